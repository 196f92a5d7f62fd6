//! What each of whose values is an integral over the sphere: the higher orders of scattering and the sky's irradiance on
//! the ground.

use super::path::Path;
use super::{FRAC_1_PI, Medium, PI, Toward, exp};
use crate::phase::hg_per_sr;
use glam::DVec3;
use rayon::prelude::*;

/// Points of the curves.
const ALTITUDES: usize = 28;
const SUNS: usize = 96;

/// How finely the sphere and its paths are divided.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fineness {
    /// Cosines above, and as many below the horizon.
    cosines: usize,
    /// Azimuths from the sun's to its opposite.
    azimuths: usize,
    /// Intervals of a path on either side of its lowest place.
    intervals: usize,
    /// Intervals of the way to the sun.
    sun_intervals: usize,
}

/// What the curves are made with.
const OF_CURVES: Fineness = Fineness {
    cosines: 20,
    azimuths: 6,
    intervals: 32,
    sun_intervals: 10,
};
/// The sky on the ground, which has a bright place around the sun.
const OF_SKY: Fineness = Fineness {
    cosines: 14,
    azimuths: 20,
    ..OF_CURVES
};
/// What they are compared with.
pub(super) const FRESH: Fineness = Fineness {
    cosines: 24,
    azimuths: 16,
    intervals: 60,
    sun_intervals: 40,
};
/// What a logarithm is taken of at least.
const LEAST: f64 = 1e-12;

/// The curves: logarithms, which are straighter at dusk.
#[derive(Debug)]
pub(super) struct Orders {
    higher: Vec<DVec3>,
    irradiance: Vec<DVec3>,
}

