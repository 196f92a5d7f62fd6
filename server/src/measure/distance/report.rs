//! What was measured, and at which distance each way to read the cache is as wrong as the plain one.

use super::plan::{Direction, Fineness, Variant, View};
use crate::cells::{ErrorAt, ErrorCurveFile, ReadingCurve};
use crate::frame_loop::FrameFigures;
use crate::measure::metrics::ShownErrors;
use anyhow::ensure;
use serde::Serialize;
use serde_json::Value;
use skycell_protocol::FrameSize;

/// A picture from a cache against one from the eye.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DistancePoint {
    /// Where it looks.
    pub view: View,
    /// Which way the reference lies.
    pub direction: Direction,
    /// How the cache is read.
    pub variant: Variant,
    /// How far the reference is from the eye, m.
    pub distance_m: f64,
    /// How far the pictures are apart.
    #[serde(flatten)]
    pub errors: ShownErrors,
    /// What the picture took: of those that share texels with others, what was left to march. Composites are looked at
    /// where variants are compared.
    pub figures: FrameFigures,
}

/// What a composite of a variant costs, over the points at which variants are compared.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct VariantCost {
    /// How the cache is read.
    pub variant: Variant,
    /// Mean reads of atlas, page tables and origins for each pixel.
    pub reads_per_pixel: f64,
    /// Mean device time of a composite, where the device can tell, ns.
    pub composite_ns: Option<f64>,
}

/// Where a variant reaches the error that the plain cache has at a fixed distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Reach {
    /// Where it looks.
    pub view: View,
    /// Which way the reference lies.
    pub direction: Direction,
    /// How the cache is read.
    pub variant: Variant,
    /// Distance at which the simplest variant has `flip`, m.
    pub compared_at_m: f64,
    /// Its mean FLIP there.
    pub flip: f64,
    /// Where this variant reaches it first, between measured distances by a line, m; none within `measured_m`.
    pub reached_m: Option<f64>,
    /// The farthest distance that was measured, m.
    pub measured_m: f64,
}

impl Reach {
    /// For people.
    #[must_use]
    pub fn told(&self) -> String {
        let flip = self.flip;
        match self.reached_m {
            Some(reached_m) => format!("FLIP {flip:.4} at {reached_m:.0} m"),
            None => format!("FLIP {flip:.4} not within {:.0} m", self.measured_m),
        }
    }
}

/// All that is reported.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DistanceReport {
    /// What rendered.
    pub adapter: String,
    /// Of the pictures.
    pub size: FrameSize,
    /// Steps through a layer's thickness, of cache and screen alike.
    pub steps: u32,
    /// Samples of a texel and of a pixel.
    pub samples: u32,
    /// Where the middle of the pictures looks above the horizon.
    pub pitch_deg: f64,
    /// The whole scene document.
    pub scene: Value,
    /// Every picture.
    pub points: Vec<DistancePoint>,
    /// Distances of equal error.
    pub reaches: Vec<Reach>,
    /// What composites cost.
    pub costs: Vec<VariantCost>,
}

impl DistanceReport {
    /// A report of points.
    #[must_use]
    pub fn new(
        adapter: String,
        size: FrameSize,
        fineness: Fineness,
        pitch_deg: f64,
        scene: Value,
        points: Vec<DistancePoint>,
    ) -> Self {
        Self {
            adapter,
            size,
            steps: fineness.steps,
            samples: fineness.samples,
            pitch_deg,
            scene,
            reaches: reaches(&points),
            costs: costs(&points),
            points,
        }
    }

    /// FLIP over distance of one view, direction and variant, by rising distance.
    #[must_use]
    pub fn curve(&self, view: View, direction: Direction, variant: Variant) -> Vec<(f64, f64)> {
        curve(&self.points, view, direction, variant)
    }

    /// Of each variant that a server can be set to, the largest error over views, and sideways over both level directions:
    /// what the limit of cells follows from.
    ///
    /// # Errors
    /// When not all directions were measured.
    pub fn curve_file(&self) -> anyhow::Result<ErrorCurveFile> {
        let served = Variant::ALL.into_iter().filter(|v| v.is_served());
        let curves: Vec<ReadingCurve> = served
            .map(|variant| ReadingCurve {
                slabs: variant.slabs(),
                parallax_steps: variant.parallax_steps(),
                sideways: self.largest(&[Direction::Sideways, Direction::Forward], variant),
                up: self.largest(&[Direction::Up], variant),
            })
            .filter(|curve| curve.sideways.len() > 1 && curve.up.len() > 1)
            .collect();
        ensure!(
            curves
                .iter()
                .any(|curve| (curve.slabs, curve.parallax_steps) == (1, 0)),
            "--write-curve needs {}: allowed are --directions and --variants that hold a level direction, up and phase",
            Variant::Phase.name()
        );
        let measured_with = format!(
            "{}, {}x{}, {} steps, {} samples, against the screen-space renderer from the same eye",
            self.adapter,
            self.size.width(),
            self.size.height(),
            self.steps,
            self.samples,
        );
        Ok(ErrorCurveFile::new(measured_with, curves))
    }

    fn largest(&self, directions: &[Direction], variant: Variant) -> Vec<ErrorAt> {
        let mut largest: Vec<ErrorAt> = Vec::new();
        let these = self
            .points
            .iter()
            .filter(|p| p.variant == variant && directions.contains(&p.direction));
        for point in these {
            let (distance_m, flip) = (point.distance_m, point.errors.flip);
            match largest.iter_mut().find(|at| at.distance_m == distance_m) {
                Some(at) => at.flip = at.flip.max(flip),
                None => largest.push(ErrorAt { distance_m, flip }),
            }
        }
        largest.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        largest
    }
}

