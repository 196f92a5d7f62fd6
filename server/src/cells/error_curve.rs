//! How the error of a shared cache grows with the distance from its reference point: what the limit of cells follows from.

use super::CellLimit;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The version of the file that is read.
const VERSION: u32 = 2;
/// More ways to read a cache than anybody measures.
const CURVES_MAX: usize = 64;
/// More points than anybody measures.
const POINTS_MAX: usize = 256;
/// Cells that form are no narrower sideways, m, whatever error is asked for: viewers at one place must be able to share.
const RADIUS_MIN_M: f64 = 100.0;
/// The same upwards, m.
const RADIUS_UP_MIN_M: f64 = 50.0;

/// A distance and the error there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ErrorAt {
    /// From the reference point, m.
    pub distance_m: f64,
    /// Mean FLIP against a march from the viewer's own place.
    pub flip: f64,
}

/// Why a file is no curve.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ErrorCurveError {
    /// Not JSON of the format.
    #[error("the curve of errors over distance: {0}")]
    Format(#[from] serde_json::Error),
    /// A version that is not read.
    #[error("the curve of errors over distance has version {0}; allowed: {VERSION}")]
    Version(u32),
    /// No curve, too many, or none of a layer that is kept whole and read on its sphere alone.
    #[error(
        "there are {count} curves of errors over distance; allowed: 1 to {CURVES_MAX}, among them one of 1 slab and 0 parallax_steps"
    )]
    Curves {
        /// How many.
        count: usize,
    },
    /// Too few or too many points.
    #[error("the curve of errors {way} has {count} points; allowed: 2 to {POINTS_MAX}")]
    Points {
        /// Which way.
        way: &'static str,
        /// How many.
        count: usize,
    },
    /// A number is out of range or order.
    #[error(
        "point {point} of the curve of errors {way}: {key} is {value}; allowed: distances that rise from 0, FLIP from 0 to 1"
    )]
    Value {
        /// Which way.
        way: &'static str,
        /// Which point, from 0.
        point: usize,
        /// Which number.
        key: &'static str,
        /// What it is.
        value: f64,
    },
}

/// The file of `measure distance --write-curve`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ErrorCurveFile {
    /// Of the format.
    pub version: u32,
    /// By what.
    pub measured_with: String,
    /// One for each way to read a cache.
    pub curves: Vec<ReadingCurve>,
}

/// The errors of one way to read a cache.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReadingCurve {
    /// Slabs that each layer is cut into.
    pub slabs: u32,
    /// Most places of a viewer's search in each of them; 0: proxy spheres alone.
    pub parallax_steps: u32,
    /// The largest error of all level directions and views, by distance.
    pub sideways: Vec<ErrorAt>,
    /// The same upwards.
    pub up: Vec<ErrorAt>,
}

impl ErrorCurveFile {
    /// Of what was measured.
    #[must_use]
    pub fn new(measured_with: String, curves: Vec<ReadingCurve>) -> Self {
        Self {
            version: VERSION,
            measured_with,
            curves,
        }
    }
}

/// Error over distance for each way to read a cache that was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorCurves {
    /// Slabs, places of a search, and the curve; rising.
    curves: Vec<((u32, u32), ErrorCurve)>,
}

impl ErrorCurves {
    /// The curves that the server was built with.
    #[must_use]
    pub fn embedded() -> Self {
        match Self::from_json_text(include_str!("../../data/distance.json")) {
            Ok(curves) => curves,
            // The file is a part of the program; a test holds it right.
            Err(error) => unreachable!("{error}"),
        }
    }