/// Gauss and Legendre's points and weights on 0…1, found by Newton's method.
pub(super) fn gauss(count: usize) -> Vec<(f64, f64)> {
    (0..count)
        .map(|i| {
            let n = count as f64;
            let mut x = (PI * (i as f64 + 0.75) / (n + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..50 {
                let (mut p, mut before) = (1.0, 0.0);
                for k in 0..count {
                    let k = k as f64;
                    let next = ((2.0 * k + 1.0) * x * p - k * before) / (k + 1.0);
                    (before, p) = (p, next);
                }
                slope = n * (x * p - before) / (x * x - 1.0);
                x -= p / slope;
            }
            (0.5 - 0.5 * x, 1.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

/// Cosine of a place on the axis of suns: dense around the horizon.
fn sun_at(place: f64) -> f64 {
    let x = 2.0 * place - 1.0;
    x.signum() * x * x
}

fn place_of_sun(mu_sun: f64) -> f64 {
    0.5 + 0.5 * mu_sun.signum() * mu_sun.abs().sqrt()
}

/// Half the sphere (the other mirrors it): directions above the horizon, and those below it where asked for, with their
/// solid angles, both halves counted.
fn directions(fine: Fineness, mu_horizon: f64, below: bool) -> Vec<(f64, f64, f64)> {
    let points = gauss(fine.cosines);
    let mut list = Vec::new();
    for (from, to) in [(mu_horizon, 1.0), (mu_horizon, -1.0)] {
        if to < 0.0 && !below {
            continue;
        }
        for (place, weight) in &points {
            // Squared: dense towards the horizon, where air is thick.
            let mu = from + (to - from) * place * place;
            let solid = (to - from).abs() * 2.0 * place * weight * 2.0 * PI;
            for azimuth in 0..fine.azimuths {
                let angle = PI * (azimuth as f64 + 0.5) / fine.azimuths as f64;
                list.push((mu, angle.cos(), solid / fine.azimuths as f64));
            }
        }
    }
    list
}

fn toward(mu: f64, cos_azimuth: f64, mu_sun: f64) -> Toward {
    let across = ((1.0 - mu * mu) * (1.0 - mu_sun * mu_sun)).max(0.0).sqrt();
    Toward {
        mu,
        mu_sun,
        from_sun: 1.0 - (mu * mu_sun + across * cos_azimuth).clamp(-1.0, 1.0),
    }
}

/// Mean of a radiance over the upper hemisphere.
pub(super) fn upper_mean(mu_sun: f64, radiance: impl Fn(Toward) -> DVec3) -> DVec3 {
    directions(OF_SKY, 0.0, false)
        .into_iter()
        .map(|(mu, cos_azimuth, solid)| radiance(toward(mu, cos_azimuth, mu_sun)) * solid)
        .sum::<DVec3>()
        / (2.0 * PI)
}

/// Hillaire 2020, eq. 5 to 10: with L₂ the light that comes to a place after one scattering or one reflection by the
/// ground, as if all scattered evenly, and f the share of even light around a place that is scattered back to it, all
/// orders from the second on are L₂ / (1 − f).
pub(super) fn higher_per_sr(
    medium: &Medium,
    altitude_m: f64,
    mu_sun: f64,
    fine: Fineness,
) -> DVec3 {
    let (mut second, mut share) = (DVec3::ZERO, DVec3::ZERO);
    let mu_horizon = medium.mu_horizon(altitude_m);
    for (mu, cos_azimuth, solid) in directions(fine, mu_horizon, true) {
        let on_ground = mu < mu_horizon;
        let toward = toward(mu, cos_azimuth, mu_sun);
        let nu = 1.0 - toward.from_sun;
        let Some(path) = Path::new(medium, altitude_m, mu, on_ground) else {
            continue;
        };
        let even = solid / (4.0 * PI);
        let columns = path.walk(medium, fine.intervals, |part| {
            let (place, densities, length_m) = (part.middle, part.densities, part.length_m);
            let depth = part.columns_to_middle;
            let kept = exp(-medium.depth(depth)) * medium.scattering_per_m(densities) * length_m;
            let sun = medium.sun_transmittance(
                place.altitude_m,
                place.mu_sun(mu_sun, nu),
                fine.sun_intervals,
            );
            second += kept * sun * (even / (4.0 * PI));
            share += kept * even;
        });
        if on_ground {
            let mu_sun = path.end().mu_sun(mu_sun, nu);
            let lit = medium.sun_transmittance(0.0, mu_sun, fine.sun_intervals) * mu_sun.max(0.0);
            second += exp(-medium.depth(columns)) * lit * (medium.ground_albedo * FRAC_1_PI * even);
        }
    }
    second / (DVec3::ONE - share).max(DVec3::splat(1e-3))
}

impl Orders {
    pub(super) fn new(medium: &Medium) -> Self {
        let higher: Vec<DVec3> = (0..ALTITUDES * SUNS)
            .into_par_iter()
            .map(|i| {
                let altitude_m = altitude_at(medium, (i / SUNS) as f64 / (ALTITUDES - 1) as f64);
                let mu_sun = sun_at((i % SUNS) as f64 / (SUNS - 1) as f64);
                ln(higher_per_sr(medium, altitude_m, mu_sun, OF_CURVES))
            })
            .collect();
        let mut orders = Self {
            higher,
            irradiance: Vec::new(),
        };
        orders.irradiance = (0..SUNS)
            .into_par_iter()
            .map(|i| {
                let mu_sun = sun_at(i as f64 / (SUNS - 1) as f64);
                ln(orders.fresh_irradiance(medium, mu_sun))
            })
            .collect();
        orders
    }

    /// Radiance of the higher orders at a place, 1/sr.
    pub(super) fn higher_per_sr(&self, medium: &Medium, altitude_m: f64, mu_sun: f64) -> DVec3 {
        let row = place_of_altitude(medium, altitude_m) * (ALTITUDES - 1) as f64;
        let (first, weights) = cubic(row, ALTITUDES);
        let sun = place_of_sun(mu_sun) * (SUNS - 1) as f64;
        let value: DVec3 = weights
            .into_iter()
            .enumerate()
            .map(|(i, weight)| {
                let start = (first + i) * SUNS;
                weight * curve(&self.higher[start..start + SUNS], sun)
            })
            .sum();
        exp(value)
    }

    pub(super) fn sky_irradiance(&self, mu_sun: f64) -> DVec3 {
        exp(curve(
            &self.irradiance,
            place_of_sun(mu_sun) * (SUNS - 1) as f64,
        ))
    }

    /// Irradiance of the sky on level ground.
    pub(super) fn fresh_irradiance(&self, medium: &Medium, mu_sun: f64) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for (mu, cos_azimuth, solid) in directions(OF_SKY, 0.0, false) {
            let toward = toward(mu, cos_azimuth, mu_sun);
            let x = toward.from_sun;
            let nu = 1.0 - x;
            let Some(path) = Path::new(medium, 0.0, mu, false) else {
                continue;
            };
            let rayleigh = 3.0 / (16.0 * PI) * (1.0 + nu * nu);
            let mie = hg_per_sr(medium.mie_asymmetry, x);
            path.walk(medium, OF_CURVES.intervals, |part| {
                let (place, densities, length_m) = (part.middle, part.densities, part.length_m);
                let depth = part.columns_to_middle;
                let there = place.mu_sun(mu_sun, nu);
                let sun =
                    medium.sun_transmittance(place.altitude_m, there, OF_CURVES.sun_intervals);
                let higher = self.higher_per_sr(medium, place.altitude_m, there);
                let once = medium.rayleigh_per_m * densities.rayleigh * rayleigh
                    + medium.mie_scattering_per_m * densities.mie * mie;
                sum += exp(-medium.depth(depth))
                    * (once * sun + medium.scattering_per_m(densities) * higher)
                    * (length_m * mu * solid);
            });
        }
        sum
    }
}

fn altitude_at(medium: &Medium, place: f64) -> f64 {
    medium.top_m * place * place
}

fn place_of_altitude(medium: &Medium, altitude_m: f64) -> f64 {
    (altitude_m / medium.top_m).clamp(0.0, 1.0).sqrt()
}

fn ln(v: DVec3) -> DVec3 {
    DVec3::from_array(v.to_array().map(|v| v.max(LEAST).ln()))
}

/// Weights of four neighbouring points of `count`, the polynomial through them, and the first of them.
fn cubic(at: f64, count: usize) -> (usize, [f64; 4]) {
    let first = (at.floor() as isize - 1).clamp(0, count as isize - 4) as usize;
    let x = at - first as f64;
    let weights = [0.0, 1.0, 2.0, 3.0].map(|i: f64| {
        [0.0, 1.0, 2.0, 3.0]
            .into_iter()
            .filter(|j| *j != i)
            .map(|j: f64| (x - j) / (i - j))
            .product()
    });
    (first, weights)
}

fn curve(values: &[DVec3], at: f64) -> DVec3 {
    let (first, weights) = cubic(at, values.len());
    weights
        .into_iter()
        .zip(&values[first..])
        .map(|(weight, value)| weight * *value)
        .sum()
}
