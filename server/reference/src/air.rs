//! The physical atmosphere by direct integration: air and aerosol that fall off exponentially, a layer of ozone, one
//! scattering exactly and all higher ones by S. Hillaire's closed sum (A Scalable and Production Ready Sky and Atmosphere
//! Rendering Technique, 2020, section 5.5), the ground's light included.
//!
//! Every integral over a path is taken anew where it is asked for. Two smooth functions are kept as dense curves and read
//! by cubic interpolation, since each of their values is an integral over the sphere: the higher orders, of altitude and
//! sun, and the sky's irradiance on the ground. A test compares them with fresh integrals.

mod orders;
mod path;

use crate::phase::{hg_per_sr, one_minus_mu};
use glam::DVec3;
use orders::Orders;
use path::Path;
use skycell_protocol::scene::{PhysicalAtmosphere, Planet};
use std::f64::consts::{FRAC_1_PI, PI};
use std::sync::{Arc, Mutex};

/// Wavelengths of the channels, µm.
const WAVELENGTHS_UM: [f64; 3] = [0.680, 0.550, 0.440];
/// Rayleigh scattering at sea level is this over λ⁴ per metre, λ in µm. E. Bruneton 2017, demo.cc `kRayleigh`.
const RAYLEIGH_PER_M_UM4: f64 = 1.240_62e-6;
/// Absorption by ozone at the three wavelengths where its layer, 300 Dobson units, is densest, 1/m. Hillaire 2020, table 1.
const OZONE_PER_M: DVec3 = DVec3::new(0.650e-6, 1.881e-6, 0.085e-6);
/// The ozone layer: a tent around an altitude, zero this far from it (Bruneton 2017).
const OZONE_MIDDLE_M: f64 = 25_000.0;
const OZONE_HALF_WIDTH_M: f64 = 15_000.0;

/// How densely the three constituents fill a place: 1 at sea level, ozone 1 in its middle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Densities {
    rayleigh: f64,
    mie: f64,
    ozone: f64,
}

impl Densities {
    fn plus(self, other: Self, factor: f64) -> Self {
        Self {
            rayleigh: self.rayleigh + factor * other.rayleigh,
            mie: self.mie + factor * other.mie,
            ozone: self.ozone + factor * other.ozone,
        }
    }
}

/// The medium.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Medium {
    radius_m: f64,
    top_m: f64,
    rayleigh_per_m: DVec3,
    rayleigh_scale_m: f64,
    mie_scattering_per_m: DVec3,
    mie_extinction_per_m: DVec3,
    mie_scale_m: f64,
    mie_asymmetry: f64,
    ozone_per_m: DVec3,
    ground_albedo: f64,
    sun_radius_rad: f64,
}

impl Medium {
    fn densities(&self, altitude_m: f64) -> Densities {
        Densities {
            rayleigh: (-altitude_m / self.rayleigh_scale_m).exp(),
            mie: (-altitude_m / self.mie_scale_m).exp(),
            ozone: (1.0 - (altitude_m - OZONE_MIDDLE_M).abs() / OZONE_HALF_WIDTH_M).max(0.0),
        }
    }

    /// Optical depth of columns, m.
    fn depth(&self, columns: Densities) -> DVec3 {
        self.rayleigh_per_m * columns.rayleigh
            + self.mie_extinction_per_m * columns.mie
            + self.ozone_per_m * columns.ozone
    }

    fn scattering_per_m(&self, densities: Densities) -> DVec3 {
        self.rayleigh_per_m * densities.rayleigh + self.mie_scattering_per_m * densities.mie
    }

    /// Cosine of the zenith angle of the horizon.
    fn mu_horizon(&self, altitude_m: f64) -> f64 {
        let h = altitude_m.max(0.0);
        -(h * (h + 2.0 * self.radius_m)).sqrt() / (self.radius_m + h)
    }

