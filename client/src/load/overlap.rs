//! One overlap: cold caches, viewers come, the sky converges, everybody turns, everybody leaves.

use std::time::Duration;

use indicatif::ProgressBar;

use super::baseline;
use super::crowd::Crowd;
use super::report::{IdealComparison, OverlapReport, TurningReport};
use super::viewer::{TimesMs, ViewerFigures, times_histogram};
use super::wait::{wait_until_converged, wait_until_empty};
use super::{LoadError, LoadOptions};
use crate::server_stats::{LatencyStats, Totals};
use crate::{HttpApi, ServerAddress};

pub(super) async fn measure(
    address: &ServerAddress,
    api: &HttpApi,
    options: &LoadOptions,
    overlap: f64,
    progress: &ProgressBar,
) -> Result<OverlapReport, LoadError> {
    let label = format!("{:.0} % overlap", overlap * 100.0);
    progress.set_message(format!("{label}: waiting for empty cells"));
    let empty = wait_until_empty(api).await?;
    progress.set_message(format!("{label}: connecting"));
    let mut crowd = Crowd::join(address, options, overlap).await?;
    let still =
        wait_until_converged(api, &mut crowd, options.converge_timeout, progress, &label).await?;
    let spent = still.stats.totals.since(&empty.stats.totals);
    let turning_totals = if options.turn_duration > Duration::ZERO {
        progress.set_message(format!("{label}: turning"));
        let before = api.stats().await?;
        crowd
            .turn(options.turn_speed_deg_per_s, options.turn_duration)
            .await?;
        let after = api.stats().await?;
        let cpu_s = after.service.cpu_s.zip(before.service.cpu_s);
        Some((
            after.totals.since(&before.totals),
            cpu_s.map(|(after, before)| after - before),
            after.latency,
        ))
    } else {
        None
    };
    let viewers = crowd.leave().await?;
    let screen_space = if options.renderer_baseline {
        Some(baseline::measure(address, api, options, overlap, progress).await?)
    } else {
        None
    };
    Ok(OverlapReport {
        nominal_overlap_percent: overlap * 100.0,
        turn_between_neighbours_deg: options.ring.turn_between_neighbours_deg(overlap),
        cold_start: empty.is_cold,
        tiles_at_start: empty.stats.tiles_resident(),
        converged: still.converged,
        converge_s: still.waited.as_secs_f64(),
        cells: still.cells.cells,
        measured_overlap: still.cells.overlap,
        texels_requested: still.cells.texels_requested,
        texels_unique: still.cells.texels_unique,
        texels_updated: spent.texels_updated,
        frames_composited: spent.frames_composited,
        gpu_cache_ms: ms(spent.gpu_cache_ns),
        gpu_composite_ms: ms(spent.gpu_composite_ns),
        cache_bytes: still.cells.cache_bytes,
        ideal: IdealComparison {
            unique_share_by_angles: options.ring.unique_share(overlap),
            ..IdealComparison::default()
        },
        screen_space,
        turning: turning_totals
            .map(|(totals, cpu_s, stages)| turning_report(options, totals, cpu_s, stages, viewers)),
    })
}

fn turning_report(
    options: &LoadOptions,
    spent: Totals,
    cpu_s: Option<f64>,
    stages: LatencyStats,
    viewers: Vec<ViewerFigures>,
) -> TurningReport {
    let (mut ages_us, mut motions_us) = (times_histogram(), times_histogram());
    let mut fps = Vec::new();
    let mut frames = 0;
    for turning in viewers.iter().filter_map(|viewer| viewer.turning.as_ref()) {
        // Both have the same bounds, so nothing can be out of them.
        let _ = ages_us.add(&turning.ages_us);
        let _ = motions_us.add(&turning.motions_us);
        fps.push(turning.fps);
        frames += turning.frames;
    }
    fps.sort_by(f64::total_cmp);
    TurningReport {
        seconds: options.turn_duration.as_secs_f64(),
        texels_updated: spent.texels_updated,
        gpu_cache_ms: ms(spent.gpu_cache_ns),
        gpu_composite_ms: ms(spent.gpu_composite_ns),
        frames_composited: spent.frames_composited,
        server_cpu_ms_per_frame: cpu_s
            .filter(|_| frames > 0)
            .map(|cpu_s| cpu_s * 1e3 / frames as f64),
        fps_min: fps.first().copied().unwrap_or(0.0),
        fps_median: fps.get(fps.len() / 2).copied().unwrap_or(0.0),
        frame_age_ms: TimesMs::of(&ages_us),
        motion_to_photon_ms: TimesMs::of(&motions_us),
        stages,
        viewers,
    }
}

fn ms(ns: u64) -> f64 {
    ns as f64 / 1e6
}
