//! The sun volumes on the device: which there are, what is made of them next, and which cell reads which.

use super::renderer::SkyRenderer;
use crate::march::{CellFrame, MarchSettings, SunVolumeTexture, layer_features, scene_uniform};
use crate::sun_volume::{
    Generation, GenerationInputs, LayerShell, SiteId, Sites, serves, sun_volume_uniform,
};
use glam::{DVec2, DVec3};
use skycell_protocol::scene::CloudLayer;
use skycell_protocol::{CellId, Scene, SunDepth};
use skycell_shaders::Features;
use std::collections::BTreeMap;

/// Beyond this turn of the sun at once its old volume tells nothing any more: rad.
pub(super) const TURN_MAX_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
/// Cells within this share of the finest level's width share a volume.
const JOIN_SHARE: f64 = 0.125;
/// Evaluations of density that go into volumes for each tile that may be marched meanwhile.
const EVALUATIONS_PER_TILE: u64 = 60_000;
/// The share of that while an older volume still serves.
const UPDATE_SHARE: u64 = 4;

struct Held {
    volume: Generation,
    texture: SunVolumeTexture,
    /// Tells textures apart.
    number: u64,
    /// The layers as they were when it began.
    clouds: Vec<CloudLayer>,
    /// What of the settings its densities depend on.
    noise: (bool, bool),
    /// Of which state of maps and grids it is.
    epoch: u64,
    /// It was full once: what is read of it no longer depends on how far it is.
    is_ready: bool,
}

#[derive(Default)]
struct Site {
    front: Option<Held>,
    /// Takes the place of `front` when it is full.
    back: Option<Held>,
}

/// What the volumes hold and did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct SunVolumeCounters {
    pub(super) evaluations: u64,
    pub(super) columns: u64,
}

/// The sun volumes on the device.
#[derive(Default)]
pub(super) struct SunVolumes {
    sites: Sites,
    held: BTreeMap<SiteId, Site>,
    next_number: u64,
    pub(super) counters: SunVolumeCounters,
}

impl SunVolumes {
    /// Forgets all columns: the clouds are others.
    pub(super) fn clear(&mut self) {
        self.held.clear();
    }

    /// Bytes on the device.
    pub(super) fn bytes(&self) -> u64 {
        self.held
            .values()
            .flat_map(|site| [&site.front, &site.back])
            .flatten()
            .map(|held| held.texture.bytes())
            .sum()
    }
}

/// Whether settings ask for the volume in a scene.
pub(super) fn asks_for_volume(settings: &MarchSettings, scene: &Scene) -> bool {
    settings.sun_depth.unwrap_or(scene.light().sun_depth()) == SunDepth::Volume
}

fn xz(v: DVec3) -> DVec2 {
    DVec2::new(v.x, v.z)
}

impl SkyRenderer {
    /// The inputs of a volume around a place.
    fn sun_inputs(&self, center_m: DVec2) -> GenerationInputs {
        GenerationInputs {
            direction: self.light.sun_direction,
            center_m,
            planet_radius_m: self.scene.planet().radius_m(),
            layers: self
                .active
                .iter()
                .map(|active| {
                    let layer = &self.scene.layers()[active.scene_index];
                    let shell = LayerShell {
                        base_altitude_m: layer.base_altitude_m(),
                        top_altitude_m: layer.top_altitude_m(),
                    };
                    (shell, self.drifts[active.scene_index])
                })
                .collect(),
        }
    }

    /// What the layers' column passes are specialised to.
    fn sun_features(&self) -> Vec<Features> {
        self.active
            .iter()
            .map(|layer| layer_features(&self.scene, layer.scene_index, &self.settings))
            .collect()
    }

    fn sun_clouds(&self) -> Vec<CloudLayer> {
        self.active
            .iter()
            .map(|active| self.scene.layers()[active.scene_index].clone())
            .collect()
    }

