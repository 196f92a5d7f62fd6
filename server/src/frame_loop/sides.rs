//! Viewers in, between and above layers: for whom the caches of a cell hold, and what their frames need beside those of
//! viewers below all clouds.

#[cfg(test)]
mod tests;

use super::cells_on_device::ActiveCell;
use super::clouds::of_codec;
use super::interface::ViewRequest;
use super::renderer::{SkyRenderer, frame_key};
use super::transitions::PICTURES_BYTES_MAX;
use super::viewers_on_device::ActiveViewer;
use crate::cells::Storeys;
use crate::composite::{PictureFade, dither_shift, with_above, with_parallax};
use crate::config::FrameFilter;
use crate::gpu::PipelineKey;
use crate::march::{LayerBlend, Side, active_layers, layer_bounds_m};
use skycell_protocol::{Camera, CellId, Codec, RendererKind, Scene, ViewerId};

/// From rays back to the cache, a camera goes this far out of a layer, m.
const RETURN_MARGIN_M: f64 = 50.0;
/// And no further than this share of the base's altitude, below it, or of the layer's thickness, above: fog lies low, and
/// sheets are thin.
const RETURN_SHARE: f64 = 0.1;

/// From rays of its own to the cache a viewer at rest goes in this time, s.
const RENDERER_FADE_S: f64 = 1.0;

/// A viewer's way from rays of its own to the cache: its last picture of them goes into those of the cache.
pub(super) struct RendererFade {
    fade: PictureFade,
    /// Share of the cache's picture.
    share: f64,
    /// Of the kept picture, where it shows clouds alone.
    pre_exposure: f32,
    /// From where the last picture was seen. Motion hides the change, and it would be seen twice.
    camera: Camera,
}

impl SkyRenderer {
    /// Keeps a viewer's last picture by rays, to be mixed with those of the cache that follow. None where it has none.
    pub(super) fn renderer_fade(&mut self, id: ViewerId) -> Option<RendererFade> {
        let viewer = self.viewers.get(&id)?;
        let bytes = PictureFade::bytes_of(viewer.view.picture_size(), viewer.picture.format());
        let is_seen = viewer.frames_composited > 0
            && viewer.shown_camera == viewer.view.camera
            && viewer.transition.is_none();
        if !is_seen || self.fade_bytes() + bytes > PICTURES_BYTES_MAX {
            return None;
        }
        let fade = PictureFade::new(&self.gpu, &self.pipelines, &viewer.picture);
        let label = Some("keep a picture");
        let descriptor = wgpu::CommandEncoderDescriptor { label };
        let mut encoder = self.gpu.device.create_command_encoder(&descriptor);
        let (from, to) = (viewer.picture.pixels(), fade.old().pixels());
        encoder.copy_buffer_to_buffer(from, 0, to, 0, to.size());
        let camera = viewer.shown_camera;
        let pre_exposure = self.pre_exposure_in(viewer.cell);
        self.submit(encoder);
        Some(RendererFade {
            fade,
            share: 0.0,
            pre_exposure,
            camera,
        })
    }

    /// Lets time pass for viewers between rays and cache. Returns those whose frames show something else for that.
    pub(super) fn pass_renderer_fades(&mut self, passed_s: f64) -> Vec<ViewerId> {
        let mut changed = Vec::new();
        for (id, viewer) in &mut self.viewers {
            let Some(mut way) = viewer.renderer_fade.take() else {
                continue;
            };
            changed.push(*id);
            way.share += passed_s / RENDERER_FADE_S;
            let stays = viewer.kind == RendererKind::Cached
                && viewer.transition.is_none()
                && viewer.view.camera == way.camera
                && viewer.picture.eyes() == way.fade.old().eyes();
            viewer.renderer_fade = Some(way).filter(|way| stays && way.share < 1.0);
        }
        changed
    }

    /// Records the mix of the last picture by rays into that of the cache.
    pub(super) fn record_renderer_fade(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        viewer: &ActiveViewer,
    ) {
        if let Some(way) = &viewer.renderer_fade {
            let (gpu, pipelines) = (&self.gpu, &self.pipelines);
            let shift = dither_shift(viewer.view.codec);
            let old_scale = self.pre_exposure_in(viewer.cell) / way.pre_exposure;
            let timing = &mut self.timing;
            (way.fade).record(gpu, encoder, timing, pipelines, way.share, shift, old_scale);
            self.counters.dispatches += 1;
        }
    }

    /// On which side of each layer an altitude is.
    pub(super) fn sides_at(&self, altitude_m: f64) -> Vec<Side> {
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        let sides = bounds_m.into_iter();
        sides.map(|between| Side::of(between, altitude_m)).collect()
    }

