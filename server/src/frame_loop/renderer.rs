//! Everything that the render thread holds, and how it takes a new scene over. What happens to view cells, viewers and on
//! the device stands in the files beside. It decides nothing about time; [`super::pacing`] does.

use super::auditing::Audit;
use super::awaited_scene::AwaitedScene;
use super::budgets::Losses;
use super::cells_on_device::ActiveCell;
use super::interface::{RenderStats, ViewRequest};
use super::light_shafts::CellShafts;
use super::qualities::Qualities;
use super::screen_space::WindowChoice;
use super::sky_steps::steps_between;
use super::sky_time::SkyTime;
use super::sun_volumes::{SunVolumes, asks_for_volume};
use super::transitions::TransitionCounters;
use super::viewers_on_device::ActiveViewer;
use crate::atmosphere::{AirKeeper, AirViews, cloud_shadows_key, make_shafts_key, table_keys};
use crate::cache::{BYTES_PER_TEXEL, Caches, TEXELS_PER_TILE, TexelSamples};
use crate::cells::{CellLimit, Cells};
use crate::clock;
use crate::composite::{
    Inspections, Mix, Picture, PictureFade, clouds_key, composite_key, fade_key, ground_key,
    with_parallax, with_shared_background,
};
use crate::config::{FrameFilter, PlacedCell, RenderConfig};
use crate::field::FieldStore;
use crate::gpu::{
    BlendStep, DeviceInventory, FieldTextures, Gpu, GpuError, PipelineKey, Pipelines, TimingRing,
    blend_key,
};
use crate::march::{
    ActiveLayer, Atlas, LayerBlend, MarchSettings, Proxy, ProxySettings, SkyLight, TexelMarch,
    WINDOW_FRAMES_MAX, active_layers, audit_key, drift_m_per_s, layer_features, pixels_key,
    placed_sheets, placed_weather, possible_frames, proxies_of, resample_key, resolve_key,
    sky_light, sun_angular_radius_rad, sun_columns_key, texels_key, window_key,
};
use glam::DVec3;
use skycell_protocol::{Camera, CellId, FrameSize, RendererKind, Scene, ViewerId};
use skycell_shaders::Features;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64};
use std::time::Instant;

/// A change of the scene that is no larger is one of those that time makes, and texels are mixed towards it.
const STEPS_OF_A_MOMENT_MAX: f64 = 1.0;

/// A proxy sphere stays where it is when a change of the scene would move it by less. Texels are marched for where it is, so
/// that it costs parallax alone, and less than a cloud is deep.
const PROXY_SHIFT_MAX_M: f64 = 20.0;

/// Sums since the start.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) ticks: u64,
    pub(super) submissions: u64,
    pub(super) dispatches: u64,
    pub(super) tiles_updated: u64,
    pub(super) tiles_resampled: u64,
    pub(super) texels_audited: u64,
    pub(super) frames_composited: u64,
    pub(super) first_frames_held: u64,
    pub(super) frames_held: u64,
    pub(super) screen_space_marches: u64,
    pub(super) transitions: TransitionCounters,
    pub(super) frames_read_back: Arc<AtomicU64>,
}