    /// Reads curves.
    ///
    /// # Errors
    /// Says what is wrong and what is allowed.
    pub fn from_json_text(text: &str) -> Result<Self, ErrorCurveError> {
        let file: ErrorCurveFile = serde_json::from_str(text)?;
        if file.version != VERSION {
            return Err(ErrorCurveError::Version(file.version));
        }
        let count = file.curves.len();
        let has_simplest = file
            .curves
            .iter()
            .any(|curve| (curve.slabs, curve.parallax_steps) == (1, 0));
        if !has_simplest || count > CURVES_MAX {
            return Err(ErrorCurveError::Curves { count });
        }
        let mut curves = file
            .curves
            .into_iter()
            .map(|curve| {
                let reading = (curve.slabs, curve.parallax_steps);
                Ok((reading, ErrorCurve::new(curve.sideways, curve.up)?))
            })
            .collect::<Result<Vec<_>, ErrorCurveError>>()?;
        curves.sort_by_key(|(reading, _)| *reading);
        Ok(Self { curves })
    }

    /// The curve of viewers who read layers of so many slabs and search at so many places: of ways with neither more slabs
    /// nor more places, the one that is least wrong half the way to the farthest distance.
    #[must_use]
    pub fn of(&self, slabs: u32, parallax_steps: u32) -> &ErrorCurve {
        let (_, simplest) = &self.curves[0];
        let middle_m = 0.5 * simplest.farthest_m();
        self.curves
            .iter()
            .filter(|((s, p), _)| *s <= slabs.max(1) && *p <= parallax_steps)
            .map(|(_, curve)| curve)
            .min_by(|a, b| a.flip(middle_m, 0.0).total_cmp(&b.flip(middle_m, 0.0)))
            .unwrap_or(simplest)
    }
}

/// Error over distance, sideways and upwards: nowhere falling, measured up to a farthest distance.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorCurve {
    sideways: Vec<ErrorAt>,
    up: Vec<ErrorAt>,
}

impl ErrorCurve {
    /// Curves of points by rising distance.
    ///
    /// # Errors
    /// Says which point is wrong and what is allowed.
    pub fn new(sideways: Vec<ErrorAt>, up: Vec<ErrorAt>) -> Result<Self, ErrorCurveError> {
        Ok(Self {
            sideways: checked("sideways", sideways)?,
            up: checked("upwards", up)?,
        })
    }

    fn farthest_m(&self) -> f64 {
        self.sideways.last().map_or(0.0, |at| at.distance_m)
    }

    /// How wide a cell may be so that no viewer in it has an error above `max_error`: no narrower than a bound below which
    /// nobody could share, no wider than was measured.
    #[must_use]
    pub fn limit(&self, max_error: f64) -> CellLimit {
        CellLimit::new(
            distance_m(&self.sideways, max_error).max(RADIUS_MIN_M),
            distance_m(&self.up, max_error).max(RADIUS_UP_MIN_M),
        )
    }

    /// Mean FLIP at a place that is so far from the reference, sideways and upwards; of places farther than was measured,
    /// that of the farthest. A height counts as the way sideways that has the same error, and both as the sides of a right
    /// angle, as [`CellLimit::distance_m`] counts them.
    #[must_use]
    pub fn flip(&self, sideways_m: f64, up_m: f64) -> f64 {
        let as_sideways_m = distance_m(&self.sideways, flip_at(&self.up, up_m.abs()));
        let as_sideways_m = if up_m == 0.0 { 0.0 } else { as_sideways_m };
        flip_at(&self.sideways, sideways_m.hypot(as_sideways_m))
    }
}

/// Errors that never fall: noise of the measurement must not make a wider cell better than a narrow one.
fn checked(way: &'static str, mut points: Vec<ErrorAt>) -> Result<Vec<ErrorAt>, ErrorCurveError> {
    if !(2..=POINTS_MAX).contains(&points.len()) {
        return Err(ErrorCurveError::Points {
            way,
            count: points.len(),
        });
    }
    let mut before: Option<ErrorAt> = None;
    for (point, at) in points.iter_mut().enumerate() {
        let wrong = |key, value| ErrorCurveError::Value {
            way,
            point,
            key,
            value,
        };
        let rises = match before {
            None => at.distance_m == 0.0,
            Some(before) => at.distance_m > before.distance_m && at.distance_m.is_finite(),
        };
        if !rises {
            return Err(wrong("distance_m", at.distance_m));
        }
        if !(0.0..=1.0).contains(&at.flip) {
            return Err(wrong("flip", at.flip));
        }
        at.flip = before.map_or(at.flip, |before| before.flip.max(at.flip));
        before = Some(*at);
    }
    Ok(points)
}

