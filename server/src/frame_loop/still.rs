//! One picture without a server: the same renderer, driven until nothing is left to do.

use super::interface::{RenderTotals, ViewRequest};
use super::renderer::SkyRenderer;
use super::screen_space::{EyeJob, ScreenSpaceJob, WindowChoice};
use super::still_frames::cell_around;
use super::still_settings::{LayerFigures, RayFigures, RayPicture};
use super::still_settings::{StillFigures, StillPicture, StillSettings};
use crate::atmosphere::ShaftShares;
use crate::cache::{BYTES_PER_TEXEL, TEXELS_PER_TILE, TexelSamples};
use crate::cells::{CellLimit, Cells};
use crate::composite::{Picture, composite_key, ground_key, shown_of};
use crate::config::{PlacedCell, RenderConfig};
use crate::gpu::{DeviceInventory, Gpu, GpuError, PipelineKey, TimedPass};
use crate::gpu::{read_buffer_blocking, reads_of};
use crate::march::{CellFrame, LISTED_VALUES, MarchedPixels, layer_features, pixels_key};
use glam::DVec3;
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene, ViewerId};
use skycell_shaders::{Features, Shown, layout};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

/// Tiles marched between two reports of progress.
pub(super) const BATCH_TILES: usize = 32;
/// Device time of a strip of the screen-space renderer between two reports, ns.
const STRIP_NS: u64 = 400_000_000;
/// The only viewer.
pub(super) const VIEWER: ViewerId = ViewerId(1);

/// Renders single pictures of one scene.
pub struct StillRenderer {
    pub(super) renderer: SkyRenderer,
    placed: Vec<PlacedCell>,
}

impl StillRenderer {
    /// Opens a device and makes or loads the noise.
    ///
    /// # Errors
    /// When there is no device.
    pub fn new(
        config: RenderConfig,
        scene: Arc<Scene>,
        placed: &[PlacedCell],
    ) -> Result<Self, GpuError> {
        let gpu = Gpu::open_blocking()?;
        Ok(Self {
            renderer: SkyRenderer::new(gpu, config, scene, 1, placed)?,
            placed: placed.to_vec(),
        })
    }

    /// Name of the adapter.
    #[must_use]
    pub fn adapter(&self) -> String {
        let info = &self.renderer.gpu.info;
        format!("{} ({} {})", info.name, info.driver, info.driver_info)
    }

    /// Lets the wind blow for a while.
    pub fn advance_time(&mut self, seconds: f64) {
        self.renderer.advance_time(seconds);
    }

    /// Replaces the scene.
    ///
    /// # Errors
    /// When a pipeline cannot be made.
    pub fn set_scene(&mut self, scene: Arc<Scene>) -> Result<(), GpuError> {
        let revision = self.renderer.scene_revision + 1;
        self.renderer.set_scene(scene, revision)
    }

    /// For tests: pictures are made by edited shaders, until `None` brings the true ones back.
    ///
    /// # Errors
    /// When what comes of the edit is no shader.
    pub fn plant(&mut self, edit: Option<skycell_shaders::SourceEdit>) -> Result<(), GpuError> {
        self.renderer.pipelines.plant(edit);
        let scene = self.renderer.scene.clone();
        self.set_scene(scene)
    }

    /// Sums of what was done so far.
    #[must_use]
    pub fn totals(&self) -> RenderTotals {
        self.renderer.stats(0.0).totals
    }

    /// GPU memory of the cache's tiles that are there, bytes.
    #[must_use]
    pub fn resident_bytes(&self) -> u64 {
        u64::from(self.renderer.caches.resident()) * TEXELS_PER_TILE * BYTES_PER_TEXEL
    }

    /// What stands on the device.
    #[must_use]
    pub fn inventory(&self) -> DeviceInventory {
        self.renderer.inventory()
    }

