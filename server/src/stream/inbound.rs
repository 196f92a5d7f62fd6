//! What a viewer says becomes commands for the renderer.

use axum::extract::ws::{Message, WebSocket};
use futures_util::StreamExt;
use futures_util::stream::SplitStream;
use skycell_protocol::message::{
    Acknowledgement, ClientMessage, ErrorCode, ErrorMessage, MessageError, ServerMessage,
    ViewChange,
};
use tokio::sync::mpsc;
use tokio::time::Instant;

use super::StreamContext;
use super::end::End;
use super::pace::{Due, InputPace};
use crate::access::Refusal;
use crate::clock::unix_now_us;
use crate::frame_loop::interface::{
    FRAMES_IN_FLIGHT_MAX, FrameLoopGone, RenderCommand, ViewRequest,
};
use crate::viewers::Viewer;

/// Reads what the viewer says until the session ends.
pub(super) async fn read(
    stream: &mut SplitStream<WebSocket>,
    answers: mpsc::Sender<ServerMessage>,
    viewer: &Viewer,
    context: &StreamContext,
) -> End {
    let mut inbound = Inbound {
        answers,
        viewer,
        context,
        pace: InputPace::new(Instant::now()),
    };
    match inbound.read(stream).await {
        Ok(never) => match never {},
        Err(end) => end,
    }
}

struct Inbound<'a> {
    answers: mpsc::Sender<ServerMessage>,
    viewer: &'a Viewer,
    context: &'a StreamContext,
    pace: InputPace,
}

