//! The light shafts of the view cells: whose are out of date, what is made of them next, and which a composite reads.

use super::cells_on_device::ActiveCell;
use super::renderer::SkyRenderer;
use crate::atmosphere::{
    BaseTables, LightShafts, ShaftInputs, ShaftLayer, ShaftReader, ShaftsRead, blank_shafts,
};
use crate::gpu::{GpuError, TimedPass};
use crate::march::layer_features;
use glam::DVec3;
use skycell_protocol::CellId;
use skycell_protocol::scene::CloudLayer;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most cells that have light shafts; in further ones the air is lit everywhere.
const CELLS_MAX: usize = 4;
/// The sun's turn after which shadows are made anew, 0.1°.
const TURN_RAD: f64 = 1.745e-3;
/// Clouds or a reference that have moved by this angle, as seen from below the lowest cloud, throw another shadow.
const SHIFT_RAD: f64 = 4e-3;
/// Height under the lowest cloud that this is counted from at least, m.
const HEIGHT_MIN_M: f64 = 250.0;
/// Evaluations (samples of density, steps through the air) that go into shafts for each tile that may be marched meanwhile.
const EVALUATIONS_PER_TILE: u64 = 60_000;
/// The share of that while an older table is read.
const UPDATE_SHARE: u64 = 4;

/// What a table shows; another one is made when that has become something else.
#[derive(Clone)]
struct Shown {
    sun: DVec3,
    reference_m: DVec3,
    clouds: Vec<CloudLayer>,
    drifts: Vec<DVec3>,
    /// Of which state of the maps it is.
    epoch: u64,
    exact: bool,
    air: Arc<BaseTables>,
}

impl Shown {
    /// Whether what another one shows differs so much that it is seen.
    fn differs(&self, other: &Self) -> bool {
        let lowest_m = self
            .clouds
            .iter()
            .map(CloudLayer::base_altitude_m)
            .fold(f64::INFINITY, f64::min);
        let height_m = (lowest_m - self.reference_m.y).abs().max(HEIGHT_MIN_M);
        let moved = |a: DVec3, b: DVec3| a.distance(b) > SHIFT_RAD * height_m;
        self.clouds != other.clouds
            || self.epoch != other.epoch
            || self.exact != other.exact
            || !Arc::ptr_eq(&self.air, &other.air)
            || self.sun.angle_between(other.sun) > TURN_RAD
            || moved(self.reference_m, other.reference_m)
            || self.drifts.len() != other.drifts.len()
            || self
                .drifts
                .iter()
                .zip(&other.drifts)
                .any(|(a, b)| moved(*a, *b))
    }
}

struct Held {
    shafts: LightShafts,
    /// What is being made, or was made last.
    shown: Option<Shown>,
}

/// What came of a turn.
#[derive(Debug, Default)]
pub(super) struct ShaftProgress {
    /// There is more to make.
    pub(super) is_pending: bool,
    /// Cells whose air is lit otherwise from now on.
    pub(super) changed: Vec<CellId>,
    /// Samples and steps that were submitted.
    pub(super) evaluations: u64,
}

/// The light shafts of all cells.
#[derive(Default)]
pub(super) struct CellShafts {
    held: BTreeMap<CellId, Held>,
    blank: Option<ShaftReader>,
    /// Where the eye of a single picture's rays is, in its cell's frame, m; else a cell's reference counts.
    pub(super) eye: Option<DVec3>,
    /// Samples and steps since the start.
    pub(super) evaluations: u64,
    /// Tables that became whole since the start.
    pub(super) tables: u64,
}

impl CellShafts {
    /// Gives everything back.
    pub(super) fn clear(&mut self) {
        self.held.clear();
        self.blank = None;
        self.eye = None;
    }

    /// Bytes on the device.
    pub(super) fn bytes(&self) -> u64 {
        self.held.values().map(|held| held.shafts.bytes()).sum()
    }

    /// Where a cell's shafts are seen from, in its frame, m.
    fn origin(&self, cell: &ActiveCell) -> DVec3 {
        self.eye
            .unwrap_or_else(|| cell.frame.from_world(cell.reference_m))
    }

    /// The table that a cell reads.
    pub(super) fn of(&self, cell: CellId) -> Option<&LightShafts> {
        self.held.get(&cell).map(|held| &held.shafts)
    }
}

impl SkyRenderer {
    /// Whether clouds throw shadow into the air.
    pub(super) fn has_light_shafts(&self) -> bool {
        self.scene.light_shafts() && !self.active.is_empty()
    }

