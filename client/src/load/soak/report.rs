//! What a soak has shown: a line a minute, and whether each bar was kept.

use serde::Serialize;
use std::fmt::Write;

/// Memory at the end may be larger than early on by this share: allocators round and keep.
const MEMORY_GROWTH_MAX: f64 = 0.05;
/// Share of the time in which the caches' error must be what is asked for.
const WITHIN_ERROR_MIN: f64 = 0.95;

/// The server and the crowd at one moment, once a second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SoakSample {
    /// Since all were connected, s.
    pub at_s: f64,
    /// Memory that the server's process holds; none where its system does not tell.
    pub memory_bytes: Option<u64>,
    /// GPU memory of its caches.
    pub cache_bytes: u64,
    /// View cells with members.
    pub cells: usize,
    /// 95 of 100 audited texels deviate by no more, percent.
    pub audit_p95_percent: Option<f64>,
    /// Halvings of resolution that some cell has lost.
    pub levels_lost: u32,
    /// How much is given up for want of time.
    pub rate_step: u32,
    /// Frames that all viewers have received since the start.
    pub frames: u64,
}

/// A bar and what came of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SoakCheck {
    /// What is looked at.
    pub what: &'static str,
    /// What was found.
    pub found: String,
    /// It is as it should be.
    pub is_kept: bool,
}

/// A whole soak.
#[derive(Clone, Debug, Serialize)]
pub struct SoakReport {
    /// Version of this format.
    pub format: u32,
    /// The server.
    pub url: String,
    /// What rendered.
    pub adapter: String,
    /// In the crowd.
    pub viewers: usize,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames a second that each viewer wished.
    pub fps: f64,
    /// Error that all viewers ask for, FLIP.
    pub max_error: f64,
    /// How long, s.
    pub seconds: f64,
    /// Frames received, by all.
    pub frames: u64,
    /// Those of them that were marked coarse.
    pub coarse_frames: u64,
    /// Longer than 1.5 s without a frame or a heartbeat.
    pub missed_heartbeats: u64,
    /// The longest time without either, of any viewer, ms.
    pub longest_gap_ms: f64,
    /// Pictures with a black pixel, or that were none.
    pub bad_pictures: u64,
    /// Changes of view cells, by all viewers.
    pub cell_changes: u64,
    /// Wanted tiles that found no room.
    pub tiles_refused: u64,
    /// Processor time of the server, s.
    pub cpu_s: Option<f64>,
    /// Once a second.
    pub samples: Vec<SoakSample>,
}

impl SoakReport {
    /// Every bar.
    #[must_use]
    pub fn checks(&self) -> Vec<SoakCheck> {
        let check = |what, found, is_kept| SoakCheck {
            what,
            found,
            is_kept,
        };
        let (early, late) = self.memory_early_and_late();
        let within = self.share_within_error();
        vec![
            check(
                "no growth of memory (5 % at most)",
                match (early, late) {
                    (Some(early), Some(late)) => {
                        format!("{:.1} MiB, at the end {:.1} MiB", mib(early), mib(late))
                    }
                    _ => "the server does not tell".to_owned(),
                },
                early.zip(late).is_some_and(|(early, late)| {
                    late as f64 <= early as f64 * (1.0 + MEMORY_GROWTH_MAX)
                }),
            ),
            check(
                "no heartbeat missed",
                format!(
                    "{} missed, longest gap {:.0} ms",
                    self.missed_heartbeats, self.longest_gap_ms
                ),
                self.missed_heartbeats == 0,
            ),
            check(
                "no black pixel, no broken picture",
                format!("{} of {} pictures", self.bad_pictures, self.frames),
                self.bad_pictures == 0 && self.frames > 0,
            ),
            check(
                "error of the caches (p95) as asked for in 95 % of the time",
                within.map_or("not measured".to_owned(), |share| {
                    let asked = 100.0 * self.max_error;
                    format!("at most {asked:.1} % in {:.1} % of the time", 100.0 * share)
                }),
                within.is_some_and(|share| share >= WITHIN_ERROR_MIN),
            ),
            check(
                "every wanted tile finds room",
                format!("{} did not", self.tiles_refused),
                self.tiles_refused == 0,
            ),
        ]
    }

    /// Whether every bar is kept.
    #[must_use]
    pub fn is_kept(&self) -> bool {
        self.checks().iter().all(|check| check.is_kept)
    }

    /// Share of the seconds in which the audit's p95 was within the asked error; none without an audit.
    #[must_use]
    pub fn share_within_error(&self) -> Option<f64> {
        let audited = self.samples.iter().filter_map(|s| s.audit_p95_percent);
        let audited: Vec<f64> = audited.collect();
        let within = audited.iter().filter(|p| **p <= 100.0 * self.max_error);
        (!audited.is_empty()).then(|| within.count() as f64 / audited.len() as f64)
    }

    /// Medians of memory in the second and in the last fifth of the time: what begins is over by then.
    fn memory_early_and_late(&self) -> (Option<u64>, Option<u64>) {
        let fifth = (self.samples.len() / 5).max(1);
        let of = |samples: &[SoakSample]| {
            let mut bytes: Vec<u64> = samples.iter().filter_map(|s| s.memory_bytes).collect();
            bytes.sort_unstable();
            bytes.get(bytes.len() / 2).copied()
        };
        let fifths: Vec<&[SoakSample]> = self.samples.chunks(fifth).collect();
        let late = self.samples.len().saturating_sub(fifth);
        (
            fifths.get(1).and_then(|samples| of(samples)),
            of(&self.samples[late..]),
        )
    }

