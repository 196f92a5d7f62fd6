//! View cells: which viewers share caches, and where their rays start. Pure decisions; nothing here touches the device.
//!
//! Cells are placed by hand in the config, or form, follow, split, merge and vanish with the viewers ([`Cells::regroup`]).
//! The same viewers at the same places at the same times always give the same cells.

mod crowd;
mod error_curve;
mod grouping;
mod limit;

pub use crowd::{Crowd, CrowdMotion};
pub use error_curve::{
    ErrorAt, ErrorCurve, ErrorCurveError, ErrorCurveFile, ErrorCurves, ReadingCurve,
};
pub use limit::{CellLimit, Storeys};

use crate::config::PlacedCell;
use glam::DVec3;
use skycell_protocol::{CellId, ViewerId};
use std::collections::BTreeMap;

/// A viewer stays in a placed cell until it is this share farther away than the cell's radius.
const PLACED_HYSTERESIS: f64 = 1.1;

/// One cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// What people call it.
    pub name: String,
    /// Where rays start: x, altitude, z.
    pub reference_m: DVec3,
    /// Viewers belong to it within this distance.
    pub radius_m: f64,
    /// Whether the operator placed it.
    pub placed: bool,
    /// Who belongs to it, in the order of joining.
    pub members: Vec<ViewerId>,
    /// What keeps to the limits of all members, where the cell was not placed.
    limit: CellLimit,
    /// The reference is where it should be.
    is_settled: bool,
}

/// A viewer that is in another cell than before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellChange {
    /// Who.
    pub viewer: ViewerId,
    /// Where it was. The cell may be gone by now.
    pub from: CellId,
    /// Where it is.
    pub to: CellId,
}

#[derive(Clone, Copy, Debug)]
struct Place {
    position_m: DVec3,
    /// Where it was when all were grouped last.
    grouped_m: DVec3,
    /// Smoothed; a jump is no motion.
    velocity_m_per_s: DVec3,
    cell: CellId,
    /// How far it may be from its reference, where it is not as far as everybody.
    limit: Option<CellLimit>,
    /// The cells that it left last, and when, the last first.
    left: [Option<(CellId, f64)>; 4],
}

/// All cells and who belongs where.
#[derive(Debug)]
pub struct Cells {
    limit: CellLimit,
    cells: BTreeMap<CellId, Cell>,
    places: BTreeMap<ViewerId, Place>,
    next_id: u32,
    /// Time that groupings were told, s.
    time_s: f64,
    /// Who is in another cell than at the last grouping, and where that was.
    moved: BTreeMap<ViewerId, CellId>,
    /// Somebody has moved, come or gone, or a reference is on its way.
    restless: bool,
}

impl Cells {
    /// The placed cells; others form as viewers come.
    #[must_use]
    pub fn new(placed: &[PlacedCell], limit: CellLimit) -> Self {
        let mut cells = Self {
            limit,
            cells: BTreeMap::new(),
            places: BTreeMap::new(),
            next_id: 0,
            time_s: 0.0,
            moved: BTreeMap::new(),
            restless: false,
        };
        for cell in placed {
            cells.add(Cell {
                name: cell.name.clone(),
                reference_m: DVec3::from_array(cell.center_m),
                radius_m: cell.radius_m,
                placed: true,
                members: Vec::new(),
                limit,
                is_settled: true,
            });
        }
        cells
    }

    fn add(&mut self, cell: Cell) -> CellId {
        self.next_id += 1;
        let id = CellId(self.next_id);
        self.cells.insert(id, cell);
        id
    }

    /// How wide cells that form may be, where no member asks for less.
    #[must_use]
    pub fn limit(&self) -> CellLimit {
        self.limit
    }

    /// Gives cells that form another limit, which the next grouping keeps.
    pub fn set_limit(&mut self, limit: CellLimit) {
        let limit = limit.with_storeys(self.limit.storeys());
        if limit != self.limit {
            self.limit = limit;
            self.restless = true;
            let ids: Vec<CellId> = self.cells.keys().copied().collect();
            for id in ids {
                self.keep_to_limits(id);
            }
        }
    }

    /// Tells where layers are. Nobody on one side of a layer stays in a cell on another.
    pub fn set_storeys(&mut self, storeys: Storeys) {
        if storeys != self.limit.storeys() {
            self.limit = self.limit.with_storeys(storeys);
            self.restless = true;
            let ids: Vec<CellId> = self.cells.keys().copied().collect();
            for id in ids {
                self.keep_to_limits(id);
            }
        }
    }

    /// Says how far a viewer may be from the reference of a cell that forms, where that is not as far as everybody may. It
    /// narrows the cells that it is in, and no others.
    pub fn set_limit_of(&mut self, viewer: ViewerId, limit: Option<CellLimit>) {
        let Some(place) = self.places.get_mut(&viewer) else {
            return;
        };
        if place.limit != limit {
            place.limit = limit;
            self.restless = true;
            let cell = place.cell;
            self.keep_to_limits(cell);
        }
    }

