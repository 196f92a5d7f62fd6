//! Slabs against discrete ordinates (`tests/data/oracles/disort.json`), a solver that shares nothing with this crate.

use crate::support::*;
use glam::DVec3;
use serde_json::{Value, json};
use skycell_reference::path::{Mean, Moments, PathSettings, Random, SunShape, trace_ray};
use skycell_reference::{Ray, World};
use std::f64::consts::TAU;

const DATA: &str = include_str!("../../../../tests/data/oracles/disort.json");
/// Paths for a flux, for one with a narrow forward peak, which is noisier, and for a radiance.
const FLUX_PATHS: u64 = 24_000;
const PEAKED_FLUX_PATHS: u64 = 32_000;
const RADIANCE_PATHS: u64 = 8_000;
/// Paths for either through the thickest slabs, where each is scattered some hundred times.
const THICK_PATHS: u64 = 4_000;
/// Less light than this comes through thick slabs by so few paths that their mean is no normal deviate: left out.
const LEAST: f64 = 2e-3;

/// A figure that is beyond three standard errors, which of 370 one will be by chance, is estimated once more with so many
/// times the paths and other random numbers: what is wrong is then farther out, what was chance is not.
const AGAIN: u64 = 16;

struct Tally {
    compared: u32,
    left_out: u32,
    beyond_two: u32,
    again: u32,
    worst: f64,
}

/// A figure to compare: the solver's value and its own error.
struct Figure {
    name: String,
    expected: f64,
    error: f64,
}

impl Tally {
    /// `estimate` gives mean and standard error for a factor of the paths and a seed.
    fn add(&mut self, figure: &Figure, seed: u64, estimate: impl Fn(u64, u64) -> (f64, f64)) {
        let Figure {
            name,
            expected,
            error,
        } = figure;
        let off = |factor: u64, seed: u64| {
            let (seen, seen_error) = estimate(factor, seed);
            // The solver's own error counts as one standard error.
            let off = (seen - expected) / seen_error.hypot(*error).max(1e-12);
            println!("{name:44} {expected:.6} {seen:.6} ± {seen_error:.6} {off:+.2}");
            off.abs()
        };
        let mut found = off(1, seed);
        self.compared += 1;
        self.beyond_two += u32::from(found > 2.0);
        if found > 3.0 {
            self.again += 1;
            found = off(AGAIN, seed + 1_000_000);
        }
        self.worst = self.worst.max(found);
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

/// Mean radiance without the sun's disc, which an eye under the slab may look at.
fn scattered(world: &World, ray: &Ray, moments: &Moments) -> f64 {
    let disc = world.light().sun_disc_radiance(ray.direction).x;
    moments.radiance[0].mean - disc * moments.transmittance.mean
}

/// Diffuse flux through a side by backward estimates: with directions in proportion to their cosine, flux = π · mean
/// radiance. Each path has its own direction.
fn flux(world: &World, up: bool, paths: u64, seed: u64) -> Mean {
    let mut mean = Mean::default();
    for path in 0..paths {
        let mut random = Random::new(seed, u64::MAX, path);
        let ray = eye(up, random.unit().sqrt().max(1e-9), 360.0 * random.unit());
        let moments = trace_ray(world, &ray, path, path..path + 1, seed, &settings());
        mean.add(0.5 * TAU * scattered(world, &ray, &moments));
    }
    mean
}

#[test]
fn slabs_agree_with_discrete_ordinates() {
    let data: Value = serde_json::from_str(DATA).expect("data");
    let mut tally = Tally {
        compared: 0,
        left_out: 0,
        beyond_two: 0,
        again: 0,
        worst: 0.0,
    };
    for (index, case) in data["cases"].as_array().expect("cases").iter().enumerate() {
        let [tau, albedo, g, mu0] = ["tau", "albedo", "g", "mu0"].map(|key| number(case, key));
        let world = world(&flat_scene(
            slab(tau, albedo),
            mu0,
            json!({"model": "hg", "g": g}),
        ));
        let seed = index as u64;
        for (key, up) in [("reflected", true), ("diffuse", false)] {
            if number(&case["flux"], key) < LEAST {
                tally.left_out += 1;
                continue;
            }
            let paths = if tau > 16.0 {
                THICK_PATHS
            } else if g > 0.8 {
                PEAKED_FLUX_PATHS
            } else {
                FLUX_PATHS
            };
            let figure = Figure {
                name: format!("tau {tau} albedo {albedo} g {g} mu0 {mu0} {key}"),
                expected: number(&case["flux"], key),
                error: number(&case["flux_err"], key),
            };
            tally.add(&figure, 2 * seed + u64::from(up), |factor, seed| {
                let seen = flux(&world, up, factor * paths, seed);
                (seen.mean / mu0, seen.standard_error() / mu0)
            });
        }
        for (column, radiance) in case["radiance"]
            .as_array()
            .into_iter()
            .flatten()
            .enumerate()
        {
            let at = |i: usize| radiance[i].as_f64().expect("a number");
            if tau > 4.0 && at(3) < LEAST {
                tally.left_out += 1;
                continue;
            }
            let up = radiance[0] == "up";
            let ray = eye(up, at(1), at(2));
            let paths = if tau > 16.0 {
                THICK_PATHS
            } else {
                RADIANCE_PATHS
            };
            let figure = Figure {
                name: format!(
                    "tau {tau} albedo {albedo} g {g} mu0 {mu0} {} {} {}",
                    radiance[0], radiance[1], radiance[2]
                ),
                expected: at(3),
                error: at(4),
            };
            tally.add(&figure, seed, |factor, seed| {
                let range = 0..factor * paths;
                let moments = trace_ray(&world, &ray, column as u64, range, seed, &settings());
                let error = moments.radiance[0].standard_error();
                (scattered(&world, &ray, &moments), error)
            });
        }
    }
    println!(
        "discrete ordinates: {} compared, {} too dark, {} beyond 2 standard errors, {} beyond 3 and estimated again, worst {:.2}",
        tally.compared, tally.left_out, tally.beyond_two, tally.again, tally.worst
    );
    assert!(tally.worst <= 3.0, "{}", tally.worst);
    // Of 370 normal deviates 17 ± 4 are beyond 2 and 1 ± 1 beyond 3: allowed are four deviations more.
    let expected = 0.0455 * f64::from(tally.compared);
    assert!(f64::from(tally.beyond_two) < expected + 4.0 * expected.sqrt());
    assert!(tally.again <= 5);
    assert!(tally.compared > 350);
}
