//! How often a peer may do something. Each limiter is a leaky bucket per peer (GCRA, crate `governor`).

use std::num::NonZeroU32;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use governor::clock::{Clock, MonotonicClock};
use governor::state::keyed::HashMapStateStore;
use governor::{Quota, RateLimiter};

use super::peer::PeerKey;

/// Peers that a limiter keeps apart. Beyond them newcomers share one bucket until others have been quiet for a while.
const PEERS_MAX: usize = 16 * 1024;

/// Peers that have been quiet are looked for at most so often: it takes as long as there are peers.
const SWEEP_INTERVAL: Duration = Duration::from_secs(1);

/// A bucket per peer: `burst` at once, and then as many as flow out of it.
pub(super) struct PeerRate {
    buckets: RateLimiter<PeerKey, HashMapStateStore<PeerKey>, MonotonicClock>,
    started: Instant,
    swept_ms: AtomicU64,
}

impl PeerRate {
    /// `count` each `period`, `burst` at once.
    pub(super) fn new(count: u32, period: Duration, burst: u32) -> Self {
        let not_zero = |number: u32| NonZeroU32::new(number).unwrap_or(NonZeroU32::MIN);
        let quota = Quota::with_period(period / not_zero(count).get())
            // Only a period of nothing has no quota, and those here are seconds and minutes.
            .unwrap_or(Quota::per_second(NonZeroU32::MIN))
            .allow_burst(not_zero(burst));
        Self {
            buckets: RateLimiter::hashmap_with_clock(quota, MonotonicClock),
            started: Instant::now(),
            swept_ms: AtomicU64::new(0),
        }
    }

    /// Takes one of a peer's; if it has none left, tells how long it has to wait.
    pub(super) fn take(&self, peer: PeerKey) -> Result<(), Duration> {
        self.buckets
            .check_key(&self.key_of(peer))
            .map_err(|not_until| not_until.wait_time_from(MonotonicClock.now()))
    }

    /// The peer's bucket, or the one of all for whom there is no room.
    fn key_of(&self, peer: PeerKey) -> PeerKey {
        if self.buckets.len() < PEERS_MAX {
            return peer;
        }
        let now_ms = u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX);
        let swept_ms = self.swept_ms.load(Ordering::Relaxed);
        let is_due = now_ms.saturating_sub(swept_ms) >= SWEEP_INTERVAL.as_millis() as u64;
        let is_mine = is_due
            && self
                .swept_ms
                .compare_exchange(swept_ms, now_ms, Ordering::Relaxed, Ordering::Relaxed)
                .is_ok();
        if is_mine {
            self.buckets.retain_recent();
        }
        if self.buckets.len() < PEERS_MAX {
            peer
        } else {
            PeerKey::OTHERS
        }
    }
}

/// A `Retry-After` in whole seconds, at least one.
pub(super) fn retry_after_s(wait: Duration) -> u64 {
    (wait.as_secs_f64().ceil() as u64).max(1)
}

#[cfg(test)]
mod tests {
    use std::net::{IpAddr, Ipv4Addr};

    use super::*;

    fn peer(number: u32) -> PeerKey {
        PeerKey::of(IpAddr::V4(Ipv4Addr::from_bits(number)))
    }

    #[test]
    fn a_peer_has_its_burst_and_then_waits_while_others_go_on() {
        let rate = PeerRate::new(1, Duration::from_secs(60), 3);
        for _ in 0..3 {
            assert_eq!(rate.take(peer(1)), Ok(()));
        }
        let wait = rate.take(peer(1)).expect_err("none left");
        assert!(
            wait > Duration::from_secs(50) && wait <= Duration::from_secs(60),
            "{wait:?}"
        );
        assert_eq!(rate.take(peer(2)), Ok(()));
        assert_eq!(retry_after_s(Duration::from_millis(1)), 1);
        assert_eq!(retry_after_s(Duration::from_millis(59_100)), 60);
    }

    #[test]
    fn however_many_peers_come_memory_stays_bounded() {
        let rate = PeerRate::new(1, Duration::from_secs(60), 1);
        for number in 0..PEERS_MAX as u32 + 1000 {
            let _ = rate.take(peer(number));
        }
        assert!(
            rate.buckets.len() <= PEERS_MAX + 1,
            "{}",
            rate.buckets.len()
        );
        // Who was there before still has a bucket, and it is still empty.
        assert!(rate.take(peer(7)).is_err());
    }
}
