//! Frames, heartbeats, status and answers on their way to a viewer.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use bytes::Bytes;
use futures_util::SinkExt;
use futures_util::stream::SplitSink;
use skycell_protocol::frame::FrameCodec;
use skycell_protocol::message::{PickedQuality, ServerMessage, Status};
use skycell_protocol::{CellId, FrameHeader, FrameSequence, FrameStages, InputSequence};
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior, interval_at};

use super::StreamContext;
use super::end::End;
use super::inbound::renderer_gone;
use crate::clock::unix_now_us;
use crate::frame_loop::interface::{RenderCommand, RenderStats};
use crate::viewers::{EncodedFrame, SentFrame, Stage, Viewer};

/// After this long without a frame, a heartbeat is sent.
const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);
/// How often a viewer is told how things are.
const STATUS_INTERVAL: Duration = Duration::from_secs(1);
/// After this long without a newer frame, one that was less good than wished is sent again as wished.
const REFINE_INTERVAL: Duration = Duration::from_millis(300);
/// What a viewer is told of a loss of the device that is over.
const LOST_AND_OPEN_AGAIN: &str = "the graphics device was lost and is open again";
/// How many pings a viewer may miss before it counts as stalled.
const PINGS_PER_STALL: u32 = 3;

/// The text message of what a server says.
pub(super) fn text_of(message: &ServerMessage) -> Result<Message, End> {
    match serde_json::to_string(message) {
        Ok(text) => Ok(Message::Text(text.into())),
        Err(error) => {
            tracing::error!(%error, "a message cannot be written as JSON");
            Err(End::internal("a message cannot be written"))
        }
    }
}

/// Writes to the viewer until the session ends, the welcome before all else. Frames are taken only from the latest-wins slot,
/// and only when the socket has taken all that came before.
pub(super) async fn write(
    sink: &mut SplitSink<WebSocket, Message>,
    welcome: &ServerMessage,
    mut answers: mpsc::Receiver<ServerMessage>,
    viewer: &Arc<Viewer>,
    context: &StreamContext,
) -> End {
    let mut outbound = Outbound {
        sink,
        viewer,
        context,
        last: None,
        last_binary_at: Instant::now(),
        refine_at: None,
        rates_from: Instant::now(),
        losses_told: 0,
    };
    if let Err(end) = outbound.say(welcome).await {
        return end;
    }
    // At once: no frame stands in its way yet, so its round trip is that of an empty link.
    if let Err(end) = outbound.ping().await {
        return end;
    }
    let start = Instant::now();
    let mut status = interval_at(start + STATUS_INTERVAL, STATUS_INTERVAL);
    // After a stall, one status says it all.
    status.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut device_state = context.frame_loop.device_state();
    outbound.losses_told = device_state.borrow_and_update().losses;
    let ping_interval = context.stall / PINGS_PER_STALL;
    let mut ping = interval_at(start + ping_interval, ping_interval);
    ping.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        let heartbeat_at = outbound.last_binary_at + HEARTBEAT_INTERVAL;
        let refine_at = outbound.refine_at;
        let result = tokio::select! {
            frame = viewer.outbox().next() => {
                context.encoders.go_on(viewer);
                outbound.frame(frame).await
            }
            Some(answer) = answers.recv() => outbound.say(&answer).await,
            _ = status.tick() => outbound.status(RatesOf::Now).await,
            // Not a second later: it may be over by then.
            Ok(()) = device_state.changed() => outbound.status(RatesOf::LastTime).await,
            () = tokio::time::sleep_until(heartbeat_at) => outbound.heartbeat().await,
            () = tokio::time::sleep_until(refine_at.unwrap_or(heartbeat_at)), if refine_at.is_some() => outbound.refine(),
            _ = ping.tick() => outbound.ping().await,
            () = viewer.failure() => Err(End::internal("a frame could not be encoded")),
        };
        if let Err(end) = result {
            return end;
        }
    }
}

struct Outbound<'a> {
    sink: &'a mut SplitSink<WebSocket, Message>,
    viewer: &'a Viewer,
    context: &'a StreamContext,
    last: Option<FrameHeader>,
    last_binary_at: Instant,
    /// When the last frame is to come again, as good as wished.
    refine_at: Option<Instant>,
    rates_from: Instant,
    /// How many losses of the device the viewer knows of.
    losses_told: u64,
}

/// Which rates a status tells.
#[derive(Clone, Copy, PartialEq, Eq)]
enum RatesOf {
    /// Those since they were told last.
    Now,
    /// The same as last time.
    LastTime,
}

