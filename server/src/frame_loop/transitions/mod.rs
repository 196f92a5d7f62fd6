//! Viewers on their way from one view cell to another: they go on seeing the old cell's cache until the new one has what
//! they look at, then a cross-fade of both pictures.
//!
//! A viewer is between two cells at most. When it comes to belong to a third one while two are mixed, it goes there when that
//! mix is over; when it comes to belong to the one that it left, the mix goes back the way that it came. So what is shown never
//! jumps.

mod rays;
mod way;

#[cfg(test)]
mod tests;

pub(super) use rays::OwnRays;
use rays::RING_BYTES_MAX;
pub(super) use way::{Readiness, Stage, Way};

use super::interface::TransitionStats;
use super::renderer::SkyRenderer;
use super::viewers_on_device::ActiveViewer;
use crate::cache::TileRequest;
use crate::composite::{Picture, PictureFade};
use crate::gpu::{Gpu, Pipelines};
use glam::DVec3;
use skycell_protocol::{Camera, CellId, RendererKind, ViewerId};
use std::collections::BTreeMap;

/// Most viewers between two cells; further ones are shown their new cell at once. Each may keep a cell that nobody belongs to
/// any more.
const VIEWERS_MAX: usize = 32;
/// Most bytes of second pictures: fifteen of 1920×1080.
pub(super) const PICTURES_BYTES_MAX: u64 = 128 << 20;
/// The reference of a cell that somebody leaves stands still for that while it would not have to move farther, m.
const HELD_MAX_M: f64 = 3_000.0;
/// Pictures about old and new anchors differ as little as those of references that are so far apart, rad.
pub(super) const NEW_ANCHORS_RAD: f64 = 0.13;
/// A reference that has stood still follows by and by where it has no more than this to go, rad.
const LATE_MAX_RAD: f64 = 0.05;
/// Clouds count as no nearer than this, m.
const HEIGHT_MIN_M: f64 = 100.0;

/// A viewer's way to another cell.
pub(super) struct Transition {
    /// The cell that it comes from.
    pub(super) from: CellId,
    /// What it looks at there.
    pub(super) requests: Vec<Vec<TileRequest>>,
    pub(super) way: Way,
    /// While both are shown.
    pub(super) fade: Option<PictureFade>,
    /// What is shown instead of both.
    pub(super) rays: Option<OwnRays>,
    /// The camera when time last passed.
    camera: Camera,
    /// Where a viewer who has jumped stood before: from there it is shown the old cell, whose clouds would look torn from where
    /// it is now.
    seen_from_m: Option<[f64; 3]>,
}

/// What happens to those who look at a cell that becomes another.
#[derive(Clone, Copy, Debug)]
pub(super) struct LeftBehind {
    /// How far apart the old and the new picture are, as an angle between references, seen from the nearest clouds.
    pub(super) apart_rad: f64,
    /// They have jumped with it.
    pub(super) has_jumped: bool,
    /// Where rays started, and will start.
    pub(super) references_m: [DVec3; 2],
}

impl Transition {
    /// A picture of another size needs another one of that size beside it.
    pub(super) fn resize(&mut self, gpu: &Gpu, pipelines: &Pipelines, picture: &Picture) {
        if self.fade.is_some() {
            self.fade = Some(PictureFade::new(gpu, pipelines, picture));
        }
    }
}

impl ActiveViewer {
    /// Whether frames show a cell's cache, or are about to for want of anything else.
    pub(super) fn looks_at(&self, cell: CellId) -> bool {
        match &self.transition {
            None => self.cell == cell,
            Some(transition) if transition.way.stage() == Stage::Waits => transition.from == cell,
            Some(transition) if transition.rays.is_some() => self.cell == cell,
            Some(transition) => transition.from == cell || self.cell == cell,
        }
    }

    /// Whether two pictures are mixed in its frames: of two cells, or of rays and the cache.
    pub(super) fn fades(&self) -> bool {
        self.renderer_fade.is_some()
            || self.transition.as_ref().is_some_and(|transition| {
                transition.rays.is_none() && transition.way.stage() == Stage::Fades
            })
    }

