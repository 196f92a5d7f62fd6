//! Pixels become pictures: a bounded pool of threads, at most one job per viewer.

mod codec;
#[cfg(test)]
mod tests;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

use skycell_protocol::{Codec, FrameHeader, FrameStages};

pub use codec::{EncodeError, check_codec, encode_after, encode_clouds_after};

use crate::clock::saturating_us;
use crate::frame_loop::interface::{FinishedFrame, FrameSink};
use crate::metrics::Metrics;
use crate::viewers::{EncodedFrame, Viewer, ViewerRegistry};
use skycell_protocol::frame::FRAME_HEADER_BYTES;

/// Takes finished frames from the frame loop and leaves encoded ones with their viewers.
pub struct EncoderPool {
    viewers: Arc<ViewerRegistry>,
    metrics: Arc<Metrics>,
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
            threads,
        }))
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
            let metrics = Arc::clone(&self.metrics);
            self.threads
                .spawn_fifo(move || encode_waiting(viewer, metrics));
        }
    }
}

/// Encodes the frame that waits for the viewer, then queues behind the other viewers for the next.
fn encode_waiting(viewer: Arc<Viewer>, metrics: Arc<Metrics>) {
    let Some(frame) = viewer.take_for_encoding() else {
        return;
    };
    // A panic in a codec must not end the pool, and the viewer must hear of it.
    let result = catch_unwind(AssertUnwindSafe(|| encode(frame, &metrics)));
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
    rayon::spawn_fifo(move || encode_waiting(viewer, metrics));
}

fn count_drop(viewer: &Viewer, metrics: &Metrics) {
    viewer.figures().frames_dropped += 1;
    metrics.frames_dropped.increment(1);
}

fn encode(frame: FinishedFrame, metrics: &Metrics) -> Result<EncodedFrame, EncodeError> {
    let started = Instant::now();
    let waited = started.saturating_duration_since(frame.read_back);
    metrics.encode_wait_s.record(waited);
    let mut message = vec![0; FRAME_HEADER_BYTES];
    let pixels = frame.pixels.rgba();
    match &frame.clouds {
        Some(header) => encode_clouds_after(&mut message, pixels, header)?,
        None => encode_after(
            &mut message,
            pixels,
            frame.size,
            frame.codec,
            frame.jpeg_quality,
        )?,
    }
    let encoded = Instant::now();
    let encode_time = encoded.saturating_duration_since(started);
    match frame.codec {
        Codec::Jpeg => metrics.encode_jpeg_s.record(encode_time),
        Codec::Png => metrics.encode_png_s.record(encode_time),
        // No encoder makes it.
        Codec::H264 => {}
        Codec::Clouds => metrics.encode_clouds_s.record(encode_time),
    }
    let header = FrameHeader {
        codec: frame.codec.into(),
        heartbeat: false,
        coarse: frame.coarse,
        stereo: frame.stereo,
        // Each picture is whole.
        key: true,
        exact: frame.exact,
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
        target_kbit_per_s: 0,
    };
    Ok(EncodedFrame::new(header, message, encoded))
}
