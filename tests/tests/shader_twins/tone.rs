//! From radiance to bytes.

use super::support::{Point, Probe, SceneProbe, judge};
use skycell_server::probe::{FieldPoint, FieldQuestion, FunctionQuestion as Question};
use skycell_tests::numbers::{U, wide, worst};

/// IEC 61966-2-1.
fn srgb_twin(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

#[test]
fn the_fast_srgb_curve_stays_within_a_hundredth_of_an_eight_bit_step() {
    let mut points: Vec<Point> = (0..12_000)
        .map(|index| {
            let share = f64::from(index) / 11_999.0;
            [
                [
                    share as f32,
                    share.powi(4) as f32,
                    (share * 0.01) as f32,
                    0.0,
                ],
                [0.0; 4],
            ]
        })
        .collect();
    let edge = 0.003_130_8f32;
    points.push([[edge.next_down(), edge, edge.next_up(), 0.0], [0.0; 4]]);
    let values = Probe::open().ask(Question::Srgb, &points);
    let bound = 0.01 / 255.0;
    let check = |twin: fn(f64) -> f64| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let (linear, encoded) = (wide(point[0]), wide(*value));
            [0, 1, 2].map(|channel| ((encoded[channel] - twin(linear[channel])).abs(), bound))
        }))
    };
    let gpu = check(srgb_twin);
    // The power that is often taken for sRGB.
    let defect = check(|linear| linear.powf(1.0 / 2.2));
    judge("sRGB", points.len(), gpu, defect);
}

#[test]
fn the_filmic_curve_is_its_fit_from_black_to_the_sun() {
    let probe = SceneProbe::open(&serde_json::json!({"version": 1}), true);
    let points: Vec<FieldPoint> = (0..12_000)
        .map(|index| {
            let value = 10f64.powf(-12.0 + 20.0 * f64::from(index) / 11_999.0) as f32;
            [[value, 0.0, 2.0 * value, 0.0], [0.0; 4], [0.0; 4], [0.0; 4]]
        })
        .collect();
    let values = probe.ask(FieldQuestion::Tone, &points);
    let white = [0.8444, 1.0602, 1.0954];
    let check = |white: [f64; 3]| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            [0, 1, 2].map(|c| {
                let exact = skycell_tests::tone::filmic(f64::from(point[0][c]) / white[c]);
                // Sums of positive terms and two quotients: some ten roundings, of what was rounded before.
                (
                    (f64::from(value[0][c]) - exact).abs(),
                    16.0 * U * exact + 1e-30,
                )
            })
        }))
    };
    // Planted: no white balance.
    judge("filmic curve", points.len(), check(white), check([1.0; 3]));
}

/// Colours from black to far above white, grey and saturated ones.
fn colours() -> Vec<[f32; 3]> {
    (0..12_000)
        .map(|index| {
            let brightness = 10f64.powf(-9.0 + 15.0 * f64::from(index) / 11_999.0);
            let turn = f64::from(index) * 0.618_033_988_749_895;
            let share = |shift: f64| (0.02 + 0.98 * (turn + shift).fract()) * brightness;
            [share(0.0) as f32, share(0.37) as f32, share(0.71) as f32]
        })
        .collect()
}

/// By how much AgX as it was published changes the order of channels: the rows of its outer matrix add up to 0.99983, 1.00004
/// and 1.00006, so that of three equal channels blue comes out 2.3e-4 above red. No other colour is turned by more (two
/// million random ones, from black to a million, in f64: 2.3e-4).
const AGX_ORDER: f64 = 2.4e-4;

fn wide3(value: [f32; 4]) -> [f64; 3] {
    [0, 1, 2].map(|c| f64::from(value[c]))
}

#[test]
fn agx_and_neutral_are_their_published_curves_and_keep_the_order_of_the_channels() {
    let probe = SceneProbe::open(&serde_json::json!({"version": 1}), true);
    let white = [0.8444, 1.0602, 1.0954];
    for (number, curve, bound, disorder) in [
        // A twentieth of an eight-bit step: drivers' logarithms and powers are good to some 2^-16 of their range.
        (
            1.0f32,
            skycell_tests::tone::agx as fn([f64; 3]) -> [f64; 3],
            2e-4,
            AGX_ORDER,
        ),
        (2.0, skycell_tests::tone::neutral, 4e-6, 0.0),
    ] {
        let points: Vec<FieldPoint> = colours()
            .into_iter()
            .map(|[r, g, b]| [[r, g, b, 0.0], [number, 0.0, 0.0, 0.0], [0.0; 4], [0.0; 4]])
            .collect();
        let values = probe.ask(FieldQuestion::Tone, &points);
        let check = |white: [f64; 3]| {
            worst(points.iter().zip(&values).flat_map(|(point, value)| {
                let exact = curve([0, 1, 2].map(|c| f64::from(point[0][c]) / white[c]));
                [0, 1, 2].map(|c| ((f64::from(value[0][c]) - exact[c]).abs(), bound))
            }))
        };
        judge("tone curve", points.len(), check(white), check([1.0; 3]));
        // Hue: no channel overtakes another on the way to white, by more than the curve itself does and the device's errors.
        let overtaken = |encoded: &dyn Fn(usize) -> [f64; 3]| {
            let mut most = 0.0f64;
            for (at, point) in points.iter().enumerate() {
                let balanced = [0, 1, 2].map(|c| f64::from(point[0][c]) / white[c]);
                let encoded = encoded(at);
                for (a, b) in [(0, 1), (1, 2), (0, 2), (1, 0), (2, 1), (2, 0)] {
                    if balanced[a] > 1.01 * balanced[b] {
                        most = most.max(encoded[b] - encoded[a]);
                    }
                }
            }
            most
        };
        let of_device = overtaken(&|at| wide3(values[at][0]));
        let of_curve =
            overtaken(&|at| curve([0, 1, 2].map(|c| f64::from(points[at][0][c]) / white[c])));
        println!(
            "curve {number}: a channel is overtaken by {of_device:.2e}, exactly by {of_curve:.2e}"
        );
        assert!(of_curve <= disorder, "{of_curve}");
        assert!(of_device <= disorder + 2.0 * bound, "{of_device}");
    }
}
