//! Tables that depend on the air alone. They are small, every later table reads them, and the processor makes them in f64
//! in some hundredths of a second when the air changes.

use super::medium::{Medium, exp};
use glam::DVec3;
use rayon::prelude::*;
use skycell_protocol::Scene;
use std::f64::consts::{FRAC_1_PI, PI};
use std::sync::Arc;

/// Directions and altitudes of the table of optical depths.
const DEPTH_SIZE: [usize; 2] = [192, 64];
/// Suns and altitudes of the table of higher orders.
const ORDERS_SIZE: [usize; 2] = [80, 24];
/// Suns of the table of lit ground, whose light falls fast where the sun sets.
const GROUND_SUNS: usize = 384;
/// Intervals of a path of optical depth, on either side of its lowest place.
const DEPTH_INTERVALS: u32 = 48;
/// Intervals of the paths that are integrated over the sphere.
const INTERVALS: u32 = 16;
/// Azimuths from the sun's to its opposite: for light that scatters evenly, and for the sky, which has a bright place.
const EVEN_AZIMUTHS: u32 = 6;
const SKY_AZIMUTHS: u32 = 16;
/// Gauss and Legendre's points and weights on 0…1.
const GAUSS: [[f64; 2]; 6] = [
    [0.033_765_242_898_423_99, 0.085_662_246_189_585_17],
    [0.169_395_306_766_867_74, 0.180_380_786_524_069_3],
    [0.380_690_406_958_401_55, 0.233_956_967_286_345_52],
    [0.619_309_593_041_598_5, 0.233_956_967_286_345_52],
    [0.830_604_693_233_132_3, 0.180_380_786_524_069_3],
    [0.966_234_757_101_576, 0.085_662_246_189_585_17],
];
/// Below this no light is told apart from none.
const LEAST: f64 = 1e-12;

/// Values of a table, rows one behind the other.
#[derive(Clone, Debug)]
pub struct Table {
    /// Columns and rows.
    pub size: [usize; 2],
    values: Vec<DVec3>,
}

impl Table {
    fn new(size: [usize; 2], value: impl Fn(f64, f64) -> DVec3 + Sync) -> Self {
        let place = |i: usize, n: usize| i as f64 / (n.max(2) - 1) as f64;
        let values = (0..size[0] * size[1])
            .into_par_iter()
            .map(|i| value(place(i % size[0], size[0]), place(i / size[0], size[1])))
            .collect();
        Self { size, values }
    }

    /// Bilinear interpolation at a place 0…1 along both axes.
    fn at(&self, across: f64, down: f64) -> DVec3 {
        let split = |place: f64, n: usize| {
            let at = place.clamp(0.0, 1.0) * (n - 1) as f64;
            let low = (at as usize).min(n.saturating_sub(2));
            (low, (low + 1).min(n - 1), at - low as f64)
        };
        let (left, right, x) = split(across, self.size[0]);
        let (upper, lower, y) = split(down, self.size[1]);
        let row = |row: usize| {
            let start = row * self.size[0];
            self.values[start + left].lerp(self.values[start + right], x)
        };
        row(upper).lerp(row(lower), y)
    }

    /// As the device stores it: four f32 a texel.
    #[must_use]
    pub fn texels(&self) -> Vec<[f32; 4]> {
        self.values
            .iter()
            .map(|v| [v.x as f32, v.y as f32, v.z as f32, 0.0])
            .collect()
    }
}

/// The tables.
#[derive(Clone, Debug)]
pub struct BaseTables {
    /// What they are of.
    pub medium: Medium,
    /// Angular radius of the sun, rad.
    pub sun_radius_rad: f64,
    /// Lowest cosine of the sun's zenith angle that is tabulated: lower, hardly any light is left.
    pub mu_sun_lowest: f64,
    /// Optical depth to the top of the air.
    pub depth: Table,
    /// Logarithm of the radiance of the higher orders, which is straighter at dusk than the radiance.
    pub orders: Table,
    /// Logarithm of the radiance of the lit ground.
    pub ground: Table,
    sky_irradiance: Table,
}