    /// Whether it needs a cell, which may have no members any more.
    pub(super) fn needs(&self, cell: CellId) -> bool {
        let leaves = |transition: &Transition| transition.from == cell && !transition.shows_rays();
        self.cell == cell || self.transition.as_ref().is_some_and(leaves)
    }

    /// What it looks at in a cell whose cache it reads, to be filled in. Empty ones are out of date.
    pub(super) fn requests_in(&mut self, cell: CellId) -> Option<&mut Vec<Vec<TileRequest>>> {
        if self.cell == cell {
            return self.reads_cache().then_some(&mut self.requests);
        }
        self.transition
            .as_mut()
            .filter(|transition| transition.from == cell && !transition.shows_rays())
            .map(|transition| &mut transition.requests)
    }

    /// The camera from which it is shown a cell: its own, but for the cell that it left by a jump.
    pub(super) fn camera_in(&self, cell: CellId) -> Camera {
        let camera = self.view.camera;
        let left = self.transition.as_ref().filter(|t| t.from == cell);
        let Some(from_m) = left.and_then(|transition| transition.seen_from_m) else {
            return camera;
        };
        let (yaw_deg, pitch_deg) = (camera.yaw_deg(), camera.pitch_deg());
        Camera::new(from_m, yaw_deg, pitch_deg, camera.vertical_fov_deg()).unwrap_or(camera)
    }

    /// The cameras of its eyes there.
    pub(super) fn eyes_in(&self, cell: CellId) -> Vec<Camera> {
        self.view.eyes_about(&self.camera_in(cell))
    }

    /// Whether what it is shown is of where it was before a jump.
    pub(super) fn is_shown_elsewhere(&self) -> bool {
        self.transition
            .as_ref()
            .is_some_and(|t| t.way.stage() == Stage::Waits && t.way.has_jumped())
    }

    /// Whether it looks at a cell from so far away by now that nothing is marched for that.
    pub(super) fn has_jumped_from(&self, cell: CellId) -> bool {
        self.transition
            .as_ref()
            .is_some_and(|transition| transition.from == cell && transition.way.has_jumped())
    }

    /// What it asks for has to be looked up anew, in all cells that it reads.
    pub(super) fn forget_requests(&mut self) {
        self.requests.clear();
        if let Some(transition) = &mut self.transition {
            transition.requests.clear();
        }
    }
}

/// Sums since the start.
#[derive(Debug, Default)]
pub(super) struct TransitionCounters {
    /// Viewers who changed cells by a way.
    begun: u64,
    /// Those who were shown their new cell at once, for want of room or time.
    swapped: u64,
    /// Cells that were shown under another number.
    stand_ins: u32,
}

