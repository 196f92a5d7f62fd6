//! Viewers who ask for clouds alone. What their frames need is made beside the frames when the first of them comes; before, and
//! where nobody asks, nothing of it exists.

use super::renderer::{SkyRenderer, frame_key};
use super::viewers_on_device::ActiveViewer;
use crate::composite::{
    PictureFormat, clouds_key, fade_key_of, ground_key, pre_exposure, with_parallax,
};
use crate::config::FrameFilter;
use crate::gpu::PipelineKey;
use crate::march::LayerBlend;
use skycell_protocol::{CellId, Codec, Scene};
use skycell_shaders::Shown;
use std::collections::BTreeSet;

/// Why a viewer who asks for clouds alone is sent nothing yet.
pub(super) const BEING_MADE: &str =
    "what makes clouds alone is being made; frames come when it is there";

/// A composite, or a mix, as the frames of a codec need it.
pub(super) fn of_codec(key: PipelineKey, codec: Codec, haze: bool) -> PipelineKey {
    match PictureFormat::of(codec) {
        PictureFormat::Clouds => clouds_key(key, haze),
        PictureFormat::Display | PictureFormat::Linear => key,
    }
}

impl SkyRenderer {
    /// In which ways viewers ask for clouds alone: with haze, without.
    pub(super) fn clouds_asked(&self) -> BTreeSet<bool> {
        let views = self.viewers.values().map(|viewer| viewer.view);
        views
            .filter(|view| view.codec == Codec::Clouds)
            .map(|view| view.haze)
            .collect()
    }

    /// What those viewers' frames of a scene need, wherever they are below its layers.
    pub(super) fn clouds_keys(&self, scene: &Scene, blend: LayerBlend) -> Vec<PipelineKey> {
        let asked = self.clouds_asked();
        let mut keys: Vec<PipelineKey> = asked
            .iter()
            .map(|_| fade_key_of(PictureFormat::Clouds))
            .collect();
        for haze in asked {
            for filter in FrameFilter::ALL {
                for screen_space in [false, true] {
                    let plain = frame_key(&self.gpu, scene, filter, blend, screen_space);
                    let key = clouds_key(plain, haze);
                    keys.extend([key, ground_key(key), with_parallax(key)]);
                }
            }
        }
        keys
    }

    /// What a viewer's frames come to need, if it asks for clouds alone.
    pub(super) fn own_clouds_keys(&self, viewer: &ActiveViewer) -> Vec<PipelineKey> {
        if viewer.view.codec != Codec::Clouds {
            return Vec::new();
        }
        let mut keys = self.possible_keys(viewer, Shown::Picture);
        keys.push(fade_key_of(PictureFormat::Clouds));
        keys
    }

    /// Whether a viewer cannot be sent what it asks for yet.
    pub(super) fn waits_for_clouds(&self, viewer: &ActiveViewer) -> bool {
        let keys = self.own_clouds_keys(viewer);
        keys.into_iter()
            .any(|key| self.pipelines.get(key).is_none())
    }

    /// What the colours of clouds alone are multiplied by that are composited from a cell now.
    pub(super) fn pre_exposure_in(&self, cell: CellId) -> f32 {
        let exposure = self.active_cells.get(&cell).map_or(1.0, |c| c.exposure);
        pre_exposure(exposure)
    }
}
