//! Viewers of one cell while simulated time passes: what wind and turning heads cost, without a clock.

use super::auditing::AuditedTexel;
use super::interface::ViewRequest;
use super::still::{BATCH_TILES, StillRenderer};
use super::still_settings::StillSettings;
use crate::cells::{CellLimit, Cells};
use crate::composite::{Picture, composite_key, ground_key, with_parallax};
use crate::gpu::{GpuError, PipelineKey, read_buffer_blocking};
use crate::march::AUDIT_TEXELS_MAX;
use skycell_protocol::{Camera, FrameSize, InputSequence, RendererKind, Scene, ViewerId};
use skycell_shaders::Features;
use std::sync::Arc;
use std::time::Instant;

/// Viewers who share a cell and stay while time passes.
#[derive(Debug)]
pub struct LivingViewers {
    ids: Vec<ViewerId>,
    size: FrameSize,
    settings: StillSettings,
}

impl StillRenderer {
    /// Lets viewers share a cell from now on, with empty caches.
    ///
    /// # Errors
    /// When a pipeline cannot be made.
    pub fn begin_living(
        &mut self,
        cameras: &[Camera],
        size: FrameSize,
        settings: &StillSettings,
    ) -> Result<LivingViewers, GpuError> {
        self.begin(settings)?;
        let renderer = &mut self.renderer;
        renderer.cells = Cells::new(&[], CellLimit::default());
        let ids: Vec<ViewerId> = (1..).map(ViewerId).take(cameras.len()).collect();
        for (id, camera) in ids.iter().zip(cameras) {
            let view = ViewRequest {
                size,
                fps: 1.0,
                codec: settings.codec,
                jpeg_quality: 100,
                camera: *camera,
                renderer: RendererKind::Cached,
                quality: None,
                show: settings.show,
            };
            renderer.join(*id, view);
        }
        let viewers = LivingViewers {
            ids,
            size,
            settings: *settings,
        };
        let key = self.living_key(&viewers);
        let renderer = &mut self.renderer;
        for key in [key, with_parallax(key)] {
            renderer.pipelines.prepare(&renderer.gpu, key)?;
            renderer.pipelines.prepare(&renderer.gpu, ground_key(key))?;
        }
        // They come together to where their mean is.
        renderer.regroup(0.0);
        Ok(viewers)
    }

    fn living_key(&self, viewers: &LivingViewers) -> PipelineKey {
        let renderer = &self.renderer;
        let blend = renderer.blend();
        let key = composite_key(&renderer.scene, viewers.settings.filter, blend, false, false);
        PipelineKey {
            features: Features {
                shared_background: viewers.settings.shared_background,
                ..key.features
            },
            ..key
        }
    }

    /// Marches until nothing is left to do, as the sky is now.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn settle_living(&mut self) -> Result<(), GpuError> {
        self.march_all(false, |_| {})
    }

    /// One turn: time has passed, viewers look elsewhere, at most so many tiles are marched. Returns how many were.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn turn_living(
        &mut self,
        viewers: &LivingViewers,
        cameras: &[Camera],
        passed_s: f64,
        tiles_max: usize,
    ) -> Result<u64, GpuError> {
        let renderer = &mut self.renderer;
        renderer.advance_time(passed_s);
        for (id, camera) in viewers.ids.iter().zip(cameras) {
            renderer.set_camera(*id, InputSequence(1), *camera);
        }
        renderer.regroup(passed_s);
        renderer.look_up_all();
        renderer.refresh_cells();
        while renderer.update_sun_volumes(BATCH_TILES) {
            renderer.gpu.wait()?;
        }
        let mut marched = 0;
        // A tile takes one sample a batch.
        while marched < tiles_max {
            let updates = renderer.march((tiles_max - marched).min(BATCH_TILES)).len();
            renderer.gpu.wait()?;
            if updates == 0 {
                break;
            }
            marched += updates;
        }
        let cells: Vec<_> = renderer.active_cells.keys().copied().collect();
        for cell in cells {
            renderer.caches.frame_shown(cell);
        }
        renderer.refresh_cells();
        Ok(marched as u64)
    }

    /// The scene is another, and nobody tells the caches.
    ///
    /// # Errors
    /// When a pipeline cannot be made or the device is lost.
    pub fn pretend_living(&mut self, scene: Arc<Scene>) -> Result<(), GpuError> {
        let renderer = &mut self.renderer;
        renderer.prepare_pipelines(&scene)?;
        renderer.scene = scene;
        renderer.take_maps();
        let altitude_m = renderer.active.first().map(|layer| layer.proxy_altitude_m);
        renderer.take_light(altitude_m.unwrap_or_default());
        renderer.look_up_all();
        renderer.refresh_cells();
        while renderer.update_sun_volumes(BATCH_TILES) {
            renderer.gpu.wait()?;
        }
        Ok(())
    }

    /// Every tile takes one sample more.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn refresh_living(&mut self) -> Result<(), GpuError> {
        self.renderer.caches.refresh_all();
        self.march_all(false, |_| {})
    }

    /// What a viewer sees, as it is shown: 4 bytes a pixel.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn show_living(
        &mut self,
        viewers: &LivingViewers,
        viewer: usize,
    ) -> Result<Vec<u8>, GpuError> {
        let gone = || GpuError::Device("the viewer of the picture is gone".into());
        let id = *viewers.ids.get(viewer).ok_or_else(gone)?;
        let key = self.living_key(viewers);
        let renderer = &mut self.renderer;
        let active = renderer.viewers.get(&id).ok_or_else(gone)?;
        let key = renderer.key_for(active, active.cell, key);
        let picture = Picture::new(&renderer.gpu, &renderer.pipelines, viewers.size, false);
        renderer.composite_still(id, &picture, key, None)?;
        read_buffer_blocking(&renderer.gpu, picture.pixels())
    }

    /// Marches so many texels of what viewers want again, and tells how far the cache is from them, percent.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn audit_living(&mut self, texels: usize) -> Result<Vec<AuditedTexel>, GpuError> {
        let renderer = &mut self.renderer;
        let mut found = Vec::new();
        renderer.refresh_cells();
        while found.len() < texels && renderer.audit((texels - found.len()).min(AUDIT_TEXELS_MAX)) > 0 {
            renderer.gpu.wait()?;
            found.extend(renderer.collect_audit(Instant::now()));
        }
        Ok(found)
    }
}
