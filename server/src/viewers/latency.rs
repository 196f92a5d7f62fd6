//! Where the time goes: how long frames take in each stage of their way, from the input to the screen.

use std::collections::{BTreeMap, VecDeque};

use schemars::JsonSchema;
use serde::Serialize;
use skycell_protocol::FrameStages;

/// A stage of a frame's way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// From an input's arrival until the first composite with it was submitted.
    Input,
    /// Of that, waiting for marching.
    MarchWait,
    /// The device's time for the picture.
    Composite,
    /// Waiting for the device, and the copy of the pixels.
    Readback,
    /// Waiting for an encoder.
    EncodeWait,
    /// Encoding.
    Encode,
    /// Waiting in the latest-wins slot for the socket.
    ToSocket,
    /// To the client, and the acknowledgement's way back.
    Network,
    /// Decoding at the client.
    Decode,
    /// From there until the client showed it.
    Present,
    /// All of it: from the client's sending an input until it showed the first frame with it.
    MotionToPhoton,
}

impl Stage {
    /// In the order of the way.
    pub const ALL: [Self; 11] = [
        Self::Input,
        Self::MarchWait,
        Self::Composite,
        Self::Readback,
        Self::EncodeWait,
        Self::Encode,
        Self::ToSocket,
        Self::Network,
        Self::Decode,
        Self::Present,
        Self::MotionToPhoton,
    ];

    /// As figures call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Input => "input",
            Self::MarchWait => "march_wait",
            Self::Composite => "composite",
            Self::Readback => "readback",
            Self::EncodeWait => "encode_wait",
            Self::Encode => "encode",
            Self::ToSocket => "to_socket",
            Self::Network => "network",
            Self::Decode => "decode",
            Self::Present => "present",
            Self::MotionToPhoton => "motion_to_photon",
        }
    }

    /// What a frame's header tells of them, µs. What was not there is left out: an input where none was new, a device
    /// that tells no times.
    pub fn of_header(stages: &FrameStages) -> impl Iterator<Item = (Self, u64)> {
        let has_input = stages.input_to_render_us > 0;
        let told = |is_told: bool, stage, us: u32| is_told.then_some((stage, u64::from(us)));
        [
            told(has_input, Self::Input, stages.input_to_render_us),
            told(has_input, Self::MarchWait, stages.march_wait_us),
            told(
                stages.composite_us > 0,
                Self::Composite,
                stages.composite_us,
            ),
            told(true, Self::Readback, stages.readback_us),
            told(true, Self::EncodeWait, stages.encode_wait_us),
            told(true, Self::Encode, stages.encode_us),
            told(true, Self::ToSocket, stages.encode_to_send_us),
        ]
        .into_iter()
        .flatten()
    }
}

/// What half and 95 of 100 of some times do not exceed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Percentiles {
    /// Half of them are not longer.
    pub p50_ms: f64,
    /// 95 of 100 are not longer.
    pub p95_ms: f64,
}

/// The latest times of a kind, of which percentiles are taken.
#[derive(Clone, Debug)]
pub struct RecentTimes {
    most: usize,
    times_us: VecDeque<u64>,
}

impl RecentTimes {
    /// None yet; at most `most` are kept.
    pub fn new(most: usize) -> Self {
        Self {
            most: most.max(1),
            times_us: VecDeque::new(),
        }
    }

    /// Takes a time, in the place of the oldest when there are enough.
    pub fn push(&mut self, time_us: u64) {
        if self.times_us.len() == self.most {
            self.times_us.pop_front();
        }
        self.times_us.push_back(time_us);
    }

    /// How many are kept.
    pub fn len(&self) -> usize {
        self.times_us.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.times_us.is_empty()
    }

    /// Percentiles by nearest rank; none without times.
    pub fn percentiles(&self) -> Option<Percentiles> {
        if self.is_empty() {
            return None;
        }
        let mut times_us: Vec<u64> = self.times_us.iter().copied().collect();
        times_us.sort_unstable();
        // At least `percent` of the times are not above the result.
        let percentile_ms = |percent: usize| {
            let rank = (times_us.len() * percent).div_ceil(100).max(1);
            times_us[rank - 1] as f64 * 1.0e-3
        };
        Some(Percentiles {
            p50_ms: percentile_ms(50),
            p95_ms: percentile_ms(95),
        })
    }
}

/// Percentiles by stage; stages of which nothing is known are left out.
pub type LatencyReport = BTreeMap<&'static str, Percentiles>;

/// The latest times of each stage.
#[derive(Clone, Debug)]
pub struct Latencies {
    stages: [RecentTimes; Stage::ALL.len()],
}

impl Latencies {
    /// None yet; at most `most` are kept of each stage.
    pub fn new(most: usize) -> Self {
        Self {
            stages: std::array::from_fn(|_| RecentTimes::new(most)),
        }
    }

    /// Takes a time of a stage.
    pub fn push(&mut self, stage: Stage, time_us: u64) {
        self.stages[stage as usize].push(time_us);
    }

    /// Percentiles by stage.
    pub fn report(&self) -> LatencyReport {
        Stage::ALL
            .into_iter()
            .filter_map(|stage| Some((stage.name(), self.stages[stage as usize].percentiles()?)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_recent_times() {
        let mut times = RecentTimes::new(100);
        assert_eq!(times.percentiles(), None);
        (1..=100).for_each(|ms| times.push(ms * 1000));
        let expected = Percentiles {
            p50_ms: 50.0,
            p95_ms: 95.0,
        };
        assert_eq!(times.percentiles(), Some(expected));
        (0..100_000).for_each(|_| times.push(2_000));
        assert_eq!(times.percentiles().map(|of| of.p95_ms), Some(2.0));
        assert_eq!(times.len(), 100);
    }

    #[test]
    fn each_stage_stands_at_its_own_place_and_what_is_not_known_is_left_out() {
        for (place, stage) in Stage::ALL.into_iter().enumerate() {
            assert_eq!(stage as usize, place);
        }
        let stages = FrameStages {
            input_to_render_us: 1_000,
            march_wait_us: 2_000,
            composite_us: 3_000,
            readback_us: 4_000,
            encode_wait_us: 5_000,
            encode_us: 6_000,
            encode_to_send_us: 7_000,
        };
        let mut latencies = Latencies::new(4);
        for (stage, us) in Stage::of_header(&stages) {
            latencies.push(stage, us);
        }
        let report = latencies.report();
        let found: Vec<f64> = Stage::ALL
            .iter()
            .filter_map(|stage| Some(report.get(stage.name())?.p50_ms))
            .collect();
        assert_eq!(found, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let without = FrameStages {
            input_to_render_us: 0,
            composite_us: 0,
            ..stages
        };
        let first = Stage::of_header(&without).next();
        assert_eq!(first, Some((Stage::Readback, 4_000)));
    }
}
