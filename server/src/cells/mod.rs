//! View cells: which viewers share caches, and where their rays start. Pure decisions; nothing here touches the device.
//!
//! Cells are placed by hand in the config or formed around the first viewer of a place. Clusters that form, split and
//! merge by themselves, and transitions between cells, will take the place of [`Cells::assign`].

use crate::config::PlacedCell;
use glam::DVec3;
use skycell_protocol::{CellId, ViewerId};
use std::collections::BTreeMap;

/// Viewers farther than this from a formed cell's reference form another one: where the error of a shared reference
/// becomes just noticeable sideways (Weinrauch et al. 2023, user study: 3 km).
pub const FORMED_RADIUS_M: f64 = 3_000.0;
/// A viewer stays in its cell until it is this share farther away than the cell's radius.
const HYSTERESIS: f64 = 1.1;
/// A formed cell follows its first viewer when it has moved this far; aged tiles are then marched from the new point.
const FOLLOW_M: f64 = 300.0;
/// The same upwards and downwards. A cloud's side is seen from another height at once: 150 m up cost as much as 1 km
/// sideways (mean difference of a picture 4 to 7 steps of 8 bits instead of 1, 96×56, 800 to 1400 m under a base of 1500 m).
const FOLLOW_UP_M: f64 = 30.0;

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
}

/// All cells and who belongs where.
#[derive(Debug, Default)]
pub struct Cells {
    cells: BTreeMap<CellId, Cell>,
    next_id: u32,
}

impl Cells {
    /// The placed cells; others form as viewers come.
    #[must_use]
    pub fn new(placed: &[PlacedCell]) -> Self {
        let mut cells = Self::default();
        for cell in placed {
            cells.add(Cell {
                name: cell.name.clone(),
                reference_m: DVec3::from_array(cell.center_m),
                radius_m: cell.radius_m,
                placed: true,
                members: Vec::new(),
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
        self.cells
            .iter()
            .find(|(_, cell)| cell.members.contains(&viewer))
            .map(|(id, _)| *id)
    }

    /// Puts a viewer at a position into exactly one cell: the one that it is in while that still holds it, else the
    /// nearest placed one, else the nearest formed one, else a new one around it. Formed cells without members go.
    pub fn assign(&mut self, viewer: ViewerId, position_m: DVec3) -> CellId {
        let current = self.cell_of(viewer);
        if let Some(id) = current
            && let Some(cell) = self.cells.get_mut(&id)
        {
            // Alone or first in a formed cell, a viewer takes the cell along.
            let leads = !cell.placed && cell.members.first() == Some(&viewer);
            let away = position_m - cell.reference_m;
            let away_m = away.length();
            let is_due = away.with_y(0.0).length() > FOLLOW_M || away.y.abs() > FOLLOW_UP_M;
            if leads && is_due && (cell.members.len() == 1 || away_m <= cell.radius_m) {
                cell.reference_m = position_m;
            }
            let holds = cell.reference_m.distance(position_m) <= cell.radius_m * HYSTERESIS;
            let better = !cell.placed && self.nearest(position_m, true).is_some();
            if holds && !better {
                return id;
            }
        }
        self.remove(viewer);
        let id = self
            .nearest(position_m, true)
            .or_else(|| self.nearest(position_m, false))
            .unwrap_or_else(|| {
                let name = format!("formed-{}", self.next_id + 1);
                self.add(Cell {
                    name,
                    reference_m: position_m,
                    radius_m: FORMED_RADIUS_M,
                    placed: false,
                    members: Vec::new(),
                })
            });
        if let Some(cell) = self.cells.get_mut(&id) {
            cell.members.push(viewer);
        }
        id
    }

    /// The nearest cell of a kind that holds a position, measured in its own radius.
    fn nearest(&self, position_m: DVec3, placed: bool) -> Option<CellId> {
        self.cells
            .iter()
            .filter(|(_, cell)| cell.placed == placed)
            .map(|(id, cell)| (cell.reference_m.distance(position_m) / cell.radius_m, *id))
            .filter(|(share, _)| *share <= 1.0)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, id)| id)
    }

    /// Takes a viewer out of its cell.
    pub fn remove(&mut self, viewer: ViewerId) {
        for cell in self.cells.values_mut() {
            cell.members.retain(|member| *member != viewer);
        }
        self.cells
            .retain(|_, cell| cell.placed || !cell.members.is_empty());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plaza() -> Cells {
        Cells::new(&[PlacedCell {
            name: "plaza".into(),
            center_m: [10_000.0, 2.0, 0.0],
            radius_m: 500.0,
        }])
    }

    fn at(x: f64) -> DVec3 {
        DVec3::new(x, 2.0, 0.0)
    }

    #[test]
    fn each_viewer_belongs_to_exactly_one_cell() {
        let mut cells = plaza();
        for viewer in 0..20 {
            for step in 0..5 {
                let x = f64::from((viewer * 733 + step * 977) % 12_000);
                cells.assign(ViewerId(viewer), at(x));
                let homes = cells
                    .iter()
                    .filter(|(_, cell)| cell.members.contains(&ViewerId(viewer)))
                    .count();
                assert_eq!(homes, 1);
            }
        }
    }

    #[test]
    fn a_placed_cell_takes_those_who_stand_in_it_and_keeps_its_reference() {
        let mut cells = plaza();
        let first = cells.assign(ViewerId(1), at(10_300.0));
        let second = cells.assign(ViewerId(2), at(9_800.0));
        assert_eq!(first, second);
        let cell = cells.get(first).expect("there");
        assert_eq!(
            (cell.name.as_str(), cell.reference_m),
            ("plaza", at(10_000.0))
        );
    }

    #[test]
    fn viewers_near_each_other_share_a_formed_cell_and_far_ones_do_not() {
        let mut cells = plaza();
        let a = cells.assign(ViewerId(1), at(0.0));
        let b = cells.assign(ViewerId(2), at(2_000.0));
        let c = cells.assign(ViewerId(3), at(1.0e7));
        assert_eq!(a, b);
        assert_ne!(a, c);
    }

    #[test]
    fn nobody_flips_back_and_forth_at_an_edge() {
        let mut cells = plaza();
        cells.assign(ViewerId(1), at(9_600.0));
        let mut changes = 0;
        let mut last = cells.cell_of(ViewerId(1));
        for step in 0..100 {
            let x = if step % 2 == 0 { 9_495.0 } else { 9_505.0 };
            let now = Some(cells.assign(ViewerId(1), at(x)));
            changes += u32::from(now != last);
            last = now;
        }
        assert_eq!(changes, 0);
    }

    #[test]
    fn a_formed_cell_goes_with_its_last_viewer() {
        let mut cells = plaza();
        cells.assign(ViewerId(1), at(0.0));
        cells.remove(ViewerId(1));
        assert_eq!(cells.iter().count(), 1);
    }

    #[test]
    fn a_formed_cell_follows_its_viewer_upwards_in_small_steps() {
        let mut cells = Cells::new(&[]);
        let up = |y: f64| DVec3::new(0.0, y, 0.0);
        let id = cells.assign(ViewerId(1), up(2.0));
        for (y, reference_y) in [(20.0, 2.0), (40.0, 40.0), (60.0, 40.0), (1400.0, 1400.0)] {
            assert_eq!(cells.assign(ViewerId(1), up(y)), id);
            assert_eq!(
                cells.get(id).map(|cell| cell.reference_m.y),
                Some(reference_y)
            );
        }
    }
}