impl BaseTables {
    /// Those of a scene's air: the known ones, if they are of the same; none where the scene has no such air.
    #[must_use]
    pub fn of(scene: &Scene, sun_radius_rad: f64, known: Option<&Arc<Self>>) -> Option<Arc<Self>> {
        let medium = Medium::of(scene)?;
        Some(match known {
            Some(known) if known.medium == medium && known.sun_radius_rad == sun_radius_rad => {
                known.clone()
            }
            _ => Arc::new(Self::new(medium, sun_radius_rad)),
        })
    }

    /// Makes the tables.
    #[must_use]
    pub fn new(medium: Medium, sun_radius_rad: f64) -> Self {
        let nothing = Table {
            size: [1, 1],
            values: vec![DVec3::ZERO],
        };
        let mut tables = Self {
            medium,
            sun_radius_rad,
            mu_sun_lowest: (2.0 * medium.mu_horizon(medium.top_m) - 0.05).max(-1.0),
            depth: Table::new(DEPTH_SIZE, |across, down| {
                let (altitude_m, mu) = direction_of_place(&medium, across, down);
                medium.depth(altitude_m, mu, DEPTH_INTERVALS)
            }),
            orders: nothing.clone(),
            ground: nothing.clone(),
            sky_irradiance: nothing,
        };
        tables.orders = Table::new(ORDERS_SIZE, |across, down| {
            let altitude_m = medium.top_m * down * down;
            ln(tables.fresh_orders_per_sr(altitude_m, tables.sun_of_place(across)))
        });
        tables.sky_irradiance = Table::new([ORDERS_SIZE[0], 1], |across, _| {
            ln(tables.fresh_sky_irradiance(tables.sun_of_place(across)))
        });
        tables.ground = Table::new([GROUND_SUNS, 1], |across, _| {
            let mu_sun = tables.sun_of_place(across);
            let sun = tables.sun_transmittance(0.0, mu_sun) * mu_sun.max(0.0);
            let sky = exp(tables.sky_irradiance.at(across, 0.0));
            ln(medium.ground_albedo * FRAC_1_PI * (sun + sky))
        });
        tables
    }

    fn sun_of_place(&self, place: f64) -> f64 {
        let x = 2.0 * place - 1.0;
        if x < 0.0 {
            x * x * self.mu_sun_lowest
        } else {
            x * x
        }
    }

    fn place_of_sun(&self, mu_sun: f64) -> f64 {
        if mu_sun < 0.0 {
            0.5 - 0.5 * (mu_sun / self.mu_sun_lowest).min(1.0).sqrt()
        } else {
            0.5 + 0.5 * mu_sun.sqrt()
        }
    }

    /// Share of the sun's light that reaches a place, facing it.
    #[must_use]
    pub fn sun_transmittance(&self, altitude_m: f64, mu_sun: f64) -> DVec3 {
        let medium = &self.medium;
        let (r, h) = (medium.radius_m, altitude_m.clamp(0.0, medium.top_m));
        let horizon = medium.mu_horizon(altitude_m);
        let above = (mu_sun - horizon) * (r + h) / (r * self.sun_radius_rad);
        let t = (0.5 + 0.5 * above).clamp(0.0, 1.0);
        let visible = t * t * (3.0 - 2.0 * t);
        if visible == 0.0 || altitude_m >= medium.top_m {
            return DVec3::splat(visible);
        }
        let (across, down) = place_of_direction(medium, h, mu_sun.max(horizon));
        visible * exp(-self.depth.at(across, down))
    }

    /// Radiance of the higher orders of scattering at a place, 1/sr.
    #[must_use]
    pub fn orders_per_sr(&self, altitude_m: f64, mu_sun: f64) -> DVec3 {
        let down = (altitude_m / self.medium.top_m).clamp(0.0, 1.0).sqrt();
        exp(self.orders.at(self.place_of_sun(mu_sun), down))
    }

