//! Waiting for the server, with an end.

use std::time::Duration;

use indicatif::ProgressBar;
use tokio::time::{Instant, sleep};

use super::LoadError;
use super::crowd::Crowd;
use crate::server_stats::CellsOfViewers;
use crate::{HttpApi, ServerStats};

const POLL_EVERY: Duration = Duration::from_millis(250);
/// A closed socket is noticed within a heartbeat or two.
const LEAVE_TIMEOUT: Duration = Duration::from_secs(15);
/// Unseen tiles live for some frames more.
const EVICTION_TIMEOUT: Duration = Duration::from_secs(10);
/// The counters are published by the render thread and may be a tick old: converged must be seen
/// as often as this before it is believed.
const CONVERGED_POLLS: u32 = 3;

/// A server without viewers.
pub(super) struct EmptyServer {
    pub(super) stats: ServerStats,
    /// Its caches hold no tile.
    pub(super) is_cold: bool,
}

/// Waits until nobody is connected, and then, not as long, until the caches are empty.
pub(super) async fn wait_until_empty(api: &HttpApi) -> Result<EmptyServer, LoadError> {
    let begun = Instant::now();
    let mut left_at = None;
    loop {
        let stats = api.stats().await?;
        let viewers = stats.viewers.len().max(stats.viewers_in_cells());
        if viewers == 0 {
            let left_at = *left_at.get_or_insert_with(Instant::now);
            let is_cold = stats.tiles_resident() == 0;
            if is_cold || left_at.elapsed() > EVICTION_TIMEOUT {
                return Ok(EmptyServer { stats, is_cold });
            }
        } else {
            left_at = None;
            if begun.elapsed() > LEAVE_TIMEOUT {
                return Err(LoadError::OtherViewers { viewers });
            }
        }
        // Somebody may come and go for ever.
        if begun.elapsed() > LEAVE_TIMEOUT + EVICTION_TIMEOUT + LEAVE_TIMEOUT {
            return Err(LoadError::OtherViewers { viewers });
        }
        sleep(POLL_EVERY).await;
    }
}

/// How the sky was when the wait ended.
pub(super) struct StillSky {
    pub(super) stats: ServerStats,
    pub(super) cells: CellsOfViewers,
    pub(super) converged: bool,
    pub(super) waited: Duration,
}

/// Waits until the server says that nothing the crowd sees waits for an update, or time is up.
pub(super) async fn wait_until_converged(
    api: &HttpApi,
    crowd: &mut Crowd,
    limit: Duration,
    progress: &ProgressBar,
    label: &str,
) -> Result<StillSky, LoadError> {
    let begun = Instant::now();
    let mut converged_polls = 0;
    loop {
        crowd.check().await?;
        let stats = api.stats().await?;
        let cells = stats.cells_of(crowd.ids());
        let everybody_served = cells.viewers_served == crowd.ids().len();
        if everybody_served && cells.converged && cells.texels_pending == 0 {
            converged_polls += 1;
        } else {
            converged_polls = 0;
        }
        let converged = converged_polls >= CONVERGED_POLLS;
        if converged || begun.elapsed() > limit {
            return Ok(StillSky {
                stats,
                cells,
                converged,
                waited: begun.elapsed(),
            });
        }
        progress.set_message(format!(
            "{label}: {} of {} viewers served, {} texels pending, {:.0} s",
            cells.viewers_served,
            crowd.ids().len(),
            cells.texels_pending,
            begun.elapsed().as_secs_f64()
        ));
        progress.tick();
        sleep(POLL_EVERY).await;
    }
}
