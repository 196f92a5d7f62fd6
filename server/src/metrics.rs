//! The service's figures for Prometheus. Each service has its own recorder, so that several can
//! run in one process (tests do).

mod service;

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use metrics::{
    Counter, Histogram, Unit, counter, describe_counter, describe_gauge, describe_histogram, gauge,
    histogram, with_local_recorder,
};
use metrics_exporter_prometheus::{
    BuildError, Matcher, PrometheusBuilder, PrometheusHandle, PrometheusRecorder,
};
use metrics_util::MetricKindMask;

use skycell_protocol::FrameStages;

use crate::access::Refusal;
use crate::frame_loop::interface::RenderStats;
use crate::viewers::{Acknowledged, Latencies, LatencyReport, Stage};
pub use service::ServiceFigures;

/// Edges of the buckets of durations: from a small JPEG to a frame that is useless.
const DURATION_BUCKETS_S: [f64; 14] = [
    0.000_5, 0.001, 0.002, 0.004, 0.008, 0.016, 0.033, 0.066, 0.1, 0.2, 0.4, 0.8, 1.6, 5.0,
];

/// Gauges of cells that are gone leave the page after this time.
const GAUGE_IDLE_TIMEOUT: Duration = Duration::from_secs(60);

/// Of how many of the latest frames of all viewers percentiles are told.
const LATENCIES_MAX: usize = 1024;

/// Counters and histograms that the service writes as things happen.
pub struct Metrics {
    recorder: PrometheusRecorder,
    page: PrometheusHandle,
    /// Frames handed to sockets.
    pub frames_sent: Counter,
    /// Frames replaced by newer ones before they were encoded or sent.
    pub frames_dropped: Counter,
    /// Bytes of messages handed to sockets.
    pub bytes_sent: Counter,
    /// Duration of encoding a JPEG.
    pub encode_jpeg_s: Histogram,
    /// Duration of encoding a PNG.
    pub encode_png_s: Histogram,
    /// Duration of encoding clouds alone.
    pub encode_clouds_s: Histogram,
    /// Duration of encoding a picture of an H.264 stream.
    pub encode_h264_s: Histogram,
    /// From readback until an encoder takes the frame.
    pub encode_wait_s: Histogram,
    /// From the composite's submission until the client's acknowledgement.
    pub frame_age_s: Histogram,
    /// By [`Refusal::ALL`].
    refusals: [Counter; Refusal::ALL.len()],
    /// Frames that were encoded.
    pub frames_encoded: AtomicU64,
    /// Durations of the stages of frames' ways, in the order of [`Stage::ALL`].
    stages_s: [Histogram; Stage::ALL.len()],
    latencies: Mutex<Latencies>,
}

impl Metrics {
    /// Figures that all stand at zero.
    ///
    /// # Errors
    /// If the exporter refuses its settings.
    pub fn new() -> Result<Self, BuildError> {
        let recorder = PrometheusBuilder::new()
            .set_buckets_for_metric(Matcher::Suffix("_seconds".to_owned()), &DURATION_BUCKETS_S)?
            .idle_timeout(MetricKindMask::GAUGE, Some(GAUGE_IDLE_TIMEOUT))
            .build_recorder();
        let page = recorder.handle();
        let metrics = with_local_recorder(&recorder, || {
            describe();
            (
                counter!("skycell_frames_sent_total"),
                counter!("skycell_frames_dropped_total"),
                counter!("skycell_bytes_sent_total"),
                histogram!("skycell_encode_seconds", "codec" => "jpeg"),
                histogram!("skycell_encode_seconds", "codec" => "png"),
                histogram!("skycell_encode_wait_seconds"),
                histogram!("skycell_frame_age_seconds"),
                histogram!("skycell_encode_seconds", "codec" => "clouds"),
                Refusal::ALL
                    .map(|refusal| counter!("skycell_refusals_total", "reason" => refusal.name())),
                Stage::ALL.map(stage_histogram),
                histogram!("skycell_encode_seconds", "codec" => "h264"),
            )
        });
        Ok(Self {
            recorder,
            page,
            frames_sent: metrics.0,
            frames_dropped: metrics.1,
            bytes_sent: metrics.2,
            encode_jpeg_s: metrics.3,
            encode_png_s: metrics.4,
            encode_wait_s: metrics.5,
            frame_age_s: metrics.6,
            encode_clouds_s: metrics.7,
            refusals: metrics.8,
            frames_encoded: AtomicU64::new(0),
            stages_s: metrics.9,
            latencies: Mutex::new(Latencies::new(LATENCIES_MAX)),
            encode_h264_s: metrics.10,
        })
    }

