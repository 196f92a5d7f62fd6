//! A crowd on the move through the service. The long run is `skycell load --crowd migrate --seconds 600`.

use indicatif::ProgressBar;
use skycell_client::load::{SoakOptions, soak};
use skycell_protocol::FrameSize;
use skycell_tests::{Server, until};
use std::time::Duration;

#[tokio::test(flavor = "multi_thread")]
async fn a_crowd_that_migrates_is_served_without_a_gap_and_leaves_nothing_behind()
-> anyhow::Result<()> {
    let server = Server::start().await?;
    let options = SoakOptions {
        viewers: 6,
        duration: Duration::from_secs(20),
        size: FrameSize::new(96, 54)?,
        fps: 5.0,
        max_error: 0.1,
        // A swing of two groups in the time that there is.
        pace: 5.0,
    };
    let progress = ProgressBar::hidden();
    let report = soak(
        &server.client_address()?,
        &options,
        &progress,
        std::future::pending(),
    )
    .await?;
    println!("{}", report.table());
    let cells = report.samples.iter().map(|sample| sample.cells);
    let (least, most) = (cells.clone().min(), cells.max());
    assert!(
        least < most && report.cell_changes > 0,
        "{least:?} {most:?}"
    );
    assert_eq!(report.bad_pictures, 0);
    assert_eq!(report.tiles_refused, 0);
    // How often, and how far texels are off, is the machine's affair; that each viewer is served is not.
    assert!(report.frames > 100, "{}", report.frames);
    until("caches that are given back", async || {
        let stats = server.get("api/v1/stats").await?;
        Ok((stats["totals"]["cache_bytes"] == 0).then_some(()))
    })
    .await?;
    Ok(())
}