    /// For people.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = format!(
            "{} viewers of {}x{} who migrate, {} fps wished, error {} asked, {:.0} s, on {}\n\n",
            self.viewers,
            self.width,
            self.height,
            self.fps,
            self.max_error,
            self.seconds,
            self.adapter
        );
        text.push_str(
            "until, s  cells  frames/s  memory, MiB  caches, MiB  error p95, %  levels lost  rate step\n",
        );
        let lines = (self.samples.len() / 60).clamp(1, 10);
        let per_line = self.samples.len().div_ceil(lines).max(1);
        let mut before = (0.0, 0);
        for minute in self.samples.chunks(per_line) {
            let Some(last) = minute.last() else { continue };
            let mut cells: Vec<usize> = minute.iter().map(|s| s.cells).collect();
            cells.sort_unstable();
            let p95 = minute.iter().filter_map(|s| s.audit_p95_percent);
            let passed_s = (last.at_s - before.0).max(1e-3);
            let frames = last.frames.saturating_sub(before.1) as f64 / passed_s;
            let _ = writeln!(
                text,
                "{:>8.0}  {:>5}  {:>8.1}  {:>11}  {:>11.1}  {:>12}  {:>11}  {:>9}",
                last.at_s,
                match (cells.first(), cells.last()) {
                    (Some(least), Some(most)) if least != most => format!("{least}-{most}"),
                    (least, _) => least.map_or_else(String::new, usize::to_string),
                },
                frames,
                last.memory_bytes
                    .map_or("-".to_owned(), |bytes| format!("{:.1}", mib(bytes))),
                mib(last.cache_bytes),
                p95.fold(None, |most: Option<f64>, p| Some(
                    most.map_or(p, |m| m.max(p))
                ))
                .map_or("-".to_owned(), |most| format!("{most:.2}")),
                minute.iter().map(|s| s.levels_lost).max().unwrap_or(0),
                minute.iter().map(|s| s.rate_step).max().unwrap_or(0),
            );
            before = (last.at_s, last.frames);
        }
        let _ = writeln!(
            text,
            "\n{} frames ({} coarse), {} changes of cells{}\n",
            self.frames,
            self.coarse_frames,
            self.cell_changes,
            self.cpu_s.map_or_else(String::new, |cpu_s| {
                let cores = cpu_s / self.seconds.max(1e-3);
                format!(", {cores:.2} cores of the server")
            })
        );
        for check in self.checks() {
            let kept = if check.is_kept { "kept  " } else { "MISSED" };
            let _ = writeln!(text, "{kept}  {}: {}", check.what, check.found);
        }
        text
    }
}

fn mib(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(memory: impl Fn(usize) -> u64, p95: impl Fn(usize) -> f64) -> SoakReport {
        let samples = (0..100).map(|second| SoakSample {
            at_s: second as f64,
            memory_bytes: Some(memory(second) << 20),
            audit_p95_percent: Some(p95(second)),
            frames: 30 * second as u64,
            cells: 1 + second / 40,
            ..SoakSample::default()
        });
        SoakReport {
            format: 1,
            url: String::new(),
            adapter: "llvmpipe".to_owned(),
            viewers: 6,
            width: 96,
            height: 54,
            fps: 5.0,
            max_error: 0.05,
            seconds: 100.0,
            frames: 3_000,
            coarse_frames: 10,
            missed_heartbeats: 0,
            longest_gap_ms: 400.0,
            bad_pictures: 0,
            cell_changes: 4,
            tiles_refused: 0,
            cpu_s: Some(40.0),
            samples: samples.collect(),
        }
    }

    fn missed(report: &SoakReport) -> Vec<&'static str> {
        let checks = report.checks().into_iter();
        checks.filter(|c| !c.is_kept).map(|c| c.what).collect()
    }

    #[test]
    fn each_bar_is_missed_by_what_it_is_there_for_and_by_nothing_else() {
        // Memory that comes early is no growth.
        let good = || report(|second| 100 + second.min(20) as u64, |_| 4.0);
        assert!(good().is_kept(), "{}", good().table());
        let grows = report(|second| 100 + second as u64, |_| 4.0);
        assert_eq!(missed(&grows).len(), 1, "{}", grows.table());
        let wrong = report(|_| 100, |second| if second < 10 { 6.0 } else { 4.0 });
        assert_eq!(missed(&wrong).len(), 1, "{}", wrong.table());
        assert_eq!(wrong.share_within_error(), Some(0.9));
        for spoil in [
            (|r| r.missed_heartbeats = 1) as fn(&mut SoakReport),
            |r| r.bad_pictures = 1,
            |r| r.tiles_refused = 1,
            |r| r.frames = 0,
        ] {
            let mut spoilt = good();
            spoil(&mut spoilt);
            assert_eq!(missed(&spoilt).len(), 1);
            assert!(spoilt.table().contains("MISSED"));
        }
    }
}
