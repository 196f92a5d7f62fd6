//! Keeping an error that was asked for: how finely is marched follows from what audits find of the caches.

use super::QualityTable;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Share of audited texels that may deviate by more than the error that was asked for: the audit's 95th percentile is within it.
pub const BEYOND_MAX: f64 = 0.05;
/// From this share on it is marched more finely or more often: what is found sways, and is to stay within what is allowed.
const BEYOND_AIM: f64 = 0.04;
/// Below this share something coarser is tried again.
const BEYOND_FEW: f64 = 0.01;
/// The latest texels that a decision follows from, ...
const WINDOW_TEXELS: usize = 4096;
/// ... and the fewest: what is far beyond is seen from these.
const TEXELS_MIN: usize = 192;
/// After a change, what is audited for so long may have been marched before it.
const SETTLES: Duration = Duration::from_secs(2);
/// Where marching has been behind for so long, something finer that was picked is given up again, ...
const BEHIND: Duration = Duration::from_secs(10);
/// ... the next so long after that: what waits must be worked off first; ...
const WORKS_OFF: Duration = Duration::from_secs(30);
/// ... and tried again after this: what does not fit costs a minute of pictures that are far worse.
const RETRY: Duration = Duration::from_secs(640);
/// How long few texels must have been beyond the error before something coarser is tried, ...
const CALM: Duration = Duration::from_secs(60);
/// ... which doubles, up to [`CALM_MAX`], where that did not hold for twice as long.
const HOLD: Duration = Duration::from_secs(120);
/// The longest such time.
const CALM_MAX: Duration = Duration::from_secs(640);

/// So many texels of the old or of the fresh ones tell what part age has.
const OF_AGE_MIN: usize = 16;
/// Where the old ones are so many times as often beyond the error, and twice the standard error more, age is what is wrong.
const BY_AGE: f64 = 1.5;
/// Least share of the time that tiles otherwise wait until they are marched again.
const WAIT_SHARE_MIN: f64 = 0.25;

/// How many times the steps it is marched with next where they are too few.
const STEPS_GROW: f64 = std::f64::consts::SQRT_2;

/// What an audit has found of a texel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AuditedError {
    /// It deviates by more than was asked for.
    pub is_beyond: bool,
    /// What it shows is seen from elsewhere.
    pub is_old: bool,
}

/// Whether marching keeps up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// It does.
    KeepsUp,
    /// Just: what is old waits longer. There is no room for more.
    Just,
    /// It does not: samples or levels are given up.
    Behind,
}

/// How is marched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarchedAs {
    /// The point of the table as whose rays.
    pub point: usize,
    /// With so many steps for each of the point's: some of the way to the next one.
    pub steps_factor: f64,
    /// After which share of the time that tiles otherwise wait.
    pub wait_share: f64,
}

impl MarchedAs {
    /// Steps through a layer's thickness.
    #[must_use]
    pub fn march_steps(&self, table: &QualityTable) -> u32 {
        let steps = table.point(self.point).settings.march_steps;
        (f64::from(steps) * self.steps_factor).round() as u32
    }
}

/// How is marched for those who ask for one error.
#[derive(Clone, Debug)]
pub struct ErrorGovernor {
    marched: MarchedAs,
    /// What it was before each step, from the table's pick on: steps are taken back in this order.
    before: Vec<MarchedAs>,
    /// What was found of the latest texels.
    found: VecDeque<AuditedError>,
    /// How many of them are beyond the error: that is asked for every viewer in every turn.
    beyond: usize,
    changed: Option<Instant>,
    behind_since: Option<Instant>,
    /// When marching was last too slow for what was picked.
    given_up: Option<Instant>,
    few_since: Option<Instant>,
    calm: Duration,
    coarsened: Option<Instant>,
}

impl ErrorGovernor {
    /// Begins with what the table picks.
    #[must_use]
    pub fn new(point: usize) -> Self {
        Self {
            marched: MarchedAs {
                point,
                steps_factor: 1.0,
                wait_share: 1.0,
            },
            before: Vec::new(),
            found: VecDeque::with_capacity(WINDOW_TEXELS),
            beyond: 0,
            changed: None,
            behind_since: None,
            given_up: None,
            few_since: None,
            calm: CALM,
            coarsened: None,
        }
    }

    /// How is marched now.
    #[must_use]
    pub fn marched(&self) -> MarchedAs {
        self.marched
    }

    /// How many texels there are of some, and the share of them that is beyond the error.
    fn share_of(&self, of: impl Fn(&AuditedError) -> bool) -> (usize, f64) {
        let (count, beyond) = self
            .found
            .iter()
            .filter(|found| of(found))
            .fold((0, 0), |(count, beyond), found| {
                (count + 1, beyond + usize::from(found.is_beyond))
            });
        (count, beyond as f64 / count.max(1) as f64)
    }

    /// Share of the latest audited texels that deviate by more than was asked for; none while there are too few.
    fn share_beyond(&self) -> Option<f64> {
        let texels = self.found.len();
        (texels >= TEXELS_MIN).then(|| self.beyond as f64 / texels as f64)
    }