    /// Radiance of the lit ground, 1/sr.
    #[must_use]
    pub fn ground_per_sr(&self, mu_sun: f64) -> DVec3 {
        exp(self.ground.at(self.place_of_sun(mu_sun), 0.0))
    }

    /// Hillaire 2020, eq. 5 to 10: the light L₂ that comes to a place after one scattering or one reflection by the ground,
    /// as if all scattered evenly, over 1 − f, where f is the share of even light that comes back to its place.
    fn fresh_orders_per_sr(&self, altitude_m: f64, mu_sun: f64) -> DVec3 {
        let medium = &self.medium;
        let (mut second, mut share) = (DVec3::ZERO, DVec3::ZERO);
        for way in sphere(medium.mu_horizon(altitude_m), EVEN_AZIMUTHS) {
            let nu = way.nu(mu_sun);
            let even = way.solid_angle_sr / (4.0 * PI);
            let Some(path) = medium.path_m(altitude_m, way.mu, way.on_ground) else {
                continue;
            };
            let mut kept = DVec3::ONE;
            for (middle, length) in Medium::intervals(path, INTERVALS) {
                let (there_m, radius) = medium.altitude_along(altitude_m, way.mu, middle);
                let mu_sun_there = ((medium.radius_m + altitude_m) * mu_sun + middle * nu) / radius;
                let densities = medium.densities(there_m);
                let depth = medium.extinction_per_m(densities) * length;
                let seen = kept * exp(-0.5 * depth);
                let scattered = seen * medium.scattering_per_m(densities) * length;
                let sun = self.sun_transmittance(there_m, mu_sun_there.clamp(-1.0, 1.0));
                second += scattered * sun * (even / (4.0 * PI));
                share += scattered * even;
                kept *= exp(-depth);
            }
            if way.on_ground {
                let end = path[2];
                let (_, radius) = medium.altitude_along(altitude_m, way.mu, end);
                let mu_sun = ((medium.radius_m + altitude_m) * mu_sun + end * nu) / radius;
                let lit = self.sun_transmittance(0.0, mu_sun.clamp(-1.0, 1.0)) * mu_sun.max(0.0);
                second += kept * lit * (medium.ground_albedo * FRAC_1_PI * even);
            }
        }
        second / (DVec3::ONE - share).max(DVec3::splat(1e-3))
    }

    fn fresh_sky_irradiance(&self, mu_sun: f64) -> DVec3 {
        sphere(0.0, SKY_AZIMUTHS)
            .filter(|way| !way.on_ground)
            .map(|way| self.sky_per_sr(0.0, mu_sun, &way) * (way.mu * way.solid_angle_sr))
            .sum()
    }

    /// Radiance of the sky along a way, 1/sr.
    fn sky_per_sr(&self, altitude_m: f64, mu_sun: f64, way: &Way) -> DVec3 {
        let medium = &self.medium;
        let nu = way.nu(mu_sun);
        let Some(path) = medium.path_m(altitude_m, way.mu, false) else {
            return DVec3::ZERO;
        };
        let rayleigh = 3.0 / (16.0 * PI) * (1.0 + nu * nu);
        let g = medium.mie_asymmetry;
        let base = 1.0 + g * g - 2.0 * g * nu;
        let mie = (1.0 - g * g) / (4.0 * PI * base * base.sqrt());
        let (mut kept, mut sum) = (DVec3::ONE, DVec3::ZERO);
        for (middle, length) in Medium::intervals(path, 2 * INTERVALS) {
            let (there_m, radius) = medium.altitude_along(altitude_m, way.mu, middle);
            let mu_sun_there = ((medium.radius_m + altitude_m) * mu_sun + middle * nu) / radius;
            let mu_sun_there = mu_sun_there.clamp(-1.0, 1.0);
            let densities = medium.densities(there_m);
            let depth = medium.extinction_per_m(densities) * length;
            let once = medium.rayleigh_per_m * (densities[0] * rayleigh)
                + medium.mie_scattering_per_m * (densities[1] * mie);
            let light = once * self.sun_transmittance(there_m, mu_sun_there)
                + medium.scattering_per_m(densities) * self.orders_per_sr(there_m, mu_sun_there);
            sum += kept * exp(-0.5 * depth) * light * length;
            kept *= exp(-depth);
        }
        sum
    }

