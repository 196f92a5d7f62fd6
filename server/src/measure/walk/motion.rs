//! How a sequence of pictures moves beside one that moves right.

use crate::measure::metrics::{CompareError, shown_errors};
use image::RgbImage;
use serde::Serialize;

/// Frames on either side that a frame's change is compared with.
const NEIGHBOURS: usize = 3;

/// How far two sequences of the same eyes are apart, and how differently they move.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Motion {
    /// Mean FLIP between both, frame by frame.
    pub flip: Vec<f64>,
    /// FLIP from each frame to the next of the sequence that moves right.
    pub changes_own: Vec<f64>,
    /// The same of the other.
    pub changes: Vec<f64>,
    /// Mean of `changes` over that of `changes_own`: 1 where as much moves.
    pub changes_ratio: f64,
    /// What swims: how much what is wrong changes from frame to frame, over how much the right sequence changes. 0 where
    /// both move alike, whatever they show; 1 for a picture that stands still. Mean of absolute differences.
    pub swimming: f64,
    /// The largest change over the median of those around it, of the sequence that moves right.
    pub pop_own: f64,
    /// The same of the other: a pop is a change that stands out.
    pub pop: f64,
    /// The frame that it leads to.
    pub pop_frame: usize,
}

impl Motion {
    /// Of at least three pairs of frames.
    ///
    /// # Errors
    /// For pictures of different sizes.
    pub fn of(own: &[RgbImage], seen: &[RgbImage]) -> Result<Self, CompareError> {
        let flip = own
            .iter()
            .zip(seen)
            .map(|(a, b)| Ok(shown_errors(a, b)?.flip))
            .collect::<Result<Vec<f64>, CompareError>>()?;
        let changes_own = changes(own)?;
        let changes = changes(seen)?;
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
        let (pop_own, _) = pop(&changes_own);
        let (pop, pop_at) = pop(&changes);
        Ok(Self {
            changes_ratio: mean(&changes) / mean(&changes_own).max(1e-9),
            swimming: swimming(own, seen),
            pop_own,
            pop,
            pop_frame: pop_at + 1,
            flip,
            changes_own,
            changes,
        })
    }

    /// For people.
    #[must_use]
    pub fn told(&self) -> String {
        let last = self.flip.last().copied().unwrap_or_default();
        format!(
            "FLIP {last:.4} at the end, change from frame to frame ÷ that of own rays {:.2}, swimming {:.2}, largest change \
             ÷ those around it {:.2} at frame {} (own rays {:.2})",
            self.changes_ratio, self.swimming, self.pop, self.pop_frame, self.pop_own
        )
    }
}

fn changes(pictures: &[RgbImage]) -> Result<Vec<f64>, CompareError> {
    pictures
        .windows(2)
        .map(|pair| Ok(shown_errors(&pair[0], &pair[1])?.flip))
        .collect()
}

/// The largest change over the median of its neighbours, and where it is.
fn pop(changes: &[f64]) -> (f64, usize) {
    let over_neighbours = |at: usize| {
        let low = at.saturating_sub(NEIGHBOURS);
        let high = (at + NEIGHBOURS + 1).min(changes.len());
        let mut around: Vec<f64> = (low..high)
            .filter(|i| *i != at)
            .map(|i| changes[i])
            .collect();
        around.sort_by(f64::total_cmp);
        let median = around.get(around.len() / 2).copied().unwrap_or_default();
        changes[at] / median.max(1e-9)
    };
    (0..changes.len())
        .map(|at| (over_neighbours(at), at))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or_default()
}

/// Mean |Δ(seen − own)| over mean |Δ own|, Δ from frame to frame.
fn swimming(own: &[RgbImage], seen: &[RgbImage]) -> f64 {
    let (mut wrong, mut right) = (0.0, 0.0);
    for (o, s) in own.windows(2).zip(seen.windows(2)) {
        let values = |picture: &RgbImage| -> Vec<f64> {
            picture.as_raw().iter().map(|v| f64::from(*v)).collect()
        };
        let [o0, o1, s0, s1] = [&o[0], &o[1], &s[0], &s[1]].map(values);
        for at in 0..o0.len() {
            let moved = o1[at] - o0[at];
            right += f64::abs(moved);
            wrong += f64::abs(s1[at] - s0[at] - moved);
        }
    }
    wrong / f64::max(right, 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// A soft blob at a place.
    fn blob(x: f64) -> RgbImage {
        RgbImage::from_fn(64, 32, |px, py| {
            let d = (f64::from(px) - x).powi(2) + (f64::from(py) - 16.0).powi(2);
            Rgb([(200.0 * (-d / 40.0).exp()) as u8 + 20; 3])
        })
    }

    fn moving(offsets: impl Iterator<Item = f64>) -> Vec<RgbImage> {
        offsets.map(blob).collect()
    }

    #[test]
    fn what_moves_alike_swims_not_at_all_and_what_stands_still_wholly() {
        let own = moving((0..10).map(|i| 20.0 + f64::from(i)));
        let alike = Motion::of(&own, &own).expect("comparable");
        assert_eq!(alike.swimming, 0.0);
        assert!((alike.changes_ratio - 1.0).abs() < 1e-12);
        let still = Motion::of(&own, &vec![own[0].clone(); 10]).expect("comparable");
        assert!((still.swimming - 1.0).abs() < 1e-12, "{}", still.swimming);
        assert!(still.changes_ratio < 1e-3);
    }

    #[test]
    fn a_jump_in_the_middle_is_found_as_a_pop_and_where_it_is() {
        let own = moving((0..20).map(|i| 20.0 + f64::from(i)));
        let jump = |i: i32| 20.0 + f64::from(i) + if i >= 12 { 6.0 } else { 0.0 };
        let seen = moving((0..20).map(jump));
        let motion = Motion::of(&own, &seen).expect("comparable");
        assert_eq!(motion.pop_frame, 12);
        assert!(motion.pop > 2.0 && motion.pop_own < 1.2, "{motion:?}");
    }
}
