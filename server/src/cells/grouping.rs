//! How cells form, follow, split, merge and vanish.
//!
//! Each threshold has a gap to its opposite, so that nobody goes back and forth: a viewer leaves a cell beyond its radius and
//! enters another within [`ENTER_SHARE`] of it, and cells merge only if all members would be that near, where the reference
//! is and where it will go, now and soon. Who only passes a cell does not enter it.

use super::{Cell, CellChange, CellLimit, Cells, PLACED_HYSTERESIS, Place};
use glam::DVec3;
use skycell_protocol::{CellId, ViewerId};
use std::collections::{BTreeMap, BTreeSet};

/// A viewer enters a cell, and cells merge, within this share of the radius around the reference.
const ENTER_SHARE: f64 = 0.8;
/// Around the mean of all members, where the reference goes, this share is enough.
const SETTLED_SHARE: f64 = 0.9;
/// Time in which a reference goes 63 % of its way to the mean of the members, s.
const FOLLOW_TIME_S: f64 = 2.0;
/// A reference is never farther from the mean than this share of the radius: it keeps up with whoever is fast.
const LAG_SHARE: f64 = 0.1;
/// A reference sets out when the mean is this far away, m sideways…
const SET_OUT_M: f64 = 60.0;
/// …and goes until it is this near: texels age by where rays start, so a crowd that mills about must not move it.
const ARRIVE_M: f64 = 5.0;

/// Where members fall apart with a gap of this share of the radius, all on one side leave together.
const GAP_SHARE: f64 = 0.15;
/// Whoever enters a cell must still be near its members after this time, s.
const AHEAD_S: f64 = 10.0;
/// Nobody goes back to a cell before this time, s.
const RETURN_S: f64 = 15.0;
/// Faster than anybody travels, m/s: a jump.
const SPEED_MAX_M_PER_S: f64 = 1_000.0;
/// Slower counts as standing, m/s.
const SPEED_MIN_M_PER_S: f64 = 0.1;

/// Who, and where it is.
type Member<'a> = (ViewerId, &'a Place);

impl Cells {
    /// Brings cells to where their members are now; `passed_s` since the last time. Returns who is in another cell than
    /// before. Costs nothing while nobody moves and every reference has arrived.
    pub fn regroup(&mut self, passed_s: f64) -> Vec<CellChange> {
        self.time_s += passed_s;
        if !self.restless {
            return Vec::new();
        }
        self.restless = false;
        self.part_from_jumpers();
        self.note_speeds(passed_s);
        self.fill_placed();
        self.follow(passed_s);
        self.split();
        self.merge();
        let moved = std::mem::take(&mut self.moved);
        let changes = moved.into_iter().filter_map(|(viewer, from)| {
            let to = self.cell_of(viewer)?;
            (to != from).then_some(CellChange { viewer, from, to })
        });
        let changes: Vec<CellChange> = changes.collect();
        // Who has changed may let others follow, and who may not go back yet may do so later, though nobody moves then.
        self.restless |=
            !changes.is_empty() || self.places.values().any(|p| self.may_not_go_back(p));
        changes
    }

    /// Who has jumped beyond the limit leaves before the mean of the members is taken: nobody else is moved by that.
    fn part_from_jumpers(&mut self) {
        let limit = self.limit;
        let has_jumped =
            |place: &Place| limit.distance_m(place.grouped_m, place.position_m) > limit.radius_m();
        let jumped = self.places.iter().filter(|(_, place)| has_jumped(place));
        let jumped: Vec<(ViewerId, Place)> = jumped.map(|(id, place)| (*id, *place)).collect();
        for (viewer, place) in jumped {
            let Some(cell) = self.cells.get(&place.cell).filter(|cell| !cell.placed) else {
                continue;
            };
            let is_near = limit.distance_m(cell.reference_m, place.position_m) <= limit.radius_m();
            let stays = |member: &ViewerId| self.places.get(member).is_some_and(|p| !has_jumped(p));
            if !is_near && cell.members.iter().any(stays) {
                let to = self
                    .nearest_formed(&place)
                    .unwrap_or_else(|| self.form(place.position_m));
                self.transfer(viewer, to);
            }
        }
    }

    /// How fast everybody moves.
    fn note_speeds(&mut self, passed_s: f64) {
        if passed_s <= 0.0 {
            return;
        }
        let share = 1.0 - (-passed_s / FOLLOW_TIME_S).exp();
        for place in self.places.values_mut() {
            let velocity = (place.position_m - place.grouped_m) / passed_s;
            let velocity = if velocity.length() <= SPEED_MAX_M_PER_S {
                velocity
            } else {
                DVec3::ZERO
            };
            place.grouped_m = place.position_m;
            place.velocity_m_per_s = place.velocity_m_per_s.lerp(velocity, share);
            if place.velocity_m_per_s.length() < SPEED_MIN_M_PER_S {
                place.velocity_m_per_s = DVec3::ZERO;
            }
            self.restless |= place.velocity_m_per_s != DVec3::ZERO;
        }
    }