fn costs(points: &[DistancePoint]) -> Vec<VariantCost> {
    let mean = |values: Vec<f64>| {
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let of = |variant| {
        let these = || points.iter().filter(move |p| p.variant == variant);
        let reads = these().filter_map(|p| p.figures.reads_per_pixel);
        let times = these().filter_map(|p| p.figures.composite_ns);
        Some(VariantCost {
            variant,
            reads_per_pixel: mean(reads.collect())?,
            composite_ns: mean(times.map(|ns| ns as f64).collect()),
        })
    };
    Variant::ALL.into_iter().filter_map(of).collect()
}

fn curve(
    points: &[DistancePoint],
    view: View,
    direction: Direction,
    variant: Variant,
) -> Vec<(f64, f64)> {
    points
        .iter()
        .filter(|p| (p.view, p.direction, p.variant) == (view, direction, variant))
        .map(|p| (p.distance_m, p.errors.flip))
        .collect()
}

fn reaches(points: &[DistancePoint]) -> Vec<Reach> {
    let mut reaches = Vec::new();
    for view in View::ALL {
        for direction in Direction::ALL {
            let curves: Vec<(Variant, Vec<(f64, f64)>)> = Variant::ALL
                .into_iter()
                .map(|variant| (variant, curve(points, view, direction, variant)))
                .filter(|(_, curve)| !curve.is_empty())
                .collect();
            let compared_at_m = direction.compared_at_m();
            let flip = curves.first().and_then(|(_, plain)| {
                plain
                    .iter()
                    .find(|(distance_m, _)| *distance_m == compared_at_m)
                    .map(|(_, flip)| *flip)
            });
            let Some(flip) = flip else {
                continue;
            };
            for (variant, curve) in curves {
                reaches.push(Reach {
                    view,
                    direction,
                    variant,
                    compared_at_m,
                    flip,
                    reached_m: first_reached(&curve, flip),
                    measured_m: curve.last().map_or(0.0, |(distance_m, _)| *distance_m),
                });
            }
        }
    }
    reaches
}

/// Where a curve first comes up to a value, between its points by a line.
pub(in crate::measure) fn first_reached(curve: &[(f64, f64)], value: f64) -> Option<f64> {
    let (first_m, first) = *curve.first()?;
    if first >= value {
        return Some(first_m);
    }
    curve
        .windows(2)
        .find(|pair| pair[1].1 >= value)
        .map(|pair| {
            // The first point at or above it: the one before is below, so they differ.
            let share = (value - pair[0].1) / (pair[1].1 - pair[0].1);
            pair[0].0 + share * (pair[1].0 - pair[0].0)
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(direction: Direction, view: View, distance_m: f64, flip: f64) -> DistancePoint {
        DistancePoint {
            view,
            direction,
            variant: Variant::Phase,
            distance_m,
            errors: ShownErrors { flip, ssim: 1.0 },
            figures: FrameFigures::default(),
        }
    }

    fn report(points: Vec<DistancePoint>) -> DistanceReport {
        let fineness = Fineness {
            steps: 64,
            samples: 8,
        };
        let size = FrameSize::new(320, 180).expect("a size");
        DistanceReport::new("a device".into(), size, fineness, 20.0, Value::Null, points)
    }

    #[test]
    fn a_value_is_reached_where_the_line_between_two_points_crosses_it() {
        let curve = [(0.0, 0.01), (100.0, 0.03), (300.0, 0.02), (500.0, 0.06)];
        for (value, reached) in [
            (0.005, Some(0.0)),
            (0.02, Some(50.0)),
            (0.03, Some(100.0)),
            (0.045, Some(425.0)),
            (0.07, None),
        ] {
            let found = first_reached(&curve, value);
            let is_same = match (found, reached) {
                (Some(a), Some(b)) => f64::abs(a - b) < 1e-9,
                (a, b) => a == b,
            };
            assert!(is_same, "{value}: {found:?}");
        }
    }

    #[test]
    fn the_curve_of_cells_is_the_worst_of_views_and_level_directions() {
        let (to, from) = (View::TowardsSun, View::AwayFromSun);
        let report = report(vec![
            point(Direction::Sideways, to, 0.0, 0.01),
            point(Direction::Sideways, to, 1_000.0, 0.03),
            point(Direction::Forward, from, 0.0, 0.02),
            point(Direction::Forward, from, 1_000.0, 0.02),
            point(Direction::Up, to, 0.0, 0.01),
            point(Direction::Up, to, 300.0, 0.09),
        ]);
        let file = report.curve_file().expect("all directions");
        let [curve] = &file.curves[..] else {
            panic!("one variant was measured: {file:?}");
        };
        let flips: Vec<f64> = curve.sideways.iter().map(|at| at.flip).collect();
        assert_eq!(flips, [0.02, 0.03]);
        assert_eq!(curve.up.len(), 2);
        assert!(
            crate::cells::ErrorCurves::from_json_text(&serde_json::to_string(&file).expect("JSON"))
                .is_ok()
        );
    }

    #[test]
    fn a_curve_without_a_direction_is_refused() {
        let report = report(vec![
            point(Direction::Up, View::TowardsSun, 0.0, 0.01),
            point(Direction::Up, View::TowardsSun, 300.0, 0.09),
        ]);
        let error = report.curve_file().expect_err("no level one");
        assert!(error.to_string().contains("--directions"), "{error}");
    }
}