    /// Share of the latest audited texels that deviate by more than was asked for, where it speaks against the error being kept.
    #[must_use]
    pub fn missed_share(&self) -> Option<f64> {
        self.share_beyond()
            .filter(|share| *share > self.not_by_chance(BEYOND_MAX))
    }

    /// The share from which on the latest texels tell that there are more than some share. It is looked at again and again, so
    /// something is always found by chance: of few texels up to three times the standard error more, of a whole window twice.
    fn not_by_chance(&self, share: f64) -> f64 {
        let texels = self.found.len();
        let errors = if texels < WINDOW_TEXELS { 3.0 } else { 2.0 };
        share + errors * (share * (1.0 - share) / texels as f64).sqrt()
    }

    /// Takes what an audit has found.
    pub fn note(&mut self, found: impl IntoIterator<Item = AuditedError>, now: Instant) {
        if self.changed.is_some_and(|changed| now - changed < SETTLES) {
            return;
        }
        for found in found {
            if self.found.len() == WINDOW_TEXELS {
                let oldest = self.found.pop_front();
                self.beyond -= usize::from(oldest.is_some_and(|oldest| oldest.is_beyond));
            }
            self.beyond += usize::from(found.is_beyond);
            self.found.push_back(found);
        }
    }

    /// Decides; true when it is marched in another way from now on.
    pub fn consider(&mut self, table: &QualityTable, pace: Pace, now: Instant) -> bool {
        let is_changed = if pace == Pace::Behind {
            let since = *self.behind_since.get_or_insert(now);
            let is_working_off = self.has_given_up_within(WORKS_OFF, now);
            let gives_up = now - since >= BEHIND && !is_working_off && self.step_back();
            if gives_up {
                self.given_up = Some(now);
            }
            gives_up
        } else {
            self.behind_since = None;
            let has_room = pace == Pace::KeepsUp;
            (self.share_beyond()).is_some_and(|share| self.follow(table, share, has_room, now))
        };
        if is_changed {
            self.found.clear();
            self.beyond = 0;
            self.changed = Some(now);
            self.few_since = None;
            self.behind_since = None;
        }
        is_changed
    }

    fn has_given_up_within(&self, time: Duration, now: Instant) -> bool {
        self.given_up.is_some_and(|at| now - at < time)
    }

    fn follow(&mut self, table: &QualityTable, share: f64, has_room: bool, now: Instant) -> bool {
        if share > self.not_by_chance(BEYOND_AIM) {
            self.few_since = None;
            if !has_room || self.has_given_up_within(RETRY, now) {
                return false;
            }
            if (self.coarsened.take()).is_some_and(|coarsened| now - coarsened < HOLD) {
                self.calm = (2 * self.calm).min(CALM_MAX);
            }
            return self.step(table);
        }
        if share >= BEYOND_FEW || self.found.len() < WINDOW_TEXELS {
            self.few_since = None;
            return false;
        }
        let is_calm = now - *self.few_since.get_or_insert(now) >= self.calm;
        let is_back = is_calm && self.step_back();
        if is_back {
            self.coarsened = Some(now);
        }
        is_back
    }

    /// Marches more often where what is old is wrong, else more finely.
    fn step(&mut self, table: &QualityTable) -> bool {
        let (old, old_beyond) = self.share_of(|found| found.is_old);
        let (fresh, fresh_beyond) = self.share_of(|found| !found.is_old);
        let share = self.beyond as f64 / self.found.len().max(1) as f64;
        let doubt = 2.0 * (share * (1.0 - share) / old.max(1) as f64).sqrt();
        let is_by_age =
            old >= OF_AGE_MIN && (fresh < OF_AGE_MIN || old_beyond > BY_AGE * fresh_beyond + doubt);
        let sooner = (self.marched.wait_share > WAIT_SHARE_MIN).then_some(MarchedAs {
            wait_share: 0.5 * self.marched.wait_share,
            ..self.marched
        });
        let finer = finer(table, self.marched.point).map(|point| {
            // Points are far apart, and the next one may be more than there is time for.
            let more = MarchedAs {
                steps_factor: STEPS_GROW * self.marched.steps_factor,
                ..self.marched
            };
            if more.march_steps(table) < table.point(point).settings.march_steps {
                more
            } else {
                MarchedAs {
                    point,
                    steps_factor: 1.0,
                    ..self.marched
                }
            }
        });
        let next = if is_by_age {
            sooner.or(finer)
        } else {
            finer.or(sooner.filter(|_| old >= OF_AGE_MIN))
        };
        if let Some(next) = next {
            self.before.push(self.marched);
            self.marched = next;
        }
        next.is_some()
    }

