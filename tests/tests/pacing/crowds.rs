//! Crowds that come at once.

use std::time::Duration;

use anyhow::ensure;
use skycell_client::load::storm::{self, Storm, StormOptions};
use skycell_protocol::FrameSize;
use skycell_tests::{PATIENCE, Server, ServerOptions};

use crate::Outcome;

#[tokio::test(flavor = "multi_thread")]
async fn two_hundred_viewers_at_once_have_a_picture_in_time_and_again_after_all_were_cut_off()
-> Outcome {
    let options = ServerOptions {
        top_level_toml: "viewers_max = 256".to_owned(),
        ..ServerOptions::default()
    };
    let server = Server::start_with(options).await?;
    server.calm().await?;
    let storm = StormOptions {
        viewers: 200,
        size: FrameSize::new(64, 36)?,
        fps: 1.0,
    };
    let report = storm::run(&server.client_address()?, &storm).await?;
    println!("{}", report.table());
    for round in &report.rounds {
        ensure!(round.served == 200, "{} were served", round.served);
    }
    ensure!(report.is_kept(), "more than 5 s");
    server.at_rest(0).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn viewers_come_back_by_themselves_to_a_server_that_was_killed_and_not_as_one() -> Outcome {
    let server = Server::start_calm().await?;
    let address = server.client_address()?;
    let listen = server.address().to_owned();
    let options = StormOptions {
        viewers: 40,
        size: FrameSize::new(64, 36)?,
        fps: 1.0,
    };
    let mut storm = Storm::begin(&address, &options)?;
    ensure!(storm.served(PATIENCE).await.served == 40);
    server.kill()?;
    storm.expect_anew();
    let restarted = ServerOptions {
        listen: Some(listen),
        ..ServerOptions::default()
    };
    let server = Server::start_with(restarted).await?;
    let round = storm.served(PATIENCE).await;
    ensure!(round.served == 40, "{} are back", round.served);
    let mut back = storm.first_frames();
    back.sort_unstable();
    let (first, last) = (back[0], back[back.len() - 1]);
    println!(
        "{} viewers are back {first:.1?} to {last:.1?} after the old server was killed; {} tries failed",
        round.served, round.failed_tries
    );
    ensure!(last - first > Duration::from_millis(100), "all came as one");
    storm.leave().await;
    server.at_rest(0).await?;
    Ok(())
}
