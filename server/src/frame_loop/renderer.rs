//! Everything that the render thread holds, and one step of it: requests, updates, composites. It decides nothing about
//! time; [`super::pacing`] does.

use super::interface::{FinishedFrame, FrameSink, RenderStats, ViewRequest};
use super::screen_space::ScreenSpaceJob;
use crate::cache::{
    BYTES_PER_TEXEL, Caches, ProxySphere, SphereId, TEXELS_PER_TILE, TileRequest, TileUpdate,
    coarse_tiles, requested_tiles,
};
use crate::cells::Cells;
use crate::clock::unix_now_us;
use crate::composite::{
    CompositeInputs, Picture, composite_key, ground_key, view_frustum, view_uniform,
};
use crate::config::{FrameFilter, PlacedCell, RenderConfig};
use crate::field::FieldStore;
use crate::gpu::{
    FieldTextures, Gpu, GpuError, PipelineKey, Pipelines, ReadbackRing, TimedPass, TimingRing,
};
use crate::march::{
    ActiveLayer, Atlas, BATCH_TILES_MAX, CellBuffers, CellFrame, MarchSettings, MarchedPixels,
    PixelStrip, SkyLight, TexelGroup, TexelMarch, active_layers, layer_features, pixels_key,
    scene_uniform, sky_light, texels_key,
};
use glam::DVec3;
use skycell_protocol::scene::DensityModel;
use skycell_protocol::{
    Camera, CellId, FrameSequence, InputSequence, RendererKind, Scene, ViewerId,
};
use skycell_shaders::{Features, layout};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Pictures of a viewer that may be on their way back from the device or wait to be encoded.
const READBACKS_PER_VIEWER: usize = 3;
/// Beyond this distance between anchor and reference the cache's texels no longer have even sizes for the viewers.
const ANCHOR_DRIFT_MAX_M: f64 = 4_000.0;

/// Under wind tiles move past the viewers; what they need is looked up this often. At 50 m/s that is 2.5 m.
const REQUESTS_INTERVAL: Duration = Duration::from_millis(50);

/// Where a layer's addresses are centred: follows the layer's wind.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    at_start_m: DVec3,
    drift_at_start_m: DVec3,
}

/// A cell with members, on the device.
struct ActiveCell {
    frame: CellFrame,
    reference_m: DVec3,
    anchors: Vec<Anchor>,
    coarse: Vec<Vec<TileRequest>>,
    buffers: CellBuffers,
    /// When its caches began.
    begun: Instant,
    /// Requests or reference have changed since the caches were told.
    requests_changed: bool,
    /// When the tiles were last looked up for where the wind has carried them.
    looked_up: Instant,
}

/// A viewer on the device.
pub(super) struct ActiveViewer {
    pub(super) view: ViewRequest,
    pub(super) input: InputSequence,
    pub(super) cell: CellId,
    /// Which renderer makes its frames: the one that it asks for, or rays of its own where the cache does not reach.
    pub(super) kind: RendererKind,
    requests: Vec<Vec<TileRequest>>,
    picture: Picture,
    ring: ReadbackRing,
    pub(super) screen_space: Option<ScreenSpaceJob>,
    pub(super) sequence: u32,
    pub(super) acknowledged: u32,
    pub(super) frames_composited: u64,
}

/// Sums since the start.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) ticks: u64,
    pub(super) submissions: u64,
    pub(super) dispatches: u64,
    pub(super) tiles_updated: u64,
    pub(super) frames_composited: u64,
    pub(super) screen_space_marches: u64,
    frames_read_back: Arc<AtomicU64>,
}

/// The render thread's state.
pub(super) struct SkyRenderer {
    pub(super) gpu: Gpu,
    pub(super) pipelines: Pipelines,
    pub(super) timing: TimingRing,
    field: FieldTextures,
    atlas: Atlas,
    texel_march: TexelMarch,
    pub(super) caches: Caches,
    pub(super) cells: Cells,
    pub(super) config: RenderConfig,
    /// As configured, or as suits the adapter.
    pub(super) frame_filter: FrameFilter,
    pub(super) mip_bias: f64,
    pub(super) march_steps: u32,
    pub(super) scene: Arc<Scene>,
    pub(super) scene_revision: u64,
    pub(super) active: Vec<ActiveLayer>,
    light: SkyLight,
    drifts: Vec<DVec3>,
    active_cells: BTreeMap<CellId, ActiveCell>,
    pub(super) viewers: BTreeMap<ViewerId, ActiveViewer>,
    pub(super) counters: Counters,
    /// Submissions that the device has not finished.
    in_flight: Arc<AtomicU32>,
}