    fn sun_noise(&self) -> (bool, bool) {
        let settings = &self.settings;
        (settings.detail_noise, settings.exact_interpolation)
    }

    fn new_sun_volume(&mut self, inputs: &GenerationInputs) -> Held {
        let size = self.settings.sun_volume.fitting(self.active.len());
        let volume = Generation::new(size, inputs);
        let scenes: Vec<_> = (0..volume.layers())
            .map(|layer| {
                // In the field's own coordinates: where no wind has blown.
                let origin_m = volume.origin_m(layer);
                let at = DVec3::new(origin_m.x, 0.0, origin_m.y);
                // And where the noise stays where it is.
                let still = DVec3::new(0.0, volume.risen_m(layer), 0.0);
                scene_uniform(
                    &self.scene,
                    &self.active,
                    &self.light,
                    self.settings,
                    &CellFrame::at(at, self.scene.planet().radius_m()),
                    &vec![still; self.scene.layers().len()],
                )
            })
            .collect();
        self.sun.next_number += 1;
        Held {
            texture: SunVolumeTexture::new(&self.gpu, &self.pipelines, &volume, &scenes),
            volume,
            number: self.sun.next_number,
            clouds: self.sun_clouds(),
            noise: self.sun_noise(),
            epoch: self.field_epoch,
            is_ready: false,
        }
    }

    /// Makes columns of volumes that are wanted, in proportion to the tiles that may be marched meanwhile, and lets cells
    /// read them. True while a volume that cells wait for is not full yet.
    pub(super) fn update_sun_volumes(&mut self, tiles_max: usize) -> bool {
        let wanting: Vec<(CellId, DVec2)> = self
            .active_cells
            .iter()
            .filter(|(_, cell)| asks_for_volume(&cell.settings, &self.scene))
            .map(|(id, cell)| (*id, xz(cell.reference_m)))
            .collect();
        if wanting.is_empty() || self.active.is_empty() || !serves(self.light.sun_direction) {
            self.sun.clear();
            for cell in self.active_cells.values_mut() {
                cell.buffers.sun = None;
            }
            return false;
        }
        let size = self.settings.sun_volume.fitting(self.active.len());
        let join_m = JOIN_SHARE * size.spacing_m * f64::from(size.columns);
        self.sun.sites.assign(&wanting, join_m);
        let first_cells = self.sun.sites.first_cells();
        self.sun.held.retain(|id, _| first_cells.contains_key(id));
        let mut evaluations_left = EVALUATIONS_PER_TILE * tiles_max.max(1) as u64;
        let mut is_awaited = false;
        for (id, first) in first_cells {
            let center_m = self
                .active_cells
                .get(&first)
                .map_or(DVec2::ZERO, |cell| xz(cell.reference_m));
            let inputs = self.sun_inputs(center_m);
            let mut site = self.sun.held.remove(&id).unwrap_or_default();
            let (awaited, changed) = self.update_site(&mut site, &inputs, &mut evaluations_left);
            is_awaited |= awaited;
            self.sun.held.insert(id, site);
            if changed {
                for (cell, _) in &wanting {
                    if self.sun.sites.of(*cell) == Some(id) {
                        self.caches.age_cell(*cell);
                    }
                }
            }
        }
        self.bind_sun_volumes();
        is_awaited
    }

