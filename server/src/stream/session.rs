//! One viewer's session, from its hello to its end.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, WebSocket};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt, StreamExt};
use skycell_protocol::frame::FRAME_HEADER_BYTES;
use skycell_protocol::message::{AccessToken, Hello, ServerMessage, Welcome};
use skycell_protocol::view::{FRAME_HEIGHT_MAX, FRAME_WIDTH_MAX, FRAMES_PER_SECOND};
use skycell_protocol::{PROTOCOL_VERSION, ViewerId};
use tokio::sync::mpsc;
use tracing::Instrument;

use super::StreamContext;
use super::end::End;
use super::{hello, inbound, outbound};
use crate::access::{HelloRefusal, Lease, PeerKey, PeerPermit, Refusal};
use crate::frame_loop::interface::{FrameLoopGone, FrameLoopHandle, RenderCommand, ViewRequest};
use crate::viewers::{JoinError, Viewer};

/// How many answers may wait for the writer.
const ANSWERS_MAX: usize = 16;

/// How long a client may take to hear why the server closes.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

/// How often a leave is tried again while the renderer's channel is full.
const LEAVE_RETRY_INTERVAL: Duration = Duration::from_millis(50);

/// Runs a session to its end.
pub(super) async fn run(
    mut socket: WebSocket,
    context: Arc<StreamContext>,
    peer: PeerKey,
    greeting: PeerPermit,
) {
    let hello = tokio::select! {
        hello = hello::receive(&mut socket) => hello,
        () = context.shutdown.cancelled() => Err(End::restart()),
    };
    let (mut sink, mut stream) = socket.split();
    let admitted = hello.and_then(|hello| Ok((admit(&hello, peer, &context)?, hello)));
    drop(greeting);
    let end = match admitted {
        Ok(((_admitted, lease), hello)) => {
            let span = tracing::trace_span!(
                target: crate::traces::TARGET,
                parent: None,
                "viewer session",
                skycell.viewer = tracing::field::Empty,
                skycell.width = hello.size.width(),
                skycell.height = hello.size.height(),
                skycell.frames_sent = tracing::field::Empty,
            );
            let end = serve(&mut sink, &mut stream, &hello, lease, &context)
                .instrument(span)
                .await;
            tracing::debug!(?end, "session ends");
            end
        }
        Err(end) => end,
    };
    say_goodbye(sink, stream, end).await;
}

/// Whether who says hello may watch, and room for it among the viewers of its peer.
fn admit(
    hello: &Hello,
    peer: PeerKey,
    context: &StreamContext,
) -> Result<(PeerPermit, Lease), End> {
    let token = hello.token.as_ref().map(AccessToken::text);
    let lease = context
        .gate
        .check_hello(peer, token)
        .map_err(|refusal| match refusal {
            HelloRefusal::Unauthorized(why) => End::unauthorized(why),
            HelloRefusal::Blocked(seconds) => End::blocked(seconds),
        })?;
    let permit = context.gate.admit(peer).map_err(|max| {
        End::too_many_viewers(format!(
            "{max} viewers of this address are connected, and no more are allowed"
        ))
    })?;
    Ok((permit, lease))
}