    /// Share of the sun's disc above the horizon, by a smooth step over its diameter.
    fn sun_visible(&self, altitude_m: f64, mu_sun: f64) -> f64 {
        let h = altitude_m.max(0.0);
        let sine = self.radius_m / (self.radius_m + h);
        let above = (mu_sun - self.mu_horizon(altitude_m)) / (sine * self.sun_radius_rad);
        let t = (0.5 + 0.5 * above).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    }

    /// Transmittance from a place to the sun, whose light the ground hides in part.
    fn sun_transmittance(&self, altitude_m: f64, mu_sun: f64, intervals: usize) -> DVec3 {
        let visible = self.sun_visible(altitude_m, mu_sun);
        if visible == 0.0 {
            return DVec3::ZERO;
        }
        // Light of a disc's part comes from above the horizon.
        let mu = mu_sun.max(self.mu_horizon(altitude_m));
        match Path::new(self, altitude_m, mu, false) {
            Some(path) => visible * exp(-self.depth(path.columns(self, intervals))),
            None => DVec3::splat(visible),
        }
    }
}

fn exp(v: DVec3) -> DVec3 {
    DVec3::new(v.x.exp(), v.y.exp(), v.z.exp())
}

/// Intervals of a path in air that clouds shade: 10 km away they are 200 m long at the horizon.
const SHADED_INTERVALS: usize = 3000;

/// Light of the air between a place and a distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AirLight {
    /// Scattered into the direction, per unit of the sun's irradiance, 1/sr.
    pub scattered_per_sr: DVec3,
    /// What comes through from behind.
    pub transmittance: DVec3,
}

/// Where a part of a path ends.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct PathEnd {
    distance_m: f64,
    scattered_per_sr: DVec3,
    depth: DVec3,
}

/// Light towards a place from a direction, for every distance along it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AlongPath {
    ends: Vec<PathEnd>,
    /// Of the ground at the end, seen from nearby, per unit of the sun's irradiance, 1/sr; 0 towards the sky.
    pub ground_per_sr: DVec3,
}

impl AlongPath {
    /// Of all the air.
    #[must_use]
    pub fn all(&self) -> AirLight {
        self.until(f64::INFINITY)
    }

    /// Of the air as far as a distance, m.
    #[must_use]
    pub fn until(&self, distance_m: f64) -> AirLight {
        let next = self.ends.partition_point(|end| end.distance_m < distance_m);
        let first = self.ends.first().copied().unwrap_or_default();
        let (scattered_per_sr, depth) = match (next.checked_sub(1), self.ends.get(next)) {
            (None, _) => (first.scattered_per_sr, first.depth),
            (Some(last), None) => (self.ends[last].scattered_per_sr, self.ends[last].depth),
            (Some(before), Some(after)) => {
                let before = self.ends[before];
                let share =
                    (distance_m - before.distance_m) / (after.distance_m - before.distance_m);
                (
                    before.scattered_per_sr.lerp(after.scattered_per_sr, share),
                    before.depth.lerp(after.depth, share),
                )
            }
        };
        AirLight {
            scattered_per_sr,
            transmittance: exp(-depth),
        }
    }
}

/// The air of a scene.
#[derive(Clone, Debug)]
pub struct Air {
    medium: Medium,
    orders: Arc<Orders>,
}

/// Where a direction points, seen from a place: cosines of the angles between it, the zenith and the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Toward {
    /// Between the direction and the zenith.
    pub mu: f64,
    /// Between the sun and the zenith.
    pub mu_sun: f64,
    /// 1 − cos between the direction and the sun.
    pub from_sun: f64,
}

impl Toward {
    /// From a direction, the zenith and the sun, unit vectors.
    #[must_use]
    pub fn new(direction: DVec3, up: DVec3, sun: DVec3) -> Self {
        Self {
            mu: direction.dot(up).clamp(-1.0, 1.0),
            mu_sun: sun.dot(up).clamp(-1.0, 1.0),
            from_sun: one_minus_mu(direction, sun),
        }
    }
}

/// Airs whose higher orders are known: they are the same for many scenes.
static KNOWN: Mutex<Vec<(Medium, Arc<Orders>)>> = Mutex::new(Vec::new());
const KNOWN_MAX: usize = 32;