impl Outbound<'_> {
    async fn frame(&mut self, frame: EncodedFrame) -> Result<(), End> {
        let is_reduced = frame.is_reduced();
        let (header, message) = frame.into_message(std::time::Instant::now());
        crate::traces::frame_sent(&header);
        self.context.metrics.sent(&header.stages);
        let sent = SentFrame {
            sequence: header.sequence,
            render_unix_us: header.render_unix_us,
            sent_us: self.viewer.clock_us(),
            bytes: message.len() as u64,
        };
        // Before it is sent: the acknowledgement may be there before the send returns.
        {
            let mut figures = self.viewer.figures();
            figures.sent_frame(sent);
            for (stage, time_us) in Stage::of_header(&header.stages) {
                figures.latencies.push(stage, time_us);
            }
        }
        self.last = Some(header);
        self.send(Message::Binary(message)).await?;
        self.last_binary_at = Instant::now();
        self.refine_at = is_reduced.then(|| self.last_binary_at + REFINE_INTERVAL);
        Ok(())
    }

    /// Asks for the last frame again, as good as wished.
    fn refine(&mut self) -> Result<(), End> {
        self.refine_at = None;
        let viewer = self.viewer.id();
        let refine = RenderCommand::Refine { viewer };
        let sent = self.context.frame_loop.send(refine);
        sent.map_err(|error| renderer_gone(error, self.viewer))
    }

    /// Asks for a sign of life that tells how long the way there and back takes.
    async fn ping(&mut self) -> Result<(), End> {
        let payload = self.viewer.clock_us().to_le_bytes();
        self.send(Message::Ping(Bytes::copy_from_slice(&payload)))
            .await
    }

    async fn heartbeat(&mut self) -> Result<(), End> {
        let header = FrameHeader {
            codec: FrameCodec::None,
            heartbeat: true,
            coarse: self.last.is_some_and(|last| last.coarse),
            stereo: self.last.is_some_and(|last| last.stereo),
            key: false,
            exact: self.last.is_some_and(|last| last.exact),
            sequence: self.last.map_or(FrameSequence(0), |last| last.sequence),
            width: 0,
            height: 0,
            scene_revision: self.last.map_or(0, |last| last.scene_revision),
            input: self.last.map_or(InputSequence(0), |last| last.input),
            cell: self.last.map_or(CellId(0), |last| last.cell),
            viewer: self.viewer.id(),
            render_unix_us: unix_now_us(),
            stages: FrameStages::default(),
            payload_bytes: 0,
            target_kbit_per_s: self.last.map_or(0, |last| last.target_kbit_per_s),
            colours: None,
        };
        let message = Bytes::copy_from_slice(&header.encode());
        self.send(Message::Binary(message)).await?;
        self.last_binary_at = Instant::now();
        Ok(())
    }

    async fn status(&mut self, rates: RatesOf) -> Result<(), End> {
        let now = Instant::now();
        let (fps, mbit_per_s) = {
            let mut figures = self.viewer.figures();
            if rates == RatesOf::Now {
                figures.take_rates((now - self.rates_from).as_secs_f64());
                self.rates_from = now;
            }
            (figures.fps, figures.mbit_per_s)
        };
        let stats = self.context.frame_loop.stats();
        let scene_revision = self.context.scene.snapshot().revision;
        let mut status = status_of(self.viewer, &stats, scene_revision, fps, mbit_per_s);
        // It was over before it could be told.
        if !stats.device_loss.is_lost && stats.device_loss.losses > self.losses_told {
            status.renderer_note = Some(LOST_AND_OPEN_AGAIN.to_owned());
        }
        self.losses_told = stats.device_loss.losses;
        self.say(&ServerMessage::Status(status)).await
    }

    async fn say(&mut self, message: &ServerMessage) -> Result<(), End> {
        let message = text_of(message)?;
        self.send(message).await
    }

    async fn send(&mut self, message: Message) -> Result<(), End> {
        let bytes = match &message {
            Message::Text(text) => text.len(),
            Message::Binary(bytes) => bytes.len(),
            Message::Ping(_) | Message::Pong(_) | Message::Close(_) => 0,
        } as u64;
        match tokio::time::timeout(self.context.stall, self.sink.send(message)).await {
            Ok(Ok(())) => {
                self.viewer.figures().bytes_sent += bytes;
                self.context.metrics.bytes_sent.increment(bytes);
                Ok(())
            }
            Ok(Err(error)) => Err(End::of_socket_error(error)),
            Err(_) => Err(End::stalled()),
        }
    }
}

fn status_of(
    viewer: &Viewer,
    stats: &RenderStats,
    scene_revision: u64,
    fps: f64,
    mbit_per_s: f64,
) -> Status {
    let known = stats.viewers.iter().find(|known| known.id == viewer.id());
    let cell = known.map(|known| known.cell);
    let figures = cell.and_then(|id| stats.cells.iter().find(|cell| cell.id == id));
    Status {
        cell,
        cell_name: figures.map_or_else(String::new, |cell| cell.name.clone()),
        viewers_in_cell: figures.map_or(0, |cell| {
            u32::try_from(cell.viewers.len()).unwrap_or(u32::MAX)
        }),
        overlap: figures.map_or(0.0, |cell| cell.overlap),
        texels_pending: figures.map_or(0, |cell| cell.texels_pending),
        scene_revision,
        fps,
        mbit_per_s,
        sky_converged: figures.is_some_and(|cell| cell.converged),
        cache_error_p50_percent: stats.audit.p50_percent,
        cache_error_p95_percent: stats.audit.p95_percent,
        quality: known.map(|known| PickedQuality {
            name: known.quality.picked.to_owned(),
            flip: known.quality.flip,
            measured: known.quality.measured,
            is_met: known.quality.is_met,
            device_ms: known.quality.device_ms_per_frame,
        }),
        renderer: known.map(|known| known.renderer),
        renderer_note: known.and_then(|known| known.renderer_note.map(str::to_owned)),
        show_note: known.and_then(|known| known.show_note.map(str::to_owned)),
        loss_note: figures.and_then(|cell| cell.loss_note.clone()),
        stereo: viewer.view().stereo,
        codec: viewer.view().codec,
        target_kbit_per_s: viewer
            .view()
            .codec
            .is_stream()
            .then(|| viewer.target_kbit_per_s()),
    }
}