    /// Whether an altitude is in no layer; with a margin for a camera that comes out of one.
    fn is_between_layers(&self, altitude_m: f64, comes_out: bool) -> bool {
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        bounds_m.into_iter().all(|[base_m, top_m]| {
            let margin = |of_m: f64| {
                if comes_out {
                    (RETURN_SHARE * of_m).min(RETURN_MARGIN_M)
                } else {
                    0.0
                }
            };
            altitude_m < base_m - margin(base_m) || altitude_m > top_m + margin(top_m - base_m)
        })
    }

    /// The renderer for a view. The cache of a layer holds on the side of it on which its rays start, below or above: in a
    /// layer a viewer gets rays of its own. `before`: the one that made its frames so far; from rays back to the cache it goes
    /// a little farther than the other way, so that a camera on the boundary does not change between them all the time.
    pub(super) fn kind_of(&self, view: &ViewRequest, before: Option<RendererKind>) -> RendererKind {
        let altitude_m = view.camera.position_m()[1];
        let comes_out = before == Some(RendererKind::ScreenSpace);
        if self.is_between_layers(altitude_m, comes_out) {
            view.renderer
        } else {
            RendererKind::ScreenSpace
        }
    }

    /// Whether the caches of a cell hold for an eye at an altitude: it is on the side of each layer on which their rays start.
    pub(super) fn reaches(&self, cell: &ActiveCell, altitude_m: f64) -> bool {
        let sides = self.sides_at(altitude_m);
        !sides.contains(&Side::Within) && sides == self.sides_at(cell.reference_m.y)
    }

    /// The same of a cell by its number.
    pub(super) fn is_reached(&self, cell: CellId, altitude_m: f64) -> bool {
        let cell = self.active_cells.get(&cell);
        cell.is_some_and(|cell| self.reaches(cell, altitude_m))
    }

    /// Whether some layer is below an altitude.
    pub(super) fn looks_down(&self, altitude_m: f64) -> bool {
        self.sides_at(altitude_m).contains(&Side::Above)
    }

    /// Whether a layer's anchor is on the side of the layer on which rays start. In the layer nothing is kept of it.
    pub(super) fn is_anchored_aright(&self, cell: &ActiveCell, layer: usize) -> bool {
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        bounds_m.get(layer).is_some_and(|between_m| {
            let starts = Side::of(*between_m, cell.reference_m.y);
            let anchor_m = cell.frame.altitude_m(self.anchor_m(cell, layer));
            starts == Side::Within || starts == Side::of(*between_m, anchor_m)
        })
    }

    /// Tells the cells where layers are: nobody on one side of a layer shares what is seen from another.
    pub(super) fn tell_storeys(&mut self) {
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        self.cells.set_storeys(Storeys::of(&bounds_m));
    }

    /// What frames of a scene need that look down on a layer.
    pub(super) fn above_keys(&self, scene: &Scene) -> Vec<PipelineKey> {
        let blend = LayerBlend::of(scene, &active_layers(scene), &self.kept_on);
        let of_filter = |filter| {
            let above = with_above(frame_key(&self.gpu, scene, filter, blend, false));
            [above, with_parallax(above)]
        };
        FrameFilter::ALL.into_iter().flat_map(of_filter).collect()
    }

    /// The same as a view's codec needs it.
    fn above_keys_of(&self, view: &ViewRequest) -> Vec<PipelineKey> {
        let mut keys = self.above_keys(&self.scene);
        if view.codec == Codec::Clouds {
            let alone = |key: &PipelineKey| of_codec(*key, view.codec, view.haze);
            let alone: Vec<PipelineKey> = keys.iter().map(alone).collect();
            keys.extend(alone);
        }
        keys
    }

    /// Whether some viewer looks down on a layer, or is about to.
    pub(super) fn somebody_looks_down(&self) -> bool {
        let bounds_m = layer_bounds_m(&self.scene, &self.active);
        self.viewers.values().any(|viewer| {
            let altitude_m = viewer.view.camera.position_m()[1];
            viewer.view.renderer == RendererKind::Cached
                && (bounds_m.iter()).any(|between| Side::of(*between, altitude_m) != Side::Below)
        })
    }

    /// Whether the pipelines of a view's frames are there. Those of viewers above a layer are made when the first comes there.
    pub(super) fn can_be_shown(&self, view: &ViewRequest) -> bool {
        let altitude_m = view.camera.position_m()[1];
        let is_made = |key: PipelineKey| self.pipelines.get(key).is_some();
        !self.looks_down(altitude_m) || self.above_keys_of(view).into_iter().all(is_made)
    }

    /// Has the pipelines of a view that is about to look down on a layer made, beside the frames.
    pub(super) fn prepare_above(&mut self, view: &ViewRequest) {
        let altitude_m = view.camera.position_m()[1];
        let sides = self.sides_at(altitude_m);
        if view.renderer == RendererKind::Cached && sides.iter().any(|side| *side != Side::Below) {
            let keys = self.above_keys_of(view);
            self.pipelines.prepare_later(&self.gpu, keys);
        }
    }
}