impl Air {
    /// The air of a planet.
    #[must_use]
    pub fn new(air: &PhysicalAtmosphere, planet: &Planet, sun_radius_rad: f64) -> Self {
        let each = |f: &dyn Fn(f64) -> f64| DVec3::from_array(WAVELENGTHS_UM.map(f));
        let mie_extinction_per_m = air.aerosol_optical_depth() / air.aerosol_scale_height_m()
            * each(&|um| (um / 0.550).powf(-air.aerosol_angstrom_exponent()));
        let medium = Medium {
            radius_m: planet.radius_m(),
            top_m: top_m(air),
            rayleigh_per_m: air.rayleigh_density() * each(&|um| RAYLEIGH_PER_M_UM4 / um.powi(4)),
            rayleigh_scale_m: air.rayleigh_scale_height_m(),
            mie_scattering_per_m: air.aerosol_single_scattering_albedo() * mie_extinction_per_m,
            mie_extinction_per_m,
            mie_scale_m: air.aerosol_scale_height_m(),
            mie_asymmetry: air.aerosol_asymmetry(),
            ozone_per_m: air.ozone_dobson() / 300.0 * OZONE_PER_M,
            ground_albedo: planet.ground_albedo(),
            sun_radius_rad,
        };
        let known = |list: &[(Medium, Arc<Orders>)]| {
            list.iter()
                .find(|(of, _)| *of == medium)
                .map(|(_, orders)| orders.clone())
        };
        let lock = || {
            KNOWN
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner)
        };
        // Found before the list is locked again.
        let found = known(&lock());
        let orders = found.unwrap_or_else(|| {
            let orders = Arc::new(Orders::new(&medium));
            let mut list = lock();
            list.truncate(KNOWN_MAX - 1);
            list.insert(0, (medium, orders.clone()));
            orders
        });
        Self { medium, orders }
    }

    /// Altitude above which there is no air, m.
    #[must_use]
    pub fn top_m(&self) -> f64 {
        self.medium.top_m
    }

    /// Share of the sun's light that reaches a place, facing it.
    #[must_use]
    pub fn sun_transmittance(&self, altitude_m: f64, mu_sun: f64) -> DVec3 {
        self.medium.sun_transmittance(altitude_m, mu_sun, 400)
    }

    /// Irradiance of the sky on level ground, per unit of the sun's.
    #[must_use]
    pub fn sky_irradiance(&self, mu_sun: f64) -> DVec3 {
        self.orders.sky_irradiance(mu_sun)
    }

    /// The higher orders of scattering at a place: radiance that comes evenly from everywhere, per unit of the sun's
    /// irradiance, 1/sr.
    #[must_use]
    pub fn higher_orders_per_sr(&self, altitude_m: f64, mu_sun: f64) -> DVec3 {
        self.orders.higher_per_sr(&self.medium, altitude_m, mu_sun)
    }

    /// The same, integrated anew.
    #[must_use]
    pub fn fresh_higher_orders_per_sr(&self, altitude_m: f64, mu_sun: f64) -> DVec3 {
        orders::higher_per_sr(&self.medium, altitude_m, mu_sun, orders::FRESH)
    }

    /// Light that the lit ground throws back into every direction, per unit of the sun's irradiance, 1/sr.
    #[must_use]
    pub fn ground_per_sr(&self, mu_sun: f64) -> DVec3 {
        let sun = self.sun_transmittance(0.0, mu_sun) * mu_sun.max(0.0);
        self.medium.ground_albedo * FRAC_1_PI * (sun + self.sky_irradiance(mu_sun))
    }

    /// Light towards a place from a direction. `on_ground`: whether the direction ends on the ground.
    #[must_use]
    pub fn along(&self, altitude_m: f64, toward: Toward, on_ground: bool) -> AlongPath {
        self.along_by(altitude_m, toward, on_ground, 300, 24, |_| 1.0)
    }

    /// The same with a few hundredths of the work, right to some thousandths.
    #[must_use]
    pub fn roughly_along(&self, altitude_m: f64, toward: Toward, on_ground: bool) -> AlongPath {
        self.along_by(altitude_m, toward, on_ground, 48, 10, |_| 1.0)
    }

    /// Light towards a place, in air that clouds shade: `sunlit` is the share of the sun's light that they let through to a
    /// distance, m. What is scattered once is shaded. The higher orders come from all around and are not: Hillaire's closed
    /// sum, like the renderer's, knows no place.
    #[must_use]
    pub fn along_shaded(
        &self,
        altitude_m: f64,
        toward: Toward,
        on_ground: bool,
        sunlit: impl Fn(f64) -> f64,
    ) -> AlongPath {
        self.along_by(altitude_m, toward, on_ground, SHADED_INTERVALS, 24, sunlit)
    }

    fn along_by(
        &self,
        altitude_m: f64,
        toward: Toward,
        on_ground: bool,
        intervals: usize,
        sun_intervals: usize,
        sunlit: impl Fn(f64) -> f64,
    ) -> AlongPath {
        let medium = &self.medium;
        let mut along = AlongPath {
            ends: vec![PathEnd::default()],
            ..AlongPath::default()
        };
        let Some(path) = Path::new(medium, altitude_m, toward.mu, on_ground) else {
            return along;
        };
        let x = toward.from_sun;
        let nu = 1.0 - x;
        let rayleigh_per_sr = 3.0 / (16.0 * PI) * (1.0 + nu * nu);
        let mie_per_sr = hg_per_sr(medium.mie_asymmetry, x);
        let mut scattered_per_sr = DVec3::ZERO;
        along.ends[0].distance_m = path.start_m();
        path.walk(medium, intervals, |part| {
            let mu_sun = part.middle.mu_sun(toward.mu_sun, nu);
            let altitude_m = part.middle.altitude_m;
            let shade = sunlit(part.middle.distance_m());
            let sun = shade * medium.sun_transmittance(altitude_m, mu_sun, sun_intervals);
            let higher = self.orders.higher_per_sr(medium, altitude_m, mu_sun);
            let once = medium.rayleigh_per_m * part.densities.rayleigh * rayleigh_per_sr
                + medium.mie_scattering_per_m * part.densities.mie * mie_per_sr;
            scattered_per_sr += exp(-medium.depth(part.columns_to_middle))
                * (once * sun + medium.scattering_per_m(part.densities) * higher)
                * part.length_m;
            along.ends.push(PathEnd {
                distance_m: part.end_m,
                scattered_per_sr,
                depth: medium.depth(part.columns_to_end),
            });
        });
        if on_ground {
            along.ground_per_sr = self.ground_per_sr(path.end().mu_sun(toward.mu_sun, nu));
        }
        along
    }

    /// Mean radiance of the upper hemisphere at a place without the sun's disc, per unit of its irradiance, 1/sr.
    #[must_use]
    pub fn upper_mean_per_sr(&self, altitude_m: f64, mu_sun: f64) -> DVec3 {
        orders::upper_mean(mu_sun, |toward| {
            self.roughly_along(altitude_m, toward, false)
                .all()
                .scattered_per_sr
        })
    }
}

