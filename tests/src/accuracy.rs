//! Pictures for comparisons, and how far two are apart.

use crate::picture::without_alpha;
use crate::server::target_dir;
use image::RgbImage;
use skycell_protocol::{Camera, FrameSize, RendererKind};
use skycell_server::config::{FrameFilter, RenderConfig};
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use skycell_server::march::MarchSettings;
use std::sync::Arc;

pub use skycell_server::measure::metrics::{ShownErrors as Distance, shown_errors as distance};

/// How a picture for a comparison is made.
#[derive(Clone, Copy, Debug)]
pub struct Recipe {
    /// Which renderer.
    pub renderer: RendererKind,
    /// Samples of a texel or pixel.
    pub samples: u32,
    /// Where several texels make a pixel, it is their samples together that are so many.
    pub samples_by_area: bool,
    /// Levels by which the cache is coarser.
    pub mip_bias: f32,
    /// Steps through the layer's thickness.
    pub march_steps: u32,
    /// How the cache is read.
    pub filter: FrameFilter,
}

impl Recipe {
    /// The baseline: eight samples a pixel, 192 steps, no cache.
    #[must_use]
    pub fn screen_space() -> Self {
        Self {
            renderer: RendererKind::ScreenSpace,
            samples: 8,
            samples_by_area: false,
            mip_bias: 0.0,
            march_steps: 192,
            filter: FrameFilter::CatmullRom,
        }
    }
}

/// A picture of the default scene from the default camera's place, looking 25° up, with how many texels were updated.
///
/// # Errors
/// When there is no device that renders it.
pub fn picture(recipe: Recipe, size: FrameSize) -> anyhow::Result<(RgbImage, u64)> {
    let mut config = RenderConfig::new(target_dir()?.join("noise-of-tests"));
    config.cache_memory_mib = 1024;
    let mut still = StillRenderer::new(config, Arc::default(), &[])?;
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0)?;
    let settings = StillSettings {
        renderer: recipe.renderer,
        march: MarchSettings {
            steps: recipe.march_steps,
            ..MarchSettings::default()
        },
        samples: recipe.samples,
        samples_by_area: recipe.samples_by_area,
        mip_bias: recipe.mip_bias,
        filter: recipe.filter,
        ..StillSettings::default()
    };
    let made = still.render_with(camera, size, &settings, |_| {})?;
    let picture = without_alpha(&made.display, size)?;
    Ok((picture, still.totals().texels_updated))
}