    /// Counts somebody who was refused.
    pub fn refused(&self, refusal: Refusal) {
        if let Some(index) = Refusal::ALL.iter().position(|known| *known == refusal) {
            self.refusals[index].increment(1);
        }
    }

    /// Counts a frame that is handed to a socket, and the time that it took by stage.
    pub fn sent(&self, stages: &FrameStages) {
        self.frames_sent.increment(1);
        self.took(Stage::of_header(stages));
    }

    /// Counts what an acknowledgement tells.
    pub fn acknowledged(&self, told: &Acknowledged) {
        if let Some(age_us) = told.age_us {
            self.frame_age_s.record(age_us as f64 * 1.0e-6);
        }
        self.took(told.stages.iter().copied());
    }

    fn took(&self, times_us: impl Iterator<Item = (Stage, u64)>) {
        let mut latencies = self.latencies();
        for (stage, time_us) in times_us {
            self.stages_s[stage as usize].record(time_us as f64 * 1.0e-6);
            latencies.push(stage, time_us);
        }
    }

    /// Percentiles of the latest frames of all viewers, by stage.
    pub fn latency_report(&self) -> LatencyReport {
        self.latencies().report()
    }

    fn latencies(&self) -> MutexGuard<'_, Latencies> {
        // A ring of numbers is whole whenever a panic may come.
        self.latencies
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Folds recorded durations into their buckets. To be called every few seconds: until then
    /// each one takes memory.
    pub fn fold(&self) {
        self.page.run_upkeep();
    }

    /// The page that Prometheus reads.
    pub fn render(&self, viewers: usize, stats: &RenderStats) -> String {
        with_local_recorder(&self.recorder, || {
            let encoded = self.frames_encoded.load(Ordering::Relaxed);
            counter!("skycell_frames_encoded_total").absolute(encoded);
            set_render_figures(viewers, stats);
        });
        self.page.render()
    }
}

fn stage_histogram(stage: Stage) -> Histogram {
    match stage {
        Stage::MotionToPhoton => histogram!("skycell_motion_to_photon_seconds"),
        stage => histogram!("skycell_frame_stage_seconds", "stage" => stage.name()),
    }
}

