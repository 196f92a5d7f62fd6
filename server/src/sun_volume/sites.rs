//! Which view cells share a volume.

use glam::DVec2;
use skycell_protocol::CellId;
use std::collections::BTreeMap;

/// Most volumes at a time; cells beyond them are served by the cone.
pub const SITES_MAX: usize = 4;

/// A place around which a volume stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SiteId(pub u32);

/// Cells by the volume that they share.
#[derive(Debug, Default)]
pub struct Sites {
    of_cell: BTreeMap<CellId, SiteId>,
    next: u32,
}

impl Sites {
    /// Gives each of the cells (with its world x and z) a site. A cell stays with its site while it is within twice
    /// `join_m` of the site's first cell, joins another within `join_m`, or founds one, as long as there are not too many.
    pub fn assign(&mut self, cells: &[(CellId, DVec2)], join_m: f64) {
        let before = std::mem::take(&mut self.of_cell);
        let mut centers: Vec<(SiteId, DVec2)> = Vec::new();
        // Those that stay come first, so that a site keeps its number.
        let (held, others): (Vec<(CellId, DVec2)>, Vec<_>) =
            cells.iter().partition(|(id, _)| before.contains_key(id));
        for (id, at) in held.into_iter().chain(others) {
            let old = before.get(&id).copied();
            let near = |reach_m: f64, site: Option<SiteId>| {
                centers
                    .iter()
                    .find(|(held, center)| {
                        site.is_none_or(|site| site == *held) && center.distance(at) <= reach_m
                    })
                    .map(|(held, _)| *held)
            };
            let is_taken = old.is_some_and(|old| centers.iter().any(|(held, _)| *held == old));
            let found = match old {
                Some(old) if !is_taken => None.or(near(0.5 * join_m, None)).or(Some(old)),
                Some(old) => near(2.0 * join_m, Some(old)).or_else(|| near(join_m, None)),
                None => near(join_m, None),
            };
            let site = match found {
                Some(site) => site,
                None if centers.len() < SITES_MAX => {
                    self.next += 1;
                    SiteId(self.next)
                }
                None => continue,
            };
            if !centers.iter().any(|(held, _)| *held == site) {
                if centers.len() >= SITES_MAX {
                    continue;
                }
                centers.push((site, at));
            }
            self.of_cell.insert(id, site);
        }
    }

    /// The site of a cell.
    #[must_use]
    pub fn of(&self, cell: CellId) -> Option<SiteId> {
        self.of_cell.get(&cell).copied()
    }

    /// The sites, each with its first cell.
    #[must_use]
    pub fn first_cells(&self) -> BTreeMap<SiteId, CellId> {
        let mut first = BTreeMap::new();
        for (cell, site) in &self.of_cell {
            first.entry(*site).or_insert(*cell);
        }
        first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(id: u32, x_m: f64) -> (CellId, DVec2) {
        (CellId(id), DVec2::new(x_m, 0.0))
    }

    #[test]
    fn near_cells_share_a_site_and_far_ones_do_not() {
        let mut sites = Sites::default();
        sites.assign(&[cell(1, 0.0), cell(2, 500.0), cell(3, 1e7)], 800.0);
        assert_eq!(sites.of(CellId(1)), sites.of(CellId(2)));
        assert_ne!(sites.of(CellId(1)), sites.of(CellId(3)));
        assert_eq!(sites.first_cells().len(), 2);
    }

    #[test]
    fn there_are_never_more_sites_than_allowed() {
        let mut sites = Sites::default();
        let cells: Vec<_> = (0..20).map(|i| cell(i, 1e5 * f64::from(i))).collect();
        for _ in 0..3 {
            sites.assign(&cells, 800.0);
            assert_eq!(sites.first_cells().len(), SITES_MAX);
        }
        let alone: Vec<_> = cells
            .iter()
            .filter(|(id, _)| sites.of(*id).is_none())
            .collect();
        assert_eq!(alone.len(), 20 - SITES_MAX);
    }

    #[test]
    fn a_cell_keeps_its_site_until_it_is_far_away() {
        let mut sites = Sites::default();
        sites.assign(&[cell(1, 0.0), cell(2, 700.0)], 800.0);
        let first = sites.of(CellId(1));
        sites.assign(&[cell(1, 0.0), cell(2, 1500.0)], 800.0);
        assert_eq!(sites.of(CellId(2)), first);
        sites.assign(&[cell(1, 0.0), cell(2, 1700.0)], 800.0);
        assert_ne!(sites.of(CellId(2)), first);
        // A lone cell that moves keeps its own.
        let own = sites.of(CellId(2));
        sites.assign(&[cell(2, 9000.0)], 800.0);
        assert_eq!(sites.of(CellId(2)), own);
    }
}
