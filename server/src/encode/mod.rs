//! Pixels become pictures: a bounded pool of threads, at most one job per viewer.
//!
//! JPEG and PNG are single pictures (`codec`). A video (`video`) is a stream whose pictures build on one another, so none of
//! it may be lost once it is encoded: while an encoded picture still waits for the socket, the next stays in pixels, where a
//! newer one replaces it.

mod codec;
pub mod colours;
pub mod h264;
pub mod i420;
mod stream;
#[cfg(test)]
mod tests;
pub mod video;
#[cfg(test)]
mod video_tests;

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use skycell_protocol::{Codec, ColourScale, FrameHeader, FrameStages};

pub use codec::{EncodeError, encode_after, encode_clouds_after, encode_exr_after, exr_of};
pub use stream::{StreamPicture, ViewerStream};

use crate::clock::saturating_us;
use crate::frame_loop::interface::{FinishedFrame, FrameSink, Refinement};
use crate::metrics::Metrics;
use crate::viewers::{EncodedFrame, Viewer, ViewerRegistry};
use skycell_protocol::frame::FRAME_HEADER_BYTES;

/// Viewers whose frames wait for an encoder, in the order in which they are served.
type Turns = Arc<Mutex<VecDeque<Arc<Viewer>>>>;

/// The exact picture of a view that rests may keep a line busy for this long that carries no more than the video's rate:
/// whoever turns meanwhile waits for it. It has about a second's worth of the full rate.
const EXACT_MAX_S: f64 = 2.0;

/// Takes finished frames from the frame loop and leaves encoded ones with their viewers.
pub struct EncoderPool {
    viewers: Arc<ViewerRegistry>,
    metrics: Arc<Metrics>,
    turns: Turns,
    threads: rayon::ThreadPool,
}

impl EncoderPool {
    /// A pool of `threads` threads.
    ///
    /// # Errors
    /// If the system gives no threads.
    pub fn new(
        threads: u32,
        viewers: Arc<ViewerRegistry>,
        metrics: Arc<Metrics>,
    ) -> Result<Arc<Self>, rayon::ThreadPoolBuildError> {
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.max(1) as usize)
            .thread_name(|index| format!("encode-{index}"))
            .build()?;
        Ok(Arc::new(Self {
            viewers,
            metrics,
            turns: Turns::default(),
            threads,
        }))
    }

    /// Goes on with a viewer whose next frame waited until its socket had taken the one before.
    pub fn go_on(&self, viewer: &Arc<Viewer>) {
        if viewer.resumes_encoding() {
            self.start(Arc::clone(viewer));
        }
    }

    fn start(&self, viewer: Arc<Viewer>) {
        queue(&self.turns, viewer);
        let (turns, metrics) = (Arc::clone(&self.turns), Arc::clone(&self.metrics));
        self.threads.spawn_fifo(move || serve_next(turns, metrics));
    }
}

impl FrameSink for EncoderPool {
    fn deliver(&self, frame: FinishedFrame) {
        let Some(viewer) = self.viewers.get(frame.viewer) else {
            return;
        };
        let (replaced, needs_job) = viewer.offer(frame);
        if replaced.is_some() {
            count_drop(&viewer, &self.metrics);
        }
        if needs_job {
            self.start(viewer);
        }
    }
}

/// Puts a viewer behind all others. Its place in the queue is its job, of which it has one at most, so the queue is no
/// longer than there are viewers.
fn queue(turns: &Turns, viewer: Arc<Viewer>) {
    turns
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .push_back(viewer);
}

/// Encodes the frame of the viewer whose turn it is, who then queues behind all others. Turns are kept here and not by
/// the pool's threads: each of those would take its own viewers first.
fn serve_next(turns: Turns, metrics: Arc<Metrics>) {
    let next = turns
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .pop_front();
    let Some(viewer) = next else {
        return;
    };
    let Some(frame) = viewer.take_for_encoding() else {
        return;
    };
    // A panic in a codec must not end the pool, and the viewer must hear of it.
    let result = catch_unwind(AssertUnwindSafe(|| encode(frame, &viewer, &metrics)));
    match result {
        Ok(Ok(encoded)) => {
            if viewer.outbox().put(encoded).is_some() {
                count_drop(&viewer, &metrics);
            }
        }
        Ok(Err(error)) => {
            tracing::error!(viewer = %viewer.id(), %error, "a frame could not be encoded");
            viewer.fail();
        }
        Err(_) => {
            tracing::error!(viewer = %viewer.id(), "the encoder panicked");
            viewer.fail();
        }
    }
    queue(&turns, viewer);
    rayon::spawn_fifo(move || serve_next(turns, metrics));
}

fn count_drop(viewer: &Viewer, metrics: &Metrics) {
    viewer.figures().frames_dropped += 1;
    metrics.frames_dropped.increment(1);
}

/// Quality of a JPEG of that frame.
fn jpeg_quality(frame: &FinishedFrame, viewer: &Viewer) -> u8 {
    if frame.refines {
        // The link has been quiet: it may take its time.
        frame.jpeg_quality
    } else {
        viewer.rate().jpeg_quality(frame.jpeg_quality)
    }
}

/// What was made of a frame.
struct Made {
    codec: Codec,
    is_key: bool,
    is_exact: bool,
    target_kbit_per_s: u32,
    colours: Option<ColourScale>,
}

