//! Viewers on links and screens of all kinds, beside each other.

use std::time::Duration;

use anyhow::{Context, ensure};
use skycell_tests::Server;
use skycell_tests::slow_link::SlowLink;

use crate::Outcome;
use crate::turning::{Doing, Shown, Turning, p95};

const SIZE: (u32, u32) = (320, 180);
const FPS: f64 = 10.0;
/// What 95 of 100 frames are to be younger than over a third of the link, on a machine that has nothing else to do.
const AGE_P95_WANTED_MS: f64 = 250.0;
/// Beyond this frames wait for one another, which no busy machine excuses: with a queue they are seconds old.
const AGE_P95_MAX_MS: f64 = 1_000.0;
/// How much the server may take in addition for a viewer on a slow link.
const GROWTH_MAX_KIB: u64 = 16 * 1024;

fn fps(frames: &[Shown], seconds: f64) -> f64 {
    frames.len() as f64 / seconds
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_over_a_third_of_the_link_stay_young_cost_no_neighbour_and_end_exact() -> Outcome {
    const SECONDS: f64 = 6.0;
    let time = Duration::from_secs_f64(SECONDS);
    let server = Server::start_calm().await?;
    let address = server.client_address()?;
    let mut neighbours = Vec::new();
    for _ in 0..2 {
        neighbours.push(Turning::join(&address, SIZE, FPS).await?);
    }
    let near = Turning::join(&address, SIZE, FPS).await?;
    // Until what they look at is marched.
    near.watch(Duration::from_secs(4)).await;
    let neighbour = &neighbours[0];
    let (source, before) = tokio::join!(near.watch(time), neighbour.watch(time));
    near.leave().await?;
    let bytes: usize = source.iter().map(|frame| frame.message_bytes).sum();
    let source_bytes_per_s = bytes as f64 / SECONDS;
    ensure!(fps(&source, SECONDS) > 0.5 * FPS, "{} frames", source.len());

    let link = SlowLink::to(&server, source_bytes_per_s / 3.0).await?;
    let memory_before = server.memory_kib();
    let far = Turning::join(&link.client_address()?, SIZE, FPS).await?;
    let neighbour = &neighbours[1];
    let (seen, after) = tokio::join!(far.watch(2 * time), neighbour.watch(2 * time));
    let memory_after = server.memory_kib();
    let ages_ms = seen.iter().map(Shown::age_ms);
    let age_p95_ms = p95(ages_ms);
    let target = seen.last().context("frames")?.header.target_kbit_per_s;
    println!(
        "source {:.0} kbit/s, {:.1} fps; link a third: {:.1} fps, {:.0} kbit/s, aims at {target}, age p95 {age_p95_ms:.0} ms (wanted: {AGE_P95_WANTED_MS})",
        source_bytes_per_s * 8e-3,
        fps(&source, SECONDS),
        fps(&seen, 2.0 * SECONDS),
        seen.iter().map(|frame| frame.message_bytes).sum::<usize>() as f64 * 8e-3 / (2.0 * SECONDS),
    );
    let neighbours_fps = [fps(&before, SECONDS), fps(&after, 2.0 * SECONDS)];
    println!("a neighbour's fps before and beside it: {neighbours_fps:.1?}");
    ensure!(age_p95_ms <= AGE_P95_MAX_MS, "age p95 {age_p95_ms} ms");
    // The machine itself may be busier than before.
    ensure!(neighbours_fps[1] > 0.6 * neighbours_fps[0]);
    // All that is sent fits, so that more than a few frames a second come.
    ensure!(fps(&seen, 2.0 * SECONDS) > 0.6 * neighbours_fps[1]);
    ensure!(target > 0, "no rate is aimed at");
    if let (Some(before), Some(after)) = (memory_before, memory_after) {
        println!("server memory {before} KiB, beside a slow link {after} KiB");
        ensure!(after < before + GROWTH_MAX_KIB);
    } else {
        println!("SKIPPED: the memory of the server is not known without /proc");
    }

    // Who rests gets the picture as good as it was wished, once.
    for viewer in neighbours.iter().chain([&far]) {
        viewer.now(Doing::Rests);
    }
    let exact = far
        .wait_for("exact frame", |frame| frame.header.exact)
        .await?;
    ensure!(
        exact.message_bytes > seen.last().map_or(0, |frame| frame.message_bytes),
        "an exact frame of {} bytes",
        exact.message_bytes
    );
    server.at_rest(3).await?;
    ensure!(far.watch(Duration::from_secs(2)).await.is_empty());
    far.leave().await?;
    for viewer in neighbours {
        viewer.leave().await?;
    }
    link.cut();
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_of_1080p_leaves_small_ones_their_frames() -> Outcome {
    const SECONDS: f64 = 5.0;
    let time = Duration::from_secs_f64(SECONDS);
    let server = Server::start_calm().await?;
    let address = server.client_address()?;
    let mut small = Vec::new();
    for _ in 0..4 {
        small.push(Turning::join(&address, (64, 36), FPS).await?);
    }
    let large = Turning::join(&address, (1920, 1080), 30.0).await?;
    large.watch(Duration::from_secs(4)).await;
    let counts: Vec<usize> = small.iter().map(|viewer| viewer.shown().len()).collect();
    let many = large.watch(time).await;
    let fewest = small
        .iter()
        .zip(&counts)
        .map(|(viewer, before)| viewer.shown().len() - before)
        .min()
        .context("viewers")?;
    println!(
        "in {SECONDS} s: {} frames of 1080p, at least {fewest} of each small viewer, who wishes {}",
        many.len(),
        SECONDS * FPS
    );
    ensure!(!many.is_empty(), "the large one starves");
    ensure!(fewest as f64 >= 0.5 * SECONDS * FPS, "{fewest} frames");
    large.leave().await?;
    for viewer in small {
        viewer.leave().await?;
    }
    Ok(())
}
