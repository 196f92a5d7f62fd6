//! Before the session: the client has to say hello.

use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use skycell_protocol::message::{ClientMessage, ErrorCode, ErrorMessage, Hello, ServerMessage};

use super::end::End;
use super::outbound::text_of;

/// How long a client may take to say hello.
pub(super) const HELLO_TIMEOUT: Duration = Duration::from_secs(5);

/// Waits for the hello. A hello with a bad value is answered, and another may follow in the same
/// time.
pub(super) async fn receive(socket: &mut WebSocket) -> Result<Hello, End> {
    tokio::time::timeout(HELLO_TIMEOUT, receive_untimed(socket))
        .await
        .unwrap_or_else(|_| Err(End::hello_too_late(HELLO_TIMEOUT.as_secs())))
}

async fn receive_untimed(socket: &mut WebSocket) -> Result<Hello, End> {
    loop {
        let message = match socket.recv().await {
            Some(Ok(message)) => message,
            Some(Err(error)) => return Err(End::of_socket_error(error)),
            None => return Err(End::PeerGone),
        };
        let error: ErrorMessage = match message {
            Message::Text(text) => match ClientMessage::from_json_text(&text) {
                Ok(ClientMessage::Hello(hello)) => return Ok(hello),
                Ok(_) => return Err(End::hello_expected("the first message must be a hello")),
                Err(error) if error.code() == ErrorCode::WrongProtocol => {
                    return Err(End::wrong_version(error.to_message()));
                }
                Err(error) => error.to_message(),
            },
            Message::Binary(_) => return Err(End::binary()),
            Message::Close(_) => return Err(End::PeerGone),
            Message::Ping(_) | Message::Pong(_) => continue,
        };
        let answer = text_of(&ServerMessage::Error(error))?;
        socket.send(answer).await.map_err(|_| End::PeerGone)?;
    }
}
