//! Rays of a viewer's own on its way from one view cell to another, instead of a mix of both cells' pictures (Weinrauch et al. 2023,
//! 3.3.1). Each goes through the point of a layer's sphere that the viewer looks at, as a texel's ray does, and starts at a
//! place that moves from the old cell's reference to the new one's. So the way begins with what the old cache shows and ends with
//! what the new one does, and neither has to be kept or to be there while it lasts.

#[cfg(test)]
mod tests;

use super::{LeftBehind, Stage, Transition, Way};
use crate::config::Transitions;
use crate::frame_loop::renderer::SkyRenderer;
use crate::frame_loop::screen_space::{ScreenSpaceJob, WindowChoice};
use crate::frame_loop::viewers_on_device::ActiveViewer;
use crate::march::{Side, ring_bytes};
use glam::DVec3;
use skycell_protocol::{RendererKind, Show, ViewerId};
use std::time::Instant;

/// References that are no farther apart show the same, m.
const APART_MIN_M: f64 = 1.0;
/// In less wind the start of a standing viewer's rays goes on at this speed, m/s: that of a light wind.
const SPEED_MIN_M_PER_S: f64 = 5.0;

/// Most bytes of the last frames of rays of viewers on their way: four windows of 1920×1080 and one layer. Further ones fade.
pub(super) const RING_BYTES_MAX: u64 = 544 << 20;

/// Where rays started when a way began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::frame_loop) struct OwnRays {
    pub(super) from_m: DVec3,
}

impl Transition {
    /// Whether rays of the viewer's own are shown by now; before, the old cell's cache is.
    pub(in crate::frame_loop) fn shows_rays(&self) -> bool {
        self.rays.is_some() && matches!(self.way.stage(), Stage::Fades | Stage::Arrived)
    }

    /// Where its rays start by now, on the way to a reference.
    pub(super) fn start_m(&self, to_m: DVec3) -> DVec3 {
        let from_m = self.rays.map_or(to_m, |rays| rays.from_m);
        from_m.lerp(to_m, self.way.share())
    }

    /// Whether its rays start where those of the new cell's texels do.
    pub(in crate::frame_loop) fn has_arrived(&self) -> bool {
        self.way.stage() == Stage::Arrived
    }
}

impl ActiveViewer {
    /// Whether rays of its own are marched for its way to another cell, shown or not.
    pub(in crate::frame_loop) fn marches_on_its_way(&self) -> bool {
        let transition = self.transition.as_ref();
        transition.is_some_and(|transition| transition.rays.is_some())
    }

    /// Whether they make its frames.
    pub(in crate::frame_loop) fn shows_rays_on_its_way(&self) -> bool {
        self.transition.as_ref().is_some_and(Transition::shows_rays)
    }

    /// Whether rays of its own may show what it asked for.
    pub(super) fn may_have_rays(&self) -> bool {
        self.view.renderer == RendererKind::Cached
            && self.view.show == Show::Picture
            && !self.view.linear
    }
}

impl SkyRenderer {
    /// Whether ways are shown by rays of the viewers' own: a window sums up what is marched of their moving start.
    pub(in crate::frame_loop) fn shows_ways_by_rays(&self) -> bool {
        self.config.transitions == Transitions::OwnRays
            && !matches!(self.window_choice, WindowChoice::Fixed(None))
    }

    /// Own rays from one reference to another, where that is how ways are shown.
    pub(super) fn own_rays_between(&self, left: &LeftBehind) -> Option<OwnRays> {
        let [from_m, to_m] = left.references_m;
        let is_shown = !left.has_jumped
            && from_m.distance(to_m) > APART_MIN_M
            && [from_m, to_m]
                .iter()
                .all(|place| self.is_below_all(place.y));
        (self.shows_ways_by_rays() && is_shown).then_some(OwnRays { from_m })
    }

    fn is_below_all(&self, altitude_m: f64) -> bool {
        let sides = self.sides_at(altitude_m);
        sides.into_iter().all(|side| side == Side::Below)
    }

    /// Bytes of the last frames of all rays of viewers on their way.
    pub(super) fn ring_bytes(&self) -> u64 {
        let viewers = self.viewers.values();
        let on_their_way = viewers.filter(|viewer| viewer.marches_on_its_way());
        on_their_way.map(|viewer| self.ring_bytes_of(viewer)).sum()
    }

