//! Viewers that behave, and viewers that do not read.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use serde_json::json;
use skycell_protocol::message::ServerMessage;
use skycell_protocol::{FrameCodec, FrameSequence, InputSequence};

use crate::client::{Client, Heard, hello_json};
use crate::stand_in::Behaviour;
use crate::world::{eventually, start, start_with};

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_is_welcomed_and_gets_frames_that_decode() {
    // One frame only: no second one can replace it before it is sent.
    let behaviour = Behaviour {
        rests: true,
        ..Behaviour::default()
    };
    let world = start_with(behaviour, |_| {}).await;
    let (mut client, welcome) = Client::join_as(world.address(), hello_json()).await;
    assert_eq!(welcome.adapter, "stand-in");
    assert_eq!(
        (
            welcome.protocol,
            welcome.max_width,
            welcome.max_height,
            welcome.frame_header_bytes
        ),
        (1, 3840, 2160, 96)
    );
    let (header, payload) = client.frame().await;
    assert_eq!(
        (header.sequence, header.viewer),
        (FrameSequence(1), welcome.viewer)
    );
    assert_eq!((header.codec, header.coarse), (FrameCodec::Png, true));
    assert_eq!((header.key, header.exact), (true, false));
    assert_eq!((header.width, header.height), (64, 32));
    let picture = image::load_from_memory(&payload).expect("a PNG");
    assert_eq!((picture.width(), picture.height()), (64, 32));
    let now_us = skycell_server::clock::unix_now_us();
    assert!(header.sent_unix_us() <= now_us + 1000, "sent in the future");
    assert!(now_us - header.sent_unix_us() < 5_000_000);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_change_of_wishes_shows_in_the_next_frames() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    client
        .say(&json!({"type": "view", "width": 48, "height": 16, "codec": "jpeg", "jpeg_quality": 50}))
        .await;
    client
        .frame_with(|header| {
            header.width == 48 && header.height == 16 && header.codec == FrameCodec::Jpeg
        })
        .await;
    // What is not named stays.
    client.say(&json!({"type": "view", "height": 8})).await;
    client
        .frame_with(|header| (header.width, header.height) == (48, 8))
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_two_eyes_are_twice_as_wide_and_say_so() {
    let world = start().await;
    let mut hello = hello_json();
    hello["stereo"] = json!({"eye_distance_m": 0.064});
    let (mut client, _) = Client::join_as(world.address(), hello).await;
    let (header, payload) = client.frame().await;
    assert!(header.stereo && (header.width, header.height) == (128, 32));
    let picture = image::load_from_memory(&payload).expect("a PNG");
    assert_eq!((picture.width(), picture.height()), (128, 32));
    let viewers = world.get_json("/api/v1/viewers").await;
    assert_eq!(
        (&viewers[0]["width"], &viewers[0]["stereo"]),
        (&json!(64), &json!({"eye_distance_m": 0.064}))
    );
    // Too wide for two eyes: refused as a whole, with both eyes open.
    client
        .say(&json!({"type": "view", "width": 2000, "height": 16}))
        .await;
    let error = client.error().await;
    assert_eq!(error["pointer"], "/width");
    client
        .frame_with(|header| header.stereo && header.height == 32)
        .await;
    client.say(&json!({"type": "view", "stereo": null})).await;
    client
        .frame_with(|header| !header.stereo && header.width == 64)
        .await;
    client
        .say(&json!({"type": "view", "stereo": {"eye_distance_m": 2}, "width": 48}))
        .await;
    client
        .frame_with(|header| header.stereo && header.width == 96)
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_tell_the_last_camera_that_they_show_and_a_flood_of_cameras_is_thinned() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    let mut camera = hello_json()["camera"].clone();
    for input in 1..=5000 {
        camera["yaw_deg"] = json!(f64::from(input) * 0.01);
        client
            .say(&json!({"type": "camera", "input": input, "camera": camera}))
            .await;
    }
    client
        .frame_with(|header| header.input == InputSequence(5000))
        .await;
    let heard = world.renderer.witness.cameras_heard.load(Ordering::SeqCst);
    assert!(heard < 2500, "{heard} of 5000 cameras reached the renderer");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_at_rest_gets_a_heartbeat_and_a_status_each_second_and_no_frames() {
    let behaviour = Behaviour {
        rests: true,
        ..Behaviour::default()
    };
    let world = start_with(behaviour, |_| {}).await;
    let mut client = Client::join(world.address()).await;
    let (first, _) = client.frame().await;
    let started = Instant::now();
    let (mut heartbeats, mut statuses) = (0, 0);
    while started.elapsed() < Duration::from_millis(3300) {
        match client.hear().await {
            Heard::Frame(header, payload) => {
                assert!(header.heartbeat && payload.is_empty());
                assert_eq!(header.codec, FrameCodec::None);
                assert_eq!(header.sequence, first.sequence);
                heartbeats += 1;
            }
            Heard::Message(ServerMessage::Status(status)) => {
                assert_eq!(status.cell_name, "everywhere");
                assert_eq!((status.viewers_in_cell, status.sky_converged), (1, true));
                assert_eq!(status.scene_revision, 1);
                statuses += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    assert!((2..=4).contains(&heartbeats), "{heartbeats} heartbeats");
    assert!((2..=4).contains(&statuses), "{statuses} statuses");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_that_acknowledges_nothing_gets_two_frames() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    let started = Instant::now();
    let mut frames = 0;
    while started.elapsed() < Duration::from_millis(1500) {
        if let Heard::Frame(header, _) = client.hear().await {
            frames += u32::from(!header.heartbeat);
        }
    }
    assert_eq!(frames, 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_that_stops_reading_costs_one_frame_slows_nobody_and_is_dropped() {
    // The stand-in goes on delivering without acknowledgements, so that only the edge's own
    // bounds hold.
    let behaviour = Behaviour {
        ignores_window: true,
        ..Behaviour::default()
    };
    let world = start_with(behaviour, |config| config.viewer_stall_s = 3.0).await;
    let mut hello = hello_json();
    // A frame of noise as PNG: 1 MB.
    (hello["width"], hello["height"]) = (json!(512), json!(512));
    let (deaf, welcome) = Client::join_as(world.address(), hello).await;
    let mut neighbour = Client::join(world.address()).await;

    let sent = async || {
        let reports = world.get_json("/api/v1/viewers").await;
        let report = reports
            .as_array()
            .and_then(|list| {
                list.iter()
                    .find(|report| report["id"] == json!(welcome.viewer))
            })
            .cloned();
        report.map(|report| {
            (
                report["frames_sent"].as_u64().expect("a count"),
                report["frames_dropped"].as_u64().expect("a count"),
            )
        })
    };
    // Time for the kernel's buffers to fill.
    let until = Instant::now() + Duration::from_millis(1200);
    while Instant::now() < until {
        neighbour.frame().await;
    }
    let full = sent().await.expect("still connected");
    let memory_before = resident_bytes();
    let until = Instant::now() + Duration::from_millis(1200);
    let mut frames = 0;
    while Instant::now() < until {
        neighbour.frame().await;
        frames += 1;
    }
    let later = sent().await.expect("still connected");
    assert!(
        later.0 <= full.0 + 1,
        "{full:?} {later:?}: frames were sent to a full socket"
    );
    assert!(
        later.1 >= full.1 + 5,
        "{full:?} {later:?}: nothing was dropped"
    );
    assert!(frames >= 15, "the neighbour got {frames} frames in 1.2 s");
    // One in an encoder and one that waits, for each of two viewers.
    let alive = world
        .renderer
        .witness
        .pixels_alive_most
        .load(Ordering::SeqCst);
    assert!(alive <= 4, "{alive} frames of pixels were alive at once");
    if let (Some(before), Some(after)) = (memory_before, resident_bytes()) {
        let grown = after.saturating_sub(before);
        // Other tests run in this process, so this only catches a queue: 1 MB a frame.
        assert!(grown < 200 << 20, "memory grew by {grown} bytes");
    }

    // The neighbour is served until the deaf one is dropped, and after.
    let started = Instant::now();
    while sent().await.is_some() {
        neighbour.frame().await;
        assert!(started.elapsed() < Duration::from_secs(8), "never dropped");
    }
    neighbour.frame().await;
    let left = || {
        world
            .renderer
            .witness
            .left
            .lock()
            .expect("not poisoned")
            .clone()
    };
    eventually("the renderer hears that it left", || {
        left() == [welcome.viewer]
    })
    .await;
    drop(deaf);
}

/// Memory of this process, where the system tells.
fn resident_bytes() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = text.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * 4096)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_renderer_hears_of_viewers_that_leave_in_order_or_are_cut_off() {
    let world = start().await;
    let (mut polite, first) = Client::join_as(world.address(), hello_json()).await;
    let (cut, second) = Client::join_as(world.address(), hello_json()).await;
    polite.socket.close(None).await.expect("closes");
    drop(cut);
    eventually("both have left", || {
        let left = world.renderer.witness.left.lock().expect("not poisoned");
        left.contains(&first.viewer) && left.contains(&second.viewer)
    })
    .await;
    eventually("all pixels are given back", || {
        world.renderer.witness.pixels_alive.load(Ordering::SeqCst) == 0
    })
    .await;
    assert_eq!(world.get_json("/api/v1/viewers").await, json!([]));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_whose_frames_cannot_be_encoded_is_told() {
    let behaviour = Behaviour {
        breaks_frames: true,
        ..Behaviour::default()
    };
    let world = start_with(behaviour, |_| {}).await;
    let mut client = Client::join(world.address()).await;
    assert_eq!(client.end().await, (1011, Some("internal".to_owned())));
    assert_eq!(world.get("/livez").await.status(), 200);
}
