//! Bad input of each kind: each gets its clear error, and the service goes on.

use std::time::Duration;

use serde_json::{Value, json};
use skycell_protocol::INBOUND_MESSAGE_MAX_BYTES;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::protocol::frame::Frame;
use tokio_tungstenite::tungstenite::protocol::frame::coding::{Data, OpCode};
use tokio_tungstenite::tungstenite::{Error, Message};

use crate::client::{Client, handshake, hello_json};
use crate::stand_in::Behaviour;
use crate::world::{World, start, start_with};

#[tokio::test(flavor = "multi_thread")]
async fn a_bad_message_gets_its_error_and_the_session_goes_on() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    let camera = hello_json()["camera"].to_string();
    for (text, code, pointer, part) in [
        ("{\"type\":", "bad-json", None, "EOF"),
        (
            "{\"type\":\"camera\",\"input\":1,\"camera\":{\"yaw_deg\":NaN}}",
            "bad-json",
            None,
            "column 48",
        ),
        ("\u{0}", "bad-json", None, "not JSON"),
        (
            "{\"type\":\"camra\"}",
            "unknown-type",
            Some("/type"),
            "did you mean \"camera\"",
        ),
        (
            "{\"type\":\"camera\",\"input\":1,\"camera\":{\"yaw_deg\":0}}",
            "bad-value",
            Some("/camera/position_m"),
            "missing",
        ),
        (
            "{\"type\":\"view\",\"width\":0,\"height\":0}",
            "bad-value",
            Some("/width"),
            "1 to 3840",
        ),
        (
            "{\"type\":\"view\",\"width\":100000,\"height\":100000}",
            "bad-value",
            Some("/width"),
            "1 to 3840",
        ),
        (
            "{\"type\":\"view\",\"width\":1921,\"stereo\":{\"eye_distance_m\":0.064}}",
            "bad-value",
            Some("/width"),
            "1 to 1920 for each of two eyes",
        ),
        (
            "{\"type\":\"view\",\"stereo\":{\"eye_distance_m\":1e9}}",
            "bad-value",
            Some("/stereo/eye_distance_m"),
            "0 to 100",
        ),
        (
            "{\"type\":\"view\",\"stereo\":0.064}",
            "bad-value",
            Some("/stereo"),
            "an object with eye_distance_m",
        ),
        (
            "{\"type\":\"view\",\"hight\":3}",
            "bad-value",
            Some("/hight"),
            "did you mean \"height\"",
        ),
        (
            "{\"type\":\"ack\",\"sequence\":4000000}",
            "bad-value",
            Some("/sequence"),
            "last frame sent",
        ),
    ] {
        client.say_text(text).await;
        let error = client.error().await;
        assert_eq!(error["code"], code, "{text}: {error}");
        assert_eq!(
            error.get("pointer").and_then(Value::as_str),
            pointer,
            "{text}: {error}"
        );
        assert!(
            error["message"].as_str().is_some_and(|m| m.contains(part)),
            "{text}: {error}"
        );
    }
    // Still a viewer, and a good message is still understood.
    client
        .say_text(&format!(
            "{{\"type\":\"camera\",\"input\":77,\"camera\":{camera}}}"
        ))
        .await;
    client.frame_with(|header| header.input.0 == 77).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hello_with_a_bad_value_may_be_said_again() {
    let world = start().await;
    let mut client = Client::connect(world.address()).await;
    for (width, height) in [(0, 0), (100_000, 100_000)] {
        let mut hello = hello_json();
        (hello["width"], hello["height"]) = (json!(width), json!(height));
        client.say(&hello).await;
        let error = client.error().await;
        assert_eq!(
            (&error["code"], &error["pointer"]),
            (&json!("bad-value"), &json!("/width"))
        );
    }
    client.say(&hello_json()).await;
    client.frame().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_breaks_the_protocol_is_told_and_closed() {
    let world = start().await;
    let address = world.address();
    let ends_with = async |mut client: Client, message: Message, code: u16, error: &str| {
        client.send(message).await.expect("sent");
        assert_eq!(client.end().await, (code, Some(error.to_owned())));
    };
    let too_large = || Message::text(" ".repeat(INBOUND_MESSAGE_MAX_BYTES + 1));
    let mut old = hello_json();
    old["protocol"] = json!(0);

    let fresh = async || Client::connect(address).await;
    ends_with(
        fresh().await,
        Message::text("{\"type\":\"ack\",\"sequence\":1}"),
        1002,
        "hello-expected",
    )
    .await;
    ends_with(
        fresh().await,
        Message::text(old.to_string()),
        1002,
        "wrong-protocol",
    )
    .await;
    ends_with(
        fresh().await,
        Message::binary(vec![1, 2, 3]),
        1008,
        "wrong-protocol",
    )
    .await;
    ends_with(fresh().await, too_large(), 1009, "too-large").await;

    let joined = async || Client::join(address).await;
    ends_with(
        joined().await,
        Message::text(hello_json().to_string()),
        1002,
        "hello-expected",
    )
    .await;
    ends_with(
        joined().await,
        Message::binary(vec![1, 2, 3]),
        1008,
        "wrong-protocol",
    )
    .await;
    ends_with(joined().await, too_large(), 1009, "too-large").await;
    world.goes_on().await;
}

/// A socket that is closed with something unread is reset, and whoever then answers the ping that came first never gets to
/// the reason.
#[tokio::test(flavor = "multi_thread")]
async fn why_a_message_was_refused_is_heard_by_who_listens_late() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    let too_large = Message::text(" ".repeat(4 * INBOUND_MESSAGE_MAX_BYTES));
    client.send(too_large).await.expect("sent");
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(client.end().await, (1009, Some("too-large".to_owned())));
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_in_pieces_that_grow_too_large_is_refused() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    let piece = vec![b' '; INBOUND_MESSAGE_MAX_BYTES / 2 + 1];
    for opcode in [Data::Text, Data::Continue] {
        let frame = Frame::message(piece.clone(), OpCode::Data(opcode), false);
        client.send(Message::Frame(frame)).await.expect("sent");
    }
    assert_eq!(client.end().await, (1009, Some("too-large".to_owned())));
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_says_no_hello_is_closed_after_five_seconds() {
    let world = start().await;
    let mut client = Client::connect(world.address()).await;
    assert_eq!(
        client.end().await,
        (1008, Some("hello-expected".to_owned()))
    );
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_that_is_cut_in_the_middle_of_a_message_harms_nobody() {
    let world = start().await;
    let mut socket = upgraded_by_hand(&world).await;
    // A masked text frame of 100 bytes, of which 10 come.
    socket
        .write_all(&[0x81, 0x80 | 100, 1, 2, 3, 4])
        .await
        .expect("sent");
    socket.write_all(&[7; 10]).await.expect("sent");
    drop(socket);
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bytes_that_are_no_websocket_frame_are_refused() {
    let world = start().await;
    let mut socket = upgraded_by_hand(&world).await;
    // Reserved bits set, an opcode that does not exist, no mask.
    socket
        .write_all(&[0xff, 0x03, 1, 2, 3])
        .await
        .expect("sent");
    let mut answer = Vec::new();
    let _ = socket.read_to_end(&mut answer).await;
    let text = String::from_utf8_lossy(&answer);
    assert!(text.contains("wrong-protocol"), "{text}");
    world.goes_on().await;
}

/// A WebSocket whose frames the test writes itself.
async fn upgraded_by_hand(world: &World) -> TcpStream {
    let mut socket = TcpStream::connect(world.address()).await.expect("connects");
    let request = format!(
        "GET /ws HTTP/1.1\r\nHost: {}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: skycell.v1\r\n\r\n",
        world.address()
    );
    socket.write_all(request.as_bytes()).await.expect("sent");
    let mut answer = Vec::new();
    while !answer.ends_with(b"\r\n\r\n") {
        answer.push(socket.read_u8().await.expect("an answer"));
    }
    assert!(answer.starts_with(b"HTTP/1.1 101"));
    socket
}

#[tokio::test(flavor = "multi_thread")]
async fn a_handshake_without_the_subprotocol_is_refused_with_a_problem() {
    let world = start().await;
    for (asked, part) in [
        (None, "asked for: none"),
        (Some("skycell.v2, chat"), "skycell.v2"),
    ] {
        let problem = refused_handshake(handshake(world.address(), asked)).await;
        assert_eq!(problem["status"], 400);
        let detail = problem["detail"].as_str().expect("a detail");
        assert!(
            detail.contains("skycell.v1") && detail.contains(part),
            "{detail}"
        );
    }
    // No WebSocket at all.
    let response = world.get("/ws").await;
    assert!(response.status().is_client_error());
    assert_eq!(
        response.headers()["content-type"],
        "application/problem+json"
    );
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_page_of_another_site_may_not_connect() {
    let world = start().await;
    let mut request = handshake(world.address(), Some("skycell.v1"));
    let origin = "http://evil.example".parse().expect("a header value");
    request.headers_mut().insert("origin", origin);
    assert_eq!(refused_handshake(request).await["status"], 403);
    world.goes_on().await;
}

async fn refused_handshake(
    request: tokio_tungstenite::tungstenite::handshake::client::Request,
) -> Value {
    match connect_async(request).await {
        Err(Error::Http(response)) => {
            assert_eq!(
                response.headers()["content-type"],
                "application/problem+json"
            );
            let body = response.into_body().expect("a body");
            serde_json::from_slice(&body).expect("JSON")
        }
        Err(other) => panic!("another error: {other}"),
        Ok(_) => panic!("was accepted"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_viewer_too_many_is_told_to_come_later() {
    let world = start_with(Behaviour::default(), |config| config.viewers_max = 1).await;
    let first = Client::join(world.address()).await;
    let mut second = Client::connect(world.address()).await;
    second.say(&hello_json()).await;
    assert_eq!(
        second.end().await,
        (1013, Some("too-many-viewers".to_owned()))
    );
    drop(first);
    crate::world::eventually("there is room again", || {
        !world
            .renderer
            .witness
            .left
            .lock()
            .expect("not poisoned")
            .is_empty()
    })
    .await;
    world.goes_on().await;
}