impl SkyRenderer {
    pub(super) fn new(
        gpu: Gpu,
        config: RenderConfig,
        scene: Arc<Scene>,
        scene_revision: u64,
        placed: &[PlacedCell],
    ) -> Result<Self, GpuError> {
        let pipelines = Pipelines::new(&gpu);
        let store = FieldStore::new(Some(config.noise_cache_dir.clone()));
        let field = FieldTextures::new(&gpu, &pipelines.field_layout, store);
        let tile_bytes = TEXELS_PER_TILE * BYTES_PER_TEXEL;
        let tiles_max = (u64::from(config.cache_memory_mib) << 20) / tile_bytes;
        let tiles_max = tiles_max.clamp(32, u64::from(Atlas::tiles_max(&gpu))) as u32;
        let mut renderer = Self {
            atlas: Atlas::new(&gpu),
            texel_march: TexelMarch::new(&gpu),
            timing: TimingRing::new(&gpu),
            caches: Caches::new(tiles_max, config.samples),
            cells: Cells::new(placed),
            light: sky_light(&scene, 0.0),
            scene: scene.clone(),
            scene_revision,
            active: Vec::new(),
            drifts: Vec::new(),
            active_cells: BTreeMap::new(),
            viewers: BTreeMap::new(),
            counters: Counters::default(),
            in_flight: Arc::default(),
            frame_filter: config.frame_filter.unwrap_or(if gpu.is_software() {
                FrameFilter::Bilinear
            } else {
                FrameFilter::CatmullRom
            }),
            mip_bias: config
                .mip_bias
                .map_or(if gpu.is_software() { 1.0 } else { 0.0 }, f64::from),
            march_steps: config
                .march_steps
                .unwrap_or(if gpu.is_software() { 64 } else { 128 }),
            gpu,
            pipelines,
            field,
            config,
        };
        renderer.set_scene(scene, scene_revision)?;
        Ok(renderer)
    }

    /// Takes a new scene over. What only colours the sky marches nothing; what changes light or density in the clouds
    /// ages every texel; what changes where layers are starts their caches anew.
    pub(super) fn set_scene(&mut self, scene: Arc<Scene>, revision: u64) -> Result<(), GpuError> {
        let active = active_layers(&scene);
        let mut keys = Vec::new();
        for screen_space in [false, true] {
            let key = composite_key(self.frame_filter, active.len(), screen_space, false);
            keys.extend([key, ground_key(key)]);
        }
        for layer in &active {
            let features = layer_features(&scene, layer.scene_index);
            keys.extend([texels_key(features), pixels_key(features)]);
        }
        for key in keys {
            self.pipelines.prepare(&self.gpu, key)?;
        }
        for (place, layer) in (0..).zip(&active) {
            if let DensityModel::Weather(weather) = scene.layers()[layer.scene_index].density() {
                self.field.set_map(&self.gpu, place, weather);
            }
        }
        let cloud_altitude_m = active.first().map_or(0.0, |layer| layer.proxy_altitude_m);
        let old = std::mem::replace(&mut self.scene, scene);
        self.scene_revision = revision;
        self.light = sky_light(&self.scene, cloud_altitude_m);
        self.drifts.resize(self.scene.layers().len(), DVec3::ZERO);
        let moved =
            old.planet().radius_m() != self.scene.planet().radius_m() || active != self.active;
        self.active = active;
        if moved {
            let ids: Vec<CellId> = self.active_cells.keys().copied().collect();
            for id in ids {
                self.restart_cell(id);
            }
        } else if marches_differ(&old, &self.scene) {
            self.caches.age_all();
        }
        let views: Vec<(ViewerId, ViewRequest)> =
            self.viewers.iter().map(|(id, v)| (*id, v.view)).collect();
        for (id, view) in views {
            self.choose_renderer(id, &view);
            if let Some(viewer) = self.viewers.get_mut(&id) {
                viewer.screen_space = None;
            }
        }
        self.touch_all_requests();
        Ok(())
    }