impl Inbound<'_> {
    async fn read(
        &mut self,
        stream: &mut SplitStream<WebSocket>,
    ) -> Result<std::convert::Infallible, End> {
        let mut heard = Instant::now();
        loop {
            let stalled_at = heard + self.context.stall;
            let due_at = self.pace.due_at();
            tokio::select! {
                message = stream.next() => {
                    heard = Instant::now();
                    match message {
                        Some(Ok(message)) => self.take(message)?,
                        Some(Err(error)) => return Err(End::of_socket_error(error)),
                        None => return Err(End::PeerGone),
                    }
                }
                // A viewer that reads answers pings, so one that is silent does not read.
                () = tokio::time::sleep_until(stalled_at) => return Err(End::stalled()),
                () = tokio::time::sleep_until(due_at.unwrap_or(stalled_at)), if due_at.is_some() => {}
            }
            self.send_due()?;
        }
    }

    fn take(&mut self, message: Message) -> Result<(), End> {
        match message {
            Message::Text(text) => match ClientMessage::from_json_text(&text) {
                Ok(message) => self.obey(message),
                Err(error) => {
                    self.answer(error.to_message());
                    Ok(())
                }
            },
            Message::Binary(_) => Err(End::binary()),
            Message::Close(_) => Err(End::PeerGone),
            Message::Ping(_) => Ok(()),
            Message::Pong(payload) => {
                self.pong(&payload);
                Ok(())
            }
        }
    }

    fn obey(&mut self, message: ClientMessage) -> Result<(), End> {
        match message {
            ClientMessage::Hello(_) => Err(End::hello_expected("the hello was already said")),
            ClientMessage::Camera(input) => {
                self.viewer.change_view(|view| view.camera = input.camera);
                self.pace.camera(input, Instant::now());
                Ok(())
            }
            ClientMessage::View(change) => {
                self.change_view(change);
                Ok(())
            }
            ClientMessage::Ack(acknowledgement) => self.acknowledge(acknowledgement),
            ClientMessage::KeyFrame => {
                self.viewer.wish_key();
                // A view that rests would have no next picture.
                self.pace.view();
                Ok(())
            }
        }
    }

    fn change_view(&mut self, change: ViewChange) {
        let before = self.viewer.view();
        let allowed = change
            .show_after(before.show, before.codec)
            .and_then(|shown| Ok((change.size_after(before.size, before.stereo)?, shown)));
        let ((size, stereo), (show, codec)) = match allowed {
            Ok(after) => after,
            Err(error) => return self.answer(MessageError::from(error).to_message()),
        };
        let pixels = ViewRequest {
            size,
            stereo,
            ..before
        }
        .picture_size()
        .pixels();
        if let Err(error) = self.viewer.pixels().resize(u64::from(pixels)) {
            self.context.gate.count(Refusal::Pixels);
            return self.answer(ErrorMessage {
                code: ErrorCode::TooManyPixels,
                message: error.to_string(),
                pointer: Some("/width".to_owned()),
            });
        }
        let view = self.viewer.change_view(|view| {
            view.size = size;
            view.stereo = stereo;
            view.fps = change.fps.unwrap_or(view.fps);
            view.codec = codec;
            if let Some(quality) = change.jpeg_quality {
                view.jpeg_quality = quality.get();
            }
            view.quality = change.quality.unwrap_or(view.quality);
            view.show = show;
            view.haze = change.haze.unwrap_or(view.haze);
        });
        self.viewer
            .set_target_kbit_per_s(self.context.video_rate_kbit_per_s(view.picture_size()));
        self.pace.view();
    }

    fn acknowledge(&mut self, acknowledgement: Acknowledgement) -> Result<(), End> {
        let sequence = acknowledgement.sequence;
        let told = {
            let mut figures = self.viewer.figures();
            let last_sent = figures.last_sent();
            if sequence > last_sent {
                drop(figures);
                self.answer(ErrorMessage {
                    code: ErrorCode::BadValue,
                    pointer: Some("/sequence".to_owned()),
                    message: format!("/sequence is {sequence}; the last frame sent is {last_sent}"),
                });
                return Ok(());
            }
            figures.acknowledged(&acknowledgement, self.viewer.clock_us(), unix_now_us())
        };
        self.context.metrics.acknowledged(&told);
        if !told.is_new {
            return Ok(());
        }
        let frames_in_flight_max = {
            let mut rate = self.viewer.rate();
            if let Some(delivery) = told.delivery {
                rate.delivered(delivery, self.viewer.view().fps);
            }
            rate.frames_in_flight_max(FRAMES_IN_FLIGHT_MAX)
        };
        self.send(RenderCommand::Acknowledge {
            viewer: self.viewer.id(),
            sequence,
            frames_in_flight_max,
        })
    }

    /// A ping of the writer's comes back: that is how long the way there and back takes.
    fn pong(&self, payload: &[u8]) {
        if let Some(sent_us) = payload.first_chunk().copied().map(u64::from_le_bytes)
            && let Some(round_trip_us) = self.viewer.clock_us().checked_sub(sent_us)
        {
            self.viewer.rate().round_trip(round_trip_us);
        }
    }

    fn send_due(&mut self) -> Result<(), End> {
        let Due { camera, view } = self.pace.take_due(Instant::now());
        let viewer = self.viewer.id();
        if view {
            let view = self.viewer.view();
            self.send(RenderCommand::SetView { viewer, view })?;
        }
        if let Some((input, arrived)) = camera {
            self.send(RenderCommand::SetCamera {
                viewer,
                input: input.input,
                camera: input.camera,
                arrived: arrived.into_std(),
            })?;
        }
        Ok(())
    }

    fn send(&self, command: RenderCommand) -> Result<(), End> {
        self.context
            .frame_loop
            .send(command)
            .map_err(|error| renderer_gone(error, self.viewer))
    }

    /// Leaves an answer for the writer. A client that provokes more than it reads misses some.
    fn answer(&self, error: ErrorMessage) {
        if self.answers.try_send(ServerMessage::Error(error)).is_err() {
            tracing::debug!(viewer = %self.viewer.id(), "an answer was dropped");
        }
    }
}

/// Logs why the renderer takes no commands, and ends the session.
pub(super) fn renderer_gone(error: FrameLoopGone, viewer: &Viewer) -> End {
    tracing::error!(viewer = %viewer.id(), %error, "a session ends");
    End::internal("the renderer takes no commands")
}