impl SkyRenderer {
    /// Brings a viewer to the cell that it belongs to, or on its way there.
    pub(super) fn follow_cell(&mut self, id: ViewerId) {
        let Some(target) = self.cells.cell_of(id) else {
            return;
        };
        let in_transition = self.viewers_in_transition();
        let Some(mut viewer) = self.viewers.remove(&id) else {
            return;
        };
        let left = viewer.cell;
        let mut leads_elsewhere = false;
        if left != target {
            if viewer.marches_on_its_way() {
                // Its cameras are told in the frame of the cell.
                viewer.screen_space = None;
            }
            match viewer.transition.take() {
                None => {
                    // From what shows nothing there is no way, and rays of its own show the same sky in all cells.
                    // Nor from what was seen from the other side of a layer.
                    let eye_m = viewer.view.camera.position_m();
                    let is_shown = viewer.kind == RendererKind::Cached
                        && self.coarse_is_ready(left)
                        && self.is_reached(left, eye_m);
                    let requests = std::mem::take(&mut viewer.requests);
                    let references_m = self.references_m(left, target);
                    let left_behind = LeftBehind {
                        apart_rad: self.apart_rad_of(references_m[0], references_m[1]),
                        has_jumped: false,
                        references_m,
                    };
                    let may_have_rays = viewer.may_have_rays()
                        && self.ring_bytes() + self.ring_bytes_of(&viewer) <= RING_BYTES_MAX;
                    let (rays, way) = self.begun_way(&left_behind, may_have_rays);
                    // Two pictures of linear radiance are not mixed.
                    if is_shown && in_transition < VIEWERS_MAX && !viewer.view.linear {
                        self.counters.transitions.begun += 1;
                        viewer.transition = Some(Transition {
                            from: left,
                            requests,
                            way,
                            fade: None,
                            rays,
                            camera: viewer.shown_camera,
                            seen_from_m: None,
                        });
                    } else {
                        self.counters.transitions.swapped += u64::from(is_shown);
                    }
                    viewer.cell = target;
                    viewer.screen_space = None;
                }
                Some(transition) if transition.shows_rays() => {
                    // From where they start by now.
                    let to_m = self.references_m(left, target)[1];
                    let from_m = transition.start_m(self.references_m(left, left)[0]);
                    viewer.cell = target;
                    viewer.requests.clear();
                    leads_elsewhere = true;
                    viewer.transition = Some(Transition {
                        from: left,
                        way: self.way_of_rays([from_m, to_m]).shown(),
                        rays: Some(OwnRays { from_m }),
                        ..transition
                    });
                }
                Some(mut transition) if transition.fade.is_some() => {
                    if transition.from == target {
                        transition.from = left;
                        std::mem::swap(&mut viewer.requests, &mut transition.requests);
                        transition.way.turn_round();
                        viewer.cell = target;
                    }
                    // A third cell comes after these two.
                    viewer.transition = Some(transition);
                }
                Some(transition) if transition.from == target => {
                    viewer.cell = target;
                    viewer.requests = transition.requests;
                }
                Some(mut transition) => {
                    if let Some(rays) = transition.rays {
                        let to_m = self.references_m(left, target)[1];
                        transition.way = self.way_of_rays([rays.from_m, to_m]);
                    }
                    viewer.cell = target;
                    viewer.requests.clear();
                    viewer.transition = Some(transition);
                }
            }
        }
        let to = viewer.cell;
        self.viewers.insert(id, viewer);
        if leads_elsewhere {
            // A new window has few samples at first.
            let fade = self.renderer_fade(id, left);
            if let Some(viewer) = self.viewers.get_mut(&id) {
                viewer.renderer_fade = fade;
            }
        }
        self.change_requests(left);
        self.change_requests(to);
    }

    /// What a viewer asks for has changed, in all cells that it reads.
    pub(super) fn change_requests_of(&mut self, id: ViewerId) {
        let Some(viewer) = self.viewers.get(&id) else {
            return;
        };
        let from = viewer.transition.as_ref().map(|transition| transition.from);
        let cells = [Some(viewer.cell), from];
        for cell in cells.into_iter().flatten() {
            self.change_requests(cell);
        }
    }

    /// The cell that is shown by the caches of an active one: itself, or the one that it stands for.
    pub(super) fn cell_shown_by(&self, id: CellId) -> CellId {
        let cell = self.active_cells.get(&id);
        cell.and_then(|cell| cell.stands_for)
            .map_or(id, |(shown, _)| shown)
    }

    /// The way of those who leave a cell, as they see it: by rays of their own, where they may have such.
    fn begun_way(&self, left: &LeftBehind, may_have_rays: bool) -> (Option<OwnRays>, Way) {
        let rays = self.own_rays_between(left).filter(|_| may_have_rays);
        let way = match rays {
            Some(_) => self.way_of_rays(left.references_m),
            None if left.has_jumped => Way::of_a_jump(left.apart_rad),
            None => Way::new(left.apart_rad),
        };
        (rays, way)
    }

