//! One picture without a server: the same renderer, driven until nothing is left to do.

use super::interface::{RenderTotals, ViewRequest};
use super::renderer::SkyRenderer;
use crate::composite::{Picture, composite_key, ground_key};
use crate::config::{PlacedCell, RenderConfig};
use crate::gpu::{Gpu, GpuError, TimedPass, read_buffer_blocking};
use skycell_protocol::{Camera, Codec, FrameSize, RendererKind, Scene, ViewerId};
use std::sync::Arc;

/// Tiles marched between two reports of progress.
const BATCH_TILES: usize = 32;
/// Device time of a strip of the screen-space renderer between two reports, ns.
const STRIP_NS: u64 = 400_000_000;
/// The only viewer.
pub(super) const VIEWER: ViewerId = ViewerId(1);

/// A finished picture.
#[derive(Clone, Debug, PartialEq)]
pub enum StillPixels {
    /// Tone-mapped sRGB, 4 bytes a pixel.
    Display(Vec<u8>),
    /// Linear radiance per W/(m² nm) of the sun's spectrum, 4 floats a pixel.
    Linear(Vec<f32>),
}

/// Renders single pictures of one scene.
pub struct StillRenderer {
    pub(super) renderer: SkyRenderer,
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

    /// Sums of what was done so far.
    #[must_use]
    pub fn totals(&self) -> RenderTotals {
        self.renderer.stats(0.0).totals
    }

    /// Renders a picture; `progress` gets the share that is done.
    ///
    /// # Errors
    /// When the device is lost or the picture does not fit on it.
    pub fn render(
        &mut self,
        camera: Camera,
        size: FrameSize,
        kind: RendererKind,
        linear: bool,
        mut progress: impl FnMut(f64),
    ) -> Result<StillPixels, GpuError> {
        let renderer = &mut self.renderer;
        renderer.leave(VIEWER);
        renderer.join(
            VIEWER,
            ViewRequest {
                size,
                fps: 1.0,
                codec: Codec::Png,
                jpeg_quality: 100,
                camera,
                renderer: kind,
            },
        );
        let filter = renderer.frame_filter;
        // A camera in or above the clouds is rendered with rays of its own, whatever was asked for.
        let screen_space = renderer
            .viewers
            .get(&VIEWER)
            .is_some_and(|viewer| viewer.kind == RendererKind::ScreenSpace);
        let key = composite_key(filter, renderer.active.len(), screen_space, linear);
        renderer.pipelines.prepare(&renderer.gpu, key)?;
        renderer.pipelines.prepare(&renderer.gpu, ground_key(key))?;
        renderer.refresh_cells();
        if screen_space {
            let samples = f64::from(renderer.config.samples);
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
        let picture = Picture::new(&renderer.gpu, &renderer.pipelines, size, linear);
        renderer.composite_still(VIEWER, &picture, key)?;
        let bytes = read_buffer_blocking(&renderer.gpu, picture.pixels())?;
        Ok(if linear {
            StillPixels::Linear(bytemuck::pod_collect_to_vec(&bytes))
        } else {
            StillPixels::Display(bytes)
        })
    }

    /// GPU time of the cache, of composites and of the screen-space renderer so far, ns.
    #[must_use]
    pub fn gpu_times_ns(&self) -> [u64; 3] {
        [
            TimedPass::Cache,
            TimedPass::Composite,
            TimedPass::ScreenSpace,
        ]
        .map(|pass| self.renderer.gpu_time(pass).0)
    }
}