    /// Mean radiance of the upper hemisphere at a place, 1/sr.
    #[must_use]
    pub fn upper_mean_per_sr(&self, altitude_m: f64, mu_sun: f64) -> DVec3 {
        sphere(0.0, SKY_AZIMUTHS)
            .filter(|way| !way.on_ground)
            .map(|way| self.sky_per_sr(altitude_m, mu_sun, &way) * way.solid_angle_sr)
            .sum::<DVec3>()
            / (2.0 * PI)
    }
}

/// One of the directions that stand for the sphere; the half at one side of the sun counts for both.
struct Way {
    mu: f64,
    cos_azimuth: f64,
    on_ground: bool,
    solid_angle_sr: f64,
}

impl Way {
    /// Cosine of the angle from the sun.
    fn nu(&self, mu_sun: f64) -> f64 {
        let across = ((1.0 - self.mu * self.mu) * (1.0 - mu_sun * mu_sun)).max(0.0);
        (self.mu * mu_sun + across.sqrt() * self.cos_azimuth).clamp(-1.0, 1.0)
    }
}

/// Directions of the sphere: cosines by Gauss and Legendre, dense towards the horizon, at even azimuths.
fn sphere(mu_horizon: f64, azimuths: u32) -> impl Iterator<Item = Way> {
    [1.0, -1.0].into_iter().flat_map(move |pole: f64| {
        GAUSS.into_iter().flat_map(move |[place, weight]| {
            (0..azimuths).map(move |i| {
                let angle = PI * (f64::from(i) + 0.5) / f64::from(azimuths);
                Way {
                    mu: mu_horizon + (pole - mu_horizon) * place * place,
                    cos_azimuth: angle.cos(),
                    on_ground: pole < 0.0,
                    solid_angle_sr: (pole - mu_horizon).abs() * 2.0 * place * weight * 2.0 * PI
                        / f64::from(azimuths),
                }
            })
        })
    })
}

/// Place of a direction above the horizon in the table of optical depths: by the distance to the top of the air and the
/// distance to the horizon (Bruneton 2008, section 4).
fn place_of_direction(medium: &Medium, altitude_m: f64, mu: f64) -> (f64, f64) {
    let (r, h, top) = (medium.radius_m, altitude_m, medium.top_m);
    let to_horizon = (h * (h + 2.0 * r)).sqrt();
    let farthest = (top * (top + 2.0 * r)).sqrt();
    let b = (r + h) * mu;
    let to_top = ((b * b) + (top - h) * (top + h + 2.0 * r)).sqrt() - b;
    let least = top - h;
    let across = (to_top - least) / (to_horizon + farthest - least).max(1e-3);
    (across.clamp(0.0, 1.0), to_horizon / farthest)
}

/// The inverse: altitude and cosine of the zenith angle.
fn direction_of_place(medium: &Medium, across: f64, down: f64) -> (f64, f64) {
    let (r, top) = (medium.radius_m, medium.top_m);
    let farthest = (top * (top + 2.0 * r)).sqrt();
    let to_horizon = down * farthest;
    let h = to_horizon * to_horizon / ((r * r + to_horizon * to_horizon).sqrt() + r);
    let least = top - h;
    let to_top = least + across * (to_horizon + farthest - least);
    let mu = if to_top > 0.0 {
        ((top - h) * (top + h + 2.0 * r) - to_top * to_top) / (2.0 * (r + h) * to_top)
    } else {
        1.0
    };
    (h, mu.clamp(-1.0, 1.0).max(medium.mu_horizon(h)))
}

fn ln(v: DVec3) -> DVec3 {
    DVec3::from_array(v.to_array().map(|v| v.max(LEAST).ln()))
}