/// The session of a client that has said hello.
async fn serve(
    sink: &mut SplitSink<WebSocket, Message>,
    stream: &mut SplitStream<WebSocket>,
    hello: &Hello,
    mut lease: Lease,
    context: &StreamContext,
) -> End {
    let view = ViewRequest {
        size: hello.size,
        fps: hello.fps,
        // Every codec of the protocol has its encoder.
        codec: hello.picked_codec(|_| true),
        jpeg_quality: hello.jpeg_quality.get(),
        camera: hello.camera,
        renderer: hello.renderer,
        quality: hello.quality,
        show: hello.show,
        stereo: hello.stereo,
        haze: hello.haze,
        linear: false,
    };
    let viewer = match context.viewers.join(view) {
        Ok(viewer) => viewer,
        Err(JoinError::Pixels(error)) => {
            context.gate.count(Refusal::Pixels);
            return End::too_many_pixels(error.to_string());
        }
        Err(error) => {
            context.gate.count(Refusal::Viewers);
            return End::too_many_viewers(error.to_string());
        }
    };
    viewer.set_target_kbit_per_s(context.video_rate_kbit_per_s(view.picture_size()));
    viewer.set_scales_colours(hello.scaled_colours);
    tracing::info!(
        viewer = %viewer.id(),
        width = view.size.width(),
        height = view.size.height(),
        codec = ?view.codec,
        "viewer connects"
    );
    let span = tracing::Span::current();
    span.record("skycell.viewer", viewer.id().0);
    let join = RenderCommand::Join {
        viewer: viewer.id(),
        view,
    };
    if let Err(error) = context.frame_loop.send(join) {
        return inbound::renderer_gone(error, &viewer);
    }
    let _leave = LeaveOnDrop::new(context.frame_loop.clone(), viewer.id());
    let (answers, waiting_answers) = mpsc::channel(ANSWERS_MAX);
    let welcome = ServerMessage::Welcome(welcome(&viewer, context));
    let end = tokio::select! {
        end = inbound::read(stream, answers, &viewer, context) => end,
        end = outbound::write(sink, &welcome, waiting_answers, &viewer, context) => end,
        () = context.shutdown.cancelled() => End::restart(),
        why = lease.ended() => {
            context.gate.count(Refusal::TokenTaken);
            End::unauthorized(why)
        }
    };
    span.record("skycell.frames_sent", viewer.figures().frames_sent);
    end
}

fn welcome(viewer: &Viewer, context: &StreamContext) -> Welcome {
    let stats = context.frame_loop.stats();
    Welcome {
        protocol: PROTOCOL_VERSION,
        viewer: viewer.id(),
        // The renderer places the viewer when it takes the join.
        cell: None,
        server: concat!("skycell-server ", env!("CARGO_PKG_VERSION")).to_owned(),
        adapter: stats.adapter.name.clone(),
        max_width: FRAME_WIDTH_MAX,
        max_height: FRAME_HEIGHT_MAX,
        max_fps: FRAMES_PER_SECOND.max,
        frame_header_bytes: FRAME_HEADER_BYTES as u32,
        codec: viewer.view().codec,
    }
}

/// Tells the client why, closes, and gives it a moment to close too.
pub(super) async fn say_goodbye(
    mut sink: SplitSink<WebSocket, Message>,
    mut stream: SplitStream<WebSocket>,
    end: End,
) {
    let End::Close {
        error,
        code,
        reason,
    } = end
    else {
        // Completes the closing handshake, if there is one.
        let _ = tokio::time::timeout(CLOSE_TIMEOUT, sink.close()).await;
        return;
    };
    tracing::debug!(code, %reason, "closing a connection");
    let farewell = async {
        if let Some(Ok(message)) = error.map(|e| outbound::text_of(&ServerMessage::Error(e))) {
            sink.send(message).await?;
        }
        let frame = CloseFrame {
            code,
            reason: reason.as_ref().into(),
        };
        sink.send(Message::Close(Some(frame))).await
    };
    if !matches!(
        tokio::time::timeout(CLOSE_TIMEOUT, farewell).await,
        Ok(Ok(()))
    ) {
        return;
    }
    // Until the client closes too. After an error nothing more can be read here: the socket itself lingers.
    let closed = async { while let Some(Ok(_)) = stream.next().await {} };
    let _ = tokio::time::timeout(CLOSE_TIMEOUT, closed).await;
}

/// Tells the renderer that the viewer is gone, however the session ends.
pub(crate) struct LeaveOnDrop {
    frame_loop: FrameLoopHandle,
    viewer: ViewerId,
}

impl LeaveOnDrop {
    pub(crate) fn new(frame_loop: FrameLoopHandle, viewer: ViewerId) -> Self {
        Self { frame_loop, viewer }
    }
}

impl Drop for LeaveOnDrop {
    fn drop(&mut self) {
        let viewer = self.viewer;
        tracing::info!(%viewer, "viewer leaves");
        let frame_loop = self.frame_loop.clone();
        if frame_loop.send(RenderCommand::Leave { viewer }) != Err(FrameLoopGone::Behind) {
            return;
        }
        // The renderer would go on rendering for it. Outside a runtime everything ends anyway.
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            runtime.spawn(async move {
                while frame_loop.send(RenderCommand::Leave { viewer }) == Err(FrameLoopGone::Behind)
                {
                    tokio::time::sleep(LEAVE_RETRY_INTERVAL).await;
                }
            });
        }
    }
}
