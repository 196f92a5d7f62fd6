//! What a load test found, and how far it is from the ideal: cost proportional to unique texels.

use serde::Serialize;
use skycell_protocol::Stereo;

use super::viewer::{TimesMs, ViewerFigures};
use crate::server_stats::{AdapterStats, LatencyStats};

/// A whole load test; the file that `--json` names.
#[derive(Clone, Debug, Serialize)]
pub struct LoadReport {
    /// Version of this format.
    pub format: u32,
    /// The server.
    pub url: String,
    /// What rendered.
    pub adapter: AdapterStats,
    /// When the test began, seconds since 1970.
    pub started_unix_s: u64,
    /// Revision of the scene, if its tag is a number.
    pub scene_revision: Option<u64>,
    /// The wind was taken out for the test.
    pub wind_off: bool,
    /// Viewers at one place.
    pub viewers: u32,
    /// Pixels in a row of an eye's picture.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Every viewer has two eyes; null for one.
    pub stereo: Option<Stereo>,
    /// Frames per second that each viewer wished.
    pub fps: f64,
    /// Where all stood: x, altitude, z.
    pub position_m: [f64; 3],
    /// How far up all looked.
    pub pitch_deg: f64,
    /// Across a picture.
    pub horizontal_fov_deg: f64,
    /// Between a picture's upper and lower edge.
    pub vertical_fov_deg: f64,
    /// Updates until a texel has converged.
    pub samples_per_texel: u32,
    /// How fast all turned in the turning phase.
    pub turn_speed_deg_per_s: f64,
    /// Viewers decoded frames before they acknowledged them.
    pub decodes: bool,
    /// One entry per overlap, in the order of measuring.
    pub overlaps: Vec<OverlapReport>,
}

/// One overlap.
#[derive(Clone, Debug, Serialize)]
pub struct OverlapReport {
    /// By angles.
    pub nominal_overlap_percent: f64,
    /// How far neighbours were turned against each other.
    pub turn_between_neighbours_deg: f64,
    /// No tile was in memory when the viewers came.
    pub cold_start: bool,
    /// Tiles that were.
    pub tiles_at_start: u64,
    /// The server said that nothing waits for an update; otherwise the wait ran out.
    pub converged: bool,
    /// How long that took.
    pub converge_s: f64,
    /// Cells that the viewers were spread over; one, if all is well.
    pub cells: usize,
    /// The server's measure: share of the requested texels that another viewer requests too, 0 to 1.
    pub measured_overlap: f64,
    /// Texels requested, summed over viewers.
    pub texels_requested: u64,
    /// Texels requested, each counted once.
    pub texels_unique: u64,
    /// Texel updates from the first viewer's coming until all had converged.
    pub texels_updated: u64,
    /// Frames composited in that time.
    pub frames_composited: u64,
    /// GPU time of texel updates in that time.
    pub gpu_cache_ms: f64,
    /// GPU time of composites in that time.
    pub gpu_composite_ms: f64,
    /// Memory of the viewers' cells.
    pub cache_bytes: u64,
    /// How far from the ideal.
    pub ideal: IdealComparison,
    /// The same views by the screen-space renderer.
    pub screen_space: Option<ScreenSpaceFigures>,
    /// All viewers turning.
    pub turning: Option<TurningReport>,
}

/// Figures against the ideal, in which cost follows the unique texels. None: nothing to divide by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct IdealComparison {
    /// Unique of requested texels.
    pub unique_share: Option<f64>,
    /// The same by angles alone.
    pub unique_share_by_angles: f64,
    /// Updates per unique texel and sample: 1 is ideal, more is work that nobody asked for.
    pub updates_per_unique_sample: Option<f64>,
    /// Unique texels against those of the smallest overlap.
    pub unique_ratio: Option<f64>,
    /// Updates against those of the smallest overlap.
    pub updated_ratio: Option<f64>,
    /// GPU time of updates against that of the smallest overlap.
    pub gpu_cache_ratio: Option<f64>,
    /// `updated_ratio / unique_ratio`: 1 is ideal.
    pub updated_excess: Option<f64>,
    /// `gpu_cache_ratio / unique_ratio`: 1 is ideal.
    pub gpu_cache_excess: Option<f64>,
}

/// The same views by the screen-space renderer, one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ScreenSpaceFigures {
    /// How many views.
    pub views: u32,
    /// Rays marched: one per pixel and frame, and the server may have made more than one frame.
    pub marches: u64,
    /// GPU time of all of them.
    pub gpu_ms: f64,
    /// GPU time that one frame of one ray per pixel takes for all views.
    pub gpu_ms_once: Option<f64>,
    /// Rays that one frame of one ray per pixel takes for all views.
    pub marches_once: u64,
}

/// The turning phase.
#[derive(Clone, Debug, Serialize)]
pub struct TurningReport {
    /// For how long.
    pub seconds: f64,
    /// Texel updates in that time.
    pub texels_updated: u64,
    /// GPU time of texel updates in that time.
    pub gpu_cache_ms: f64,
    /// GPU time of composites in that time.
    pub gpu_composite_ms: f64,
    /// Frames composited in that time.
    pub frames_composited: u64,
    /// Processor time of the server, over all cores, for each frame that a viewer got: everything included.
    pub server_cpu_ms_per_frame: Option<f64>,
    /// Of the slowest viewer.
    pub fps_min: f64,
    /// Of the viewer in the middle.
    pub fps_median: f64,
    /// Over the frames of all viewers.
    pub frame_age_ms: TimesMs,
    /// From sending a camera until the first frame with it was shown, over all viewers.
    pub motion_to_photon_ms: TimesMs,
    /// Where that time goes, as the server tells of its latest frames, by stage.
    pub stages: LatencyStats,
    /// Each viewer, in the order of the ring.
    pub viewers: Vec<ViewerFigures>,
}

