//! One connected viewer, as its socket, the encoders and the API share it.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use bytes::Bytes;
use skycell_protocol::frame::FRAME_HEADER_BYTES;
use skycell_protocol::{FrameHeader, FrameSequence, ViewerId};
use tokio::sync::Notify;

use super::figures::ViewerFigures;
use super::pixels::PixelShare;
use super::rate::RateControl;
use super::slot::LatestSlot;
use crate::clock::saturating_us;
use crate::encode::ViewerStream;
use crate::encode::video::full_rate_kbit_per_s;
use crate::frame_loop::interface::{FinishedFrame, ViewRequest};

/// A frame that waits to be sent.
#[derive(Debug)]
pub struct EncodedFrame {
    header: FrameHeader,
    /// Room for the header, then the payload, so that sending copies nothing.
    message: Vec<u8>,
    encoded: Instant,
    /// It is not as good as the viewer wishes, because its link does not take that.
    is_reduced: bool,
}

impl EncodedFrame {
    /// A frame whose `message` has [`FRAME_HEADER_BYTES`] bytes of room before the payload.
    /// `is_reduced`: it is not as good as the viewer wishes, because its link does not take that.
    pub fn new(header: FrameHeader, message: Vec<u8>, encoded: Instant, is_reduced: bool) -> Self {
        debug_assert!(message.len() >= FRAME_HEADER_BYTES);
        Self {
            header,
            message,
            encoded,
            is_reduced,
        }
    }

    /// Its number.
    pub fn sequence(&self) -> FrameSequence {
        self.header.sequence
    }

    /// Whether it is not as good as the viewer wishes, because its link does not take that.
    pub fn is_reduced(&self) -> bool {
        self.is_reduced
    }

    /// The finished message and its header, which tells how long the frame waited until `now`.
    pub fn into_message(mut self, now: Instant) -> (FrameHeader, Bytes) {
        self.header.stages.encode_to_send_us =
            saturating_us(now.saturating_duration_since(self.encoded));
        if let Some(room) = self.message.first_chunk_mut::<FRAME_HEADER_BYTES>() {
            *room = self.header.encode();
        }
        (self.header, Bytes::from(self.message))
    }
}

/// What waits for an encoder: at most one frame and at most one job.
#[derive(Default)]
struct EncoderInbox {
    frame: Option<FinishedFrame>,
    has_job: bool,
    is_closed: bool,
}

/// One connected viewer. All that waits for it is one frame in pixels and one encoded frame.
pub struct Viewer {
    id: ViewerId,
    connected: Instant,
    view: Mutex<ViewRequest>,
    inbox: Mutex<EncoderInbox>,
    figures: Mutex<ViewerFigures>,
    rate: Mutex<RateControl>,
    outbox: LatestSlot<EncodedFrame>,
    failed: Notify,
    pixels: PixelShare,
    /// Of the viewer's one job; nobody else waits for it.
    stream: Mutex<ViewerStream>,
    wants_key: AtomicBool,
    target_kbit_per_s: AtomicU32,
    scales_colours: AtomicBool,
}

impl Viewer {
    pub(super) fn new(id: ViewerId, view: ViewRequest, pixels: PixelShare) -> Self {
        Self {
            id,
            connected: Instant::now(),
            view: Mutex::new(view),
            inbox: Mutex::default(),
            figures: Mutex::default(),
            rate: Mutex::default(),
            outbox: LatestSlot::default(),
            failed: Notify::new(),
            pixels,
            stream: Mutex::default(),
            wants_key: AtomicBool::new(false),
            target_kbit_per_s: AtomicU32::new(full_rate_kbit_per_s(view.picture_size())),
            scales_colours: AtomicBool::new(false),
        }
    }

    /// The viewer's number.
    pub fn id(&self) -> ViewerId {
        self.id
    }

    /// When it said hello.
    pub fn connected(&self) -> Instant {
        self.connected
    }

    /// What it wants now.
    pub fn view(&self) -> ViewRequest {
        *lock(&self.view)
    }

    /// Changes what it wants and returns the whole.
    pub fn change_view(&self, change: impl FnOnce(&mut ViewRequest)) -> ViewRequest {
        let mut view = lock(&self.view);
        change(&mut view);
        *view
    }

