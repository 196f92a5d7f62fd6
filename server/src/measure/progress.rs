//! How far a run is, and how long it will take.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// The time that is left, from the work that was done and the time that it took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    done_work: f64,
    done_s: f64,
    left_work: f64,
}

impl Estimate {
    /// Work was found.
    pub fn add(&mut self, work: f64) {
        self.left_work += work;
    }

    /// Work was done.
    pub fn done(&mut self, work: f64, seconds: f64) {
        self.left_work = (self.left_work - work).max(0.0);
        self.done_work += work;
        self.done_s += seconds;
    }

    /// Seconds that are left when `share` of `work` is done; none before anything was.
    #[must_use]
    pub fn left_s(&self, work: f64, share: f64) -> Option<f64> {
        (self.done_work > 0.0)
            .then(|| (self.left_work - work * share).max(0.0) * self.done_s / self.done_work)
    }
}

/// `3 min 20 s`.
#[must_use]
pub fn spoken(seconds: f64) -> String {
    let s = seconds.max(0.0).round() as u64;
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {} s", s / 60, s % 60),
        _ => format!("{} h {} min", s / 3600, s % 3600 / 60),
    }
}

/// A bar on a terminal, a line for each point elsewhere; on standard error.
pub struct Progress {
    bar: ProgressBar,
    lines: bool,
    estimate: Estimate,
    label: String,
    work: f64,
    begun: Instant,
}

impl Progress {
    /// For `points` points of `work` work.
    #[must_use]
    pub fn new(points: u64, work: f64) -> Self {
        let bar = ProgressBar::new(points);
        if let Ok(style) = ProgressStyle::with_template("[{bar:24}] {pos}/{len} {msg}") {
            bar.set_style(style);
        }
        let mut estimate = Estimate::default();
        estimate.add(work);
        Self {
            bar,
            lines: !std::io::stderr().is_terminal(),
            estimate,
            label: String::new(),
            work: 0.0,
            begun: Instant::now(),
        }
    }

    /// More points were found.
    pub fn add(&mut self, work: f64) {
        self.bar.inc_length(1);
        self.estimate.add(work);
    }

    /// A point is begun.
    pub fn begin(&mut self, label: &str, work: f64) {
        label.clone_into(&mut self.label);
        self.work = work;
        self.begun = Instant::now();
        self.share(0.0);
    }

    /// So much of it is done.
    pub fn share(&self, share: f64) {
        let left = self.estimate.left_s(self.work, share);
        let left = left.map_or_else(String::new, |s| format!(", about {} left", spoken(s)));
        self.bar.set_message(format!("{}{left}", self.label));
    }

    /// It is done, with this result.
    pub fn done(&mut self, result: &str) {
        let seconds = self.begun.elapsed();
        // What was read from disk tells nothing about how fast this machine renders, nor does what is no point's work.
        if self.work > 0.0 && seconds > Duration::from_millis(20) {
            self.estimate.done(self.work, seconds.as_secs_f64());
        } else {
            self.estimate.add(-self.work);
        }
        self.bar.inc(1);
        if self.lines {
            let left = self
                .estimate
                .left_s(0.0, 0.0)
                .map_or_else(String::new, |s| format!(", about {} left", spoken(s)));
            eprintln!(
                "[{}/{}] {}: {result}{left}",
                self.bar.position(),
                self.bar.length().unwrap_or_default(),
                self.label
            );
        }
    }

    /// Nothing is left to do.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_takes_as_long_as_what_was_done() {
        let mut estimate = Estimate::default();
        estimate.add(30.0);
        assert_eq!(estimate.left_s(0.0, 0.0), None);
        estimate.done(10.0, 5.0);
        assert_eq!(estimate.left_s(0.0, 0.0), Some(10.0));
        assert_eq!(estimate.left_s(10.0, 0.5), Some(7.5));
    }

    #[test]
    fn times_are_spoken_in_the_unit_that_fits() {
        assert_eq!(
            [5.4, 200.0, 7_300.0].map(spoken),
            ["5 s", "3 min 20 s", "2 h 1 min"]
        );
    }
}