    /// Brings one volume forward. First: cells have to wait for it. Second: another volume took its place.
    fn update_site(
        &mut self,
        site: &mut Site,
        inputs: &GenerationInputs,
        evaluations_left: &mut u64,
    ) -> (bool, bool) {
        let size = self.settings.sun_volume.fitting(self.active.len());
        let noise = self.sun_noise();
        let fits = |held: &Held| {
            held.volume.size() == size
                && held.volume.layers() == inputs.layers.len()
                && held.noise == noise
                && inputs
                    .layers
                    .iter()
                    .enumerate()
                    .all(|(layer, (shell, _))| held.volume.shell(layer) == *shell)
        };
        let clouds = self.sun_clouds();
        if site
            .front
            .as_ref()
            .is_some_and(|front| !fits(front) || front.volume.off_by_rad(inputs) > TURN_MAX_RAD)
        {
            *site = Site::default();
        }
        let mut front = match site.front.take() {
            Some(front) => front,
            None => self.new_sun_volume(inputs),
        };
        if !front.is_ready {
            self.advance(&mut front, inputs, evaluations_left, 1);
            // A sky that moves may do so faster than a volume can follow: nobody waits for it.
            let awaited = !front.is_ready && !self.sky_time.moves();
            site.front = Some(front);
            return (awaited, false);
        }
        self.advance(&mut front, inputs, evaluations_left, UPDATE_SHARE);
        let is_old = front.volume.is_stale(inputs)
            || front.epoch != self.field_epoch
            || front.clouds != clouds;
        if site.back.is_none() && is_old {
            site.back = Some(self.new_sun_volume(inputs));
        }
        let mut changed = false;
        if let Some(mut back) = site.back.take() {
            self.advance(&mut back, inputs, evaluations_left, UPDATE_SHARE);
            if back.is_ready {
                // Texels of a sky that changes are refreshed in any case.
                changed = !self.sky_time.moves()
                    && (back.volume.direction() != front.volume.direction()
                        || back.clouds != front.clouds);
                front = back;
            } else {
                site.back = Some(back);
            }
        }
        site.front = Some(front);
        (false, changed)
    }

