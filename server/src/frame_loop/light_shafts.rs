//! The light shafts of the view cells: whose are out of date, what is made of them next, and which a composite reads.

use super::cells_on_device::ActiveCell;
use super::renderer::SkyRenderer;
use super::sun_volumes::TURN_MAX_RAD;
use crate::atmosphere::{
    BaseTables, LightShafts, ShaftInputs, ShaftLayer, ShaftReader, ShaftsRead, blank_shafts,
    cloud_shadows_key,
};
use crate::gpu::{GpuError, TimedPass};
use crate::march::{CellFrame, layer_features};
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
/// A reference that has moved by this share of the height under the lowest cloud sees other shafts: the table tells nothing.
const SHIFT_SHARE_MAX: f64 = 0.25;
/// Height under the lowest cloud that both are counted from at least, m.
const HEIGHT_MIN_M: f64 = 250.0;
/// Evaluations (samples of density, steps through the air) that go into shafts for each tile that may be marched meanwhile.
const EVALUATIONS_PER_TILE: u64 = 60_000;
/// The share of that while an older table is read.
const UPDATE_SHARE: u64 = 4;

/// From where and under which sun a table is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seat {
    sun: DVec3,
    frame: CellFrame,
    planet_radius_m: f64,
    /// In the frame, m.
    origin_m: DVec3,
    altitude_m: f64,
}

/// What a table shows; another one is made when that has become something else.
#[derive(Clone)]
struct Shown {
    seat: Seat,
    clouds: Vec<CloudLayer>,
    drifts: Vec<DVec3>,
    /// Of which state of maps and grids it is.
    epoch: u64,
    exact: bool,
    air: Arc<BaseTables>,
}

impl Shown {
    /// Height of the lowest cloud over or under the place, m.
    fn height_m(&self) -> f64 {
        let lowest_m = self
            .clouds
            .iter()
            .map(CloudLayer::base_altitude_m)
            .fold(f64::INFINITY, f64::min);
        (lowest_m - self.seat.altitude_m).abs().max(HEIGHT_MIN_M)
    }

    /// Whether it tells nothing of what is seen from there: better none.
    fn is_off(&self, now: &Seat) -> bool {
        let seat = &self.seat;
        seat.frame != now.frame
            || seat.planet_radius_m != now.planet_radius_m
            || seat.sun.angle_between(now.sun) > TURN_MAX_RAD
            || seat.origin_m.distance(now.origin_m) > SHIFT_SHARE_MAX * self.height_m()
    }

