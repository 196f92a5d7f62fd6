//! The sun volume: each value against the sum over its columns, and both ways to the sun against the integral.

use super::density::moves;
use super::support::{SceneProbe, judge};
use glam::{DVec2, DVec3};
use serde_json::{Value, json};
use skycell_protocol::SunDepth;
use skycell_reference::{World, WorldLayer};
use skycell_server::march::MarchSettings;
use skycell_server::probe::{FieldPoint, FieldQuestion};
use skycell_server::sun_volume::SunVolumeSize;
use skycell_tests::numbers::{Random, U, wide, worst};

const BASE_M: f64 = 1500.0;
const TOP_M: f64 = 4000.0;

fn scene(elevation_deg: f64) -> Value {
    json!({"version": 1, "sun": {"elevation_deg": elevation_deg},
        "layers": [{"density": {"model": "weather", "coverage": 0.6}}]})
}

fn with(depth: SunDepth, size: SunVolumeSize) -> MarchSettings {
    MarchSettings {
        sun_depth: Some(depth),
        sun_volume: size,
        exact_interpolation: true,
        ..MarchSettings::default()
    }
}

fn places(count: usize, reach_m: f64) -> Vec<FieldPoint> {
    let mut random = Random(31);
    (0..count)
        .map(|_| {
            let (x, z) = (
                random.between(-reach_m, reach_m),
                random.between(-reach_m, reach_m),
            );
            let y = random.between(BASE_M, TOP_M) - (x * x + z * z) / 12_720_000.0;
            [
                [x as f32, y as f32, z as f32, 0.0],
                [0.0; 4],
                [0.0; 4],
                [0.0; 4],
            ]
        })
        .collect()
}

/// Distance along a rising direction to an altitude, by secants: the altitude is nearly linear.
fn rise_m(world: &World, from: DVec3, direction: DVec3, altitude_m: f64) -> f64 {
    let over = |t: f64| world.globe().altitude_m(from + direction * t) - altitude_m;
    let (mut before, mut at) = (0.0, -over(0.0) / direction.y);
    for _ in 0..8 {
        let (f, g) = (over(before), over(at));
        if (at - before).abs() < 1e-6 || f == g {
            break;
        }
        (before, at) = (at, at - g * (at - before) / (g - f));
    }
    at
}

/// What a column holds at slices, m: density between slices by midpoints, summed from the top. With each, how much it
/// moves where places move by a few roundings.
struct ColumnTwin {
    slices: usize,
    substeps: usize,
}

impl ColumnTwin {
    fn amounts(&self, world: &World, layer: &WorldLayer, foot: DVec2, sun: DVec3) -> Vec<[f64; 2]> {
        let foot = world.frame_from_world_m(DVec3::new(foot.x, BASE_M, foot.y));
        let distance_m = |slice: usize| {
            let share = slice as f64 / (self.slices - 1) as f64;
            rise_m(world, foot, sun, BASE_M + share * (TOP_M - BASE_M))
        };
        let mut amounts = vec![[0.0; 2]; self.slices];
        for slice in (0..self.slices - 1).rev() {
            let (near_m, far_m) = (distance_m(slice), distance_m(slice + 1));
            let step_m = (far_m - near_m) / self.substeps as f64;
            let [mut sum_m, mut bound_m] = amounts[slice + 1];
            for i in 0..self.substeps {
                let at = foot + sun * (near_m + (i as f64 + 0.5) * step_m);
                let twin = |at: DVec3| world.smooth_density(layer, at);
                sum_m += twin(at) * step_m;
                // As densities in `density`: a centimetre, and roundings times the surface's steepness.
                bound_m += (2.0 * moves(twin, at, 8.0 * U * 72_000.0) + 240.0 * U) * step_m;
            }
            amounts[slice] = [sum_m, bound_m];
        }
        amounts
    }
}