/// The farthest distance whose error is not above `flip`, between points by a line.
fn distance_m(points: &[ErrorAt], flip: f64) -> f64 {
    let mut reached_m = 0.0;
    for pair in points.windows(2) {
        if pair[1].flip <= flip {
            reached_m = pair[1].distance_m;
        } else if pair[0].flip <= flip {
            // The second is above, so they differ.
            let share = (flip - pair[0].flip) / (pair[1].flip - pair[0].flip);
            return pair[0].distance_m + share * (pair[1].distance_m - pair[0].distance_m);
        } else {
            break;
        }
    }
    reached_m
}

/// The error at a distance, between points by a line; beyond the last that of the last.
fn flip_at(points: &[ErrorAt], distance_m: f64) -> f64 {
    let span = points
        .windows(2)
        .find(|pair| distance_m <= pair[1].distance_m);
    match span {
        Some(pair) => {
            let share =
                (distance_m - pair[0].distance_m) / (pair[1].distance_m - pair[0].distance_m);
            pair[0].flip + share.max(0.0) * (pair[1].flip - pair[0].flip)
        }
        None => points.last().map_or(0.0, |last| last.flip),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    fn curve(sideways: &[[f64; 2]], up: &[[f64; 2]]) -> Result<ErrorCurve, ErrorCurveError> {
        let points = |list: &[[f64; 2]]| {
            list.iter()
                .map(|[distance_m, flip]| ErrorAt {
                    distance_m: *distance_m,
                    flip: *flip,
                })
                .collect()
        };
        let curve = ReadingCurve {
            slabs: 1,
            parallax_steps: 0,
            sideways: points(sideways),
            up: points(up),
        };
        let file = ErrorCurveFile::new("a test".into(), vec![curve]);
        let curves = ErrorCurves::from_json_text(&serde_json::to_string(&file).expect("JSON"))?;
        Ok(curves.of(4, 16).clone())
    }

    fn known() -> ErrorCurve {
        curve(
            &[[0.0, 0.01], [1_000.0, 0.03], [3_000.0, 0.07]],
            &[[0.0, 0.01], [300.0, 0.03], [900.0, 0.05]],
        )
        .expect("a curve")
    }

    #[test]
    fn a_limit_is_where_the_lines_between_the_points_reach_the_error() {
        let up = |limit: CellLimit| {
            limit.radius_m() / limit.distance_m(DVec3::ZERO, DVec3::Y) // the height that counts as the radius
        };
        for (flip, sideways_m, up_m) in [
            (0.03, 1_000.0, 300.0),
            (0.02, 500.0, 150.0),
            (0.04, 1_500.0, 600.0),
            // Below what the cache has at its reference: as narrow as cells may be.
            (0.001, 100.0, 50.0),
            // Above all that was measured: as wide as was measured.
            (0.5, 3_000.0, 900.0),
        ] {
            let limit = known().limit(flip);
            assert!(
                (limit.radius_m() - sideways_m).abs() < 1e-6,
                "{flip}: {limit:?}"
            );
            assert!((up(limit) - up_m).abs() < 1e-6, "{flip}: {limit:?}");
        }
    }

    #[test]
    fn noise_that_falls_counts_as_none() {
        let bumpy = curve(
            &[[0.0, 0.01], [100.0, 0.03], [1_000.0, 0.02], [2_000.0, 0.05]],
            &[[0.0, 0.0], [1.0, 0.1]],
        )
        .expect("a curve");
        assert_eq!(bumpy.flip(1_000.0, 0.0), 0.03);
        assert!(bumpy.limit(0.025).radius_m() <= 100.0);
    }

    #[test]
    fn an_error_that_is_asked_for_narrows_cells_and_slabs_and_searches_widen_them() {
        let curves = ErrorCurves::embedded();
        for (slabs, parallax_steps) in [(1, 0), (1, 4), (1, 16), (2, 16), (4, 4), (4, 16)] {
            let curve = curves.of(slabs, parallax_steps);
            let radii = [0.02, 0.04, 0.08].map(|flip| curve.limit(flip).radius_m());
            assert!(radii.is_sorted(), "{radii:?}");
            assert!(radii[0] < radii[2], "{radii:?}");
        }
        for parallax_steps in [4, 16] {
            let radii =
                [1, 2, 4].map(|slabs| curves.of(slabs, parallax_steps).limit(0.08).radius_m());
            assert!(radii.is_sorted() && radii[0] < radii[2], "{radii:?}");
        }
        let radii = [0, 4, 16].map(|steps| curves.of(1, steps).limit(0.08).radius_m());
        assert!(radii.is_sorted() && radii[0] < radii[2], "{radii:?}");
        for distance_m in [1_000.0, 3_000.0, 5_000.0] {
            let flips = [1, 2, 4].map(|slabs| curves.of(slabs, 16).flip(distance_m, 0.0));
            assert!(flips.is_sorted_by(|a, b| a > b), "{distance_m}: {flips:?}");
        }
    }

    #[test]
    fn a_way_to_read_that_was_not_measured_has_the_curve_of_a_simpler_one() {
        let curves = ErrorCurves::embedded();
        assert_eq!(curves.of(3, 16), curves.of(2, 16));
        assert_eq!(curves.of(1, 8), curves.of(1, 4));
        assert_eq!(curves.of(0, 0), curves.of(1, 0));
        assert_eq!(curves.of(4, 64), curves.of(4, 16));
    }

    #[test]
    fn a_file_without_the_simplest_curve_is_refused() {
        let text = r#"{"version": 2, "measured_with": "", "curves": []}"#;
        let error = ErrorCurves::from_json_text(text).expect_err("none");
        assert!(error.to_string().contains("0 curves"), "{error}");
    }

    #[test]
    fn a_bad_curve_is_refused_and_says_why() {
        let good: &[[f64; 2]] = &[[0.0, 0.01], [100.0, 0.03]];
        for (bad, said) in [
            (&[[0.0, 0.01]][..], "1 points; allowed: 2 to"),
            (&[[5.0, 0.01], [6.0, 0.02]], "distance_m is 5"),
            (&[[0.0, 0.01], [0.0, 0.02]], "distance_m is 0"),
            (&[[0.0, 0.01], [6.0, 1.5]], "flip is 1.5"),
        ] {
            for error in [curve(bad, good), curve(good, bad)] {
                let error = error.expect_err(said).to_string();
                assert!(error.contains(said), "{error}");
            }
        }
    }

    proptest! {
        /// Whoever stands within the limit of an error has no larger one, but for the bounds of cells.
        #[test]
        fn nobody_within_a_limit_has_a_larger_error(flip in 0.015..0.2f64, share in 0.0..1.0f64, angle in 0.0..1.57f64) {
            let curve = known();
            let limit = curve.limit(flip);
            // A height counts in the limit by a line, in the curve by what was measured: they agree on the axes.
            for [x, y] in [[share, 0.0], [0.0, share]] {
                let up_m = limit.radius_m() / limit.distance_m(DVec3::ZERO, DVec3::Y);
                let found = curve.flip(x * limit.radius_m(), y * up_m);
                prop_assert!(found <= flip + 1e-9, "{found} at {x} {y}");
            }
            let near = curve.flip(share * 100.0 * angle.cos(), share * 30.0 * angle.sin());
            let far = curve.flip(100.0 * angle.cos(), 30.0 * angle.sin());
            prop_assert!(near <= far + 1e-12);
        }
    }
}
