//! What the air is made of, and straight paths through it, in f64.

use glam::DVec3;
use skycell_protocol::Scene;

/// Wavelengths of the channels, µm.
const WAVELENGTHS_UM: [f64; 3] = [0.680, 0.550, 0.440];
/// Rayleigh scattering at sea level is this over λ⁴ per metre, λ in µm (E. Bruneton 2017, demo.cc `kRayleigh`).
const RAYLEIGH_PER_M_UM4: f64 = 1.240_62e-6;
/// Absorption by ozone where a layer of 300 Dobson units is densest, 1/m (S. Hillaire 2020, table 1).
const OZONE_PER_M: DVec3 = DVec3::new(0.650e-6, 1.881e-6, 0.085e-6);
const OZONE_DOBSON: f64 = 300.0;
/// Middle and half width of the ozone layer, a tent (Bruneton 2017).
const OZONE_MIDDLE_M: f64 = 25_000.0;
const OZONE_HALF_WIDTH_M: f64 = 15_000.0;
/// Air ends where it is e^-12.5, 4e-6, of what it is at the ground; at 100 km on the Earth.
const SCALE_HEIGHTS_TO_TOP: f64 = 12.5;

/// First point of Gauss and Legendre's rule of two on 0…1: (1 − 1/√3)/2.
const NEAR_POINT: f64 = 0.211_324_865_405_187_1;

/// Largest optical depth of a step where nothing is dimmed yet, and how that grows with the depth in front.
const STEP_DEPTH: f64 = 0.8;
const STEP_GROWTH: f64 = 0.25;
/// Largest change of altitude in a step, in scale heights.
const STEP_HEIGHTS: f64 = 1.0;
/// Longest step, in distances from the planet's centre: the sun's height changes over it. Around a planet that is small for
/// its air, whose paths are many radii long, a share of what is left of the path, which bounds the number of steps.
const STEP_RADII: f64 = 0.02;
const STEP_SHARE: f64 = 0.05;
/// Steps of a path at most.
const STEPS_MAX: usize = 256;
/// Optical depth behind which nothing is seen.
const OPAQUE: f64 = 20.0;

/// A place on a path that stands for a part of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stand {
    /// From the path's origin.
    pub(super) distance_m: f64,
    pub(super) altitude_m: f64,
    /// From the planet's centre.
    pub(super) radius_m: f64,
    pub(super) densities: [f64; 3],
    /// Transmittance from the origin.
    pub(super) kept: DVec3,
    /// Of the part.
    pub(super) length_m: f64,
}

/// Air, aerosol and ozone around a sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Medium {
    /// Radius of the ground, m.
    pub radius_m: f64,
    /// Altitude above which there is no air, m.
    pub top_m: f64,
    /// Rayleigh scattering at the ground, 1/m.
    pub rayleigh_per_m: DVec3,
    /// Height over which air falls to 1/e, m.
    pub rayleigh_scale_m: f64,
    /// Scattering by aerosol at the ground, 1/m.
    pub mie_scattering_per_m: DVec3,
    /// Extinction by aerosol at the ground, 1/m.
    pub mie_extinction_per_m: DVec3,
    /// Height over which aerosol falls to 1/e, m.
    pub mie_scale_m: f64,
    /// Mean cosine of its phase.
    pub mie_asymmetry: f64,
    /// Absorption by ozone where it is densest, 1/m.
    pub ozone_per_m: DVec3,
    /// Share of light that the ground reflects.
    pub ground_albedo: f64,
}

impl Medium {
    /// The air of a scene; none where it has no such air.
    #[must_use]
    pub fn of(scene: &Scene) -> Option<Self> {
        let air = scene.physical_air()?;
        let aerosol = DVec3::from_array(
            WAVELENGTHS_UM.map(|um| (um / 0.550).powf(-air.aerosol_angstrom_exponent())),
        );
        let mie_extinction_per_m =
            aerosol * (air.aerosol_optical_depth() / air.aerosol_scale_height_m());
        let scale_m = air
            .rayleigh_scale_height_m()
            .max(air.aerosol_scale_height_m());
        Some(Self {
            radius_m: scene.planet().radius_m(),
            top_m: (SCALE_HEIGHTS_TO_TOP * scale_m)
                .max(OZONE_MIDDLE_M + OZONE_HALF_WIDTH_M + 5_000.0),
            rayleigh_per_m: DVec3::from_array(
                WAVELENGTHS_UM
                    .map(|um| air.rayleigh_density() * RAYLEIGH_PER_M_UM4 / (um * um * um * um)),
            ),
            rayleigh_scale_m: air.rayleigh_scale_height_m(),
            mie_scattering_per_m: air.aerosol_single_scattering_albedo() * mie_extinction_per_m,
            mie_extinction_per_m,
            mie_scale_m: air.aerosol_scale_height_m(),
            mie_asymmetry: air.aerosol_asymmetry(),
            ozone_per_m: OZONE_PER_M * (air.ozone_dobson() / OZONE_DOBSON),
            ground_albedo: scene.planet().ground_albedo(),
        })
    }