    /// Placed cells take those who stand in them and let those go who have left.
    fn fill_placed(&mut self) {
        if !self.cells.values().any(|cell| cell.placed) {
            return;
        }
        let viewers: Vec<(ViewerId, Place)> = self
            .places
            .iter()
            .map(|(viewer, place)| (*viewer, *place))
            .collect();
        for (viewer, place) in viewers {
            let current = self.cells.get(&place.cell).filter(|cell| cell.placed);
            let is_held = current.is_some_and(|cell| {
                cell.reference_m.distance(place.position_m) <= cell.radius_m * PLACED_HYSTERESIS
                    && self.limit.share_storey(cell.reference_m, place.position_m)
            });
            if is_held {
                continue;
            }
            let to = match self.nearest_placed(place.position_m) {
                Some(placed) => placed,
                None if current.is_none() => continue,
                None => self
                    .nearest_formed(&place)
                    .unwrap_or_else(|| self.form(place.position_m)),
            };
            self.transfer(viewer, to);
        }
    }

    /// References go to the means of their members, that of one alone in a step.
    fn follow(&mut self, passed_s: f64) {
        let share = 1.0 - (-passed_s.max(0.0) / FOLLOW_TIME_S).exp();
        let places = &self.places;
        for cell in self.cells.values_mut().filter(|cell| !cell.placed) {
            let limit = cell.limit;
            // Who has gone through a layer leaves; the reference stays with the others.
            let stays = |viewer: &ViewerId| {
                places
                    .get(viewer)
                    .is_some_and(|place| limit.share_storey(place.position_m, cell.reference_m))
            };
            let staying: Vec<ViewerId> = cell.members.iter().copied().filter(stays).collect();
            let mean_m = mean(&staying, places).or_else(|| mean(&cell.members, places));
            let Some(mean_m) = mean_m else {
                continue;
            };
            let away_m = limit.distance_m(mean_m, cell.reference_m);
            let near_m = if cell.is_settled { SET_OUT_M } else { ARRIVE_M };
            cell.is_settled = away_m <= near_m;
            if cell.is_settled {
                continue;
            }
            self.restless = true;
            if let [_] = cell.members[..] {
                // Nobody else is disturbed.
                cell.reference_m = mean_m;
                continue;
            }
            let least = 1.0 - LAG_SHARE * limit.radius_m() / away_m;
            cell.reference_m = cell.reference_m.lerp(mean_m, share.max(least));
        }
    }

    /// Those who are too far from their reference leave. Where that is most of the members, the cell falls into two: the larger
    /// part keeps it.
    fn split(&mut self) {
        let formed: Vec<CellId> = self.formed().collect();
        let mut leaving: Vec<ViewerId> = Vec::new();
        for id in formed {
            let Some(cell) = self.cells.get(&id) else {
                continue;
            };
            let limit = cell.limit;
            let is_far = |reference_m: DVec3, position_m: DVec3| {
                limit.distance_m(reference_m, position_m) > limit.radius_m()
            };
            let members = cell
                .members
                .iter()
                .filter_map(|viewer| Some((*viewer, self.places.get(viewer)?)));
            if !members
                .clone()
                .any(|(_, place)| is_far(cell.reference_m, place.position_m))
            {
                continue;
            }
            let places: Vec<Member<'_>> = members.collect();
            let mut reference_m = cell.reference_m;
            if let Some(strict) = self.few_who_ask_for_less(&places, reference_m) {
                leaving.extend(strict);
                continue;
            }
            let mut kept = self.larger_part(&places, reference_m, limit);
            if kept.len() == places.len() {
                // A crowd without a gap loses its edge, unless that is most of it.
                kept.retain(|(_, place)| !is_far(reference_m, place.position_m));
            }
            if 2 * kept.len() < places.len() {
                kept.clone_from(&places);
            }
            let is_left_behind = |m: &Member<'_>| is_far(reference_m, m.1.position_m);
            if kept.iter().any(is_left_behind) {
                // It was in between the parts.
                let sum: DVec3 = kept.iter().map(|m| m.1.position_m).sum();
                reference_m = sum / kept.len() as f64;
            }
            kept.retain(|m| !is_far(reference_m, m.1.position_m));
            if let Some(cell) = self.cells.get_mut(&id) {
                cell.reference_m = reference_m;
            }
            let kept: BTreeSet<ViewerId> = kept.iter().map(|m| m.0).collect();
            leaving.extend(places.iter().map(|m| m.0).filter(|m| !kept.contains(m)));
        }
        for viewer in leaving {
            let Some(place) = self.places.get(&viewer).copied() else {
                continue;
            };
            let to = self
                .nearest_formed(&place)
                .unwrap_or_else(|| self.form(place.position_m));
            self.transfer(viewer, to);
        }
    }