/// The render thread's state.
pub(super) struct SkyRenderer {
    pub(super) gpu: Gpu,
    pub(super) pipelines: Pipelines,
    pub(super) timing: TimingRing,
    pub(super) field: FieldTextures,
    /// Grows where maps or grids become others: what is made of them serves until it has been made anew.
    pub(super) field_epoch: u64,
    pub(super) atlas: Atlas,
    pub(super) texel_march: TexelMarch,
    pub(super) audit: Audit,
    pub(super) caches: Caches,
    pub(super) sun: SunVolumes,
    pub(super) cells: Cells,
    pub(super) config: RenderConfig,
    /// What is given up for want of memory or time.
    pub(super) losses: Losses,
    /// What is asked for, and what is picked.
    pub(super) qualities: Qualities,
    /// Of single pictures; viewers have their own.
    pub(super) frame_filter: FrameFilter,
    /// Of single pictures; viewers have their own.
    pub(super) mip_bias: f64,
    /// Of single pictures; viewers have their own.
    pub(super) parallax_steps: u32,
    /// Whether time passes from frame to frame: under wind, rays then start ahead of the reference. Not for single pictures.
    pub(super) is_living: bool,
    /// Whether viewers look for what texels show where the wind alone has moved it: with a software driver that costs more
    /// than it is worth.
    pub(super) wind_is_searched: bool,
    /// How rays are marched, but for what a quality sets.
    pub(super) settings: MarchSettings,
    /// How screen-space pictures come about.
    pub(super) window_choice: WindowChoice,
    /// The scene of the moment.
    pub(super) scene: Arc<Scene>,
    pub(super) scene_revision: u64,
    pub(super) sky_time: SkyTime,
    /// The scene that comes next.
    pub(super) awaited: Option<AwaitedScene>,
    pub(super) active: Vec<ActiveLayer>,
    /// What keeps them in the caches: as many of each layer, one layer after another.
    pub(super) proxies: Vec<Proxy>,
    /// How.
    pub(super) kept_on: ProxySettings,
    /// The layers with proxy spheres where they would be if the scene had always been so.
    pub(super) ideal_active: Vec<ActiveLayer>,
    pub(super) light: SkyLight,
    /// Tables of the scene's air, where it has such.
    pub(super) air: AirKeeper,
    pub(super) air_views: AirViews,
    /// Shadow of clouds in that air, where the scene has it.
    pub(super) shafts: CellShafts,
    pub(super) drifts: Vec<DVec3>,
    pub(super) active_cells: BTreeMap<CellId, ActiveCell>,
    pub(super) viewers: BTreeMap<ViewerId, ActiveViewer>,
    pub(super) counters: Counters,
    /// What passes of inspections are told; made when somebody first looks at one.
    pub(super) inspections: Option<Inspections>,
    /// Submissions that the device has not finished.
    pub(super) in_flight: Arc<AtomicU32>,
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
        let tiles_of = |memory_mib: u32| {
            let tiles = (u64::from(memory_mib) << 20) / tile_bytes;
            tiles.clamp(32, u64::from(Atlas::tiles_max(&gpu))) as u32
        };
        let mut caches = Caches::new(tiles_of(config.cache_memory_mib), 1);
        if let Some(memory_mib) = config.cell_memory_mib {
            caches.set_cell_tiles_max(tiles_of(memory_mib));
        }
        let qualities = Qualities::new(&config, gpu.is_software());
        let base = qualities.default_settings();
        caches.set_samples(TexelSamples::new(base.samples, base.samples_by_area));
        let mut renderer = Self {
            atlas: Atlas::new(&gpu),
            texel_march: TexelMarch::new(&gpu),
            audit: Audit::new(&gpu, &pipelines),
            timing: TimingRing::new(&gpu),
            caches,
            losses: Losses::default(),
            sun: SunVolumes::default(),
            cells: Cells::new(placed, CellLimit::default()),
            light: sky_light(&scene, None, 0.0),
            air: AirKeeper::new(sun_angular_radius_rad()),
            air_views: AirViews::new(&gpu),
            shafts: CellShafts::default(),
            scene: scene.clone(),
            scene_revision,
            sky_time: SkyTime::standing(scene.clone()),
            active: Vec::new(),
            proxies: Vec::new(),
            kept_on: config.proxies,
            ideal_active: Vec::new(),
            drifts: Vec::new(),
            active_cells: BTreeMap::new(),
            viewers: BTreeMap::new(),
            counters: Counters::default(),
            inspections: None,
            in_flight: Arc::default(),
            frame_filter: base.frame_filter,
            mip_bias: base.mip_bias,
            parallax_steps: base.parallax_steps,
            is_living: false,
            wind_is_searched: !gpu.is_software(),
            settings: MarchSettings {
                steps: base.march_steps,
                sun_steps: base.sun_steps,
                sun_depth: base.sun_depth,
                octaves: base.octaves,
                ..MarchSettings::default()
            },
            qualities,
            window_choice: WindowChoice::Fixed(None),
            awaited: None,
            gpu,
            pipelines,
            field,
            field_epoch: 0,
            config,
        };
        renderer.set_scene(scene, scene_revision)?;
        Ok(renderer)
    }

    /// Takes a new scene over. What only colours the sky marches nothing; what changes light or density in the clouds
    /// ages every texel; what changes where layers are starts their caches anew.
    pub(super) fn set_scene(
        &mut self,
        document: Arc<Scene>,
        revision: u64,
    ) -> Result<(), GpuError> {
        let now = clock::now();
        let scene = self.take_document(document, now);
        let active = active_layers(&scene);
        self.prepare_pipelines(&scene)?;
        for other in self.sky_time.to_come() {
            self.prepare_pipelines(&other)?;
        }
        let layout = &self.pipelines.field_layout;
        let grids_change = self
            .field
            .set_grids(&self.gpu, layout, &scene, &self.config.grids_dir);
        if grids_change {
            for cell in self.active_cells.values_mut() {
                cell.buffers.set_field_group(&self.field.bind_group);
            }
        }
        let maps = placed_weather(&scene, &active);
        let sheets = placed_sheets(&scene, &active);
        if maps.iter().any(|m| m.weather.maps().transition_s() > 0.0) {
            self.pipelines.prepare(&self.gpu, blend_key())?;
        }
        let layout = &self.pipelines.field_layout;
        let maps_change =
            self.field
                .set_maps(&self.gpu, layout, &maps, &sheets, &self.config.maps_dir);
        if maps_change.textures {
            for cell in self.active_cells.values_mut() {
                cell.buffers.set_field_group(&self.field.bind_group);
            }
        }
        self.field_epoch += u64::from(grids_change || maps_change.content);
        let cloud_altitude_m = active.first().map_or(0.0, |layer| layer.proxy_altitude_m);
        let old = std::mem::replace(&mut self.scene, scene);
        if maps_change.content
            || old.layers() != self.scene.layers()
            || old.planet() != self.scene.planet()
        {
            // Of other clouds.
            self.sun.clear();
        }
        self.scene_revision = revision;
        self.take_light(cloud_altitude_m);
        if old.has_carried() && !self.scene.has_carried() {
            // Where the scene before said that its clouds are says nothing about these.
            self.drifts.clear();
        }
        self.place_clouds();
        self.inspections = None;
        let moved = old.planet().radius_m() != self.scene.planet().radius_m()
            || !stand_alike(&active, &self.ideal_active);
        if moved {
            self.ideal_active.clone_from(&active);
            self.set_active(active);
            self.end_transitions();
            let ids: Vec<CellId> = self.active_cells.keys().copied().collect();
            for id in ids {
                self.restart_cell(id);
            }
        } else {
            let steps = steps_between(&old, &self.scene);
            if maps_change.content || steps.march() > STEPS_OF_A_MOMENT_MAX || steps.layers_change {
                self.caches.age_all();
            } else {
                self.age_by(&steps);
            }
        }
        if !self.has_light_shafts() {
            self.shafts.clear();
        }
        let views: Vec<(ViewerId, ViewRequest)> =
            self.viewers.iter().map(|(id, v)| (*id, v.view)).collect();
        for (id, view) in views {
            self.choose_renderer(id, &view);
            self.refresh_quality(id);
        }
        self.scene_changed_for_screen_space(!moved);
        self.touch_all_requests();
        self.prepare_views();
        self.prepare_meters()?;
        self.audit.restart();
        Ok(())
    }

    /// Other layers are shown.
    pub(super) fn set_active(&mut self, active: Vec<ActiveLayer>) {
        self.active = active;
        self.place_proxies();
    }

    /// Places what keeps the active layers.
    pub(super) fn place_proxies(&mut self) {
        self.proxies = proxies_of(&self.scene, &self.active, &self.kept_on);
    }

    /// How the composite blends the scene's layers.
    pub(super) fn blend(&self) -> LayerBlend {
        LayerBlend::of(&self.scene, &self.active, &self.kept_on)
    }

    /// Makes the pipelines of a scene that are not there yet.
    pub(super) fn prepare_pipelines(&mut self, scene: &Scene) -> Result<(), GpuError> {
        for key in self.pipeline_keys(scene) {
            self.pipelines.prepare(&self.gpu, key)?;
        }
        Ok(())
    }

    /// The pipelines of a scene.
    pub(super) fn pipeline_keys(&self, scene: &Scene) -> Vec<PipelineKey> {
        let active = active_layers(scene);
        let blend = LayerBlend::of(scene, &active, &self.kept_on);
        let most_frames = match self.window_choice {
            WindowChoice::Fixed(plan) => plan.map(|plan| plan.bounded().frames),
            WindowChoice::ByQuality => Some(WINDOW_FRAMES_MAX),
        };
        let mut keys: Vec<PipelineKey> = most_frames
            .into_iter()
            .flat_map(possible_frames)
            .flat_map(|frames| [resolve_key(frames, false), resolve_key(frames, true)])
            .collect();
        for filter in FrameFilter::ALL {
            for screen_space in [false, true] {
                let key = frame_key(&self.gpu, scene, filter, blend, screen_space);
                keys.extend([key, ground_key(key)]);
                if !screen_space {
                    keys.push(with_parallax(key));
                }
            }
        }
        keys.extend(self.clouds_keys(scene, blend));
        let of_sides = self.side_keys(scene, &self.sides_of_viewers());
        for haze in self.clouds_asked() {
            keys.extend(of_sides.iter().map(|key| clouds_key(*key, haze)));
        }
        keys.extend(of_sides);
        if scene.physical_air().is_some() {
            keys.extend(table_keys());
        }
        if !active.is_empty() {
            let domes = self.kept_on.has_domes();
            keys.extend([fade_key(), resample_key(domes, false)]);
            keys.extend(domes.then(|| resample_key(domes, true)));
        }
        let has_shafts = scene.light_shafts() && !active.is_empty();
        if has_shafts {
            keys.push(make_shafts_key());
        }
        for settings in self.possible_settings(scene.light().octaves()) {
            for layer in &active {
                let cone = layer_features(scene, layer.scene_index, &settings);
                let volume = asks_for_volume(&settings, scene).then_some(Features {
                    sun_layers: active.len() as u32,
                    ..cone
                });
                for features in [Some(cone), volume].into_iter().flatten() {
                    let texels = self.kept_on.features(features);
                    keys.extend([texels_key(texels), audit_key(texels)]);
                    keys.push(match self.window_choice {
                        WindowChoice::Fixed(None) => pixels_key(features, false),
                        WindowChoice::Fixed(Some(_)) | WindowChoice::ByQuality => {
                            window_key(features)
                        }
                    });
                    if self.shows_ways_by_rays() {
                        keys.push(window_key(Features {
                            moved_start: true,
                            ..features
                        }));
                    }
                }
                keys.extend(volume.map(sun_columns_key));
                keys.extend(has_shafts.then(|| cloud_shadows_key(cone)));
            }
        }
        keys
    }

    /// The light of the present scene, and the air that it passes. Texels hold which direction it comes from: the sun's,
    /// whose moves are told apart elsewhere, or the moon's.
    pub(super) fn take_light(&mut self, cloud_altitude_m: f64) {
        if self.sky_time.is_live() {
            self.air.follow(&self.scene, Instant::now());
        } else {
            self.air.make_now(&self.scene);
        }
        let light = sky_light(&self.scene, self.air.shown(), cloud_altitude_m);
        let old = std::mem::replace(&mut self.light, light);
        let moonlit = old.is_moon || self.light.is_moon;
        if moonlit && old.sun_direction != self.light.sun_direction {
            self.caches.age_all();
        }
        self.air_views
            .set(&self.gpu, self.air.shown(), self.light.sun_direction.y);
    }

    /// Brings the tables of air that has changed to where they are by now; true where something else is to be seen.
    pub(super) fn follow_air(&mut self) -> bool {
        if !self.air.is_moving() || !self.air.follow(&self.scene, Instant::now()) {
            return false;
        }
        let cloud_altitude_m = self
            .active
            .first()
            .map_or(0.0, |layer| layer.proxy_altitude_m);
        self.take_light(cloud_altitude_m);
        self.scene_changed_for_screen_space(true);
        true
    }

    /// Runs every pipeline once: a driver may compile at the first dispatch, which must not be a viewer's frame.
    pub(super) fn warm_up(&mut self) -> Result<(), GpuError> {
        use skycell_protocol::Codec;
        let viewer = ViewerId(u32::MAX);
        let size = FrameSize::new(8, 8).map_err(|error| GpuError::Device(error.to_string()))?;
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
                    quality: None,
                    show: skycell_protocol::Show::Picture,
                    stereo: None,
                    haze: true,
                    linear: false,
                },
            );
            self.refresh_cells();
            while self.update_sun_volumes(usize::MAX >> 32) {}
            while self.update_light_shafts(usize::MAX >> 32).is_pending {}
            for update in self.march(1) {
                self.warm_up_audit(&update);
                self.warm_up_resample(&update);
            }
            if renderer == RendererKind::ScreenSpace {
                self.warm_up_rays(viewer);
                self.march_screen_space(viewer, 1);
            }
            self.refresh_cells();
            let screen_space = renderer == RendererKind::ScreenSpace;
            for filter in FrameFilter::ALL {
                let blend = self.blend();
                let key = frame_key(&self.gpu, &self.scene, filter, blend, screen_space);
                let picture = Picture::new(&self.gpu, &self.pipelines, size, false);
                self.composite_still(viewer, &picture, &[key], None)?;
                if !screen_space {
                    self.composite_still(viewer, &picture, &[with_parallax(key)], None)?;
                }
            }
            self.warm_up_fade(size);
            self.leave(viewer);
        }
        self.gpu.wait()?;
        self.audit.restart();
        self.counters = Counters::default();
        self.timing = TimingRing::new(&self.gpu);
        Ok(())
    }

    /// Mixes two empty pictures.
    fn warm_up_fade(&mut self, size: FrameSize) {
        let picture = Picture::new(&self.gpu, &self.pipelines, size, false);
        let fade = PictureFade::new(&self.gpu, &self.pipelines, &picture);
        self.timing.begin();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("fade"),
            });
        let (gpu, pipelines) = (&self.gpu, &self.pipelines);
        let mix = Mix {
            share: 0.5,
            dither_shift: 0,
            old_scale: 1.0,
        };
        fade.record(gpu, &mut encoder, &mut self.timing, pipelines, mix);
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
    }

    /// Puts clouds where a scene of a moment says that they are.
    pub(super) fn place_clouds(&mut self) {
        self.drifts.resize(self.scene.layers().len(), DVec3::ZERO);
        if self.scene.has_carried() {
            for (index, drift) in self.drifts.iter_mut().enumerate() {
                *drift = self.scene.carried_m(index);
            }
        }
    }

    /// Wind carries the layers for a while, their noise rises, maps go on to others.
    pub(super) fn advance_time(&mut self, seconds: f64) {
        for (index, drift) in self.drifts.iter_mut().enumerate() {
            *drift += drift_m_per_s(&self.scene, index) * seconds;
        }
        self.field.advance_maps(seconds);
    }

    /// Time passes for maps that are on their way to others: sky time, while it runs.
    pub(super) fn advance_maps(&mut self, seconds: f64) {
        self.field
            .advance_maps(seconds * self.sky_time.rate().abs());
    }

    /// Lets marches read maps as far on their way to others as sky time is, and ages what was marched before: step by
    /// step a little, and in the end all of it.
    pub(super) fn step_maps(&mut self) -> BlendStep {
        let step = self
            .field
            .show_maps(&self.gpu, &mut self.pipelines)
            .unwrap_or_else(|error| {
                tracing::error!(%error, "maps cannot be blended");
                BlendStep::None
            });
        match step {
            BlendStep::None => {}
            BlendStep::Moved => {
                self.field_epoch += 1;
                self.caches.refresh_all();
            }
            BlendStep::Ended => {
                self.field_epoch += 1;
                self.caches.age_all();
                self.audit.restart();
            }
        }
        step
    }

    /// Whether clouds change by themselves: by wind, by evolution, with time, or because maps are on their way to others.
    pub(super) fn sky_is_changing(&self) -> bool {
        self.sky_time.moves()
            || self.wind_speed_max_m_per_s() > 0.0
            || self.evolution_max_m_per_s() > 0.0
            || self.field.maps_are_blending()
    }

    /// Fastest evolution of a layer that is shown, m/s.
    pub(super) fn evolution_max_m_per_s(&self) -> f64 {
        self.active
            .iter()
            .map(|layer| drift_m_per_s(&self.scene, layer.scene_index).y.abs())
            .fold(0.0, f64::max)
            * self.sky_time.wind_rate().abs()
    }

    /// Fastest speed at which the wind carries a layer that is shown past its viewers, m/s.
    pub(super) fn wind_speed_max_m_per_s(&self) -> f64 {
        let wind = self
            .active
            .iter()
            .map(|layer| self.scene.layer_wind(layer.scene_index).speed_m_per_s())
            .fold(0.0, f64::max);
        wind * self.sky_time.wind_rate().abs()
    }

    /// What stands on the device.
    pub(super) fn inventory(&self) -> DeviceInventory {
        DeviceInventory::of(&self.gpu, &self.pipelines, &self.timing)
    }

    pub(super) fn stats(&self, uptime_s: f64) -> RenderStats {
        super::stats::render_stats(self, uptime_s)
    }
}

/// Whether proxy spheres of the same layers stand where the others do, or so near that texels may stay.
fn stand_alike(a: &[ActiveLayer], b: &[ActiveLayer]) -> bool {
    a.len() == b.len()
        && a.iter().zip(b).all(|(a, b)| {
            a.scene_index == b.scene_index
                && (a.proxy_altitude_m - b.proxy_altitude_m).abs() <= PROXY_SHIFT_MAX_M
        })
}

/// The composite of viewers' frames.
pub(super) fn frame_key(
    gpu: &Gpu,
    scene: &Scene,
    filter: FrameFilter,
    blend: LayerBlend,
    screen_space: bool,
) -> PipelineKey {
    let key = composite_key(scene, filter, blend, screen_space, false);
    if gpu.is_software() {
        with_shared_background(key)
    } else {
        key
    }
}