    /// Runs every pipeline once: a driver may compile at the first dispatch, which must not be a viewer's frame.
    pub(super) fn warm_up(&mut self) -> Result<(), GpuError> {
        use skycell_protocol::Codec;
        let viewer = ViewerId(u32::MAX);
        let size = skycell_protocol::FrameSize::new(8, 8)
            .map_err(|error| GpuError::Device(error.to_string()))?;
        for renderer in [RendererKind::Cached, RendererKind::ScreenSpace] {
            let camera = Camera::default();
            self.join(
                viewer,
                ViewRequest {
                    size,
                    fps: 1.0,
                    codec: Codec::Png,
                    jpeg_quality: 100,
                    camera,
                    renderer,
                },
            );
            self.refresh_cells();
            self.march(1);
            if renderer == RendererKind::ScreenSpace {
                self.march_screen_space(viewer, 1);
            }
            self.refresh_cells();
            let key = composite_key(
                self.frame_filter,
                self.active.len(),
                renderer == RendererKind::ScreenSpace,
                false,
            );
            let picture = Picture::new(&self.gpu, &self.pipelines, size, false);
            self.composite_still(viewer, &picture, key)?;
            self.leave(viewer);
        }
        self.gpu.wait()?;
        self.counters = Counters::default();
        self.timing = TimingRing::new(&self.gpu);
        Ok(())
    }

    /// Wind carries the layers for a while.
    pub(super) fn advance_time(&mut self, seconds: f64) {
        for (index, drift) in self.drifts.iter_mut().enumerate() {
            *drift += self.scene.layer_wind(index).velocity_m_per_s() * seconds;
        }
    }

    /// Fastest wind of a layer that is shown, m/s.
    pub(super) fn wind_speed_max_m_per_s(&self) -> f64 {
        self.active
            .iter()
            .map(|layer| self.scene.layer_wind(layer.scene_index).speed_m_per_s())
            .fold(0.0, f64::max)
    }

    fn new_active_cell(&self, reference_m: DVec3) -> ActiveCell {
        let anchors = self
            .active
            .iter()
            .map(|layer| Anchor {
                at_start_m: reference_m,
                drift_at_start_m: self.drifts[layer.scene_index],
            })
            .collect();
        ActiveCell {
            frame: CellFrame::at(reference_m, self.scene.planet().radius_m()),
            reference_m,
            anchors,
            coarse: Vec::new(),
            buffers: CellBuffers::new(&self.gpu, &self.pipelines, &self.field.bind_group),
            begun: Instant::now(),
            requests_changed: true,
            looked_up: Instant::now(),
        }
    }

    fn restart_cell(&mut self, id: CellId) {
        self.caches.remove_cell(id);
        if let Some(cell) = self.active_cells.get(&id) {
            let reference_m = cell.reference_m;
            let fresh = self.new_active_cell(reference_m);
            self.active_cells.insert(id, fresh);
        }
    }

    fn touch_all_requests(&mut self) {
        for cell in self.active_cells.values_mut() {
            cell.requests_changed = true;
        }
    }

    /// Puts a viewer where its camera is; cells without members end and free their memory.
    fn place(&mut self, viewer: ViewerId, camera: &Camera) -> CellId {
        let id = self
            .cells
            .assign(viewer, DVec3::from_array(camera.position_m()));
        let reference_m = self
            .cells
            .get(id)
            .map_or(DVec3::ZERO, |cell| cell.reference_m);
        match self.active_cells.get_mut(&id) {
            Some(cell) if cell.reference_m != reference_m => {
                cell.reference_m = reference_m;
                cell.coarse.clear();
                cell.requests_changed = true;
            }
            Some(_) => {}
            None => {
                let cell = self.new_active_cell(reference_m);
                self.active_cells.insert(id, cell);
            }
        }
        self.end_empty_cells();
        id
    }

