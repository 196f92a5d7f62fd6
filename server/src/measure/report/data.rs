//! The report's figures, from the outcomes of a sweep.

use super::super::front::{Preset, Tradeoff, pareto_front, preset_point};
use super::super::plan::{Axis, Extent, PlannedPoint};
use super::super::settings::PointSettings;
use super::super::store::{Measurement, Record};
use crate::quality::FEW_TILES_MIP_BIAS;
use serde::Serialize;
use serde_json::Value;
use skycell_protocol::{Camera, FrameSize};

/// What a frame costs is told in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CostUnit {
    /// Texture reads, counted by the shader: the same on every machine.
    TextureReads,
    /// Milliseconds by the device's timestamps.
    GpuMs,
    /// Milliseconds by the clock.
    WallMs,
}

impl CostUnit {
    /// The best that all measurements have.
    #[must_use]
    pub fn of<'a>(measurements: impl Iterator<Item = &'a Measurement> + Clone) -> Self {
        if measurements.clone().all(|m| m.cost.texture_reads.is_some()) {
            Self::TextureReads
        } else if measurements.clone().all(|m| m.cost.gpu_ns.is_some()) {
            Self::GpuMs
        } else {
            Self::WallMs
        }
    }

    /// What stands at an axis.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::TextureReads => "texture reads a frame",
            Self::GpuMs => "GPU ms a frame",
            Self::WallMs => "ms a frame by the clock",
        }
    }

    /// A whole picture's cost.
    #[must_use]
    pub fn cost(self, measurement: &Measurement) -> Option<f64> {
        let cost = measurement.cost;
        match self {
            Self::TextureReads => cost.texture_reads.map(|n| n as f64),
            Self::GpuMs => cost.gpu_ns.map(|ns| ns as f64 / 1e6),
            Self::WallMs => Some(cost.wall_s * 1e3),
        }
    }
}

/// What the run was.
#[derive(Clone, Debug, Serialize)]
pub struct RunFacts {
    /// Version of the program.
    pub version: String,
    /// The command that does the same again.
    pub command: String,
    /// What rendered.
    pub adapter: String,
    /// Of the shown picture.
    pub size: FrameSize,
    /// Where the eye was.
    pub camera: Camera,
    /// The whole scene document.
    pub scene: Value,
    /// How much was measured.
    pub extent: Extent,
    /// What pictures were measured against.
    pub reference: String,
    /// How pixels were made comparable.
    pub footprint: String,
    /// What the reader has to know.
    pub notes: Vec<String>,
}

/// A point of an axis with what came out.
#[derive(Clone, Debug, Serialize)]
pub struct ReportPoint {
    /// Which axis.
    pub axis: Axis,
    /// What it is called there.
    pub label: String,
    /// Where it stands there.
    pub position: f64,
    /// The point.
    pub settings: PointSettings,
    /// Its key in the store.
    pub key: String,
    /// What came out.
    pub measurement: Measurement,
    /// FLIP against the axis's own most accurate point: the error of this setting alone.
    pub flip_of_axis: Option<f64>,
    /// Cost of a frame in the report's unit.
    pub frame_cost: Option<f64>,
    /// Nothing beats it.
    pub on_front: bool,
}

impl ReportPoint {
    /// A point of a plan with what came out.
    #[must_use]
    pub fn new(planned: &PlannedPoint, record: &Record) -> Self {
        Self {
            axis: planned.axis,
            label: planned.label.clone(),
            position: planned.position,
            settings: planned.settings,
            key: record.key.clone(),
            measurement: record.measurement,
            flip_of_axis: None,
            frame_cost: None,
            on_front: false,
        }
    }

    fn tradeoff(&self) -> Tradeoff {
        Tradeoff {
            cost: self.frame_cost.unwrap_or(f64::NAN),
            error: self.measurement.shown.flip,
        }
    }
}

/// Costs of a frame, or factors between them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RungCosts {
    /// Texture reads.
    pub texture_reads: Option<f64>,
    /// Evaluations of a density.
    pub density_evaluations: Option<f64>,
    /// Rays.
    pub marches: Option<f64>,
    /// Milliseconds by the device's timestamps.
    pub gpu_ms: Option<f64>,
    /// Milliseconds by the clock.
    pub wall_ms: Option<f64>,
}

