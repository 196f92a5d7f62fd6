//! Where droplets scatter light to.

use super::support::{Point, Probe, SceneProbe, judge};
use skycell_server::probe::{FieldPoint, FieldQuestion, FunctionQuestion as Question};
use skycell_tests::numbers::{Random, U, wide, worst};
use std::f64::consts::PI;

/// Henyey and Greenstein 1941.
fn hg_twin(g: f64, one_minus_mu: f64) -> f64 {
    let mu = 1.0 - one_minus_mu;
    (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * mu).powf(1.5))
}

/// Draine 2003, eq. 4.
fn draine_twin(g: f64, alpha: f64, one_minus_mu: f64) -> f64 {
    let mu = 1.0 - one_minus_mu;
    hg_twin(g, one_minus_mu) * (1.0 + alpha * mu * mu) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
}

const SHARPEST: [f64; 11] = [
    0.999, -0.999, 0.99, -0.99, 0.9, -0.9, 0.5, -0.5, 1e-4, -1e-4, 0.0,
];

#[test]
fn phase_functions_keep_their_digits_in_the_sharpest_peaks_forward_and_backward() {
    let mut random = Random(5);
    let points: Vec<Point> = (0..20_000)
        .map(|index| {
            let g = if index % 2 == 0 {
                random.one_of(&SHARPEST)
            } else {
                random.between(-0.999, 0.999)
            };
            let alpha = random.one_of(&[0.0, 1.0, 5.0, 100.0, 1e4]);
            let small = 2.0 * 10f64.powf(random.between(-12.0, 0.0));
            let one_minus_mu = match index % 4 {
                0 => random.one_of(&[0.0, 1e-12, 1e-6, 1.0, 2.0]),
                1 => small,
                2 => 2.0 - small,
                _ => random.between(0.0, 2.0),
            };
            [[g as f32, alpha as f32, one_minus_mu as f32, 0.0], [0.0; 4]]
        })
        .collect();
    let values = Probe::open().ask(Question::Phase, &points);
    // Some ten roundings and a square root, each of 1 to 2.5 units: nothing of it cancels.
    let bound = 24.0 * U;
    let check = |value: &dyn Fn(usize) -> [f64; 2]| {
        worst(points.iter().enumerate().flat_map(|(index, point)| {
            let [g, alpha, one_minus_mu] = wide(point[0]);
            let twins = [
                hg_twin(g, one_minus_mu),
                draine_twin(g, alpha, one_minus_mu),
            ];
            let [hg, draine] = value(index);
            [
                ((hg / twins[0] - 1.0).abs(), bound),
                ((draine / twins[1] - 1.0).abs(), bound),
            ]
        }))
    };
    let gpu = check(&|index| [values[index][0].into(), values[index][1].into()]);
    // 1 + g² - 2 g µ in f32.
    let defect = check(&|index| {
        let [g, _, one_minus_mu, _] = points[index][0];
        let base = 1.0 + g * g - 2.0 * g * (1.0 - one_minus_mu);
        let hg = (1.0 - g * g) / (4.0 * std::f32::consts::PI * base * base.sqrt());
        [hg.into(), values[index][1].into()]
    });
    judge("phase", points.len(), gpu, defect);
}

#[test]
fn phase_functions_integrate_to_one_over_the_sphere() {
    const NODES: usize = 10_001;
    let probe = Probe::open();
    for g in [-0.99, -0.9, -0.5, -0.1, 0.0, 0.3, 0.7, 0.9, 0.97, 0.99f64] {
        for alpha in [0.0, 1.0, 20.0f64] {
            // Nodes as dense as the peak is sharp: 1 ∓ µ = s (e^(k i) - 1) from 0 to 2.
            let scale = (1.0 - g.abs()).powi(2);
            let rate = (2.0 / scale).ln_1p();
            let points: Vec<Point> = (0..NODES)
                .map(|index| {
                    let from_peak = scale * (rate * index as f64 / (NODES - 1) as f64).exp_m1();
                    let from_peak = from_peak.min(2.0);
                    let one_minus_mu = if g < 0.0 { 2.0 - from_peak } else { from_peak };
                    [[g as f32, alpha as f32, one_minus_mu as f32, 0.0], [0.0; 4]]
                })
                .collect();
            let values = probe.ask(Question::Phase, &points);
            let integral = |value: &dyn Fn(usize) -> f64| {
                let node = |index: usize| f64::from(points[index][0][2]);
                let area = (1..NODES).map(|index| {
                    let width = (node(index) - node(index - 1)).abs();
                    width * (value(index) + value(index - 1)) / 2.0
                });
                2.0 * PI * area.sum::<f64>()
            };
            // The trapezoids' error, (ln 2e4 / 1e4)² ~ 1e-6, and the nodes' rounding.
            let bound = 2e-5;
            for column in [0, 1] {
                let whole = integral(&|index| values[index][column].into());
                let error = (whole - 1.0).abs();
                assert!(
                    error < bound,
                    "g {g}, alpha {alpha}, function {column}: integral {whole}"
                );
            }
            // Draine's numerator without its normalisation.
            if alpha > 0.0 {
                let defect = integral(&|index| {
                    let mu = 1.0 - f64::from(points[index][0][2]);
                    f64::from(values[index][0]) * (1.0 + alpha * mu * mu)
                });
                assert!((defect - 1.0).abs() > bound, "the planted defect passes");
            }
        }
    }
}

