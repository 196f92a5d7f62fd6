//! The points of the trade between speed and accuracy, and the picks that need no clock.

use super::QualitySettings;
use crate::config::{MARCH_STEPS, MIP_BIAS, SAMPLES};
use serde::{Deserialize, Serialize};
use skycell_protocol::QualityPreset;
use skycell_protocol::number_range::NumberRange;
use skycell_protocol::scene::ranges::{OCTAVES, SUN_STEPS};
use thiserror::Error;

/// The version of the file that is read.
const VERSION: u32 = 1;
/// More points than anybody measures.
const POINTS_MAX: usize = 1024;

/// How far a point's pictures are from the converged one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointError {
    /// Mean FLIP.
    pub flip: f64,
    /// SSIM of luma.
    pub ssim: f64,
    /// Mean of squared relative errors of linear radiance.
    pub relative_mse: f64,
}

/// What a point costs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointCost {
    /// Texture reads of one ray in the mean.
    pub texture_reads_per_ray: f64,
    /// Marching one view with all its samples, as a share of what the preset `high` takes.
    pub relative: f64,
}

/// One point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QualityPoint {
    /// Its name, if it has one.
    #[serde(default)]
    pub preset: Option<QualityPreset>,
    /// What it sets.
    pub settings: QualitySettings,
    /// Error and cost were measured. Otherwise they are orders of magnitude.
    #[serde(default = "measured")]
    pub measured: bool,
    /// How wrong its pictures are.
    pub error: PointError,
    /// What they cost.
    pub cost: PointCost,
}

fn measured() -> bool {
    true
}

impl QualityPoint {
    /// Its name, or `custom`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.preset.map_or("custom", QualityPreset::name)
    }
}

