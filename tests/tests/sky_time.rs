//! Skies that move, on real servers: one document, one sky; nothing jumps; what has come to rest costs nothing.

use std::time::{Duration, Instant};

use anyhow::Context;
use image::RgbImage;
use serde_json::{Value, json};
use skycell_protocol::message::Hello;
use skycell_protocol::{Codec, FrameSize};
use skycell_tests::picture::{decoded, mean_difference};
use skycell_tests::server::total_of;
use skycell_tests::viewer::camera;
use skycell_tests::{Seen, Server, Viewer};

type Outcome = anyhow::Result<()>;

/// Small, for nine pictures have to be marched on two cores; PNG, for they are compared by the byte.
async fn viewer(server: &Server) -> anyhow::Result<Viewer> {
    let camera = camera([0.0, 2.0, 0.0], 150.0, 20.0)?;
    let mut hello = Hello::new(FrameSize::new(192, 108)?, 20.0, camera);
    hello.codec = Codec::Png;
    Viewer::join_as(server, hello).await
}

async fn put_time(server: &Server, change: Value) -> anyhow::Result<Value> {
    Ok(server.api().change_time(&change).await?)
}

fn picture(seen: &Seen) -> anyhow::Result<RgbImage> {
    decoded(seen.frame()?)
}

/// Pictures that come within a time, with the largest difference between one and the next.
async fn watched(viewer: &Viewer, time: Duration) -> anyhow::Result<(Vec<RgbImage>, f64)> {
    let until = Instant::now() + time;
    let mut pictures = vec![picture(&viewer.picture().await?)?];
    let mut sequence = viewer.seen().frame()?.header.sequence;
    let mut largest: f64 = 0.0;
    while Instant::now() < until {
        let seen = viewer.seen();
        let frame = seen.frame()?;
        if frame.header.sequence == sequence {
            tokio::time::sleep(Duration::from_millis(5)).await;
            continue;
        }
        sequence = frame.header.sequence;
        let next = picture(&seen)?;
        largest = largest.max(mean_difference(&pictures[pictures.len() - 1], &next));
        pictures.push(next);
    }
    Ok((pictures, largest))
}

#[tokio::test(flavor = "multi_thread")]
async fn two_servers_with_one_document_show_the_same_picture_to_the_byte() -> Outcome {
    let a = Server::start().await?;
    a.patch(&json!({
        "sun": {"place_and_time": {"latitude_deg": 47, "longitude_deg": 8, "date": "2026-09-01T10:00:00Z"}},
        "wind": {"speed_m_per_s": 8},
        "animation": [{"path": "/layers/0/density/coverage", "repeat": "ping-pong", "keyframes": [
            {"at_s": 0, "value": 0.3}, {"at_s": 600, "value": 0.7}]}],
    }))
    .await?;
    a.api().set_preset("broken-sunset", 3600.0).await?;
    put_time(&a, json!({"rate": 24})).await?;
    tokio::time::sleep(Duration::from_millis(300)).await;
    put_time(&a, json!({"paused": true})).await?;
    let mut document = a.get("api/v1/scene").await?;
    // The transition goes on by the wall's clock; for a picture to the byte it has to be over.
    document["transition"] = Value::Null;
    let b = a.start_beside().await?;
    for server in [&a, &b] {
        server.patch(&document).await?;
        assert_eq!(
            server.get("api/v1/scene").await?["drift"],
            document["drift"]
        );
    }
    let mut pictures = Vec::new();
    for server in [&a, &b] {
        let viewer = viewer(server).await?;
        viewer.picture().await?;
        server.at_rest(1).await?;
        pictures.push(picture(&viewer.seen())?);
        viewer.close().await;
    }
    assert_eq!(pictures[0].as_raw(), pictures[1].as_raw());
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sun_that_races_never_jumps_and_where_it_is_stopped_the_sky_comes_to_rest() -> Outcome {
    let server = Server::start_calm().await?;
    server
        .patch(&json!({"sun": {"place_and_time": {"latitude_deg": 47, "date": "2026-09-01T07:00:00Z"}}}))
        .await?;
    put_time(&server, json!({"paused": true, "sky_s": 0})).await?;
    let viewer = viewer(&server).await?;
    viewer.picture().await?;
    server.at_rest(1).await?;
    let morning = picture(&viewer.seen())?;

    // A day in ten minutes: 0.6 degrees a second.
    let texels = server.total("texels_updated").await?;
    put_time(&server, json!({"paused": false, "rate": 144})).await?;
    let (pictures, largest) = watched(&viewer, Duration::from_secs(8)).await?;
    let marched = server.total("texels_updated").await? - texels;
    let time = put_time(&server, json!({"paused": true})).await?;
    let sky_s = time["sky_s"].as_f64().context("a number")?;
    server.at_rest(1).await?;
    let stopped = picture(&viewer.seen())?;
    let way = mean_difference(&morning, &stopped);
    println!(
        "a day in ten minutes: {} pictures, {:.0} texels a second, the largest change from one to the next {largest:.2}, \
         all in all {way:.2}",
        pictures.len(),
        marched as f64 / 8.0,
    );
    assert!(pictures.len() > 20, "{} pictures", pictures.len());
    assert!(way > 4.0, "the sun has moved: {way}");
    assert!(largest < way / 3.0, "{largest} of {way} at once");

    // What was mixed on the way is what is marched at once.
    let fresh = server.start_beside().await?;
    fresh.calm().await?;
    let mut document = server.get("api/v1/scene").await?;
    document["time"]["paused_at"] = document["time"]["epoch"].clone();
    document["time"]["sky_s_at_epoch"] = json!(sky_s);
    fresh.patch(&document).await?;
    let other = viewer_of(&fresh).await?;
    fresh.at_rest(1).await?;
    let difference = mean_difference(&picture(&other.seen())?, &stopped);
    println!("mixed against marched anew: {difference:.3}");
    assert!(difference < 0.5, "{difference}");

    // At rest nothing is marched.
    let texels = total_of(&server.at_rest(1).await?, "texels_updated")?;
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(server.total("texels_updated").await?, texels);
    Ok(())
}

async fn viewer_of(server: &Server) -> anyhow::Result<Viewer> {
    let viewer = viewer(server).await?;
    viewer.picture().await?;
    Ok(viewer)
}

#[tokio::test(flavor = "multi_thread")]
async fn one_preset_becomes_another_without_a_jump_also_when_it_is_left_on_the_way() -> Outcome {
    let server = Server::start_calm().await?;
    server.api().set_preset("fair-weather-cumulus", 0.0).await?;
    let viewer = viewer_of(&server).await?;
    server.calm().await?;
    server.at_rest(1).await?;
    let before = picture(&viewer.seen())?;
    server.api().set_preset("overcast", 6.0).await?;
    let (first, jump_of_first) = watched(&viewer, Duration::from_secs(3)).await?;
    server.api().set_preset("cirrus-evening", 6.0).await?;
    let (second, jump_of_second) = watched(&viewer, Duration::from_secs(8)).await?;
    server.calm().await?;
    server.at_rest(1).await?;
    let after = picture(&viewer.seen())?;
    let way = mean_difference(&before, &after);
    println!(
        "fair weather to overcast: {} pictures, largest change {jump_of_first:.2}; left for a cirrus evening: {} pictures, \
         {jump_of_second:.2}; all in all {way:.2}",
        first.len(),
        second.len()
    );
    assert!(way > 8.0, "the presets differ: {way}");
    assert!(jump_of_first.max(jump_of_second) < way / 3.0);
    Ok(())
}
