//! One viewer of a load test: acknowledges without decoding, turns when told to, and counts.

use std::collections::VecDeque;
use std::time::Duration;

use hdrhistogram::Histogram;
use serde::Serialize;
use skycell_protocol::message::{Acknowledgement, Hello};
use skycell_protocol::{InputSequence, ViewerId};
use tokio::sync::{oneshot, watch};
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::ring::ViewerRing;
use crate::unix_time::unix_us_now;
use crate::{ConnectionError, ConnectionLimits, Event, Frame, ServerAddress, Session};

/// Inputs whose frames have not come; a server that is this far behind shows it in the frame age.
const INPUTS_IN_FLIGHT_MAX: usize = 1024;
const LONGEST_TIME_US: u64 = 600_000_000;

/// What all viewers of a crowd do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// Look where the ring has placed them.
    Hold,
    /// Turn, all together.
    Turn {
        /// Since when.
        begun: Instant,
        /// To the right.
        speed_deg_per_s: f64,
    },
    /// Say goodbye.
    Leave,
}

/// A viewer's place in the ring.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) ring: ViewerRing,
    pub(super) number: u32,
    pub(super) overlap: f64,
    /// It decodes frames before it acknowledges them.
    pub(super) decodes: bool,
}

/// Quantiles of times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TimesMs {
    /// Half of them are shorter.
    pub p50: f64,
    /// 95 % are shorter.
    pub p95: f64,
    /// The longest.
    pub max: f64,
}

impl TimesMs {
    pub(super) fn of(histogram: &Histogram<u64>) -> Self {
        let ms = |us: u64| us as f64 / 1000.0;
        Self {
            p50: ms(histogram.value_at_quantile(0.5)),
            p95: ms(histogram.value_at_quantile(0.95)),
            max: ms(histogram.max()),
        }
    }
}

/// What a viewer has seen.
#[derive(Clone, Debug, Serialize)]
pub struct ViewerFigures {
    /// Its number at the server.
    pub viewer: ViewerId,
    /// From the first packet to the first picture.
    pub first_frame_ms: Option<f64>,
    /// Frames received, standing and turning.
    pub frames: u64,
    /// How often the connection was lost and came back.
    pub reconnects: u32,
    /// Only while turning.
    pub turning: Option<TurningFigures>,
}

/// What a viewer has seen while it turned.
#[derive(Clone, Debug, Serialize)]
pub struct TurningFigures {
    /// For how long.
    pub seconds: f64,
    /// Frames received.
    pub frames: u64,
    /// Frames received per second.
    pub fps: f64,
    /// Received, in 10^6 bits.
    pub mbit_per_s: f64,
    /// From submitting the composite to its arrival, by the clocks of the two machines.
    pub frame_age_ms: TimesMs,
    /// From sending a camera to the arrival of the first frame that shows it or a later one.
    pub latency_ms: TimesMs,
    /// From sending a camera until the first frame that shows it or a later one was decoded, if frames are, and shown.
    pub motion_to_photon_ms: TimesMs,
    /// The longest time without a frame.
    pub longest_gap_ms: f64,
    /// Every frame's age, for quantiles over several viewers.
    #[serde(skip)]
    pub(super) ages_us: Histogram<u64>,
    /// Every input's time until it was shown, likewise.
    #[serde(skip)]
    pub(super) motions_us: Histogram<u64>,
}

/// Connects, tells its number, and does what `phase` says until that is [`Phase::Leave`].
pub(super) async fn run_viewer(
    address: ServerAddress,
    hello: Hello,
    place: Place,
    mut phase: watch::Receiver<Phase>,
    joined: oneshot::Sender<ViewerId>,
) -> Result<ViewerFigures, ConnectionError> {
    let begun = Instant::now();
    let fps = hello.fps;
    let mut connection = Session::open(&address, hello, ConnectionLimits::default()).await?;
    let viewer = connection.welcome().viewer;
    // A crowd that is gone has dropped the phase as well.
    let _ = joined.send(viewer);
    let mut figures = ViewerFigures {
        viewer,
        first_frame_ms: None,
        frames: 0,
        reconnects: 0,
        turning: None,
    };
    let mut turning: Option<Turning> = None;
    let mut inputs = interval(Duration::from_secs_f64(1.0 / fps));
    inputs.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        tokio::select! {
            changed = phase.changed() => {
                let now = if changed.is_ok() { *phase.borrow_and_update() } else { Phase::Leave };
                if let Some(ended) = turning.take() {
                    figures.turning = Some(ended.figures());
                }
                match now {
                    Phase::Hold => {}
                    Phase::Turn { begun, speed_deg_per_s } => turning = Some(Turning::new(begun, speed_deg_per_s)),
                    Phase::Leave => break,
                }
            }
            _ = inputs.tick(), if turning.is_some() => {
                if let Some(turning) = &mut turning {
                    let camera = place.ring.camera(place.number, place.overlap, turning.angle_deg());
                    // The server may have it before this task is told that it was sent.
                    let at = Instant::now();
                    turning.sent(connection.send_camera(camera).await?, at);
                }
            }
            event = connection.next_event() => match event? {
                Event::Frame(frame) => {
                    figures.frames += 1;
                    figures.first_frame_ms.get_or_insert(begun.elapsed().as_secs_f64() * 1000.0);
                    let input_sent = turning.as_mut().and_then(|turning| turning.received(&frame));
                    let decode_us = if place.decodes { Some(decode(&frame).await) } else { None };
                    let motion = input_sent.map(|sent| sent.elapsed());
                    if let (Some(turning), Some(motion)) = (&mut turning, motion) {
                        turning.motions_us.saturating_record(micros(motion));
                    }
                    connection.acknowledge(Acknowledgement {
                        decode_us,
                        received_us: Some(frame.received_unix_us),
                        present_us: Some(unix_us_now()),
                        motion_to_photon_us: motion.map(|motion| u32::try_from(micros(motion)).unwrap_or(u32::MAX)),
                        ..Acknowledgement::of(frame.header.sequence)
                    }).await?;
                }
                Event::Resumed => {
                    figures.reconnects = connection.reconnects();
                    if let Some(turning) = &mut turning {
                        // Their frames will not come.
                        turning.inputs.clear();
                    }
                }
                Event::Complaint(complaint) => return Err(ConnectionError::Refused(complaint)),
                _ => {}
            },
        }
    }
    connection.close().await;
    Ok(figures)
}

