//! How much a viewer's link takes, told by its acknowledgements, and what compression makes of that.
//!
//! [`RateControl`] finds a rate to aim at, for every codec; [`JpegLadder`] picks JPEG's quality by it. Pure
//! decisions over acknowledged bytes and times: no clock, no socket.
//!
//! A link is too slow where frames take it for longer than their turn lasts. How long a frame takes it is the time from
//! its hand-over, or from the acknowledgement before if that came later, until its own acknowledgement, less an empty
//! link's round trip and what the client says of its own time. Bytes over that time are what the link carries; three
//! quarters of it are aimed at, so that nothing queues. Down at once, up only after a calm time, and later after each
//! attempt that failed.

mod ladder;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

pub use ladder::JpegLadder;

/// Deliveries that a link is judged by: half a second at 15 frames a second.
const DELIVERIES: usize = 8;
/// Fewer say nothing.
const DELIVERIES_LEAST: usize = 2;
/// Round trips of which the shortest counts as that of an empty link.
const ROUND_TRIPS: usize = 8;
/// What a busy machine may add to a delivery, so that it is not taken for the link.
const JITTER_US: u64 = 3_000;
/// Frames that take the link for less than this are young enough, however many are wished.
const BUSY_LEAST_US: u64 = 25_000;
/// Share of its turn that a frame may take the link for before the link counts as too slow.
const BUSY_SHARE: f64 = 0.9;
/// Share of what the link carries that is aimed at.
const AIM: f64 = 0.75;
/// The least that is aimed at.
const TARGET_LEAST_KBIT_PER_S: f64 = 64.0;
/// A link that carries more must do so for this long before more is aimed at.
const CALM_US: u64 = 2_000_000;
/// What is aimed at grows by no more than this at once.
const GROWTH: f64 = 1.25;
/// A link that could carry less than this much more is left alone.
const GROWTH_LEAST: f64 = 1.1;
/// Frames that take the link longer than this, and than their turn, are sent one at a time: the second would only grow
/// old behind the first.
const ONE_AT_A_TIME_US: u64 = 60_000;

/// Frames of a viewer that have arrived: those that one acknowledgement covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delivery {
    /// Bytes of their messages.
    pub bytes: u64,
    /// When the last of them was handed to the socket, by a clock that only goes forward.
    pub sent_us: u64,
    /// When the acknowledgement came, by the same clock.
    pub acknowledged_us: u64,
    /// How long the client says that it held the frame before it acknowledged: decoding, and waiting for its screen.
    pub held_us: u64,
}

impl Delivery {
    /// From its hand-over until the acknowledgement, without what the client held it.
    pub fn since_sent_us(&self) -> u64 {
        self.acknowledged_us
            .saturating_sub(self.sent_us)
            .saturating_sub(self.held_us)
    }
}

/// What a viewer's link takes.
#[derive(Clone, Debug, Default)]
pub struct RateControl {
    /// Bytes, and how long they took the link.
    busy: VecDeque<(u64, u64)>,
    round_trips_us: VecDeque<u64>,
    shortest_delivery_us: Option<u64>,
    last_acknowledged_us: Option<u64>,
    target_kbit_per_s: Option<f64>,
    /// How long a frame may take the link.
    turn_us: u64,
    /// Since when the link could carry more than is aimed at.
    calm_since_us: Option<u64>,
    ladder: JpegLadder,
}

impl RateControl {
    /// The round trip of a small message.
    pub fn round_trip(&mut self, round_trip_us: u64) {
        push(&mut self.round_trips_us, round_trip_us, ROUND_TRIPS);
    }

