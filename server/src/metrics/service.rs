//! Figures of the service and its process: what it is, whether it is ready, what it uses, what it is asked for.

use std::time::Duration;

use metrics::{
    Unit, counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram,
    with_local_recorder,
};

use super::Metrics;
use crate::frame_loop::interface::RenderStats;

/// What the service knows of itself when somebody asks for its figures.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ServiceFigures {
    /// It can serve viewers.
    pub is_ready: bool,
    /// It takes no viewer any more.
    pub is_draining: bool,
    /// Revision of the stored scene.
    pub scene_revision: u64,
    /// Revisions that can be brought back.
    pub revisions_kept: usize,
    /// Processor time so far; none where the system does not tell.
    pub cpu: Option<Duration>,
    /// Memory of the process; none where the system does not tell.
    pub memory_bytes: Option<u64>,
}

impl Metrics {
    /// Counts a request that was answered. `route` is the pattern of its path, so that there are not more than routes.
    pub fn answered(&self, method: &'static str, route: &str, status: u16, took: Duration) {
        with_local_recorder(&self.recorder, || {
            let labels = [
                ("method", method.to_owned()),
                ("route", route.to_owned()),
                ("status", status.to_string()),
            ];
            counter!("skycell_http_requests_total", &labels).increment(1);
            histogram!("skycell_http_request_seconds", "route" => route.to_owned())
                .record(took.as_secs_f64());
        });
    }

    /// Brings the figures of the service up to date.
    pub fn set_service(&self, figures: &ServiceFigures, stats: &RenderStats) {
        with_local_recorder(&self.recorder, || set(figures, stats));
    }
}

fn set(figures: &ServiceFigures, stats: &RenderStats) {
    let build = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("adapter", stats.adapter.name.clone()),
        ("driver", stats.adapter.driver.clone()),
    ];
    gauge!("skycell_build_info", &build).set(1.0);
    gauge!("skycell_uptime_seconds").set(stats.uptime_s);
    gauge!("skycell_ready").set(f64::from(u8::from(figures.is_ready)));
    gauge!("skycell_draining").set(f64::from(u8::from(figures.is_draining)));
    gauge!("skycell_scene_store_revision").set(figures.scene_revision as f64);
    gauge!("skycell_scene_revisions_kept").set(figures.revisions_kept as f64);
    if let Some(cpu) = figures.cpu {
        let cpu_ms = u64::try_from(cpu.as_millis()).unwrap_or(u64::MAX);
        counter!("skycell_cpu_milliseconds_total").absolute(cpu_ms);
    }
    if let Some(bytes) = figures.memory_bytes {
        gauge!("skycell_resident_bytes").set(bytes as f64);
    }
    let loss = &stats.device_loss;
    counter!("skycell_device_losses_total").absolute(loss.losses);
    counter!("skycell_device_openings_failed_total").absolute(loss.failed_openings);
    gauge!("skycell_device_lost").set(f64::from(u8::from(loss.is_lost)));
}

pub(super) fn describe() {
    describe_gauge!(
        "skycell_build_info",
        "1; labels tell the version, the graphics adapter and its driver"
    );
    describe_gauge!(
        "skycell_uptime_seconds",
        Unit::Seconds,
        "Time since the renderer was ready"
    );
    describe_gauge!("skycell_ready", "1 while viewers can be served");
    describe_gauge!("skycell_draining", "1 while no viewer is taken any more");
    describe_gauge!(
        "skycell_scene_store_revision",
        "Revision of the stored scene; the rendered one follows it"
    );
    describe_gauge!(
        "skycell_scene_revisions_kept",
        "Revisions of the scene that can be brought back"
    );
    describe_counter!(
        "skycell_cpu_milliseconds_total",
        Unit::Milliseconds,
        "Processor time of the process, over all cores"
    );
    describe_gauge!(
        "skycell_resident_bytes",
        Unit::Bytes,
        "Memory that the process holds"
    );
    describe_counter!(
        "skycell_device_losses_total",
        "How often the graphics device was lost"
    );
    describe_counter!(
        "skycell_device_openings_failed_total",
        "How often a lost graphics device could not be opened again at once"
    );
    describe_gauge!(
        "skycell_device_lost",
        "1 while there is no graphics device and viewers see their last picture"
    );
    describe_counter!(
        "skycell_http_requests_total",
        "Requests answered, by method, route and status"
    );
    describe_histogram!(
        "skycell_http_request_seconds",
        Unit::Seconds,
        "From a request's head until its answer's head, by route"
    );
}