    /// Lets those who look at a cell go on seeing it under another number, which is returned, while the cell itself becomes
    /// another, and then go on to that. None where nobody does. If they have jumped with it, they see it from where they stood.
    pub(super) fn keep_for_viewers(&mut self, id: CellId, left: &LeftBehind) -> Option<CellId> {
        let has_jumped = left.has_jumped;
        let ways = [false, true].map(|may_have_rays| self.begun_way(left, may_have_rays));
        let mut bytes_left = RING_BYTES_MAX.saturating_sub(self.ring_bytes());
        let bytes_of: BTreeMap<ViewerId, u64> = (self.viewers.iter())
            .map(|(id, viewer)| (*id, self.ring_bytes_of(viewer)))
            .collect();
        let mut room = VIEWERS_MAX.saturating_sub(self.viewers_in_transition());
        // Far from those of cells, which are counted up.
        let stand_in = CellId(u32::MAX - self.counters.transitions.stand_ins);
        let mut is_kept = false;
        for (viewer_id, viewer) in &mut self.viewers {
            let is_in =
                viewer.cell == id && viewer.kind == RendererKind::Cached && !viewer.view.linear;
            match &mut viewer.transition {
                Some(transition) if transition.from == id && !transition.shows_rays() => {
                    transition.from = stand_in;
                    is_kept = true;
                }
                None if is_in && room > 0 => {
                    room -= 1;
                    let stood_m = viewer.shown_camera.position_m();
                    let bytes = bytes_of.get(viewer_id).copied().unwrap_or(u64::MAX);
                    let may_have_rays = viewer.may_have_rays() && bytes <= bytes_left;
                    let (rays, way) = ways[usize::from(may_have_rays)];
                    if rays.is_some() {
                        bytes_left -= bytes;
                    }
                    viewer.transition = Some(Transition {
                        from: stand_in,
                        requests: std::mem::take(&mut viewer.requests),
                        way,
                        fade: None,
                        rays,
                        camera: viewer.shown_camera,
                        seen_from_m: has_jumped.then_some(stood_m),
                    });
                    is_kept = true;
                }
                _ => {}
            }
            if viewer.cell == id {
                viewer.requests.clear();
            }
        }
        if is_kept {
            self.counters.transitions.stand_ins += 1;
        }
        is_kept.then_some(stand_in)
    }

    /// Lets time pass for viewers between two cells. Returns those whose frames show something else for that.
    pub(super) fn pass_transitions(&mut self, passed_s: f64) -> Vec<ViewerId> {
        let ids: Vec<ViewerId> = self
            .viewers
            .iter()
            .filter(|(_, viewer)| viewer.transition.is_some())
            .map(|(id, _)| *id)
            .collect();
        if ids.is_empty() {
            return ids;
        }
        let mut changed = Vec::new();
        let mut has_ended = false;
        for id in ids {
            let Some(mut viewer) = self.viewers.remove(&id) else {
                continue;
            };
            let before = viewer.transition.as_ref().map(|t| t.way.share());
            self.pass_transition(&mut viewer, passed_s);
            let after = viewer.transition.as_ref().map(|t| t.way.share());
            if before != after {
                changed.push(id);
            }
            let ends = viewer.transition.is_none();
            let begins_rays = viewer.shows_rays_on_its_way() && viewer.kind == RendererKind::Cached;
            self.viewers.insert(id, viewer);
            if begins_rays {
                self.show_rays(id);
                changed.push(id);
                // Nobody needs what it left.
                has_ended = true;
            }
            if ends {
                has_ended = true;
                // It may belong to another cell by now.
                self.follow_cell(id);
            }
        }
        if has_ended {
            self.end_empty_cells();
        }
        changed
    }