impl LoadReport {
    /// Fills in every overlap's comparison with the ideal. `unique_share_by_angles` is kept.
    pub fn compare_with_ideal(&mut self) {
        let Some(reference) = self
            .overlaps
            .iter()
            .min_by(|a, b| {
                a.nominal_overlap_percent
                    .total_cmp(&b.nominal_overlap_percent)
            })
            .cloned()
        else {
            return;
        };
        for overlap in &mut self.overlaps {
            overlap.ideal = overlap.compared_with(&reference, self.samples_per_texel);
        }
    }
}

impl OverlapReport {
    fn compared_with(&self, reference: &Self, samples_per_texel: u32) -> IdealComparison {
        let of = |part: u64, whole: u64| quotient(part as f64, whole as f64);
        let unique_ratio = of(self.texels_unique, reference.texels_unique);
        let updated_ratio = of(self.texels_updated, reference.texels_updated);
        let gpu_cache_ratio = quotient(self.gpu_cache_ms, reference.gpu_cache_ms);
        let excess = |ratio: Option<f64>| quotient(ratio?, unique_ratio?);
        IdealComparison {
            unique_share: of(self.texels_unique, self.texels_requested),
            unique_share_by_angles: self.ideal.unique_share_by_angles,
            updates_per_unique_sample: of(
                self.texels_updated,
                self.texels_unique * u64::from(samples_per_texel),
            ),
            unique_ratio,
            updated_ratio,
            gpu_cache_ratio,
            updated_excess: excess(updated_ratio),
            gpu_cache_excess: excess(gpu_cache_ratio),
        }
    }
}

fn quotient(part: f64, whole: f64) -> Option<f64> {
    (whole > 0.0).then(|| part / whole)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(crate) fn overlap(
        nominal_percent: f64,
        unique: u64,
        updated: u64,
        gpu_ms: f64,
    ) -> OverlapReport {
        OverlapReport {
            nominal_overlap_percent: nominal_percent,
            turn_between_neighbours_deg: 22.5 * (1.0 - nominal_percent / 100.0),
            cold_start: true,
            tiles_at_start: 0,
            converged: true,
            converge_s: 3.0,
            cells: 1,
            measured_overlap: nominal_percent / 100.0,
            texels_requested: 16_000,
            texels_unique: unique,
            texels_updated: updated,
            frames_composited: 160,
            gpu_cache_ms: gpu_ms,
            gpu_composite_ms: 50.0,
            cache_bytes: 1 << 20,
            ideal: IdealComparison {
                unique_share_by_angles: 0.5,
                ..IdealComparison::default()
            },
            screen_space: None,
            turning: None,
        }
    }

    pub(crate) fn report(overlaps: Vec<OverlapReport>) -> LoadReport {
        let mut report = LoadReport {
            format: 1,
            url: "ws://sky.test/ws".to_owned(),
            adapter: AdapterStats::default(),
            started_unix_s: 0,
            scene_revision: Some(1),
            wind_off: false,
            viewers: 16,
            width: 640,
            height: 360,
            stereo: None,
            fps: 30.0,
            position_m: [0.0, 2.0, 0.0],
            pitch_deg: 12.0,
            horizontal_fov_deg: 22.5,
            vertical_fov_deg: 12.8,
            samples_per_texel: 8,
            turn_speed_deg_per_s: 10.0,
            decodes: false,
            overlaps,
        };
        report.compare_with_ideal();
        report
    }

    #[test]
    fn a_server_whose_cost_follows_the_unique_texels_is_ideal() {
        let report = report(vec![
            overlap(100.0, 1_000, 8_000, 10.0),
            overlap(0.0, 16_000, 128_000, 160.0),
        ]);
        for overlap in &report.overlaps {
            assert_eq!(overlap.ideal.updates_per_unique_sample, Some(1.0));
            assert_eq!(overlap.ideal.updated_excess, Some(1.0));
            assert_eq!(overlap.ideal.gpu_cache_excess, Some(1.0));
        }
        assert_eq!(report.overlaps[0].ideal.unique_ratio, Some(1.0 / 16.0));
        assert_eq!(report.overlaps[0].ideal.unique_share_by_angles, 0.5);
    }

    #[test]
    fn viewers_that_share_nothing_show_as_excess() {
        // At full overlap the cost stays that of no overlap.
        let report = report(vec![
            overlap(0.0, 16_000, 128_000, 160.0),
            overlap(100.0, 1_000, 128_000, 160.0),
        ]);
        let worst = report.overlaps[1].ideal;
        assert_eq!(worst.updates_per_unique_sample, Some(16.0));
        assert_eq!(worst.gpu_cache_ratio, Some(1.0));
        assert_eq!(worst.gpu_cache_excess, Some(16.0));
    }

    #[test]
    fn nothing_is_divided_by_nothing() {
        let empty = OverlapReport {
            texels_requested: 0,
            ..overlap(0.0, 0, 0, 0.0)
        };
        let ideal = report(vec![empty]).overlaps[0].ideal;
        assert_eq!(
            ideal,
            IdealComparison {
                unique_share_by_angles: 0.5,
                ..IdealComparison::default()
            }
        );
    }

    #[test]
    fn the_report_is_json_with_units_in_its_keys() {
        let json =
            serde_json::to_value(report(vec![overlap(20.0, 1, 8, 1.0)])).expect("serialises");
        for pointer in [
            "/overlaps/0/nominal_overlap_percent",
            "/overlaps/0/gpu_cache_ms",
            "/overlaps/0/ideal/updates_per_unique_sample",
            "/horizontal_fov_deg",
            "/adapter/name",
        ] {
            assert!(json.pointer(pointer).is_some(), "{pointer}");
        }
    }
}