/// Altitude above which the thinnest constituent is less than 4e-6 of what it is at the ground, and there is no ozone, m.
fn top_m(air: &PhysicalAtmosphere) -> f64 {
    let scale_m = air
        .rayleigh_scale_height_m()
        .max(air.aerosol_scale_height_m());
    (12.5 * scale_m).max(45_000.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use skycell_protocol::Scene;

    fn air(atmosphere: serde_json::Value) -> Air {
        let document = json!({"version": 1, "atmosphere": atmosphere});
        let scene = Scene::from_json(&document).expect("a scene");
        let air = scene.physical_air().expect("air");
        Air::new(air, scene.planet(), 0.2666f64.to_radians())
    }

    fn earth() -> Air {
        air(json!({"model": "physical"}))
    }

    fn relative(a: DVec3, b: DVec3) -> f64 {
        ((a - b) / b).abs().max_element()
    }

    #[test]
    fn straight_up_the_optical_depths_are_those_of_the_constituents() {
        let earth = earth();
        let depth = -DVec3::from_array(earth.sun_transmittance(0.0, 1.0).to_array().map(f64::ln));
        // β H each, and a tent of 15 km.
        let exact = earth.medium.rayleigh_per_m * 8_000.0
            + DVec3::splat(0.06)
            + earth.medium.ozone_per_m * 15_000.0;
        assert!(relative(depth, exact) < 1e-4, "{depth} {exact}");
    }

    #[test]
    fn curves_of_the_higher_orders_are_their_integrals() {
        let earth = earth();
        for (altitude_m, mu_sun) in [
            (0.0, 0.7),
            (1_300.0, 0.21),
            (5_000.0, 0.013),
            (9_000.0, -0.02),
            (30_000.0, -0.07),
            (60_000.0, 0.5),
        ] {
            let curve = earth.higher_orders_per_sr(altitude_m, mu_sun);
            let fresh = earth.fresh_higher_orders_per_sr(altitude_m, mu_sun);
            let off = relative(curve, fresh);
            assert!(
                off < 0.01,
                "{altitude_m} m, {mu_sun}: {off} ({curve} {fresh})"
            );
        }
    }

    #[test]
    fn white_air_over_black_ground_loses_no_light() {
        // Nothing absorbs but the ground: what it takes and what leaves through the air's top is what came. The higher
        // orders count every scattering as even, which costs some percent.
        let document = json!({"version": 1,
            "planet": {"ground_albedo": 0.0},
            "atmosphere": {"model": "physical", "ozone_dobson": 0.0, "aerosol_optical_depth": 0.0}});
        let scene = Scene::from_json(&document).expect("a scene");
        let air = Air::new(
            scene.physical_air().expect("air"),
            scene.planet(),
            0.2666f64.to_radians(),
        );
        // At noon the sphere's curvature changes little.
        let top_m = air.top_m();
        let mut up = DVec3::ZERO;
        for (place, weight) in orders::gauss(12) {
            let (mu, mu_sun) = (-place, 1.0);
            if mu > air.medium.mu_horizon(top_m) {
                continue;
            }
            let toward = Toward {
                mu,
                mu_sun,
                from_sun: 1.0 - mu,
            };
            let along = air.roughly_along(top_m, toward, true);
            let all = along.all();
            let radiance = all.scattered_per_sr + along.ground_per_sr * all.transmittance;
            up += radiance * (2.0 * PI * weight * place);
        }
        let down = air.sun_transmittance(0.0, 1.0) + air.sky_irradiance(1.0);
        let all = up + down;
        assert!((all - DVec3::ONE).abs().max_element() < 0.03, "{up} {down}");
    }

    #[test]
    fn a_path_in_two_parts_is_the_path() {
        let earth = earth();
        let toward = Toward {
            mu: 0.05,
            mu_sun: 0.3,
            from_sun: 0.4,
        };
        let along = earth.along(2.0, toward, false);
        let (near, all) = (along.until(40_000.0), along.all());
        // From the place where the first part ends.
        let r = 6.36e6 + 2.0;
        let radius: f64 = (r * r + 40_000f64.powi(2) + 2.0 * r * 40_000.0 * 0.05).sqrt();
        let beyond = earth.along(
            radius - 6.36e6,
            Toward {
                mu: (r * 0.05 + 40_000.0) / radius,
                mu_sun: (r * 0.3 + 40_000.0 * 0.6) / radius,
                from_sun: 0.4,
            },
            false,
        );
        let sum = near.scattered_per_sr + near.transmittance * beyond.all().scattered_per_sr;
        assert!(relative(sum, all.scattered_per_sr) < 1e-3);
        let through = near.transmittance * beyond.all().transmittance;
        assert!(relative(through, all.transmittance) < 1e-3);
    }
}
