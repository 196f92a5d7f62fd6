//! The connection against a server of the protocol, well-behaved and not.

mod support;

use std::time::Duration;

use skycell_client::{Connection, ConnectionError, ConnectionLimits, Event, Frame, ServerAddress};
use skycell_protocol::frame::{FRAME_HEADER_BYTES, FrameHeader};
use skycell_protocol::message::{Acknowledgement, ClientMessage, Hello};
use skycell_protocol::{Camera, FrameSize, InputSequence};
use support::{Behaviour, FakeServer, too_many_viewers};

fn hello() -> Hello {
    Hello::new(
        FrameSize::new(32, 18).expect("in range"),
        30.0,
        Camera::default(),
    )
}

fn hasty() -> ConnectionLimits {
    ConnectionLimits {
        connect_timeout: Duration::from_millis(300),
        silence_timeout: Duration::from_millis(300),
        ..ConnectionLimits::default()
    }
}

async fn next_frame(connection: &mut Connection) -> Frame {
    match connection.next_event().await.expect("an event") {
        Event::Frame(frame) => frame,
        other => panic!("not a frame: {other:?}"),
    }
}

#[tokio::test]
async fn a_session_says_hello_moves_its_camera_and_acknowledges() {
    let server = FakeServer::start(Behaviour::default()).await;
    let mut connection = Connection::open(&server.address, hello(), ConnectionLimits::default())
        .await
        .expect("a session");
    assert_eq!(connection.welcome().server, "fake");
    assert_eq!(
        next_frame(&mut connection).await.header.input,
        InputSequence(0)
    );

    let east = Camera::new([0.0, 2.0, 0.0], 90.0, 12.0, 60.0).expect("in range");
    let input = connection.send_camera(east).await.expect("sent");
    let frame = next_frame(&mut connection).await;
    assert_eq!(
        (input, frame.header.input),
        (InputSequence(1), InputSequence(1))
    );
    assert_eq!(frame.payload().len(), frame.header.payload_bytes as usize);
    assert!(frame.age() >= Duration::from_millis(1));
    connection
        .acknowledge(Acknowledgement {
            decode_us: Some(5),
            received_us: Some(6),
            present_us: Some(7),
            motion_to_photon_us: Some(8),
            ..Acknowledgement::of(frame.header.sequence)
        })
        .await
        .expect("sent");
    connection.close().await;
    assert_eq!(server.acknowledged(), [2]);
    assert!(matches!(server.messages()[0], ClientMessage::Hello(_)));
}

#[tokio::test]
async fn a_refusal_is_told_in_the_servers_words() {
    let server = FakeServer::start(Behaviour {
        refuse: Some(too_many_viewers()),
        ..Behaviour::default()
    })
    .await;
    let error = Connection::open(&server.address, hello(), ConnectionLimits::default())
        .await
        .expect_err("refused");
    assert_eq!(
        error.to_string(),
        "the server refused: 16 viewers are connected; allowed: 16"
    );
}

#[tokio::test]
async fn a_server_that_says_nothing_is_not_waited_for_without_end() {
    let server = FakeServer::start(Behaviour {
        mute: true,
        ..Behaviour::default()
    })
    .await;
    let error = Connection::open(&server.address, hello(), hasty())
        .await
        .expect_err("mute");
    assert!(matches!(error, ConnectionError::Timeout { .. }), "{error}");

    let server = FakeServer::start(Behaviour::default()).await;
    let mut connection = Connection::open(&server.address, hello(), hasty())
        .await
        .expect("a session");
    next_frame(&mut connection).await;
    // The fake sends no heartbeats.
    let error = connection.next_event().await.expect_err("silence");
    assert!(error.to_string().contains("a sign of life"), "{error}");
}

#[tokio::test]
async fn what_is_no_frame_or_too_large_ends_the_session_with_a_reason() {
    let mut lying = FrameHeader::decode(&{
        let mut bytes = [0; FRAME_HEADER_BYTES];
        bytes[..5].copy_from_slice(b"SKYF\x02");
        bytes
    })
    .expect("a header");
    lying.payload_bytes = 7;
    for (garbage, part) in [
        (b"SKYF".to_vec(), "too few"),
        (vec![0; FRAME_HEADER_BYTES], "not a frame"),
        (lying.encode().to_vec(), "announces 7"),
        (vec![0; 5_000], "too long"),
    ] {
        let server = FakeServer::start(Behaviour {
            garbage: Some(garbage),
            ..Behaviour::default()
        })
        .await;
        let limits = ConnectionLimits {
            message_max_bytes: 4_096,
            ..ConnectionLimits::default()
        };
        let mut connection = Connection::open(&server.address, hello(), limits)
            .await
            .expect("a session");
        let error = connection.next_event().await.expect_err("garbage");
        assert!(error.to_string().contains(part), "{part}: {error}");
    }
}

#[tokio::test]
async fn nobody_there_is_told_with_the_address() {
    let nobody: ServerAddress = "ws://127.0.0.1:1/ws".parse().expect("an address");
    let error = Connection::open(&nobody, hello(), ConnectionLimits::default())
        .await
        .expect_err("nobody");
    assert!(
        error
            .to_string()
            .contains("no connection to ws://127.0.0.1:1/ws"),
        "{error}"
    );
}
