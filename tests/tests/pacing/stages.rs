//! Where the time goes between an input and the screen.

use std::time::Duration;

use anyhow::{Context, ensure};
use skycell_client::load::STAGES;
use skycell_tests::Server;

use crate::Outcome;
use crate::turning::{Doing, Turning};

#[tokio::test(flavor = "multi_thread")]
async fn the_stages_of_a_frame_add_up_to_what_its_viewer_measures() -> Outcome {
    let server = Server::start_calm().await?;
    let viewer = Turning::join(&server.client_address()?, (160, 90), 10.0).await?;
    viewer.watch(Duration::from_secs(2)).await;
    let frames = viewer.watch(Duration::from_secs(3)).await;
    let (mut rests_ms, mut timed) = (Vec::new(), 0);
    for frame in &frames {
        let stages = frame.header.stages;
        ensure!(stages.encode_us > 0, "{stages:?}");
        timed += usize::from(stages.composite_us > 0);
        ensure!(frame.header.key && frame.header.codec != skycell_protocol::FrameCodec::None);
        let Some(motion_us) = frame.motion_us else {
            continue;
        };
        ensure!(stages.input_to_render_us > 0, "a frame with a new input");
        ensure!(stages.march_wait_us <= stages.input_to_render_us);
        let told_us = u64::from(stages.input_to_render_us) + stages.render_to_send_us();
        // Each is rounded down.
        ensure!(told_us <= motion_us + 10, "{told_us} of {motion_us} us");
        rests_ms.push((motion_us - told_us.min(motion_us)) as f64 * 1e-3);
    }
    ensure!(rests_ms.len() > 5, "{} inputs were shown", rests_ms.len());
    // Where more is under way than is timed, a frame goes untimed.
    ensure!(
        2 * timed > frames.len(),
        "the device timed {timed} of {} frames",
        frames.len()
    );
    rests_ms.sort_by(f64::total_cmp);
    println!(
        "{} frames; network and decoding, ms: median {:.1}, most {:.1}",
        rests_ms.len(),
        rests_ms[rests_ms.len() / 2],
        rests_ms[rests_ms.len() - 1]
    );
    viewer.now(Doing::Rests);

    let viewers = server.get("api/v1/viewers").await?;
    let stats = server.get("api/v1/stats").await?;
    for latency in [&viewers[0]["latency"], &stats["latency"]] {
        println!("{latency}");
        for stage in STAGES {
            let p50_ms = latency[stage]["p50_ms"].as_f64();
            let p95_ms = latency[stage]["p95_ms"].as_f64();
            let (p50_ms, p95_ms) = p50_ms.zip(p95_ms).with_context(|| stage.to_owned())?;
            ensure!(
                (0.0..=p95_ms).contains(&p50_ms),
                "{stage}: {p50_ms} {p95_ms}"
            );
        }
    }
    let metrics = server.http().get(server.url("metrics")).send().await?;
    let metrics = metrics.text().await?;
    let count = |name: &str| -> Option<u64> {
        let line = metrics.lines().find_map(|line| line.strip_prefix(name))?;
        line.trim().parse().ok()
    };
    for stage in &STAGES[..10] {
        let name = format!("skycell_frame_stage_seconds_count{{stage=\"{stage}\"}}");
        ensure!(count(&name) >= Some(rests_ms.len() as u64), "{name}");
    }
    ensure!(count("skycell_motion_to_photon_seconds_count") >= Some(rests_ms.len() as u64));
    viewer.leave().await
}