    fn advance(
        &mut self,
        held: &mut Held,
        inputs: &GenerationInputs,
        evaluations_left: &mut u64,
        share: u64,
    ) {
        if *evaluations_left == 0 {
            return;
        }
        let strips = held
            .volume
            .advance(inputs, (*evaluations_left / share).max(1));
        if !strips.is_empty() {
            let features = self.sun_features();
            self.timing.begin();
            let mut encoder =
                self.gpu
                    .device
                    .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                        label: Some("sun volume"),
                    });
            self.counters.dispatches += held.texture.record(
                &self.gpu,
                &mut encoder,
                &mut self.timing,
                &self.pipelines,
                &self.field.bind_group,
                &held.volume,
                &strips,
                &features,
            );
            self.timing.resolve(&mut encoder);
            self.submit(encoder);
            self.timing.submitted();
        }
        for strip in &strips {
            self.sun.counters.evaluations += strip.evaluations;
            self.sun.counters.columns += strip.columns.count();
            *evaluations_left = evaluations_left.saturating_sub(strip.evaluations);
        }
        held.is_ready |= held.volume.is_complete(inputs);
    }

    /// Tells every cell which volume it reads, and where its columns are for it.
    pub(super) fn bind_sun_volumes(&mut self) {
        let layers: Vec<(DVec2, f64)> = self
            .active
            .iter()
            .map(|active| {
                let extinction = self.scene.layers()[active.scene_index].extinction_per_m();
                (xz(self.drifts[active.scene_index]), extinction)
            })
            .collect();
        for (id, cell) in &mut self.active_cells {
            let site = self.sun.sites.of(*id);
            let held = site
                .and_then(|site| self.sun.held.get(&site))
                .and_then(|site| site.front.as_ref())
                .filter(|held| held.is_ready && asks_for_volume(&cell.settings, &self.scene));
            let Some(held) = held else {
                cell.buffers.sun = None;
                continue;
            };
            let [x, z] = cell.frame.origin_m();
            let sun_steps = cell
                .settings
                .sun_steps
                .unwrap_or(self.scene.light().sun_steps());
            let seen = sun_volume_uniform(&held.volume, DVec2::new(x, z), &layers, sun_steps);
            cell.buffers.bind_sun(
                &self.gpu,
                &self.pipelines,
                &held.texture,
                held.number,
                held.volume.layers() as u32,
                &seen,
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RenderConfig;
    use crate::frame_loop::interface::ViewRequest;
    use crate::gpu::Gpu;
    use crate::sun_volume::SunVolumeSize;
    use serde_json::json;
    use skycell_protocol::{Camera, Codec, FrameSize, RendererKind, Show, ViewerId};
    use std::path::PathBuf;
    use std::sync::Arc;

    fn scene(elevation_deg: f64) -> Arc<Scene> {
        let document = json!({"version": 1, "sun": {"elevation_deg": elevation_deg},
            "wind": {"speed_m_per_s": 5}, "light": {"sun_depth": "volume"}});
        Arc::new(Scene::from_json(&document).expect("a scene"))
    }

    fn renderer(elevation_deg: f64) -> SkyRenderer {
        let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
        let config = RenderConfig::new(PathBuf::from(noise));
        let gpu = Gpu::open_blocking().expect("a device");
        let mut renderer =
            SkyRenderer::new(gpu, config, scene(elevation_deg), 1, &[]).expect("a renderer");
        renderer.settings.sun_volume = SunVolumeSize {
            columns: 64,
            slices: 16,
            ..SunVolumeSize::default()
        };
        renderer.join(
            ViewerId(1),
            ViewRequest {
                size: FrameSize::new(64, 36).expect("a size"),
                fps: 1.0,
                codec: Codec::Png,
                jpeg_quality: 100,
                camera: Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0).expect("a camera"),
                renderer: RendererKind::Cached,
                quality: None,
                show: Show::Picture,
                stereo: None,
                haze: true,
                linear: false,
            },
        );
        renderer.refresh_cells();
        renderer
    }

    /// The texture that the only cell reads.
    fn read(renderer: &SkyRenderer) -> Option<u64> {
        let cell = renderer.active_cells.values().next().expect("a cell");
        cell.buffers.sun.as_ref().map(|sun| sun.texture)
    }

    fn made(renderer: &mut SkyRenderer) -> u64 {
        let before = renderer.sun.counters.evaluations;
        renderer.update_sun_volumes(1);
        renderer.sun.counters.evaluations - before
    }

    #[test]
    fn a_volume_is_made_in_slices_rests_with_the_sky_and_is_replaced_while_it_serves() {
        let mut renderer = renderer(45.0);
        let mut turns = 0;
        while renderer.update_sun_volumes(1) {
            turns += 1;
            assert_eq!(read(&renderer), None, "read before it was there");
        }
        let whole = renderer.sun.counters.evaluations;
        let first = read(&renderer);
        assert!(turns > 3 && first.is_some(), "{turns}");
        assert_eq!(made(&mut renderer), 0, "a sky at rest");
        // A minute of 5 m/s: 300 m of a window of 3.2 km.
        renderer.advance_time(60.0);
        let entered = made(&mut renderer);
        assert!(entered > 0 && entered < whole / 5, "{entered} of {whole}");
        assert_eq!(read(&renderer), first);
        // Half a degree later the old one serves until the new one is full.
        renderer.set_scene(scene(45.5), 2).expect("a scene");
        renderer.refresh_cells();
        let mut slices = 0;
        while read(&renderer) == first {
            let step = made(&mut renderer);
            assert!(step > 0 && step < whole / 3, "{step} of {whole}");
            slices += 1;
        }
        assert!(slices > 3, "{slices}");
        assert!(read(&renderer).is_some());
        assert_eq!(made(&mut renderer), 0, "a sky at rest again");
        // A leap of the sun is waited for; a set one needs nothing.
        renderer.set_scene(scene(75.0), 3).expect("a scene");
        renderer.refresh_cells();
        assert!(renderer.update_sun_volumes(1) && read(&renderer).is_none());
        renderer.set_scene(scene(2.0), 4).expect("a scene");
        renderer.refresh_cells();
        assert!(!renderer.update_sun_volumes(1) && read(&renderer).is_none());
        assert_eq!(renderer.sun.bytes(), 0);
    }
}
