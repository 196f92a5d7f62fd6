//! View cells through the service: what a viewer is shown that goes from one to another.

use anyhow::Context;
use serde_json::Value;
use skycell_protocol::FrameSize;
use skycell_protocol::message::Hello;
use skycell_tests::viewer::camera;
use skycell_tests::{Server, ServerOptions, Viewer, until};

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_who_changes_cells_gets_frames_all_the_way_and_nothing_is_left_behind()
-> anyhow::Result<()> {
    let server = Server::start_with(ServerOptions {
        cells_toml: "[[cells]]\nname = \"plaza\"\ncenter_m = [0.0, 2.0, 0.0]\nradius_m = 300.0\n\
                     [[cells]]\nname = \"arena\"\ncenter_m = [700.0, 2.0, 0.0]\nradius_m = 300.0\n"
            .to_owned(),
        ..ServerOptions::default()
    })
    .await?;
    server.calm().await?;
    let at = |x_m: f64| camera([x_m, 2.0, 0.0], 0.0, 20.0);
    let hello = Hello::new(FrameSize::new(320, 180)?, 30.0, at(0.0)?);
    let viewer = Viewer::join_as(&server, hello).await?;
    server.at_rest(1).await?;
    let ways = |stats: &Value, what: &str| stats["transitions"][what].as_u64();
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
