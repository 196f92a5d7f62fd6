//! How much one peer, and all viewers together, may ask for; and that every refusal is counted.

use std::time::Duration;

use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use skycell_server::access::Role;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Error;

use crate::client::{Client, handshake, hello_json};
use crate::stand_in::Behaviour;
use crate::tokens::{by_hand, token_of, with_tokens};
use crate::world::{World, start, start_with};

/// How often that reason was counted.
async fn refusals(world: &World, reason: &str) -> u64 {
    refusals_in(&metrics(world).await, reason)
}

async fn metrics(world: &World) -> String {
    world
        .request(Method::GET, "/metrics")
        .bearer_auth(token_of(Role::Admin))
        .send()
        .await
        .expect("an answer")
        .text()
        .await
        .expect("text")
}

fn refusals_in(page: &str, reason: &str) -> u64 {
    let start = format!("skycell_refusals_total{{reason=\"{reason}\"}} ");
    let line = page.lines().find_map(|line| line.strip_prefix(&start));
    line.and_then(|count| count.parse().ok())
        .unwrap_or_else(|| panic!("no {reason} in\n{page}"))
}

fn sized(width: u32, height: u32) -> Value {
    let mut hello = hello_json();
    (hello["width"], hello["height"]) = (json!(width), json!(height));
    // Few frames: only their size matters here.
    hello["fps"] = json!(1);
    hello["codec"] = json!("jpeg");
    hello
}

#[tokio::test(flavor = "multi_thread")]
async fn too_many_requests_get_429_with_a_time_to_wait() {
    let world = start_with(Behaviour::default(), |config| {
        config.limits.requests_per_s = Some(1);
        config.limits.requests_burst = Some(5);
    })
    .await;
    let mut refused = 0;
    for _ in 0..20 {
        let response = world.get("/livez").await;
        if response.status() == StatusCode::TOO_MANY_REQUESTS {
            assert_eq!(response.headers()["retry-after"], "1");
            let problem: Value = response.json().await.expect("a problem");
            assert_eq!(problem["status"], 429);
            refused += 1;
        } else {
            assert_eq!(response.status(), StatusCode::OK);
        }
    }
    // Five at once, and one for each second that the loop took.
    assert!((5..=15).contains(&refused), "{refused}");
}