fn describe() {
    service::describe();
    describe_counter!("skycell_frames_encoded_total", "Frames encoded");
    describe_histogram!(
        "skycell_frame_stage_seconds",
        "Durations of the stages of frames' ways, from the input's arrival to the screen"
    );
    describe_histogram!(
        "skycell_motion_to_photon_seconds",
        "From a client's sending an input until it showed the first frame with it, as it says"
    );
    describe_gauge!("skycell_viewers", "Connected viewers");
    describe_counter!("skycell_frames_sent_total", "Frames handed to sockets");
    describe_counter!(
        "skycell_frames_dropped_total",
        "Frames replaced by newer ones before they were encoded or sent"
    );
    describe_counter!(
        "skycell_bytes_sent_total",
        Unit::Bytes,
        "Bytes of messages handed to sockets"
    );
    describe_counter!(
        "skycell_refusals_total",
        "Requests, viewers and connections that were refused, by reason"
    );
    describe_histogram!("skycell_encode_seconds", "Duration of encoding a frame");
    describe_histogram!(
        "skycell_encode_wait_seconds",
        "From a frame's readback until an encoder takes it"
    );
    describe_histogram!(
        "skycell_frame_age_seconds",
        "From a composite's submission until the client's acknowledgement"
    );
    describe_counter!("skycell_ticks_total", "Turns of the frame loop");
    describe_counter!(
        "skycell_submissions_total",
        "Command buffers submitted to the GPU"
    );
    describe_counter!("skycell_dispatches_total", "Compute dispatches and draws");
    describe_counter!("skycell_texels_updated_total", "Cache texels marched");
    describe_counter!("skycell_tiles_updated_total", "Cache tiles marched");
    describe_counter!(
        "skycell_tiles_resampled_total",
        "Cache tiles filled from others when a cell got new anchors"
    );
    describe_counter!("skycell_tiles_evicted_total", "Cache tiles given up");
    describe_counter!(
        "skycell_texels_audited_total",
        "Cache texels marched again to see how wrong the cache is"
    );
    describe_gauge!(
        "skycell_cache_error_percent",
        "Deviation of cached texels from texels marched anew, by quantile"
    );
    describe_gauge!(
        "skycell_scene_quality_flip",
        "Mean FLIP of what is picked for viewers who ask for no quality"
    );
    describe_gauge!(
        "skycell_viewer_quality_flip",
        "Mean FLIP of what is picked for a viewer"
    );
    describe_gauge!(
        "skycell_viewer_frame_device_seconds",
        Unit::Seconds,
        "Device time of a viewer's frame: composite and its share of marching"
    );
    describe_counter!("skycell_frames_composited_total", "Frames composited");
    describe_counter!("skycell_frames_read_back_total", "Frames read back");
    describe_counter!(
        "skycell_screen_space_marches_total",
        "Rays marched by the screen-space renderer"
    );
    describe_counter!(
        "skycell_gpu_nanoseconds_total",
        Unit::Nanoseconds,
        "GPU time by pass"
    );
    describe_gauge!("skycell_cache_bytes", Unit::Bytes, "GPU memory of caches");
    describe_gauge!(
        "skycell_sun_volume_bytes",
        Unit::Bytes,
        "GPU memory of sun volumes"
    );
    describe_counter!(
        "skycell_sun_volume_evaluations_total",
        "Look-ups of density for columns of sun volumes"
    );
    describe_counter!(
        "skycell_sun_volume_columns_total",
        "Columns of sun volumes made"
    );
    describe_gauge!(
        "skycell_light_shaft_bytes",
        Unit::Bytes,
        "GPU memory of light shafts"
    );
    describe_counter!(
        "skycell_light_shaft_evaluations_total",
        "Look-ups of density and steps through the air for light shafts"
    );
    describe_counter!(
        "skycell_light_shaft_tables_total",
        "Tables of light shafts made"
    );
    describe_gauge!(
        "skycell_viewers_in_transition",
        "Viewers on their way from one view cell to another"
    );
    describe_gauge!(
        "skycell_viewers_with_rays_in_transition",
        "Those of them whose frames are made by rays of their own"
    );
    describe_gauge!(
        "skycell_cells_kept",
        "View cells without members whose caches are kept for viewers on their way"
    );
    describe_gauge!(
        "skycell_transition_picture_bytes",
        Unit::Bytes,
        "GPU memory of the second pictures of viewers on their way"
    );
    describe_counter!(
        "skycell_cell_changes_total",
        "Changes of view cells by how they were shown: on a way, or at once for want of room or time"
    );
    describe_gauge!(
        "skycell_cache_tiles_wished",
        "Tiles that caches would hold if nothing were given up"
    );
    describe_gauge!("skycell_cache_tiles_max", "Tiles that caches may hold");
    describe_counter!(
        "skycell_tiles_refused_total",
        "Wanted tiles that found no room because not even the coarse levels fit"
    );
    describe_gauge!(
        "skycell_cell_levels_lost",
        "Halvings of resolution that a view cell has lost because memory or time do not suffice"
    );
    describe_gauge!(
        "skycell_rate_step",
        "How much is given up because the time for marching does not suffice, 0 for nothing"
    );
    describe_gauge!(
        "skycell_march_backlog_seconds",
        Unit::Seconds,
        "How long the marches that wait take, at their share of the time"
    );
    describe_counter!(
        "skycell_loss_changes_total",
        "How often something was given up or came back, by what does not suffice"
    );
    describe_counter!(
        "skycell_frames_held_total",
        "Frames that waited for tiles, by whether they were a viewer's first"
    );
    describe_gauge!("skycell_scene_revision", "Revision of the rendered scene");
    describe_gauge!("skycell_cell_viewers", "Viewers of a view cell");
    describe_gauge!(
        "skycell_cell_overlap",
        "Share of requested texels that another viewer of the cell requests too"
    );
    describe_gauge!(
        "skycell_cell_texels_requested",
        "Texels requested, summed over the cell's viewers"
    );
    describe_gauge!(
        "skycell_cell_texels_unique",
        "Texels requested, each counted once"
    );
    describe_gauge!(
        "skycell_cell_texels_pending",
        "Texels that wait for an update"
    );
    describe_gauge!("skycell_cell_tiles_resident", "Tiles that are allocated");
    describe_gauge!(
        "skycell_cell_cache_bytes",
        Unit::Bytes,
        "GPU memory of a cell's caches"
    );
}

