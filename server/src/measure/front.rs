//! What nothing beats: the Pareto front of cost and error, and the presets picked from it.

use serde::{Deserialize, Serialize};

/// Quality presets, from the cheapest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Seen to be approximate.
    Draft,
    /// Hard to tell apart in motion.
    Balanced,
    /// Hard to tell apart at rest.
    High,
    /// The best that was measured.
    Reference,
}

impl Preset {
    /// Every preset.
    pub const ALL: [Self; 4] = [Self::Draft, Self::Balanced, Self::High, Self::Reference];

    /// Its name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Balanced => "balanced",
            Self::High => "high",
            Self::Reference => "reference",
        }
    }

    /// The cheapest point with at most this FLIP is the preset; without, the point of least FLIP.
    #[must_use]
    pub fn flip_max(self) -> Option<f64> {
        match self {
            Self::Draft => Some(0.06),
            Self::Balanced => Some(0.012),
            Self::High => Some(0.008),
            Self::Reference => None,
        }
    }
}

/// Cost and error of a point; less is better in both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tradeoff {
    /// Cost, in any unit.
    pub cost: f64,
    /// Error.
    pub error: f64,
}

/// Indices of the points that no other beats (at most the same cost and at most the same error, one of them less), by
/// rising cost and falling error. Of equal points the first is taken. Points that are not finite are left out.
#[must_use]
pub fn pareto_front(points: &[Tradeoff]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len())
        .filter(|i| points[*i].cost.is_finite() && points[*i].error.is_finite())
        .collect();
    order.sort_by(|a, b| {
        let (a, b) = (points[*a], points[*b]);
        a.cost.total_cmp(&b.cost).then(a.error.total_cmp(&b.error))
    });
    let mut least = f64::INFINITY;
    order.retain(|i| {
        let better = points[*i].error < least;
        least = least.min(points[*i].error);
        better
    });
    order
}

/// The preset's point of a front of `(index, error)` by rising cost; none when no point is good enough.
#[must_use]
pub fn preset_point(preset: Preset, front: &[usize], points: &[Tradeoff]) -> Option<usize> {
    match preset.flip_max() {
        Some(flip_max) => front.iter().copied().find(|i| points[*i].error <= flip_max),
        // Errors fall along the front.
        None => front.last().copied(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn beats(a: Tradeoff, b: Tradeoff) -> bool {
        a.cost <= b.cost && a.error <= b.error && (a.cost < b.cost || a.error < b.error)
    }

    proptest! {
        #[test]
        fn no_point_of_the_front_is_beaten_and_every_other_is(
            values in prop::collection::vec((0u8..20, 0u8..20), 0..40),
        ) {
            let points: Vec<Tradeoff> = values
                .iter()
                .map(|(cost, error)| Tradeoff { cost: f64::from(*cost), error: f64::from(*error) })
                .collect();
            let front = pareto_front(&points);
            prop_assert_eq!(front.is_empty(), points.is_empty());
            for i in &front {
                prop_assert!(!points.iter().any(|p| beats(*p, points[*i])));
            }
            for (i, point) in points.iter().enumerate() {
                let shown = front.contains(&i);
                prop_assert!(shown || front.iter().any(|f| beats(points[*f], *point) || points[*f] == *point));
            }
            for pair in front.windows(2) {
                let (a, b) = (points[pair[0]], points[pair[1]]);
                prop_assert!(a.cost < b.cost && a.error > b.error);
            }
        }
    }

    #[test]
    fn presets_are_the_cheapest_points_that_are_good_enough() {
        let points = [
            (1.0, 0.08),
            (2.0, 0.04),
            (3.0, 0.03),
            (4.0, 0.007),
            (9.0, 0.006),
            (10.0, 0.5),
        ]
        .map(|(cost, error)| Tradeoff { cost, error });
        let front = pareto_front(&points);
        let of = |preset| preset_point(preset, &front, &points);
        assert_eq!(Preset::ALL.map(of), [Some(1), Some(3), Some(3), Some(4)]);
        assert_eq!(preset_point(Preset::High, &front[..2], &points), None);
    }

    #[test]
    fn points_without_a_number_are_no_front() {
        let points = [(f64::NAN, 0.1), (1.0, f64::NAN), (f64::INFINITY, 0.1)]
            .map(|(cost, error)| Tradeoff { cost, error });
        assert!(pareto_front(&points).is_empty());
    }
}