    /// Whether what another one shows differs so much that it is seen.
    fn differs(&self, other: &Self) -> bool {
        let height_m = self.height_m();
        let moved = |a: DVec3, b: DVec3| a.distance(b) > SHIFT_RAD * height_m;
        self.is_off(&other.seat)
            || self.clouds != other.clouds
            || self.epoch != other.epoch
            || self.exact != other.exact
            || !Arc::ptr_eq(&self.air, &other.air)
            || self.seat.sun.angle_between(other.seat.sun) > TURN_RAD
            || moved(self.seat.origin_m, other.seat.origin_m)
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
    /// What is being made, or was made last; none where that was dropped.
    shown: Option<Shown>,
    /// What the table shows that is read.
    served: Option<Shown>,
}

impl Held {
    /// Drops what is being made, which begins anew.
    fn drop_build(&mut self) {
        self.shafts.drop_build();
        self.shown = None;
    }
}

/// Whose turn it is: cells that have shafts keep them, then come others as long as there is room; first who follows the one
/// whose turn was last.
fn chosen(
    active: impl Iterator<Item = CellId>,
    is_held: impl Fn(CellId) -> bool,
    last: Option<CellId>,
) -> Vec<CellId> {
    let (mut cells, others): (Vec<CellId>, Vec<CellId>) = active.partition(|id| is_held(*id));
    cells.extend(others);
    cells.truncate(CELLS_MAX);
    cells.sort_unstable();
    let next = cells.iter().position(|id| Some(*id) > last).unwrap_or(0);
    cells.rotate_left(next);
    cells
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
    /// Whose table was made last.
    last: Option<CellId>,
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

    /// A cell has ended.
    pub(super) fn remove_cell(&mut self, cell: CellId) {
        self.held.remove(&cell);
    }

    /// Bytes on the device.
    pub(super) fn bytes(&self) -> u64 {
        self.held.values().map(|held| held.shafts.bytes()).sum()
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

    /// Where a cell's shafts are seen from now.
    fn seat(&self, cell: &ActiveCell) -> Seat {
        let origin_m = self
            .shafts
            .eye
            .unwrap_or_else(|| cell.frame.from_world(cell.reference_m));
        Seat {
            sun: self.light.sun_direction,
            frame: cell.frame,
            planet_radius_m: self.scene.planet().radius_m(),
            origin_m,
            altitude_m: cell.frame.altitude_m(origin_m),
        }
    }

    /// The table of a cell, unless it is too wrong to be read.
    fn served_shafts(&self, cell: CellId) -> Option<&ShaftReader> {
        let held = self.shafts.held.get(&cell)?;
        // Who meters a cell has it in his hands: it is not among the others then.
        let now = self.active_cells.get(&cell).map(|cell| self.seat(cell));
        let is_off = |served: &Shown| now.is_some_and(|now| served.is_off(&now));
        held.shafts
            .reader()
            .filter(|_| !held.served.as_ref().is_some_and(is_off))
    }

    /// What composites of a cell's viewers read; none in a scene without.
    pub(super) fn shaft_reader(&mut self, cell: CellId) -> Option<ShaftReader> {
        if !self.has_light_shafts() {
            return None;
        }
        Some(self.served_shafts(cell).cloned().unwrap_or_else(|| {
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
        let own = self
            .active_cells
            .iter()
            .filter(|(_, cell)| cell.stands_for.is_none());
        let cells = chosen(
            own.map(|(id, _)| *id),
            |id| self.shafts.held.contains_key(&id),
            self.shafts.last,
        );
        self.shafts.held.retain(|id, _| cells.contains(id));
        let mut left = EVALUATIONS_PER_TILE * tiles_max.max(1) as u64;
        for id in cells {
            let held = self.shafts.held.remove(&id);
            let was_served = held.as_ref().is_some_and(|held| held.served.is_some());
            let mut held = held
                .filter(|held| held.shafts.layers() == self.active.len())
                .unwrap_or_else(|| Held {
                    shafts: LightShafts::new(&self.gpu, &self.pipelines, self.active.len()),
                    shown: None,
                    served: None,
                });
            self.drop_what_is_off(id, &mut held);
            if was_served && held.served.is_none() {
                self.lit_otherwise(id, &mut progress);
            }
            self.begin_when_stale(id, &mut held, &air);
            let share = if held.served.is_some() {
                UPDATE_SHARE
            } else {
                1
            };
            // The smallest part may be more than a turn's: then it is the only one.
            let fits = held.shafts.least_evaluations() <= left;
            if fits || progress.evaluations == 0 {
                let made = self.advance_light_shafts(id, &mut held, left / share, &mut progress);
                left = left.saturating_sub(made);
            }
            progress.is_pending |= held.shafts.is_building();
            self.shafts.held.insert(id, held);
        }
        progress
    }

    /// Drops a table that is too wrong to be read, and one in the making whose parts would not fit.
    fn drop_what_is_off(&self, id: CellId, held: &mut Held) {
        let Some(cell) = self.active_cells.get(&id) else {
            return;
        };
        let now = self.seat(cell);
        let is_off = |shown: &Option<Shown>| shown.as_ref().is_some_and(|shown| shown.is_off(&now));
        if is_off(&held.served) {
            held.shafts.drop_table();
            held.served = None;
        }
        let is_of_others =
            held.shafts.building().is_some_and(|inputs| {
                let layers = self.shaft_layers(cell);
                inputs.layers.len() != layers.len()
                    || inputs.layers.iter().zip(&layers).any(|(a, b)| {
                        cloud_shadows_key(a.features) != cloud_shadows_key(b.features)
                    })
            });
        if is_off(&held.shown) || is_of_others {
            held.drop_build();
        }
    }

    /// The air of a cell is lit otherwise from now on: who sees it gets a frame, and exposure follows it.
    fn lit_otherwise(&mut self, id: CellId, progress: &mut ShaftProgress) {
        progress.changed.push(id);
        let cell = self.active_cells.get_mut(&id);
        if let Some(meter) = cell.and_then(|cell| cell.meter.as_mut()) {
            meter.due = true;
        }
    }

    /// The layers that throw shadow, as a cell's rays see them.
    fn shaft_layers(&self, cell: &ActiveCell) -> Vec<ShaftLayer> {
        self.active
            .iter()
            .map(|active| {
                let layer = &self.scene.layers()[active.scene_index];
                ShaftLayer {
                    base_altitude_m: layer.base_altitude_m(),
                    top_altitude_m: layer.top_altitude_m(),
                    features: layer_features(&self.scene, active.scene_index, &cell.settings),
                }
            })
            .collect()
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
        let seat = self.seat(cell);
        let indices = || self.active.iter().map(|active| active.scene_index);
        let now = Shown {
            seat,
            clouds: indices()
                .map(|index| self.scene.layers()[index].clone())
                .collect(),
            drifts: indices().map(|index| self.drifts[index]).collect(),
            epoch: self.field_epoch,
            exact: cell.settings.exact_interpolation,
            air: air.clone(),
        };
        if held.shown.as_ref().is_some_and(|last| !last.differs(&now)) {
            return;
        }
        let inputs = ShaftInputs {
            sun: seat.sun,
            origin: seat.origin_m,
            altitude_m: seat.altitude_m,
            zenith: (seat.origin_m + DVec3::Y * seat.planet_radius_m).normalize_or(DVec3::Y),
            air_top_m: air.medium.top_m,
            layers: self.shaft_layers(cell),
        };
        if !inputs
            .pipelines()
            .all(|key| self.pipelines.get(key).is_some())
        {
            // Nothing to make it with: tried again at the next turn.
            held.shown = None;
            return;
        }
        held.shafts.begin(inputs);
        held.shown = Some(now);
    }

    /// Makes a part of what is being made; returns the evaluations that were submitted.
    fn advance_light_shafts(
        &mut self,
        id: CellId,
        held: &mut Held,
        evaluations_max: u64,
        progress: &mut ShaftProgress,
    ) -> u64 {
        let (Some(cell), Some(inputs)) = (self.active_cells.get(&id), held.shafts.building())
        else {
            return 0;
        };
        // Place and sun are those of its beginning, as in the parts that are there.
        let air = self.air_views.base_group(
            &self.gpu,
            &self.pipelines,
            held.shafts.air(),
            inputs.altitude_m,
            inputs.sun.dot(inputs.zenith),
        );
        let Some(air) = air else {
            held.drop_build();
            return 0;
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
        self.shafts.last = Some(id);
        progress.evaluations += evaluations;
        if is_whole {
            self.shafts.tables += 1;
            held.served.clone_from(&held.shown);
            self.lit_otherwise(id, progress);
        } else if !held.shafts.is_building() {
            held.drop_build();
        }
        evaluations
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

    const VIEWER: ViewerId = ViewerId(1);

    fn scene(light_shafts: bool, elevation_deg: f64) -> Arc<Scene> {
        let document = json!({"version": 1, "sun": {"elevation_deg": elevation_deg},
            "wind": {"speed_m_per_s": 5},
            "layers": [{"density": {"model": "homogeneous"}}],
            "atmosphere": {"model": "physical", "light_shafts": light_shafts}});
        Arc::new(Scene::from_json(&document).expect("a scene"))
    }

    fn renderer() -> SkyRenderer {
        renderer_of(scene(true, 40.0))
    }

    fn renderer_of(scene: Arc<Scene>) -> SkyRenderer {
        let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
        let config = RenderConfig::new(PathBuf::from(noise));
        let gpu = Gpu::open_blocking().expect("a device");
        let mut renderer = SkyRenderer::new(gpu, config, scene, 1, &[]).expect("a renderer");
        join(&mut renderer, VIEWER, 0.0);
        renderer
    }

    fn join(renderer: &mut SkyRenderer, viewer: ViewerId, east_m: f64) {
        renderer.join(
            viewer,
            ViewRequest {
                size: FrameSize::new(64, 36).expect("a size"),
                fps: 1.0,
                codec: Codec::Png,
                jpeg_quality: 100,
                camera: Camera::new([east_m, 2.0, 0.0], 0.0, 25.0, 60.0).expect("a camera"),
                renderer: RendererKind::Cached,
                quality: None,
                show: Show::Picture,
                stereo: None,
                haze: true,
                linear: false,
            },
        );
        renderer.refresh_cells();
    }

    fn cell_of(renderer: &SkyRenderer) -> CellId {
        *renderer.active_cells.keys().next().expect("a cell")
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
        let id = cell_of(&renderer);
        assert!(renderer.served_shafts(id).is_some());
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
        assert_eq!(renderer.shafts.bytes(), 0);
        renderer.refresh_cells();
        assert_eq!(made(&mut renderer), (vec![], 0));
        assert!(renderer.shaft_reader(id).is_none());
    }

    #[test]
    fn a_table_that_is_too_wrong_is_not_read_and_nothing_outlives_its_cell() {
        let mut renderer = renderer();
        let (_, tables) = made(&mut renderer);
        let id = cell_of(&renderer);
        assert!(tables == 1 && renderer.served_shafts(id).is_some());
        // The lowest cloud is at 1.5 km.
        for (east_m, is_read) in [(300.0, true), (100.0, false), (-400.0, true)] {
            let cell = renderer.active_cells.get_mut(&id).expect("a cell");
            cell.reference_m.x += east_m;
            assert_eq!(renderer.served_shafts(id).is_some(), is_read, "{east_m}");
        }
        // The sun by 1.9°, then by 2.1°: at once, before anything is made.
        renderer.set_scene(scene(true, 41.9), 2).expect("a scene");
        assert!(renderer.served_shafts(id).is_some());
        renderer.set_scene(scene(true, 42.1), 3).expect("a scene");
        assert!(renderer.served_shafts(id).is_none());
        renderer.refresh_cells();
        let first = renderer.update_light_shafts(8);
        assert_eq!(first.changed, [id]);
        // With nothing to read, the whole of what a turn may take.
        assert!(first.evaluations > 8 * EVALUATIONS_PER_TILE / 2);
        let (turns, tables) = made(&mut renderer);
        let whole = first.evaluations + turns.iter().sum::<u64>();
        assert!(tables == 1 && renderer.served_shafts(id).is_some());
        // Another frame: neither the table stays nor what is made of the next one.
        renderer.set_scene(scene(true, 42.6), 4).expect("a scene");
        renderer.refresh_cells();
        assert!(renderer.update_light_shafts(8).is_pending);
        let radius_m = renderer.scene.planet().radius_m();
        let cell = renderer.active_cells.get_mut(&id).expect("a cell");
        cell.frame = CellFrame::at(DVec3::X * 10.0, radius_m);
        assert!(renderer.served_shafts(id).is_none());
        renderer.refresh_cells();
        let (turns, tables) = made(&mut renderer);
        assert_eq!((turns.iter().sum::<u64>(), tables), (whole, 1));
        // Who comes back to an empty cell finds nothing.
        renderer.leave(VIEWER);
        assert_eq!(renderer.shafts.bytes(), 0);
        join(&mut renderer, VIEWER, 0.0);
        assert!(renderer.served_shafts(cell_of(&renderer)).is_none());
    }

    #[test]
    fn other_maps_or_grids_make_a_table_anew_and_exposure_follows_it() {
        let grid = |file: &str| {
            let document = json!({"version": 1, "tone": {"auto_exposure": {}},
                "layers": [{"density": {"model": "grid", "file": file, "dimensions": [2, 2, 2],
                    "bounds_min_m": [-1000, 1500, -1000], "bounds_max_m": [1000, 2500, 1000]}}],
                "atmosphere": {"model": "physical", "light_shafts": true}});
            Arc::new(Scene::from_json(&document).expect("a scene"))
        };
        let mut renderer = renderer_of(grid("a.f32"));
        let is_due = |renderer: &SkyRenderer| {
            let meter = renderer.active_cells.values().next().expect("a cell");
            meter.meter.as_ref().is_some_and(|meter| meter.due)
        };
        // Metered before the table is there.
        renderer.adapt_exposures(std::time::Instant::now(), 0.0);
        assert!(!is_due(&renderer));
        assert_eq!(made(&mut renderer).1, 1);
        assert!(is_due(&renderer));
        let epoch = renderer.field_epoch;
        renderer.set_scene(grid("a.f32"), 2).expect("a scene");
        renderer.refresh_cells();
        assert_eq!(renderer.field_epoch, epoch);
        assert_eq!(made(&mut renderer), (vec![], 0));
        renderer.set_scene(grid("b.f32"), 3).expect("a scene");
        assert_eq!(renderer.field_epoch, epoch + 1);
        renderer.refresh_cells();
        assert_eq!(made(&mut renderer).1, 1);
        // The layers are the same, what fills them is not.
        renderer.field_epoch += 1;
        assert_eq!(made(&mut renderer).1, 1);
    }

    #[test]
    fn cells_share_what_a_turn_may_take_and_those_with_shafts_keep_them() {
        let ids =
            |numbers: &[u32]| -> Vec<CellId> { numbers.iter().copied().map(CellId).collect() };
        let of = |active: &[u32], held: &[u32], last: Option<u32>| {
            let held = ids(held);
            chosen(
                ids(active).into_iter(),
                |id| held.contains(&id),
                last.map(CellId),
            )
        };
        assert_eq!(of(&[1, 2, 3, 4, 5, 6], &[], None), ids(&[1, 2, 3, 4]));
        let held = [3, 4, 5, 6];
        assert_eq!(of(&[1, 2, 3, 4, 5, 6], &held, None), ids(&held));
        assert_eq!(of(&[1, 2, 4, 6], &held, Some(4)), ids(&[6, 1, 2, 4]));
        assert_eq!(of(&[1, 2], &held, Some(2)), ids(&[1, 2]));

        let mut renderer = renderer();
        join(&mut renderer, ViewerId(2), 200_000.0);
        assert_eq!(renderer.active_cells.len(), 2);
        let (turns, tables) = made(&mut renderer);
        assert_eq!(tables, 2);
        let most = 8 * EVALUATIONS_PER_TILE;
        assert!(turns.iter().all(|turn| *turn <= most), "{turns:?}");
        // What a turn may take is less than the smallest part: cells take turns.
        renderer.field_epoch += 1;
        let mut last = Vec::new();
        for _ in 0..4 {
            renderer.update_light_shafts(1);
            last.extend(renderer.shafts.last);
        }
        assert!(last[0] != last[1] && last[..2] == last[2..], "{last:?}");
    }
}
