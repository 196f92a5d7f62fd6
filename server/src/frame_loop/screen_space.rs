//! The screen-space renderer's work for one viewer: frames of a temporal window, or samples of a single picture, in strips
//! of rows, so that the device can serve others in between. For who is in a layer and reads the cache, of that layer's near part.

use super::passes::ground_radius_m;
use super::renderer::SkyRenderer;
use super::viewers_on_device::ActiveViewer;
use crate::composite::first_ground_row;
use crate::gpu::TimedPass;
use crate::march::{
    CellFrame, MarchedPixels, TemporalWindow, WindowPlan, WindowRing, WindowStrip, fitting_window,
    layer_features,
};
use glam::DVec3;
use skycell_protocol::{Camera, CellId, ViewerId};
use skycell_shaders::{Features, layout};

/// How screen-space pictures come about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum WindowChoice {
    /// As a viewer's quality sets it.
    ByQuality,
    /// By a window, or by samples that add up to a picture.
    Fixed(Option<WindowPlan>),
}

/// A viewer's frames over the last moments.
#[derive(Debug)]
struct JobWindow {
    window: TemporalWindow,
    ring: WindowRing,
    /// Place that the slices' cameras are told in.
    cell: CellId,
    frame: CellFrame,
}

/// What one eye sees of a picture that is being marched.
#[derive(Debug)]
pub(super) struct EyeJob {
    marched: MarchedPixels,
    /// The view that is shown, and that of what is under way: a camera that moves on is shown by the next frame.
    view: layout::View,
    next_view: layout::View,
    window: Option<JobWindow>,
}

impl EyeJob {
    pub(super) fn marched(&self) -> &MarchedPixels {
        &self.marched
    }

    pub(super) fn view(&self) -> layout::View {
        self.view
    }
}

/// A picture that is being marched.
#[derive(Debug)]
pub(super) struct ScreenSpaceJob {
    /// One, or the left and the right one, of which a sample is complete together.
    eyes: Vec<EyeJob>,
    /// The layers that are marched, by their places among the active ones.
    layers: Vec<u32>,
    /// The camera of what is shown, and that of what is under way.
    camera: Camera,
    next_camera: Camera,
    /// Whether there is something to show.
    is_shown: bool,
    /// Whether its rays start beside the eye.
    has_moved_start: bool,
    /// Whole samples, or frames, since the view or the scene changed.
    sample: u32,
    eye: usize,
    layer: usize,
    row: u32,
}

/// Rows of the first strip, before any was measured.
const FIRST_ROWS: u32 = 16;

impl ScreenSpaceJob {
    /// A picture of which nothing is marched yet, of some of the active layers. `view` is that of the picture; rays are as many as
    /// its pixels.
    pub(super) fn new(
        camera: Camera,
        layers: Vec<u32>,
        eyes: impl IntoIterator<Item = (MarchedPixels, layout::View)>,
    ) -> Self {
        let eyes = eyes.into_iter().map(|(marched, view)| EyeJob {
            marched,
            view,
            next_view: view,
            window: None,
        });
        Self {
            eyes: eyes.collect(),
            layers,
            camera,
            next_camera: camera,
            is_shown: false,
            has_moved_start: false,
            sample: 0,
            eye: 0,
            layer: 0,
            row: 0,
        }
    }

    pub(super) fn eyes(&self) -> &[EyeJob] {
        &self.eyes
    }

    /// The layers that are marched.
    #[cfg(test)]
    pub(super) fn marched_layers(&self) -> &[u32] {
        &self.layers
    }

    /// The camera of what is shown, where there is something.
    pub(super) fn shown_from(&self) -> Option<Camera> {
        self.is_shown.then_some(self.camera)
    }

    /// Whether all frames of its window are there, in each eye.
    pub(super) fn is_full(&self) -> bool {
        let is_full = |eye: &EyeJob| {
            let own = eye.window.as_ref();
            own.is_none_or(|own| own.window.filled() == own.window.plan().frames)
        };
        self.is_shown && self.eyes.iter().all(is_full)
    }

    /// Whether the next strip is the first one of a frame.
    pub(super) fn begins(&self) -> bool {
        [self.eye, self.layer] == [0; 2] && self.row == 0
    }

    fn window(&self) -> Option<&JobWindow> {
        self.eyes.first()?.window.as_ref()
    }

    /// Samples or frames after which nothing is left to do for a view at rest.
    fn samples_wanted(&self, samples: u32) -> u32 {
        self.window()
            .map_or(samples, |own| own.window.plan().frames)
    }

    /// Where rays start beside the eye, each frame has a view of its own, and there is no last one.
    fn follow(&mut self, camera: Camera, views: &[layout::View]) {
        self.look(camera, views);
        self.has_moved_start = true;
    }

