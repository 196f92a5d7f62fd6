//! Rays that graze the ground or a boundary of a full layer, from the ground to orbit: their optical depth against the
//! length of their parts in the layer.

use super::line::Line;
use super::stage::{Stage, ray, slab};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_server::march::MarchSettings;
use skycell_tests::numbers::{RADIUS_M, U, grazes_ground, layer_parts};

const BASE_M: f64 = 1000.0;
const TOP_M: f64 = 2000.0;
const STEPS: u32 = 1024;
const EXTINCTION_PER_M: f64 = 1e-5;

/// Heights of closest approach over a shell, m.
const OVER_M: [f64; 9] = [-1000.0, -10.0, -1.0, -1e-3, 0.0, 1e-3, 1.0, 10.0, 500.0];

fn scene() -> Value {
    let mut scene = slab(
        json!({"layers": [{"base_altitude_m": BASE_M, "top_altitude_m": TOP_M,
        "extinction_per_m": EXTINCTION_PER_M, "density": {"model": "homogeneous"}}]}),
    );
    if let Some(members) = scene.as_object_mut() {
        members.remove("planet");
    }
    scene
}

pub(crate) fn grazed(stage: &mut Stage) -> Line {
    let mut line = Line::new("grazing rays");
    stage.scene(&scene());
    let mut rays = Vec::new();
    for altitude_m in [2.0, 1500.0, 12_000.0, 400_000.0] {
        for shell_m in [0.0, BASE_M, TOP_M] {
            for over_m in OVER_M {
                // cos of the pitch = closest approach / distance from the centre; from below the shell: level with it.
                let closest = RADIUS_M + shell_m + over_m;
                let cosine = (closest / (RADIUS_M + altitude_m)).min(1.0);
                let sine = -(1.0 - cosine * cosine).max(0.0).sqrt();
                // An eye under the shell cannot graze it: it looks as far up as it would have had to look down.
                let sine = if closest > RADIUS_M + altitude_m {
                    (over_m * 1e-4).abs().min(1.0)
                } else {
                    sine
                };
                rays.push((
                    altitude_m,
                    shell_m,
                    over_m,
                    ray([0.0, altitude_m, 0.0], [cosine, sine, 0.0]),
                ));
            }
        }
    }
    let march = MarchSettings {
        sun_steps: Some(1),
        ..MarchSettings::plain(STEPS)
    };
    let found = stage.rays(
        DVec3::ZERO,
        rays.iter().map(|(.., ray)| *ray).collect(),
        march,
    );
    for ((altitude_m, shell_m, over_m, ray), layer) in rays.iter().zip(&found.layers[0]) {
        line.case();
        let what = format!("{over_m} m over {shell_m} m from {altitude_m} m");
        line.layer(&what, layer, 0.0, 0.0);
        // As the shaders have it.
        let origin = ray.origin_m.as_vec3().as_dvec3().to_array();
        let direction = ray.direction.as_vec3().as_dvec3().to_array();
        let step_m = |distance_m: f64| {
            ((TOP_M - BASE_M) / f64::from(STEPS)).max(0.5 * distance_m / f64::from(STEPS))
        };
        let optical_depth = |ground: bool| {
            let parts = layer_parts(origin, direction, BASE_M, TOP_M, ground);
            let length_m: f64 = parts.iter().map(|part| part.end_m - part.start_m).sum();
            // Samples stand for steps around them: half a step is won or lost at either end, and the ends are where f32
            // puts them.
            let ends_m: f64 = parts
                .iter()
                .map(|part| part.bound_m + 0.6 * (step_m(part.start_m) + step_m(part.end_m)))
                .sum();
            // The midpoint rule in steps that grow by a 2048th, and sums of some thousand terms.
            let rest = length_m * EXTINCTION_PER_M * (1e-4 + 64.0 * U);
            (
                EXTINCTION_PER_M * length_m,
                EXTINCTION_PER_M * ends_m + rest + 1e-12,
            )
        };
        let either = if grazes_ground(origin, direction) {
            vec![true, false]
        } else {
            vec![true]
        };
        let found_depth = f64::from(layer.optical_depth);
        let nearest = either.into_iter().map(optical_depth).min_by(|a, b| {
            (found_depth - a.0)
                .abs()
                .total_cmp(&(found_depth - b.0).abs())
        });
        let (exact, bound) = nearest.expect("one at least");
        line.holds(
            format!("{what}: optical depth {exact:.4}"),
            (found_depth - exact).abs(),
            bound,
        );
        // d(e^-τ) = e^-τ dτ; some thousand factors, each known to a few U.
        line.holds(
            format!("{what}: transmittance"),
            (f64::from(layer.transmittance) - (-exact).exp()).abs(),
            (-exact).exp() * bound.exp_m1() + 1e4 * U,
        );
    }
    line
}
