//! How a single picture is made, and what it cost.

use super::still::{StillPixels, StillRenderer};
use crate::cache::{BYTES_PER_TEXEL, Caches, TEXELS_PER_TILE};
use crate::cells::Cells;
use crate::config::{FrameFilter, PlacedCell};
use crate::gpu::GpuError;
use glam::DVec3;
use image::imageops::FilterType;
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use std::sync::Arc;
use std::time::Instant;

/// How rays are marched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarchSettings {
    /// Steps through the thickness of a layer at close range.
    pub steps: u32,
    /// Steps towards the sun; the scene's without.
    pub sun_steps: Option<u32>,
    /// Terms of the multiple-scattering sum; the scene's without.
    pub octaves: Option<u32>,
    /// Rays end where nothing behind can be seen.
    pub early_exit: bool,
    /// Space that holds no cloud is crossed without reading it.
    pub low_density_skip: bool,
    /// Steps grow with distance.
    pub adaptive_step: bool,
    /// Noise is interpolated in full precision.
    pub exact_interpolation: bool,
    /// Count texture reads, which costs time.
    pub count_reads: bool,
}

/// How a picture is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StillSettings {
    /// Which renderer.
    pub renderer: RendererKind,
    /// How rays are marched.
    pub march: MarchSettings,
    /// Samples of a texel or pixel.
    pub samples: u32,
    /// Width and height of the marched picture are the shown one's divided by this: 1, 2 or 4. Screen-space only.
    pub resolution_divisor: u32,
    /// Halvings of the cache's resolution below the screen's.
    pub mip_bias: f32,
    /// How the cache is read.
    pub filter: FrameFilter,
    /// Reference point minus eye, m. Cached only.
    pub reference_offset_m: [f64; 3],
}

/// A picture with what it cost.
#[derive(Clone, Debug, PartialEq)]
pub struct StillPicture {
    /// Width and height.
    pub size: FrameSize,
    /// Tone-mapped sRGB, RGBA.
    pub display: Vec<u8>,
    /// Linear radiance per W/(m² nm) of the sun's spectrum, RGBA.
    pub linear: Vec<f32>,
    /// What it cost.
    pub figures: StillFigures,
}

/// What a picture cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StillFigures {
    /// Rays.
    pub marches: u64,
    /// Texture reads, if they were counted.
    pub texture_reads: Option<u64>,
    /// Time by the device's timestamps, if it has any.
    pub gpu_ns: Option<u64>,
    /// Time by the clock.
    pub wall_s: f64,
}

/// Why a picture cannot be made with these settings by this build; none when it can.
#[must_use]
pub fn unsupported(settings: &StillSettings) -> Option<&'static str> {
    let march = settings.march;
    [
        (!march.early_exit, "rays always end early"),
        (!march.low_density_skip, "empty space is always skipped"),
        (!march.adaptive_step, "steps always grow with distance"),
        (
            march.exact_interpolation,
            "noise is interpolated by the device",
        ),
        (march.count_reads, "texture reads are not counted"),
        (
            settings.resolution_divisor > 1 && settings.renderer == RendererKind::Cached,
            "the cache has a mip bias instead",
        ),
    ]
    .into_iter()
    .find_map(|(asked, reason)| asked.then_some(reason))
}

impl StillRenderer {
    /// Renders a picture with its own settings; `progress` gets the share that is done.
    ///
    /// # Errors
    /// When the settings are not supported, the device is lost or the picture does not fit on it.
    pub fn render_with(
        &mut self,
        camera: Camera,
        size: FrameSize,
        settings: &StillSettings,
        mut progress: impl FnMut(f64),
    ) -> Result<StillPicture, GpuError> {
        if let Some(reason) = unsupported(settings) {
            return Err(GpuError::Device(format!(
                "this build cannot render that: {reason}"
            )));
        }
        let own_scene = self.renderer.scene.clone();
        let scene = scene_with(&own_scene, settings.march)?;
        if scene != *own_scene {
            self.set_scene(Arc::new(scene))?;
        }
        let picture = self.render_settled(camera, size, settings, &mut progress);
        if self.renderer.scene != own_scene {
            self.set_scene(own_scene)?;
        }
        picture
    }

