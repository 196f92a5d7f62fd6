//! A viewer's session: hello, cameras, frames, acknowledgements.

use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use skycell_protocol::frame::{FrameError, FrameHeader};
use skycell_protocol::message::{
    Acknowledgement, CameraInput, ClientMessage, ErrorMessage, Hello, ServerMessage, Status,
    ViewChange, Welcome,
};
use skycell_protocol::{Camera, InputSequence, SUBPROTOCOL};
use thiserror::Error;
use tokio::net::TcpStream;
use tokio::time::{Instant, timeout, timeout_at};
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;
use tokio_tungstenite::tungstenite::http::Uri;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{self, Bytes, Message};
use tokio_tungstenite::{
    Connector, MaybeTlsStream, WebSocketStream, connect_async_tls_with_config,
};

use crate::ServerAddress;
use crate::unix_time::unix_us_now;

/// How long a connection waits, and how much it takes at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConnectionLimits {
    /// For the connection, and then for the welcome.
    pub connect_timeout: Duration,
    /// Without a word from the server, which speaks at least once a second.
    pub silence_timeout: Duration,
    /// For the server to take a message off our hands.
    pub send_timeout: Duration,
    /// The largest message taken. A PNG of 3840x2160 pixels of noise has 33 MB.
    pub message_max_bytes: usize,
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        Self {
            connect_timeout: Duration::from_secs(10),
            silence_timeout: Duration::from_secs(15),
            send_timeout: Duration::from_secs(10),
            message_max_bytes: 48 << 20,
        }
    }
}

/// Why a session did not begin or does not go on.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ConnectionError {
    /// Nobody there, or no Skycell server.
    #[error("no connection to {url}: {source}")]
    Connect {
        /// Where.
        url: String,
        /// Why not.
        source: Box<tungstenite::Error>,
    },
    /// The server did not do something in time.
    #[error("the server took longer than {limit_s} s for {what}")]
    Timeout {
        /// What it should have done.
        what: &'static str,
        /// How long it had.
        limit_s: f64,
    },
    /// The server refused the hello.
    #[error("the server refused: {}", .0.message)]
    Refused(ErrorMessage),
    /// The server ended the session.
    #[error("the server closed the connection ({reason})")]
    Closed {
        /// The close code, if it gave any.
        code: Option<u16>,
        /// Code and reason, if it gave any.
        reason: String,
    },
    /// The connection broke.
    #[error("the connection broke: {0}")]
    Transport(Box<tungstenite::Error>),
    /// A binary message that is no frame.
    #[error("the server sent a frame that is none: {0}")]
    BadFrame(#[from] FrameError),
    /// A text message that does not follow the protocol.
    #[error("the server sent a message that is none: {0}")]
    BadMessage(#[from] serde_json::Error),
    /// A message of ours that JSON cannot hold.
    #[error("the message cannot be written as JSON: {0}")]
    Unwritable(serde_json::Error),
}

impl From<tungstenite::Error> for ConnectionError {
    fn from(error: tungstenite::Error) -> Self {
        match error {
            tungstenite::Error::ConnectionClosed | tungstenite::Error::AlreadyClosed => {
                Self::Closed {
                    code: None,
                    reason: "no reason given".to_owned(),
                }
            }
            other => Self::Transport(Box::new(other)),
        }
    }
}

/// A picture from the server.
#[derive(Clone, Debug)]
pub struct Frame {
    /// What the server says about it.
    pub header: FrameHeader,
    /// This machine's clock when it had arrived, µs since 1970.
    pub received_unix_us: u64,
    message: Bytes,
}

impl Frame {
    /// What `header.codec` says: a JPEG or PNG file, or clouds alone (`skycell_protocol::clouds`).
    pub fn payload(&self) -> &[u8] {
        // A frame exists only of a message with a whole header.
        &self.message[skycell_protocol::frame::FRAME_HEADER_BYTES..]
    }

    /// Length of the whole message.
    pub fn message_bytes(&self) -> usize {
        self.message.len()
    }

    /// From submitting the composite to its arrival, by the clocks of the two machines. 0 if
    /// theirs is ahead.
    pub fn age(&self) -> Duration {
        Duration::from_micros(
            self.received_unix_us
                .saturating_sub(self.header.render_unix_us),
        )
    }
}

/// What a server says during a session.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Event {
    /// A picture; wants an acknowledgement.
    Frame(Frame),
    /// Nothing new to show.
    Heartbeat(FrameHeader),
    /// How things are, once a second.
    Status(Status),
    /// Something that we said was not allowed; the session goes on.
    Complaint(ErrorMessage),
    /// The connection was lost and is there again ([`crate::Session`] alone says so): another viewer for the server, which
    /// knows the last camera as input 0.
    Resumed,
}