#[test]
fn what_the_volume_tells_is_the_sum_over_its_columns() {
    // One level of 51 km, so that every point is far from its rim; few slices, so that f64 has little to add up.
    let size = SunVolumeSize {
        columns: 128,
        slices: 5,
        levels: 1,
        spacing_m: 400.0,
        near_steps: Some(0),
        near_columns: 1.0,
    };
    let probe = SceneProbe::open_with(&scene(40.0), with(SunDepth::Volume, size), 0.0);
    let points = places(10_000, 12_000.0);
    let values = probe.ask(FieldQuestion::SunOpticalDepth, &points);
    let layer = &probe.world.layers()[0];
    let sun = probe.world.light().sun_direction;
    // A slice of 625 m is 972 m long at 40°: 2.4 columns' distances, two samples.
    let twin = ColumnTwin {
        slices: 5,
        substeps: 2,
    };
    let check = |middle: f64| {
        worst(points.iter().zip(&values).map(|(point, value)| {
            let position = DVec3::from_array(wide(point[0]));
            let altitude_m = probe.world.globe().altitude_m(position);
            let down_m = rise_m(&probe.world, position, sun, BASE_M);
            let foot = position + sun * down_m;
            let columns = DVec2::new(foot.x, foot.z) / 400.0 - middle;
            let (low, share) = (columns.floor(), columns - columns.floor());
            let slice = ((altitude_m - BASE_M) / (TOP_M - BASE_M) * 4.0).clamp(0.0, 4.0);
            let below = (slice.floor() as usize).min(3);
            let up = slice - below as f64;
            let (mut depth, mut bound, mut most) = (0.0, 0.0, 0.0f64);
            for (x, z) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                let weight =
                    (1.0 - x + (2.0 * x - 1.0) * share.x) * (1.0 - z + (2.0 * z - 1.0) * share.y);
                let foot = (low + DVec2::new(x, z) + middle) * 400.0;
                let amounts = twin.amounts(&probe.world, layer, foot, sun);
                let [[a, da], [b, db]] = [amounts[below], amounts[below + 1]];
                depth += weight * (a + (b - a) * up);
                bound += weight * (da.max(db));
                most = most.max(a);
            }
            // A place on the torus is known to 8 U of a period of 128 columns, and one among 5 slices to as much of them:
            // what the columns around differ by counts so often.
            let read = 8.0 * U * (128.0 + 5.0) * 2.0 * most;
            (
                (f64::from(value[0][0]) - depth * layer.extinction_per_m).abs(),
                (bound + read + 64.0 * U * depth) * layer.extinction_per_m + 1e-9,
            )
        }))
    };
    // Planted: feet at the corners of their columns instead of in the middle.
    judge("sun volume", points.len(), check(0.5), check(0.0));
}

/// Mean of |e^-τ/4 − e^-τ'/4| at places in cloud, and how many these are: what the light of an octave is off by.
fn mean_error(elevation_deg: f64, settings: MarchSettings, truth: &[f64]) -> f64 {
    let probe = SceneProbe::open_with(&scene(elevation_deg), settings, 0.0);
    let values = probe.ask(
        FieldQuestion::SunOpticalDepth,
        &places(truth.len(), 3_000.0),
    );
    let light = |depth: f64| (-0.25 * depth).exp();
    let (sum, count) = values
        .iter()
        .zip(truth)
        .filter(|(_, truth)| truth.is_finite())
        .fold((0.0, 0), |(sum, count), (value, truth)| {
            let off = (light(value[0][0].into()) - light(*truth)).abs();
            (sum + off, count + 1)
        });
    sum / f64::from(count)
}

#[test]
fn one_sample_and_a_read_err_less_than_a_cone_of_six() {
    let elevation_deg = 40.0;
    let cone = with(SunDepth::Cone, SunVolumeSize::default());
    let probe = SceneProbe::open_with(&scene(elevation_deg), cone, 0.0);
    let layer = &probe.world.layers()[0];
    let sun = probe.world.light().sun_direction;
    let points = places(10_000, 3_000.0);
    // The integral to the layer's top in steps of 10 m, where there is cloud.
    let truth: Vec<f64> = points
        .iter()
        .map(|point| {
            let position = DVec3::from_array(wide(point[0]));
            if probe.world.smooth_density(layer, position) <= 0.0 {
                return f64::NAN;
            }
            let end_m = rise_m(&probe.world, position, sun, TOP_M).max(0.0);
            let steps = (end_m / 10.0).ceil().max(1.0);
            let step_m = end_m / steps;
            let sum: f64 = (0..steps as u32)
                .map(|i| {
                    let at = position + sun * ((f64::from(i) + 0.5) * step_m);
                    probe.world.smooth_density(layer, at)
                })
                .sum();
            sum * step_m * layer.extinction_per_m
        })
        .collect();
    let of = |settings| mean_error(elevation_deg, settings, &truth);
    let cone = of(cone);
    let volume = of(with(SunDepth::Volume, SunVolumeSize::default()));
    let coarse = of(with(
        SunDepth::Volume,
        SunVolumeSize {
            columns: 64,
            slices: 16,
            spacing_m: 200.0,
            ..SunVolumeSize::default()
        },
    ));
    println!(
        "mean error of e^(-τ/4): cone {cone:.5}, volume {volume:.5}, coarse volume {coarse:.5}"
    );
    assert!(volume < cone && volume < coarse, "{cone} {volume} {coarse}");
}