    /// Those of a cell's members whose limit is the narrowest, where they are fewer than the rest and the rest could stay without
    /// them: a wish for less error must not take a crowd apart.
    fn few_who_ask_for_less(
        &self,
        members: &[Member<'_>],
        reference_m: DVec3,
    ) -> Option<Vec<ViewerId>> {
        let radius_m = |m: &Member<'_>| self.limit_of(m.1).radius_m();
        let least_m = members.iter().map(radius_m).fold(f64::INFINITY, f64::min);
        let (strict, rest): (Vec<&Member<'_>>, Vec<_>) =
            members.iter().partition(|&m| radius_m(m) <= least_m);
        let limit = rest
            .iter()
            .map(|m| self.limit_of(m.1))
            .reduce(CellLimit::narrower)?;
        let stays =
            |m: &&Member<'_>| limit.distance_m(reference_m, m.1.position_m) <= limit.radius_m();
        (strict.len() < rest.len() && rest.iter().all(stays))
            .then(|| strict.into_iter().map(|m| m.0).collect())
    }

    /// Those on one side of a gap: all members where there is none that is worth it, and of two equal parts that of the first
    /// member. The gap is looked for between two members that will soon be far apart.
    fn larger_part<'a>(
        &self,
        members: &[Member<'a>],
        reference_m: DVec3,
        limit: CellLimit,
    ) -> Vec<Member<'a>> {
        let velocity = members.iter().map(|m| m.1.velocity_m_per_s);
        let velocity = velocity.sum::<DVec3>() / members.len().max(1) as f64;
        let soon_m =
            |place: &Place| place.position_m + (place.velocity_m_per_s - velocity) * AHEAD_S;
        let farthest_from = |from_m: DVec3| {
            members
                .iter()
                .map(|m| soon_m(m.1))
                .max_by(|a, b| {
                    let [a, b] = [a, b].map(|p| limit.distance_m(from_m, *p));
                    a.total_cmp(&b)
                })
                .unwrap_or(from_m)
        };
        let one_m = farthest_from(reference_m);
        let other_m = farthest_from(one_m);
        let axis = (other_m - one_m).normalize_or_zero();
        let mut along: Vec<(f64, Member<'_>)> = members
            .iter()
            .map(|m| ((soon_m(m.1) - one_m).dot(axis), *m))
            .collect();
        along.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.0.cmp(&b.1.0)));
        let gaps = along.windows(2).map(|two| two[1].0 - two[0].0);
        let widest = gaps.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((index, _)) = widest.filter(|gap| gap.1 >= GAP_SHARE * limit.radius_m()) else {
            return members.to_vec();
        };
        let far = along.split_off(index + 1);
        let first = members.first().map(|m| m.0);
        let has_first = along.iter().any(|m| Some(m.1.0) == first);
        let stays = if along.len() > far.len() || (along.len() == far.len() && has_first) {
            along
        } else {
            far
        };
        stays.into_iter().map(|m| m.1).collect()
    }

    /// Cells that have come near each other become one: the smaller goes into the larger.
    fn merge(&mut self) {
        // From west to east, so that each is compared with those near it alone.
        let mut formed: Vec<(f64, CellId)> = self
            .formed()
            .filter_map(|id| Some((self.cells.get(&id)?.reference_m.x, id)))
            .collect();
        formed.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let radii_m = self.cells.values().map(|cell| cell.limit.radius_m());
        let reach_m = ENTER_SHARE * radii_m.fold(0.0, f64::max);
        for (index, (x_m, one)) in formed.iter().enumerate() {
            for (_, other) in formed[index + 1..]
                .iter()
                .take_while(|(other_x_m, _)| other_x_m - x_m <= reach_m)
            {
                let (Some(a), Some(b)) = (self.cells.get(one), self.cells.get(other)) else {
                    continue;
                };
                let limit = a.limit.narrower(b.limit);
                let away_m = limit.distance_m(a.reference_m, b.reference_m);
                if away_m > ENTER_SHARE * limit.radius_m() {
                    continue;
                }
                let larger_first = |a: (&Cell, CellId), b: (&Cell, CellId)| {
                    (b.0.members.len(), a.1) < (a.0.members.len(), b.1)
                };
                let (into, from) = if larger_first((a, *one), (b, *other)) {
                    (*one, *other)
                } else {
                    (*other, *one)
                };
                let moving = self.cells.get(&from).map(|cell| cell.members.clone());
                let moving = moving.unwrap_or_default();
                let places: Vec<Place> = moving
                    .iter()
                    .filter_map(|viewer| self.places.get(viewer).copied())
                    .collect();
                if self.has_room(into, &places) {
                    for viewer in moving {
                        self.transfer(viewer, into);
                    }
                }
            }
        }
    }