    fn pass_transition(&mut self, viewer: &mut ActiveViewer, passed_s: f64) {
        let Some(mut transition) = viewer.transition.take() else {
            return;
        };
        let eye_m = viewer.view.camera.position_m();
        let camera = viewer.view.camera;
        let motion = self.motion_between(&transition.camera, &camera);
        if transition.rays.is_some() {
            transition.camera = camera;
            if self.pass_rays(viewer, &mut transition, passed_s, motion) {
                viewer.transition = Some(transition);
            } else {
                let gives_up = transition.way.stage() == Stage::GivenUp;
                self.counters.transitions.swapped += u64::from(gives_up);
            }
            return;
        }
        if viewer.kind != RendererKind::Cached || !self.is_reached(transition.from, eye_m) {
            return;
        }
        let stood_m = transition.camera.position_m();
        transition.camera = camera;
        let was_jump = transition.way.has_jumped();
        transition
            .way
            .pass(passed_s, motion, self.readiness(viewer));
        if transition.way.has_jumped() && !was_jump {
            transition.seen_from_m = Some(stood_m);
            transition.requests.clear();
            self.change_requests(transition.from);
        }
        let is_first = transition.way.stage() == Stage::Fades && transition.fade.is_none();
        if is_first {
            let format = viewer.picture.format();
            let bytes = PictureFade::bytes_of(viewer.view.picture_size(), format);
            if self.fade_bytes() + bytes > PICTURES_BYTES_MAX {
                transition.way.give_up();
            } else {
                let (gpu, pipelines) = (&self.gpu, &self.pipelines);
                transition.fade = Some(PictureFade::new(gpu, pipelines, &viewer.picture));
            }
        }
        match transition.way.stage() {
            Stage::Waits | Stage::Fades => viewer.transition = Some(transition),
            Stage::Arrived => {}
            Stage::GivenUp => self.counters.transitions.swapped += 1,
        }
    }

    /// What a viewer's cell can show of what it looks at.
    fn readiness(&self, viewer: &ActiveViewer) -> Readiness {
        let has_requests = viewer.requests.len() == self.proxies.len();
        if !has_requests || !self.coarse_is_ready(viewer.cell) {
            Readiness::Missing
        } else if self.is_coarse(viewer.cell, &viewer.requests) {
            Readiness::Coarse
        } else {
            Readiness::Fine
        }
    }

    /// Height of the nearest clouds over or under an altitude, m.
    fn cloud_height_m(&self, altitude_m: f64) -> f64 {
        self.active
            .iter()
            .map(|layer| (layer.proxy_altitude_m - altitude_m).abs())
            .fold(f64::INFINITY, f64::min)
            .max(HEIGHT_MIN_M)
    }

    /// The references of two cells. Of one that is no more, the other's.
    fn references_m(&self, a: CellId, b: CellId) -> [DVec3; 2] {
        let reference_m = |id: CellId| {
            let on_device = self.active_cells.get(&id).map(|cell| cell.reference_m);
            on_device.or_else(|| self.cells.get(id).map(|cell| cell.reference_m))
        };
        let (a_m, b_m) = (reference_m(a), reference_m(b));
        [a_m.or(b_m), b_m.or(a_m)].map(Option::unwrap_or_default)
    }

    /// Angle between two places, seen from the nearest clouds.
    pub(super) fn apart_rad_of(&self, a_m: DVec3, b_m: DVec3) -> f64 {
        a_m.distance(b_m) / self.cloud_height_m(a_m.y)
    }

    /// Whether a reference that goes from one place to another jumps: from there nothing is seen as it was from here. Who flies
    /// close over clouds goes far about them in a frame, and is shown its own motion.
    pub(super) fn is_a_jump(&self, from_m: DVec3, to_m: DVec3) -> bool {
        let moved_rad = from_m.distance(to_m) / self.cloud_height_m(to_m.y);
        Way::is_a_jump(Way::hidden_by(0.0, moved_rad))
    }

    /// Ways that the motion from one camera to another hides.
    pub(super) fn motion_between(&self, before: &Camera, now: &Camera) -> f64 {
        let [was_m, is_m] = [before, now].map(|camera| DVec3::from_array(camera.position_m()));
        // Of two equal directions the cosine may round to more than 1.
        let turned_rad = before
            .direction()
            .dot(now.direction())
            .clamp(-1.0, 1.0)
            .acos();
        let moved_rad = was_m.distance(is_m) / self.cloud_height_m(is_m.y);
        Way::hidden_by(turned_rad, moved_rad)
    }

