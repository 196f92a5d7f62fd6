//! What layers are kept on: a layer may be cut into parts, each with a surface of its own. Setups are settings of one
//! mechanism: where the surface is, what of a ray lies on it, and what happens when the cell's reference goes away.

#[cfg(test)]
mod tests;

use super::inside::FarPart;
use super::surface::Surface;
use super::{ActiveLayer, CellFrame};
use crate::field::{CloudHeights, Slab};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use skycell_protocol::Scene;
use skycell_protocol::number_range::NumberRange;
use skycell_protocol::scene::{CloudLayer, DensityModel};
use skycell_shaders::{Features, layout};

/// Most parts of a layer.
pub const PROXIES_PER_LAYER_MAX: u32 = 4;
/// Layers that a scene may have.
const LAYERS_MAX: usize = 4;
/// Most proxies of a scene, as in `scene/scene.wgsl`.
pub const PROXIES_MAX: usize = LAYERS_MAX * PROXIES_PER_LAYER_MAX as usize;
/// Bands of distance that a layer may be cut into.
pub const BANDS: NumberRange = NumberRange::new(2.0, PROXIES_PER_LAYER_MAX as f64);
/// How far a reference may go before a dome follows it, m.
pub const DOME_FOLLOW_M: NumberRange = NumberRange::new(1.0, 4_000.0);
/// Farther than any ray goes, m.
pub(super) const FAR_M: f64 = 1e30;
/// A layer counts as this far above or below an anchor at least, m.
const HEIGHT_MIN_M: f64 = 100.0;

/// What layers are kept on.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum ProxySetup {
    /// Spheres about the planet, in the layers.
    #[default]
    InLayer,
    /// One dome per layer about where the cell began. Its rays go on starting there.
    StaticDome,
    /// One dome per layer that goes along with the cell's reference: what it shows is resampled.
    FollowingDome,
    /// Bands of distance, each on a dome of its own, that go along with the reference.
    NestedDomes,
}

impl ProxySetup {
    /// Every setup, with its name.
    pub const NAMES: [(&str, Self); 4] = [
        ("in-layer", Self::InLayer),
        ("static-dome", Self::StaticDome),
        ("following-dome", Self::FollowingDome),
        ("nested-domes", Self::NestedDomes),
    ];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES
            .iter()
            .find(|(_, setup)| *setup == self)
            .map_or("in-layer", |(name, _)| name)
    }
}

/// Where bands of distance end.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum BandEnds {
    /// In the next gap between clouds along each ray.
    Gaps,
    /// At their distance, through whatever cloud stands there: what is in front hides the cut, and what is behind is there where a
    /// viewer beside the reference looks past it.
    #[default]
    Cut,
}

/// A setup with all that it is told.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ProxySettings {
    /// Which.
    pub setup: ProxySetup,
    /// Slabs of altitude, 1 to 4 (in-layer; else 1).
    pub slabs: u32,
    /// Bands of distance, 2 to 4 (nested domes).
    pub bands: u32,
    /// Where bands end (nested domes).
    pub band_ends: BandEnds,
    /// How far a reference may go before its domes follow, m (following and nested domes).
    pub follow_m: f64,
}

impl Default for ProxySettings {
    fn default() -> Self {
        Self {
            setup: ProxySetup::InLayer,
            slabs: 1,
            bands: 3,
            band_ends: BandEnds::default(),
            follow_m: 100.0,
        }
    }
}

/// Slabs of altitude on something that has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{slabs} slabs with {}: only in-layer proxies are cut into slabs; domes have 1", setup.name())]
pub struct SlabsWithDomes {
    /// As many.
    pub slabs: u32,
    /// On this.
    pub setup: ProxySetup,
}

