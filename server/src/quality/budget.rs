//! Keeping a viewer's frames within a time: down soon, up late, never to and fro.

use super::QualityTable;
use std::time::{Duration, Instant};

/// Measurements above the budget, one after another, before something cheaper is picked: one slow frame is nothing.
const BREACHES: u32 = 3;
/// Share of the budget that something better may be expected to take before it is picked.
const MARGIN: f64 = 0.75;
/// How long something better must have fitted before it is picked.
const CALM: Duration = Duration::from_secs(10);
/// Where something better was picked and did not hold for this long, the next try waits twice as long,
const HOLD: Duration = Duration::from_secs(60);
/// up to this.
const CALM_MAX: Duration = Duration::from_secs(320);

/// What one frame of a viewer costs the device with the point that is picked now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameCost {
    /// Compositing, ms.
    pub composite_ms: f64,
    /// Its share of marching, ms.
    pub march_ms: f64,
}

impl FrameCost {
    /// Both, ms.
    #[must_use]
    pub fn total_ms(&self) -> f64 {
        self.composite_ms + self.march_ms
    }

    /// What it would cost if marching cost `factor` times as much, ms.
    fn with_march(&self, factor: f64) -> f64 {
        self.composite_ms + self.march_ms * factor
    }
}

/// The pick of one viewer with a budget.
#[derive(Clone, Debug, PartialEq)]
pub struct BudgetGovernor {
    point: usize,
    breaches: u32,
    better_since: Option<Instant>,
    calm: Duration,
    raised: Option<Instant>,
    is_met: bool,
}

impl BudgetGovernor {
    /// Begins with a point of the table.
    #[must_use]
    pub fn new(point: usize) -> Self {
        Self {
            point,
            breaches: 0,
            better_since: None,
            calm: CALM,
            raised: None,
            is_met: true,
        }
    }

    /// The point that is picked.
    #[must_use]
    pub fn point(&self) -> usize {
        self.point
    }

    /// The last measurement was within the budget.
    #[must_use]
    pub fn is_met(&self) -> bool {
        self.is_met
    }

    /// Takes a measurement of the picked point; true when another one is picked now.
    pub fn consider(
        &mut self,
        table: &QualityTable,
        budget_ms: f64,
        cost: &FrameCost,
        now: Instant,
    ) -> bool {
        let here = *table.point(self.point);
        let predicted_ms = |relative: f64| cost.with_march(relative / here.cost.relative);
        self.is_met = cost.total_ms() <= budget_ms;
        if !self.is_met {
            self.better_since = None;
            self.breaches += 1;
            if self.breaches < BREACHES {
                return false;
            }
            self.breaches = 0;
            let cheaper = table
                .best(|p| {
                    p.cost.relative < here.cost.relative
                        && predicted_ms(p.cost.relative) <= budget_ms
                })
                // Nothing fits: the least that can be done.
                .unwrap_or(0);
            let changed = cheaper != self.point;
            if changed && self.raised.is_some_and(|raised| now - raised < HOLD) {
                self.calm = (2 * self.calm).min(CALM_MAX);
            }
            self.point = cheaper;
            return changed;
        }
        self.breaches = 0;
        // One step: the cheapest of what is better.
        let better = table.points().iter().position(|p| {
            p.error.flip < here.error.flip
                && p.cost.relative > here.cost.relative
                && predicted_ms(p.cost.relative) <= MARGIN * budget_ms
        });
        let Some(better) = better else {
            self.better_since = None;
            return false;
        };
        let since = *self.better_since.get_or_insert(now);
        if now - since < self.calm {
            return false;
        }
        self.point = better;
        self.better_since = None;
        self.raised = Some(now);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(500);

    /// A device on which a frame with the preset `high` marches for `high_ms(t)` ms, t in s.
    fn run(
        governor: &mut BudgetGovernor,
        start: Instant,
        seconds: u32,
        budget_ms: f64,
        high_ms: impl Fn(f64) -> f64,
    ) -> (usize, Instant) {
        let table = QualityTable::embedded();
        let mut changes = 0;
        let mut now = start;
        for _ in 0..2 * seconds {
            let cost = FrameCost {
                composite_ms: 0.5,
                march_ms: high_ms((now - start).as_secs_f64())
                    * table.point(governor.point()).cost.relative,
            };
            changes += usize::from(governor.consider(&table, budget_ms, &cost, now));
            now += PERIOD;
        }
        (changes, now)
    }

    fn relative(governor: &BudgetGovernor) -> f64 {
        QualityTable::embedded()
            .point(governor.point())
            .cost
            .relative
    }

    #[test]
    fn a_budget_ends_at_the_best_point_that_fits_from_either_side_and_stays_there() {
        let last = QualityTable::embedded().points().len() - 1;
        for first in [0, last] {
            let mut governor = BudgetGovernor::new(first);
            let (_, now) = run(&mut governor, Instant::now(), 200, 4.0, |_| 2.0);
            // 0.5 ms and 1.0 of 2 ms fit, with the margin too.
            assert_eq!(relative(&governor), 1.0, "from {first}");
            assert!(governor.is_met());
            let (changes, _) = run(&mut governor, now, 600, 4.0, |_| 2.0);
            assert_eq!(changes, 0);
        }
    }

    #[test]
    fn it_goes_down_within_two_seconds_and_up_only_after_ten_calm_ones() {
        let high = QualityTable::embedded()
            .pick_preset(skycell_protocol::QualityPreset::High)
            .point;
        let mut governor = BudgetGovernor::new(high);
        let (changes, now) = run(&mut governor, Instant::now(), 2, 3.0, |_| 20.0);
        assert_eq!(changes, 1);
        assert!(governor.point() < high);
        let down = governor.point();
        let (changes, now) = run(&mut governor, now, 9, 3.0, |_| 1.0);
        assert_eq!((changes, governor.point()), (0, down));
        let (changes, _) = run(&mut governor, now, 5, 3.0, |_| 1.0);
        assert_eq!(changes, 1);
    }

    #[test]
    fn single_slow_frames_change_nothing() {
        let high = QualityTable::embedded()
            .pick_preset(skycell_protocol::QualityPreset::High)
            .point;
        let mut governor = BudgetGovernor::new(high);
        let slow = |t: f64| {
            if (t as u32).is_multiple_of(5) {
                4.0
            } else {
                1.9
            }
        };
        let (changes, _) = run(&mut governor, Instant::now(), 300, 3.0, slow);
        assert_eq!(changes, 0);
    }

    #[test]
    fn a_load_that_comes_and_goes_makes_it_change_ever_more_rarely() {
        let mut governor = BudgetGovernor::new(4);
        // Light for 15 s, so that it goes up, and heavy for 15 s, so that it comes down.
        let load = |t: f64| if t % 30.0 < 15.0 { 0.5 } else { 8.0 };
        let start = Instant::now();
        let (first, now) = run(&mut governor, start, 300, 3.0, load);
        let (second, _) = run(&mut governor, now, 3000, 3.0, load);
        assert!(first <= 12, "{first} changes in 5 minutes");
        // With calm times longer than the light spells it stays down.
        assert!(second <= 4, "{second} changes in 50 minutes");
    }

    #[test]
    fn where_nothing_fits_the_cheapest_is_picked_and_it_says_so() {
        let mut governor = BudgetGovernor::new(4);
        run(&mut governor, Instant::now(), 30, 0.2, |_| 5.0);
        assert_eq!(governor.point(), 0);
        assert!(!governor.is_met());
    }
}