    fn formed(&self) -> impl Iterator<Item = CellId> {
        self.cells
            .iter()
            .filter(|(_, cell)| !cell.placed)
            .map(|(id, _)| *id)
    }

    fn transfer(&mut self, viewer: ViewerId, to: CellId) {
        if let Some(place) = self.places.get(&viewer).copied() {
            self.leave(viewer, place.cell);
            self.moved.entry(viewer).or_insert(place.cell);
            let mut left = place.left;
            left.rotate_right(1);
            left[0] = Some((place.cell, self.time_s));
            self.places.insert(
                viewer,
                Place {
                    cell: to,
                    left,
                    ..place
                },
            );
            self.enter(viewer, to);
        }
    }

    /// The nearest formed cell that a viewer may enter, but for the one where it is.
    pub(super) fn nearest_formed(&self, place: &Place) -> Option<CellId> {
        let own = self.limit_of(place);
        // Most cells are far away, and need no closer look: a whole crowd may have to leave at once.
        let reach_m = ENTER_SHARE * own.radius_m();
        let may_be_near = |cell: &Cell| {
            let away_m = cell.reference_m - place.position_m;
            away_m.x.abs().max(away_m.z.abs()) <= reach_m
        };
        let mut near: Vec<(f64, CellId)> = self
            .cells
            .iter()
            .filter(|(id, cell)| !cell.placed && **id != place.cell && may_be_near(cell))
            .map(|(id, cell)| {
                let limit = own.narrower(cell.limit);
                let away_m = limit.distance_m(cell.reference_m, place.position_m);
                (away_m / limit.radius_m(), *id)
            })
            .filter(|(share, _)| *share <= ENTER_SHARE)
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.into_iter()
            .map(|(_, id)| id)
            .find(|id| self.has_room(*id, std::slice::from_ref(place)))
    }

    /// Whether there is a cell that somebody has left too short a time ago.
    fn may_not_go_back(&self, place: &Place) -> bool {
        let left_s = place.left.iter().flatten().map(|(_, left_s)| *left_s);
        left_s.fold(f64::NEG_INFINITY, f64::max) > self.time_s - RETURN_S
    }

    /// Whether some may enter a cell: near enough to its reference, now and soon, and all near enough to where the
    /// reference then goes.
    fn has_room(&self, cell: CellId, entering: &[Place]) -> bool {
        let comes_back = |place: &Place| {
            place
                .left
                .iter()
                .flatten()
                .any(|(left, left_s)| *left == cell && self.time_s - left_s < RETURN_S)
        };
        if entering.iter().any(comes_back) {
            return false;
        }
        let Some(cell) = self.cells.get(&cell) else {
            return false;
        };
        let entering_limits = entering.iter().map(|place| self.limit_of(place));
        let limit = entering_limits.fold(cell.limit, CellLimit::narrower);
        let is_within = |from_m: DVec3, position_m: DVec3, share: f64| {
            limit.distance_m(from_m, position_m) <= share * limit.radius_m()
        };
        let is_near = |position_m| is_within(cell.reference_m, position_m, ENTER_SHARE);
        // Before the members are looked at: most cells that are passed have no room for where others are.
        if !entering.iter().all(|place| is_near(place.position_m)) {
            return false;
        }
        let members: Vec<&Place> = cell
            .members
            .iter()
            .filter_map(|viewer| self.places.get(viewer))
            .collect();
        let count = members.len().max(1) as f64;
        let velocity = members.iter().map(|place| place.velocity_m_per_s);
        let velocity = velocity.sum::<DVec3>() / count;
        let stays_near = |place: &Place| {
            is_near(place.position_m + (place.velocity_m_per_s - velocity) * AHEAD_S)
        };
        if !entering.iter().all(stays_near) {
            return false;
        }
        let all: Vec<DVec3> = members
            .into_iter()
            .chain(entering)
            .map(|place| place.position_m)
            .collect();
        let mean_m = all.iter().sum::<DVec3>() / all.len().max(1) as f64;
        all.iter()
            .all(|position_m| is_within(mean_m, *position_m, SETTLED_SHARE))
    }
}

fn mean(members: &[ViewerId], places: &BTreeMap<ViewerId, Place>) -> Option<DVec3> {
    let positions = members
        .iter()
        .filter_map(|viewer| Some(places.get(viewer)?.position_m));
    let (count, sum) = positions.fold((0, DVec3::ZERO), |(count, sum), position_m| {
        (count + 1, sum + position_m)
    });
    (count > 0).then(|| sum / f64::from(count))
}
