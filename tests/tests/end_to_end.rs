//! Real viewers of a real server: what they see, what it costs, and what bad ones cannot do.

use std::time::Duration;

use anyhow::{Context, ensure};
use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use skycell_protocol::message::Hello;
use skycell_protocol::{
    Codec, FrameHeader, FrameSize, INBOUND_MESSAGE_MAX_BYTES, QualityChoice, QualityPreset,
};
use skycell_tests::picture::{colours, decoded, mean_difference};
use skycell_tests::server::total_of;
use skycell_tests::viewer::camera;
use skycell_tests::{PATIENCE, Seen, Server, ServerOptions, Viewer, until};
use tokio::io::AsyncWriteExt;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::protocol::frame::Frame as WireFrame;
use tokio_tungstenite::tungstenite::protocol::frame::coding::{Data, OpCode};
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, client_async, connect_async};

type Outcome = anyhow::Result<()>;
type Socket = WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>;

/// What a picture of the sky differs by when its clouds or its light have changed, 8-bit steps in the mean; the dither of
/// a picture is fixed, so that one of the same sky differs by nothing.
const OTHER_PICTURE: f64 = 1.0;

fn shows(revision: u64) -> impl Fn(&Seen) -> bool {
    move |seen| {
        seen.frame
            .as_ref()
            .is_some_and(|frame| frame.header.scene_revision >= revision)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn two_viewers_look_around_follow_a_patch_and_leave_an_empty_server() -> Outcome {
    let server = Server::start_calm().await?;
    let first = Viewer::join(&server, 0.0).await?;
    let second = Viewer::join(&server, 20.0).await?;
    for viewer in [&first, &second] {
        let picture = decoded(viewer.picture().await?.frame()?)?;
        assert!(colours(&picture) > 100, "{} colours", colours(&picture));
    }

    // Looks around: each camera is answered by a frame that shows it.
    let mut pictures = Vec::new();
    for yaw_deg in [90.0, 180.0] {
        let input = first.look(camera([0.0, 2.0, 0.0], yaw_deg, 20.0)?).await?;
        let seen = first
            .wait_for("a frame with the camera", |seen| {
                seen.frame
                    .as_ref()
                    .is_some_and(|frame| frame.header.input >= input)
            })
            .await?;
        pictures.push(decoded(seen.frame()?)?);
    }
    let difference = mean_difference(&pictures[0], &pictures[1]);
    assert!(
        difference > OTHER_PICTURE,
        "the picture differs by {difference}"
    );

    // A patch with the ETag; a second one with the same is stale.
    server.at_rest(2).await?;
    let cloudy = [
        decoded(first.seen().frame()?)?,
        decoded(second.seen().frame()?)?,
    ];
    let scene = server.api().scene().await?;
    let weather = &scene.document["layers"][0]["density"];
    assert!(
        weather["coverage"].is_number(),
        "the default scene has weather: {weather}"
    );
    let mut layers = scene.document["layers"].clone();
    layers[0]["density"]["coverage"] = json!(0.95);
    let patch = json!({"layers": layers});
    let patched = server.api().patch_scene(&patch, &scene.etag).await?;
    let revision = patched.revision().context("a revision")?;
    assert!(Some(revision) > scene.revision());
    assert!(server.api().patch_scene(&patch, &scene.etag).await.is_err());
    for viewer in [&first, &second] {
        viewer
            .wait_for("a frame of the new scene", shows(revision))
            .await?;
    }
    server.at_rest(2).await?;
    for (viewer, before) in [&first, &second].into_iter().zip(&cloudy) {
        let difference = mean_difference(&decoded(viewer.seen().frame()?)?, before);
        assert!(
            difference > OTHER_PICTURE,
            "the picture differs by {difference}"
        );
    }

    first.close().await;
    second.close().await;
    until("a server without viewers", async || {
        let cells = server.get("api/v1/cells").await?;
        let viewers = server.get("api/v1/viewers").await?;
        let empty = |list: &Value| list.as_array().is_some_and(Vec::is_empty);
        Ok((empty(&cells) && empty(&viewers)).then_some(()))
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_viewer_of_the_same_view_costs_no_texel_and_four_cost_what_one_costs() -> Outcome {
    let server = Server::start_calm().await?;
    let start = server.total("texels_updated").await?;
    let first = Viewer::join(&server, 0.0).await?;
    let alone = total_of(&server.at_rest(1).await?, "texels_updated")?;
    assert!(alone > start, "a picture costs texels");

    let second = Viewer::join(&server, 0.0).await?;
    second.picture().await?;
    let stats = server.at_rest(2).await?;
    assert_eq!(
        total_of(&stats, "texels_updated")?,
        alone,
        "the second viewer costs texels"
    );
    let cell = &stats["cells"][0];
    assert_eq!(cell["viewers"].as_array().map(Vec::len), Some(2));
    assert_eq!(cell["overlap"], 1.0);
    // Same cell, same view: the same picture to the byte.
    assert_eq!(
        decoded(first.seen().frame()?)?.as_raw(),
        decoded(second.seen().frame()?)?.as_raw()
    );
    first.close().await;
    second.close().await;
    until("an empty server", async || {
        let cells = server.get("api/v1/cells").await?;
        Ok(cells.as_array().is_some_and(Vec::is_empty).then_some(()))
    })
    .await?;

    // Four at once, from cold.
    let before = server.total("texels_updated").await?;
    let mut viewers = Vec::new();
    for _ in 0..4 {
        viewers.push(Viewer::join(&server, 0.0).await?);
    }
    let after = total_of(&server.at_rest(4).await?, "texels_updated")?;
    let (one, four) = ((alone - start) as f64, (after - before) as f64);
    assert!(
        four <= 1.02 * one,
        "one viewer updates {one} texels, four {four}"
    );
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_empty_server_and_a_resting_sky_submit_nothing() -> Outcome {
    let server = Server::start_calm().await?;
    let counted = [
        "texels_updated",
        "dispatches",
        "submissions",
        "frames_composited",
    ];
    let unchanged_for = async |seconds: u64, what: &str| {
        let before = server.get("api/v1/stats").await?;
        tokio::time::sleep(Duration::from_secs(seconds)).await;
        let after = server.get("api/v1/stats").await?;
        for name in counted {
            ensure!(
                total_of(&before, name)? == total_of(&after, name)?,
                "{what}: {name} rose from {} to {}",
                total_of(&before, name)?,
                total_of(&after, name)?
            );
        }
        let encoded = |stats: &Value| stats["service"]["frames_encoded"].as_u64();
        ensure!(
            encoded(&before).is_some() && encoded(&before) == encoded(&after),
            "{what}: frames were encoded"
        );
        anyhow::Ok(())
    };
    unchanged_for(2, "no client").await?;
    let first = Viewer::join(&server, 0.0).await?;
    let second = Viewer::join(&server, 30.0).await?;
    let audit = server.at_rest(2).await?["audit"].clone();
    ensure!(audit["rests"] == true, "the audit goes on: {audit}");
    ensure!(audit["texels"].as_u64() > Some(1000), "{audit}");
    let p95_percent = audit["p95_percent"].as_f64().context("a percentile")?;
    ensure!((0.0..20.0).contains(&p95_percent), "{audit}");
    let metrics = server.http().get(server.url("metrics")).send().await?;
    let metrics = metrics.text().await?;
    ensure!(metrics.contains("skycell_cache_error_percent{quantile=\"0.95\"}"));
    unchanged_for(3, "resting viewers").await?;
    // They are still served: it rests, it is not stuck.
    let input = first.look(camera([0.0, 2.0, 0.0], 10.0, 20.0)?).await?;
    first
        .wait_for("a frame after the rest", |seen| {
            seen.frame
                .as_ref()
                .is_some_and(|frame| frame.header.input >= input)
        })
        .await?;
    first.close().await;
    second.close().await;
    server.at_rest(0).await?;
    unchanged_for(2, "no client any more").await
}

#[tokio::test(flavor = "multi_thread")]
async fn light_and_exposure_change_the_picture_and_march_nothing() -> Outcome {
    let server = Server::start_calm().await?;
    let viewer = Viewer::join(&server, 0.0).await?;
    let mut before = total_of(&server.at_rest(1).await?, "texels_updated")?;
    let mut picture = decoded(viewer.seen().frame()?)?;
    for patch in [
        json!({"exposure_ev": -1.0}),
        json!({"sun": {"irradiance_w_per_m2_nm": [2.2, 0.9, 0.6]}}),
    ] {
        let revision = server.patch(&patch).await?;
        viewer
            .wait_for("a frame of the new light", shows(revision))
            .await?;
        let after = total_of(&server.at_rest(1).await?, "texels_updated")?;
        assert_eq!(after, before, "{patch} marches {} texels", after - before);
        let changed = decoded(viewer.seen().frame()?)?;
        let difference = mean_difference(&changed, &picture);
        assert!(
            difference > OTHER_PICTURE,
            "{patch}: the picture differs by {difference}"
        );
        (before, picture) = (after, changed);
    }
    Ok(())
}

/// A small viewer of the sky that asks for a quality.
async fn join_with(server: &Server, quality: Option<QualityChoice>) -> anyhow::Result<Viewer> {
    let camera = camera([0.0, 2.0, 0.0], 0.0, 20.0)?;
    let hello = Hello {
        quality,
        ..Hello::new(FrameSize::new(160, 90)?, 30.0, camera)
    };
    Viewer::join_as(server, hello).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_who_asks_for_draft_costs_fewer_texels_than_one_who_asks_for_high() -> Outcome {
    let server = Server::start_calm().await?;
    let mut updated = Vec::new();
    for preset in [QualityPreset::Draft, QualityPreset::High] {
        let before = server.total("texels_updated").await?;
        let viewer = join_with(&server, Some(QualityChoice::Preset(preset))).await?;
        let stats = server.at_rest(1).await?;
        updated.push(total_of(&stats, "texels_updated")? - before);
        let quality = &stats["viewers"][0]["quality"];
        ensure!(
            quality["picked"] == preset.name()
                && quality["asked"] == json!({"preset": preset.name()})
                && quality["asked_by"] == "viewer"
                && quality["is_met"] == true,
            "{quality}"
        );
        let settings = &quality["settings"];
        ensure!(
            stats["cells"][0]["samples"] == settings["samples"]
                && stats["cells"][0]["march_steps"] == settings["march_steps"],
            "{stats}"
        );
        viewer.close().await;
        server.at_rest(0).await?;
    }
    let [draft, high] = updated[..] else {
        unreachable!("two presets");
    };
    ensure!(
        4 * draft < high,
        "draft updates {draft} texels, high {high}"
    );

    // The scene's choice holds for who makes none, and is answered by the present scene's figures.
    server
        .patch(&json!({"quality": {"max_error": 0.015}}))
        .await?;
    let viewer = join_with(&server, None).await?;
    let stats = server.at_rest(1).await?;
    for quality in [&stats["quality"], &stats["viewers"][0]["quality"]] {
        ensure!(
            quality["asked_by"] == "scene" && quality["flip"].as_f64() <= Some(0.015),
            "{quality}"
        );
    }
    viewer.close().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_who_asks_for_more_than_the_cell_has_gets_it_without_a_restart_of_the_cell()
-> Outcome {
    let server = Server::start_calm().await?;
    let draft = QualityChoice::Preset(QualityPreset::Draft);
    let first = join_with(&server, Some(draft)).await?;
    let coarse = server.at_rest(1).await?;
    let balanced = QualityChoice::Preset(QualityPreset::Balanced);
    let second = join_with(&server, Some(balanced)).await?;
    let fine = server.at_rest(2).await?;
    let cell = |stats: &Value| stats["cells"][0].clone();
    ensure!(cell(&coarse)["id"] == cell(&fine)["id"]);
    ensure!(cell(&coarse)["march_steps"].as_u64() < cell(&fine)["march_steps"].as_u64());
    // The first one's wish has not changed; what it sees has become finer.
    ensure!(fine["viewers"][0]["quality"]["picked"] == "draft", "{fine}");
    let frames = first.seen().frames;
    ensure!(frames > 0);
    first.close().await;
    second.close().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_budget_that_nothing_meets_ends_at_the_cheapest_and_says_so() -> Outcome {
    // With wind, so that there are always frames to measure.
    let server = Server::start().await?;
    let budget = QualityChoice::BudgetMs(0.1);
    let camera = camera([0.0, 2.0, 0.0], 0.0, 20.0)?;
    let hello = Hello {
        quality: Some(budget),
        ..Hello::new(FrameSize::new(640, 360)?, 10.0, camera)
    };
    let viewer = Viewer::join_as(&server, hello).await?;
    let quality = until("the cheapest point", async || {
        let quality = server.get("api/v1/stats").await?["viewers"][0]["quality"].clone();
        let is_draft = quality["picked"] == "draft" && quality["device_ms_per_frame"].is_f64();
        Ok(is_draft.then_some(quality))
    })
    .await;
    // A device that is faster than this, or that tells no times, cannot be brought to it.
    let stats = server.get("api/v1/stats").await?;
    if stats["adapter"]["device_type"] == "Cpu" {
        let quality = quality?;
        ensure!(quality["is_met"] == false, "{quality}");
        ensure!(quality["asked"] == json!({"budget_ms": 0.1}), "{quality}");
    }
    viewer.close().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn viewers_in_two_placed_cells_have_caches_of_their_own() -> Outcome {
    let server = Server::start_with(ServerOptions {
        cells_toml: "[[cells]]\nname = \"west\"\ncenter_m = [-20000.0, 2.0, 0.0]\nradius_m = 3000.0\n\
                     [[cells]]\nname = \"east\"\ncenter_m = [20000.0, 2.0, 0.0]\nradius_m = 3000.0\n"
            .to_owned(),
        ..ServerOptions::default()
    })
    .await?;
    server.calm().await?;
    let join_at = async |x_m: f64| {
        let camera = camera([x_m, 2.0, 100.0], 0.0, 20.0)?;
        Viewer::join_as(&server, Hello::new(FrameSize::new(320, 180)?, 30.0, camera)).await
    };
    let west = join_at(-20_000.0).await?;
    let one = server.at_rest(1).await?;
    let east = join_at(20_000.0).await?;
    let two = server.at_rest(2).await?;
    // The east's texels are not the west's, though both look the same way.
    let (one_texels, two_texels) = (
        total_of(&one, "texels_updated")?,
        total_of(&two, "texels_updated")?,
    );
    assert!(two_texels > one_texels);
    for (viewer, name) in [(&west, "west"), (&east, "east")] {
        let cells = two["cells"].as_array().context("cells")?;
        let cell = cells.iter().find(|cell| cell["name"] == name);
        let cell = cell.with_context(|| format!("no cell {name} in {cells:?}"))?;
        assert_eq!(cell["viewers"], json!([viewer.id().0]), "{name}");
        assert!(cell["bytes"].as_u64() > Some(0), "{cell}");
        assert_eq!(cell["overlap"], 0.0, "{cell}");
        assert_eq!(
            viewer.seen().frame()?.header.cell.0,
            cell["id"].as_u64().unwrap_or(0) as u32
        );
    }
    let west_bytes = two["cells"][0]["bytes"].as_u64();
    west.close().await;
    let after = until("an empty west", async || {
        let stats = server.get("api/v1/stats").await?;
        let gone = stats["cells"][0]["viewers"]
            .as_array()
            .is_some_and(Vec::is_empty);
        Ok(gone.then_some(stats))
    })
    .await?;
    assert!(
        after["cells"][0]["bytes"].as_u64() < west_bytes,
        "the west keeps its memory: {after}"
    );
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scene_outlives_a_server_that_is_killed() -> Outcome {
    let state = tempfile::tempdir()?;
    let options = ServerOptions {
        state_dir: Some(state.path().to_owned()),
        ..ServerOptions::default()
    };
    let server = Server::start_with(options.clone()).await?;
    let revision = server
        .patch(&json!({"sun": {"elevation_deg": 12.5}}))
        .await?;
    server.kill()?;
    let server = Server::start_with(options).await?;
    let scene = server.api().scene().await?;
    assert_eq!(scene.document["sun"]["elevation_deg"], 12.5);
    assert!(
        scene.revision() >= Some(revision),
        "{:?} after {revision}",
        scene.etag
    );
    let viewer = Viewer::join(&server, 0.0).await?;
    viewer
        .wait_for("a frame of the kept scene", shows(revision))
        .await?;
    Ok(())
}

/// What the server may grow by while a viewer does not read. Its share is bounded: two frames composited, one encoded in
/// the slot, one on its way and the sockets' buffers; of 640x360 as PNG these are below 4 MiB. The rest is for the
/// allocators of the process and of the driver.
const STALL_GROWTH_MAX_KIB: u64 = 24 * 1024;

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_that_stops_reading_costs_no_memory_and_slows_no_neighbour() -> Outcome {
    let server = Server::start_with(ServerOptions {
        // Longer than the test: it is not dropped, it is borne.
        top_level_toml: "viewer_stall_s = 300.0".to_owned(),
        ..ServerOptions::default()
    })
    .await?;
    server.calm().await?;
    let neighbour = Viewer::join(&server, 0.0).await?;
    neighbour.picture().await?;
    let at = camera([0.0, 2.0, 0.0], 0.0, 20.0)?;
    let mut hello = Hello::new(FrameSize::new(640, 360)?, 30.0, at);
    hello.codec = Codec::Png;
    let mut stalled = session(narrow_socket(&server).await?, &hello).await?;

    // It turns and acknowledges like one that reads, so that the server has every reason to send it frames.
    let mut input = 0;
    let mut turn_and_count_sent = async |seconds: u64| {
        let until = tokio::time::Instant::now() + Duration::from_secs(seconds);
        while tokio::time::Instant::now() < until {
            input += 1;
            let yaw_deg = (input % 40) as f64;
            let looked = camera([0.0, 2.0, 0.0], yaw_deg, 20.0)?;
            neighbour.look(looked).await?;
            let messages = [
                json!({"type": "camera", "input": input, "camera": looked}),
                json!({"type": "ack", "sequence": input}),
            ];
            for message in messages {
                stalled.send(Message::text(message.to_string())).await?;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let viewers = server.get("api/v1/viewers").await?;
        let other = |viewer: &&Value| viewer["id"] != neighbour.id().0;
        let viewer = viewers.as_array().and_then(|all| all.iter().find(other));
        let sent = viewer.and_then(|viewer| viewer["frames_sent"].as_u64());
        sent.with_context(|| format!("the stalled viewer is gone: {viewers}"))
    };
    // Until the sockets are full and the caches hold what the turning cameras see: that memory is not the stalled one's.
    let mut settled = (
        turn_and_count_sent(3).await?,
        server.total("cache_bytes").await?,
    );
    for tries in 0.. {
        ensure!(
            tries < 15,
            "frames sent to a viewer that does not read, or cache bytes, still rise: {settled:?}"
        );
        let now = (
            turn_and_count_sent(3).await?,
            server.total("cache_bytes").await?,
        );
        if std::mem::replace(&mut settled, now) == now {
            break;
        }
    }
    let (sent, _) = settled;
    let warm = server.memory_kib();
    let frames = neighbour.seen().frames;
    assert_eq!(
        turn_and_count_sent(6).await?,
        sent,
        "the viewer was not stalled"
    );
    let seen = neighbour.seen().frames - frames;
    assert!(seen >= 6, "the neighbour got {seen} frames in 6 s");
    match (warm, server.memory_kib()) {
        (Some(before), Some(after)) => {
            println!("{sent} frames sent to the stalled viewer, {seen} in 6 s to its neighbour");
            println!("server memory {before} KiB, 6 s later {after} KiB");
            assert!(
                after < before + STALL_GROWTH_MAX_KIB,
                "memory grew from {before} to {after} KiB"
            );
        }
        _ => println!("SKIPPED: the memory of the server is not known without /proc"),
    }
    drop(stalled);
    Ok(())
}

/// A WebSocket whose messages the test writes itself.
async fn raw_socket(server: &Server) -> anyhow::Result<Socket> {
    let mut request = format!("ws://{}/ws", server.address()).into_client_request()?;
    let headers = request.headers_mut();
    headers.insert("sec-websocket-protocol", "skycell.v1".parse()?);
    Ok(connect_async(request).await?.0)
}

/// The same with a receive buffer that a picture does not fit in.
async fn narrow_socket(server: &Server) -> anyhow::Result<Socket> {
    let socket = tokio::net::TcpSocket::new_v4()?;
    socket.set_recv_buffer_size(4096)?;
    let stream = socket.connect(server.address().parse()?).await?;
    let mut request = format!("ws://{}/ws", server.address()).into_client_request()?;
    let headers = request.headers_mut();
    headers.insert("sec-websocket-protocol", "skycell.v1".parse()?);
    Ok(client_async(request, MaybeTlsStream::Plain(stream))
        .await?
        .0)
}

async fn raw_session(server: &Server, hello: &Hello) -> anyhow::Result<Socket> {
    session(raw_socket(server).await?, hello).await
}

async fn session(mut socket: Socket, hello: &Hello) -> anyhow::Result<Socket> {
    let mut message = serde_json::to_value(hello)?;
    message["type"] = json!("hello");
    socket.send(Message::text(message.to_string())).await?;
    let welcome = next_json(&mut socket).await?.context("a welcome")?;
    ensure!(welcome["type"] == "welcome", "no welcome but {welcome}");
    Ok(socket)
}

/// The next text message; None when the server has closed.
async fn next_json(socket: &mut Socket) -> anyhow::Result<Option<Value>> {
    let hearing = async {
        loop {
            match socket.next().await {
                Some(Ok(Message::Text(text))) => return Ok(Some(serde_json::from_str(&text)?)),
                Some(Ok(Message::Binary(bytes))) => {
                    let (header, _) = FrameHeader::split(&bytes)?;
                    if !header.heartbeat {
                        let ack = json!({"type": "ack", "sequence": header.sequence});
                        socket.send(Message::text(ack.to_string())).await?;
                    }
                }
                Some(Ok(Message::Close(_)) | Err(_)) | None => return Ok(None),
                Some(Ok(_)) => {}
            }
        }
    };
    tokio::time::timeout(PATIENCE, hearing)
        .await
        .context("the server says nothing")?
}

/// The next error that the server tells.
async fn next_error(socket: &mut Socket) -> anyhow::Result<Value> {
    loop {
        let message = next_json(socket)
            .await?
            .context("closed without an error")?;
        if message["type"] == "error" {
            return Ok(message);
        }
    }
}

fn ensure_error(text: &str, error: &Value, code: &str, part: &str) -> Outcome {
    let message = error["message"].as_str().unwrap_or_default();
    ensure!(
        error["code"] == code && message.contains(part),
        "{text} gets {error}, not {code} with {part}"
    );
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_input_of_each_kind_gets_its_error_and_a_frame_still_comes_afterwards() -> Outcome {
    let server = Server::start_calm().await?;
    let hello = Hello::new(
        FrameSize::new(64, 36)?,
        10.0,
        camera([0.0, 2.0, 0.0], 0.0, 20.0)?,
    );

    // What a session survives.
    let mut socket = raw_session(&server, &hello).await?;
    let camera_of = |yaw: &str| {
        format!(
            r#"{{"type":"camera","input":1,"camera":{{"position_m":[0,2,0],"yaw_deg":{yaw},"pitch_deg":0,"vertical_fov_deg":60}}}}"#
        )
    };
    for (text, code, part) in [
        ("{\"type\":\"camera\",".to_owned(), "bad-json", "EOF"),
        (camera_of("NaN"), "bad-json", ""),
        (camera_of("1e999"), "bad-json", ""),
        (camera_of("\"north\""), "bad-value", "/camera/yaw_deg"),
        (
            r#"{"type":"camra"}"#.to_owned(),
            "unknown-type",
            "did you mean \"camera\"",
        ),
        (
            r#"{"type":"view","hight":3}"#.to_owned(),
            "bad-value",
            "did you mean \"height\"",
        ),
        (
            r#"{"type":"view","quality":{"budget_ms":0}}"#.to_owned(),
            "bad-value",
            "/quality/budget_ms",
        ),
        (
            r#"{"type":"view","width":0,"height":0}"#.to_owned(),
            "bad-value",
            "1 to 3840",
        ),
        (
            r#"{"type":"view","width":100000,"height":100000}"#.to_owned(),
            "bad-value",
            "1 to 3840",
        ),
    ] {
        socket.send(Message::text(text.clone())).await?;
        ensure_error(&text, &next_error(&mut socket).await?, code, part)?;
    }
    drop(socket);

    // What ends it.
    let oversized = || Message::text(" ".repeat(INBOUND_MESSAGE_MAX_BYTES + 1));
    for (message, code) in [
        (oversized(), "too-large"),
        (Message::binary(vec![1, 2, 3]), "wrong-protocol"),
        (
            Message::text(r#"{"type":"ack","sequence":1}"#),
            "hello-expected",
        ),
    ] {
        let mut socket = raw_socket(&server).await?;
        socket.send(message).await?;
        ensure_error(code, &next_error(&mut socket).await?, code, "")?;
        ensure!(
            next_json(&mut socket).await?.is_none(),
            "{code}: the session goes on"
        );
    }

    // Truncated: a first piece and nothing more; and a connection that ends in the middle of a frame.
    let mut socket = raw_session(&server, &hello).await?;
    let piece = WireFrame::message(br#"{"type":"ca"#.to_vec(), OpCode::Data(Data::Text), false);
    socket.send(Message::Frame(piece)).await?;
    drop(socket);
    let mut socket = raw_session(&server, &hello).await?;
    if let MaybeTlsStream::Plain(stream) = socket.get_mut() {
        // Announces 100 masked bytes, of which 4 come.
        stream
            .write_all(&[0x81, 0x80 | 100, 1, 2, 3, 4, 9, 9, 9, 9])
            .await?;
        stream.shutdown().await?;
    }
    drop(socket);

    // A handshake that asks for something else.
    for asked in [None, Some("skycell.v2")] {
        let mut request = format!("ws://{}/ws", server.address()).into_client_request()?;
        if let Some(asked) = asked {
            request
                .headers_mut()
                .insert("sec-websocket-protocol", asked.parse()?);
        }
        match connect_async(request).await {
            Err(Error::Http(answer)) => {
                let body = answer.body().clone().unwrap_or_default();
                let text = String::from_utf8_lossy(&body).into_owned();
                ensure!(
                    answer.status() == 400 && text.contains("skycell.v1"),
                    "{asked:?}: {text}"
                );
            }
            other => anyhow::bail!("{asked:?} is answered by {other:?}"),
        }
    }

    // Bad scenes.
    for (body, status, part) in [
        ("{\"sun\":", 400, "EOF"),
        (r#"{"sun":{"elevation_deg":NaN}}"#, 400, ""),
        (r#"{"sun":{"elevatoin_deg":1}}"#, 422, "elevation_deg"),
        (r#"{"sun":{"elevation_deg":91}}"#, 422, "/sun/elevation_deg"),
        (r#"{"wind":{"speed_m_per_s":-1}}"#, 422, "0 to 200"),
        (
            r#"{"quality":{"max_error":7}}"#,
            422,
            "/quality/max_error is 7; allowed: 0.001 to 1",
        ),
        (r#"{"quality":"best"}"#, 422, "balanced"),
    ] {
        let answer = server
            .http()
            .patch(server.url("api/v1/scene"))
            .header("content-type", "application/merge-patch+json")
            .header("if-match", "*")
            .body(body)
            .send()
            .await?;
        let found = answer.status();
        let text = answer.text().await?;
        ensure!(
            found == status && text.contains(part),
            "{body}: {found} {text}"
        );
    }

    // The server goes on, and nobody has stayed behind.
    let viewer = Viewer::join(&server, 0.0).await?;
    assert!(colours(&decoded(viewer.picture().await?.frame()?)?) > 100);
    until("only the good viewer", async || {
        let viewers = server.get("api/v1/viewers").await?;
        Ok((viewers.as_array().map(Vec::len) == Some(1)).then_some(()))
    })
    .await
}
