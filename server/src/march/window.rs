//! The temporal window of a screen-space viewer: which frames it holds and how they are seen from the shown camera.

use super::pattern::{FramePlace, WINDOW_FRAMES_MAX, window_places};
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use skycell_shaders::layout;

/// Layers that a slice can have moved clouds of.
const LAYERS_MAX: usize = 4;
/// Width of the Gaussian by which samples are weighed, in the distance between them.
/// Tuned: the least FLIP of a turning camera (`cargo run --release --example window_costs -- 16,4,3,2,1.5,56`).
const KERNEL_SIGMA: f64 = 0.45;

/// How a picture is spread over frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct WindowPlan {
    /// Frames of the window, 1 to 16.
    pub frames: u32,
    /// Each marched pixel stands for this many columns and rows of the picture: 1, 2 or 4.
    pub divisor: u32,
    /// Into how many parts the steps of the march are shared out: a frame takes one of them, 1 to 16.
    pub depth_segments: u32,
    /// Into how many parts a step of a frame is cut where cloud begins, 1 to 16; 1: steps stay as long as they are.
    pub refinement: u32,
}

impl Default for WindowPlan {
    fn default() -> Self {
        Self {
            frames: 16,
            divisor: 1,
            depth_segments: 16,
            refinement: 1,
        }
    }
}

impl WindowPlan {
    /// The same within its limits.
    #[must_use]
    pub fn bounded(self) -> Self {
        Self {
            frames: self.frames.clamp(1, WINDOW_FRAMES_MAX),
            divisor: self.divisor.clamp(1, 4),
            depth_segments: self.depth_segments.clamp(1, WINDOW_FRAMES_MAX),
            refinement: self.refinement.clamp(1, WINDOW_FRAMES_MAX),
        }
    }
}

/// A frame that has been marched.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Slice {
    position: [f32; 3],
    /// Where its rays started, if that is not the eye.
    start: [f32; 3],
    forward: [f32; 3],
    right: [f32; 3],
    up: [f32; 3],
    /// How far the wind had carried each layer, m.
    drifts: [DVec3; LAYERS_MAX],
}

impl Slice {
    fn of(view: &layout::View, drifts: &[DVec3]) -> Self {
        let mut slice = Self {
            position: view.position,
            start: view.start,
            forward: view.forward,
            right: view.right,
            up: view.up,
            drifts: [DVec3::ZERO; LAYERS_MAX],
        };
        for (to, from) in slice.drifts.iter_mut().zip(drifts) {
            *to = *from;
        }
        slice
    }
}

/// The frames of a window, oldest overwritten first.
#[derive(Clone, Debug, PartialEq)]
pub struct TemporalWindow {
    plan: WindowPlan,
    places: Vec<FramePlace>,
    slices: Vec<Option<Slice>>,
    /// The slice that is or will be marched next.
    next: usize,
}

impl TemporalWindow {
    /// A window that holds nothing.
    #[must_use]
    pub fn new(plan: WindowPlan) -> Self {
        let plan = plan.bounded();
        Self {
            plan,
            places: window_places(plan.frames, plan.divisor),
            slices: vec![None; plan.frames as usize],
            next: 0,
        }
    }

    /// How it was asked for.
    #[must_use]
    pub fn plan(&self) -> WindowPlan {
        self.plan
    }

    /// Frames that can be shown.
    #[must_use]
    pub fn filled(&self) -> u32 {
        self.slices.iter().flatten().count() as u32
    }

    /// A cut: nothing that was marched can be shown any more.
    pub fn forget(&mut self) {
        self.slices.fill(None);
    }

    /// The march of the next frame begins over the oldest one, which is gone.
    pub fn begin(&mut self) {
        self.slices[self.next] = None;
    }

    /// The march of the next frame is complete.
    pub fn complete(&mut self, view: &layout::View, drifts: &[DVec3]) {
        self.slices[self.next] = Some(Slice::of(view, drifts));
        self.next = (self.next + 1) % self.slices.len();
    }

