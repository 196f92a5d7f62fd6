//! The screen-space renderer's work for one viewer: samples of layers in strips of rows, so that the device can serve
//! others in between.

use super::renderer::SkyRenderer;
use crate::gpu::TimedPass;
use crate::march::{MarchedPixels, layer_features};
use skycell_protocol::{FrameSize, RendererKind, ViewerId};
use skycell_shaders::layout;

/// A picture that is being marched.
#[derive(Debug)]
pub(super) struct ScreenSpaceJob {
    marched: MarchedPixels,
    /// The view when the job began: a camera that moves on is shown by the next job.
    view: layout::View,
    sample: u32,
    layer: u32,
    row: u32,
}

/// A picture's size divided, rounded up.
fn reduced(size: FrameSize, divisor: u32) -> FrameSize {
    let divisor = divisor.max(1);
    // Not larger than what was a size before.
    FrameSize::new(
        size.width().div_ceil(divisor),
        size.height().div_ceil(divisor),
    )
    .unwrap_or(size)
}

/// Rows of the first strip, before any was measured.
const FIRST_ROWS: u32 = 16;

impl ScreenSpaceJob {
    /// A picture of which nothing is marched yet. `view` is that of the picture; rays are as many as its pixels.
    pub(super) fn new(marched: MarchedPixels, view: layout::View) -> Self {
        let size = marched.size();
        Self {
            view: layout::View {
                marched_width: size.width(),
                marched_height: size.height(),
                ..view
            },
            marched,
            sample: 0,
            layer: 0,
            row: 0,
        }
    }

    pub(super) fn marched(&self) -> &MarchedPixels {
        &self.marched
    }

    pub(super) fn view(&self) -> layout::View {
        self.view
    }
}

impl SkyRenderer {
    /// Whether a screen-space viewer's picture lacks samples.
    pub(super) fn screen_space_pending(&self, id: ViewerId) -> bool {
        self.viewers.get(&id).is_some_and(|viewer| {
            viewer.kind == RendererKind::ScreenSpace
                && viewer
                    .screen_space
                    .as_ref()
                    .is_none_or(|job| job.sample < viewer.quality.settings.samples)
        })
    }

    /// Whether the picture under way has at least one whole sample, or there is none.
    pub(super) fn screen_space_is_shown(&self, id: ViewerId) -> bool {
        self.viewers.get(&id).is_some_and(|viewer| {
            viewer
                .screen_space
                .as_ref()
                .is_none_or(|job| job.sample > 0)
        })
    }

    /// Begins a viewer's picture anew, from where it looks now.
    pub(super) fn restart_screen_space(&mut self, id: ViewerId) {
        if let Some(viewer) = self.viewers.get_mut(&id) {
            viewer.screen_space = None;
        }
    }

    /// Marches rows of a viewer's picture for about `budget_ns`; true when a sample of the whole picture is complete.
    pub(super) fn march_screen_space(&mut self, id: ViewerId, budget_ns: u64) -> bool {
        let Some(mut viewer) = self.viewers.remove(&id) else {
            return false;
        };
        let layers = self.active.len() as u32;
        if viewer.screen_space.is_none()
            && let Some(view) = self.view_of(&viewer)
        {
            let size = reduced(viewer.view.size, self.resolution_divisor);
            let layers = self.active.len();
            let marched = MarchedPixels::new(&self.gpu, &self.pipelines, size, layers, None);
            viewer.screen_space = Some(ScreenSpaceJob::new(marched, view));
        }
        let mut complete = false;
        let samples = viewer.quality.settings.samples;
        if let Some(job) = &mut viewer.screen_space {
            if layers == 0 {
                job.sample = samples;
                complete = true;
            } else if job.sample < samples {
                complete = self.march_strip(viewer.cell, job, budget_ns, layers);
            }
        }
        self.viewers.insert(id, viewer);
        complete
    }

    fn march_strip(
        &mut self,
        cell: skycell_protocol::CellId,
        job: &mut ScreenSpaceJob,
        budget_ns: u64,
        layers: u32,
    ) -> bool {
        let size = job.marched.size();
        let (ns, pixels) = self.gpu_time(TimedPass::ScreenSpace);
        let rows = match ns.checked_div(pixels) {
            Some(ns_per_pixel) if ns_per_pixel > 0 => {
                (budget_ns / (ns_per_pixel * u64::from(size.width())).max(1)) as u32
            }
            _ => FIRST_ROWS,
        };
        let left = size.height() - job.row;
        let rows = rows.next_multiple_of(8).clamp(8, left.max(8)).min(left);
        let scene_index = self.active[job.layer as usize].scene_index;
        let features = layer_features(&self.scene, scene_index, &self.cell_settings(cell));
        let mut view = job.view;
        view.width = size.width();
        view.height = size.height();
        view.jitter = f32::from(u8::from(self.settings.jitter));
        view.first_row = job.row;
        view.layer = job.layer;
        view.sample_index = job.sample;
        view.sample_is_first = u32::from(job.sample == 0);
        view.sample_weight = 1.0 / (job.sample + 1) as f32;
        if !self.submit_pixels(cell, &job.marched, features, &view, rows) {
            return false;
        }
        self.watch_submission();
        self.counters.submissions += 1;
        self.counters.dispatches += 1;
        self.counters.screen_space_marches += u64::from(rows) * u64::from(size.width());
        job.row += rows;
        if job.row < size.height() {
            return false;
        }
        job.row = 0;
        job.layer += 1;
        if job.layer < layers {
            return false;
        }
        job.layer = 0;
        job.sample += 1;
        true
    }
}