fn encode(
    frame: FinishedFrame,
    viewer: &Viewer,
    metrics: &Metrics,
) -> Result<EncodedFrame, EncodeError> {
    let started = Instant::now();
    let waited = started.saturating_duration_since(frame.read_back);
    metrics.encode_wait_s.record(waited);
    let quality = jpeg_quality(&frame, viewer);
    let is_reduced = frame.codec == Codec::Jpeg && quality < frame.jpeg_quality;
    let mut message = vec![0; FRAME_HEADER_BYTES];
    let made = if frame.codec.is_stream() {
        encode_stream(viewer, &frame, started, &mut message)?
    } else {
        viewer.stream().end();
        let pixels = frame.pixels.rgba();
        match &frame.clouds {
            Some(header) => encode_clouds_after(&mut message, pixels, header)?,
            None if frame.linear => encode_exr_after(&mut message, pixels, frame.size)?,
            None => encode_after(&mut message, pixels, frame.size, frame.codec, quality)?,
        }
        let mut rate = viewer.rate();
        if frame.codec == Codec::Jpeg && !frame.refines {
            rate.jpeg_encoded(message.len(), viewer.view().fps, viewer.clock_us());
        }
        Made {
            codec: frame.codec,
            is_key: true,
            is_exact: frame.exact && !is_reduced,
            target_kbit_per_s: rate.target_kbit_per_s().unwrap_or(0),
            colours: None,
        }
    };
    let encoded = Instant::now();
    let encode_time = encoded.saturating_duration_since(started);
    metrics.frames_encoded.fetch_add(1, Ordering::Relaxed);
    match made.codec {
        // No codec of viewers.
        _ if frame.linear => {}
        Codec::Jpeg => metrics.encode_jpeg_s.record(encode_time),
        Codec::Png => metrics.encode_png_s.record(encode_time),
        Codec::H264 => metrics.encode_h264_s.record(encode_time),
        Codec::Clouds => metrics.encode_clouds_s.record(encode_time),
    }
    let header = FrameHeader {
        codec: made.codec.into(),
        heartbeat: false,
        coarse: frame.coarse,
        stereo: frame.stereo,
        key: made.is_key,
        exact: made.is_exact,
        sequence: frame.sequence,
        // At most 3840 and 2160.
        width: frame.size.width() as u16,
        height: frame.size.height() as u16,
        scene_revision: frame.scene_revision,
        input: frame.input,
        cell: frame.cell,
        viewer: frame.viewer,
        render_unix_us: frame.submitted_unix_us,
        stages: FrameStages {
            encode_wait_us: saturating_us(waited),
            encode_us: saturating_us(encode_time),
            ..frame.stages
        },
        payload_bytes: u32::try_from(message.len() - FRAME_HEADER_BYTES)
            .map_err(|_| EncodeError::TooLong(message.len()))?,
        target_kbit_per_s: made.target_kbit_per_s,
        colours: made.colours,
    };
    Ok(EncodedFrame::new(header, message, encoded, is_reduced))
}

fn encode_picture(
    frame: &FinishedFrame,
    codec: Codec,
    message: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    let rgba = frame.pixels.rgba();
    encode_after(message, rgba, frame.size, codec, frame.jpeg_quality)
}

/// The next picture of a viewer's stream; the last one of a view that rests is an exact one beside it, where the line has it
/// soon.
fn encode_stream(
    viewer: &Viewer,
    frame: &FinishedFrame,
    now: Instant,
    message: &mut Vec<u8>,
) -> Result<Made, EncodeError> {
    // What its size asks for, or less where the line takes less.
    let link_kbit_per_s = viewer.rate().target_kbit_per_s();
    let target_kbit_per_s = link_kbit_per_s.map_or(viewer.target_kbit_per_s(), |link| {
        link.min(viewer.target_kbit_per_s())
    });
    let is_last = frame.refinement == Refinement::Last;
    if is_last {
        encode_picture(frame, Codec::Png, message)?;
        let kbit = (message.len() - FRAME_HEADER_BYTES) as f64 * 8e-3;
        if kbit <= f64::from(target_kbit_per_s) * EXACT_MAX_S {
            return Ok(Made {
                codec: Codec::Png,
                is_key: true,
                is_exact: true,
                target_kbit_per_s,
                colours: None,
            });
        }
        message.truncate(FRAME_HEADER_BYTES);
    }
    let picture = StreamPicture {
        rgba: frame.pixels.rgba(),
        size: frame.size,
        codec: frame.codec,
        target_kbit_per_s,
        fps_max: viewer.view().fps as f32,
        scales_colours: viewer.scales_colours(),
        is_pair: frame.stereo,
    };
    let mut wants_key = viewer.takes_key_wish();
    let unit = viewer
        .stream()
        .encode(&picture, &mut wants_key, now, message);
    let unit = match unit {
        Ok(unit) => unit,
        Err(error) => {
            // OpenH264 has no room for pictures of nothing but noise. The next picture begins the stream anew.
            tracing::warn!(viewer = %viewer.id(), %error, "a picture of a video is sent as JPEG");
            message.truncate(FRAME_HEADER_BYTES);
            encode_picture(frame, Codec::Jpeg, message)?;
            return Ok(Made {
                codec: Codec::Jpeg,
                is_key: true,
                is_exact: is_last,
                target_kbit_per_s,
                colours: None,
            });
        }
    };
    if wants_key {
        viewer.wish_key();
    }
    Ok(Made {
        codec: frame.codec,
        is_key: unit.is_key,
        // Nothing finer comes, though it is not the very picture.
        is_exact: is_last,
        target_kbit_per_s,
        colours: unit.colours,
    })
}
