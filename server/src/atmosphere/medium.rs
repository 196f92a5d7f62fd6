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
        (end > start).then(|| [start, (-b).clamp(start, end), end])
    }

    /// Altitude at a distance along a path, and the radius there.
    pub(super) fn altitude_along(&self, altitude_m: f64, mu: f64, distance_m: f64) -> (f64, f64) {
        let (r, h, t) = (self.radius_m, altitude_m, distance_m);
        let excess = h * (h + 2.0 * r) + t * (t + 2.0 * (r + h) * mu);
        let radius = (r * r + excess).max(1.0).sqrt();
        (excess / (radius + r), radius)
    }

    /// Middles and lengths of the intervals of a path: short towards its lowest place, where air is dense.
    pub(super) fn intervals(
        [start, lowest, end]: [f64; 3],
        count: u32,
    ) -> impl Iterator<Item = (f64, f64)> {
        let n = f64::from(count);
        let part = move |from: f64, to: f64, x: f64| {
            let (near, far) = (x / n, (x + 1.0) / n);
            let middle = 0.5 * (near + far);
            (
                from + (to - from) * middle * middle,
                (to - from).abs() * (far - near) * (far + near),
            )
        };
        let down = if lowest > start { count } else { 0 };
        let up = if end > lowest { count } else { 0 };
        let falling = (0..down)
            .rev()
            .map(move |i| part(lowest, start, f64::from(i)));
        falling.chain((0..up).map(move |i| part(lowest, end, f64::from(i))))
    }

    /// Optical depth of a path.
    pub(super) fn depth(&self, altitude_m: f64, mu: f64, count: u32) -> DVec3 {
        let Some(path) = self.path_m(altitude_m, mu, false) else {
            return DVec3::ZERO;
        };
        let mut columns = [0.0; 3];
        for (middle, length) in Self::intervals(path, count) {
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