    /// What the pipelines that were made can read or write, by entry point.
    ///
    /// # Errors
    /// When a kernel does not compose.
    pub fn reads(&self) -> Result<BTreeMap<&'static str, BTreeSet<String>>, GpuError> {
        reads_of(&self.renderer.pipelines)
    }

    /// The light shafts of the last picture, brought to the processor: for tests. None where it had none.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn light_shafts(&self) -> Result<Option<ShaftShares>, GpuError> {
        let renderer = &self.renderer;
        let cell = renderer.viewers.get(&VIEWER).map(|viewer| viewer.cell);
        match cell.and_then(|cell| renderer.shafts.of(cell)) {
            Some(shafts) => shafts.shares_blocking(&renderer.gpu),
            None => Ok(None),
        }
    }

    /// The scene.
    #[must_use]
    pub fn scene(&self) -> &Arc<Scene> {
        &self.renderer.scene
    }

    /// Whether the device is the processor.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.renderer.gpu.is_software()
    }

    /// Renders a picture; `progress` gets the share that is done.
    ///
    /// # Errors
    /// When the device is lost or the picture does not fit on it.
    pub fn render_with(
        &mut self,
        camera: Camera,
        size: FrameSize,
        settings: &StillSettings,
        progress: impl FnMut(f64),
    ) -> Result<StillPicture, GpuError> {
        let start = Start::of(self, settings)?;
        let screen_space = self.join(camera, size, settings);
        if screen_space && shown_of(settings.show).is_of_cache() {
            return Err(GpuError::NotShown(settings.show.name()));
        }
        self.prepare_composites(screen_space, settings, false)?;
        self.renderer.refresh_cells();
        match settings.window {
            Some(_) if screen_space => self.march_frames(camera, settings, progress)?,
            _ => self.march_all(screen_space, progress)?,
        }
        self.renderer.meter_now()?;
        let (display, linear) = self.composites(size, screen_space, settings)?;
        Ok(StillPicture {
            size: settings.stereo.map_or(size, |_| size.pair()),
            display,
            linear,
            figures: start.figures(self)?,
        })
    }

    /// Marches listed rays with the screen-space renderer; `progress` gets the share that is done.
    ///
    /// # Errors
    /// When the device is lost or the rays do not fit on it.
    pub fn render_rays(
        &mut self,
        list: &RayPicture,
        settings: &StillSettings,
        progress: impl FnMut(f64),
    ) -> Result<RayFigures, GpuError> {
        let settings = &StillSettings {
            renderer: RendererKind::ScreenSpace,
            window: None,
            frames: 1,
            stereo: None,
            ..*settings
        };
        if list.rays.len() != list.size.pixels() as usize {
            return Err(GpuError::Device("as many rays as pixels".into()));
        }
        let start = Start::of(self, settings)?;
        let [x, _, z] = list.frame_m.to_array();
        let at_frame = Camera::new([x, 0.0, z], 0.0, 0.0, 60.0)
            .map_err(|error| GpuError::Device(error.to_string()))?;
        self.join(at_frame, list.size, settings);
        let renderer = &mut self.renderer;
        for layer in &renderer.active {
            let cone = layer_features(&renderer.scene, layer.scene_index, &renderer.settings);
            let volume = Features {
                sun_layers: renderer.active.len() as u32,
                ..cone
            };
            for features in [cone, volume] {
                let key = pixels_key(features, true);
                renderer.pipelines.prepare(&renderer.gpu, key)?;
            }
        }
        self.prepare_composites(true, settings, true)?;
        let renderer = &mut self.renderer;
        renderer.refresh_cells();
        let f32s = |v: DVec3| v.as_vec3().to_array();
        let listed: Vec<layout::ListedRay> = list
            .rays
            .iter()
            .map(|ray| layout::ListedRay {
                origin: f32s(ray.origin_m),
                direction: f32s(ray.direction),
                ..Default::default()
            })
            .collect();
        let layers = renderer.active.len();
        let marched = MarchedPixels::new(
            &renderer.gpu,
            &renderer.pipelines,
            list.size,
            layers,
            Some(&listed),
        );
        let gone = || GpuError::Device("the viewer of the rays is gone".into());
        let viewer = renderer.viewers.get(&VIEWER).ok_or_else(gone)?;
        // The air is looked up for one altitude, that of the first ray.
        let altitude_m = list.rays.first().map_or(0.0, |ray| {
            let radius_m = renderer.scene.planet().radius_m();
            CellFrame::at(list.frame_m, radius_m).altitude_m(ray.origin_m)
        });
        let view = layout::View {
            right: f32s(list.pixel_m[0]),
            up: f32s(-list.pixel_m[1]),
            altitude_m: altitude_m as f32,
            ..*renderer
                .views_of(viewer)
                .and_then(|eyes| eyes.first().copied())
                .as_ref()
                .ok_or_else(gone)?
        };
        // Light shafts are seen from one place, too.
        renderer.shafts.eye = list.rays.first().map(|ray| ray.origin_m);
        let viewer = renderer.viewers.get_mut(&VIEWER).ok_or_else(gone)?;
        viewer.screen_space = Some(ScreenSpaceJob::new(
            at_frame,
            (0..layers as u32).collect(),
            [(marched, view)],
        ));
        self.march_all(true, progress)?;
        let (display, linear) = self.composites(list.size, true, settings)?;
        let renderer = &self.renderer;
        let viewer = renderer.viewers.get(&VIEWER).ok_or_else(gone)?;
        let eyes = viewer.screen_space.as_ref().map(ScreenSpaceJob::eyes);
        let eye = eyes.and_then(<[EyeJob]>::first).ok_or_else(gone)?;
        let values: Vec<f32> = if layers == 0 {
            Vec::new()
        } else {
            let bytes = read_buffer_blocking(&renderer.gpu, eye.marched().values())?;
            bytemuck::pod_collect_to_vec(&bytes)
        };
        let found: Vec<LayerFigures> = values
            .chunks_exact(LISTED_VALUES)
            .map(|v| LayerFigures {
                single: v[0],
                octaves: v[1],
                ambient: v[2],
                transmittance: v[3],
                opacity_distance_m: v[4],
                steps: v[5],
                optical_depth: v[6],
            })
            .collect();
        Ok(RayFigures {
            radiance: linear.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect(),
            layers: found
                .chunks_exact(list.rays.len())
                .map(<[LayerFigures]>::to_vec)
                .collect(),
            picture: StillPicture {
                size: list.size,
                display,
                linear,
                figures: start.figures(self)?,
            },
        })
    }

    /// Nobody is there, and what comes next is made by these settings.
    pub(super) fn begin(&mut self, settings: &StillSettings) -> Result<(), GpuError> {
        Start::of(self, settings).map(|_| ())
    }

    /// Makes the only viewer anew; true when it gets rays of its own: a camera in a layer always does.
    pub(super) fn join(
        &mut self,
        camera: Camera,
        size: FrameSize,
        settings: &StillSettings,
    ) -> bool {
        let offset_m = DVec3::from_array(settings.reference_offset_m);
        let reference_m = DVec3::from_array(camera.position_m()) + offset_m;
        self.join_cell(
            camera,
            size,
            settings,
            (offset_m != DVec3::ZERO).then_some(reference_m),
        )
    }

    /// The same with a reference that stands somewhere, where it is told.
    pub(super) fn join_cell(
        &mut self,
        camera: Camera,
        size: FrameSize,
        settings: &StillSettings,
        reference_m: Option<DVec3>,
    ) -> bool {
        let renderer = &mut self.renderer;
        renderer.leave(VIEWER);
        renderer.cells = match reference_m {
            None => Cells::new(&self.placed, CellLimit::default()),
            Some(reference_m) => Cells::new(&[cell_around(reference_m)], CellLimit::default()),
        };
        renderer.join(
            VIEWER,
            ViewRequest {
                size,
                fps: 1.0,
                codec: settings.codec,
                jpeg_quality: 100,
                camera,
                renderer: settings.renderer,
                quality: None,
                show: settings.show,
                stereo: settings.stereo,
                haze: true,
                linear: false,
            },
        );
        renderer.viewers.get_mut(&VIEWER).is_some_and(|viewer| {
            // Its pipelines are made before the picture, wherever it looks from.
            if viewer.approaches.take().is_some() {
                viewer.kind = RendererKind::Cached;
            }
            viewer.kind == RendererKind::ScreenSpace
        })
    }

    /// The list of rays that is marched in the place of a camera's.
    fn listed_rays(&self) -> Option<&wgpu::Buffer> {
        let viewer = self.renderer.viewers.get(&VIEWER)?;
        viewer
            .screen_space
            .as_ref()?
            .eyes()
            .first()?
            .marched()
            .rays()
    }

    /// Those of the picture as it is shown and of its linear radiance, each with one for each eye.
    pub(super) fn composite_keys(
        &self,
        screen_space: bool,
        settings: &StillSettings,
    ) -> [Vec<PipelineKey>; 2] {
        let ray_list = self.listed_rays().is_some();
        self.composite_keys_for(screen_space, settings, ray_list)
    }

    fn composite_keys_for(
        &self,
        screen_space: bool,
        settings: &StillSettings,
        ray_list: bool,
    ) -> [Vec<PipelineKey>; 2] {
        let shown = shown_of(settings.show);
        let renderer = &self.renderer;
        let viewer = renderer.viewers.get(&VIEWER);
        [false, true].map(|linear| {
            let blend = self.renderer.blend();
            let key = composite_key(
                &self.renderer.scene,
                settings.filter,
                blend,
                screen_space,
                linear,
            );
            let keys = viewer.map_or_else(
                || vec![key],
                |viewer| renderer.keys_for(viewer, viewer.cell, key),
            );
            let of_eye = |key: PipelineKey| PipelineKey {
                features: Features {
                    ray_list,
                    shown: if shown.is_inspection() {
                        Shown::Picture
                    } else {
                        shown
                    },
                    shared_background: settings.shared_background,
                    phase_of_reference: settings.phase_of_reference && !screen_space,
                    ..key.features
                },
                ..key
            };
            keys.into_iter().map(of_eye).collect()
        })
    }

    pub(super) fn prepare_composites(
        &mut self,
        screen_space: bool,
        settings: &StillSettings,
        ray_list: bool,
    ) -> Result<(), GpuError> {
        let keys = self.composite_keys_for(screen_space, settings, ray_list);
        for key in keys.iter().flatten().copied() {
            let renderer = &mut self.renderer;
            renderer.pipelines.prepare(&renderer.gpu, key)?;
            renderer.pipelines.prepare(&renderer.gpu, ground_key(key))?;
        }
        let shown = shown_of(settings.show);
        if shown.is_inspection() {
            let renderer = &mut self.renderer;
            for key in keys[0].iter().copied() {
                for key in renderer.shown_keys(shown, key) {
                    renderer.pipelines.prepare(&renderer.gpu, key)?;
                }
            }
        }
        Ok(())
    }

    /// Frames of a window, from a camera that turns towards where the picture is taken.
    fn march_frames(
        &mut self,
        camera: Camera,
        settings: &StillSettings,
        mut progress: impl FnMut(f64),
    ) -> Result<(), GpuError> {
        self.renderer.make_light_shafts(BATCH_TILES)?;
        let frames = settings.frames.max(1);
        for frame in 0..frames {
            let left = f64::from((frames - frame).saturating_sub(settings.resting_frames.max(1)));
            let turned = turned(&camera, -settings.turn_deg_per_frame * left)?;
            let renderer = &mut self.renderer;
            if let Some(viewer) = renderer.viewers.get_mut(&VIEWER) {
                viewer.view.camera = turned;
            }
            renderer.refresh_cells();
            renderer.restart_screen_space(VIEWER);
            while !renderer.march_screen_space(VIEWER, STRIP_NS) {
                renderer.gpu.wait()?;
            }
            renderer.gpu.wait()?;
            progress(f64::from(frame + 1) / f64::from(frames));
        }
        Ok(())
    }

    pub(super) fn march_all(
        &mut self,
        screen_space: bool,
        mut progress: impl FnMut(f64),
    ) -> Result<(), GpuError> {
        let renderer = &mut self.renderer;
        while renderer.update_sun_volumes(BATCH_TILES) {
            renderer.gpu.wait()?;
        }
        renderer.make_light_shafts(BATCH_TILES)?;
        let viewer = renderer.viewers.get(&VIEWER);
        if !screen_space && viewer.is_some_and(|viewer| renderer.marches_near(viewer)) {
            // The near part of a layer that the viewer is in.
            renderer.refresh_cells();
            renderer.restart_screen_space(VIEWER);
            while renderer.screen_space_pending(VIEWER) {
                renderer.march_screen_space(VIEWER, STRIP_NS);
                renderer.gpu.wait()?;
            }
        }
        if screen_space {
            let samples = f64::from(renderer.caches.samples().most);
            let mut done = 0.0;
            while renderer.screen_space_pending(VIEWER) {
                done += f64::from(u8::from(renderer.march_screen_space(VIEWER, STRIP_NS)));
                renderer.refresh_cells();
                renderer.gpu.wait()?;
                progress(done / samples);
            }
        } else {
            loop {
                renderer.refresh_cells();
                let marched = renderer.march(BATCH_TILES);
                if marched.is_empty() {
                    break;
                }
                renderer.gpu.wait()?;
                progress(renderer.share_done());
            }
        }
        renderer.refresh_cells();
        Ok(())
    }

    /// The picture as it is shown, and its linear radiance.
    pub(super) fn composites(
        &mut self,
        size: FrameSize,
        screen_space: bool,
        settings: &StillSettings,
    ) -> Result<(Vec<u8>, Vec<f32>), GpuError> {
        let [display_keys, linear_keys] = self.composite_keys(screen_space, settings);
        let mut read = |keys: &[PipelineKey], linear| {
            let rays = self.listed_rays().cloned();
            let renderer = &mut self.renderer;
            let (gpu, pipelines) = (&renderer.gpu, &renderer.pipelines);
            let eyes = keys.len();
            let picture = Picture::with_rays(gpu, pipelines, size, eyes, linear, rays.as_ref());
            let shown = shown_of(settings.show);
            let inspected = (!linear && shown.is_inspection()).then_some(shown);
            renderer.composite_still(VIEWER, &picture, keys, inspected)?;
            read_buffer_blocking(&renderer.gpu, picture.pixels())
        };
        let display = read(&display_keys, false)?;
        let linear = bytemuck::pod_collect_to_vec(&read(&linear_keys, true)?);
        Ok((display, linear))
    }

    /// GPU time of the cache, of composites, of the screen-space renderer, of sun volumes and of light shafts so far, ns.
    #[must_use]
    pub fn gpu_times_ns(&self) -> [u64; 5] {
        [
            TimedPass::Cache,
            TimedPass::Composite,
            TimedPass::ScreenSpace,
            TimedPass::SunVolume,
            TimedPass::LightShafts,
        ]
        .map(|pass| self.renderer.gpu_time(pass).0)
    }
}

