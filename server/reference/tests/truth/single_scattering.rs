//! Light scattered once in a slab, against its formula.

use crate::support::*;
use glam::DVec3;
use serde_json::json;
use skycell_reference::march::{ConvergeLimit, MarchSteps, converged_ray, march_ray};
use skycell_reference::path::{Orders, PathSettings, SunShape, trace_ray};
use skycell_reference::phase::{hg_per_sr, one_minus_mu};
use skycell_reference::{Ray, World};

/// Radiance of light scattered once in a slab under a beam of irradiance 1 from µ0 above (S. Chandrasekhar 1950, § 7):
/// seen from above, ω p µ0/(µ + µ0) (1 − e^(−τ (1/µ + 1/µ0))); from below, ω p µ0/(µ0 − µ) (e^(−τ/µ0) − e^(−τ/µ)).
fn formula(tau: f64, albedo: f64, phase_per_sr: f64, mu0: f64, mu: f64, from_above: bool) -> f64 {
    let share = if from_above {
        mu0 / (mu + mu0) * -(-tau * (1.0 / mu + 1.0 / mu0)).exp_m1()
    } else if (mu - mu0).abs() < 1e-9 {
        tau / mu * (-tau / mu).exp()
    } else {
        mu0 / (mu0 - mu) * ((-tau / mu0).exp() - (-tau / mu).exp())
    };
    albedo * phase_per_sr * share
}

/// The camera's ray that sees light leave at µ, and its direction.
fn view(mu: f64, azimuth_deg: f64, from_above: bool) -> Ray {
    let sign = if from_above { -1.0 } else { 1.0 };
    let height_m = if from_above { 5000.0 } else { 0.0 };
    Ray::new(
        DVec3::new(0.0, height_m, 0.0),
        direction(sign * mu, azimuth_deg),
    )
    .expect("a ray")
}

fn slab_world(tau: f64, albedo: f64, g: f64, mu0: f64) -> World {
    let phase = json!({"model": "hg", "g": g});
    world(&flat_scene(slab(tau, albedo), mu0, phase))
}

fn cases() -> Vec<(f64, f64, f64, bool)> {
    let mut cases = Vec::new();
    for tau in [1e-6, 0.1, 1.0, 10.0, 300.0] {
        for mu0 in [1.0, 0.6, 0.15] {
            for mu in [1.0, 0.35] {
                cases.push((tau, mu0, mu, true));
                if tau < 5.0 {
                    cases.push((tau, mu0, mu, false));
                }
            }
        }
    }
    cases
}

#[test]
fn the_converged_march_has_the_slabs_single_scattering() {
    for (tau, mu0, mu, from_above) in cases() {
        let world = slab_world(tau, 0.9, 0.3, mu0);
        let ray = view(mu, 70.0, from_above);
        let x = one_minus_mu(ray.direction, world.light().sun_direction);
        let expected = formula(tau, 0.9, hg_per_sr(0.3, x), mu0, mu, from_above);
        let limit = ConvergeLimit {
            levels: 16,
            ..ConvergeLimit::default()
        };
        let marched = converged_ray(&world, &ray, None, 1e-6, &limit).expect("ok");
        assert!(marched.converged, "{tau} {mu0} {mu}: {marched:?}");
        // The march averages the phase over the sun's disc, which moves it by less than 1e-4 here.
        let name = format!("tau {tau} mu0 {mu0} mu {mu} above {from_above}");
        assert_close(&name, marched.result.single_scattered.x, expected, 2e-4);
    }
}

#[test]
fn paths_of_one_scattering_have_the_slabs_single_scattering() {
    let settings = PathSettings {
        orders: Orders::UpTo(1),
        sun: SunShape::Point,
        ..PathSettings::default()
    };
    let (mut compared, mut beyond_two) = (0, 0);
    for (index, (tau, mu0, mu, from_above)) in cases().into_iter().enumerate() {
        // Nearly all that is seen from below a thick slab comes from its top, which hardly any path reaches.
        if tau < 0.1 || (tau > 1.0 && !from_above) {
            continue;
        }
        let world = slab_world(tau, 0.9, 0.3, mu0);
        let ray = view(mu, 70.0, from_above);
        let x = one_minus_mu(ray.direction, world.light().sun_direction);
        let expected = formula(tau, 0.9, hg_per_sr(0.3, x), mu0, mu, from_above);
        let moments = trace_ray(&world, &ray, index as u64, 0..20_000, 3, &settings);
        let mean = moments.single_scattered[0];
        let off = (mean.mean - expected).abs() / mean.standard_error();
        assert!(
            off < 3.5,
            "{tau} {mu0} {mu} {from_above}: {off} standard errors"
        );
        compared += 1;
        beyond_two += u32::from(off > 2.0);
    }
    println!("single scattering: {compared} compared, {beyond_two} beyond 2 standard errors");
    assert!(beyond_two <= 6, "{beyond_two} of {compared}");
}

#[test]
fn a_wrong_phase_is_noticed() {
    // Planted: a phase without its 1/4π, and one with its sign of g turned.
    let world = slab_world(1.0, 0.9, 0.3, 0.6);
    let ray = view(0.35, 70.0, true);
    let x = one_minus_mu(ray.direction, world.light().sun_direction);
    let marched = converged_ray(&world, &ray, None, 1e-5, &ConvergeLimit::default()).expect("ok");
    let seen = marched.result.radiance.x;
    for wrong in [
        hg_per_sr(0.3, x) * 4.0 * std::f64::consts::PI,
        hg_per_sr(-0.3, x),
    ] {
        let expected = formula(1.0, 0.9, wrong, 0.6, 0.35, true);
        assert!((seen / expected - 1.0).abs() > 0.01);
    }
}

#[test]
fn the_renderers_steps_come_closer_to_the_converged_march_the_more_they_are() {
    let world = slab_world(2.0, 0.9, 0.3, 0.6);
    let ray = view(0.5, 70.0, false);
    let truth = converged_ray(&world, &ray, None, 1e-6, &ConvergeLimit::default())
        .expect("ok")
        .result
        .radiance
        .x;
    let error = |steps: u32| {
        let steps = MarchSteps {
            steps,
            sun_steps: Some(4096),
            early_exit: false,
            ..MarchSteps::default()
        };
        (march_ray(&world, &ray, &steps).radiance.x / truth - 1.0).abs()
    };
    let errors = [error(64), error(512), error(4096)];
    assert!(errors[0] > errors[1] && errors[1] > errors[2], "{errors:?}");
    assert!(errors[2] < 1e-4, "{errors:?}");
}

#[test]
fn a_thin_medium_scatters_in_proportion() {
    // As τ → 0 the radiance is ω p τ / µ, whatever else.
    let world = slab_world(1e-9, 1.0, 0.3, 0.6);
    let ray = view(0.35, 70.0, true);
    let x = one_minus_mu(ray.direction, world.light().sun_direction);
    let marched = converged_ray(&world, &ray, None, 1e-6, &ConvergeLimit::default()).expect("ok");
    let expected = hg_per_sr(0.3, x) * 1e-9 / 0.35;
    assert_close("thin", marched.result.radiance.x, expected, 1e-4);
}
