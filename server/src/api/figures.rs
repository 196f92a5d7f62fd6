//! `/api/v1/cells`, `/viewers` and `/stats`: what the service does, in numbers.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use axum::Json;
use axum::extract::State;
use schemars::JsonSchema;
use serde::Serialize;
use skycell_protocol::{CellId, Codec, RendererKind, Show, ShowReport, Stereo, ViewerId};

use crate::frame_loop::interface::{CellStats, RenderStats};
use crate::stream::StreamContext;
use crate::viewers::{LatencyReport, Viewer};

/// A viewer as `/api/v1/viewers` shows it.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct ViewerReport {
    id: ViewerId,
    /// Null until the renderer has placed the viewer.
    cell: Option<CellId>,
    /// Where it is: x, altitude, z. Null until the renderer has placed it.
    position_m: Option<[f64; 3]>,
    /// Where it looks, clockwise from north. Null until then.
    yaw_deg: Option<f64>,
    /// Of one eye's picture.
    width: u32,
    height: u32,
    /// Two eyes side by side in each frame; null for one.
    stereo: Option<Stereo>,
    codec: Codec,
    jpeg_quality: u8,
    renderer: RendererKind,
    /// What the viewer asked for.
    fps_wanted: f64,
    /// What it was sent in the last second.
    fps: f64,
    mbit_per_s: f64,
    /// From the composite's submission until the acknowledgement, of half of the recent frames at
    /// most; null before the first.
    frame_age_p50_ms: Option<f64>,
    /// The same of 95 of 100 recent frames.
    frame_age_p95_ms: Option<f64>,
    /// Times of the stages of recent frames' ways, as far as they are known.
    latency: LatencyReport,
    /// What its link is found to take; null as long as it was never too slow.
    target_kbit_per_s: Option<u32>,
    /// What the client told last; null if it did not.
    decode_us: Option<u32>,
    frames_sent: u64,
    frames_dropped: u64,
    bytes_sent: u64,
    frames_composited: u64,
    frames_in_flight: u32,
    texels_requested: u64,
    connected_s: f64,
}

/// The service's own sums, beside the renderer's.
#[derive(Debug, Serialize, JsonSchema)]
struct ServiceStats {
    viewers: usize,
    /// Frames encoded since the start.
    frames_encoded: u64,
    version: &'static str,
    /// Of the store; the renderer's `scene_revision` follows it.
    scene_revision: u64,
    /// Processor time that the server has used since it started, over all cores; null where the system does not tell.
    cpu_s: Option<f64>,
    /// Memory that the server's process holds; null where the system does not tell.
    memory_bytes: Option<u64>,
}

/// `/api/v1/stats`: the renderer's figures and the service's.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct StatsReport {
    #[serde(flatten)]
    render: RenderStats,
    /// Jittered samples that a texel averages before it has converged: the most of any cell.
    samples: u32,
    service: ServiceStats,
    /// Times of the stages of the latest frames of all viewers.
    latency: LatencyReport,
}

pub(super) async fn cells(State(context): State<Arc<StreamContext>>) -> Json<Vec<CellStats>> {
    Json(context.frame_loop.stats().cells.clone())
}

pub(super) async fn viewers(State(context): State<Arc<StreamContext>>) -> Json<Vec<ViewerReport>> {
    let stats = context.frame_loop.stats();
    let reports = context
        .viewers
        .all()
        .iter()
        .map(|viewer| report_of(viewer, &stats))
        .collect();
    Json(reports)
}

pub(super) async fn stats(State(context): State<Arc<StreamContext>>) -> Json<StatsReport> {
    let render = RenderStats::clone(&context.frame_loop.stats());
    let in_cells = render.cells.iter().map(|cell| cell.samples).max();
    Json(StatsReport {
        samples: in_cells
            .filter(|samples| *samples > 0)
            .unwrap_or(render.quality.settings.samples),
        render,
        service: ServiceStats {
            viewers: context.viewers.count(),
            frames_encoded: context.metrics.frames_encoded.load(Ordering::Relaxed),
            version: env!("CARGO_PKG_VERSION"),
            scene_revision: context.scene.snapshot().revision,
            cpu_s: cpu_time::ProcessTime::try_now()
                .ok()
                .map(|time| time.as_duration().as_secs_f64()),
            memory_bytes: resident_bytes(),
        },
        latency: context.metrics.latency_report(),
    })
}

/// Memory that this process holds, where the system tells as Linux does.
pub(super) fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib << 10)
}

/// What frames can show, with the scales of the colours.
pub(super) async fn views() -> Json<Vec<ShowReport>> {
    Json(Show::ALL.map(|(_, show)| show.report()).to_vec())
}

fn report_of(viewer: &Viewer, stats: &RenderStats) -> ViewerReport {
    let view = viewer.view();
    let rendered = stats.viewers.iter().find(|known| known.id == viewer.id());
    let target_kbit_per_s = viewer.rate().target_kbit_per_s();
    let figures = viewer.figures();
    let age = figures.frame_age();
    ViewerReport {
        id: viewer.id(),
        cell: rendered.map(|known| known.cell),
        position_m: rendered.map(|known| known.position_m),
        yaw_deg: rendered.map(|known| known.yaw_deg),
        width: view.size.width(),
        height: view.size.height(),
        stereo: view.stereo,
        codec: view.codec,
        jpeg_quality: view.jpeg_quality,
        renderer: view.renderer,
        fps_wanted: view.fps,
        fps: figures.fps,
        mbit_per_s: figures.mbit_per_s,
        frame_age_p50_ms: age.map(|age| age.p50_ms),
        frame_age_p95_ms: age.map(|age| age.p95_ms),
        latency: figures.latencies.report(),
        target_kbit_per_s,
        decode_us: figures.decode_us,
        frames_sent: figures.frames_sent,
        frames_dropped: figures.frames_dropped,
        bytes_sent: figures.bytes_sent,
        frames_composited: rendered.map_or(0, |known| known.frames_composited),
        frames_in_flight: rendered.map_or(0, |known| known.frames_in_flight),
        texels_requested: rendered.map_or(0, |known| known.texels_requested),
        connected_s: viewer.connected().elapsed().as_secs_f64(),
    }
}