    /// The same of a viewer, if it were.
    pub(super) fn ring_bytes_of(&self, viewer: &ActiveViewer) -> u64 {
        let layers = self.active.len();
        let eye = |plan| ring_bytes(&self.gpu, viewer.view.picture_size(), layers, plan);
        self.window_plan(viewer).map_or(0, eye)
    }

    /// A way whose rays start at one reference and end at another: standing viewers see it about as fast as they see clouds drift.
    pub(super) fn way_of_rays(&self, [from_m, to_m]: [DVec3; 2]) -> Way {
        let wind_m_per_s = self.wind_speed_max_m_per_s();
        Way::of_rays(from_m.distance(to_m) / wind_m_per_s.max(SPEED_MIN_M_PER_S))
    }

    /// Where the rays of a viewer on its way start by now.
    pub(in crate::frame_loop) fn rays_start_m(&self, viewer: &ActiveViewer) -> Option<DVec3> {
        let transition = viewer.transition.as_ref()?;
        let to_m = self.active_cells.get(&viewer.cell)?.reference_m;
        transition.rays.map(|_| transition.start_m(to_m))
    }

    /// Lets time pass for a viewer with own rays. False where its way ends with what it is shown otherwise.
    pub(super) fn pass_rays(
        &mut self,
        viewer: &mut ActiveViewer,
        transition: &mut Transition,
        passed_s: f64,
        motion: f64,
    ) -> bool {
        let eye_m = viewer.view.camera.position_m();
        let had_arrived = transition.has_arrived();
        let goes_on = if transition.shows_rays() {
            viewer.approaches.is_some()
        } else {
            viewer.kind == RendererKind::Cached && self.is_reached(transition.from, eye_m)
        };
        if !goes_on || !viewer.may_have_rays() || !self.is_below_all(eye_m[1]) {
            viewer.screen_space = None;
            return false;
        }
        let job = viewer.screen_space.as_ref();
        let is_full = job.is_some_and(ScreenSpaceJob::is_full);
        transition.way.pass_rays(passed_s, motion, is_full);
        if transition.has_arrived() && !had_arrived {
            // The new cell's tiles may take their time from now on.
            viewer.approaches = Some(Instant::now());
        }
        transition.way.stage() != Stage::GivenUp
    }

    /// A viewer whose rays show all that the old cell's cache does is shown them from now on.
    pub(super) fn show_rays(&mut self, id: ViewerId) {
        let left = self
            .viewers
            .get(&id)
            .and_then(|viewer| viewer.transition.as_ref());
        let Some(left) = left.map(|transition| transition.from) else {
            return;
        };
        let fade = self.renderer_fade(id, left);
        let Some(viewer) = self.viewers.get_mut(&id) else {
            return;
        };
        viewer.kind = RendererKind::ScreenSpace;
        viewer.approaches = Some(Instant::now());
        viewer.renderer_fade = fade;
        if let Some(transition) = &mut viewer.transition {
            transition.requests.clear();
        }
        self.change_requests(left);
    }

    /// Marches rays of a viewer's own from its cell's reference once, so that the first way waits for nothing.
    pub(in crate::frame_loop) fn warm_up_rays(&mut self, id: ViewerId) {
        if !self.shows_ways_by_rays() {
            return;
        }
        let Some(viewer) = self.viewers.get_mut(&id) else {
            return;
        };
        let from_m = DVec3::from_array(viewer.view.camera.position_m());
        viewer.transition = Some(Transition {
            from: viewer.cell,
            requests: Vec::new(),
            way: Way::of_rays(0.0),
            fade: None,
            rays: Some(OwnRays { from_m }),
            camera: viewer.view.camera,
            seen_from_m: None,
        });
        // A strip for each layer is the whole small picture.
        for _ in 0..=self.active.len() {
            if self.march_screen_space(id, u64::MAX >> 20) {
                break;
            }
        }
        if let Some(viewer) = self.viewers.get_mut(&id) {
            viewer.transition = None;
            viewer.screen_space = None;
        }
    }
}
