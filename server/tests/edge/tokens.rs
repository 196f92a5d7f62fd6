//! Tokens and roles, names and origins.

use axum::http::header::WWW_AUTHENTICATE;
use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use skycell_server::access::{Role, TokenDigest, TokenEntry};
use skycell_server::config::{Config, ConfiguredTokens};
use skycell_server::service::{ServiceError, ServiceParts};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Error;

use crate::client::{Client, handshake, hello_json};
use crate::stand_in::Behaviour;
use crate::world::{World, start, start_with};

/// The token of a role in these tests.
pub(crate) fn token_of(role: Role) -> String {
    format!("sky_token-of-{role}")
}

pub(crate) fn entry(role: Role) -> TokenEntry {
    TokenEntry {
        role,
        name: role.name().to_owned(),
        digest: TokenDigest::of(&token_of(role)),
    }
}

/// One token of each role.
pub(crate) fn with_tokens(config: &mut Config) {
    config.tokens = ConfiguredTokens(Role::NAMES.map(|(_, role)| entry(role)).to_vec());
}

async fn world_with_tokens() -> World {
    start_with(Behaviour::default(), with_tokens).await
}

#[tokio::test(flavor = "multi_thread")]
async fn each_route_asks_for_its_role_and_says_which() {
    let world = world_with_tokens().await;
    let get = Method::GET;
    let (view, steer, admin) = (Some(Role::View), Some(Role::Steer), Some(Role::Admin));
    for (method, path, needed) in [
        (&get, "/", None),
        (&get, "/main.js", None),
        (&get, "/livez", None),
        (&get, "/readyz", None),
        (&get, "/api/v1/scene", view),
        (&get, "/api/v1/scene/time", view),
        (&get, "/api/v1/scene/now", view),
        (&get, "/api/v1/presets", view),
        (&get, "/api/v1/views", view),
        (&Method::PATCH, "/api/v1/scene", steer),
        (&Method::PUT, "/api/v1/scene/time", steer),
        (&Method::POST, "/api/v1/scene/preset", steer),
        (&Method::DELETE, "/api/v1/scene/maps/type", steer),
        (&get, "/api/v1/cells", admin),
        (&get, "/api/v1/viewers", admin),
        (&get, "/api/v1/stats", admin),
        (&get, "/metrics", admin),
        (&get, "/api/v1/not-there", admin),
    ] {
        for holder in [None, view, steer, admin] {
            let mut request = world.request(method.clone(), path);
            if let Some(role) = holder {
                request = request.bearer_auth(token_of(role));
            }
            let response = request.send().await.expect("an answer");
            let status = response.status();
            let what = format!("{method} {path} as {holder:?}: {status}");
            match (needed, holder) {
                (Some(_), None) => {
                    assert_eq!(status, StatusCode::UNAUTHORIZED, "{what}");
                    assert_eq!(
                        response.headers()[WWW_AUTHENTICATE],
                        "Bearer realm=\"skycell\""
                    );
                }
                (Some(needed), Some(role)) if role < needed => {
                    assert_eq!(status, StatusCode::FORBIDDEN, "{what}");
                    let challenge = format!(
                        "Bearer realm=\"skycell\", error=\"insufficient_scope\", scope=\"{needed}\""
                    );
                    assert_eq!(response.headers()[WWW_AUTHENTICATE], challenge);
                    let problem: Value = response.json().await.expect("a problem");
                    assert_eq!(problem["role_needed"], needed.name(), "{problem}");
                }
                // What is behind the gate may still refuse: no If-Match, no such resource.
                _ => assert!(
                    ![401, 403, 429].contains(&status.as_u16()) && !status.is_server_error(),
                    "{what}"
                ),
            }
        }
    }
    let wrong = world
        .request(Method::GET, "/api/v1/scene")
        .bearer_auth("sky_wrong")
        .send()
        .await
        .expect("an answer");
    assert_eq!(wrong.status(), StatusCode::UNAUTHORIZED);
    assert_eq!(
        wrong.headers()[WWW_AUTHENTICATE],
        "Bearer realm=\"skycell\", error=\"invalid_token\""
    );
    let problem: Value = wrong.json().await.expect("a problem");
    assert!(!problem.to_string().contains("sky_wrong"), "{problem}");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_tokens_everything_is_open_on_the_loopback_interface() {
    let world = start().await;
    for path in ["/api/v1/scene", "/api/v1/viewers", "/metrics"] {
        assert_eq!(world.get(path).await.status(), StatusCode::OK, "{path}");
    }
    let (mut client, _) = Client::join_as(world.address(), with("token", "sky_any")).await;
    client.frame().await;
}

fn with(key: &str, value: &str) -> Value {
    let mut hello = hello_json();
    hello[key] = json!(value);
    hello
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hello_needs_a_known_token_and_ends_with_4401_without() {
    let world = world_with_tokens().await;
    for hello in [hello_json(), with("token", "sky_wrong")] {
        let mut client = Client::connect(world.address()).await;
        client.say(&hello).await;
        assert_eq!(client.end().await, (4401, Some("unauthorized".to_owned())));
    }
    for role in [Role::View, Role::Steer, Role::Admin] {
        let hello = with("token", &token_of(role));
        let (mut client, _) = Client::join_as(world.address(), hello).await;
        client.frame().await;
    }
    // What is no token is a bad value, is not repeated, and a better hello may follow.
    let mut client = Client::connect(world.address()).await;
    client.say(&with("token", "with spaces")).await;
    let error = client.error().await;
    assert_eq!(
        (&error["code"], &error["pointer"]),
        (&json!("bad-value"), &json!("/token"))
    );
    assert!(!error.to_string().contains("with spaces"), "{error}");
    client.say(&with("token", &token_of(Role::View))).await;
    client.frame().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_in_an_address_is_refused_even_where_none_is_needed() {
    let world = start().await;
    for path in ["/api/v1/scene?token=sky_x", "/ws?access_token=sky_x"] {
        let response = world.get(path).await;
        assert_eq!(response.status(), StatusCode::BAD_REQUEST, "{path}");
        let problem: Value = response.json().await.expect("a problem");
        let detail = problem["detail"].as_str().expect("a detail");
        assert!(
            detail.contains("Authorization") && !detail.contains("sky_x"),
            "{detail}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn beyond_the_loopback_interface_nothing_starts_without_a_token() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut config = Config::new(folder.path().to_owned());
    config.listen = ([0, 0, 0, 0], 0).into();
    let error = ServiceParts::prepare(config.clone())
        .err()
        .expect("must be refused");
    assert!(matches!(error, ServiceError::Exposed(_)), "{error}");
    assert!(error.to_string().contains("tokens_file"), "{error}");
    config.tokens = ConfiguredTokens(vec![entry(Role::View)]);
    assert!(ServiceParts::prepare(config).is_ok());
}

/// The status and body of a request that the test writes itself.
pub(crate) async fn by_hand(world: &World, request: &str) -> String {
    let mut socket = tokio::net::TcpStream::connect(world.address())
        .await
        .expect("connects");
    socket.write_all(request.as_bytes()).await.expect("sent");
    let mut answer = Vec::new();
    let reading = socket.read_to_end(&mut answer);
    let _ = tokio::time::timeout(std::time::Duration::from_secs(60), reading)
        .await
        .expect("the connection stays open");
    String::from_utf8_lossy(&answer).into_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_that_was_made_to_lead_here_is_refused() {
    let world = start_with(Behaviour::default(), |config| {
        config.allowed_hosts = vec!["sky.example".to_owned()];
    })
    .await;
    for (host, status) in [
        ("Host: evil.example:8080\r\n", "421"),
        ("Host: 127.0.0.1.evil.example\r\n", "421"),
        ("Host: 192.0.2.1\r\n", "421"),
        ("", "400"),
        ("Host: sky.example\r\n", "200"),
        ("Host: localhost:1\r\n", "200"),
        ("Host: [::1]\r\n", "200"),
    ] {
        let request = format!("GET /api/v1/scene HTTP/1.1\r\n{host}Connection: close\r\n\r\n");
        let answer = by_hand(&world, &request).await;
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status} ")),
            "{host}: {answer}"
        );
    }
    // The same for the WebSocket, with an origin that goes with the name.
    let mut request = handshake(world.address(), Some("skycell.v1"));
    let header = |text: &str| text.parse().expect("a header value");
    request.headers_mut().insert("host", header("evil.example"));
    request
        .headers_mut()
        .insert("origin", header("http://evil.example"));
    match connect_async(request).await {
        Err(Error::Http(response)) => assert_eq!(response.status(), 421),
        other => panic!("not refused: {:?}", other.map(|_| ())),
    }
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_sites_change_nothing_and_listed_ones_may() {
    let world = start_with(Behaviour::default(), |config| {
        config.allowed_origins = vec!["https://world.example".to_owned()];
    })
    .await;
    for (origin, may) in [
        ("https://world.example", true),
        ("https://evil.example", false),
    ] {
        let response = world
            .request(Method::PATCH, "/api/v1/scene")
            .header("origin", origin)
            .header("if-match", "*")
            .header("content-type", "application/merge-patch+json")
            .body("{}")
            .send()
            .await
            .expect("an answer");
        let expected = if may {
            StatusCode::OK
        } else {
            StatusCode::FORBIDDEN
        };
        assert_eq!(response.status(), expected, "{origin}");
        let readable_by = response.headers().get("access-control-allow-origin");
        assert_eq!(readable_by.is_some(), may, "{origin}: {readable_by:?}");
        let preflight = world
            .request(Method::OPTIONS, "/api/v1/scene")
            .header("origin", origin)
            .header("access-control-request-method", "PATCH")
            .header("access-control-request-headers", "authorization,if-match")
            .send()
            .await
            .expect("an answer");
        let allowed = preflight.headers().get("access-control-allow-origin");
        assert_eq!(allowed.is_some(), may, "{origin}: {allowed:?}");
    }
}