    /// What the next frame shows, if something else than before. What is under way is given up.
    fn look(&mut self, camera: Camera, views: &[layout::View]) {
        self.next_camera = camera;
        self.has_moved_start = false;
        for (eye, view) in self.eyes.iter_mut().zip(views) {
            eye.next_view = *view;
        }
        self.sample = 0;
        self.eye = 0;
        self.layer = 0;
        self.row = 0;
    }
}

impl SkyRenderer {
    /// Whether a screen-space viewer's picture lacks samples.
    pub(super) fn screen_space_pending(&self, id: ViewerId) -> bool {
        self.viewers.get(&id).is_some_and(|viewer| {
            self.marches_pixels(viewer)
                && viewer.screen_space.as_ref().is_none_or(|job| {
                    viewer.marches_on_its_way()
                        || job.sample < job.samples_wanted(viewer.quality.settings.samples)
                })
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

    /// Begins a viewer's picture anew, from where it looks now. A window goes on and reprojects what it has.
    pub(super) fn restart_screen_space(&mut self, id: ViewerId) {
        let Some(mut viewer) = self.viewers.remove(&id) else {
            return;
        };
        let views = self.views_of(&viewer);
        let place = self.place_of(&viewer);
        let layers = self.layers_marched_for(&viewer);
        let camera = viewer.view.camera;
        let goes_on = match (&mut viewer.screen_space, views, place) {
            (Some(job), Some(views), Some((cell, frame))) => match job.window() {
                Some(own) if own.cell == cell && own.frame == frame && job.layers == layers => {
                    job.look(camera, &views);
                    true
                }
                _ => false,
            },
            _ => false,
        };
        if !goes_on {
            viewer.screen_space = None;
        }
        self.viewers.insert(id, viewer);
    }

    /// The scene has changed, but neither the number of its layers nor the picture: windows slide on from the old to the
    /// new one, other pictures begin anew.
    pub(super) fn scene_changed_for_screen_space(&mut self, same_layers: bool) {
        for viewer in self.viewers.values_mut() {
            match &mut viewer.screen_space {
                Some(job) if job.window().is_some() && same_layers => {
                    job.look(job.next_camera, &[])
                }
                job => *job = None,
            }
        }
    }

    fn place_of(&self, viewer: &ActiveViewer) -> Option<(CellId, CellFrame)> {
        let cell = self.active_cells.get(&viewer.cell)?;
        Some((viewer.cell, cell.frame))
    }

    /// The window of a viewer's pictures, if they have one.
    pub(super) fn window_plan(&self, viewer: &ActiveViewer) -> Option<WindowPlan> {
        match self.window_choice {
            WindowChoice::Fixed(plan) => plan,
            WindowChoice::ByQuality => Some(viewer.quality.settings.window_plan()),
        }
    }

    fn new_job(&self, viewer: &ActiveViewer) -> Option<ScreenSpaceJob> {
        let views = self.views_of(viewer)?;
        let (cell, frame) = self.place_of(viewer)?;
        let marched_layers = self.layers_marched_for(viewer);
        let (size, layers) = (viewer.view.size, marched_layers.len());
        let marched = || MarchedPixels::new(&self.gpu, &self.pipelines, size, layers, None);
        let eyes = views.into_iter().map(|view| (marched(), view));
        let mut job = ScreenSpaceJob::new(viewer.view.camera, marched_layers, eyes);
        if let Some(plan) = self.window_plan(viewer)
            && layers > 0
        {
            // Two eyes have half of a ring's bytes each.
            let plan = fitting_window(&self.gpu, viewer.view.picture_size(), layers, plan);
            for eye in &mut job.eyes {
                let values = eye.marched.values();
                let ring = WindowRing::new(&self.gpu, &self.pipelines, size, layers, plan, values);
                eye.window = Some(JobWindow {
                    window: TemporalWindow::new(plan),
                    ring,
                    cell,
                    frame,
                });
            }
        }
        Some(job)
    }

    /// Marches rows of a viewer's picture for about `budget_ns`; true when a sample of the whole picture is complete.
    pub(super) fn march_screen_space(&mut self, id: ViewerId, budget_ns: u64) -> bool {
        let Some(mut viewer) = self.viewers.remove(&id) else {
            return false;
        };
        let marched = self.layers_marched_for(&viewer);
        let place = self.place_of(&viewer);
        let is_elsewhere = |job: &ScreenSpaceJob| {
            // Cameras of its frames are told in the place that it began in. Who looks anew is asked about that then.
            viewer.marches_on_its_way()
                && job
                    .window()
                    .is_some_and(|own| Some((own.cell, own.frame)) != place)
        };
        if (viewer.screen_space.as_ref())
            .is_some_and(|job| job.layers != marched || is_elsewhere(job))
        {
            viewer.screen_space = None;
        }
        if viewer.screen_space.is_none() {
            viewer.screen_space = self.new_job(&viewer);
        }
        if viewer.marches_on_its_way() {
            let views = self.views_of(&viewer);
            let camera = viewer.view.camera;
            if let (Some(job), Some(views)) = (&mut viewer.screen_space, views)
                && job.begins()
            {
                job.follow(camera, &views);
            }
        }
        let mut complete = false;
        let samples = viewer.quality.settings.samples;
        if let Some(job) = &mut viewer.screen_space {
            let wanted = job.samples_wanted(samples);
            if job.layers.is_empty() {
                for eye in &mut job.eyes {
                    eye.view = eye.next_view;
                }
                (job.camera, job.is_shown) = (job.next_camera, true);
                job.sample = wanted;
                complete = true;
            } else if job.sample < wanted {
                complete = self.march_strip(viewer.cell, job, budget_ns);
            }
        }
        self.viewers.insert(id, viewer);
        complete
    }

    /// The wind's drifts of layers that are marched.
    fn drifts_of(&self, layers: &[u32]) -> Vec<DVec3> {
        let drift = |layer: &u32| {
            let active = self.active.get(*layer as usize)?;
            self.drifts.get(active.scene_index).copied()
        };
        layers
            .iter()
            .map(|layer| drift(layer).unwrap_or_default())
            .collect()
    }

    fn march_strip(&mut self, cell: CellId, job: &mut ScreenSpaceJob, budget_ns: u64) -> bool {
        let Some(eye) = job.eyes.get_mut(job.eye) else {
            return false;
        };
        let size = eye.marched.size();
        let [width, height] = eye
            .window
            .as_ref()
            .map_or([size.width(), size.height()], |own| own.ring.marched());
        let (ns, pixels) = self.gpu_time(TimedPass::ScreenSpace);
        let rows = match ns.checked_div(pixels) {
            Some(ns_per_pixel) if ns_per_pixel > 0 => {
                (budget_ns / (ns_per_pixel * u64::from(width)).max(1)) as u32
            }
            _ => FIRST_ROWS,
        };
        let left = height - job.row;
        let rows = rows.next_multiple_of(8).clamp(8, left.max(8)).min(left);
        let Some(layer) = job.layers.get(job.layer).copied() else {
            return false;
        };
        let Some(active) = self.active.get(layer as usize) else {
            return false;
        };
        let scene_index = active.scene_index;
        let features = Features {
            moved_start: job.has_moved_start,
            ..layer_features(&self.scene, scene_index, &self.cell_settings(cell))
        };
        let mut view = eye.next_view;
        view.jitter = f32::from(u8::from(self.settings.jitter));
        view.first_row = job.row;
        view.layer = layer;
        view.place = job.layer as u32;
        view.sample_index = job.sample;
        view.sample_is_first = u32::from(job.sample == 0);
        view.sample_weight = 1.0 / (job.sample + 1) as f32;
        let Some(on_device) = self.active_cells.get(&cell) else {
            return false;
        };
        if let Some(own) = &mut eye.window {
            own.window.begin();
            let window = own.window.marched();
            let strip = WindowStrip {
                cell: &on_device.buffers,
                features: on_device.buffers.march_features(features),
                view: &view,
                window: &window,
                rows,
            };
            own.ring
                .submit_strip(&self.gpu, &mut self.timing, &self.pipelines, &strip);
        } else if !self.submit_pixels(cell, &eye.marched, features, &view, rows) {
            return false;
        }
        self.watch_submission();
        self.counters.submissions += 1;
        self.counters.dispatches += 1;
        self.counters.screen_space_marches += u64::from(rows) * u64::from(width);
        job.row += rows;
        if job.row < height {
            return false;
        }
        job.row = 0;
        job.layer += 1;
        if job.layer < job.layers.len() {
            return false;
        }
        job.layer = 0;
        job.eye += 1;
        if job.eye < job.eyes.len() {
            return false;
        }
        job.eye = 0;
        job.sample += 1;
        (job.camera, job.is_shown) = (job.next_camera, true);
        let drifts = self.drifts_of(&job.layers);
        for eye in &mut job.eyes {
            eye.view = eye.next_view;
            self.resolve(eye, &drifts);
        }
        true
    }

    /// Sums an eye's window up for the view that is shown.
    fn resolve(&mut self, job: &mut EyeJob, drifts: &[DVec3]) {
        let Some(own) = &mut job.window else { return };
        own.window.complete(&job.view, drifts);
        let window = own.window.shown(&job.view, drifts);
        // The composite looks up no clouds in the rows below.
        let rows = ground_radius_m(&self.scene, &self.active, &job.view)
            .map_or(job.view.height, |radius_m| {
                first_ground_row(&job.view, radius_m)
            });
        let (gpu, pipelines) = (&self.gpu, &self.pipelines);
        own.ring
            .submit_resolve(gpu, &mut self.timing, pipelines, &job.view, &window, rows);
        self.watch_submission();
        self.counters.submissions += 1;
        self.counters.dispatches += 1;
    }
}
