//! Several viewers of one cell without a server: how they come together.

use super::interface::ViewRequest;
use super::still::StillRenderer;
use super::still_settings::StillSettings;
use crate::cells::{CellLimit, Cells};
use crate::composite::composite_key;
use crate::gpu::PipelineKey;
use skycell_protocol::{Camera, FrameSize, RendererKind, ViewerId};
use skycell_shaders::Features;

impl StillRenderer {
    /// Lets viewers share cells no wider than a limit from now on. Nobody else is there.
    pub(super) fn join_together(
        &mut self,
        cameras: &[Camera],
        size: FrameSize,
        settings: &StillSettings,
        limit: CellLimit,
    ) -> Vec<ViewerId> {
        let renderer = &mut self.renderer;
        let before: Vec<ViewerId> = renderer.viewers.keys().copied().collect();
        for id in before {
            renderer.leave(id);
        }
        renderer.cells = Cells::new(&[], limit);
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
                stereo: None,
                haze: true,
                linear: false,
            };
            renderer.join(*id, view);
        }
        ids
    }

    /// The composite of their frames at the reference.
    pub(super) fn key_together(&self, settings: &StillSettings) -> PipelineKey {
        let renderer = &self.renderer;
        let blend = renderer.blend();
        let key = composite_key(&renderer.scene, settings.filter, blend, false, false);
        PipelineKey {
            features: Features {
                shared_background: settings.shared_background,
                ..key.features
            },
            ..key
        }
    }
}