/// A camera that has turned to the right.
fn turned(camera: &Camera, by_deg: f64) -> Result<Camera, GpuError> {
    if by_deg == 0.0 {
        return Ok(*camera);
    }
    Camera::new(
        camera.position_m(),
        camera.yaw_deg() + by_deg,
        camera.pitch_deg(),
        camera.vertical_fov_deg(),
    )
    .map_err(|error| GpuError::Device(error.to_string()))
}

/// Where counters stood when a picture was begun.
pub(super) struct Start {
    at: Instant,
    totals: RenderTotals,
    gpu_ns: u64,
    counts_reads: bool,
}

impl Start {
    /// Takes the settings over and begins to count.
    pub(super) fn of(
        still: &mut StillRenderer,
        settings: &StillSettings,
    ) -> Result<Self, GpuError> {
        let renderer = &mut still.renderer;
        renderer.leave(VIEWER);
        renderer.settings = settings.march;
        // Each picture pays for its own.
        renderer.sun.clear();
        renderer.shafts.clear();
        let samples = TexelSamples::new(settings.samples, settings.samples_by_area);
        renderer.caches.set_samples(samples);
        renderer.mip_bias = f64::from(settings.mip_bias);
        renderer.parallax_steps = settings.parallax_steps;
        renderer.kept_on = settings.kept_on().checked()?;
        renderer.place_proxies();
        renderer.window_choice = WindowChoice::Fixed(settings.window);
        // Pipelines for other settings.
        let (scene, revision) = (renderer.scene.clone(), renderer.scene_revision + 1);
        renderer.set_scene(scene, revision)?;
        renderer.step_maps();
        let counter = &renderer.pipelines.read_counter;
        renderer.gpu.queue.write_buffer(counter, 0, &[0; 16]);
        Ok(Self {
            at: Instant::now(),
            totals: still.totals(),
            gpu_ns: still.gpu_times_ns().iter().sum(),
            counts_reads: settings.march.count_reads,
        })
    }