    fn end_empty_cells(&mut self) {
        let ended: Vec<CellId> = self
            .active_cells
            .keys()
            .filter(|id| {
                self.cells
                    .get(**id)
                    .is_none_or(|cell| cell.members.is_empty())
            })
            .copied()
            .collect();
        for id in ended {
            self.active_cells.remove(&id);
            self.caches.remove_cell(id);
        }
        self.atlas.fit(&self.gpu, self.caches.slots_needed());
    }

    pub(super) fn join(&mut self, id: ViewerId, view: ViewRequest) {
        let cell = self.place(id, &view.camera);
        let bytes = u64::from(view.size.pixels()) * 4;
        let viewer = ActiveViewer {
            kind: self.kind_of(&view),
            view,
            input: InputSequence(0),
            cell,
            requests: Vec::new(),
            picture: Picture::new(&self.gpu, &self.pipelines, view.size, false),
            ring: ReadbackRing::new(bytes, READBACKS_PER_VIEWER),
            screen_space: None,
            sequence: 0,
            acknowledged: 0,
            frames_composited: 0,
        };
        self.viewers.insert(id, viewer);
        self.change_requests(cell);
    }

    /// The renderer for a view. Proxy spheres are marched and blended from below: a viewer in or above a layer gets rays
    /// of its own.
    fn kind_of(&self, view: &ViewRequest) -> RendererKind {
        let altitude_m = view.camera.position_m()[1];
        let below_all = self
            .active
            .iter()
            .all(|layer| altitude_m < self.scene.layers()[layer.scene_index].base_altitude_m());
        if below_all {
            view.renderer
        } else {
            RendererKind::ScreenSpace
        }
    }

    fn choose_renderer(&mut self, id: ViewerId, view: &ViewRequest) {
        let kind = self.kind_of(view);
        if let Some(viewer) = self.viewers.get_mut(&id)
            && viewer.kind != kind
        {
            viewer.kind = kind;
            viewer.screen_space = None;
            viewer.requests.clear();
        }
    }

    fn change_requests(&mut self, cell: CellId) {
        if let Some(cell) = self.active_cells.get_mut(&cell) {
            cell.requests_changed = true;
        }
    }

    pub(super) fn set_camera(&mut self, id: ViewerId, input: InputSequence, camera: Camera) {
        let Some(viewer) = self.viewers.get_mut(&id) else {
            return;
        };
        let moved = viewer.view.camera.position_m() != camera.position_m();
        viewer.view.camera = camera;
        viewer.input = input;
        viewer.requests.clear();
        let (mut cell, view) = (viewer.cell, viewer.view);
        self.choose_renderer(id, &view);
        if moved {
            let old = cell;
            cell = self.place(id, &camera);
            if let Some(viewer) = self.viewers.get_mut(&id) {
                viewer.cell = cell;
            }
            self.change_requests(old);
        }
        self.change_requests(cell);
    }

    pub(super) fn set_view(&mut self, id: ViewerId, view: ViewRequest) {
        let Some(viewer) = self.viewers.get_mut(&id) else {
            return;
        };
        if viewer.view.size != view.size {
            let bytes = u64::from(view.size.pixels()) * 4;
            viewer.picture = Picture::new(&self.gpu, &self.pipelines, view.size, false);
            viewer.ring = ReadbackRing::new(bytes, READBACKS_PER_VIEWER);
        }
        viewer.screen_space = None;
        let input = viewer.input;
        viewer.view = view;
        self.set_camera(id, input, view.camera);
    }

    pub(super) fn leave(&mut self, id: ViewerId) {
        self.viewers.remove(&id);
        let cell = self.cells.cell_of(id);
        self.cells.remove(id);
        if let Some(cell) = cell {
            self.change_requests(cell);
        }
        self.end_empty_cells();
    }

    fn anchor_m(&self, cell: &ActiveCell, layer: usize) -> DVec3 {
        let anchor = cell.anchors[layer];
        let drift = self.drifts[self.active[layer].scene_index] - anchor.drift_at_start_m;
        cell.frame.from_world(anchor.at_start_m + drift)
    }