impl ProxySettings {
    /// The settings with all numbers within their limits.
    ///
    /// # Errors
    /// Domes have no slabs.
    pub fn checked(self) -> Result<Self, SlabsWithDomes> {
        let slabs = self.slabs.clamp(1, PROXIES_PER_LAYER_MAX);
        if slabs > 1 && self.has_domes() {
            let setup = self.setup;
            return Err(SlabsWithDomes { slabs, setup });
        }
        Ok(Self {
            slabs,
            bands: self.bands.clamp(2, PROXIES_PER_LAYER_MAX),
            ..self
        })
    }

    /// Parts that each layer is kept in.
    #[must_use]
    pub fn parts(&self) -> u32 {
        match self.setup {
            ProxySetup::InLayer => self.slabs,
            ProxySetup::StaticDome | ProxySetup::FollowingDome => 1,
            ProxySetup::NestedDomes => self.bands,
        }
    }

    /// Whether texels lie on domes.
    #[must_use]
    pub fn has_domes(&self) -> bool {
        self.setup != ProxySetup::InLayer
    }

    /// Whether domes go along with their cell's reference.
    #[must_use]
    pub fn follows(&self) -> bool {
        matches!(
            self.setup,
            ProxySetup::FollowingDome | ProxySetup::NestedDomes
        )
    }

    /// What kernels that march or audit texels are specialised to beside a layer.
    #[must_use]
    pub fn features(&self, layer: Features) -> Features {
        Features {
            domes: self.has_domes(),
            bands: self.setup == ProxySetup::NestedDomes && self.band_ends == BandEnds::Gaps,
            ..layer
        }
    }
}

/// A dome in heights of its layer above the anchor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dome {
    /// Its radius.
    pub radius: f64,
    /// Least and largest distance of what it keeps.
    pub between: [f64; 2],
    /// The same of rays that stand in cloud there: where they begin and end at the latest.
    pub between_gaps: [f64; 2],
}

impl Dome {
    /// The dome of band k of n, or of all where n is 1.
    ///
    /// A layer at height h is h/µ away in a direction whose sine of elevation is µ, and directions are even in µ. Something at
    /// distance d is seen from beside the anchor as if it were at r: off in angle by |1/d − 1/r|, whose square is least on the
    /// mean where 1/r is the mean of 1/d = µ/h. So bands are cut evenly in 1/d, from 1/h to 0, each with the same share of the
    /// sky, and the dome of each is at the harmonic mean of its ends: of one band at 2 h, where the layer is seen 30° high.
    #[must_use]
    pub fn of_band(k: u32, n: u32, ends: BandEnds) -> Self {
        // The band's end number i, the first of which is at the layer's height.
        let end = |i: u32| {
            if i >= n {
                FAR_M
            } else {
                f64::from(n) / f64::from(n - i)
            }
        };
        // A ray in cloud goes on by the length of its band at most.
        let gap = |i: u32| match ends {
            BandEnds::Gaps if i > 0 && i < n => 2.0 * end(i) - end(i - 1),
            _ => end(i),
        };
        let share = |i: u32| 1.0 - f64::from(i) / f64::from(n);
        let near = |value: f64| if k == 0 { 0.0 } else { value };
        Self {
            radius: 2.0 / (share(k) + share(k + 1)),
            // What is nearer than the layer's height is the first band's.
            between: [near(end(k)), end(k + 1)],
            between_gaps: [near(gap(k)), gap(k + 1)],
        }
    }
}

/// What keeps a part of a layer in the cache.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proxy {
    /// Place of the layer among the active ones.
    pub layer: usize,
    /// Index of the layer in the scene.
    pub scene_index: usize,
    /// Altitude of a shell; of a dome, the mean altitude of its layer's clouds, m.
    pub altitude_m: f64,
    /// Base and top of the layer, m.
    pub layer_m: [f64; 2],
    /// Which of the layer's parts it is, and of how many.
    pub part: u32,
    /// As many.
    pub parts: u32,
    /// Altitudes between which rays are marched, m.
    pub between_m: [f64; 2],
    /// The dome that it is, where it is none of the shells.
    pub dome: Option<Dome>,
    /// Altitudes between which it has cloud worth a look, m.
    pub seen_between_m: [f64; 2],
}

