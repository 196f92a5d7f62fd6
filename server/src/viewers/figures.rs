//! What a viewer was sent, how fast, and how old it was when the viewer had it.

use std::collections::VecDeque;

use skycell_protocol::FrameSequence;
use skycell_protocol::message::Acknowledgement;

use super::latency::{Latencies, Percentiles, RecentTimes, Stage};
use super::rate::Delivery;

/// How many of the latest frames percentiles are taken from: about ten seconds' worth.
const TIMES_MAX: usize = 256;

/// How many sent frames may wait for their acknowledgement. The window lets two be in flight; the
/// rest is slack for a frame loop with a wider one.
const UNACKNOWLEDGED_MAX: usize = 8;

/// Sums and recent figures of one viewer.
#[derive(Clone, Debug)]
pub struct ViewerFigures {
    /// Frames handed to the socket.
    pub frames_sent: u64,
    /// Frames replaced by newer ones before they were encoded or sent.
    pub frames_dropped: u64,
    /// Bytes of messages handed to the socket.
    pub bytes_sent: u64,
    /// Frames sent in the last second.
    pub fps: f64,
    /// Sent in the last second, in 10^6 bits.
    pub mbit_per_s: f64,
    /// How long the client took to decode the frame that it acknowledged last.
    pub decode_us: Option<u32>,
    /// Times of each stage of frames' ways.
    pub latencies: Latencies,
    last_sent: FrameSequence,
    last_acknowledged: FrameSequence,
    unacknowledged: VecDeque<SentFrame>,
    ages_us: RecentTimes,
    rate_start: RateStart,
}

/// A frame that is handed to the socket.
#[derive(Clone, Copy, Debug)]
pub struct SentFrame {
    /// Its number.
    pub sequence: FrameSequence,
    /// When its composite was submitted, by the wall clock.
    pub render_unix_us: u64,
    /// Now, by a clock that only goes forward.
    pub sent_us: u64,
    /// Bytes of its message.
    pub bytes: u64,
}

/// What an acknowledgement tells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Acknowledged {
    /// Something that was not acknowledged before is now.
    pub is_new: bool,
    /// How old the frame is, from its submission on, if it is still known.
    pub age_us: Option<u64>,
    /// What has arrived with it, if the frame is still known.
    pub delivery: Option<Delivery>,
    /// Times of the stages behind the socket, as far as the client tells them.
    pub stages: Vec<(Stage, u64)>,
}

/// Sums at the start of the second that rates are taken over.
#[derive(Clone, Copy, Debug, Default)]
struct RateStart {
    frames_sent: u64,
    bytes_sent: u64,
}

impl Default for ViewerFigures {
    fn default() -> Self {
        Self {
            frames_sent: 0,
            frames_dropped: 0,
            bytes_sent: 0,
            fps: 0.0,
            mbit_per_s: 0.0,
            decode_us: None,
            latencies: Latencies::new(TIMES_MAX),
            last_sent: FrameSequence(0),
            last_acknowledged: FrameSequence(0),
            unacknowledged: VecDeque::new(),
            ages_us: RecentTimes::new(TIMES_MAX),
            rate_start: RateStart::default(),
        }
    }
}

impl ViewerFigures {
    /// Counts a frame that is about to be handed to the socket.
    pub fn sent_frame(&mut self, frame: SentFrame) {
        self.frames_sent += 1;
        self.last_sent = frame.sequence;
        if self.unacknowledged.len() == UNACKNOWLEDGED_MAX {
            self.unacknowledged.pop_front();
        }
        self.unacknowledged.push_back(frame);
    }

    /// The last frame sent; 0 if none.
    pub fn last_sent(&self) -> FrameSequence {
        self.last_sent
    }

    /// Takes an acknowledgement, with the clock of [`SentFrame::sent_us`] and the wall clock.
    pub fn acknowledged(
        &mut self,
        acknowledgement: &Acknowledgement,
        now_us: u64,
        now_unix_us: u64,
    ) -> Acknowledged {
        let sequence = acknowledgement.sequence;
        if sequence <= self.last_acknowledged {
            return Acknowledged::default();
        }
        self.last_acknowledged = sequence;
        self.decode_us = acknowledgement.decode_us.or(self.decode_us);
        let mut told = Acknowledged {
            is_new: true,
            ..Acknowledged::default()
        };
        let (mut bytes, mut known) = (0, None);
        while let Some(frame) = self.unacknowledged.front()
            && frame.sequence <= sequence
        {
            bytes += frame.bytes;
            known = (frame.sequence == sequence).then_some(*frame);
            self.unacknowledged.pop_front();
        }
        let held_us = held_us(acknowledgement);
        if let Some(frame) = known {
            told.age_us = Some(now_unix_us.saturating_sub(frame.render_unix_us));
            let delivery = Delivery {
                bytes,
                sent_us: frame.sent_us,
                acknowledged_us: now_us,
                held_us,
            };
            told.delivery = Some(delivery);
            let network_us = delivery.since_sent_us();
            told.stages.push((Stage::Network, network_us));
        }
        if let Some(decode_us) = acknowledgement.decode_us.map(u64::from) {
            told.stages.push((Stage::Decode, decode_us));
            if acknowledgement.received_us.is_some() && acknowledgement.present_us.is_some() {
                let present_us = held_us.saturating_sub(decode_us);
                told.stages.push((Stage::Present, present_us));
            }
        }
        if let Some(motion_us) = acknowledgement.motion_to_photon_us {
            told.stages.push((Stage::MotionToPhoton, motion_us.into()));
        }
        if let Some(age_us) = told.age_us {
            self.ages_us.push(age_us);
        }
        for (stage, time_us) in &told.stages {
            self.latencies.push(*stage, *time_us);
        }
        told
    }