    fn base(&self, newest: usize) -> layout::Window {
        let f32s = |place: [f64; 2]| place.map(|v| v as f32);
        let mut window = layout::Window {
            frames: self.plan.frames,
            newest: newest as u32,
            divisor: self.plan.divisor,
            step_scale: self.plan.depth_segments as f32,
            refinement: self.plan.refinement as f32,
            spread: f32::from(u8::from(self.plan.frames > self.plan.divisor.pow(2))),
            ..Default::default()
        };
        window.newest_pixel = self.places[newest].pixel.map(|p| p as f32);
        for (slice, place) in window.slices.iter_mut().zip(&self.places) {
            slice.segment = place.segment as f32;
            slice.pixel = place.pixel.map(|p| p as f32);
            slice.within = f32s(place.within);
        }
        window
    }

    /// Slices by the pixel that they look through, where every pixel has as many as every other.
    fn order(&self) -> Option<([[u32; 4]; 4], u32)> {
        let pixels = self.plan.divisor * self.plan.divisor;
        let row_by_row = |place: &FramePlace| place.pixel[1] * self.plan.divisor + place.pixel[0];
        let mut slices: Vec<u32> = (0..self.plan.frames).collect();
        slices.sort_by_key(|slice| row_by_row(&self.places[*slice as usize]));
        let each = self.plan.frames / pixels;
        let even = each > 0
            && slices
                .iter()
                .enumerate()
                .all(|(at, slice)| row_by_row(&self.places[*slice as usize]) == at as u32 / each);
        let mut order = [[0; 4]; 4];
        for (at, slice) in slices.iter().enumerate() {
            order[at / 4][at % 4] = *slice;
        }
        even.then_some((order, each))
    }

    /// What the march of the next frame reads.
    #[must_use]
    pub fn marched(&self) -> layout::Window {
        self.base(self.next)
    }

    /// The frames as they are seen by a camera while the wind has carried the layers by `drifts`.
    #[must_use]
    pub fn shown(&self, view: &layout::View, drifts: &[DVec3]) -> layout::Window {
        let frames = self.slices.len();
        let newest = (self.next + frames - 1) % frames;
        let mut window = self.base(newest);
        let now = Slice::of(view, drifts);
        let filled = self.filled();
        let mut all_same = filled as usize == frames;
        for (shown, slice) in window.slices.iter_mut().zip(&self.slices) {
            let Some(slice) = slice else { continue };
            let is_same = *slice == now;
            all_same &= is_same;
            shown.weight = 1.0;
            shown.is_same_view = u32::from(is_same);
            shown.position = slice.position;
            shown.forward = slice.forward;
            shown.across = over_its_square(slice.right);
            shown.upward = over_its_square(slice.up);
            shown.start_moved_m = Vec3::from(slice.start).distance(Vec3::from(now.start));
            for layer in 0..LAYERS_MAX {
                let moved = now.drifts[layer] - slice.drifts[layer];
                let pair = &mut shown.drift[layer / 2];
                pair[2 * (layer % 2)] = moved.x as f32;
                pair[2 * (layer % 2) + 1] = moved.z as f32;
            }
        }
        let divisor = f64::from(self.plan.divisor);
        let samples_per_pixel = f64::from(filled.max(1)) / (divisor * divisor);
        let sigma = KERNEL_SIGMA * samples_per_pixel.sqrt().recip().max(1.0);
        window.sharpness = (0.5 / (sigma * sigma)) as f32;
        window.fills_gaps = u32::from(!all_same || samples_per_pixel < 1.0);
        if all_same && let Some((order, each)) = self.order() {
            (window.order, window.slices_per_pixel) = (order, each);
        }
        window
    }
}