impl Proxy {
    /// Height of its clouds above or below an anchor, m.
    fn height_m(&self, frame: &CellFrame, anchor: DVec3) -> f64 {
        let height_m = self.altitude_m - frame.altitude_m(anchor);
        height_m.abs().max(HEIGHT_MIN_M)
    }

    /// Whether rays go down to it about an anchor.
    #[must_use]
    pub fn is_from_above(&self, frame: &CellFrame, anchor: DVec3) -> bool {
        frame.altitude_m(anchor) > self.altitude_m && self.far_part(frame, anchor).is_none()
    }

    /// Altitudes between which it is marched about an anchor, m.
    #[must_use]
    pub fn altitudes_m(&self, frame: &CellFrame, anchor: DVec3) -> [f64; 2] {
        (self.far_part(frame, anchor)).map_or(self.between_m, |_| self.layer_m)
    }

    /// Where its texels lie about an anchor in a cell's frame.
    #[must_use]
    pub fn surface(&self, frame: &CellFrame, anchor: DVec3) -> Surface {
        if let Some(FarPart { radius_m, .. }) = self.far_part(frame, anchor) {
            return Surface::Dome { radius_m };
        }
        match self.dome {
            None => Surface::shell(frame, anchor, self.altitude_m),
            Some(dome) => Surface::Dome {
                radius_m: dome.radius * self.height_m(frame, anchor),
            },
        }
    }

    /// Distances from where rays start between which it keeps something, m; None where it keeps all.
    #[must_use]
    pub fn band_m(&self, frame: &CellFrame, anchor: DVec3) -> Option<[f64; 2]> {
        if let Some(FarPart { near_m, far_m, .. }) = self.far_part(frame, anchor) {
            return Some([near_m, far_m]);
        }
        let dome = self
            .dome
            .filter(|dome| dome.between[0] > 0.0 || dome.between[1] < FAR_M)?;
        let height_m = self.height_m(frame, anchor);
        Some([dome.between[0] * height_m, dome.between_gaps[1] * height_m])
    }

    /// As the shaders read it. `anchor` is the centre of its addresses in the cell's frame.
    #[must_use]
    pub fn uniform(&self, frame: &CellFrame, anchor: DVec3) -> layout::Proxy {
        let height_m = self.height_m(frame, anchor);
        let whole = [0.0, FAR_M];
        let distances = |of: fn(&Dome) -> [f64; 2]| {
            self.dome.as_ref().map_or(whole, |dome| {
                of(dome).map(|heights| (heights * height_m).min(FAR_M))
            })
        };
        let far_part = self.far_part(frame, anchor);
        let between_m = far_part.map_or_else(
            || distances(|dome| dome.between),
            |part| [part.near_m, part.far_m],
        );
        let [near_m, far_m] = between_m.map(|m| m as f32);
        let gaps_m = far_part.map_or_else(|| distances(|dome| dome.between_gaps), |_| between_m);
        let [near_gap_m, far_gap_m] = gaps_m.map(|m| m as f32);
        let [radius_m, least_m] = match self.surface(frame, anchor) {
            Surface::Shell { .. } => [0.0, 0.0],
            Surface::ShellFromAbove { least_m, .. } => [0.0, least_m],
            Surface::Dome { radius_m } => [radius_m, 0.0],
        };
        let [low_m, high_m] = self.altitudes_m(frame, anchor);
        let seen_m = far_part.map_or(self.seen_between_m, |_| self.layer_m);
        layout::Proxy {
            anchor: anchor.as_vec3().to_array(),
            altitude_m: self.altitude_m as f32,
            part: layout::Part {
                low_altitude_m: low_m as f32,
                high_altitude_m: high_m as f32,
                near_m,
                far_m,
                near_gap_m,
                far_gap_m,
                full_near_m: far_part.map_or(0.0, |part| part.full_near_m as f32),
                full_far_m: FAR_M as f32,
            },
            layer: self.layer as u32,
            radius_m: radius_m as f32,
            from_above: u32::from(self.is_from_above(frame, anchor)),
            least_m: least_m as f32,
            seen_low_altitude_m: seen_m[0] as f32,
            seen_high_altitude_m: seen_m[1] as f32,
            ..Default::default()
        }
    }
}