fn set_render_figures(viewers: usize, stats: &RenderStats) {
    let totals = &stats.totals;
    gauge!("skycell_viewers").set(viewers as f64);
    counter!("skycell_ticks_total").absolute(totals.ticks);
    counter!("skycell_submissions_total").absolute(totals.submissions);
    counter!("skycell_dispatches_total").absolute(totals.dispatches);
    counter!("skycell_texels_updated_total").absolute(totals.texels_updated);
    counter!("skycell_tiles_updated_total").absolute(totals.tiles_updated);
    counter!("skycell_tiles_resampled_total").absolute(totals.tiles_resampled);
    counter!("skycell_tiles_evicted_total").absolute(totals.tiles_evicted);
    counter!("skycell_texels_audited_total").absolute(totals.texels_audited);
    counter!("skycell_frames_composited_total").absolute(totals.frames_composited);
    counter!("skycell_frames_read_back_total").absolute(totals.frames_read_back);
    counter!("skycell_screen_space_marches_total").absolute(totals.screen_space_marches);
    for (pass, time_ns) in [
        ("cache", totals.gpu_cache_ns),
        ("resample", totals.gpu_resample_ns),
        ("audit", totals.gpu_audit_ns),
        ("fade", totals.gpu_fade_ns),
        ("composite", totals.gpu_composite_ns),
        ("screen-space", totals.gpu_screen_space_ns),
        ("sun-volume", totals.gpu_sun_volume_ns),
        ("light-shafts", totals.gpu_light_shaft_ns),
    ] {
        counter!("skycell_gpu_nanoseconds_total", "pass" => pass).absolute(time_ns);
    }
    for (quantile, percent) in [
        ("0.5", stats.audit.p50_percent),
        ("0.95", stats.audit.p95_percent),
        ("0.99", stats.audit.p99_percent),
    ] {
        if let Some(percent) = percent {
            gauge!("skycell_cache_error_percent", "quantile" => quantile).set(percent);
        }
    }
    gauge!("skycell_scene_quality_flip", "picked" => stats.quality.picked).set(stats.quality.flip);
    for viewer in &stats.viewers {
        let quality = &viewer.quality;
        let labels = [
            ("viewer", viewer.id.to_string()),
            ("picked", quality.picked.to_owned()),
            ("is_met", quality.is_met.to_string()),
        ];
        gauge!("skycell_viewer_quality_flip", &labels).set(quality.flip);
        if let Some(device_ms) = quality.device_ms_per_frame {
            gauge!("skycell_viewer_frame_device_seconds", &labels).set(device_ms * 1e-3);
        }
    }
    gauge!("skycell_cache_bytes").set(totals.cache_bytes as f64);
    gauge!("skycell_sun_volume_bytes").set(totals.sun_volume_bytes as f64);
    counter!("skycell_sun_volume_evaluations_total").absolute(totals.sun_volume_evaluations);
    counter!("skycell_sun_volume_columns_total").absolute(totals.sun_volume_columns);
    gauge!("skycell_light_shaft_bytes").set(totals.light_shaft_bytes as f64);
    counter!("skycell_light_shaft_evaluations_total").absolute(totals.light_shaft_evaluations);
    counter!("skycell_light_shaft_tables_total").absolute(totals.light_shaft_tables);
    let ways = &stats.transitions;
    gauge!("skycell_viewers_in_transition").set(ways.viewers as f64);
    gauge!("skycell_viewers_with_rays_in_transition").set(ways.own_rays as f64);
    gauge!("skycell_cells_kept").set(ways.cells_kept as f64);
    gauge!("skycell_transition_picture_bytes").set(ways.picture_bytes as f64);
    for (shown, changes) in [("way", ways.begun), ("at-once", ways.swapped)] {
        counter!("skycell_cell_changes_total", "shown" => shown).absolute(changes);
    }
    let losses = &stats.losses;
    gauge!("skycell_cache_tiles_wished").set(losses.tiles_wished as f64);
    gauge!("skycell_cache_tiles_max").set(losses.tiles_max as f64);
    counter!("skycell_tiles_refused_total").absolute(losses.tiles_refused);
    gauge!("skycell_rate_step").set(f64::from(losses.rate_step));
    gauge!("skycell_march_backlog_seconds").set(losses.backlog_s);
    for (short, changes) in [
        ("memory", losses.memory_changes),
        ("time", losses.rate_changes),
    ] {
        counter!("skycell_loss_changes_total", "of" => short).absolute(changes);
    }
    for (which, frames) in [
        ("first", totals.first_frames_held),
        ("further", totals.frames_held),
    ] {
        counter!("skycell_frames_held_total", "which" => which).absolute(frames);
    }
    gauge!("skycell_scene_revision").set(stats.scene_revision as f64);
    for cell in &stats.cells {
        let labels = [("cell", cell.id.to_string()), ("name", cell.name.clone())];
        gauge!("skycell_cell_viewers", &labels).set(cell.viewers.len() as f64);
        gauge!("skycell_cell_overlap", &labels).set(cell.overlap);
        gauge!("skycell_cell_texels_requested", &labels).set(cell.texels_requested as f64);
        gauge!("skycell_cell_texels_unique", &labels).set(cell.texels_unique as f64);
        gauge!("skycell_cell_texels_pending", &labels).set(cell.texels_pending as f64);
        gauge!("skycell_cell_tiles_resident", &labels).set(cell.tiles_resident as f64);
        gauge!("skycell_cell_levels_lost", &labels).set(f64::from(cell.levels_lost));
        gauge!("skycell_cell_cache_bytes", &labels).set(cell.bytes as f64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame_loop::interface::{CellStats, RenderTotals, ViewerRenderStats};

    #[test]
    fn the_page_shows_the_services_and_the_renderers_figures() {
        let metrics = Metrics::new().expect("good settings");
        metrics.frames_sent.increment(3);
        metrics.encode_jpeg_s.record(0.003);
        metrics.sent(&FrameStages {
            composite_us: 3_000,
            ..FrameStages::default()
        });
        metrics.acknowledged(&Acknowledged {
            stages: vec![(Stage::MotionToPhoton, 70_000)],
            ..Acknowledged::default()
        });
        assert_eq!(metrics.latency_report()["composite"].p95_ms, 3.0);
        let stats = RenderStats {
            totals: RenderTotals {
                texels_updated: 7,
                ..RenderTotals::default()
            },
            cells: vec![CellStats {
                name: "harbour".to_owned(),
                overlap: 0.75,
                ..CellStats::default()
            }],
            ..RenderStats::default()
        };
        let page = metrics.render(2, &stats);
        for line in [
            "skycell_viewers 2",
            "skycell_frames_sent_total 4",
            "skycell_frames_encoded_total 0",
            "skycell_frame_stage_seconds_bucket{stage=\"composite\",le=\"0.004\"} 1",
            "skycell_frame_stage_seconds_bucket{stage=\"composite\",le=\"0.002\"} 0",
            "skycell_motion_to_photon_seconds_bucket{le=\"0.1\"} 1",
            "skycell_texels_updated_total 7",
            "skycell_cell_overlap{cell=\"0\",name=\"harbour\"} 0.75",
            "skycell_encode_seconds_bucket{codec=\"jpeg\",le=\"0.004\"} 1",
            "skycell_encode_seconds_bucket{codec=\"jpeg\",le=\"0.002\"} 0",
        ] {
            assert!(page.lines().any(|found| found == line), "{line} in\n{page}");
        }
    }

    /// Prometheus' rules for names: what is counted ends in `_total`, units are whole words at the end, all is explained.
    #[test]
    fn names_follow_the_rules_and_every_figure_is_explained() {
        let metrics = Metrics::new().expect("good settings");
        metrics.answered("GET", "/api/v1/scene", 200, Duration::from_millis(3));
        let stats = RenderStats {
            cells: vec![CellStats::default()],
            viewers: vec![ViewerRenderStats::default()],
            ..RenderStats::default()
        };
        metrics.set_service(&ServiceFigures::default(), &stats);
        let page = metrics.render(1, &stats);
        let mut seen = 0;
        for line in page.lines() {
            let Some((name, kind)) = line
                .strip_prefix("# TYPE ")
                .and_then(|rest| rest.split_once(' '))
            else {
                continue;
            };
            seen += 1;
            assert!(
                page.contains(&format!("# HELP {name} ")),
                "{name} has no help"
            );
            let plain = name.starts_with("skycell_")
                && name
                    .chars()
                    .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
            assert!(plain, "{name}");
            assert_eq!(
                name.ends_with("_total"),
                kind == "counter",
                "{name} is a {kind}"
            );
            let has_unit = ["_seconds", "_bytes"]
                .iter()
                .any(|unit| name.ends_with(unit));
            assert!(kind != "histogram" || has_unit, "{name} has no unit");
            for short in ["_ms", "_us", "_ns", "_s", "_mib", "_kb", "_count"] {
                assert!(!name.ends_with(short), "{name}");
            }
        }
        assert!(seen > 40, "{seen} figures");
    }

    #[test]
    fn two_services_of_one_process_count_apart() {
        let (a, b) = (Metrics::new().expect("a"), Metrics::new().expect("b"));
        a.frames_sent.increment(5);
        assert!(
            b.render(0, &RenderStats::default())
                .contains("skycell_frames_sent_total 0")
        );
    }
}
