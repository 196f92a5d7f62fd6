//! The same views by the screen-space renderer: one viewer after the other, one frame each.

use std::time::Duration;

use indicatif::ProgressBar;
use skycell_protocol::message::Hello;
use skycell_protocol::{QualityChoice, RendererKind};
use tokio::time::timeout;

use super::report::ScreenSpaceFigures;
use super::wait::wait_until_empty;
use super::{LoadError, LoadOptions};
use crate::server_stats::Totals;
use crate::{Connection, ConnectionError, ConnectionLimits, Event, HttpApi, ServerAddress};

/// A screen-space frame on a software driver takes seconds, not minutes.
const FRAME_TIMEOUT: Duration = Duration::from_secs(60);

pub(super) async fn measure(
    address: &ServerAddress,
    api: &HttpApi,
    options: &LoadOptions,
    overlap: f64,
    progress: &ProgressBar,
) -> Result<ScreenSpaceFigures, LoadError> {
    let before = wait_until_empty(api).await?.stats.totals;
    let views = options.ring.viewers();
    for number in 0..views {
        progress.set_message(format!(
            "{:.0} % overlap: screen-space view {} of {views}",
            overlap * 100.0,
            number + 1
        ));
        let camera = options.ring.camera(number, overlap, 0.0);
        let hello = Hello {
            renderer: RendererKind::ScreenSpace,
            quality: options.quality.map(QualityChoice::Preset),
            stereo: options.stereo,
            ..Hello::new(options.size, options.fps, camera)
        };
        one_frame(address, hello)
            .await
            .map_err(|source| LoadError::ViewerLost {
                number: number as usize,
                reason: format!("screen-space: {source}"),
            })?;
    }
    let after = wait_until_empty(api).await?.stats.totals;
    let eyes = if options.stereo.is_some() { 2 } else { 1 };
    let marches_once = u64::from(views) * eyes * u64::from(options.size.pixels());
    Ok(figures(views, marches_once, after.since(&before)))
}

/// Waits for one frame and leaves without acknowledging it, so that the server makes no more than
/// its window allows.
async fn one_frame(address: &ServerAddress, hello: Hello) -> Result<(), ConnectionError> {
    let mut connection = Connection::open(address, hello, ConnectionLimits::default()).await?;
    let first_frame = async {
        loop {
            match connection.next_event().await? {
                Event::Frame(_) => return Ok(()),
                Event::Complaint(complaint) => return Err(ConnectionError::Refused(complaint)),
                _ => {}
            }
        }
    };
    timeout(FRAME_TIMEOUT, first_frame)
        .await
        .map_err(|_| ConnectionError::Timeout {
            what: "a screen-space frame",
            limit_s: FRAME_TIMEOUT.as_secs_f64(),
        })??;
    connection.close().await;
    Ok(())
}

fn figures(views: u32, marches_once: u64, spent: Totals) -> ScreenSpaceFigures {
    let gpu_ms = spent.gpu_screen_space_ns as f64 / 1e6;
    ScreenSpaceFigures {
        views,
        marches: spent.screen_space_marches,
        gpu_ms,
        gpu_ms_once: (spent.screen_space_marches > 0)
            .then(|| gpu_ms * marches_once as f64 / spent.screen_space_marches as f64),
        marches_once,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_the_server_made_beyond_the_first_do_not_count_as_cost_of_the_views() {
        let spent = Totals {
            gpu_screen_space_ns: 30_000_000,
            screen_space_marches: 300,
            ..Totals::default()
        };
        let figures = figures(2, 200, spent);
        assert_eq!(figures.gpu_ms_once, Some(20.0));
        assert_eq!(super::figures(2, 200, Totals::default()).gpu_ms_once, None);
    }
}
