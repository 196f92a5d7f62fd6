//! What a viewer was sent, how fast, and how old it was when the viewer had it.

use std::collections::VecDeque;

use skycell_protocol::FrameSequence;

/// How many of the latest frames the percentiles of age are taken from: about ten seconds' worth.
const AGES_MAX: usize = 256;

/// How many sent frames may wait for their acknowledgement. The window lets two be in flight; the
/// rest is slack for a frame loop with a wider one.
const UNACKNOWLEDGED_MAX: usize = 8;

/// Sums and recent figures of one viewer.
#[derive(Clone, Debug, Default)]
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
    last_sent: FrameSequence,
    last_acknowledged: FrameSequence,
    unacknowledged: VecDeque<SentFrame>,
    ages_us: VecDeque<u64>,
    rate_start: RateStart,
}

#[derive(Clone, Copy, Debug)]
struct SentFrame {
    sequence: FrameSequence,
    render_unix_us: u64,
}

/// Sums at the start of the second that rates are taken over.
#[derive(Clone, Copy, Debug, Default)]
struct RateStart {
    frames_sent: u64,
    bytes_sent: u64,
}

/// How old frames were when the client had them: from the composite's submission to the GPU until
/// the acknowledgement's arrival, so with the way there and back.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameAge {
    /// Half of the recent frames were younger.
    pub p50_ms: f64,
    /// 95 of 100 recent frames were younger.
    pub p95_ms: f64,
}

impl ViewerFigures {
    /// Counts a frame that is about to be handed to the socket.
    pub fn sent_frame(&mut self, sequence: FrameSequence, render_unix_us: u64) {
        self.frames_sent += 1;
        self.last_sent = sequence;
        if self.unacknowledged.len() == UNACKNOWLEDGED_MAX {
            self.unacknowledged.pop_front();
        }
        self.unacknowledged.push_back(SentFrame {
            sequence,
            render_unix_us,
        });
    }

    /// The last frame sent; 0 if none.
    pub fn last_sent(&self) -> FrameSequence {
        self.last_sent
    }

    /// Takes an acknowledgement. Returns the age of the frame in microseconds, if it is still
    /// known, and whether anything new was acknowledged.
    pub fn acknowledged(
        &mut self,
        sequence: FrameSequence,
        now_unix_us: u64,
    ) -> (Option<u64>, bool) {
        if sequence <= self.last_acknowledged {
            return (None, false);
        }
        self.last_acknowledged = sequence;
        let mut age_us = None;
        while let Some(frame) = self.unacknowledged.front()
            && frame.sequence <= sequence
        {
            if frame.sequence == sequence {
                age_us = Some(now_unix_us.saturating_sub(frame.render_unix_us));
            }
            self.unacknowledged.pop_front();
        }
        if let Some(age_us) = age_us {
            if self.ages_us.len() == AGES_MAX {
                self.ages_us.pop_front();
            }
            self.ages_us.push_back(age_us);
        }
        (age_us, true)
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

    /// How old recent frames were; none before the first acknowledgement.
    pub fn frame_age(&self) -> Option<FrameAge> {
        if self.ages_us.is_empty() {
            return None;
        }
        let mut ages_us: Vec<u64> = self.ages_us.iter().copied().collect();
        ages_us.sort_unstable();
        // Nearest rank: at least `percent` of the ages are not above the result.
        let percentile_ms = |percent: usize| {
            let rank = (ages_us.len() * percent).div_ceil(100).max(1);
            ages_us[rank - 1] as f64 * 1.0e-3
        };
        Some(FrameAge {
            p50_ms: percentile_ms(50),
            p95_ms: percentile_ms(95),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_acknowledgement_covers_every_earlier_frame_and_counts_once() {
        let mut figures = ViewerFigures::default();
        figures.sent_frame(FrameSequence(1), 1_000);
        figures.sent_frame(FrameSequence(4), 2_000);
        assert_eq!(
            figures.acknowledged(FrameSequence(4), 7_000),
            (Some(5_000), true)
        );
        assert_eq!(figures.acknowledged(FrameSequence(1), 9_000), (None, false));
        assert_eq!(figures.acknowledged(FrameSequence(4), 9_000), (None, false));
        assert!(figures.unacknowledged.is_empty());
    }

    #[test]
    fn percentiles_are_those_of_the_recent_ages() {
        let mut figures = ViewerFigures::default();
        assert_eq!(figures.frame_age(), None);
        for number in 1..=100 {
            figures.sent_frame(FrameSequence(number), 0);
            figures.acknowledged(FrameSequence(number), u64::from(number) * 1000);
        }
        let expected = FrameAge {
            p50_ms: 50.0,
            p95_ms: 95.0,
        };
        assert_eq!(figures.frame_age(), Some(expected));
        for number in 101..=100_000 {
            figures.sent_frame(FrameSequence(number), 0);
            figures.acknowledged(FrameSequence(number), 2000);
        }
        assert_eq!(figures.frame_age().map(|age| age.p95_ms), Some(2.0));
        assert_eq!(figures.ages_us.len(), AGES_MAX);
    }

    #[test]
    fn a_client_that_acknowledges_nothing_costs_no_memory() {
        let mut figures = ViewerFigures::default();
        for number in 1..=100_000 {
            figures.sent_frame(FrameSequence(number), 0);
        }
        assert_eq!(figures.unacknowledged.len(), UNACKNOWLEDGED_MAX);
    }

    #[test]
    fn rates_are_those_of_the_last_stretch() {
        let mut figures = ViewerFigures::default();
        figures.sent_frame(FrameSequence(1), 0);
        figures.bytes_sent = 1_000_000;
        figures.take_rates(0.5);
        assert_eq!((figures.fps, figures.mbit_per_s), (2.0, 16.0));
        figures.take_rates(1.0);
        assert_eq!((figures.fps, figures.mbit_per_s), (0.0, 0.0));
    }
}