    fn step_back(&mut self) -> bool {
        let before = self.before.pop();
        self.marched = before.unwrap_or(self.marched);
        before.is_some()
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
            && !there.settings.samples_by_area
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
    ) -> Vec<MarchedAs> {
        let table = QualityTable::embedded();
        let mut picked = vec![governor.marched()];
        let mut sum = 0.0;
        for _ in 0..2 * seconds {
            *now += Duration::from_millis(500);
            let share = share(governor.marched().point);
            let found: Vec<AuditedError> = (0..32)
                .map(|_| {
                    sum += share;
                    let is_beyond = sum >= 1.0;
                    sum = sum.fract();
                    AuditedError {
                        is_beyond,
                        is_old: false,
                    }
                })
                .collect();
            governor.note(found, *now);
            let pace = if is_behind(governor.marched().point) {
                Pace::Behind
            } else {
                Pace::KeepsUp
            };
            if governor.consider(&table, pace, *now) {
                picked.push(governor.marched());
            }
        }
        picked
    }

    fn steps(picked: &[MarchedAs]) -> Vec<u32> {
        let table = QualityTable::embedded();
        picked.iter().map(|m| m.march_steps(&table)).collect()
    }

    #[test]
    fn too_many_texels_beyond_the_error_make_the_march_finer_within_seconds_until_it_is_kept() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let table = QualityTable::embedded();
        let share = |point: usize| 4.0 / f64::from(table.point(point).settings.march_steps);
        let picked = run(&mut governor, &mut now, 60, share, |_| false);
        assert_eq!(steps(&picked), [32, 45, 64, 91, 128]);
        assert_eq!(governor.missed_share(), None);
        // Neither finer nor coarser, however long.
        let picked = run(&mut governor, &mut now, 900, share, |_| false);
        assert_eq!(steps(&picked), [128]);
    }

    #[test]
    fn what_is_kept_by_the_tables_pick_stays_there_and_few_texels_are_no_finding() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let picked = run(&mut governor, &mut now, 300, |_| 0.03, |_| false);
        assert_eq!(steps(&picked), [32]);
        let mut governor = ErrorGovernor::new(0);
        let worst = AuditedError {
            is_beyond: true,
            is_old: false,
        };
        governor.note([worst; TEXELS_MIN - 1], now);
        assert_eq!(governor.missed_share(), None);
        assert!(!governor.consider(&QualityTable::embedded(), Pace::KeepsUp, now));
    }

    #[test]
    fn nothing_finer_is_begun_while_what_is_old_waits_longer_already() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let table = QualityTable::embedded();
        let worst = AuditedError {
            is_beyond: true,
            is_old: false,
        };
        governor.note([worst; WINDOW_TEXELS], now);
        for _ in 0..120 {
            now += Duration::from_secs(1);
            assert!(!governor.consider(&table, Pace::Just, now));
        }
        assert!(governor.missed_share().is_some());
        assert!(governor.consider(&table, Pace::KeepsUp, now));
    }

    #[test]
    fn what_is_needed_no_more_is_given_up_seldom_and_ever_more_seldom_where_it_did_not_hold() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let only_coarsest = |point: usize| if point == 0 { 0.2 } else { 0.0 };
        let picked = run(&mut governor, &mut now, 1_800, only_coarsest, |_| false);
        assert!((4..16).contains(&picked.len()), "{picked:?}");
        // No need at all any more: back to what the table picks.
        run(&mut governor, &mut now, 1_800, |_| 0.0, |_| false);
        assert_eq!(governor.marched().point, 0);
    }

    #[test]
    fn where_time_does_not_suffice_nothing_finer_is_kept_and_the_error_is_said_to_be_missed() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let picked = run(&mut governor, &mut now, 600, |_| 0.3, |point| point > 0);
        assert!((3..16).contains(&picked.len()), "{picked:?}");
        let picked = run(&mut governor, &mut now, 60, |_| 0.3, |_| true);
        assert_eq!(picked.last().map(|marched| marched.point), Some(0));
        run(&mut governor, &mut now, 30, |_| 0.3, |_| true);
        assert!(governor.missed_share().is_some() && governor.marched().point == 0);
    }

    #[test]
    fn where_what_is_old_is_wrong_it_is_marched_more_often_and_not_more_finely() {
        let (mut governor, mut now) = (ErrorGovernor::new(0), Instant::now());
        let table = QualityTable::embedded();
        let mut picked = Vec::new();
        for _ in 0..120 {
            now += Duration::from_millis(500);
            let wait_share = governor.marched().wait_share;
            let found = (0..32).map(|index| AuditedError {
                is_beyond: index % 4 == 0 && f64::from(index) < 32.0 * wait_share,
                is_old: index % 4 == 0,
            });
            governor.note(found, now);
            if governor.consider(&table, Pace::KeepsUp, now) {
                picked.push(governor.marched());
            }
        }
        let point = 0;
        let of = |wait_share: f64| MarchedAs {
            point,
            steps_factor: 1.0,
            wait_share,
        };
        // An eighth is beyond it in the end, and there is no more often: then more finely.
        assert_eq!(picked[..2], [of(0.5), of(0.25)]);
        assert!(
            picked[2..]
                .iter()
                .all(|p| p.point > 0 || p.steps_factor > 1.0),
            "{picked:?}"
        );
    }
}
