//! Says back what is said: what conformance suites of WebSocket talk to, which know no hello. The service has no route
//! to it; what reads, writes, limits and ends the connection is the same as in a session.

use axum::extract::ws::{Message, WebSocket};
use futures_util::{SinkExt, StreamExt};

use super::end::End;
use super::session::say_goodbye;

/// Says back every text and every binary message until the connection ends.
pub async fn echo(socket: WebSocket) {
    let (mut sink, mut stream) = socket.split();
    let end = loop {
        match stream.next().await {
            Some(Ok(message @ (Message::Text(_) | Message::Binary(_)))) => {
                if sink.send(message).await.is_err() {
                    break End::PeerGone;
                }
            }
            Some(Ok(Message::Close(_))) | None => break End::PeerGone,
            Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
            Some(Err(error)) => break End::of_socket_error(error).without_message(),
        }
    };
    say_goodbye(sink, stream, end).await;
}
