//! Keeping an error that was asked for: how finely is marched follows from what audits find of the caches.

use super::QualityTable;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Share of audited texels that may deviate by more than the error that was asked for: the audit's 95th percentile is within it.
pub const BEYOND_MAX: f64 = 0.05;
/// Below this share something coarser is tried again.
const BEYOND_FEW: f64 = 0.01;
/// The latest texels that a decision follows from, ...
const WINDOW_TEXELS: usize = 1024;
/// ... and the fewest.
const TEXELS_MIN: usize = 256;
/// After a change, what is audited for so long may have been marched before it.
const SETTLES: Duration = Duration::from_secs(2);
/// Where marching has been behind for so long, something finer that was picked is given up again, ...
const BEHIND: Duration = Duration::from_secs(10);
/// ... and tried again after this; each time that it did not fit, the wait doubles, ...
const RETRY: Duration = Duration::from_secs(40);
/// ... up to this.
const RETRY_MAX: Duration = Duration::from_secs(640);
/// How long few texels must have been beyond the error before something coarser is tried, ...
const CALM: Duration = Duration::from_secs(60);
/// ... which doubles, up to the longest above, where that did not hold for twice as long.
const HOLD: Duration = Duration::from_secs(120);

/// How finely is marched for those who ask for one error.
#[derive(Clone, Debug)]
pub struct ErrorGovernor {
    /// What the table picks for it: never coarser.
    least: usize,
    point: usize,
    /// Of the latest audited texels, whether they deviate by more than was asked for.
    beyond: VecDeque<bool>,
    changed: Option<Instant>,
    behind_since: Option<Instant>,
    retry: Duration,
    retry_at: Option<Instant>,
    few_since: Option<Instant>,
    calm: Duration,
    coarsened: Option<Instant>,
}

impl ErrorGovernor {
    /// Begins with what the table picks.
    #[must_use]
    pub fn new(least: usize) -> Self {
        Self {
            least,
            point: least,
            beyond: VecDeque::with_capacity(WINDOW_TEXELS),
            changed: None,
            behind_since: None,
            retry: RETRY,
            retry_at: None,
            few_since: None,
            calm: CALM,
            coarsened: None,
        }
    }

    /// The point of the table as whose rays are marched.
    #[must_use]
    pub fn point(&self) -> usize {
        self.point
    }

    /// Share of the latest audited texels that deviate by more than was asked for; none while there are too few.
    #[must_use]
    pub fn share_beyond(&self) -> Option<f64> {
        let count = self.beyond.len();
        let beyond = self.beyond.iter().filter(|beyond| **beyond).count();
        (count >= TEXELS_MIN).then(|| beyond as f64 / count as f64)
    }

    /// Nothing that was audited speaks against the error being kept.
    #[must_use]
    pub fn is_kept(&self) -> bool {
        self.share_beyond().is_none_or(|share| share <= BEYOND_MAX)
    }

    /// Takes what an audit has found: whether texels deviate by more than was asked for.
    pub fn note(&mut self, beyond: impl IntoIterator<Item = bool>, now: Instant) {
        if self.changed.is_some_and(|changed| now - changed < SETTLES) {
            return;
        }
        for beyond in beyond {
            if self.beyond.len() == WINDOW_TEXELS {
                self.beyond.pop_front();
            }
            self.beyond.push_back(beyond);
        }
    }

    /// Decides; true when it is marched in another way from now on. `is_behind`: marching does not keep up, something has been
    /// given up for that.
    pub fn consider(&mut self, table: &QualityTable, is_behind: bool, now: Instant) -> bool {
        let before = self.point;
        if is_behind {
            let since = *self.behind_since.get_or_insert(now);
            if now - since >= BEHIND && self.point != self.least {
                self.retry_at = Some(now + self.retry);
                self.retry = (2 * self.retry).min(RETRY_MAX);
                self.point = self.coarser(table);
            }
        } else {
            self.behind_since = None;
            if let Some(share) = self.share_beyond() {
                self.follow(table, share, now);
            }
        }
        let is_changed = self.point != before;
        if is_changed {
            self.beyond.clear();
            self.changed = Some(now);
            self.few_since = None;
            self.behind_since = None;
        }
        is_changed
    }

