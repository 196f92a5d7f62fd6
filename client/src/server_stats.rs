//! The server's counters, as far as the load test reads them. What else a server says is ignored.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use skycell_protocol::{CellId, ViewerId};

/// `GET /api/v1/stats`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct ServerStats {
    /// What renders.
    pub adapter: AdapterStats,
    /// Counted since the server started.
    pub totals: Totals,
    /// The view cells as they are now.
    pub cells: Vec<CellStats>,
    /// The viewers as they are now.
    pub viewers: Vec<ViewerStats>,
    /// Jittered samples that a texel accumulates until it has converged.
    #[serde(default)]
    pub samples: Option<u32>,
    /// The service's own figures.
    #[serde(default)]
    pub service: ServiceStats,
    /// How wrong the caches are.
    #[serde(default)]
    pub audit: AuditStats,
    /// What is given up because memory or time do not suffice.
    #[serde(default)]
    pub losses: LossStats,
    /// Times of the latest frames by stage.
    #[serde(default)]
    pub latency: LatencyStats,
}

/// Times of frames' ways by stage: `input`, `march_wait`, `composite`, `readback`, `encode_wait`, `encode`, `to_socket`,
/// `network`, `decode`, `present`, `motion_to_photon`; those of which the server knows nothing are missing.
pub type LatencyStats = BTreeMap<String, StageTimes>;

/// What half and 95 of 100 of some times do not exceed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageTimes {
    /// Half of them are not longer.
    pub p50_ms: f64,
    /// 95 of 100 are not longer.
    pub p95_ms: f64,
}

/// How far cached texels are from texels marched anew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub struct AuditStats {
    /// 95 of 100 deviate by no more, percent; none before the first.
    #[serde(default)]
    pub p95_percent: Option<f64>,
}

/// What is given up because memory or time do not suffice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default)]
pub struct LossStats {
    /// Wanted tiles that found no room, since the start.
    pub tiles_refused: u64,
    /// Halvings of resolution, of the cell that has lost most.
    pub levels_lost_most: u32,
    /// How much is given up for want of time, 0 for nothing.
    pub rate_step: u32,
}

/// What the service counts beside the renderer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub struct ServiceStats {
    /// Processor time since the start, s.
    #[serde(default)]
    pub cpu_s: Option<f64>,
    /// Frames encoded since the start.
    #[serde(default)]
    pub frames_encoded: u64,
    /// Memory that its process holds.
    #[serde(default)]
    pub memory_bytes: Option<u64>,
}

/// What renders.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdapterStats {
    /// Name of the graphics adapter.
    pub name: String,
    /// Its driver.
    #[serde(default)]
    pub driver: String,
    /// The interface to it, such as Vulkan.
    #[serde(default)]
    pub backend: String,
    /// Whether it is a graphics card or the processor.
    #[serde(default)]
    pub device_type: String,
}

/// Counters that only grow, except `cache_bytes`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Totals {
    /// Texels marched, each sample counted.
    pub texels_updated: u64,
    /// Frames composited.
    pub frames_composited: u64,
    /// GPU time spent on texels.
    pub gpu_cache_ns: u64,
    /// GPU time spent on frames from the caches.
    pub gpu_composite_ns: u64,
    /// GPU time spent on frames of the screen-space renderer.
    pub gpu_screen_space_ns: u64,
    /// Rays marched by the screen-space renderer.
    pub screen_space_marches: u64,
    /// Memory that the caches hold now.
    pub cache_bytes: u64,
}

impl Totals {
    /// What was added since `before`; `cache_bytes` stays what it is now.
    #[must_use]
    pub fn since(&self, before: &Self) -> Self {
        Self {
            // A server that was started anew counts from zero.
            texels_updated: self.texels_updated.saturating_sub(before.texels_updated),
            frames_composited: self
                .frames_composited
                .saturating_sub(before.frames_composited),
            gpu_cache_ns: self.gpu_cache_ns.saturating_sub(before.gpu_cache_ns),
            gpu_composite_ns: self
                .gpu_composite_ns
                .saturating_sub(before.gpu_composite_ns),
            gpu_screen_space_ns: self
                .gpu_screen_space_ns
                .saturating_sub(before.gpu_screen_space_ns),
            screen_space_marches: self
                .screen_space_marches
                .saturating_sub(before.screen_space_marches),
            cache_bytes: self.cache_bytes,
        }
    }
}

/// A view cell.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct CellStats {
    /// Its number.
    pub id: CellId,
    /// Its name.
    #[serde(default)]
    pub name: String,
    /// Who shares it.
    pub viewers: Vec<ViewerId>,
    /// Texels that its viewers ask for, summed over them.
    pub texels_requested: u64,
    /// The same, each texel counted once.
    pub texels_unique: u64,
    /// Share of the requested texels that another viewer requests too, 0 to 1.
    pub overlap: f64,
    /// Texels that wait for an update.
    pub texels_pending: u64,
    /// Tiles in memory.
    pub tiles_resident: u64,
    /// Memory of its caches.
    pub bytes: u64,
    /// Nothing waits for an update.
    pub converged: bool,
}

