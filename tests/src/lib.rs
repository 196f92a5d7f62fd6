//! What the tests that cross Skycell's crates share: a real server process, viewers, pictures, a browser.

pub mod accuracy;
pub mod browser;
pub mod numbers;
pub mod picture;
pub mod server;
pub mod slow_link;
pub mod tone;
pub mod viewer;

pub use browser::{Browser, Tab};
pub use server::{Server, ServerOptions};
pub use viewer::{Seen, Viewer};

use std::time::Duration;

/// Longer than anything that a test waits for, noise and shader compilation on a slow machine included.
pub const PATIENCE: Duration = Duration::from_secs(90);

/// Asks until the answer is there; `what` is told when it does not come within [`PATIENCE`].
///
/// # Errors
/// When an attempt fails or the time is up.
pub async fn until<T>(
    what: &str,
    mut attempt: impl AsyncFnMut() -> anyhow::Result<Option<T>>,
) -> anyhow::Result<T> {
    let asking = async {
        loop {
            if let Some(answer) = attempt().await? {
                return Ok(answer);
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(PATIENCE, asking)
        .await
        .unwrap_or_else(|_| {
            Err(anyhow::anyhow!(
                "{} s have passed without {what}",
                PATIENCE.as_secs()
            ))
        })
}