    fn follow(&mut self, table: &QualityTable, share: f64, now: Instant) {
        let texels = self.beyond.len();
        // Of few texels, twice the standard error more are no finding.
        let doubt = if texels < WINDOW_TEXELS {
            2.0 * (BEYOND_MAX * (1.0 - BEYOND_MAX) / texels as f64).sqrt()
        } else {
            0.0
        };
        if share > BEYOND_MAX + doubt {
            self.few_since = None;
            if self.retry_at.is_some_and(|at| now < at) {
                return;
            }
            if (self.coarsened.take()).is_some_and(|coarsened| now - coarsened < HOLD) {
                self.calm = (2 * self.calm).min(RETRY_MAX);
            }
            self.point = finer(table, self.point).unwrap_or(self.point);
        } else if share < BEYOND_FEW && texels == WINDOW_TEXELS && self.point != self.least {
            if now - *self.few_since.get_or_insert(now) >= self.calm {
                self.coarsened = Some(now);
                self.point = self.coarser(table);
            }
        } else {
            self.few_since = None;
        }
    }

    /// The point from which the present one is the next finer.
    fn coarser(&self, table: &QualityTable) -> usize {
        let mut at = self.least;
        while let Some(next) = finer(table, at) {
            if next == self.point {
                return at;
            }
            at = next;
        }
        self.least
    }
}

/// The cheapest point that is marched more finely than another.
fn finer(table: &QualityTable, point: usize) -> Option<usize> {
    let here = table.point(point);
    table.points().iter().position(|there| {
        there.error.flip < here.error.flip
            && there.cost.relative > here.cost.relative
            && there.settings.march_steps > here.settings.march_steps
            && there.settings.samples >= here.settings.samples
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds in which 64 texels are audited twice, of which a share deviates too much, by the point that is picked.
    fn run(
        governor: &mut ErrorGovernor,
        now: &mut Instant,
        seconds: usize,
        share: impl Fn(usize) -> f64,
        is_behind: impl Fn(usize) -> bool,
    ) -> Vec<usize> {
        let table = QualityTable::embedded();
        let mut picked = vec![governor.point()];
        let mut sum = 0.0;
        for _ in 0..2 * seconds {
            *now += Duration::from_millis(500);
            let share = share(governor.point());
            let beyond: Vec<bool> = (0..32)
                .map(|_| {
                    sum += share;
                    let is_beyond = sum >= 1.0;
                    sum = sum.fract();
                    is_beyond
                })
                .collect();
            governor.note(beyond, *now);
            if governor.consider(&table, is_behind(governor.point()), *now) {
                picked.push(governor.point());
            }
        }
        picked
    }

    fn steps(picked: &[usize]) -> Vec<u32> {
        let table = QualityTable::embedded();
        let of = |point: &usize| table.point(*point).settings.march_steps;
        picked.iter().map(of).collect()
    }

    #[test]
    fn too_many_texels_beyond_the_error_make_the_march_finer_within_seconds_until_it_is_kept() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let table = QualityTable::embedded();
        let share = |point: usize| 5.0 / f64::from(table.point(point).settings.march_steps);
        let picked = run(&mut governor, &mut now, 30, share, |_| false);
        assert_eq!(steps(&picked), [32, 64, 128]);
        assert!(governor.is_kept());
        // Neither finer nor coarser, however long.
        let picked = run(&mut governor, &mut now, 900, share, |_| false);
        assert_eq!(steps(&picked), [128]);
    }

    #[test]
    fn what_is_kept_by_the_tables_pick_stays_there_and_few_texels_are_no_finding() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let picked = run(&mut governor, &mut now, 300, |_| 0.045, |_| false);
        assert_eq!(picked, [0]);
        let mut governor = ErrorGovernor::new(0);
        governor.note([true; TEXELS_MIN - 1], now);
        assert!(governor.is_kept());
        assert!(!governor.consider(&QualityTable::embedded(), false, now));
    }

    #[test]
    fn what_is_needed_no_more_is_given_up_seldom_and_ever_more_seldom_where_it_did_not_hold() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let only_coarsest = |point: usize| if point == 0 { 0.2 } else { 0.0 };
        let picked = run(&mut governor, &mut now, 1_800, only_coarsest, |_| false);
        assert!((4..16).contains(&picked.len()), "{picked:?}");
        // No need at all any more: back to what the table picks.
        run(&mut governor, &mut now, 1_800, |_| 0.0, |_| false);
        assert_eq!(governor.point(), 0);
    }

    #[test]
    fn where_time_does_not_suffice_nothing_finer_is_kept_and_the_error_is_said_to_be_missed() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let picked = run(&mut governor, &mut now, 600, |_| 0.3, |point| point > 0);
        assert!((3..16).contains(&picked.len()), "{picked:?}");
        let picked = run(&mut governor, &mut now, 60, |_| 0.3, |_| true);
        assert_eq!(picked.last(), Some(&0));
        run(&mut governor, &mut now, 30, |_| 0.3, |_| true);
        assert!(!governor.is_kept() && governor.point() == 0);
    }
}
