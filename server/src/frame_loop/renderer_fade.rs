//! Between rays of a viewer's own and the cache: its last picture goes into those that follow, so that nothing pops.

use super::renderer::SkyRenderer;
use super::transitions::PICTURES_BYTES_MAX;
use super::viewers_on_device::ActiveViewer;
use crate::composite::{Mix, PictureFade, dither_shift};
use skycell_protocol::{Camera, CellId, ViewerId};

/// From one to the other a viewer at rest goes in this time, s.
const RENDERER_FADE_S: f64 = 1.0;
/// Time that passes between two pictures at most, s: a loop that was held up shows no jump.
const FRAME_MAX_S: f64 = 0.1;
/// A motion that hides the whole way hides this share of one between cells: the last picture stays where it was seen, and what
/// has moved by more than some pixels would be seen twice.
const HIDING_SHARE: f64 = 0.1;

/// A viewer's way from one to the other.
pub(super) struct RendererFade {
    fade: PictureFade,
    /// Share of the new pictures.
    share: f64,
    /// Of the kept picture, where it shows clouds alone.
    pre_exposure: f32,
    /// The camera when time last passed.
    camera: Camera,
    /// Frames that the viewer had then: a way begins with the first one that is made the new way.
    frames: u64,
}

impl SkyRenderer {
    /// Keeps a viewer's last picture, of a cell, to be mixed with those that follow. None where it has none, or moves so fast that nothing
    /// of it is seen at its place any more.
    pub(super) fn renderer_fade(&mut self, id: ViewerId, shown: CellId) -> Option<RendererFade> {
        let viewer = self.viewers.get(&id)?;
        let bytes = PictureFade::bytes_of(viewer.view.picture_size(), viewer.picture.format());
        let hidden = self.hidden_between(&viewer.shown_camera, &viewer.view.camera);
        let is_seen = viewer.frames_composited > 0
            && (viewer.transition.is_none() || viewer.shows_rays_on_its_way())
            && hidden < 1.0
            && !viewer.view.linear;
        if !is_seen || self.fade_bytes() + bytes > PICTURES_BYTES_MAX {
            return None;
        }
        let fade = PictureFade::new(&self.gpu, &self.pipelines, &viewer.picture);
        let label = Some("keep a picture");
        let descriptor = wgpu::CommandEncoderDescriptor { label };
        let mut encoder = self.gpu.device.create_command_encoder(&descriptor);
        let (from, to) = (viewer.picture.pixels(), fade.old().pixels());
        encoder.copy_buffer_to_buffer(from, 0, to, 0, to.size());
        let (camera, frames) = (viewer.shown_camera, viewer.frames_composited);
        let pre_exposure = self.pre_exposure_in(shown);
        self.submit(encoder);
        Some(RendererFade {
            fade,
            share: 0.0,
            pre_exposure,
            camera,
            frames,
        })
    }

    /// Share of a way that the motion from one camera to another hides.
    fn hidden_between(&self, before: &Camera, now: &Camera) -> f64 {
        self.motion_between(before, now) / HIDING_SHARE
    }

    /// Lets time pass for viewers between rays and cache. Returns those whose frames show something else for that.
    pub(super) fn pass_renderer_fades(&mut self, passed_s: f64) -> Vec<ViewerId> {
        let fading = self.viewers.iter();
        let fading = fading.filter(|(_, viewer)| viewer.renderer_fade.is_some());
        let ids: Vec<ViewerId> = fading.map(|(id, _)| *id).collect();
        for id in &ids {
            let Some(mut viewer) = self.viewers.remove(id) else {
                continue;
            };
            if let Some(mut way) = viewer.renderer_fade.take() {
                let camera = viewer.view.camera;
                way.share += self.hidden_between(&way.camera, &camera);
                way.camera = camera;
                if viewer.frames_composited > way.frames {
                    way.share += passed_s.min(FRAME_MAX_S) / RENDERER_FADE_S;
                }
                let is_alone = viewer.transition.is_none() || viewer.shows_rays_on_its_way();
                let stays = is_alone && viewer.picture.eyes() == way.fade.old().eyes();
                viewer.renderer_fade = Some(way).filter(|way| stays && way.share < 1.0);
            }
            self.viewers.insert(*id, viewer);
        }
        ids
    }

    /// Records the mix of the last picture into the present one.
    pub(super) fn record_renderer_fade(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        viewer: &ActiveViewer,
    ) {
        if let Some(way) = &viewer.renderer_fade {
            let (gpu, pipelines) = (&self.gpu, &self.pipelines);
            let mix = Mix {
                share: way.share,
                dither_shift: dither_shift(viewer.view.codec),
                old_scale: self.pre_exposure_in(viewer.cell) / way.pre_exposure,
            };
            (way.fade).record(gpu, encoder, &mut self.timing, pipelines, mix);
            self.counters.dispatches += 1;
        }
    }
}