    pub(super) fn figures(&self, still: &StillRenderer) -> Result<StillFigures, GpuError> {
        let totals = still.totals();
        let marches = |t: &RenderTotals| t.texels_updated + t.screen_space_marches;
        let gpu_ns = still.gpu_times_ns().iter().sum::<u64>() - self.gpu_ns;
        let [texture_reads, density_evaluations] = if self.counts_reads {
            let renderer = &still.renderer;
            let bytes = read_buffer_blocking(&renderer.gpu, &renderer.pipelines.read_counter)?;
            let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
            let count = |at: usize| Some(u64::from(words[at]) | u64::from(words[at + 1]) << 32);
            [count(0), count(2)]
        } else {
            [None; 2]
        };
        Ok(StillFigures {
            marches: marches(&totals) - marches(&self.totals),
            texture_reads,
            density_evaluations,
            sun_volume_evaluations: totals.sun_volume_evaluations
                - self.totals.sun_volume_evaluations,
            gpu_ns: (gpu_ns > 0).then_some(gpu_ns),
            wall_s: self.at.elapsed().as_secs_f64(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::march::{MarchSettings, WindowPlan};
    use skycell_shaders::SourceEdit;
    use std::path::PathBuf;

    /// Lets one window slide over `frames` frames: again and again the camera turns for some frames, never the same number,
    /// and rests for a window. Returns how many of the pictures at rest are not the first one, to the last bit, and of how many.
    fn strayed(edit: Option<SourceEdit>, frames: u32) -> (u32, u32) {
        let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
        let config = RenderConfig::new(PathBuf::from(noise));
        let mut still = StillRenderer::new(config, Arc::default(), &[]).expect("a device");
        still.plant(edit).expect("shaders");
        let size = FrameSize::new(16, 12).expect("a size");
        let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 30.0, 60.0).expect("a camera");
        let plan = WindowPlan {
            frames: 16,
            divisor: 4,
            depth_segments: 3,
            refinement: 2,
        };
        let settings = StillSettings {
            renderer: RendererKind::ScreenSpace,
            march: MarchSettings {
                steps: 16,
                ..MarchSettings::default()
            },
            window: Some(plan),
            frames: plan.frames,
            resting_frames: plan.frames,
            ..StillSettings::default()
        };
        let fresh = still
            .render_with(camera, size, &settings, |_| {})
            .expect("a picture");
        let (mut done, mut pictures, mut strayed) = (plan.frames, 0, 0);
        while done < frames {
            let moving = StillSettings {
                frames: plan.frames + 1 + pictures % 23,
                turn_deg_per_frame: 0.37 * f64::from(1 + pictures % 7),
                ..settings
            };
            still
                .march_frames(camera, &moving, |_| {})
                .expect("frames of the same window");
            done += moving.frames;
            pictures += 1;
            let (_, linear) = still.composites(size, true, &settings).expect("a picture");
            strayed += u32::from(linear != fresh.linear);
        }
        println!("{done} frames, {pictures} pictures at rest, {strayed} of them not the first");
        (strayed, pictures)
    }

    /// Two layers with a gap between them, no wind.
    fn two_layers() -> Arc<Scene> {
        let document = serde_json::json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
            {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 2500,
             "density": {"model": "weather", "coverage": 0.6, "type": 0.5}},
            {"name": "high", "base_altitude_m": 4000, "top_altitude_m": 4600,
             "density": {"model": "weather", "coverage": 0.4, "type": 0.2, "seed": 3}}]});
        Arc::new(Scene::from_json(&document).expect("a scene"))
    }