impl RungCosts {
    /// Of a frame.
    #[must_use]
    pub fn of_frame(point: &ReportPoint) -> Self {
        let frames = f64::from(point.settings.window_frames);
        let cost = point.measurement.cost;
        Self {
            texture_reads: cost.texture_reads.map(|n| n as f64 / frames),
            density_evaluations: cost.density_evaluations.map(|n| n as f64 / frames),
            marches: Some(cost.marches as f64 / frames),
            gpu_ms: cost.gpu_ns.map(|ns| ns as f64 / 1e6 / frames),
            wall_ms: Some(cost.wall_s * 1e3 / frames),
        }
    }

    /// How many times less than `plain`.
    #[must_use]
    fn factors(self, plain: Self) -> Self {
        let factor = |a: Option<f64>, b: Option<f64>| Some(b? / a?).filter(|f| f.is_finite());
        Self {
            texture_reads: factor(self.texture_reads, plain.texture_reads),
            density_evaluations: factor(self.density_evaluations, plain.density_evaluations),
            marches: factor(self.marches, plain.marches),
            gpu_ms: factor(self.gpu_ms, plain.gpu_ms),
            wall_ms: factor(self.wall_ms, plain.wall_ms),
        }
    }
}

/// A rung of the ladder.
#[derive(Clone, Debug, Serialize)]
pub struct Rung {
    /// What it adds.
    pub name: String,
    /// Costs of a frame.
    pub frame: RungCosts,
    /// How many times less than the plain march.
    pub times_less_than_plain: RungCosts,
    /// Mean FLIP against the reference.
    pub flip: f64,
    /// Mean FLIP against the plain march's picture.
    pub flip_of_plain: Option<f64>,
    /// Mean SSIM.
    pub ssim: f64,
    /// Relative MSE.
    pub relative_mse: Option<f64>,
}

/// A preset with its point.
#[derive(Clone, Debug, Serialize)]
pub struct PresetChoice {
    /// Which.
    pub preset: Preset,
    /// The rule that picks it.
    pub rule: String,
    /// Index of the point; none when no point is good enough.
    pub point: Option<usize>,
}

/// All that is reported.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// What the run was.
    pub run: RunFacts,
    /// What `frame_cost` is told in.
    pub cost_unit: CostUnit,
    /// Every point of every axis.
    pub points: Vec<ReportPoint>,
    /// The rungs, from the plain march down.
    pub ladder: Vec<Rung>,
    /// Points that nothing beats, by rising cost: indices.
    pub front: Vec<usize>,
    /// The same among the points that a server can be set to.
    pub quality_front: Vec<usize>,
    /// And among those of them with all samples in each texel, for who asks for an error.
    pub each_texel_front: Vec<usize>,
    /// And among those by area with few tiles, for devices on which it is tiles that cost.
    pub few_tiles_front: Vec<usize>,
    /// Presets, picked from `quality_front`.
    pub presets: Vec<PresetChoice>,
}

impl Report {
    /// A report of points. `flip_between` compares the shown pictures of two keys.
    #[must_use]
    pub fn new(
        run: RunFacts,
        mut points: Vec<ReportPoint>,
        flip_between: impl Fn(&str, &str) -> Option<f64>,
    ) -> Self {
        let cost_unit = CostUnit::of(points.iter().map(|p| &p.measurement));
        for point in &mut points {
            let whole = cost_unit.cost(&point.measurement);
            point.frame_cost = whole.map(|cost| cost / f64::from(point.settings.window_frames));
        }
        for axis in Axis::ALL {
            set_flip_of_axis(axis, &mut points, &flip_between);
        }
        let tradeoffs: Vec<Tradeoff> = points.iter().map(ReportPoint::tradeoff).collect();
        let front = front_of(&points, &tradeoffs, |p| p.codec.is_none());
        let quality_front = front_of(&points, &tradeoffs, PointSettings::is_quality);
        let each_texel_front = front_of(&points, &tradeoffs, |p| {
            p.is_quality() && !p.samples_by_area
        });
        let few_tiles_front = front_of(&points, &tradeoffs, |p| {
            p.is_quality() && p.samples_by_area && f64::from(p.mip_bias) >= FEW_TILES_MIP_BIAS
        });
        for i in &front {
            points[*i].on_front = true;
        }
        let presets = Preset::ALL
            .into_iter()
            .map(|preset| PresetChoice {
                preset,
                rule: preset
                    .flip_max()
                    .map_or("the least FLIP".to_owned(), |max| {
                        format!("the cheapest with FLIP ≤ {max}")
                    }),
                point: preset_point(preset, &quality_front, &tradeoffs),
            })
            .collect();
        Self {
            ladder: ladder(&points),
            run,
            cost_unit,
            points,
            front,
            quality_front,
            each_texel_front,
            few_tiles_front,
            presets,
        }
    }