/// The counts of a turning phase while it lasts.
struct Turning {
    begun: Instant,
    speed_deg_per_s: f64,
    inputs: VecDeque<(InputSequence, Instant)>,
    last_frame: Instant,
    longest_gap: Duration,
    frames: u64,
    bytes: u64,
    ages_us: Histogram<u64>,
    latencies_us: Histogram<u64>,
    motions_us: Histogram<u64>,
}

impl Turning {
    fn new(begun: Instant, speed_deg_per_s: f64) -> Self {
        Self {
            begun,
            speed_deg_per_s,
            inputs: VecDeque::new(),
            last_frame: begun,
            longest_gap: Duration::ZERO,
            frames: 0,
            bytes: 0,
            ages_us: times_histogram(),
            latencies_us: times_histogram(),
            motions_us: times_histogram(),
        }
    }

    fn angle_deg(&self) -> f64 {
        self.begun.elapsed().as_secs_f64() * self.speed_deg_per_s
    }

    fn sent(&mut self, input: InputSequence, at: Instant) {
        if self.inputs.len() >= INPUTS_IN_FLIGHT_MAX {
            self.inputs.pop_front();
        }
        self.inputs.push_back((input, at));
    }

    /// Counts a frame; returns when the input was sent that it is the first to show.
    fn received(&mut self, frame: &Frame) -> Option<Instant> {
        let now = Instant::now();
        self.frames += 1;
        self.bytes += frame.message_bytes() as u64;
        self.longest_gap = self.longest_gap.max(now - self.last_frame);
        self.last_frame = now;
        self.ages_us.saturating_record(micros(frame.age()));
        let mut shown_since = None;
        while let Some(&(input, sent)) = self.inputs.front() {
            if input > frame.header.input {
                break;
            }
            shown_since = Some(sent);
            self.inputs.pop_front();
        }
        if let Some(sent) = shown_since {
            self.latencies_us.saturating_record(micros(now - sent));
        }
        shown_since
    }

    fn figures(self) -> TurningFigures {
        let seconds = self.begun.elapsed().as_secs_f64();
        TurningFigures {
            seconds,
            frames: self.frames,
            fps: self.frames as f64 / seconds,
            mbit_per_s: self.bytes as f64 * 8.0 / 1e6 / seconds,
            frame_age_ms: TimesMs::of(&self.ages_us),
            latency_ms: TimesMs::of(&self.latencies_us),
            motion_to_photon_ms: TimesMs::of(&self.motions_us),
            longest_gap_ms: self
                .longest_gap
                .max(self.last_frame.elapsed())
                .as_secs_f64()
                * 1000.0,
            ages_us: self.ages_us,
            motions_us: self.motions_us,
        }
    }
}

/// Decodes a frame as a client would that shows it, and tells how long that took, µs. A broken one is the server's affair.
async fn decode(frame: &Frame) -> u32 {
    let begun = Instant::now();
    let frame = frame.clone();
    let decoding = tokio::task::spawn_blocking(move || {
        let _ = crate::picture::decode(&frame.header, frame.payload());
    });
    let _ = decoding.await;
    u32::try_from(micros(begun.elapsed())).unwrap_or(u32::MAX)
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

/// Times from 1 µs to 10 minutes, to 1 %.
pub(super) fn times_histogram() -> Histogram<u64> {
    match Histogram::new_with_max(LONGEST_TIME_US, 2) {
        Ok(histogram) => histogram,
        // Only bounds below 2 or more than 5 digits are refused.
        Err(error) => unreachable!("{error}"),
    }
}