    /// Takes an acknowledgement of a viewer who wishes `fps` frames a second.
    pub fn delivered(&mut self, delivery: Delivery, fps: f64) {
        let now_us = delivery.acknowledged_us;
        let since_sent_us = delivery.since_sent_us();
        self.shortest_delivery_us = Some(
            self.shortest_delivery_us
                .map_or(since_sent_us, |least_us| least_us.min(since_sent_us)),
        );
        let way_us = since_sent_us.saturating_sub(self.empty_round_trip_us());
        // While the frame before took the link, this one waited for it.
        let alone_us = self
            .last_acknowledged_us
            .map_or(u64::MAX, |last_us| now_us.saturating_sub(last_us));
        self.last_acknowledged_us = Some(now_us);
        let busy_us = way_us.min(alone_us).saturating_sub(JITTER_US);
        push(&mut self.busy, (delivery.bytes, busy_us), DELIVERIES);
        if self.busy.len() >= DELIVERIES_LEAST {
            self.aim(now_us, fps);
        }
    }

    fn aim(&mut self, now_us: u64, fps: f64) {
        let busy_us = self.mean_busy_us();
        self.turn_us = ((BUSY_SHARE * 1.0e6 / fps) as u64).max(BUSY_LEAST_US);
        // A link that no frame takes for long carries at least this much.
        let carried_kbit_per_s =
            self.bytes() as f64 * 8.0e3 / (self.busy.len() as f64 * busy_us.max(1_000) as f64);
        let aim_kbit_per_s = (AIM * carried_kbit_per_s).max(TARGET_LEAST_KBIT_PER_S);
        if busy_us > self.turn_us {
            self.calm_since_us = None;
            let target = self.target_kbit_per_s.unwrap_or(f64::INFINITY);
            self.target_kbit_per_s = Some(target.min(aim_kbit_per_s));
            return;
        }
        let Some(target) = self.target_kbit_per_s else {
            return;
        };
        if aim_kbit_per_s < GROWTH_LEAST * target {
            self.calm_since_us = None;
            return;
        }
        let since_us = *self.calm_since_us.get_or_insert(now_us);
        if now_us.saturating_sub(since_us) >= CALM_US {
            self.calm_since_us = None;
            self.target_kbit_per_s = Some(aim_kbit_per_s.min(GROWTH * target));
        }
    }

    /// What compression is to aim at, kbit/s; none as long as the link was never too slow.
    pub fn target_kbit_per_s(&self) -> Option<u32> {
        // As the cast saturates, a rate beyond 4 Tbit/s is one of 4 Tbit/s.
        self.target_kbit_per_s.map(|target| target as u32)
    }

    /// How many frames may be under way, at most `most`.
    pub fn frames_in_flight_max(&self, most: u32) -> u32 {
        let is_slow = self.target_kbit_per_s.is_some()
            && self.mean_busy_us() > self.turn_us.max(ONE_AT_A_TIME_US);
        if is_slow { most.min(1) } else { most }
    }

    /// The quality of the next JPEG, for a viewer who wishes `wished`.
    pub fn jpeg_quality(&self, wished: u8) -> u8 {
        self.ladder.quality(wished)
    }

    /// A JPEG of that quality has become so long.
    pub fn jpeg_encoded(&mut self, bytes: usize, fps: f64, now_us: u64) {
        let turn_bytes = self
            .target_kbit_per_s
            .map(|target| target * 1.0e3 / 8.0 / fps);
        self.ladder.encoded(bytes, turn_bytes, now_us);
    }

    /// Round trip of a small message through an empty link, as far as it is known.
    fn empty_round_trip_us(&self) -> u64 {
        let pinged_us = self.round_trips_us.iter().min().copied();
        // A frame's own time is part of a delivery, so it is taken for less than it is: the link for faster.
        pinged_us.or(self.shortest_delivery_us).unwrap_or(0)
    }

    fn bytes(&self) -> u64 {
        self.busy.iter().map(|(bytes, _)| bytes).sum()
    }

    fn mean_busy_us(&self) -> u64 {
        let sum_us: u64 = self.busy.iter().map(|(_, busy_us)| busy_us).sum();
        sum_us / (self.busy.len() as u64).max(1)
    }
}

fn push<T>(values: &mut VecDeque<T>, value: T, most: usize) {
    if values.len() == most {
        values.pop_front();
    }
    values.push_back(value);
}