    /// Reference point of a sphere in the frame that drifts with its layer.
    fn drifting_reference(&self, sphere: SphereId) -> Option<DVec3> {
        let cell = self.active_cells.get(&sphere.cell)?;
        let layer = self.active.get(sphere.layer as usize)?;
        Some(cell.reference_m - self.drifts[layer.scene_index])
    }

    /// Brings everything that the caches and the device know of cells up to the present: anchors that have drifted,
    /// requests of viewers that have turned, new page tables.
    pub(super) fn refresh_cells(&mut self) {
        let ids: Vec<CellId> = self.active_cells.keys().copied().collect();
        let windy = self.wind_speed_max_m_per_s() > 0.0;
        for id in ids {
            let drifted_away = self.active_cells.get(&id).is_some_and(|cell| {
                (0..self.active.len()).any(|layer| {
                    let anchor = self.anchor_m(cell, layer);
                    let reference = cell.frame.from_world(cell.reference_m);
                    (anchor - reference).with_y(0.0).length() > ANCHOR_DRIFT_MAX_M
                })
            });
            if drifted_away {
                self.restart_cell(id);
            }
            let Some(mut cell) = self.active_cells.remove(&id) else {
                continue;
            };
            self.refresh_cell(id, &mut cell, windy);
            self.active_cells.insert(id, cell);
        }
    }

    fn refresh_cell(&mut self, id: CellId, cell: &mut ActiveCell, windy: bool) {
        let anchors: Vec<DVec3> = (0..self.active.len())
            .map(|layer| self.anchor_m(cell, layer))
            .collect();
        let uniform = scene_uniform(
            &self.scene,
            &self.active,
            &self.light,
            MarchSettings {
                steps: self.march_steps,
            },
            &cell.frame,
            &self.drifts,
            &anchors,
        );
        cell.buffers.set_scene(&self.gpu, &uniform);
        let drifted = windy && cell.looked_up.elapsed() >= REQUESTS_INTERVAL;
        if cell.requests_changed || drifted {
            cell.looked_up = Instant::now();
            let eye = cell.frame.from_world(cell.reference_m);
            cell.buffers.set_reference(&self.gpu, eye);
            let spheres: Vec<ProxySphere> = self
                .active
                .iter()
                .zip(&anchors)
                .map(|(layer, anchor)| ProxySphere {
                    frame: cell.frame,
                    anchor: *anchor,
                    altitude_m: layer.proxy_altitude_m,
                })
                .collect();
            if drifted || cell.coarse.len() != spheres.len() {
                cell.coarse = spheres.iter().map(|s| coarse_tiles(s, eye)).collect();
            }
            for viewer in self.viewers.values_mut().filter(|v| v.cell == id) {
                if viewer.kind == RendererKind::ScreenSpace {
                    continue;
                }
                if drifted || viewer.requests.len() != spheres.len() {
                    let frustum = view_frustum(&viewer.view.camera, viewer.view.size, &cell.frame);
                    viewer.requests = spheres
                        .iter()
                        .map(|s| requested_tiles(&frustum, s, self.mip_bias))
                        .collect();
                }
            }
            let cached_viewers = || {
                self.viewers
                    .values()
                    .filter(move |v| v.cell == id && v.kind == RendererKind::Cached)
            };
            // Nobody who reads the cache: nobody who needs its coarse level.
            let used = cached_viewers().next().is_some();
            for (layer, coarse) in cell.coarse.iter().enumerate() {
                let requests = cached_viewers()
                    .filter_map(|v| v.requests.get(layer))
                    .flatten();
                let sphere = self.caches.sphere_mut(SphereId {
                    cell: id,
                    layer: layer as u32,
                });
                sphere.set_wanted(if used { coarse } else { &[] }, requests);
            }
            cell.requests_changed = false;
        }
        let changed = (0..self.active.len() as u32).any(|layer| {
            self.caches
                .sphere_mut(SphereId { cell: id, layer })
                .take_tables_changed()
        });
        if changed {
            let tables: Vec<_> = (0..self.active.len() as u32)
                .map(|layer| {
                    self.caches
                        .sphere_mut(SphereId { cell: id, layer })
                        .page_tables()
                })
                .collect();
            cell.buffers.set_tables(&self.gpu, &tables);
        }
    }

