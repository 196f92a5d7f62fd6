//! A load test: what does it save that viewers see the same sky?
//!
//! Real viewers stand at one place, turned about the vertical axis so that neighbours overlap
//! ([`ring`]). For each overlap fresh viewers join a server without any; they hold still until the
//! server says that its sky has converged; the server's counters before and after tell what that
//! cost. Then all turn together for some seconds, which gives frame rates and frame ages. They leave,
//! and the next overlap begins when the server's caches are empty again.
//!
//! Viewers acknowledge frames without decoding them, unless they are told to. Nothing but the given server is talked to,
//! and every wait ends.

mod baseline;
mod crowd;
mod overlap;
pub mod report;
pub mod ring;
pub mod soak;
pub mod storm;
pub mod table;
mod viewer;
mod wait;
pub mod wind;

use std::future::Future;
use std::time::Duration;

use indicatif::ProgressBar;
use skycell_protocol::{FrameSize, QualityPreset, Stereo};
use thiserror::Error;

pub use self::report::LoadReport;
pub use self::ring::ViewerRing;
pub use self::soak::report::SoakReport;
pub use self::soak::{SoakOptions, soak};
pub use self::storm::{Storm, StormOptions, StormReport, StormRound};
pub use self::table::{STAGES, table};
pub use self::viewer::{TimesMs, TurningFigures, ViewerFigures};
use self::wind::StilledWind;
use crate::unix_time::unix_us_now;
use crate::{HttpApi, HttpApiError, ServerAddress};

/// Version of the report's format.
const REPORT_FORMAT: u32 = 1;

/// What to measure.
#[derive(Clone, Debug)]
pub struct LoadOptions {
    /// The viewers.
    pub ring: ViewerRing,
    /// Overlaps of neighbours, 0 to 1 each.
    pub overlaps: Vec<f64>,
    /// Size of every viewer's frames, or of each of two eyes' pictures in them.
    pub size: FrameSize,
    /// Every viewer has two eyes.
    pub stereo: Option<Stereo>,
    /// Frames per second that every viewer wishes.
    pub fps: f64,
    /// How long to wait for a converged sky.
    pub converge_timeout: Duration,
    /// How long to turn; not at all if zero.
    pub turn_duration: Duration,
    /// How fast to turn.
    pub turn_speed_deg_per_s: f64,
    /// Viewers decode frames before they acknowledge them, as those do who show them.
    pub decodes: bool,
    /// Updates until a texel has converged, if the server does not tell.
    pub samples_per_texel: u32,
    /// How good pictures are to be; none for what the scene or the server says.
    pub quality: Option<QualityPreset>,
    /// Whether to have the same views by the screen-space renderer.
    pub renderer_baseline: bool,
    /// Whether to take the wind out of the scene for the test.
    pub wind_off: bool,
}

/// Why a load test ended early.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The server's API failed.
    #[error(transparent)]
    Api(#[from] HttpApiError),
    /// A viewer failed.
    #[error("viewer {number}: {reason}")]
    ViewerLost {
        /// Its place in the ring.
        number: usize,
        /// Why.
        reason: String,
    },
    /// Somebody else's viewers would be measured too.
    #[error("{viewers} other viewers are connected; a load test needs the server for itself")]
    OtherViewers {
        /// How many.
        viewers: usize,
    },
    /// Stopped from outside.
    #[error("interrupted")]
    Interrupted,
    /// The wind could not be put back.
    #[error("the wind could not be put back into the scene: {0}")]
    WindNotRestored(HttpApiError),
}

/// Measures all overlaps, or as many as it can until `stop` is ready. `save` gets the report after
/// each. The wind is put back in any case.
///
/// # Errors
/// If the server or a viewer fails, or somebody else is connected. What was measured before has
/// been saved.
pub async fn run(
    address: &ServerAddress,
    options: &LoadOptions,
    progress: &ProgressBar,
    stop: impl Future<Output = ()>,
    save: impl FnMut(&LoadReport),
) -> Result<LoadReport, LoadError> {
    let api = HttpApi::new(address.clone())?;
    let wind = if options.wind_off {
        Some(StilledWind::still(&api).await?)
    } else {
        None
    };
    let result = tokio::select! {
        result = measure(address, &api, options, progress, save) => result,
        () = stop => Err(LoadError::Interrupted),
    };
    if let Some(wind) = wind {
        wind.restore(&api)
            .await
            .map_err(LoadError::WindNotRestored)?;
    }
    result
}

async fn measure(
    address: &ServerAddress,
    api: &HttpApi,
    options: &LoadOptions,
    progress: &ProgressBar,
    mut save: impl FnMut(&LoadReport),
) -> Result<LoadReport, LoadError> {
    let stats = api.stats().await?;
    let scene_revision = api.scene().await?.revision();
    let mut report = LoadReport {
        format: REPORT_FORMAT,
        url: address.to_string(),
        adapter: stats.adapter,
        started_unix_s: unix_us_now() / 1_000_000,
        scene_revision,
        wind_off: options.wind_off,
        viewers: options.ring.viewers(),
        width: options.size.width(),
        height: options.size.height(),
        stereo: options.stereo,
        fps: options.fps,
        position_m: options.ring.position_m(),
        pitch_deg: options.ring.pitch_deg(),
        horizontal_fov_deg: options.ring.horizontal_fov_deg(),
        vertical_fov_deg: options.ring.vertical_fov_deg(),
        samples_per_texel: stats.samples.unwrap_or(options.samples_per_texel),
        turn_speed_deg_per_s: options.turn_speed_deg_per_s,
        decodes: options.decodes,
        overlaps: Vec::new(),
    };
    for &overlap in &options.overlaps {
        let measured = overlap::measure(address, api, options, overlap, progress).await?;
        report.overlaps.push(measured);
        report.compare_with_ideal();
        save(&report);
        progress.inc(1);
    }
    // The next test, or whoever comes next, finds the server as this one did.
    wait::wait_until_empty(api).await?;
    Ok(report)
}