/// A viewer.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct ViewerStats {
    /// Its number.
    pub id: ViewerId,
    /// Texels that it asks for.
    pub texels_requested: u64,
    /// Frames made for it.
    pub frames_composited: u64,
}

/// The cells of some viewers, taken together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CellsOfViewers {
    /// How many cells they are spread over; one if all stand together.
    pub cells: usize,
    /// How many of the viewers are in a cell and have texels requested for them.
    pub viewers_served: usize,
    /// Texels requested, summed over viewers.
    pub texels_requested: u64,
    /// Texels requested, each counted once.
    pub texels_unique: u64,
    /// Texels that wait for an update.
    pub texels_pending: u64,
    /// The server's measure, weighted by requested texels.
    pub overlap: f64,
    /// Memory of their caches.
    pub cache_bytes: u64,
    /// None of them waits for an update.
    pub converged: bool,
}

impl ServerStats {
    /// The cells that hold any of `viewers`.
    pub fn cells_of(&self, viewers: &[ViewerId]) -> CellsOfViewers {
        let cells: Vec<&CellStats> = self
            .cells
            .iter()
            .filter(|cell| cell.viewers.iter().any(|id| viewers.contains(id)))
            .collect();
        let texels_requested: u64 = cells.iter().map(|cell| cell.texels_requested).sum();
        let weighted_overlap: f64 = cells
            .iter()
            .map(|cell| cell.overlap * cell.texels_requested as f64)
            .sum();
        let served = |id: &&ViewerId| {
            cells.iter().any(|cell| cell.viewers.contains(id))
                && self
                    .viewers
                    .iter()
                    .any(|viewer| viewer.id == **id && viewer.texels_requested > 0)
        };
        CellsOfViewers {
            cells: cells.len(),
            viewers_served: viewers.iter().filter(served).count(),
            texels_requested,
            texels_unique: cells.iter().map(|cell| cell.texels_unique).sum(),
            texels_pending: cells.iter().map(|cell| cell.texels_pending).sum(),
            overlap: weighted_overlap / (texels_requested.max(1)) as f64,
            cache_bytes: cells.iter().map(|cell| cell.bytes).sum(),
            converged: !cells.is_empty() && cells.iter().all(|cell| cell.converged),
        }
    }

    /// Tiles in memory, in all cells.
    pub fn tiles_resident(&self) -> u64 {
        self.cells.iter().map(|cell| cell.tiles_resident).sum()
    }

    /// Viewers in all cells.
    pub fn viewers_in_cells(&self) -> usize {
        self.cells.iter().map(|cell| cell.viewers.len()).sum()
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn stats() -> ServerStats {
        let cell = |id: u32, viewers: &[u32], requested: u64, overlap: f64, converged: bool| {
            json!({"id": id, "name": "", "reference_m": [0, 2, 0], "viewers": viewers,
                "texels_requested": requested, "texels_unique": requested / 2, "overlap": overlap,
                "texels_pending": 0, "tiles_resident": 3, "bytes": 100, "converged": converged})
        };
        serde_json::from_value(json!({
            "adapter": {"name": "llvmpipe", "driver": "Mesa", "backend": "vulkan", "device_type": "Cpu"},
            "tick": 1,
            "totals": {"texels_updated": 10, "frames_composited": 2, "gpu_cache_ns": 5, "gpu_composite_ns": 6,
                "gpu_screen_space_ns": 0, "screen_space_marches": 0, "cache_bytes": 200, "ticks": 9},
            "cells": [cell(1, &[1, 2], 300, 0.5, true), cell(2, &[3], 100, 0.0, false), cell(3, &[9], 100, 0.0, false)],
            "viewers": [
                {"id": 1, "cell": 1, "texels_requested": 150, "frames_composited": 1, "frames_in_flight": 0},
                {"id": 2, "cell": 1, "texels_requested": 0, "frames_composited": 0, "frames_in_flight": 0},
                {"id": 3, "cell": 2, "texels_requested": 100, "frames_composited": 1, "frames_in_flight": 0}]
        }))
        .expect("stats")
    }

    #[test]
    fn only_the_cells_of_the_named_viewers_are_counted() {
        let together = stats().cells_of(&[ViewerId(1), ViewerId(2), ViewerId(3)]);
        assert_eq!(
            together,
            CellsOfViewers {
                cells: 2,
                viewers_served: 2,
                texels_requested: 400,
                texels_unique: 200,
                texels_pending: 0,
                overlap: 0.375,
                cache_bytes: 200,
                converged: false,
            }
        );
        assert!(stats().cells_of(&[ViewerId(1)]).converged);
    }

    #[test]
    fn viewers_in_no_cell_have_not_converged() {
        let none = stats().cells_of(&[ViewerId(77)]);
        assert_eq!((none.cells, none.converged, none.overlap), (0, false, 0.0));
    }

    #[test]
    fn a_server_that_started_anew_gives_no_negative_counts() {
        let before = Totals {
            texels_updated: 50,
            ..stats().totals
        };
        assert_eq!(stats().totals.since(&before).texels_updated, 0);
    }
}