    /// How far a viewer may be from its reference.
    fn limit_of(&self, place: &Place) -> CellLimit {
        let limit = place.limit.unwrap_or(self.limit);
        limit.with_storeys(self.limit.storeys())
    }

    /// A formed cell is as narrow as its members ask for.
    fn keep_to_limits(&mut self, id: CellId) {
        let Some(cell) = self.cells.get(&id).filter(|cell| !cell.placed) else {
            return;
        };
        let members = cell.members.iter();
        let limits = members.filter_map(|viewer| Some(self.limit_of(self.places.get(viewer)?)));
        let limit = limits.reduce(CellLimit::narrower).unwrap_or(self.limit);
        if let Some(cell) = self.cells.get_mut(&id) {
            cell.limit = limit;
            cell.radius_m = limit.radius_m();
        }
    }

    /// A cell.
    #[must_use]
    pub fn get(&self, id: CellId) -> Option<&Cell> {
        self.cells.get(&id)
    }

    /// Every cell, empty placed ones included.
    pub fn iter(&self) -> impl Iterator<Item = (CellId, &Cell)> {
        self.cells.iter().map(|(id, cell)| (*id, cell))
    }

    /// The cell of a viewer.
    #[must_use]
    pub fn cell_of(&self, viewer: ViewerId) -> Option<CellId> {
        self.places.get(&viewer).map(|place| place.cell)
    }

    /// Says where a viewer is. Who comes gets a cell at once; who has moved may get another one when all are grouped next.
    pub fn place(&mut self, viewer: ViewerId, position_m: DVec3) -> CellId {
        if let Some(place) = self.places.get_mut(&viewer) {
            self.restless |= place.position_m != position_m;
            place.position_m = position_m;
            return place.cell;
        }
        self.restless = true;
        let mut place = Place {
            position_m,
            grouped_m: position_m,
            velocity_m_per_s: DVec3::ZERO,
            cell: CellId(0),
            limit: None,
            left: [None; 4],
        };
        place.cell = self
            .nearest_placed(position_m)
            .or_else(|| self.nearest_formed(&place))
            .unwrap_or_else(|| self.form(position_m));
        self.places.insert(viewer, place);
        self.enter(viewer, place.cell);
        place.cell
    }

    /// Takes a viewer out of its cell.
    pub fn remove(&mut self, viewer: ViewerId) {
        if let Some(place) = self.places.remove(&viewer) {
            self.restless = true;
            self.leave(viewer, place.cell);
        }
    }

    fn form(&mut self, position_m: DVec3) -> CellId {
        self.add(Cell {
            name: format!("formed-{}", self.next_id + 1),
            reference_m: position_m,
            radius_m: self.limit.radius_m(),
            placed: false,
            members: Vec::new(),
            limit: self.limit,
            is_settled: true,
        })
    }

    fn enter(&mut self, viewer: ViewerId, cell: CellId) {
        let limit = self.places.get(&viewer).map(|place| self.limit_of(place));
        let Some(entered) = self.cells.get_mut(&cell) else {
            return;
        };
        entered.members.push(viewer);
        // All members are looked at only where one more can make a difference: a crowd that merges must not cost its square.
        if entered.members.len() == 1 || limit != Some(entered.limit) {
            self.keep_to_limits(cell);
        }
    }

    /// Formed cells without members go.
    fn leave(&mut self, viewer: ViewerId, cell: CellId) {
        let Some(left) = self.cells.get_mut(&cell) else {
            return;
        };
        left.members.retain(|member| *member != viewer);
        if !left.placed && left.members.is_empty() {
            self.cells.remove(&cell);
        } else if !self.is_kept_narrow(cell) {
            self.keep_to_limits(cell);
        }
    }

    /// Whether a member asks for what a cell keeps to. None asks for less, so it stays as it is.
    fn is_kept_narrow(&self, id: CellId) -> bool {
        self.cells.get(&id).is_some_and(|cell| {
            let mut members = cell.members.iter().filter_map(|m| self.places.get(m));
            members.any(|place| self.limit_of(place) == cell.limit)
        })
    }

    /// The nearest placed cell that holds a position, measured in its own radius.
    fn nearest_placed(&self, position_m: DVec3) -> Option<CellId> {
        self.cells
            .iter()
            .filter(|(_, cell)| cell.placed)
            .filter(|(_, cell)| self.limit.share_storey(cell.reference_m, position_m))
            .map(|(id, cell)| (cell.reference_m.distance(position_m) / cell.radius_m, *id))
            .filter(|(share, _)| *share <= 1.0)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, id)| id)
    }
}

#[cfg(test)]
mod tests;