#[tokio::test(flavor = "multi_thread")]
async fn too_many_websockets_of_a_peer_are_refused_at_the_handshake() {
    let world = start_with(Behaviour::default(), |config| {
        config.limits.upgrades_per_min = Some(2);
    })
    .await;
    let mut first = Client::join(world.address()).await;
    let _second = Client::join(world.address()).await;
    match connect_async(handshake(world.address(), Some("skycell.v1"))).await {
        Err(Error::Http(response)) => {
            assert_eq!(response.status(), 429);
            let wait_s: u64 = response.headers()["retry-after"]
                .to_str()
                .expect("text")
                .parse()
                .expect("seconds");
            assert!((1..=60).contains(&wait_s), "{wait_s}");
        }
        other => panic!("not refused: {:?}", other.map(|_| ())),
    }
    first.frame().await;
    assert_eq!(refusals(&world, "upgrades").await, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn too_many_wrong_tokens_block_the_peer_right_ones_included() {
    let world = start_with(Behaviour::default(), |config| {
        with_tokens(config);
        config.limits.failed_tokens_per_min = Some(3);
    })
    .await;
    let ask = async |token: String| {
        let request = world.request(Method::GET, "/api/v1/scene");
        request.bearer_auth(token).send().await.expect("an answer")
    };
    assert_eq!(ask(token_of(Role::View)).await.status(), 200);
    for _ in 0..3 {
        assert_eq!(ask("sky_wrong".to_owned()).await.status(), 401);
    }
    for token in ["sky_wrong".to_owned(), token_of(Role::Admin)] {
        let response = ask(token).await;
        assert_eq!(response.status(), 429);
        assert!(response.headers().contains_key("retry-after"));
    }
    let mut client = Client::connect(world.address()).await;
    let mut hello = hello_json();
    hello["token"] = json!(token_of(Role::View));
    client.say(&hello).await;
    assert_eq!(client.end().await, (4429, Some("rate-limited".to_owned())));
    // Who needs no token is not concerned.
    assert_eq!(world.get("/livez").await.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_peer_has_no_more_connections_and_viewers_than_it_may() {
    let world = start_with(Behaviour::default(), |config| {
        config.limits.connections_per_peer_max = Some(2);
        config.limits.viewers_per_peer_max = Some(1);
    })
    .await;
    // A WebSocket is no connection that speaks HTTP any more.
    let mut viewer = Client::join(world.address()).await;
    let mut second = Client::connect(world.address()).await;
    second.say(&hello_json()).await;
    assert_eq!(
        second.end().await,
        (1013, Some("too-many-viewers".to_owned()))
    );
    drop(second);
    // One connection is kept by the tests' HTTP client, and what it asks for later goes over that one.
    world.get("/livez").await.text().await.expect("text");
    let _idle = TcpStream::connect(world.address()).await.expect("connects");
    // The third is answered, so that it knows why, and closed.
    let request = format!("GET /livez HTTP/1.1\r\nHost: {}\r\n\r\n", world.address());
    let answer = by_hand(&world, &request).await;
    assert!(answer.starts_with("HTTP/1.1 429 "), "{answer}");
    viewer.frame().await;
    // Asked once: a second time might be a connection too many itself.
    let page = metrics(&world).await;
    assert_eq!(refusals_in(&page, "viewers-of-peer"), 1);
    assert_eq!(refusals_in(&page, "connections-of-peer"), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn all_frames_together_have_no_more_pixels_than_they_may() {
    let world = start_with(Behaviour::default(), |config| {
        config.limits.megapixels_max = Some(1);
    })
    .await;
    let (mut first, _) = Client::join_as(world.address(), sized(1000, 800)).await;
    let mut second = Client::connect(world.address()).await;
    second.say(&sized(640, 480)).await;
    assert_eq!(
        second.end().await,
        (1013, Some("too-many-pixels".to_owned()))
    );
    // Who wants more than there is keeps what it has.
    first
        .say(&json!({"type": "view", "width": 1001, "height": 1000}))
        .await;
    let error = first.error().await;
    assert_eq!(error["code"], "too-many-pixels", "{error}");
    let (header, _) = first.frame().await;
    assert_eq!((header.width, header.height), (1000, 800));
    // Two eyes are two pictures.
    first
        .say(&json!({"type": "view", "stereo": {"eye_distance_m": 0.064}}))
        .await;
    assert_eq!(first.error().await["code"], "too-many-pixels");
    // What one gives back another may have.
    first
        .say(&json!({"type": "view", "width": 500, "height": 400}))
        .await;
    first.frame_with(|header| header.width == 500).await;
    let (mut third, _) = Client::join_as(world.address(), sized(1000, 800)).await;
    third.frame().await;
    assert_eq!(refusals(&world, "pixels").await, 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_head_that_is_too_large_is_refused() {
    let world = start().await;
    let host = format!("Host: {}\r\n", world.address());
    let long = format!("X-Long: {}\r\n", "x".repeat(40_000));
    let many: String = (0..100)
        .map(|number| format!("X-{number}: 1\r\n"))
        .collect();
    for headers in [long, many] {
        let request = format!("GET /livez HTTP/1.1\r\n{host}{headers}\r\n");
        let answer = by_hand(&world, &request).await;
        assert!(answer.starts_with("HTTP/1.1 431 "), "{answer:?}");
    }
    // The answer is there before its connection's end is looked at.
    let mut tries = 0..100;
    while refusals(&world, "head-too-large").await < 2 && tries.next().is_some() {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert_eq!(refusals(&world, "head-too-large").await, 2);
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_refusal_is_counted_under_its_reason() {
    let world = start_with(Behaviour::default(), with_tokens).await;
    let ask = async |path: &str, token: Option<String>| {
        let mut request = world.request(Method::GET, path);
        if let Some(token) = token {
            request = request.bearer_auth(token);
        }
        request.send().await.expect("an answer").status().as_u16()
    };
    assert_eq!(ask("/api/v1/scene", None).await, 401);
    assert_eq!(ask("/api/v1/scene", Some("sky_wrong".into())).await, 401);
    assert_eq!(ask("/api/v1/stats", Some(token_of(Role::View))).await, 403);
    assert_eq!(ask("/livez?token=x", None).await, 400);
    let evil = "GET /livez HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n";
    assert!(by_hand(&world, evil).await.contains("421"));
    let mut client = Client::connect(world.address()).await;
    client.say(&hello_json()).await;
    assert_eq!(client.end().await.0, 4401);
    for (reason, count) in [
        ("no-token", 2),
        ("wrong-token", 1),
        ("role", 1),
        ("token-in-url", 1),
        ("host", 1),
        ("requests", 0),
    ] {
        assert_eq!(refusals(&world, reason).await, count, "{reason}");
    }
}

/// Reads one answer of a connection that stays open: its head, and its body of the announced length.
async fn answer(socket: &mut BufReader<TcpStream>) -> String {
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        let read = socket.read_line(&mut head).await.expect("a line");
        assert_ne!(read, 0, "the connection ended after: {head:?}");
    }
    let length = head
        .lines()
        .find_map(|line| line.strip_prefix("content-length: "))
        .expect("a length");
    let mut body = vec![0; length.parse().expect("a number")];
    socket.read_exact(&mut body).await.expect("a body");
    head
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_body_that_was_refused_unread_the_next_request_is_answered_or_the_end_is_told() {
    let world = start_with(Behaviour::default(), with_tokens).await;
    let host = world.address();
    let token = token_of(Role::Admin);
    // Refused for its length, and for the token that is lacking.
    for (authorization, length, status) in [
        (format!("Authorization: Bearer {token}\r\n"), 70_000, "413"),
        (String::new(), 60_000, "401"),
    ] {
        let socket = TcpStream::connect(host).await.expect("connects");
        let mut socket = BufReader::new(socket);
        let head = format!(
            "PATCH /api/v1/scene HTTP/1.1\r\nHost: {host}\r\n{authorization}If-Match: *\r\n\
             Content-Type: application/merge-patch+json\r\nContent-Length: {length}\r\n\r\n"
        );
        socket.write_all(head.as_bytes()).await.expect("sent");
        // The body comes when the refusal is known already.
        for _ in 0..10 {
            tokio::time::sleep(Duration::from_millis(20)).await;
            let part = vec![b' '; length / 10];
            socket.write_all(&part).await.expect("sent");
        }
        let refused = answer(&mut socket).await;
        assert!(
            refused.starts_with(&format!("HTTP/1.1 {status} ")),
            "{refused}"
        );
        assert!(!refused.contains("connection: close"), "{refused}");
        let next = format!("GET /livez HTTP/1.1\r\nHost: {host}\r\n\r\n");
        socket.write_all(next.as_bytes()).await.expect("sent");
        let next = answer(&mut socket).await;
        assert!(next.starts_with("HTTP/1.1 200 "), "{next}");
    }
    // More than is read for nothing.
    let head = format!(
        "PATCH /api/v1/scene HTTP/1.1\r\nHost: {host}\r\nContent-Length: 100000000\r\n\r\n"
    );
    let refused = by_hand(&world, &head).await;
    assert!(refused.starts_with("HTTP/1.1 401 "), "{refused}");
    assert!(refused.contains("connection: close"), "{refused}");
}