/// A session with a server, from its welcome on.
#[derive(Debug)]
pub struct Connection {
    wire: Wire,
    welcome: Welcome,
    last_input: InputSequence,
}

impl Connection {
    /// Connects, says `hello`, with the token of the address if it has none itself, and waits for the welcome.
    ///
    /// # Errors
    /// If nobody is there, the server refuses, or it takes too long.
    pub async fn open(
        address: &ServerAddress,
        hello: Hello,
        limits: ConnectionLimits,
    ) -> Result<Self, ConnectionError> {
        let mut wire = Wire::connect(address, limits).await?;
        let mut hello = hello;
        if hello.token.is_none() {
            hello.token = address.access().token().cloned();
        }
        wire.send(&ClientMessage::Hello(hello)).await?;
        let welcome = timeout(limits.connect_timeout, wire.await_welcome())
            .await
            .map_err(|_| timed_out("the welcome", limits.connect_timeout))??;
        Ok(Self {
            wire,
            welcome,
            last_input: InputSequence(0),
        })
    }

    /// What the server said at the beginning.
    pub fn welcome(&self) -> &Welcome {
        &self.welcome
    }

    /// Looks somewhere else. Frames tell the last input that they show.
    ///
    /// # Errors
    /// If the session has ended.
    pub async fn send_camera(&mut self, camera: Camera) -> Result<InputSequence, ConnectionError> {
        self.last_input.0 += 1;
        let input = self.last_input;
        self.wire
            .send(&ClientMessage::Camera(CameraInput { input, camera }))
            .await?;
        Ok(input)
    }

    /// Wishes another size, rate or codec.
    ///
    /// # Errors
    /// If the session has ended. What the server thinks of the wish comes as an [`Event`].
    pub async fn change_view(&mut self, change: ViewChange) -> Result<(), ConnectionError> {
        self.wire.send(&ClientMessage::View(change)).await
    }

    /// Says that a frame has arrived, and with it every earlier one. The server composites no
    /// more than two frames ahead of this.
    ///
    /// # Errors
    /// If the session has ended.
    pub async fn acknowledge(&mut self, ack: Acknowledgement) -> Result<(), ConnectionError> {
        self.wire.send(&ClientMessage::Ack(ack)).await
    }

    /// Waits for the server's next word. Nothing is lost when the future is dropped.
    ///
    /// # Errors
    /// If the session has ended, the server is silent, or it does not follow the protocol.
    pub async fn next_event(&mut self) -> Result<Event, ConnectionError> {
        loop {
            match self.wire.next_message().await? {
                Message::Text(text) => match serde_json::from_str(&text)? {
                    ServerMessage::Status(status) => return Ok(Event::Status(status)),
                    ServerMessage::Error(complaint) => return Ok(Event::Complaint(complaint)),
                    ServerMessage::Welcome(welcome) => self.welcome = welcome,
                },
                Message::Binary(message) => {
                    let received_unix_us = unix_us_now();
                    let (header, _payload) = FrameHeader::split(&message)?;
                    return Ok(if header.heartbeat {
                        Event::Heartbeat(header)
                    } else {
                        Event::Frame(Frame {
                            header,
                            received_unix_us,
                            message,
                        })
                    });
                }
                _ => {}
            }
        }
    }

