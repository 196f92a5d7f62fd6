//! What rests is composited no more.

use std::time::Duration;

use anyhow::{Context, ensure};
use serde_json::{Value, json};
use skycell_client::Frame;
use skycell_protocol::message::Hello;
use skycell_protocol::{Codec, FrameSize, RendererKind, Show};
use skycell_tests::server::total_of;
use skycell_tests::viewer::camera;
use skycell_tests::{PATIENCE, Server, ServerOptions, Viewer};
use tokio::time::Instant;

use crate::Outcome;

/// Nothing may be composited for so long; with `SKYCELL_FULL` for longer.
fn watched() -> Duration {
    Duration::from_secs(if std::env::var_os("SKYCELL_FULL").is_some() {
        20
    } else {
        4
    })
}

async fn composited(server: &Server) -> anyhow::Result<u64> {
    total_of(&server.get("api/v1/stats").await?, "frames_composited")
}

/// Watches for a time; every figure that rises with a composite is told.
async fn stays_at_rest(server: &Server, what: &str) -> Outcome {
    let before = server.get("api/v1/stats").await?;
    let begun = Instant::now();
    let mut last = total_of(&before, "frames_composited")?;
    let mut rises = Vec::new();
    while begun.elapsed() < watched() {
        tokio::time::sleep(Duration::from_millis(100)).await;
        let now = composited(server).await?;
        if now != last {
            rises.push(format!(
                "{} at {:.1} s",
                now - last,
                begun.elapsed().as_secs_f64()
            ));
            last = now;
        }
    }
    let after = server.get("api/v1/stats").await?;
    println!("{what}: {rises:?} composited in {:?}", watched());
    ensure!(
        rises.is_empty(),
        "{what}: {rises:?} composited;\nbefore {before}\nafter {after}"
    );
    Ok(())
}

/// Viewers of each codec and renderer, side by side.
async fn join_each(server: &Server) -> anyhow::Result<Vec<Viewer>> {
    let hello_at = |codec, altitude_m, pitch_deg| -> anyhow::Result<Hello> {
        let camera = camera([0.0, altitude_m, 0.0], 0.0, pitch_deg)?;
        Ok(Hello {
            codec,
            ..Hello::new(FrameSize::new(96, 54)?, 15.0, camera)
        })
    };
    let hello = |codec| hello_at(codec, 2.0, 20.0);
    let wishes = [
        hello(Codec::Jpeg)?,
        hello(Codec::H264)?,
        hello(Codec::Clouds)?,
        Hello {
            renderer: RendererKind::ScreenSpace,
            ..hello(Codec::Png)?
        },
        Hello {
            show: Show::CacheMip,
            ..hello(Codec::Png)?
        },
        // In a layer, and above all of them.
        hello_at(Codec::Jpeg, 2_500.0, 5.0)?,
        hello_at(Codec::Png, 12_000.0, -20.0)?,
    ];
    let mut viewers = Vec::new();
    for wish in wishes {
        viewers.push(Viewer::join_as(server, wish).await?);
    }
    Ok(viewers)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sky_at_rest_is_composited_no_more_for_any_codec_or_renderer() -> Outcome {
    let server = Server::start_calm().await?;
    let scenes = [
        ("the default", json!({})),
        (
            "exposure by the light, shafts, moon and stars",
            json!({
                "tone": {"curve": "agx", "auto_exposure": {}},
                "atmosphere": {"model": "physical", "light_shafts": true},
                "moon": {}, "stars": {},
            }),
        ),
    ];
    for (what, patch) in scenes {
        server.patch(&patch).await?;
        let viewers = join_each(&server).await?;
        for viewer in &viewers {
            viewer.picture().await?;
        }
        server.at_rest(viewers.len()).await?;
        stays_at_rest(&server, what).await?;
        for viewer in viewers {
            viewer.close().await;
        }
        server.at_rest(0).await?;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn after_motion_that_took_samples_no_frame_is_called_exact_before_they_are_there() -> Outcome
{
    // A device that marches hardly at all while somebody moves.
    let options = ServerOptions {
        render_toml: "march_share = 0.02".to_owned(),
        ..ServerOptions::default()
    };
    let server = Server::start_with(options).await?;
    server.calm().await?;
    let viewer = Viewer::join(&server, 0.0).await?;
    viewer.picture().await?;
    let begun = Instant::now();
    let lost = |stats: &Value| stats["losses"]["samples_divisor"].as_u64();
    // Each step is into another cell, so there is always all to be marched.
    let mut east_m = 0.0;
    loop {
        east_m += 40_000.0;
        viewer.look(camera([east_m, 2.0, 0.0], 0.0, 20.0)?).await?;
        tokio::time::sleep(Duration::from_millis(300)).await;
        if lost(&server.get("api/v1/stats").await?).context("a divisor")? > 1 {
            break;
        }
        ensure!(begun.elapsed() < PATIENCE, "nothing is given up");
    }
    println!(
        "samples are given up after {:.1} s of jumping",
        begun.elapsed().as_secs_f64()
    );
    let input = viewer.look(camera([east_m, 2.0, 0.0], 0.0, 20.0)?).await?;
    let exact = |frame: &Frame| frame.header.input >= input && frame.header.exact;
    let seen = viewer
        .wait_for("an exact frame", |seen| {
            seen.frame.as_ref().is_some_and(exact)
        })
        .await?;
    println!(
        "an exact frame after {:.1} s",
        begun.elapsed().as_secs_f64()
    );
    let stats = server.at_rest(1).await?;
    ensure!(lost(&stats) == Some(1), "{}", stats["losses"]);
    stays_at_rest(&server, "after a turn").await?;
    let after = viewer.seen();
    ensure!(
        after.frames == seen.frames,
        "{} frames after the exact one",
        after.frames - seen.frames
    );
    viewer.close().await;
    Ok(())
}