#[test]
fn the_scenes_phase_is_its_models_for_every_droplet_and_octave() {
    let models = [
        serde_json::json!({"model": "isotropic"}),
        serde_json::json!({"model": "ice"}),
        serde_json::json!({"model": "hg", "g": 0.999}),
        serde_json::json!({"model": "hg", "g": -0.6}),
        serde_json::json!({"model": "draine", "g": 0.9, "alpha": 1e4}),
        serde_json::json!({"model": "hg-draine", "droplet_diameter_um": 5}),
        serde_json::json!({"model": "hg-draine", "droplet_diameter_um": 10}),
        serde_json::json!({"model": "hg-draine", "droplet_diameter_um": 20}),
        serde_json::json!({"model": "hg-draine", "droplet_diameter_um": 50}),
    ];
    for model in models {
        let name = model.to_string();
        let probe = SceneProbe::open(
            &serde_json::json!({"version": 1, "light": {"phase": model}}),
            true,
        );
        let mut random = Random(8);
        let points: Vec<FieldPoint> = (0..10_000)
            .map(|index| {
                let x = match index % 3 {
                    0 => random.one_of(&[0.0, 1e-6, 1.0, 2.0]),
                    1 => 2.0 * 10f64.powf(random.between(-9.0, 0.0)),
                    _ => random.between(0.0, 2.0),
                };
                let eccentricity = random.one_of(&[0.0, 0.25, 0.5, 1.0]);
                [
                    [x as f32, eccentricity as f32, 1.0825e-5, 0.0],
                    [0.0; 4],
                    [0.0; 4],
                    [0.0; 4],
                ]
            })
            .collect();
        let values = probe.ask(FieldQuestion::Phase, &points);
        let phase = probe.device.uniform().light.phase;
        // The parameters as the device has them.
        let [g_hg, g_draine, alpha, w] = [
            phase.g_hg,
            phase.g_draine,
            phase.alpha_draine,
            phase.draine_weight,
        ]
        .map(f64::from);
        let check = |weight: f64| {
            worst(points.iter().zip(&values).flat_map(|(point, value)| {
                let [x, eccentricity, disc, _] = point[0].map(f64::from);
                let twin = |x: f64| {
                    (1.0 - weight) * hg_twin(g_hg * eccentricity, x)
                        + weight * draine_twin(g_draine * eccentricity, alpha, x)
                };
                // µ over a cap: µ (1 + cos r) / 2.
                let over_disc = x + (1.0 - x) * 0.5 * disc;
                // Some thirty roundings. g times its factor is rounded, and 1 - g with it. 1 + α µ² feels µ's rounding by
                // 2 α µ / (1 + α µ²), which is at most the root of α.
                let g = (g_hg.abs().max(g_draine.abs())) * eccentricity;
                let sharp = if eccentricity < 1.0 {
                    6.0 / (1.0 - g)
                } else {
                    0.0
                };
                let bound = (48.0 + sharp + 2.0 * alpha.sqrt()) * U;
                [
                    ((f64::from(value[0][0]) / twin(x) - 1.0).abs(), bound),
                    (
                        (f64::from(value[0][1]) / twin(over_disc) - 1.0).abs(),
                        bound,
                    ),
                ]
            }))
        };
        // Planted: the parts' weights swapped; where there is one part only, half of each.
        // Ice has as much of both.
        let swapped = if w == 0.0 || w == 0.5 || w == 1.0 {
            0.25
        } else {
            1.0 - w
        };
        let defect = if g_hg == 0.0 && w == 0.0 {
            f64::INFINITY
        } else {
            check(swapped)
        };
        judge(&format!("phase {name}"), points.len(), check(w), defect);
    }
}