    /// Says goodbye. A server that does not answer is left after a second.
    pub async fn close(self) {
        self.wire.close().await;
    }
}

/// The socket with its limits.
#[derive(Debug)]
struct Wire {
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    limits: ConnectionLimits,
    last_heard: Instant,
}

impl Wire {
    async fn connect(
        address: &ServerAddress,
        limits: ConnectionLimits,
    ) -> Result<Self, ConnectionError> {
        let url = address.websocket_url();
        let refused = |source: tungstenite::Error| ConnectionError::Connect {
            url: url.clone(),
            source: Box::new(source),
        };
        let uri: Uri = url
            .parse()
            .map_err(|error| refused(tungstenite::http::Error::from(error).into()))?;
        let request = ClientRequestBuilder::new(uri).with_sub_protocol(SUBPROTOCOL);
        let config = WebSocketConfig::default()
            .max_message_size(Some(limits.message_max_bytes))
            .max_frame_size(Some(limits.message_max_bytes));
        let connector = address
            .is_tls()
            .then(|| Connector::Rustls(address.access().tls_config(true)));
        // Nagle would hold a camera back until the acknowledgement before it is itself acknowledged.
        let without_nagle = true;
        let (socket, _response) = timeout(
            limits.connect_timeout,
            connect_async_tls_with_config(request, Some(config), without_nagle, connector),
        )
        .await
        .map_err(|_| timed_out("the connection", limits.connect_timeout))?
        .map_err(refused)?;
        Ok(Self {
            socket,
            limits,
            last_heard: Instant::now(),
        })
    }

    async fn await_welcome(&mut self) -> Result<Welcome, ConnectionError> {
        loop {
            if let Message::Text(text) = self.next_message().await? {
                match serde_json::from_str(&text)? {
                    ServerMessage::Welcome(welcome) => return Ok(welcome),
                    ServerMessage::Error(refusal) => return Err(ConnectionError::Refused(refusal)),
                    ServerMessage::Status(_) => {}
                }
            }
        }
    }

    async fn next_message(&mut self) -> Result<Message, ConnectionError> {
        let silent_at = self.last_heard + self.limits.silence_timeout;
        let message = timeout_at(silent_at, self.socket.next())
            .await
            .map_err(|_| timed_out("a sign of life", self.limits.silence_timeout))?;
        self.last_heard = Instant::now();
        match message {
            Some(Ok(Message::Close(close))) => Err(ConnectionError::Closed {
                code: close.as_ref().map(|close| close.code.into()),
                reason: close
                    .map_or_else(|| "no reason given".to_owned(), |close| close.to_string()),
            }),
            Some(message) => Ok(message?),
            None => Err(tungstenite::Error::ConnectionClosed.into()),
        }
    }

    async fn send(&mut self, message: &ClientMessage) -> Result<(), ConnectionError> {
        let text = serde_json::to_string(message).map_err(ConnectionError::Unwritable)?;
        timeout(
            self.limits.send_timeout,
            self.socket.send(Message::text(text)),
        )
        .await
        .map_err(|_| timed_out("taking a message", self.limits.send_timeout))??;
        Ok(())
    }

    async fn close(mut self) {
        let goodbye = async {
            if self.socket.close(None).await.is_ok() {
                while let Some(Ok(_)) = self.socket.next().await {}
            }
        };
        // The server notices the closed socket either way.
        let _ = timeout(Duration::from_secs(1), goodbye).await;
    }
}

fn timed_out(what: &'static str, limit: Duration) -> ConnectionError {
    ConnectionError::Timeout {
        what,
        limit_s: limit.as_secs_f64(),
    }
}
