//! The WebSocket `/ws`: one session per viewer.
//!
//! A session is one task. What it holds for its viewer is bounded: one encoded frame in the slot,
//! one in the socket's write buffer, a few answers, and inbound messages of at most 64 KiB.

mod echo;
mod end;
mod hello;
mod inbound;
mod outbound;
mod pace;
mod session;

pub use echo::echo;

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{WebSocketUpgrade, rejection::WebSocketUpgradeRejection};
use axum::extract::{Extension, State};
use axum::http::StatusCode;
use axum::http::header::{HeaderValue, RETRY_AFTER};
use axum::response::Response;
use skycell_protocol::{FrameSize, INBOUND_MESSAGE_MAX_BYTES, SUBPROTOCOL};
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

pub(crate) use session::LeaveOnDrop;

use crate::access::{Gate, Peer};
use crate::api::{Problem, SnapshotQueue};
use crate::encode::EncoderPool;
use crate::encode::video::full_rate_kbit_per_s;
use crate::frame_loop::interface::FrameLoopHandle;
use crate::metrics::Metrics;
use crate::scene::SceneStore;
use crate::viewers::ViewerRegistry;

/// Connections that may be between their upgrade and their hello, beyond the viewers that may be.
const GREETING_MAX: usize = 32;

/// The largest message that may wait in a socket's write buffer: a PNG of 3840x2160 pixels of
/// noise is 33.2 MB.
const WRITE_BUFFER_MAX_BYTES: usize = 40 * 1024 * 1024;

/// Inbound messages are small; tungstenite's default of 128 KiB per connection would be waste.
const READ_BUFFER_BYTES: usize = 8 * 1024;

/// What every session shares.
pub struct StreamContext {
    /// Who is connected.
    pub viewers: Arc<ViewerRegistry>,
    /// The renderer.
    pub frame_loop: FrameLoopHandle,
    /// The scene.
    pub scene: Arc<SceneStore>,
    /// The service's figures.
    pub metrics: Arc<Metrics>,
    /// Who makes pictures of pixels.
    pub encoders: Arc<EncoderPool>,
    /// The rate that videos aim at; none for what their size says.
    pub video_kbit_per_s: Option<u32>,
    /// A viewer that takes or says nothing for this long is dropped.
    pub stall: Duration,
    /// Who may what.
    pub gate: Arc<Gate>,
    /// Origins of other sites whose pages may read answers.
    pub allowed_origins: Vec<String>,
    /// No viewer is taken any more when it is cancelled; those who are there stay.
    pub draining: CancellationToken,
    /// Ends every session when it is cancelled.
    pub shutdown: CancellationToken,
    /// Knows the sessions that still run.
    pub sessions: TaskTracker,
    /// Bounds connections that have not said hello together with those that have.
    pub connections: Arc<Semaphore>,
    /// Bounds those who listen to changes of the scene.
    pub subscribers: Arc<Semaphore>,
    /// Bounds snapshots.
    pub snapshots: SnapshotQueue,
}

impl StreamContext {
    /// The rate that a video of a size aims at while its line holds it.
    pub fn video_rate_kbit_per_s(&self, size: FrameSize) -> u32 {
        self.video_kbit_per_s
            .unwrap_or_else(|| full_rate_kbit_per_s(size))
    }
}

/// As many connections as `viewers_max` viewers and those who are about to say hello need.
pub fn connection_limit(viewers_max: u32) -> Arc<Semaphore> {
    Arc::new(Semaphore::new(viewers_max as usize + GREETING_MAX))
}

/// Inbound messages as this server takes them, and how it writes.
pub fn limit_messages<F: axum::extract::ws::OnFailedUpgrade>(
    upgrade: WebSocketUpgrade<F>,
    inbound_max_bytes: usize,
) -> WebSocketUpgrade<F> {
    upgrade
        .read_buffer_size(READ_BUFFER_BYTES)
        // Every message is flushed at once: frames wait in the slot, where newer ones replace them.
        .write_buffer_size(0)
        .max_write_buffer_size(WRITE_BUFFER_MAX_BYTES)
        .max_message_size(inbound_max_bytes)
        .max_frame_size(inbound_max_bytes)
}

/// `GET /ws`: checks who asks for what, then starts a session.
pub(crate) async fn upgrade(
    State(context): State<Arc<StreamContext>>,
    Extension(peer): Extension<Peer>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let upgrade = upgrade.map_err(|rejection| {
        Problem::new(
            rejection.status(),
            format!("/ws is a WebSocket: {}", rejection.body_text()),
        )
    })?;
    let upgrade = upgrade.protocols([SUBPROTOCOL]);
    if upgrade.selected_protocol().is_none() {
        let asked: Vec<_> = upgrade
            .requested_protocols()
            .map(|protocol| String::from_utf8_lossy(protocol.as_bytes()).into_owned())
            .collect();
        return Err(Problem::new(
            StatusCode::BAD_REQUEST,
            format!(
                "the WebSocket subprotocol must be {SUBPROTOCOL}; asked for: {}",
                if asked.is_empty() {
                    "none".to_owned()
                } else {
                    asked.join(", ")
                }
            ),
        ));
    }
    let busy = |what: &str| Problem::new(StatusCode::SERVICE_UNAVAILABLE, what);
    if context.draining.is_cancelled() {
        // A proxy in front tries another server; without one, this one may be back soon.
        return Err(busy("the server is shutting down")
            .with_header(RETRY_AFTER, HeaderValue::from_static("5")));
    }
    let permit = Arc::clone(&context.connections)
        .try_acquire_owned()
        .map_err(|_| busy("too many connections; try again later"))?;
    // From here on a shutdown waits for the session.
    let running = context.sessions.token();
    let greeting = context.gate.greet(peer.key)?;
    Ok(
        limit_messages(upgrade, INBOUND_MESSAGE_MAX_BYTES).on_upgrade(move |socket| async move {
            session::run(socket, context, peer.key, greeting).await;
            drop(permit);
            drop(running);
        }),
    )
}