    /// Ends a stretch of `elapsed_s` over which rates are taken, and starts the next.
    pub fn take_rates(&mut self, elapsed_s: f64) {
        // A clock that stands still would divide by nothing.
        let elapsed_s = elapsed_s.max(1.0e-3);
        self.fps = (self.frames_sent - self.rate_start.frames_sent) as f64 / elapsed_s;
        self.mbit_per_s =
            (self.bytes_sent - self.rate_start.bytes_sent) as f64 * 8.0e-6 / elapsed_s;
        self.rate_start = RateStart {
            frames_sent: self.frames_sent,
            bytes_sent: self.bytes_sent,
        };
    }

    /// How old recent frames were when their acknowledgements came, from the composite's submission on, so with the way
    /// there and back; none before the first.
    pub fn frame_age(&self) -> Option<Percentiles> {
        self.ages_us.percentiles()
    }
}

/// How long the client had the frame before it acknowledged it, by its own clock; no longer than it can have had it.
fn held_us(acknowledgement: &Acknowledgement) -> u64 {
    match (acknowledgement.received_us, acknowledgement.present_us) {
        (Some(received_us), Some(present_us)) => present_us.saturating_sub(received_us),
        _ => acknowledgement.decode_us.unwrap_or(0).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(sequence: u32, at_us: u64) -> SentFrame {
        SentFrame {
            sequence: FrameSequence(sequence),
            render_unix_us: 1_000_000 + at_us,
            sent_us: at_us + 100,
            bytes: 1_000 + u64::from(sequence),
        }
    }

    fn acknowledge(figures: &mut ViewerFigures, sequence: u32, at_us: u64) -> Acknowledged {
        let acknowledgement = Acknowledgement::of(FrameSequence(sequence));
        figures.acknowledged(&acknowledgement, at_us, 1_000_000 + at_us)
    }

    #[test]
    fn an_acknowledgement_covers_every_earlier_frame_and_counts_once() {
        let mut figures = ViewerFigures::default();
        figures.sent_frame(sent(1, 1_000));
        figures.sent_frame(sent(4, 2_000));
        let told = acknowledge(&mut figures, 4, 7_000);
        assert!(told.is_new);
        assert_eq!(told.age_us, Some(5_000));
        let delivery = Delivery {
            bytes: 1_001 + 1_004,
            sent_us: 2_100,
            acknowledged_us: 7_000,
            held_us: 0,
        };
        assert_eq!(told.delivery, Some(delivery));
        for sequence in [1, 4] {
            let told = acknowledge(&mut figures, sequence, 9_000);
            assert_eq!(told, Acknowledged::default());
        }
        assert!(figures.unacknowledged.is_empty());
        assert_eq!(figures.frame_age().map(|age| age.p95_ms), Some(5.0));
    }

    #[test]
    fn what_the_client_tells_of_its_own_time_is_not_the_networks() {
        let mut figures = ViewerFigures::default();
        figures.sent_frame(sent(1, 0));
        let acknowledgement = Acknowledgement {
            decode_us: Some(4_000),
            // Another clock, years ahead.
            received_us: Some(9_000_000_000_000_000),
            present_us: Some(9_000_000_000_010_000),
            motion_to_photon_us: Some(60_000),
            ..Acknowledgement::of(FrameSequence(1))
        };
        let told = figures.acknowledged(&acknowledgement, 30_100, 1_030_100);
        assert_eq!(
            told.stages,
            [
                (Stage::Network, 20_000),
                (Stage::Decode, 4_000),
                (Stage::Present, 6_000),
                (Stage::MotionToPhoton, 60_000)
            ]
        );
        assert_eq!(told.delivery.map(|delivery| delivery.held_us), Some(10_000));
        let report = figures.latencies.report();
        assert_eq!(report["motion_to_photon"].p95_ms, 60.0);
        // A client whose numbers make no sense harms nobody.
        figures.sent_frame(sent(2, 40_000));
        let absurd = Acknowledgement {
            received_us: Some(0),
            present_us: Some(u64::MAX),
            ..Acknowledgement::of(FrameSequence(2))
        };
        let told = figures.acknowledged(&absurd, 50_000, 1_050_000);
        assert_eq!(told.stages, [(Stage::Network, 0)]);
    }

    #[test]
    fn a_client_that_acknowledges_nothing_costs_no_memory() {
        let mut figures = ViewerFigures::default();
        for number in 1..=100_000 {
            figures.sent_frame(sent(number, 0));
        }
        assert_eq!(figures.unacknowledged.len(), UNACKNOWLEDGED_MAX);
    }

    #[test]
    fn rates_are_those_of_the_last_stretch() {
        let mut figures = ViewerFigures::default();
        figures.sent_frame(sent(1, 0));
        figures.bytes_sent = 1_000_000;
        figures.take_rates(0.5);
        assert_eq!((figures.fps, figures.mbit_per_s), (2.0, 16.0));
        figures.take_rates(1.0);
        assert_eq!((figures.fps, figures.mbit_per_s), (0.0, 0.0));
    }
}