    /// What composites of a cell's viewers read; none in a scene without.
    pub(super) fn shaft_reader(&mut self, cell: CellId) -> Option<ShaftReader> {
        if !self.has_light_shafts() {
            return None;
        }
        let made = self.shafts.of(cell).and_then(LightShafts::reader).cloned();
        Some(made.unwrap_or_else(|| {
            let gpu = &self.gpu;
            self.shafts
                .blank
                .get_or_insert_with(|| blank_shafts(gpu))
                .clone()
        }))
    }

    /// Makes what is out of date and waits for it: for single pictures.
    pub(super) fn make_light_shafts(&mut self, tiles_max: usize) -> Result<(), GpuError> {
        while self.update_light_shafts(tiles_max).is_pending {
            self.gpu.wait()?;
        }
        Ok(())
    }

    /// Makes parts of tables that are out of date, in proportion to the tiles that may be marched meanwhile.
    pub(super) fn update_light_shafts(&mut self, tiles_max: usize) -> ShaftProgress {
        let mut progress = ShaftProgress::default();
        let Some(air) = self
            .air
            .shown()
            .cloned()
            .filter(|_| self.has_light_shafts())
        else {
            self.shafts.clear();
            return progress;
        };
        let cells: Vec<CellId> = self.active_cells.keys().copied().take(CELLS_MAX).collect();
        self.shafts.held.retain(|id, _| cells.contains(id));
        let whole = EVALUATIONS_PER_TILE * tiles_max.max(1) as u64;
        for id in cells {
            let mut held = self.shafts.held.remove(&id).unwrap_or_else(|| Held {
                shafts: LightShafts::new(&self.gpu, &self.pipelines, self.active.len()),
                shown: None,
            });
            if held.shafts.layers() != self.active.len() {
                held = Held {
                    shafts: LightShafts::new(&self.gpu, &self.pipelines, self.active.len()),
                    shown: None,
                };
            }
            self.begin_when_stale(id, &mut held, &air);
            let budget = match held.shafts.reader() {
                Some(_) => whole / UPDATE_SHARE,
                None => whole,
            };
            self.advance_light_shafts(id, &mut held, budget, &mut progress);
            progress.is_pending |= held.shafts.is_building();
            self.shafts.held.insert(id, held);
        }
        progress
    }

    /// Begins a table where the last one shows something else. One that is being made is finished first: a sky that
    /// changes all the time would never see one.
    fn begin_when_stale(&self, id: CellId, held: &mut Held, air: &Arc<BaseTables>) {
        let Some(cell) = self
            .active_cells
            .get(&id)
            .filter(|_| !held.shafts.is_building())
        else {
            return;
        };
        let layers = || {
            self.active
                .iter()
                .map(|active| (active, &self.scene.layers()[active.scene_index]))
        };
        let now = Shown {
            sun: self.light.sun_direction,
            reference_m: cell.reference_m,
            clouds: layers().map(|(_, layer)| layer.clone()).collect(),
            drifts: layers()
                .map(|(active, _)| self.drifts[active.scene_index])
                .collect(),
            epoch: self.sun.epoch(),
            exact: cell.settings.exact_interpolation,
            air: air.clone(),
        };
        if held.shown.as_ref().is_some_and(|last| !last.differs(&now)) {
            return;
        }
        let origin = self.shafts.origin(cell);
        let radius_m = self.scene.planet().radius_m();
        held.shafts.begin(ShaftInputs {
            sun: now.sun,
            origin,
            altitude_m: cell.frame.altitude_m(origin),
            zenith: (origin + DVec3::Y * radius_m).normalize_or(DVec3::Y),
            air_top_m: air.medium.top_m,
            layers: layers()
                .map(|(active, layer)| ShaftLayer {
                    base_altitude_m: layer.base_altitude_m(),
                    top_altitude_m: layer.top_altitude_m(),
                    features: layer_features(&self.scene, active.scene_index, &cell.settings),
                })
                .collect(),
        });
        held.shown = Some(now);
    }