/// Why a file is no table of qualities.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum QualityTableError {
    /// Not JSON of the format.
    #[error("the table of qualities: {0}")]
    Format(#[from] serde_json::Error),
    /// A version that is not read.
    #[error("the table of qualities has version {0}; allowed: {VERSION}")]
    Version(u32),
    /// No points, or too many.
    #[error("the table of qualities has {0} points; allowed: 1 to {POINTS_MAX}")]
    Points(usize),
    /// A preset is missing or there twice.
    #[error("the table of qualities has {count} points with the preset {name}; allowed: 1")]
    Preset {
        /// Which.
        name: &'static str,
        /// How many.
        count: usize,
    },
    /// A number is out of range.
    #[error("point {point} of the table of qualities: {key} is {value}; allowed: {allowed}")]
    Value {
        /// Which point, from 0.
        point: usize,
        /// Which number.
        key: &'static str,
        /// What it is.
        value: f64,
        /// What it may be.
        allowed: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TableFile {
    version: u32,
    #[serde(rename = "measured_with")]
    _measured_with: String,
    points: Vec<QualityPoint>,
}

/// What was picked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pick {
    /// Index of the point.
    pub point: usize,
    /// It is as good, or as fast, as was asked for.
    pub is_met: bool,
}

/// The points, cheapest first.
#[derive(Clone, Debug, PartialEq)]
pub struct QualityTable {
    points: Vec<QualityPoint>,
}

impl QualityTable {
    /// The table that the server was built with.
    #[must_use]
    pub fn embedded() -> Self {
        match Self::from_json_text(include_str!("../../data/quality.json")) {
            Ok(table) => table,
            // The file is a part of the program; `the_embedded_table_is_measured_…` holds it right.
            Err(error) => unreachable!("{error}"),
        }
    }

    /// Reads a table.
    ///
    /// # Errors
    /// Says what is wrong and what is allowed.
    pub fn from_json_text(text: &str) -> Result<Self, QualityTableError> {
        let file: TableFile = serde_json::from_str(text)?;
        if file.version != VERSION {
            return Err(QualityTableError::Version(file.version));
        }
        if !(1..=POINTS_MAX).contains(&file.points.len()) {
            return Err(QualityTableError::Points(file.points.len()));
        }
        for (point, values) in file.points.iter().enumerate() {
            check(point, values)?;
        }
        for (name, preset) in QualityPreset::ALL {
            let named = file.points.iter().filter(|p| p.preset == Some(preset));
            let count = named.count();
            if count != 1 {
                return Err(QualityTableError::Preset { name, count });
            }
        }
        let mut points = file.points;
        points.sort_by(|a, b| {
            a.cost
                .relative
                .total_cmp(&b.cost.relative)
                .then(a.error.flip.total_cmp(&b.error.flip))
        });
        Ok(Self { points })
    }

    /// The points, cheapest first; at least the presets.
    #[must_use]
    pub fn points(&self) -> &[QualityPoint] {
        &self.points
    }

    /// A point; the cheapest where there is none of that index.
    #[must_use]
    pub fn point(&self, index: usize) -> &QualityPoint {
        self.points.get(index).unwrap_or(&self.points[0])
    }

    /// The point of a preset.
    #[must_use]
    pub fn pick_preset(&self, preset: QualityPreset) -> Pick {
        let found = self.points.iter().position(|p| p.preset == Some(preset));
        Pick {
            point: found.unwrap_or(0),
            is_met: found.is_some(),
        }
    }

    /// The cheapest point whose mean FLIP is not above `max_flip`; where all are worse, the best.
    #[must_use]
    pub fn pick_error(&self, max_flip: f64) -> Pick {
        self.pick_error_among(max_flip, |_| true)
    }

    /// The same among the points that `belongs` takes, where it takes any.
    #[must_use]
    pub fn pick_error_among(&self, max_flip: f64, belongs: impl Fn(&QualityPoint) -> bool) -> Pick {
        let good_enough = (self.points.iter()).position(|p| belongs(p) && p.error.flip <= max_flip);
        let picked = good_enough
            .or_else(|| self.best(&belongs))
            .or_else(|| self.best(|_| true));
        Pick {
            point: picked.unwrap_or(0),
            is_met: good_enough.is_some(),
        }
    }

    /// The point with the smallest error of those that `fits` takes; of equals the cheapest.
    #[must_use]
    pub fn best(&self, fits: impl Fn(&QualityPoint) -> bool) -> Option<usize> {
        self.points
            .iter()
            .enumerate()
            .filter(|(_, point)| fits(point))
            // `min_by` keeps the first of equals, which is the cheapest.
            .min_by(|a, b| a.1.error.flip.total_cmp(&b.1.error.flip))
            .map(|(index, _)| index)
    }
}

fn check(point: usize, values: &QualityPoint) -> Result<(), QualityTableError> {
    const ERROR: NumberRange = NumberRange::new(0.0, 1.0);
    const RELATIVE_MSE: NumberRange = NumberRange::new(0.0, 1e12);
    const READS: NumberRange = NumberRange::new(0.0, 1e9);
    const RELATIVE: NumberRange = NumberRange::new(1e-6, 1e6);
    let settings = &values.settings;
    let numbers = [
        ("march_steps", settings.march_steps.into(), MARCH_STEPS),
        (
            "sun_steps",
            settings.sun_steps.unwrap_or(1).into(),
            SUN_STEPS,
        ),
        ("octaves", settings.octaves.unwrap_or(1).into(), OCTAVES),
        ("samples", settings.samples.into(), SAMPLES),
        ("mip_bias", settings.mip_bias, MIP_BIAS),
        ("flip", values.error.flip, ERROR),
        ("ssim", values.error.ssim, NumberRange::new(-1.0, 1.0)),
        ("relative_mse", values.error.relative_mse, RELATIVE_MSE),
        (
            "texture_reads_per_ray",
            values.cost.texture_reads_per_ray,
            READS,
        ),
        ("relative", values.cost.relative, RELATIVE),
    ];
    match numbers
        .iter()
        .find(|(_, value, range)| !range.contains(*value))
    {
        None => Ok(()),
        Some((key, value, range)) => Err(QualityTableError::Value {
            point,
            key,
            value: *value,
            allowed: range.to_string(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_embedded_table_is_measured_and_its_presets_rise_in_cost_and_fall_in_error() {
        let table = QualityTable::embedded();
        let points = QualityPreset::ALL.map(|(_, preset)| {
            let pick = table.pick_preset(preset);
            assert!(pick.is_met && table.point(pick.point).measured);
            table.point(pick.point)
        });
        for pair in points[..3].windows(2) {
            assert!(pair[0].cost.relative < pair[1].cost.relative);
            assert!(pair[0].error.flip > pair[1].error.flip);
        }
        // The best that was measured; that may be what `high` is already.
        assert!(points[3].error.flip <= points[2].error.flip);
    }

    #[test]
    fn a_bad_table_is_refused_and_says_why() {
        let good = include_str!("../../data/quality.json");
        for (from, to, part) in [
            ("\"version\": 1", "\"version\": 2", "version 2; allowed: 1"),
            (
                "\"preset\": \"draft\"",
                "\"preset\": null",
                "0 points with the preset draft",
            ),
            (
                "\"mip_bias\": 2.0",
                "\"mip_bias\": 9",
                "mip_bias is 9; allowed: 0 to 4",
            ),
            (
                "\"relative\": 0.0",
                "\"relative\": -0.0",
                "relative is -0.0",
            ),
            ("\"samples\": 4", "\"sample\": 4", "unknown field `sample`"),
        ] {
            let text = good.replacen(from, to, 1);
            assert_ne!(text, good, "{from}");
            let error = QualityTable::from_json_text(&text)
                .expect_err(from)
                .to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn an_error_that_nothing_reaches_gets_the_best_and_says_so() {
        let table = QualityTable::embedded();
        let pick = table.pick_error(1e-9);
        assert!(!pick.is_met);
        let best = table.point(pick.point).error.flip;
        assert!(table.points().iter().all(|p| p.error.flip >= best));
    }

    /// Points with errors and costs in any relation, as measurements may bring them.
    fn table() -> impl Strategy<Value = QualityTable> {
        proptest::collection::vec((0.0..1.0f64, 1e-3..10.0f64), 1..20).prop_map(|values| {
            let point = QualityTable::embedded().points()[0];
            let mut points: Vec<QualityPoint> = values
                .into_iter()
                .map(|(flip, relative)| QualityPoint {
                    error: PointError {
                        flip,
                        ..point.error
                    },
                    cost: PointCost {
                        relative,
                        ..point.cost
                    },
                    ..point
                })
                .collect();
            points.sort_by(|a, b| a.cost.relative.total_cmp(&b.cost.relative));
            QualityTable { points }
        })
    }

    proptest! {
        #[test]
        fn a_smaller_error_never_picks_a_worse_point_nor_a_cheaper_one(table in table(), a in 0.0..1.0f64, b in 0.0..1.0f64) {
            let (small, large) = (a.min(b), a.max(b));
            let (strict, lax) = (table.pick_error(small), table.pick_error(large));
            prop_assert!(table.point(strict.point).error.flip <= table.point(lax.point).error.flip);
            if strict.is_met {
                prop_assert!(lax.is_met);
                prop_assert!(table.point(strict.point).cost.relative >= table.point(lax.point).cost.relative);
                prop_assert!(table.point(strict.point).error.flip <= small);
            }
        }
    }
}
