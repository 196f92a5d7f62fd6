//! Tables that depend on the air alone. They are small, every later table reads them, and the processor makes them in f64
//! when the air changes, beside the frames (`keeper`).

use super::medium::{Medium, exp};
use glam::DVec3;
use rayon::prelude::*;
use skycell_protocol::Scene;
use std::f64::consts::{FRAC_1_PI, PI};
use std::sync::Arc;

/// How finely the tables are made.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Fineness {
    /// Directions and altitudes of the table of optical depths.
    depth_size: [usize; 2],
    /// Intervals of a path of optical depth, on either side of its lowest place.
    depth_intervals: u32,
    /// Suns and altitudes of the table of higher orders.
    orders_size: [usize; 2],
    /// Suns of the table of lit ground, whose light falls fast where the sun sets.
    ground_suns: usize,
    /// Cosines of directions above and below the horizon.
    cosines: usize,
    /// Azimuths from the sun's to its opposite for light that scatters evenly.
    even_azimuths: u32,
}

/// Tuned: tests/atmosphere, errors of the tables.
const FINE: Fineness = Fineness {
    depth_size: [256, 128],
    depth_intervals: 24,
    orders_size: [128, 32],
    ground_suns: 384,
    cosines: 20,
    even_azimuths: 6,
};
/// Some hundredths of the work, right to some percent.
const DRAFT: Fineness = Fineness {
    depth_size: [96, 48],
    depth_intervals: 10,
    orders_size: [32, 12],
    ground_suns: 128,
    cosines: 5,
    even_azimuths: 4,
};
/// Azimuths of the sky, which has a bright place.
const SKY_AZIMUTHS: u32 = 16;
const SKY_COSINES: usize = 10;
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

    /// A share of the way from one to another of the same size.
    fn between(from: &Self, to: &Self, share: f64) -> Self {
        let values = from
            .values
            .iter()
            .zip(&to.values)
            .map(|(from, to)| from.lerp(*to, share))
            .collect();
        Self {
            size: to.size,
            values,
        }
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
    /// Logarithm of the optical depth to the top of the air, which is straight where air falls off exponentially.
    pub depth: Table,
    /// Logarithm of the radiance of the higher orders, which is straighter at dusk than the radiance.
    pub orders: Table,
    /// Logarithm of the radiance of the lit ground.
    pub ground: Table,
    sky_irradiance: Table,
    fineness: Fineness,
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

    /// Makes the tables, in some seconds of one core.
    #[must_use]
    pub fn new(medium: Medium, sun_radius_rad: f64) -> Self {
        Self::as_fine(medium, sun_radius_rad, FINE)
    }

    /// Makes coarse ones in some hundredths of that, to be shown until the others are there.
    #[must_use]
    pub fn draft(medium: Medium, sun_radius_rad: f64) -> Self {
        Self::as_fine(medium, sun_radius_rad, DRAFT)
    }

    /// Tables of the air a share of the way from one to another: logarithms are mixed, so light goes evenly. None where
    /// they cannot be mixed: of planets of other sizes, or made with other fineness.
    #[must_use]
    pub fn between(from: &Self, to: &Self, share: f64) -> Option<Self> {
        let alike = from.medium.radius_m == to.medium.radius_m
            && from.sun_radius_rad == to.sun_radius_rad
            && from.fineness == to.fineness;
        alike.then(|| Self {
            medium: Medium::between(&from.medium, &to.medium, share),
            sun_radius_rad: to.sun_radius_rad,
            mu_sun_lowest: from.mu_sun_lowest + share * (to.mu_sun_lowest - from.mu_sun_lowest),
            depth: Table::between(&from.depth, &to.depth, share),
            orders: Table::between(&from.orders, &to.orders, share),
            ground: Table::between(&from.ground, &to.ground, share),
            sky_irradiance: Table::between(&from.sky_irradiance, &to.sky_irradiance, share),
            fineness: to.fineness,
        })
    }

    fn as_fine(medium: Medium, sun_radius_rad: f64, fineness: Fineness) -> Self {
        let nothing = Table {
            size: [1, 1],
            values: vec![DVec3::ZERO],
        };
        let mut tables = Self {
            medium,
            sun_radius_rad,
            mu_sun_lowest: (2.0 * medium.mu_horizon(medium.top_m) - 0.05).max(-1.0),
            depth: Table::new(fineness.depth_size, |across, down| {
                let (altitude_m, mu) = direction_of_place(&medium, across, down);
                ln(medium.depth(altitude_m, mu, fineness.depth_intervals))
            }),
            orders: nothing.clone(),
            ground: nothing.clone(),
            sky_irradiance: nothing,
            fineness,
        };
        let [suns, altitudes] = fineness.orders_size;
        let rows: Vec<Vec<DVec3>> = (0..altitudes)
            .into_par_iter()
            .map(|row| {
                let down = row as f64 / (altitudes - 1) as f64;
                tables.fresh_orders_per_sr(medium.top_m * down * down)
            })
            .collect();
        tables.orders = Table {
            size: fineness.orders_size,
            values: rows.into_iter().flatten().map(ln).collect(),
        };
        tables.sky_irradiance = Table::new([suns, 1], |across, _| {
            ln(tables.fresh_sky_irradiance(tables.sun_of_place(across)))
        });
        tables.ground = Table::new([fineness.ground_suns, 1], |across, _| {
            let mu_sun = tables.sun_of_place(across);
            let sun = tables.sun_transmittance(0.0, mu_sun) * mu_sun.max(0.0);
            let sky = exp(tables.sky_irradiance.at(across, 0.0));
            ln(medium.ground_albedo * FRAC_1_PI * (sun + sky))
        });
        tables
    }

    /// Whether they are no draft.
    pub(super) fn is_fine(&self) -> bool {
        self.fineness == FINE
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
        if visible == 0.0 {
            return DVec3::ZERO;
        }
        visible * exp(-self.sun_depth(altitude_m, mu_sun))
    }

    /// Optical depth of the air from a place to the sun, or to the horizon where the sun is below it.
    #[must_use]
    pub fn sun_depth(&self, altitude_m: f64, mu_sun: f64) -> DVec3 {
        let medium = &self.medium;
        if altitude_m >= medium.top_m {
            return DVec3::ZERO;
        }
        let mu = mu_sun.max(medium.mu_horizon(altitude_m));
        let (across, down) = place_of_direction(medium, altitude_m.max(0.0), mu);
        exp(self.depth.at(across, down))
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
    /// as if all scattered evenly, over 1 − f, where f is the share of even light that comes back to its place. For an
    /// altitude and all suns of the table.
    fn fresh_orders_per_sr(&self, altitude_m: f64) -> Vec<DVec3> {
        let medium = &self.medium;
        let fineness = self.fineness;
        let suns: Vec<f64> = (0..fineness.orders_size[0])
            .map(|i| self.sun_of_place(i as f64 / (fineness.orders_size[0] - 1) as f64))
            .collect();
        let mut second = vec![DVec3::ZERO; suns.len()];
        let mut share = DVec3::ZERO;
        let from_centre = medium.radius_m + altitude_m;
        for level in levels(medium.mu_horizon(altitude_m), fineness.cosines) {
            let even = level.solid_angle_sr / (4.0 * PI);
            let Some(path) = medium.path_m(altitude_m, level.mu, level.on_ground) else {
                continue;
            };
            let ways: Vec<Way> = level.ways(fineness.even_azimuths).collect();
            let each = even / f64::from(fineness.even_azimuths);
            let mut add =
                |distance_m: f64, there_m: f64, radius_m: f64, weight: DVec3, cosine: bool| {
                    for (second, mu_sun) in second.iter_mut().zip(&suns) {
                        let mut light = DVec3::ZERO;
                        for way in &ways {
                            let there =
                                (from_centre * mu_sun + distance_m * way.nu(*mu_sun)) / radius_m;
                            let there = there.clamp(-1.0, 1.0);
                            let facing = if cosine { there.max(0.0) } else { 1.0 };
                            if facing > 0.0 {
                                light += facing * self.sun_transmittance(there_m, there);
                            }
                        }
                        *second += weight * light;
                    }
                };
            for stand in medium.walk(altitude_m, level.mu, path) {
                let scattered =
                    stand.kept * medium.scattering_per_m(stand.densities) * stand.length_m;
                share += scattered * even;
                if scattered.max_element() > LEAST {
                    let weight = scattered * (each / (4.0 * PI));
                    add(
                        stand.distance_m,
                        stand.altitude_m,
                        stand.radius_m,
                        weight,
                        false,
                    );
                }
            }
            if level.on_ground {
                let kept =
                    exp(-medium.depth_of(altitude_m, level.mu, path, fineness.depth_intervals));
                let weight = kept * (medium.ground_albedo * FRAC_1_PI * each);
                add(path[2], 0.0, medium.radius_m, weight, true);
            }
        }
        second
            .into_iter()
            .map(|second| second / (DVec3::ONE - share).max(DVec3::splat(1e-3)))
            .collect()
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
        let mut sum = DVec3::ZERO;
        for stand in medium.walk(altitude_m, way.mu, path) {
            let there =
                ((medium.radius_m + altitude_m) * mu_sun + stand.distance_m * nu) / stand.radius_m;
            let there = there.clamp(-1.0, 1.0);
            let [air, aerosol, _] = stand.densities;
            let once = medium.rayleigh_per_m * (air * rayleigh)
                + medium.mie_scattering_per_m * (aerosol * mie);
            let light = once * self.sun_transmittance(stand.altitude_m, there)
                + medium.scattering_per_m(stand.densities)
                    * self.orders_per_sr(stand.altitude_m, there);
            sum += stand.kept * light * stand.length_m;
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

/// Directions of the sphere with one cosine of the zenith angle.
#[derive(Clone, Copy)]
struct Level {
    mu: f64,
    on_ground: bool,
    solid_angle_sr: f64,
}

impl Level {
    /// Its directions at even azimuths.
    fn ways(self, azimuths: u32) -> impl Iterator<Item = Way> {
        (0..azimuths).map(move |i| Way {
            mu: self.mu,
            cos_azimuth: (PI * (f64::from(i) + 0.5) / f64::from(azimuths)).cos(),
            on_ground: self.on_ground,
            solid_angle_sr: self.solid_angle_sr / f64::from(azimuths),
        })
    }
}

/// Levels of the sphere: cosines by Gauss and Legendre, dense towards the horizon.
fn levels(mu_horizon: f64, cosines: usize) -> impl Iterator<Item = Level> {
    [1.0, -1.0].into_iter().flat_map(move |pole: f64| {
        gauss(cosines)
            .into_iter()
            .map(move |[place, weight]| Level {
                mu: mu_horizon + (pole - mu_horizon) * place * place,
                on_ground: pole < 0.0,
                solid_angle_sr: (pole - mu_horizon).abs() * 2.0 * place * weight * 2.0 * PI,
            })
    })
}

/// Directions of the sphere.
fn sphere(mu_horizon: f64, azimuths: u32) -> impl Iterator<Item = Way> {
    levels(mu_horizon, SKY_COSINES).flat_map(move |level| level.ways(azimuths))
}

/// Points and weights of Gauss and Legendre's rule on 0…1: roots of Legendre's polynomial by Newton's method from
/// cos(π (i + 3/4)/(n + 1/2)) (Press et al., Numerical Recipes, 4.6).
fn gauss(count: usize) -> Vec<[f64; 2]> {
    let n = count as f64;
    (0..count)
        .map(|i| {
            let mut x = (PI * (i as f64 + 0.75) / (n + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..8 {
                let (mut before, mut p) = (1.0, x);
                for k in 1..count {
                    let k = k as f64;
                    let next = ((2.0 * k + 1.0) * x * p - k * before) / (k + 1.0);
                    (before, p) = (p, next);
                }
                slope = n * (x * p - before) / (x * x - 1.0);
                x -= p / slope;
            }
            [0.5 - 0.5 * x, 1.0 / ((1.0 - x * x) * slope * slope)]
        })
        .collect()
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