fn over_its_square(v: [f32; 3]) -> [f32; 3] {
    let v = Vec3::from_array(v).as_dvec3();
    (v / v.length_squared()).as_vec3().to_array()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(yaw: f32) -> layout::View {
        layout::View {
            forward: [yaw.sin(), 0.0, -yaw.cos()],
            right: [yaw.cos(), 0.0, yaw.sin()],
            up: [0.0, 1.0, 0.0],
            ..Default::default()
        }
    }

    fn marched(window: &mut TemporalWindow, yaw: f32, frames: u32) {
        for _ in 0..frames {
            window.begin();
            window.complete(&view(yaw), &[]);
        }
    }

    fn quarter() -> WindowPlan {
        WindowPlan {
            frames: 16,
            divisor: 4,
            ..WindowPlan::default()
        }
    }

    #[test]
    fn a_hundred_thousand_frames_leave_no_trace() {
        let [mut young, mut old] = [(); 2].map(|()| TemporalWindow::new(quarter()));
        marched(&mut young, 0.0, 16);
        for frame in 0..100_000u32 {
            marched(&mut old, 0.001 * frame as f32, 1);
        }
        marched(&mut old, 0.0, 16);
        assert_eq!(young.shown(&view(0.0), &[]), old.shown(&view(0.0), &[]));
    }

    /// What a window is after n frames depends on n only through n modulo its frames: nothing in it counts on, so no number
    /// of frames (2^16, 2^24, 2^31, 2^32) is another case than those here.
    #[test]
    fn a_window_is_the_same_after_every_round() {
        for frames in 1..=16 {
            let plan = WindowPlan {
                frames,
                ..quarter()
            };
            let mut window = TemporalWindow::new(plan);
            marched(&mut window, 0.3, frames);
            let round: Vec<TemporalWindow> = (0..frames)
                .map(|_| {
                    let before = window.clone();
                    marched(&mut window, 0.3, 1);
                    before
                })
                .collect();
            for (place, before) in (0..3 * frames).zip(round.iter().cycle()) {
                assert_eq!(&window, before, "{frames} frames, {place} further");
                marched(&mut window, 0.3, 1);
            }
        }
    }

    #[test]
    fn a_camera_at_rest_reprojects_nothing_and_leaves_no_gaps() {
        for (frames, divisor) in [(1, 1), (16, 1), (4, 2), (8, 2), (16, 2), (16, 4)] {
            let plan = WindowPlan {
                frames,
                divisor,
                ..WindowPlan::default()
            };
            let mut window = TemporalWindow::new(plan);
            marched(&mut window, 0.5, frames);
            let shown = window.shown(&view(0.5), &[]);
            assert_eq!(shown.slices_per_pixel, frames / divisor.pow(2));
            assert_eq!(shown.fills_gaps, 0);
            let slices = &shown.slices[..frames as usize];
            assert!(slices.iter().all(|slice| slice.is_same_view == 1));
        }
    }

    #[test]
    fn what_is_being_marched_is_not_shown_and_a_cut_leaves_nothing() {
        let mut window = TemporalWindow::new(quarter());
        marched(&mut window, 0.0, 16);
        window.begin();
        assert_eq!(window.filled(), 15);
        let shown = window.shown(&view(0.0), &[]);
        assert_eq!(shown.slices[0].weight, 0.0);
        assert_eq!((shown.slices_per_pixel, shown.fills_gaps), (0, 1));
        window.forget();
        assert_eq!(window.filled(), 0);
    }

    #[test]
    fn clouds_that_drift_are_looked_up_where_they_were() {
        let mut window = TemporalWindow::new(quarter());
        window.begin();
        window.complete(&view(0.0), &[DVec3::ZERO, DVec3::new(5.0, 0.0, 7.0)]);
        let shown = window.shown(&view(0.0), &[DVec3::ZERO, DVec3::new(25.0, 0.0, 6.0)]);
        assert_eq!(shown.slices[0].drift[0], [0.0, 0.0, 20.0, -1.0]);
        assert_eq!(shown.slices[0].is_same_view, 0);
    }
}