    /// Marches at most `tiles_max` tiles and returns what was marched. The tiles are shown from the next refresh on.
    pub(super) fn march(&mut self, tiles_max: usize) -> Vec<TileUpdate> {
        let references: BTreeMap<SphereId, DVec3> = self
            .active_cells
            .keys()
            .flat_map(|cell| {
                (0..self.active.len() as u32).map(|layer| SphereId { cell: *cell, layer })
            })
            .filter_map(|sphere| Some((sphere, self.drifting_reference(sphere)?)))
            .collect();
        let updates = self.caches.plan(tiles_max.min(BATCH_TILES_MAX), |sphere| {
            references.get(&sphere).copied()
        });
        if updates.is_empty() {
            return updates;
        }
        self.atlas.fit(&self.gpu, self.caches.slots_needed());
        let mut by_sphere: BTreeMap<SphereId, Vec<TileUpdate>> = BTreeMap::new();
        for update in &updates {
            by_sphere.entry(update.sphere).or_default().push(*update);
        }
        let groups: Vec<TexelGroup<'_>> = by_sphere
            .into_iter()
            .filter_map(|(sphere, updates)| {
                let scene_index = self.active.get(sphere.layer as usize)?.scene_index;
                Some(TexelGroup {
                    cell: &self.active_cells.get(&sphere.cell)?.buffers,
                    features: layer_features(&self.scene, scene_index),
                    layer: sphere.layer,
                    updates,
                })
            })
            .collect();
        self.timing.begin();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("march texels"),
            });
        self.counters.dispatches += self.texel_march.record(
            &self.gpu,
            &mut encoder,
            &mut self.timing,
            &self.pipelines,
            &self.atlas,
            &groups,
        );
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
        self.counters.tiles_updated += updates.len() as u64;
        updates
    }

    fn submit(&mut self, encoder: wgpu::CommandEncoder) {
        self.counters.submissions += 1;
        self.gpu.queue.submit([encoder.finish()]);
        self.watch_submission();
    }

    /// Counts what was just submitted as under way until the device is done with it.
    pub(super) fn watch_submission(&self) {
        self.in_flight.fetch_add(1, Ordering::AcqRel);
        let in_flight = self.in_flight.clone();
        self.gpu.queue.on_submitted_work_done(move || {
            in_flight.fetch_sub(1, Ordering::AcqRel);
        });
    }

    /// Submissions that the device has not finished.
    pub(super) fn in_flight(&self) -> u32 {
        self.in_flight.load(Ordering::Acquire)
    }

    /// How long a viewer's cell has had its caches.
    pub(super) fn cell_age(&self, viewer: &ActiveViewer) -> Duration {
        self.active_cells
            .get(&viewer.cell)
            .map_or(Duration::ZERO, |cell| cell.begun.elapsed())
    }

    /// Whether the coarse level of a viewer's cell shows the present sky.
    pub(super) fn coarse_is_ready(&self, viewer: &ActiveViewer) -> bool {
        self.active_cells.get(&viewer.cell).is_some_and(|cell| {
            cell.coarse.len() == self.active.len()
                && cell.coarse.iter().enumerate().all(|(layer, tiles)| {
                    let id = SphereId {
                        cell: viewer.cell,
                        layer: layer as u32,
                    };
                    self.caches
                        .sphere(id)
                        .is_some_and(|s| tiles.iter().all(|t| s.shows_present(&t.key)))
                })
        })
    }

    /// Whether some tile that a viewer asks for does not show the present sky yet.
    fn is_coarse(&self, viewer: &ActiveViewer) -> bool {
        viewer.requests.iter().enumerate().any(|(layer, tiles)| {
            let id = SphereId {
                cell: viewer.cell,
                layer: layer as u32,
            };
            self.caches
                .sphere(id)
                .is_none_or(|s| tiles.iter().any(|t| !s.shows_present(&t.key)))
        })
    }

    /// The view of a viewer as the shaders read it, with the tables of its cell.
    pub(super) fn view_of(&self, viewer: &ActiveViewer) -> Option<layout::View> {
        let cell = self.active_cells.get(&viewer.cell)?;
        let frustum = view_frustum(&viewer.view.camera, viewer.view.size, &cell.frame);
        let mut view = view_uniform(&frustum, &cell.frame, viewer.view.size);
        for (layer, requests) in viewer.requests.iter().enumerate().take(view.tables.len()) {
            let finest = requests.iter().map(|r| r.key.level).max().unwrap_or(0);
            view.tables[layer] = cell.buffers.table(layer, finest);
        }
        Some(view)
    }

    /// Submits rows of a viewer's marched pixels; false when its cell is gone.
    pub(super) fn submit_pixels(
        &mut self,
        cell: CellId,
        marched: &MarchedPixels,
        features: Features,
        view: &layout::View,
        rows: u32,
    ) -> bool {
        let Some(cell) = self.active_cells.get(&cell) else {
            return false;
        };
        marched.submit_strip(
            &self.gpu,
            &mut self.timing,
            &self.pipelines,
            &PixelStrip {
                cell: &cell.buffers,
                features,
                view,
                rows,
            },
        );
        true
    }

    /// Composites a frame for each of the viewers that has a buffer free, in one submission, and has it read back into
    /// the sink. Returns whose frames are under way.
    pub(super) fn composite(
        &mut self,
        ids: &[ViewerId],
        sink: &Arc<dyn FrameSink>,
    ) -> Vec<ViewerId> {
        self.timing.begin();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("composite"),
            });
        let mut under_way = Vec::new();
        for id in ids {
            let Some(mut viewer) = self.viewers.remove(id) else {
                continue;
            };
            if let Some(buffer) = viewer.ring.take(&self.gpu)
                && self.record_frame(&mut encoder, &viewer, &buffer).is_some()
            {
                under_way.push((*id, buffer));
            }
            self.viewers.insert(*id, viewer);
        }
        if under_way.is_empty() {
            return Vec::new();
        }
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
        let submitted_unix_us = unix_now_us();
        let mut shown_cells = Vec::new();
        let mut done = Vec::new();
        for (id, buffer) in under_way {
            let coarse = self.viewers.get(&id).is_some_and(|v| self.is_coarse(v));
            let Some(viewer) = self.viewers.get_mut(&id) else {
                continue;
            };
            viewer.sequence = viewer.sequence.wrapping_add(1);
            viewer.frames_composited += 1;
            self.counters.frames_composited += 1;
            let (view, input, cell) = (viewer.view, viewer.input, viewer.cell);
            let (sequence, scene_revision) = (FrameSequence(viewer.sequence), self.scene_revision);
            let (sink, read_back) = (sink.clone(), self.counters.frames_read_back.clone());
            viewer.ring.map(buffer, move |pixels| {
                // A lost device is reported where it is polled.
                let Some(pixels) = pixels else { return };
                read_back.fetch_add(1, Ordering::Relaxed);
                sink.deliver(FinishedFrame {
                    viewer: id,
                    sequence,
                    input,
                    scene_revision,
                    cell,
                    size: view.size,
                    codec: view.codec,
                    jpeg_quality: view.jpeg_quality,
                    coarse,
                    submitted_unix_us,
                    read_back: Instant::now(),
                    pixels: Box::new(pixels),
                });
            });
            if !shown_cells.contains(&cell) {
                shown_cells.push(cell);
            }
            done.push(id);
        }
        for cell in shown_cells {
            self.caches.frame_shown(cell);
        }
        done
    }

    fn record_frame(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        viewer: &ActiveViewer,
        target: &wgpu::Buffer,
    ) -> Option<()> {
        let view = self.view_of(viewer)?;
        let cell = self.active_cells.get_mut(&viewer.cell)?;
        let screen_space = viewer.kind == RendererKind::ScreenSpace;
        let (layers, view) = match (screen_space, &viewer.screen_space) {
            (true, Some(job)) => (job.marched().read_group().clone(), job.view()),
            (true, None) => return None,
            (false, _) => (
                cell.buffers
                    .cached_group(&self.gpu, &self.pipelines, &self.atlas)
                    .clone(),
                view,
            ),
        };
        viewer.picture.record(
            &self.gpu,
            encoder,
            &mut self.timing,
            &self.pipelines,
            &CompositeInputs {
                key: composite_key(self.frame_filter, self.active.len(), screen_space, false),
                scene: &cell.buffers.scene_group,
                layers: &layers,
                view: &view,
                planet_radius_m: self.scene.planet().radius_m(),
            },
        );
        self.counters.dispatches += 1;
        encoder.copy_buffer_to_buffer(viewer.picture.pixels(), 0, target, 0, target.size());
        Some(())
    }

    /// Composites one viewer's view into a picture of its own.
    pub(super) fn composite_still(
        &mut self,
        id: ViewerId,
        picture: &Picture,
        key: PipelineKey,
    ) -> Result<(), GpuError> {
        let gone = || GpuError::Device("the viewer of the picture is gone".into());
        let viewer = self.viewers.get(&id).ok_or_else(gone)?;
        let view = self.view_of(viewer).ok_or_else(gone)?;
        let cell = self.active_cells.get_mut(&viewer.cell).ok_or_else(gone)?;
        let (layers, view) = match &viewer.screen_space {
            Some(job) => (job.marched().read_group().clone(), job.view()),
            None => (
                cell.buffers
                    .cached_group(&self.gpu, &self.pipelines, &self.atlas)
                    .clone(),
                view,
            ),
        };
        self.timing.begin();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("still"),
            });
        picture.record(
            &self.gpu,
            &mut encoder,
            &mut self.timing,
            &self.pipelines,
            &CompositeInputs {
                key,
                scene: &cell.buffers.scene_group,
                layers: &layers,
                view: &view,
                planet_radius_m: self.scene.planet().radius_m(),
            },
        );
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
        Ok(())
    }

    /// Share of the wanted samples that the caches hold.
    pub(super) fn share_done(&self) -> f64 {
        let samples = self.caches.samples();
        let (mut wanted, mut pending) = (0, 0);
        for id in self.active_cells.keys() {
            for (_, sphere) in self.caches.spheres_of(*id) {
                let (_, unique) = sphere.requested_and_unique();
                wanted += unique * u64::from(samples) + sphere.coarse_only();
                pending += sphere.pending_samples(samples);
            }
        }
        1.0 - pending as f64 / (wanted as f64).max(1.0)
    }

    /// GPU time and units of a kind of pass.
    pub(super) fn gpu_time(&self, pass: TimedPass) -> (u64, u64) {
        self.timing.total(pass)
    }

    pub(super) fn frames_read_back(&self) -> u64 {
        self.counters.frames_read_back.load(Ordering::Relaxed)
    }

    pub(super) fn cache_bytes(&self) -> u64 {
        if self.caches.resident() == 0 {
            0
        } else {
            self.atlas.bytes()
        }
    }

    /// How far a cell's first anchor has drifted, and its reference.
    pub(super) fn cell_drift(&self, id: CellId) -> Option<(DVec3, DVec3)> {
        let cell = self.active_cells.get(&id)?;
        let drift = cell.anchors.first().map_or(DVec3::ZERO, |anchor| {
            self.drifts[self.active[0].scene_index] - anchor.drift_at_start_m
        });
        Some((drift, cell.reference_m))
    }

    pub(super) fn stats(&self, uptime_s: f64) -> RenderStats {
        super::stats::render_stats(self, uptime_s)
    }
}

impl ActiveViewer {
    /// Texels that the viewer requests.
    pub(super) fn texels_requested(&self) -> u64 {
        self.requests.iter().map(|r| r.len() as u64).sum::<u64>() * TEXELS_PER_TILE
    }

    /// Frames composited and not acknowledged.
    pub(super) fn frames_in_flight(&self) -> u32 {
        self.sequence.wrapping_sub(self.acknowledged)
    }
}

/// Whether what texels hold depends on what differs. The sun's colour, the exposure, the ground and the air do not: they
/// are applied where texels are shown.
fn marches_differ(old: &Scene, new: &Scene) -> bool {
    old.layers() != new.layers()
        || old.light() != new.light()
        || old.sun().direction() != new.sun().direction()
}
