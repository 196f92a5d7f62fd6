//! Viewers of a video: what they are given, and that they miss none of it.

use std::time::Duration;

use openh264::decoder::Decoder;
use openh264::formats::YUVSource;
use serde_json::{Value, json};
use skycell_protocol::message::ServerMessage;
use skycell_protocol::{Codec, FrameCodec, FrameHeader};

use crate::client::{Client, Heard, hello_json};
use crate::stand_in::Behaviour;
use crate::world::{start, start_with};

fn video_hello() -> Value {
    let mut hello = hello_json();
    hello["codec"] = json!("jpeg");
    hello["codecs"] = json!(["av1", "h264", "jpeg"]);
    hello
}

/// Decodes a stream and says which picture it cannot.
struct Watcher {
    decoder: Decoder,
}

impl Watcher {
    fn new() -> Self {
        Self {
            decoder: Decoder::new().expect("a decoder"),
        }
    }

    fn size_of(&mut self, header: &FrameHeader, payload: &[u8]) -> (usize, usize) {
        assert_eq!(header.codec, FrameCodec::H264);
        let picture = self.decoder.decode(payload);
        let picture = picture.unwrap_or_else(|error| panic!("frame {}: {error}", header.sequence));
        picture.expect("a picture").dimensions()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn of_the_codecs_that_a_viewer_lists_it_gets_the_first_that_there_is_and_is_told() {
    let world = start().await;
    let (mut client, welcome) = Client::join_as(world.address(), video_hello()).await;
    assert_eq!(welcome.codec, Codec::H264);
    let mut watcher = Watcher::new();
    for number in 0..10 {
        let (header, payload) = client.frame().await;
        assert_eq!(header.key, number == 0, "frame {number}");
        assert_eq!((header.width, header.height), (64, 32));
        assert_eq!(watcher.size_of(&header, &payload), (64, 32));
        assert_eq!(header.target_kbit_per_s, 500);
        assert_eq!(header.colours, None, "nobody asked");
    }
    let viewers = world.get_json("/api/v1/viewers").await;
    assert_eq!(viewers[0]["codec"], "h264");
    loop {
        match client.hear().await {
            Heard::Message(ServerMessage::Status(status)) => {
                assert_eq!(status.codec, Codec::H264);
                assert_eq!(status.target_kbit_per_s, Some(500));
                break;
            }
            Heard::Frame(header, _) if !header.heartbeat => {
                client.acknowledge(header.sequence.0).await;
            }
            Heard::Frame(..) | Heard::Message(_) => {}
            other => panic!("no status but {other:?}"),
        }
    }
    let metrics = world.get("/metrics").await.text().await.expect("text");
    assert!(metrics.contains("skycell_encode_seconds_count{codec=\"h264\"}"));
}

#[tokio::test(flavor = "multi_thread")]
async fn colours_are_spread_for_who_says_that_it_puts_them_back() {
    let world = start().await;
    let mut hello = video_hello();
    hello["scaled_colours"] = json!(true);
    let (mut client, _) = Client::join_as(world.address(), hello).await;
    for number in 0..3 {
        let (header, _) = client.frame().await;
        assert_eq!(header.codec, FrameCodec::H264);
        assert!(header.colours.is_some(), "frame {number}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn another_size_or_codec_is_another_stream_that_begins_with_a_key() {
    let world = start().await;
    let (mut client, _) = Client::join_as(world.address(), video_hello()).await;
    client.frame_with(|header| header.key).await;
    client
        .say(&json!({"type": "view", "width": 49, "height": 17}))
        .await;
    let mut watcher = Watcher::new();
    let (header, payload) = loop {
        let frame = client.frame().await;
        if frame.0.width == 49 {
            break frame;
        }
    };
    assert!(header.key, "the first of its size");
    // Sides are even in a video.
    assert_eq!(watcher.size_of(&header, &payload), (50, 18));
    client.say(&json!({"type": "view", "codec": "jpeg"})).await;
    client
        .frame_with(|header| header.codec == FrameCodec::Jpeg && header.target_kbit_per_s == 0)
        .await;
    client.say(&json!({"type": "view", "codec": "h264"})).await;
    loop {
        let (header, payload) = client.frame().await;
        if header.codec == FrameCodec::H264 {
            assert!(header.key, "the first after JPEG");
            Watcher::new().size_of(&header, &payload);
            break;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn keys_come_on_request_and_at_most_one_a_second() {
    let world = start().await;
    let (mut client, _) = Client::join_as(world.address(), video_hello()).await;
    let mut keys = Vec::new();
    for _ in 0..150 {
        client.say(&json!({"type": "key_frame"})).await;
        let (header, _) = client.frame().await;
        if header.key {
            keys.push(header);
        }
    }
    // 150 frames at 60 a second are 2.5 s and more.
    assert!(keys.len() >= 3, "{} keys", keys.len());
    for pair in keys.windows(2) {
        let apart_us = pair[1].render_unix_us - pair[0].render_unix_us;
        assert!(apart_us > 800_000, "{apart_us} us apart");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_reads_slowly_misses_pictures_but_none_of_its_video() {
    let behaviour = Behaviour {
        ignores_window: true,
        ..Behaviour::default()
    };
    // Enough to fill the socket: 50 Mbit/s of noise.
    let world = start_with(behaviour, |config| config.video_kbit_per_s = Some(50_000)).await;
    let mut hello = video_hello();
    hello["width"] = json!(640);
    hello["height"] = json!(360);
    let (mut client, _) = Client::join_as(world.address(), hello).await;
    let mut watcher = Watcher::new();
    let mut sequences = Vec::new();
    let mut keys = 0;
    while sequences.len() < 30 {
        tokio::time::sleep(Duration::from_millis(60)).await;
        match client.hear().await {
            Heard::Frame(header, payload) if !header.heartbeat => {
                watcher.size_of(&header, &payload);
                sequences.push(header.sequence.0);
                keys += u32::from(header.key);
            }
            Heard::Frame(..) | Heard::Message(_) => {}
            other => panic!("no frame but {other:?}"),
        }
    }
    assert_eq!(keys, 1, "what was never encoded needs no key");
    let made = sequences[sequences.len() - 1] - sequences[0] + 1;
    assert!(
        made > sequences.len() as u32 + 10,
        "{made} pictures and nothing left out: the test reads too fast"
    );
}
