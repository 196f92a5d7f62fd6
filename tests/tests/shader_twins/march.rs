//! Where samples of a march stand, and what stands between them and the sun.

use super::density::moves;
use super::support::{SceneProbe, judge};
use glam::DVec3;
use serde_json::json;
use skycell_server::probe::{FieldPoint, FieldQuestion};
use skycell_tests::numbers::{Random, U, wide, worst};

#[test]
fn steps_count_the_distance_in_lengths_of_steps_and_back() {
    let probe = SceneProbe::open(&json!({"version": 1}), true);
    let mut random = Random(21);
    let points: Vec<FieldPoint> = (0..12_000)
        .map(|index| {
            let steps = random.one_of(&[1.0, 24.0, 96.0, 256.0, 4096.0]);
            let thickness_m = random.one_of(&[1.0, 500.0, 2_500.0, 2e5]);
            let (least_m, growth) = ((thickness_m / steps) as f32, (0.5 / steps) as f32);
            let bend_m = f64::from(least_m) / f64::from(growth);
            let distance_m = match index % 3 {
                0 => bend_m * random.one_of(&[0.0, 1e-3, 1.0 - 1e-6, 1.0, 1.0 + 1e-6]),
                1 => random.between(0.0, bend_m),
                _ => 10f64.powf(random.between(0.0, 6.4)),
            };
            let fraction = random.one_of(&[0.0, 0.5, 0.999]) as f32;
            [
                [least_m, growth, distance_m as f32, fraction],
                [0.0; 4],
                [0.0; 4],
                [0.0; 4],
            ]
        })
        .collect();
    let values = probe.ask(FieldQuestion::Steps, &points);
    let check = |growing: bool| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let [least_m, growth, distance_m, fraction] = point[0].map(f64::from);
            // ∫ ds / max(least, growth s).
            let relative = distance_m * growth / least_m;
            let grown = relative > 1.0 && growing;
            let scaled = if grown { 1.0 + relative.ln() } else { relative };
            let steps = scaled / growth;
            // log is known to 3 units, near 1 to 2^-21 (WGSL); the quotients round four times more.
            let scaled_error = 8.0 * U * scaled + if grown { 2f64.powi(-21) } else { 0.0 };
            let [found, back_m, first, _] = value[0].map(f64::from);
            // Back: e^x is known to 3 + 2 x units, and feels the count's error.
            let back_error = scaled_error.exp_m1() + (8.0 + 4.0 * scaled) * U;
            let whole = first - fraction;
            [
                ((found - steps).abs(), scaled_error / growth + 1e-30),
                (
                    (back_m - distance_m).abs(),
                    distance_m * 2.0 * back_error + 1e-30,
                ),
                // At or beyond, by less than a step, on the grid of whole steps and a fraction.
                (
                    (found - first).max(first - found - 1.0).max(0.0),
                    4.0 * U * (first + 1.0),
                ),
                ((whole - whole.round()).abs(), 2.0 * U * (first + 1.0)),
            ]
        }))
    };
    // Planted: steps that do not grow.
    judge("steps", points.len(), check(true), check(false));
}

#[test]
fn few_samples_of_a_texel_do_not_shift_the_picture() {
    let probe = SceneProbe::open(&json!({"version": 1}), true);
    let mut random = Random(23);
    let counts = [2.0, 4.0, 6.0, 8.0];
    let points: Vec<FieldPoint> = (0..10_000)
        .map(|index| {
            let place = [(); 2].map(|()| random.between(0.0, 2e4).floor() as f32);
            [
                [place[0], place[1], 0.0, 0.0],
                [counts[index % 4], 0.0, 0.0, 0.0],
                [0.0; 4],
                [0.0; 4],
            ]
        })
        .collect();
    let values = probe.ask(FieldQuestion::SampleOffset, &points);
    // Pairs are on opposite sides but for two sixteenths of a texel; all eight are around the middle.
    let allowed = |count: f32| {
        if count == 8.0 {
            1e-6
        } else {
            2.0 / 16.0 / f64::from(count) + 1e-6
        }
    };
    let check = |shift: f64| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let bound = allowed(point[1][0]);
            [0, 1].map(|axis| ((f64::from(value[0][axis]) + shift).abs(), bound))
        }))
    };
    // Planted: all of them a sixteenth aside.
    judge("sample places", points.len(), check(0.0), check(1.0 / 16.0));
}

#[test]
fn the_depth_towards_the_sun_is_that_of_its_samples() {
    let document = json!({"version": 1, "sun": {"elevation_deg": 30}, "light": {"sun_steps": 6},
        "layers": [{"density": {"model": "weather", "coverage": 0.6}}]});
    let probe = SceneProbe::open(&document, true);
    let mut random = Random(22);
    let points: Vec<FieldPoint> = (0..10_000)
        .map(|_| {
            let (x, z) = (random.between(-3e4, 3e4), random.between(-3e4, 3e4));
            let y = random.between(1500.0, 4000.0) - (x * x + z * z) / 12_720_000.0;
            [
                [x as f32, y as f32, z as f32, 0.0],
                [0.0; 4],
                [0.0; 4],
                [0.0; 4],
            ]
        })
        .collect();
    let values = probe.ask(FieldQuestion::SunOpticalDepth, &points);
    let layer = &probe.world.layers()[0];
    let sun = probe.world.light().sun_direction;
    let check = |middle: f64| {
        worst(points.iter().zip(&values).map(|(point, value)| {
            let position = DVec3::from_array(wide(point[0]));
            let (mut depth, mut bound) = (0.0, 0.0);
            for i in 0..6 {
                // Parts of 1500 m whose ends grow with the square of their number.
                let [near_m, far_m] = [i, i + 1].map(|i| 1500.0 * (f64::from(i) / 6.0).powi(2));
                let at = position + sun * (near_m + (far_m - near_m) * middle);
                let per_density = layer.extinction_per_m * (far_m - near_m);
                let twin = |at: DVec3| probe.world.smooth_density(layer, at);
                depth += per_density * twin(at);
                // As densities in `density`: a centimetre, and roundings times the surface's steepness.
                bound += per_density * (2.0 * moves(twin, at, 8.0 * U * 72_000.0) + 240.0 * U);
            }
            (
                (f64::from(value[0][0]) - depth).abs(),
                bound + 16.0 * U * depth,
            )
        }))
    };
    // Planted: samples at the far ends of their parts.
    judge(
        "depth towards the sun",
        points.len(),
        check(0.5),
        check(1.0),
    );
}