    /// Mean difference of what is shown, in steps of 8 bits.
    fn apart(a: &[u8], b: &[u8]) -> f64 {
        let sum: f64 = a
            .iter()
            .zip(b)
            .map(|(a, b)| f64::from(a.abs_diff(*b)))
            .sum();
        // Opacity is always the same.
        sum / (0.75 * a.len() as f64)
    }

    #[test]
    fn a_camera_that_has_jumped_is_shown_what_one_is_shown_that_was_always_there() {
        let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
        let config = RenderConfig::new(PathBuf::from(noise));
        let mut still = StillRenderer::new(config, two_layers(), &[]).expect("a device");
        let settings = StillSettings {
            march: MarchSettings {
                steps: 48,
                ..MarchSettings::default()
            },
            ..StillSettings::default()
        };
        let at = |altitude_m: f64| {
            Camera::new([200.0, altitude_m, -300.0], 40.0, 20.0, 60.0).expect("a camera")
        };
        let size = FrameSize::new(160, 90).expect("a size");
        // Up to 5 m under the base and down again, for which there is a new anchor: nothing of the old view is left. Less than
        // that leaves old samples a seventeenth of the way at most.
        let seventeenth = 1.0 / 17.0;
        for (from_m, to_m, kept) in [
            (2.0, 1495.0, 0.0),
            (1400.0, 2.0, 0.0),
            (2.0, 400.0, seventeenth),
        ] {
            let [there, before] = [to_m, from_m].map(|altitude_m| {
                still
                    .render_with(at(altitude_m), size, &settings, |_| {})
                    .expect("a picture")
            });
            let input = skycell_protocol::InputSequence(1);
            still.renderer.set_camera(VIEWER, input, at(to_m));
            still.renderer.regroup(0.1);
            still.march_all(false, |_| {}).expect("marched");
            let (jumped, _) = still.composites(size, false, &settings).expect("a picture");
            let [off, way] =
                [&jumped, &before.display].map(|picture| apart(&there.display, picture));
            println!("from {from_m} to {to_m} m: {off:.2} off, of {way:.2}");
            // Beside it, a hundredth of a step of 8 bits.
            assert!(
                off <= kept * way + 0.01 && way > 5.0,
                "from {from_m} to {to_m} m: {off} of {way}"
            );
        }
    }

    #[test]
    fn a_window_that_has_slid_over_thousands_of_frames_shows_at_rest_what_a_fresh_one_shows() {
        let (changed, pictures) = strayed(None, 4_000);
        assert_eq!(changed, 0, "of {pictures}");
        // Planted: a mean that forgets instead of a window. It is found wherever the window stood in its ring.
        let trace: SourceEdit = |path, source| match path {
            "march/resolve.wgsl" => source.replace(
                "marched[at] = mean.light.x;",
                "marched[at] = mix(mean.light.x, marched[at], 0.7);",
            ),
            _ => source.to_owned(),
        };
        let (changed, pictures) = strayed(Some(trace), 200);
        assert_eq!(changed, pictures);
    }
}