    /// The air a share of the way from one to another around the same planet.
    #[must_use]
    pub fn between(from: &Self, to: &Self, share: f64) -> Self {
        let mix = |of: fn(&Self) -> f64| of(from) + share * (of(to) - of(from));
        let mix_colours = |of: fn(&Self) -> DVec3| of(from).lerp(of(to), share);
        Self {
            radius_m: to.radius_m,
            top_m: mix(|m| m.top_m),
            rayleigh_per_m: mix_colours(|m| m.rayleigh_per_m),
            rayleigh_scale_m: mix(|m| m.rayleigh_scale_m),
            mie_scattering_per_m: mix_colours(|m| m.mie_scattering_per_m),
            mie_extinction_per_m: mix_colours(|m| m.mie_extinction_per_m),
            mie_scale_m: mix(|m| m.mie_scale_m),
            mie_asymmetry: mix(|m| m.mie_asymmetry),
            ozone_per_m: mix_colours(|m| m.ozone_per_m),
            ground_albedo: mix(|m| m.ground_albedo),
        }
    }

    /// Densities of air, aerosol and ozone relative to their coefficients.
    pub(super) fn densities(&self, altitude_m: f64) -> [f64; 3] {
        [
            (-altitude_m / self.rayleigh_scale_m).exp(),
            (-altitude_m / self.mie_scale_m).exp(),
            (1.0 - (altitude_m - OZONE_MIDDLE_M).abs() / OZONE_HALF_WIDTH_M).max(0.0),
        ]
    }

    pub(super) fn extinction_per_m(&self, [air, aerosol, ozone]: [f64; 3]) -> DVec3 {
        self.rayleigh_per_m * air + self.mie_extinction_per_m * aerosol + self.ozone_per_m * ozone
    }

    pub(super) fn scattering_per_m(&self, [air, aerosol, _]: [f64; 3]) -> DVec3 {
        self.rayleigh_per_m * air + self.mie_scattering_per_m * aerosol
    }

    /// Cosine of the zenith angle of the horizon.
    #[must_use]
    pub fn mu_horizon(&self, altitude_m: f64) -> f64 {
        let h = altitude_m.max(0.0);
        -(h * (h + 2.0 * self.radius_m)).sqrt() / (self.radius_m + h)
    }

    /// How much the aerosol's phase counts in the one that divides the haze's radiance: about what it has in the light.
    #[must_use]
    pub fn haze_mie_weight(&self) -> f64 {
        let green = |v: DVec3| v.y;
        let air = green(self.rayleigh_per_m) * self.rayleigh_scale_m;
        let aerosol = green(self.mie_scattering_per_m) * self.mie_scale_m;
        (aerosol / air.max(1e-9)).min(1e3)
    }

    /// Height over which what dims falls to 1/e, the lesser where both air and aerosol do, m.
    #[must_use]
    pub fn row_scale_m(&self) -> f64 {
        let air = self.rayleigh_per_m.max_element() > 0.0;
        let aerosol = self.mie_extinction_per_m.max_element() > 0.0;
        match (air, aerosol) {
            (true, true) | (false, false) => self.rayleigh_scale_m.min(self.mie_scale_m),
            (true, false) => self.rayleigh_scale_m,
            (false, true) => self.mie_scale_m,
        }
    }

