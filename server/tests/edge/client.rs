//! A viewer of the tests: a real WebSocket.

use std::net::SocketAddr;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use skycell_protocol::FrameHeader;
use skycell_protocol::message::{ServerMessage, Welcome};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::handshake::client::Request;
use tokio_tungstenite::tungstenite::{self, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

/// Longer than anything that the service may take.
const PATIENCE: Duration = Duration::from_secs(10);
/// A session that is to end has ended by then.
const END_PATIENCE: Duration = Duration::from_secs(60);

pub(crate) struct Client {
    pub(crate) socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
}

/// What a service says.
#[derive(Debug)]
pub(crate) enum Heard {
    Frame(FrameHeader, Vec<u8>),
    Message(ServerMessage),
    Closed {
        code: u16,
        reason: String,
    },
    /// The connection ended without a closing handshake.
    Cut,
}

pub(crate) fn handshake(address: SocketAddr, subprotocol: Option<&str>) -> Request {
    let mut request = format!("ws://{address}/ws")
        .into_client_request()
        .expect("a request");
    if let Some(subprotocol) = subprotocol {
        let value = subprotocol.parse().expect("a header value");
        request
            .headers_mut()
            .insert("sec-websocket-protocol", value);
    }
    request
}

pub(crate) fn hello_json() -> Value {
    json!({
        "type": "hello", "protocol": 1, "width": 64, "height": 32, "fps": 60, "codec": "png",
        "camera": {"position_m": [0, 2, 0], "yaw_deg": 0, "pitch_deg": 15, "vertical_fov_deg": 60}
    })
}

impl Client {
    /// A connection that has not said hello.
    pub(crate) async fn connect(address: SocketAddr) -> Self {
        let (socket, response) = connect_async(handshake(address, Some("skycell.v1")))
            .await
            .expect("connects");
        assert_eq!(response.headers()["sec-websocket-protocol"], "skycell.v1");
        Self { socket }
    }

    /// A viewer that was welcomed.
    pub(crate) async fn join(address: SocketAddr) -> Self {
        Self::join_as(address, hello_json()).await.0
    }

    pub(crate) async fn join_as(address: SocketAddr, hello: Value) -> (Self, Welcome) {
        let mut client = Self::connect(address).await;
        client.say(&hello).await;
        match client.hear().await {
            Heard::Message(ServerMessage::Welcome(welcome)) => (client, welcome),
            other => panic!("no welcome but {other:?}"),
        }
    }

    pub(crate) async fn say(&mut self, message: &Value) {
        self.say_text(&message.to_string()).await;
    }

    pub(crate) async fn say_text(&mut self, text: &str) {
        self.send(Message::text(text)).await.expect("sent");
    }

    pub(crate) async fn send(&mut self, message: Message) -> tungstenite::Result<()> {
        self.socket.send(message).await
    }

    /// The next thing that the service says.
    pub(crate) async fn hear(&mut self) -> Heard {
        loop {
            let message = timeout(PATIENCE, self.socket.next())
                .await
                .expect("something is said in time");
            match message {
                Some(Ok(Message::Binary(bytes))) => {
                    let (header, payload) = FrameHeader::split(&bytes).expect("a frame");
                    return Heard::Frame(header, payload.to_vec());
                }
                Some(Ok(Message::Text(text))) => {
                    return Heard::Message(serde_json::from_str(&text).expect("a message"));
                }
                Some(Ok(Message::Close(frame))) => {
                    let frame = frame.expect("a reason");
                    return Heard::Closed {
                        code: frame.code.into(),
                        reason: frame.reason.to_string(),
                    };
                }
                Some(Ok(_)) => {}
                Some(Err(_)) | None => return Heard::Cut,
            }
        }
    }

    /// The next frame that is no heartbeat; acknowledges it.
    pub(crate) async fn frame(&mut self) -> (FrameHeader, Vec<u8>) {
        loop {
            match self.hear().await {
                Heard::Frame(header, payload) if !header.heartbeat => {
                    self.acknowledge(header.sequence.0).await;
                    return (header, payload);
                }
                Heard::Frame(..) | Heard::Message(_) => {}
                other => panic!("no frame but {other:?}"),
            }
        }
    }

    /// Frames until one is as wanted.
    pub(crate) async fn frame_with(&mut self, mut wanted: impl FnMut(&FrameHeader) -> bool) {
        timeout(PATIENCE, async { while !wanted(&self.frame().await.0) {} })
            .await
            .expect("such a frame in time");
    }

    pub(crate) async fn acknowledge(&mut self, sequence: u32) {
        self.say(&json!({"type": "ack", "sequence": sequence, "decode_us": 1500}))
            .await;
    }

    /// The next error message, as JSON; acknowledges frames that come before.
    pub(crate) async fn error(&mut self) -> Value {
        loop {
            match self.hear().await {
                Heard::Message(ServerMessage::Error(error)) => {
                    return serde_json::to_value(error).expect("JSON");
                }
                Heard::Frame(header, _) => {
                    if !header.heartbeat {
                        self.acknowledge(header.sequence.0).await;
                    }
                }
                Heard::Message(_) => {}
                other => panic!("no error but {other:?}"),
            }
        }
    }

    /// Hears on until the service closes; its code and the code of the last error before.
    ///
    /// # Panics
    /// If there is none: whoever should be refused and is not would hear for ever.
    pub(crate) async fn end(&mut self) -> (u16, Option<String>) {
        timeout(END_PATIENCE, self.hear_end())
            .await
            .expect("the session goes on")
    }

    async fn hear_end(&mut self) -> (u16, Option<String>) {
        let mut last_error = None;
        loop {
            match self.hear().await {
                Heard::Closed { code, .. } => return (code, last_error),
                Heard::Message(ServerMessage::Error(error)) => {
                    let code = serde_json::to_value(error.code).expect("JSON");
                    last_error = code.as_str().map(str::to_owned);
                }
                Heard::Cut => panic!("cut without a close frame; last error {last_error:?}"),
                Heard::Frame(..) | Heard::Message(_) => {}
            }
        }
    }
}
