//! The latest deviations and their distribution.

use schemars::JsonSchema;
use serde::Serialize;
use std::collections::VecDeque;
use std::time::Instant;

/// Deviations that the distribution is taken of: the latest.
pub const WINDOW_TEXELS: usize = 4096;
/// Texels that are audited after the last change of the scene or of a tile. After that the audit has nothing to add, and
/// a resting sky costs nothing again.
pub const AUDITED_AFTER_CHANGE: usize = WINDOW_TEXELS;

/// The distribution of cached texels' deviations from fresh ones (`audit` in ARCHITECTURE.md).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct AuditStats {
    /// Half of the deviations are not above this; null before the first.
    pub p50_percent: Option<f64>,
    /// 95 of 100 are not above this.
    pub p95_percent: Option<f64>,
    /// 99 of 100 are not above this.
    pub p99_percent: Option<f64>,
    /// Deviations that these are taken of, 4096 at most.
    pub texels: u64,
    /// How long ago the latest of them was measured.
    pub age_s: Option<f64>,
    /// Nothing has changed since the last 4096 texels were audited, or there is nothing to audit: it rests.
    pub rests: bool,
}

/// The latest deviations.
#[derive(Debug)]
pub struct AuditWindow {
    deviations_percent: VecDeque<f32>,
    percentiles: Option<[f64; 3]>,
    latest: Option<Instant>,
    left: usize,
    /// Raised by a new scene: what was marched for an older one is not counted.
    epoch: u64,
}

impl Default for AuditWindow {
    fn default() -> Self {
        Self {
            deviations_percent: VecDeque::with_capacity(WINDOW_TEXELS),
            percentiles: None,
            latest: None,
            left: 0,
            epoch: 0,
        }
    }
}

impl AuditWindow {
    /// Forgets everything: the scene is another.
    pub fn restart(&mut self) {
        self.deviations_percent.clear();
        self.percentiles = None;
        self.latest = None;
        self.epoch += 1;
        self.tiles_changed();
    }

    /// A tile has changed: there is something to audit again.
    pub fn tiles_changed(&mut self) {
        self.left = AUDITED_AFTER_CHANGE;
    }

    /// There is nothing to audit until something changes.
    pub fn rest(&mut self) {
        self.left = 0;
    }

    /// Texels that are still to be audited.
    #[must_use]
    pub fn left(&self) -> usize {
        self.left
    }

    /// Which scene is audited.
    #[must_use]
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Texels are on their way to be audited.
    pub fn begin(&mut self, texels: usize) {
        self.left = self.left.saturating_sub(texels);
    }

    /// Takes the deviations of an audit that began in an epoch.
    pub fn add(&mut self, epoch: u64, deviations_percent: &[f32], now: Instant) {
        if epoch != self.epoch || deviations_percent.is_empty() {
            return;
        }
        for deviation in deviations_percent {
            if self.deviations_percent.len() == WINDOW_TEXELS {
                self.deviations_percent.pop_front();
            }
            self.deviations_percent.push_back(*deviation);
        }
        let mut sorted: Vec<f32> = self.deviations_percent.iter().copied().collect();
        sorted.sort_unstable_by(f32::total_cmp);
        // Nearest rank: at least `percent` of the deviations are not above the result.
        self.percentiles = Some([50, 95, 99].map(|percent| {
            let rank = (sorted.len() * percent).div_ceil(100).max(1);
            f64::from(sorted[rank - 1])
        }));
        self.latest = Some(now);
    }

    /// The figures as of `now`.
    #[must_use]
    pub fn stats(&self, now: Instant) -> AuditStats {
        let [p50_percent, p95_percent, p99_percent] = match self.percentiles {
            Some(percentiles) => percentiles.map(Some),
            None => [None; 3],
        };
        AuditStats {
            p50_percent,
            p95_percent,
            p99_percent,
            texels: self.deviations_percent.len() as u64,
            age_s: self
                .latest
                .map(|latest| now.saturating_duration_since(latest).as_secs_f64()),
            rests: self.left == 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn percentiles_are_those_of_the_latest_deviations_and_memory_is_bounded() {
        let now = Instant::now();
        let mut window = AuditWindow::default();
        assert_eq!(window.stats(now).p95_percent, None);
        window.restart();
        let rising: Vec<f32> = (1..=100u8).map(f32::from).collect();
        window.add(window.epoch(), &rising, now);
        let stats = window.stats(now + Duration::from_secs(3));
        assert_eq!(
            [stats.p50_percent, stats.p95_percent, stats.p99_percent],
            [Some(50.0), Some(95.0), Some(99.0)]
        );
        assert_eq!((stats.texels, stats.age_s), (100, Some(3.0)));
        for _ in 0..100 {
            window.add(window.epoch(), &[2.0; 256], now);
        }
        let stats = window.stats(now);
        assert_eq!((stats.texels, stats.p99_percent), (4096, Some(2.0)));
    }

    #[test]
    fn a_new_scene_forgets_the_old_ones_deviations_also_those_under_way() {
        let now = Instant::now();
        let mut window = AuditWindow::default();
        let epoch = window.epoch();
        window.add(epoch, &[1.0], now);
        window.restart();
        assert_eq!(window.stats(now).texels, 0);
        window.add(epoch, &[1.0], now);
        assert_eq!(window.stats(now).texels, 0);
    }

    #[test]
    fn the_audit_of_a_sky_that_rests_ends_and_begins_again_with_the_next_tile() {
        let mut window = AuditWindow::default();
        assert!(window.stats(Instant::now()).rests);
        window.tiles_changed();
        let mut audited = 0;
        while window.left() > 0 {
            window.begin(256);
            audited += 256;
        }
        assert_eq!(audited, AUDITED_AFTER_CHANGE);
        window.tiles_changed();
        assert!(window.left() > 0);
    }
}