    /// Distances at which a path begins, is lowest and ends, from an altitude with a cosine of the zenith angle.
    pub(super) fn path_m(&self, altitude_m: f64, mu: f64, on_ground: bool) -> Option<[f64; 3]> {
        let r = self.radius_m;
        let b = (r + altitude_m) * mu;
        let roots = |shell_m: f64| {
            let c = (altitude_m - shell_m) * (altitude_m + shell_m + 2.0 * r);
            let root = (b * b - c).max(0.0).sqrt();
            let q = if b < 0.0 { root - b } else { -(b + root) };
            let other = if q == 0.0 { 0.0 } else { c / q };
            (b * b >= c).then_some((q.min(other), q.max(other)))
        };
        let (near, far) = roots(self.top_m)?;
        let start = near.max(0.0);
        let end = if on_ground {
            roots(0.0).map_or(-b, |(near, _)| near)
        } else {
            far
        };
        // An eye on the ground has ground before it, and no air.
        let end = if on_ground { end.max(start) } else { end };
        (end > start || on_ground).then(|| [start, (-b).clamp(start, end), end])
    }

    /// Altitude at a distance along a path, and the radius there.
    pub(super) fn altitude_along(&self, altitude_m: f64, mu: f64, distance_m: f64) -> (f64, f64) {
        let (r, h, t) = (self.radius_m, altitude_m, distance_m);
        let excess = h * (h + 2.0 * r) + t * (t + 2.0 * (r + h) * mu);
        let radius = (r * r + excess).max(1.0).sqrt();
        (excess / (radius + r), radius)
    }

    /// Points and weights of a path: two of Gauss and Legendre's in each interval, which are short towards the path's
    /// lowest place, where air is dense.
    pub(super) fn points(
        [start, lowest, end]: [f64; 3],
        count: u32,
    ) -> impl Iterator<Item = (f64, f64)> {
        let n = f64::from(count);
        let part = move |from: f64, to: f64, i: u32| {
            let x = (f64::from(i / 2) + [NEAR_POINT, 1.0 - NEAR_POINT][i as usize % 2]) / n;
            (from + (to - from) * x * x, (to - from).abs() * x / n)
        };
        let down = if lowest > start { 2 * count } else { 0 };
        let up = if end > lowest { 2 * count } else { 0 };
        let falling = (0..down).rev().map(move |i| part(lowest, start, i));
        falling.chain((0..up).map(move |i| part(lowest, end, i)))
    }

    /// Points that stand for a path where light is scattered into it, in order. Intervals are as long as air and what it
    /// lets through change little: depth by [`STEP_DEPTH`] and more behind what is dim anyway, altitude by
    /// [`STEP_HEIGHTS`] scale heights.
    pub(super) fn walk(&self, altitude_m: f64, mu: f64, [start, _, end]: [f64; 3]) -> Vec<Stand> {
        let r = self.radius_m + altitude_m;
        let reach_m = |distance_m: f64, depth: DVec3, rest_m: f64| {
            let (there_m, radius) = self.altitude_along(altitude_m, mu, distance_m);
            let densities = self.densities(there_m);
            let [air, aerosol, _] = densities;
            let changes = |air: f64, aerosol: f64| {
                (air / self.rayleigh_scale_m + aerosol / self.mie_scale_m)
                    / (air + aerosol).max(1e-300)
            };
            // Aerosol weighs most in the red.
            let change = changes(
                self.rayleigh_per_m.x * air,
                self.mie_extinction_per_m.x * aerosol,
            );
            let height =
                STEP_HEIGHTS / change.max(1.0 / self.rayleigh_scale_m.max(self.mie_scale_m));
            let slope = ((r * mu + distance_m) / radius).abs().min(1.0);
            let bend = 0.5 * (1.0 - slope * slope) / radius;
            let climb = 2.0 * height / (slope + (slope * slope + 4.0 * bend * height).sqrt());
            let allowed = STEP_DEPTH * exp(STEP_GROWTH * depth.min(DVec3::splat(40.0)))
                / self.extinction_per_m(densities).max(DVec3::splat(1e-30));
            climb
                .min(allowed.min_element())
                .min((STEP_RADII * radius).max(STEP_SHARE * rest_m))
        };
        let mut stands = Vec::new();
        let (mut at, mut depth) = (start, DVec3::ZERO);
        while at < end && stands.len() < 2 * STEPS_MAX && depth.min_element() < OPAQUE {
            let rest = end - at;
            let far = reach_m(at, depth, rest).min(rest);
            let near = reach_m(at + far, depth, rest).clamp(0.125 * far, far);
            let length = if stands.len() + 2 == 2 * STEPS_MAX {
                rest
            } else {
                near.max(1e-4 * rest)
            };
            let mut stand = |share: f64| {
                let distance_m = at + share * length;
                let (there_m, radius_m) = self.altitude_along(altitude_m, mu, distance_m);
                let densities = self.densities(there_m);
                stands.push(Stand {
                    distance_m,
                    altitude_m: there_m,
                    radius_m,
                    densities,
                    kept: DVec3::ZERO,
                    length_m: 0.5 * length,
                });
                self.extinction_per_m(densities)
            };
            let (first, second) = (stand(NEAR_POINT), stand(1.0 - NEAR_POINT));
            // Between the points extinction is a straight line, which goes on beyond them.
            let all = 0.5 * length * (first + second);
            let beyond = 0.5 * NEAR_POINT / (1.0 - 2.0 * NEAR_POINT) * (second - first);
            let to_first = (NEAR_POINT * length * (first - beyond)).max(DVec3::ZERO);
            let from_second = (NEAR_POINT * length * (second + beyond)).max(DVec3::ZERO);
            let count = stands.len();
            stands[count - 2].kept = exp(-(depth + to_first));
            stands[count - 1].kept = exp(-(depth + (all - from_second).max(DVec3::ZERO)));
            depth += all;
            at = if length >= rest { end } else { at + length };
        }
        stands
    }