    /// The points of an axis with their indices.
    pub fn points_of(&self, axis: Axis) -> impl Iterator<Item = (usize, &ReportPoint)> {
        self.points
            .iter()
            .enumerate()
            .filter(move |(_, p)| p.axis == axis)
    }
}

/// The front of those points that `belongs` takes; a point that stands on several axes is taken once.
fn front_of(
    points: &[ReportPoint],
    tradeoffs: &[Tradeoff],
    belongs: impl Fn(&PointSettings) -> bool,
) -> Vec<usize> {
    let of_these: Vec<usize> = (0..points.len())
        .filter(|i| belongs(&points[*i].settings))
        .collect();
    let these: Vec<Tradeoff> = of_these.iter().map(|i| tradeoffs[*i]).collect();
    pareto_front(&these)
        .into_iter()
        .map(|i| of_these[i])
        .collect()
}

/// The point of an axis that the others leave something out of, where there is one.
fn finest<'a>(
    axis: Axis,
    points: impl Iterator<Item = &'a ReportPoint>,
) -> Option<&'a ReportPoint> {
    let by_position = |a: &&ReportPoint, b: &&ReportPoint| a.position.total_cmp(&b.position);
    match axis {
        Axis::Steps | Axis::SunSteps | Axis::Octaves | Axis::Budget | Axis::Codec => {
            points.max_by(by_position)
        }
        Axis::Ladder | Axis::Resolution | Axis::MipBias | Axis::Offset => {
            points.min_by(by_position)
        }
        Axis::SunVolume | Axis::Window | Axis::TexelFormat | Axis::Front => None,
    }
}

fn set_flip_of_axis(
    axis: Axis,
    points: &mut [ReportPoint],
    flip_between: &impl Fn(&str, &str) -> Option<f64>,
) {
    let best = finest(axis, points.iter().filter(|p| p.axis == axis));
    let Some(best) = best.map(|p| p.key.clone()) else {
        return;
    };
    for point in points.iter_mut().filter(|p| p.axis == axis) {
        point.flip_of_axis = flip_between(&best, &point.key);
    }
}

fn ladder(points: &[ReportPoint]) -> Vec<Rung> {
    let rungs: Vec<&ReportPoint> = points.iter().filter(|p| p.axis == Axis::Ladder).collect();
    let plain = rungs
        .first()
        .map(|p| RungCosts::of_frame(p))
        .unwrap_or_default();
    rungs
        .into_iter()
        .map(|point| {
            let frame = RungCosts::of_frame(point);
            Rung {
                name: point.label.clone(),
                frame,
                times_less_than_plain: frame.factors(plain),
                flip: point.measurement.shown.flip,
                flip_of_plain: point.flip_of_axis,
                ssim: point.measurement.shown.ssim,
                relative_mse: point.measurement.linear.map(|l| l.relative_mse),
            }
        })
        .collect()
}

/// What `--json` prints.
#[derive(Clone, Debug, Serialize)]
pub struct Summary<'a> {
    /// Folder of the results.
    pub out: &'a std::path::Path,
    /// What the run was.
    pub adapter: &'a str,
    /// What pictures were measured against.
    pub reference: &'a str,
    /// Points of the report.
    pub points: usize,
    /// Of these, how many were measured in this run.
    pub measured_now: u32,
    /// What costs are told in.
    pub cost_unit: CostUnit,
    /// The rungs.
    pub ladder: &'a [Rung],
    /// Presets with their points.
    pub presets: Vec<(Preset, Option<&'a ReportPoint>)>,
    /// How long the run took.
    pub wall_s: f64,
}
