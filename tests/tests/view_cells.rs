//! View cells through the service: what a viewer is shown that goes from one to another.

use anyhow::Context;
use serde_json::Value;
use skycell_protocol::FrameSize;
use skycell_protocol::message::Hello;
use skycell_tests::viewer::camera;
use skycell_tests::{Server, ServerOptions, Viewer, until};

const CELLS: &str = "[[cells]]\nname = \"plaza\"\ncenter_m = [0.0, 2.0, 0.0]\nradius_m = 300.0\n\
                     [[cells]]\nname = \"arena\"\ncenter_m = [700.0, 2.0, 0.0]\nradius_m = 300.0\n";

fn ways(stats: &Value, what: &str) -> Option<u64> {
    stats["transitions"][what].as_u64()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_who_changes_cells_gets_frames_all_the_way_and_nothing_is_left_behind()
-> anyhow::Result<()> {
    let server = Server::start_with(ServerOptions {
        cells_toml: CELLS.to_owned(),
        ..ServerOptions::default()
    })
    .await?;
    server.calm().await?;
    let at = |x_m: f64| camera([x_m, 2.0, 0.0], 0.0, 20.0);
    let hello = Hello::new(FrameSize::new(320, 180)?, 30.0, at(0.0)?);
    let viewer = Viewer::join_as(&server, hello).await?;
    server.at_rest(1).await?;
    let plaza = viewer.seen().frame()?.header.cell;
    viewer.look(at(700.0)?).await?;
    let begun = until("a way", async || {
        let stats = server.get("api/v1/stats").await?;
        Ok((ways(&stats, "begun") == Some(1)).then_some(stats))
    })
    .await?;
    assert_eq!(ways(&begun, "swapped"), Some(0), "{}", begun["transitions"]);
    let before = viewer.seen().frame()?.header.sequence;
    let after = until("the other cell", async || {
        let stats = server.get("api/v1/stats").await?;
        Ok((ways(&stats, "viewers") == Some(0)).then_some(stats))
    })
    .await?;
    let seen = viewer.seen();
    let frame = &seen.frame()?.header;
    assert_ne!(frame.cell, plaza);
    assert!(frame.sequence.0 > before.0, "no frame on the way");
    for what in ["fading", "cells_kept", "picture_bytes"] {
        assert_eq!(ways(&after, what), Some(0), "{}", after["transitions"]);
    }
    let metrics = server.http().get(server.url("metrics")).send().await?;
    let metrics = metrics.text().await?;
    assert!(
        metrics.contains("skycell_cell_changes_total{shown=\"way\"} 1"),
        "{metrics}"
    );
    let cells = after["cells"].as_array().context("cells")?;
    let plaza = cells.iter().find(|cell| cell["name"] == "plaza");
    assert_eq!(plaza.context("the plaza")?["bytes"], 0);
    viewer.close().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_who_changes_cells_by_rays_of_its_own_arrives_and_nothing_is_kept_for_it_meanwhile()
-> anyhow::Result<()> {
    let server = Server::start_with(ServerOptions {
        render_toml: "transitions = \"own-rays\"\nparallax_steps = 0".to_owned(),
        cells_toml: CELLS.to_owned(),
        ..ServerOptions::default()
    })
    .await?;
    server.calm().await?;
    let at = |x_m: f64, yaw_deg: f64| camera([x_m, 2.0, 0.0], yaw_deg, 20.0);
    let hello = Hello::new(FrameSize::new(160, 90)?, 10.0, at(250.0, 0.0)?);
    let viewer = Viewer::join_as(&server, hello).await?;
    server.at_rest(1).await?;
    let plaza = viewer.seen().frame()?.header.cell;
    viewer.look(at(450.0, 0.0)?).await?;
    let on_its_way = until("rays of its own", async || {
        let stats = server.get("api/v1/stats").await?;
        Ok((ways(&stats, "own_rays") == Some(1)).then_some(stats))
    })
    .await?;
    for (what, count) in [("begun", 1), ("swapped", 0), ("cells_kept", 0)] {
        let ways = &on_its_way["transitions"];
        assert_eq!(ways[what].as_u64(), Some(count), "{ways}");
    }
    let metrics = server.http().get(server.url("metrics")).send().await?;
    let metrics = metrics.text().await?;
    assert!(
        metrics.contains("skycell_viewers_with_rays_in_transition 1"),
        "{metrics}"
    );
    let before = viewer.seen().frame()?.header.sequence;
    until("frames on the way", async || {
        let seen = viewer.seen();
        Ok((seen.frame()?.header.sequence.0 > before.0 + 3).then_some(()))
    })
    .await?;
    // Who stands goes on for minutes; who turns arrives.
    let mut yaw_deg = 0.0;
    until("the other cell", async || {
        yaw_deg += 30.0;
        viewer.look(at(450.0, yaw_deg)?).await?;
        let stats = server.get("api/v1/stats").await?;
        Ok((ways(&stats, "viewers") == Some(0)).then_some(()))
    })
    .await?;
    server.at_rest(1).await?;
    let after = server.get("api/v1/stats").await?;
    assert_eq!(
        after["viewers"][0]["renderer"], "cached",
        "{}",
        after["viewers"]
    );
    assert_ne!(viewer.seen().frame()?.header.cell, plaza);
    for what in ["own_rays", "fading", "cells_kept", "picture_bytes"] {
        assert_eq!(ways(&after, what), Some(0), "{}", after["transitions"]);
    }
    viewer.close().await;
    Ok(())
}
