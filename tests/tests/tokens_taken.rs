//! Tokens that are taken away, or get a smaller role, while sessions are open: read again at SIGHUP by a real server.

#![cfg(unix)]

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use futures_util::{SinkExt, StreamExt};
use reqwest::{Response, StatusCode};
use serde_json::{Value, json};
use skycell_client::Access;
use skycell_server::access::{Role, Token, TokenDigest, TokenEntry};
use skycell_tests::server::ServerOptions;
use skycell_tests::{PATIENCE, Server, until};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

/// Writes a file of tokens that only its owner can read.
fn write_tokens(path: &Path, tokens: &[(Role, &str, &Token)]) -> anyhow::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    let lines = tokens.iter().map(|(role, name, token)| {
        let entry = TokenEntry {
            role: *role,
            name: (*name).to_owned(),
            digest: TokenDigest::of(token.text()),
        };
        format!("{entry}\n")
    });
    std::fs::write(path, lines.collect::<String>())?;
    Ok(std::fs::set_permissions(
        path,
        std::fs::Permissions::from_mode(0o600),
    )?)
}

/// A viewer of a few pixels, as it is on the wire.
struct Session(WebSocketStream<MaybeTlsStream<TcpStream>>);

impl Session {
    async fn open(server: &Server, token: &Token) -> anyhow::Result<Self> {
        let mut request = format!("ws://{}/ws", server.address()).into_client_request()?;
        let protocol = "skycell.v1".parse()?;
        request
            .headers_mut()
            .insert("sec-websocket-protocol", protocol);
        let (socket, _) = connect_async(request).await?;
        let mut session = Self(socket);
        let hello = json!({
            "type": "hello", "protocol": 1, "width": 32, "height": 18, "fps": 2, "codec": "png", "token": token.text(),
            "camera": {"position_m": [0, 2, 0], "yaw_deg": 0, "pitch_deg": 15, "vertical_fov_deg": 60},
        });
        session.0.send(Message::text(hello.to_string())).await?;
        ensure!(session.said().await?["type"] == "welcome");
        Ok(session)
    }

    async fn next(&mut self) -> anyhow::Result<Message> {
        let message = tokio::time::timeout(PATIENCE, self.0.next()).await?;
        Ok(message.context("cut without a close frame")??)
    }

    /// The next thing that it is told.
    async fn said(&mut self) -> anyhow::Result<Value> {
        loop {
            match self.next().await? {
                Message::Text(text) => return Ok(serde_json::from_str(&text)?),
                Message::Close(frame) => bail!("closed: {frame:?}"),
                _ => {}
            }
        }
    }

    /// The code that it is closed with, and the last error before.
    async fn end(&mut self) -> anyhow::Result<(u16, Value)> {
        let mut error = Value::Null;
        loop {
            match self.next().await? {
                Message::Text(text) => {
                    let said: Value = serde_json::from_str(&text)?;
                    if said["type"] == "error" {
                        error = said;
                    }
                }
                Message::Close(frame) => {
                    return Ok((frame.context("a reason")?.code.into(), error));
                }
                _ => {}
            }
        }
    }
}

async fn events(server: &Server, token: &Token) -> anyhow::Result<Response> {
    let request = server.http().get(server.url("api/v1/scene/events"));
    let request = request.bearer_auth(token.text()).timeout(PATIENCE);
    let mut response = request.send().await?.error_for_status()?;
    let first = response.chunk().await?.context("an event")?;
    ensure!(String::from_utf8_lossy(&first).contains("event: scene"));
    Ok(response)
}

async fn patch(server: &Server, token: &Token, exposure_ev: f64) -> anyhow::Result<StatusCode> {
    let request = server.http().patch(server.url("api/v1/scene"));
    let request = request
        .bearer_auth(token.text())
        .header("content-type", "application/merge-patch+json")
        .header("if-match", "*")
        .body(json!({"exposure_ev": exposure_ev}).to_string());
    Ok(request.send().await?.status())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_that_is_taken_away_ends_what_it_opened_and_a_smaller_role_may_less()
-> anyhow::Result<()> {
    let new = || Token::new_random().context("random");
    let (ops, guest, artist) = (new()?, new()?, new()?);
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("tokens");
    let of_ops = (Role::Admin, "ops", &ops);
    write_tokens(
        &file,
        &[
            of_ops,
            (Role::View, "guest", &guest),
            (Role::Steer, "artist", &artist),
        ],
    )?;
    let server = Server::start_with(ServerOptions {
        top_level_toml: format!("tokens_file = {}\n", json!(file)),
        access: Access::default().with_token_text(ops.text(), "the test")?,
        ..ServerOptions::default()
    })
    .await?;
    let mut of_guest = Session::open(&server, &guest).await?;
    let mut of_artist = Session::open(&server, &artist).await?;
    let mut of_guest_events = events(&server, &guest).await?;
    let mut of_artist_events = events(&server, &artist).await?;
    ensure!(patch(&server, &artist, 0.5).await? == StatusCode::OK);
    for told in [&mut of_guest_events, &mut of_artist_events] {
        told.chunk().await?.context("an event")?;
    }

    // What cannot be read, and a file without any token, change nothing.
    for text in ["view guest", "# nobody\n"] {
        std::fs::write(&file, text)?;
        server.hang_up()?;
        tokio::time::sleep(Duration::from_millis(300)).await;
        ensure!(patch(&server, &guest, 1.0).await? == StatusCode::FORBIDDEN);
        ensure!(of_guest.said().await?["type"] == "status");
    }

    write_tokens(&file, &[of_ops, (Role::View, "artist", &artist)])?;
    server.hang_up()?;
    let (code, error) = of_guest.end().await?;
    ensure!(
        (code, &error["code"]) == (4401, &json!("unauthorized")),
        "{code} {error}"
    );
    let told = error["message"].as_str().unwrap_or_default();
    ensure!(told.contains("not known any more"), "{told}");
    ensure!(of_guest_events.chunk().await?.is_none(), "still told");
    ensure!(patch(&server, &guest, 1.0).await? == StatusCode::UNAUTHORIZED);

    // The artist may watch and listen on, and change nothing.
    ensure!(patch(&server, &artist, 1.0).await? == StatusCode::FORBIDDEN);
    ensure!(patch(&server, &ops, 2.0).await? == StatusCode::OK);
    let event = of_artist_events.chunk().await?.context("an event")?;
    ensure!(String::from_utf8_lossy(&event).contains("event: scene"));
    for _ in 0..2 {
        ensure!(of_artist.said().await?["type"] == "status");
    }
    until("one viewer left", async || {
        let viewers = server.api().get_json("api/v1/viewers").await?;
        Ok((viewers.as_array().map(Vec::len) == Some(1)).then_some(()))
    })
    .await
}