/// The proxies of a scene's active layers, one layer after another: slabs from the lowest to the highest, bands from the nearest
/// to the farthest. A layer that is whole is kept on a sphere at the mean altitude of its clouds, a slab on one at that of its
/// own.
#[must_use]
pub fn proxies_of(scene: &Scene, active: &[ActiveLayer], settings: &ProxySettings) -> Vec<Proxy> {
    let parts = settings.parts().clamp(1, PROXIES_PER_LAYER_MAX);
    let of_layer = |(layer, active): (usize, &ActiveLayer)| {
        let shell = &scene.layers()[active.scene_index];
        let (scene_index, whole_m) = (active.scene_index, active.proxy_altitude_m);
        let whole = Slab {
            between: [0.0, 1.0],
            mean: 0.5,
        };
        let slabs = if settings.has_domes() || parts == 1 {
            vec![whole; parts as usize]
        } else {
            heights_of(shell).slabs(parts)
        };
        (0..).zip(slabs).map(move |(part, slab)| {
            let dome = settings
                .has_domes()
                .then(|| Dome::of_band(part, parts, settings.band_ends));
            let between_m = slab.between.map(|height| altitude_m(shell, height));
            Proxy {
                layer,
                scene_index,
                altitude_m: if parts == 1 || dome.is_some() {
                    whole_m
                } else {
                    altitude_m(shell, slab.mean)
                },
                layer_m: [shell.base_altitude_m(), shell.top_altitude_m()],
                part,
                parts,
                between_m,
                seen_between_m: between_m,
                dome,
            }
        })
    };
    let mut proxies: Vec<Proxy> = active.iter().enumerate().flat_map(of_layer).collect();
    look_where_clouds_are(&mut proxies, scene);
    proxies
}

/// Lets viewers look for clouds at the altitudes where a scene's clouds are. What proxies keep stays the same.
pub fn look_where_clouds_are(proxies: &mut [Proxy], scene: &Scene) {
    for proxy in proxies {
        let shell = &scene.layers()[proxy.scene_index];
        let [low_m, high_m] = proxy.between_m;
        let seen = heights_of(shell).seen_between();
        proxy.seen_between_m = seen.map(|height| altitude_m(shell, height).clamp(low_m, high_m));
    }
}

/// Leaves the proxies of layers that were there before, at the given places, what they kept then.
pub fn keep_places(proxies: &mut [Proxy], before: &[Proxy], kept: &[Option<usize>], slabs: usize) {
    for (place, old) in kept.iter().enumerate() {
        let Some(old) = old else { continue };
        for slab in 0..slabs {
            let at = proxies.get_mut(place * slabs + slab);
            if let (Some(proxy), Some(old)) = (at, before.get(old * slabs + slab)) {
                proxy.altitude_m = old.altitude_m;
                proxy.between_m = old.between_m;
            }
        }
    }
}

fn heights_of(layer: &CloudLayer) -> CloudHeights {
    match layer.density() {
        DensityModel::Weather(weather) => CloudHeights::of(weather),
        DensityModel::Homogeneous(_) | DensityModel::Grid(_) | DensityModel::Cirrus(_) => {
            CloudHeights::even()
        }
    }
}

/// The altitude of a height fraction, m; exact at both ends.
fn altitude_m(layer: &CloudLayer, height: f64) -> f64 {
    let (base_m, top_m) = (layer.base_altitude_m(), layer.top_altitude_m());
    if height < 1.0 {
        base_m + (top_m - base_m) * height
    } else {
        top_m
    }
}