    /// Whether rays of a cell go on starting where they did although its reference is elsewhere by now: who leaves a cell that
    /// falls apart would see it jump, and those who stay were within its limit before.
    pub(super) fn holds_reference(&self, id: CellId, reference_m: DVec3) -> bool {
        let limit = self.cells.limit();
        let is_left = |viewer: &ActiveViewer| {
            let transition = viewer.transition.as_ref();
            transition.is_some_and(|t| t.from == id && !t.way.has_jumped() && !t.shows_rays())
        };
        self.active_cells
            .get(&id)
            .is_some_and(|cell| limit.distance_m(cell.reference_m, reference_m) <= HELD_MAX_M)
            && self.viewers.values().any(is_left)
    }

    /// Lets a reference go to where it should be that has stood still for those who left its cell. Those who stay come to the new
    /// place as to another cell: dragged there, a picture would change within seconds. False where it does not have far to go, or where
    /// there is no room for all of them; then it follows by and by.
    pub(super) fn let_go(&mut self, id: CellId, reference_m: DVec3) -> bool {
        let stood_m = match self.active_cells.get(&id) {
            Some(cell) if cell.is_late => cell.reference_m,
            _ => return false,
        };
        let apart_rad = self.apart_rad_of(stood_m, reference_m);
        let is_seen_alike = self.cells.limit().share_storey(stood_m, reference_m);
        let mut stay = self.viewers.values().filter(|viewer| viewer.cell == id);
        let room = VIEWERS_MAX.saturating_sub(self.viewers_in_transition());
        // Who is just coming here would see the place that it comes to become another.
        let all_may_go = stay.clone().count() <= room && stay.all(|v| v.transition.is_none());
        if apart_rad <= LATE_MAX_RAD || !is_seen_alike || !all_may_go {
            return false;
        }
        self.move_reference(id, stood_m, reference_m);
        let is_left = self.leave_behind(
            id,
            &LeftBehind {
                apart_rad,
                has_jumped: false,
                references_m: [stood_m, reference_m],
            },
        );
        if !is_left {
            self.move_reference(id, stood_m, stood_m);
        }
        is_left
    }

    fn move_reference(&mut self, id: CellId, from_m: DVec3, to_m: DVec3) {
        if let Some(cell) = self.active_cells.get_mut(&id) {
            cell.came_from_m = from_m;
            cell.reference_m = to_m;
        }
    }

    /// Shows every viewer the cell that it belongs to: nothing is left of what was shown.
    pub(super) fn end_transitions(&mut self) {
        let ids: Vec<ViewerId> = self.viewers.keys().copied().collect();
        for id in ids {
            let target = self.cells.cell_of(id);
            if let Some(viewer) = self.viewers.get_mut(&id)
                && let Some(ended) = viewer.transition.take()
                && let Some(target) = target
            {
                if ended.rays.is_some() {
                    viewer.screen_space = None;
                }
                viewer.cell = target;
                viewer.requests.clear();
                self.change_requests(target);
            }
        }
        self.end_empty_cells();
    }

    fn viewers_in_transition(&self) -> usize {
        let viewers = self.viewers.values();
        viewers.filter(|viewer| viewer.transition.is_some()).count()
    }

    pub(super) fn fade_bytes(&self) -> u64 {
        let fading = self.viewers.values().filter(|viewer| viewer.fades());
        fading
            .map(|viewer| {
                PictureFade::bytes_of(viewer.view.picture_size(), viewer.picture.format())
            })
            .sum()
    }

    pub(super) fn transition_stats(&self) -> TransitionStats {
        let belongs = |id: &CellId| self.cells.get(*id).is_some_and(|c| !c.members.is_empty());
        TransitionStats {
            viewers: self.viewers_in_transition() as u64,
            fading: self.viewers.values().filter(|v| v.fades()).count() as u64,
            own_rays: (self.viewers.values())
                .filter(|viewer| viewer.shows_rays_on_its_way())
                .count() as u64,
            cells_kept: self.active_cells.keys().filter(|id| !belongs(id)).count() as u64,
            picture_bytes: self.fade_bytes(),
            ring_bytes: self.ring_bytes(),
            begun: self.counters.transitions.begun,
            swapped: self.counters.transitions.swapped,
        }
    }
}
