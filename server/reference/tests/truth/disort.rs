//! Slabs against discrete ordinates (`tests/data/oracles/disort.json`), a solver that shares nothing with this crate.

use crate::support::*;
use glam::DVec3;
use serde_json::{Value, json};
use skycell_reference::path::{Mean, PathSettings, Random, SunShape, trace_ray};
use skycell_reference::{Ray, World};
use std::f64::consts::TAU;

const DATA: &str = include_str!("../../../../tests/data/oracles/disort.json");
/// Paths for a flux and for a radiance at optical depth 1; fewer for thick slabs, whose paths are longer.
const FLUX_PATHS: f64 = 20_000.0;
const RADIANCE_PATHS: f64 = 8_000.0;

struct Tally {
    compared: u32,
    beyond_two: u32,
    beyond_three: u32,
    worst: f64,
}

impl Tally {
    fn add(&mut self, name: &str, seen: f64, error: f64, expected: f64, expected_error: f64) {
        // The solver's own error counts as one standard error.
        let off = (seen - expected) / error.hypot(expected_error).max(1e-12);
        self.compared += 1;
        self.beyond_two += u32::from(off.abs() > 2.0);
        self.beyond_three += u32::from(off.abs() > 3.0);
        self.worst = self.worst.max(off.abs());
        println!("{name:44} {expected:.6} {seen:.6} ± {error:.6} {off:+.2}");
    }
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().expect("a number")
}

fn settings() -> PathSettings {
    PathSettings {
        sun: SunShape::Point,
        ..PathSettings::default()
    }
}

/// A ray that sees light leave the slab at µ: from above if it goes up. Azimuth 0 is light that travels on the way the
/// beam travels; the sun stands in the north (−z), so its beam travels south (+z) and the eye looks against the light.
fn eye(up: bool, mu: f64, dphi_deg: f64) -> Ray {
    let sign = if up { 1.0 } else { -1.0 };
    let travels = direction(sign * mu, 180.0 + dphi_deg);
    let height_m = if up { 3000.0 } else { 0.0 };
    Ray::new(DVec3::new(0.0, height_m, 0.0), -travels).expect("a ray")
}

/// Diffuse flux through a side by backward estimates: with directions in proportion to their cosine, flux = π · mean
/// radiance. Each path has its own direction.
fn flux(world: &World, up: bool, paths: u64, seed: u64) -> Mean {
    let mut mean = Mean::default();
    for path in 0..paths {
        let mut random = Random::new(seed, u64::MAX, path);
        let ray = eye(up, random.unit().sqrt().max(1e-9), 360.0 * random.unit());
        let moments = trace_ray(world, &ray, path, path..path + 1, seed, &settings());
        mean.add(0.5 * TAU * moments.radiance[0].mean);
    }
    mean
}

#[test]
fn slabs_agree_with_discrete_ordinates() {
    let data: Value = serde_json::from_str(DATA).expect("data");
    let mut tally = Tally {
        compared: 0,
        beyond_two: 0,
        beyond_three: 0,
        worst: 0.0,
    };
    for (index, case) in data["cases"].as_array().expect("cases").iter().enumerate() {
        let [tau, albedo, g, mu0] = ["tau", "albedo", "g", "mu0"].map(|key| number(case, key));
        let world = world(&flat_scene(
            slab(tau, albedo),
            mu0,
            json!({"model": "hg", "g": g}),
        ));
        let share = 1.0 / tau.clamp(1.0, 64.0).sqrt();
        let seed = index as u64;
        for (key, up) in [("reflected", true), ("diffuse", false)] {
            let seen = flux(&world, up, (FLUX_PATHS * share) as u64, seed);
            let name = format!("tau {tau} albedo {albedo} g {g} mu0 {mu0} {key}");
            tally.add(
                &name,
                seen.mean / mu0,
                seen.standard_error() / mu0,
                number(&case["flux"], key),
                number(&case["flux_err"], key),
            );
        }
        for (column, radiance) in case["radiance"]
            .as_array()
            .into_iter()
            .flatten()
            .enumerate()
        {
            let at = |i: usize| radiance[i].as_f64().expect("a number");
            let up = radiance[0] == "up";
            let ray = eye(up, at(1), at(2));
            let paths = (RADIANCE_PATHS * share) as u64;
            let moments = trace_ray(&world, &ray, column as u64, 0..paths, seed, &settings());
            let mean = moments.radiance[0];
            let name = format!(
                "tau {tau} albedo {albedo} g {g} mu0 {mu0} {} {} {}",
                radiance[0], radiance[1], radiance[2]
            );
            // Straight below a sun in the zenith the eye looks at the disc itself, which is not diffuse.
            let towards_sun = ray.direction.dot(world.light().sun_direction) > 1.0 - 1e-4;
            let direct = if towards_sun {
                world.light().sun_disc_radiance(ray.direction).x * moments.transmittance.mean
            } else {
                0.0
            };
            tally.add(
                &name,
                mean.mean - direct,
                mean.standard_error(),
                at(3),
                at(4),
            );
        }
    }
    println!(
        "discrete ordinates: {} compared, {} beyond 2 and {} beyond 3 standard errors, worst {:.2}",
        tally.compared, tally.beyond_two, tally.beyond_three, tally.worst
    );
    // Of 404 normal deviates 18 ± 4 are beyond 2 and 1.1 ± 1 beyond 3: allowed are four deviations more.
    let expected = 0.0455 * f64::from(tally.compared);
    assert!(f64::from(tally.beyond_two) < expected + 4.0 * expected.sqrt());
    assert!(tally.beyond_three <= 5 && tally.worst < 4.5);
    assert!(tally.compared > 390);
}
