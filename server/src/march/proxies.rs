//! What layers are kept on: a layer may be cut into parts, each with a proxy sphere of its own.

use super::{ActiveLayer, CellFrame};
use glam::DVec3;
use skycell_protocol::Scene;
use skycell_shaders::layout;

/// Most parts of a layer.
pub const PROXIES_PER_LAYER_MAX: u32 = 4;
/// Layers that a scene may have.
const LAYERS_MAX: usize = 4;
/// Most proxies of a scene, as in `scene/scene.wgsl`.
pub const PROXIES_MAX: usize = LAYERS_MAX * PROXIES_PER_LAYER_MAX as usize;
/// Farther than any ray goes, m.
const FAR_M: f32 = 1e30;

/// From above, rays from an anchor that pass over its sphere have their places no nearer than this share of the way to where
/// a ray touches the sphere.
const LEAST_SHARE: f64 = 0.25;

/// Least distance of such places, m; none where a sphere is read from below.
#[must_use]
pub fn least_from_above_m(frame: &CellFrame, anchor: DVec3, altitude_m: f64) -> Option<f64> {
    let height_m = frame.altitude_m(anchor) - altitude_m;
    let from_centre_m = 2.0 * (frame.planet_radius_m() + altitude_m) + height_m;
    (height_m > 0.0).then(|| LEAST_SHARE * (height_m * from_centre_m).sqrt())
}

/// What keeps a part of a layer in the cache.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proxy {
    /// Place of the layer among the active ones.
    pub layer: usize,
    /// Index of the layer in the scene.
    pub scene_index: usize,
    /// Altitude of the sphere, m.
    pub altitude_m: f64,
    /// Altitudes between which rays are marched, m.
    pub between_m: [f64; 2],
}

impl Proxy {
    /// As the shaders read it. `anchor` is the centre of its addresses in the cell's frame.
    #[must_use]
    pub fn uniform(&self, frame: &CellFrame, anchor: DVec3) -> layout::Proxy {
        let least_m = least_from_above_m(frame, anchor, self.altitude_m);
        layout::Proxy {
            from_above: u32::from(least_m.is_some()),
            least_m: least_m.unwrap_or(0.0) as f32,
            anchor: anchor.as_vec3().to_array(),
            altitude_m: self.altitude_m as f32,
            part: layout::Part {
                low_altitude_m: self.between_m[0] as f32,
                high_altitude_m: self.between_m[1] as f32,
                near_m: 0.0,
                far_m: FAR_M,
            },
            layer: self.layer as u32,
            ..Default::default()
        }
    }
}

/// The proxies of a scene's active layers: `slabs` of each, from the lowest to the highest, one layer after another. A layer
/// that is whole is kept on a sphere at the mean altitude of its clouds, a slab on one in its middle.
#[must_use]
pub fn proxies_of(scene: &Scene, active: &[ActiveLayer], slabs: u32) -> Vec<Proxy> {
    let slabs = slabs.clamp(1, PROXIES_PER_LAYER_MAX);
    let of_layer = |(layer, active): (usize, &ActiveLayer)| {
        let shell = &scene.layers()[active.scene_index];
        let (base_m, top_m) = (shell.base_altitude_m(), shell.top_altitude_m());
        let (scene_index, proxy_altitude_m) = (active.scene_index, active.proxy_altitude_m);
        (0..slabs).map(move |slab| {
            let cut = |place: u32| base_m + (top_m - base_m) * f64::from(place) / f64::from(slabs);
            let between_m = [cut(slab), cut(slab + 1)];
            Proxy {
                layer,
                scene_index,
                altitude_m: if slabs == 1 {
                    proxy_altitude_m
                } else {
                    0.5 * (between_m[0] + between_m[1])
                },
                between_m,
            }
        })
    };
    active.iter().enumerate().flat_map(of_layer).collect()
}

#[cfg(test)]
mod tests {
    use super::super::active_layers;
    use super::*;
    use serde_json::json;

    #[test]
    fn slabs_of_a_layer_meet_and_fill_it() {
        let document = json!({"version": 1, "layers": [
            {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 4000},
            {"name": "high", "base_altitude_m": 5000, "top_altitude_m": 6000}]});
        let scene = Scene::from_json(&document).expect("valid");
        let active = active_layers(&scene);
        for slabs in 1..=4usize {
            let proxies = proxies_of(&scene, &active, slabs as u32);
            assert_eq!(proxies.len(), 2 * slabs);
            for (layer, (base_m, top_m)) in [(1_500.0, 4_000.0), (5_000.0, 6_000.0)]
                .into_iter()
                .enumerate()
            {
                let parts = &proxies[layer * slabs..(layer + 1) * slabs];
                assert!(parts.iter().all(|part| part.layer == layer));
                assert_eq!(parts[0].between_m[0], base_m);
                assert_eq!(parts[slabs - 1].between_m[1], top_m);
                for pair in parts.windows(2) {
                    assert_eq!(pair[0].between_m[1], pair[1].between_m[0]);
                }
                for part in parts {
                    assert!(part.between_m[0] < part.altitude_m);
                    assert!(part.altitude_m < part.between_m[1]);
                }
            }
        }
    }
}