    /// Its share of the pixels of all frames.
    pub fn pixels(&self) -> &PixelShare {
        &self.pixels
    }

    /// What it was sent.
    pub fn figures(&self) -> MutexGuard<'_, ViewerFigures> {
        lock(&self.figures)
    }

    /// What its link takes.
    pub fn rate(&self) -> MutexGuard<'_, RateControl> {
        lock(&self.rate)
    }

    /// A clock for [`super::SentFrame`] and [`super::Delivery`]: µs since it said hello.
    pub fn clock_us(&self) -> u64 {
        u64::try_from(self.connected.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    /// The encoded frame that is to be sent next.
    pub fn outbox(&self) -> &LatestSlot<EncodedFrame> {
        &self.outbox
    }

    /// Leaves a frame to be encoded, in the place of one that still waits. Returns the frame that
    /// was replaced, and whether a job has to be started that takes this one.
    pub fn offer(&self, frame: FinishedFrame) -> (Option<FinishedFrame>, bool) {
        let mut inbox = lock(&self.inbox);
        if inbox.is_closed {
            // Nobody is there to see it; given back so that its buffer is freed outside the lock.
            return (Some(frame), false);
        }
        let replaced = inbox.frame.replace(frame);
        let needs_job = !inbox.has_job;
        inbox.has_job = true;
        (replaced, needs_job)
    }

    /// Whether a frame waits to be encoded.
    pub fn has_waiting_frame(&self) -> bool {
        lock(&self.inbox).frame.is_some()
    }

    /// Takes the frame that waits to be encoded. With none left, the job is over; and when the frame is of a video and the one
    /// before has not been sent yet, which must not be replaced once it is encoded.
    pub fn take_for_encoding(&self) -> Option<FinishedFrame> {
        let mut inbox = lock(&self.inbox);
        let waits = inbox.frame.as_ref().is_some_and(|f| f.codec.is_stream());
        let frame = if waits && self.outbox.is_full() {
            None
        } else {
            inbox.frame.take()
        };
        if frame.is_none() {
            inbox.has_job = false;
        }
        frame
    }

    /// Whether a job has to be started because a frame waited until the one before was sent.
    pub fn resumes_encoding(&self) -> bool {
        let mut inbox = lock(&self.inbox);
        let resumes = inbox.frame.is_some() && !inbox.has_job;
        inbox.has_job |= resumes;
        resumes
    }

    /// Its video.
    pub fn stream(&self) -> MutexGuard<'_, ViewerStream> {
        lock(&self.stream)
    }

    /// Says that the next picture of its video is to need no earlier one.
    pub fn wish_key(&self) {
        self.wants_key.store(true, Ordering::Release);
    }

    /// Whether that was said; the wish is then forgotten.
    pub fn takes_key_wish(&self) -> bool {
        self.wants_key.swap(false, Ordering::AcqRel)
    }

    /// The rate that its video aims at, kbit/s.
    pub fn target_kbit_per_s(&self) -> u32 {
        self.target_kbit_per_s.load(Ordering::Acquire)
    }

    /// Sets the rate that its video aims at.
    pub fn set_target_kbit_per_s(&self, kbit_per_s: u32) {
        self.target_kbit_per_s.store(kbit_per_s, Ordering::Release);
    }

    /// Whether it puts a video's colours back that were spread.
    pub fn scales_colours(&self) -> bool {
        self.scales_colours.load(Ordering::Acquire)
    }

    /// Says whether it does.
    pub fn set_scales_colours(&self, does: bool) {
        self.scales_colours.store(does, Ordering::Release);
    }

    /// Lets go of what waits and takes nothing more.
    pub fn close(&self) {
        let waiting = {
            let mut inbox = lock(&self.inbox);
            inbox.is_closed = true;
            inbox.frame.take()
        };
        drop(waiting);
        drop(self.outbox.take());
    }

    /// Says that a frame was lost in a way that the viewer cannot recover from.
    pub fn fail(&self) {
        self.failed.notify_one();
    }

    /// Waits until [`Viewer::fail`].
    pub async fn failure(&self) {
        self.failed.notified().await;
    }
}

/// Nothing that these locks guard can be left half changed, so a panic elsewhere spoils nothing.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