    /// Optical depth of a path.
    pub(super) fn depth(&self, altitude_m: f64, mu: f64, count: u32) -> DVec3 {
        self.path_m(altitude_m, mu, false)
            .map_or(DVec3::ZERO, |path| {
                self.depth_of(altitude_m, mu, path, count)
            })
    }

    /// The same of a known path.
    pub(super) fn depth_of(&self, altitude_m: f64, mu: f64, path: [f64; 3], count: u32) -> DVec3 {
        let mut columns = [0.0; 3];
        for (middle, length) in Self::points(path, count) {
            let (altitude, _) = self.altitude_along(altitude_m, mu, middle);
            for (column, density) in columns.iter_mut().zip(self.densities(altitude)) {
                *column += density * length;
            }
        }
        self.extinction_per_m(columns)
    }
}

pub(super) fn exp(v: DVec3) -> DVec3 {
    DVec3::new(v.x.exp(), v.y.exp(), v.z.exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// Optical depth times what is left of light, summed over a path in small even steps.
    fn opacity(medium: &Medium, altitude_m: f64, mu: f64, [start, _, end]: [f64; 3]) -> DVec3 {
        const STEPS: u32 = 100_000;
        let length = (end - start) / f64::from(STEPS);
        let (mut depth, mut sum) = (DVec3::ZERO, DVec3::ZERO);
        for i in 0..STEPS {
            let at = start + (f64::from(i) + 0.5) * length;
            let densities = medium.densities(medium.altitude_along(altitude_m, mu, at).0);
            let more = medium.extinction_per_m(densities) * length;
            sum += medium.scattering_per_m(densities) * length * exp(-(depth + 0.5 * more));
            depth += more;
        }
        sum
    }

    #[test]
    fn walks_are_short_and_right_around_planets_of_any_size() {
        let (mut most, mut worst) = (0, 0.0f64);
        for radius_m in [1e4, 1e5, 6.36e6, 1e8] {
            let document = json!({"version": 1, "planet": {"radius_m": radius_m},
                "atmosphere": {"model": "physical"}});
            let scene = Scene::from_json(&document).expect("valid");
            let medium = Medium::of(&scene).expect("air");
            for altitude_m in [0.0, 5_000.0, 40_000.0, 400_000.0] {
                // A share of the way from the nadir's horizon to the zenith.
                let horizon = medium.mu_horizon(altitude_m) + 1e-6;
                for share in [0.0, 1e-3, 0.02, 0.1, 0.4, 1.0] {
                    let mu = horizon + share * (1.0 - horizon);
                    let Some(path) = medium.path_m(altitude_m, mu, false) else {
                        continue;
                    };
                    let stands = medium.walk(altitude_m, mu, path);
                    most = most.max(stands.len());
                    let walked: DVec3 = stands
                        .iter()
                        .map(|stand| {
                            medium.scattering_per_m(stand.densities) * stand.length_m * stand.kept
                        })
                        .sum();
                    let exact = opacity(&medium, altitude_m, mu, path);
                    let off = ((walked - exact) / exact).abs().max_element();
                    worst = worst.max(off);
                }
            }
        }
        println!("at most {most} points, {worst:.5} off");
        // Two points a step. The last step that a walk may have takes what is left; it is never needed.
        assert!(most <= 2 * 64, "{most} points");
        assert!(worst < 0.007, "{worst}");
    }
}