    fn render_settled(
        &mut self,
        camera: Camera,
        size: FrameSize,
        settings: &StillSettings,
        progress: &mut impl FnMut(f64),
    ) -> Result<StillPicture, GpuError> {
        let divisor = settings.resolution_divisor.max(1);
        let marched = FrameSize::new(
            size.width().div_ceil(divisor),
            size.height().div_ceil(divisor),
        )
        .map_err(|error| GpuError::Device(error.to_string()))?;
        let renderer = &mut self.renderer;
        renderer.leave(super::still::VIEWER);
        renderer.config.samples = settings.samples;
        renderer.march_steps = settings.march.steps;
        renderer.mip_bias = f64::from(settings.mip_bias);
        renderer.frame_filter = settings.filter;
        let tiles_max = (u64::from(renderer.config.cache_memory_mib) << 20)
            / (TEXELS_PER_TILE * BYTES_PER_TEXEL);
        renderer.caches = Caches::new(
            tiles_max.clamp(32, u64::from(crate::march::Atlas::tiles_max(&renderer.gpu))) as u32,
            settings.samples,
        );
        let eye = DVec3::from_array(camera.position_m());
        renderer.cells = Cells::new(&[PlacedCell {
            name: "still".into(),
            center_m: (eye + DVec3::from_array(settings.reference_offset_m)).to_array(),
            radius_m: 1.0e6,
        }]);
        let before = (self.totals(), self.gpu_times_ns());
        let start = Instant::now();
        let display = self.render(camera, marched, settings.renderer, false, |share| {
            progress(0.5 * share)
        })?;
        let wall_s = start.elapsed().as_secs_f64();
        let after = (self.totals(), self.gpu_times_ns());
        let linear = self.render(camera, marched, settings.renderer, true, |share| {
            progress(0.5 + 0.5 * share)
        })?;
        let gpu_ns: u64 = (0..3).map(|pass| after.1[pass] - before.1[pass]).sum();
        let (StillPixels::Display(display), StillPixels::Linear(linear)) = (display, linear) else {
            return Err(GpuError::Device(
                "a picture came in the other format".into(),
            ));
        };
        Ok(StillPicture {
            size,
            display: enlarged_bytes(display, marched, size),
            linear: enlarged_floats(linear, marched, size),
            figures: StillFigures {
                marches: after.0.texels_updated - before.0.texels_updated
                    + after.0.screen_space_marches
                    - before.0.screen_space_marches,
                texture_reads: None,
                gpu_ns: (gpu_ns > 0).then_some(gpu_ns),
                wall_s,
            },
        })
    }
}

fn scene_with(scene: &Scene, march: MarchSettings) -> Result<Scene, GpuError> {
    let mut document = scene.to_document();
    document.light.sun_steps = march.sun_steps.unwrap_or(document.light.sun_steps);
    document.light.octaves = march.octaves.unwrap_or(document.light.octaves);
    Scene::try_from(document).map_err(|error| GpuError::Device(error.to_string()))
}

fn enlarged_bytes(bytes: Vec<u8>, from: FrameSize, to: FrameSize) -> Vec<u8> {
    match image::RgbaImage::from_raw(from.width(), from.height(), bytes) {
        Some(picture) if from != to => {
            image::imageops::resize(&picture, to.width(), to.height(), FilterType::Triangle)
                .into_raw()
        }
        picture => picture.map(image::RgbaImage::into_raw).unwrap_or_default(),
    }
}

fn enlarged_floats(values: Vec<f32>, from: FrameSize, to: FrameSize) -> Vec<f32> {
    match image::Rgba32FImage::from_raw(from.width(), from.height(), values) {
        Some(picture) if from != to => {
            image::imageops::resize(&picture, to.width(), to.height(), FilterType::Triangle)
                .into_raw()
        }
        picture => picture
            .map(image::Rgba32FImage::into_raw)
            .unwrap_or_default(),
    }
}