    fn advance_light_shafts(
        &mut self,
        id: CellId,
        held: &mut Held,
        evaluations_max: u64,
        progress: &mut ShaftProgress,
    ) {
        let (Some(cell), Some(shown)) = (self.active_cells.get(&id), &held.shown) else {
            return;
        };
        if !held.shafts.is_building() {
            return;
        }
        let origin = self.shafts.origin(cell);
        let zenith = (origin + DVec3::Y * self.scene.planet().radius_m()).normalize_or(DVec3::Y);
        let air = self.air_views.base_group(
            &self.gpu,
            &self.pipelines,
            held.shafts.air(),
            cell.frame.altitude_m(origin),
            shown.sun.dot(zenith),
        );
        let Some(air) = air else {
            return;
        };
        self.timing.begin();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("light shafts"),
            });
        let read = ShaftsRead {
            scene: &cell.buffers.scene_group,
            field: cell.buffers.field_group(),
            air: &air,
        };
        let (evaluations, is_whole) = held.shafts.advance(
            &self.gpu,
            &mut encoder,
            &mut self.timing,
            &self.pipelines,
            &read,
            evaluations_max,
        );
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
        self.counters.dispatches += 1;
        self.shafts.evaluations += evaluations;
        progress.evaluations += evaluations;
        if is_whole {
            self.shafts.tables += 1;
            progress.changed.push(id);
        }
    }

    /// Device time that so many evaluations take, as far as it was measured, s.
    pub(super) fn shafts_time_s(&self, evaluations: u64) -> f64 {
        let (ns, units) = self.gpu_time(TimedPass::LightShafts);
        ns as f64 * 1e-9 * evaluations as f64 / (units as f64).max(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RenderConfig;
    use crate::frame_loop::interface::ViewRequest;
    use crate::gpu::Gpu;
    use serde_json::json;
    use skycell_protocol::{Camera, Codec, FrameSize, RendererKind, Scene, Show, ViewerId};
    use std::path::PathBuf;

    fn scene(light_shafts: bool, elevation_deg: f64) -> Arc<Scene> {
        let document = json!({"version": 1, "sun": {"elevation_deg": elevation_deg},
            "wind": {"speed_m_per_s": 5},
            "layers": [{"density": {"model": "homogeneous"}}],
            "atmosphere": {"model": "physical", "light_shafts": light_shafts}});
        Arc::new(Scene::from_json(&document).expect("a scene"))
    }

    fn renderer() -> SkyRenderer {
        let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
        let config = RenderConfig::new(PathBuf::from(noise));
        let gpu = Gpu::open_blocking().expect("a device");
        let mut renderer =
            SkyRenderer::new(gpu, config, scene(true, 40.0), 1, &[]).expect("a renderer");
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
            },
        );
        renderer.refresh_cells();
        renderer
    }

    /// Evaluations of the turns in which a table is made, and how many tables became whole.
    fn made(renderer: &mut SkyRenderer) -> (Vec<u64>, u64) {
        let before = renderer.shafts.tables;
        let mut turns = Vec::new();
        loop {
            let progress = renderer.update_light_shafts(8);
            if progress.evaluations > 0 {
                turns.push(progress.evaluations);
            }
            if !progress.is_pending {
                return (turns, renderer.shafts.tables - before);
            }
        }
    }

    #[test]
    fn a_table_is_made_in_strips_rests_with_the_sky_and_goes_with_the_option() {
        let mut renderer = renderer();
        let (turns, tables) = made(&mut renderer);
        let whole: u64 = turns.iter().sum();
        assert_eq!(tables, 1);
        assert!(turns.len() > 8, "{turns:?}");
        let most = 8 * EVALUATIONS_PER_TILE;
        assert!(turns.iter().all(|turn| *turn <= most), "{turns:?}");
        let submissions = renderer.counters.submissions;
        for _ in 0..20 {
            assert_eq!(made(&mut renderer), (vec![], 0), "a sky at rest");
        }
        assert_eq!(renderer.counters.submissions, submissions);
        // Half a metre of wind is not seen, ten metres are; the table that is there serves meanwhile, and strips are smaller.
        renderer.advance_time(0.1);
        assert_eq!(made(&mut renderer), (vec![], 0));
        renderer.advance_time(2.0);
        assert!(renderer.update_light_shafts(8).is_pending);
        let id = *renderer.active_cells.keys().next().expect("a cell");
        assert!(
            renderer
                .shafts
                .of(id)
                .and_then(LightShafts::reader)
                .is_some()
        );
        let (turns, tables) = made(&mut renderer);
        assert_eq!(tables, 1);
        // A quarter of the budget, but never less than a workgroup's half-planes.
        assert!(turns.iter().all(|turn| *turn < most / 2), "{turns:?}");
        // The sun by half a degree.
        renderer.set_scene(scene(true, 40.5), 2).expect("a scene");
        renderer.refresh_cells();
        let (turns, tables) = made(&mut renderer);
        assert_eq!((turns.iter().sum::<u64>(), tables), (whole, 1));
        assert!(renderer.shafts.bytes() > 0);
        renderer.set_scene(scene(false, 40.5), 3).expect("a scene");
        renderer.refresh_cells();
        assert_eq!(made(&mut renderer), (vec![], 0));
        assert_eq!(renderer.shafts.bytes(), 0);
        assert!(renderer.shaft_reader(id).is_none());
    }
}
