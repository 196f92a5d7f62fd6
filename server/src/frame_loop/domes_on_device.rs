//! Where domes stand in a cell, and when they go along with its reference.

use super::cells_on_device::ActiveCell;
use super::renderer::SkyRenderer;
use crate::march::{Proxy, ProxySetup, Surface};
use glam::DVec3;
use skycell_protocol::CellId;

/// A dome is left by who is farther from its middle than this share of its radius.
const DOME_LEFT_SHARE: f64 = 0.5;

impl SkyRenderer {
    /// How far from its middle a dome may be left, m; None of a shell.
    fn reach_m(&self, cell: &ActiveCell, proxy: &Proxy) -> Option<f64> {
        match self.sphere_of(cell, proxy).surface {
            Surface::Dome { radius_m } => Some(DOME_LEFT_SHARE * radius_m),
            Surface::Shell { .. } | Surface::ShellFromAbove { .. } => None,
        }
    }

    /// The same of a cell's smallest dome.
    fn least_reach_m(&self, cell: &ActiveCell) -> Option<f64> {
        self.proxies
            .iter()
            .filter_map(|proxy| self.reach_m(cell, proxy))
            .min_by(f64::total_cmp)
    }

    /// Whether a cell's reference is well inside its domes.
    pub(super) fn is_inside_domes(&self, id: CellId) -> bool {
        self.active_cells.get(&id).is_some_and(|cell| {
            let reference = cell.frame.from_world(cell.reference_m);
            self.proxies.iter().all(|proxy| {
                let off_m = self.anchor_m(cell, proxy.layer).distance(reference);
                self.reach_m(cell, proxy)
                    .is_some_and(|reach_m| off_m <= reach_m)
            })
        })
    }

    /// Whether a static dome goes on being marched from where it began, though viewers are about another place by now.
    pub(super) fn dome_stays(&self, id: CellId, reference_m: DVec3) -> bool {
        self.kept_on.setup == ProxySetup::StaticDome
            && self.active_cells.get(&id).is_some_and(|cell| {
                let reach_m = self.least_reach_m(cell).unwrap_or(0.0);
                cell.reference_m.distance(reference_m) <= reach_m
                    && (self.cells.limit()).share_storey(cell.reference_m, reference_m)
            })
    }

    /// How far aside of a cell's reference its anchors may be, and how far above or below it, m, where shells' may be as far
    /// as `of_shells_m`.
    pub(super) fn anchors_may_be_off(&self, cell: &ActiveCell, of_shells_m: [f64; 2]) -> [f64; 2] {
        if self.kept_on.follows() {
            return [self.kept_on.follow_m; 2];
        }
        // The reference stays well inside its domes.
        let [aside_m, rise_m] = of_shells_m;
        let reach_m = self.least_reach_m(cell).unwrap_or(f64::INFINITY);
        [aside_m.min(reach_m), rise_m]
    }
}
