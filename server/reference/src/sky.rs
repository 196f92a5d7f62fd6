//! Light from outside the clouds: the sun through the air, the clear sky, the ground.
//!
//! The model of the clear sky is the renderer's plain one: single scattering in a slab of air and one of aerosol whose
//! path lengths are those of homogeneous shells, plus an even estimate of the higher orders. Its constants are the
//! model's; what follows from them is computed here anew.

use crate::Ray;
use crate::air::{Air, AirLight, AlongPath, Toward};
use crate::phase::{hg_per_sr, one_minus_mu, one_minus_mu_of_radius};
use crate::shell::Globe;
use crate::transport::one_minus_exp_over;
use glam::DVec3;
use skycell_protocol::Scene;
use skycell_protocol::scene::Atmosphere;
use std::f64::consts::PI;

/// Rayleigh scattering at sea level is 1.24062e-6 / λ⁴ per metre, λ in µm (E. Bruneton 2017), here at 680, 550 and 440 nm
/// and times the scale height: the optical depth straight up.
const RAYLEIGH_OPTICAL_DEPTH: DVec3 = DVec3::new(0.046_418, 0.108_463, 0.264_804);
const RAYLEIGH_SCALE_HEIGHT_M: f64 = 8_000.0;
const AEROSOL_SCALE_HEIGHT_M: f64 = 1_200.0;
/// Mean cosine of continental aerosol.
const AEROSOL_ASYMMETRY: f64 = 0.76;
/// The model's factor of the higher orders.
const DIFFUSE_FACTOR: f64 = 1.5;
/// The night sky's own light, W/(m² nm sr): 21.6 magnitudes per square arcsecond (F. Patat 2003).
const AIRGLOW_RADIANCE: DVec3 = DVec3::new(2.8e-9, 3.4e-9, 3.9e-9);
/// Angular radius of the sun as seen from the earth.
pub const SUN_ANGULAR_RADIUS_DEG: f64 = 0.2666;
/// Rings and sectors over which the model takes the hemisphere's mean.
const MEAN_RINGS: u32 = 16;
const MEAN_SECTORS: u32 = 32;

/// Radiance of the sun's disc over its mean where its surface is seen at a cosine µ: the renderer's fit of µ^α with
/// α = −0.023 + 0.292/λ, λ in µm (Hestroffer & Magnan 1998).
#[must_use]
pub fn limb(mu: f64) -> DVec3 {
    DVec3::new(0.380_422, 0.280_491_5, 0.174_775_3)
        + DVec3::new(1.302_639_3, 1.447_898_5, 1.558_243_8) * mu
        + DVec3::new(-0.485_334_8, -0.477_635_4, -0.412_042_7) * (mu * mu)
}

/// Clear air along a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClearSky {
    /// Radiance without the sun's disc.
    pub radiance: DVec3,
    /// Transmittance of the whole column.
    pub transmittance: DVec3,
}

/// What lies behind all clouds.
#[derive(Clone, Debug, PartialEq)]
pub struct Background {
    /// Radiance of sky and sun or of the ground.
    pub radiance: DVec3,
    /// The same without the sun's disc.
    pub without_sun: DVec3,
    /// Radiance of clear air: what haze fades to.
    pub air: DVec3,
    /// 1 / (1 − transmittance of the whole column): how much of `air` a part of the column has.
    pub air_share: DVec3,
    /// Whether the ray ends on the ground.
    pub on_ground: bool,
    /// Light of the air along the ray, where it is integrated.
    along: Option<AlongPath>,
}

/// Air between the eye and a cloud.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Haze {
    /// Share of the cloud's light that comes through.
    pub kept: DVec3,
    /// Radiance of the air in front of it.
    pub added: DVec3,
}

impl Haze {
    /// No air at all.
    pub const NONE: Self = Self {
        kept: DVec3::ONE,
        added: DVec3::ZERO,
    };
}

impl Background {
    /// The air as far as a distance, m, in front of a layer with a mean extinction of the air up to it, 1/m, which the
    /// closed formula counts with.
    #[must_use]
    pub fn haze(&self, light: &SkyLight, distance_m: f64, air_extinction_per_m: DVec3) -> Haze {
        if let Some(along) = &self.along {
            let AirLight {
                scattered_per_sr,
                transmittance,
            } = along.until(distance_m);
            return Haze {
                kept: transmittance,
                added: light.sun_irradiance * scattered_per_sr,
            };
        }
        let kept = each(-distance_m * air_extinction_per_m, f64::exp);
        let share = ((DVec3::ONE - kept) * self.air_share).clamp(DVec3::ZERO, DVec3::ONE);
        Haze {
            kept,
            added: self.air * share,
        }
    }
}

/// Light of a scene for clouds around one altitude.
#[derive(Clone, Debug)]
pub struct SkyLight {
    /// Unit vector towards the sun.
    pub sun_direction: DVec3,
    /// 1 − cos of the sun's angular radius.
    pub sun_one_minus_mu: f64,
    /// Spectral irradiance of the sun above the air.
    pub sun_irradiance: DVec3,
    /// Spectral irradiance of the sun at the clouds, on a surface that faces it.
    pub irradiance_at_clouds: DVec3,
    /// Mean radiance of the upper hemisphere.
    pub mean_radiance: DVec3,
    /// Radiance of the lit ground, seen from nearby.
    pub ground_radiance: DVec3,
    /// Radiance that comes from everywhere beside that of the air.
    pub environment_radiance: DVec3,
    /// Whether the light's disc is the sun's. The moon's own disc and the stars are the renderer's alone.
    shows_disc: bool,
    globe: Globe,
    air: Option<Air>,
    radius_m: f64,
    rayleigh: DVec3,
    aerosol: f64,
    /// How much of the sun's light the sky still has: 1 by day, 0 at night.
    lit: f64,
    sun_column: DVec3,
    diffuse_per_sr: DVec3,
}

/// How the air is integrated.
enum Fineness<'a> {
    Rough,
    Fine,
    /// With the share of the sun's light that clouds let through to a place.
    Shaded(&'a dyn Fn(DVec3) -> f64),
}

fn smoothstep(from: f64, to: f64, at: f64) -> f64 {
    let t = ((at - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

fn each(v: DVec3, f: impl Fn(f64) -> f64) -> DVec3 {
    DVec3::from_array(v.to_array().map(f))
}

/// Path through a shell of height H around a planet of radius R at a cosine of the zenith angle, in units of H:
/// √((R µ)² + 2 R H + H²)/H − R µ/H, without cancellation; below the horizon as at it.
#[must_use]
pub fn relative_air_mass(planet_radius_m: f64, shell_height_m: f64, mu: f64) -> f64 {
    let r = planet_radius_m / shell_height_m;
    let along = r * mu.max(0.0);
    (2.0 * r + 1.0) / ((along * along + 2.0 * r + 1.0).sqrt() + along)
}

impl SkyLight {
    /// The light of a scene for clouds around an altitude, m: the sun's, or the moon's where that is more.
    #[must_use]
    pub fn new(scene: &Scene, cloud_altitude_m: f64) -> Self {
        let irradiance = DVec3::from_array(scene.sun().irradiance_w_per_m2_nm());
        let sun = Self::of(scene, cloud_altitude_m, scene.sun().direction(), irradiance);
        let Some(moon) = scene.moon() else {
            return sun;
        };
        let share = moon.share_of_sunlight();
        let mut moonlit = Self::of(
            scene,
            cloud_altitude_m,
            moon.direction(),
            irradiance * share,
        );
        moonlit.shows_disc = false;
        let total = |light: &Self| {
            let sky = light.mean_radiance - light.environment_radiance;
            (light.irradiance_at_clouds + PI * sky).element_sum()
        };
        if total(&moonlit) > total(&sun) {
            moonlit
        } else {
            sun
        }
    }

    fn of(
        scene: &Scene,
        cloud_altitude_m: f64,
        sun_direction: DVec3,
        sun_irradiance: DVec3,
    ) -> Self {
        let (rayleigh, aerosol, environment_radiance) = match scene.atmosphere() {
            Atmosphere::Analytic(sky) => (
                RAYLEIGH_OPTICAL_DEPTH,
                sky.aerosol_optical_depth(),
                DVec3::ZERO,
            ),
            // Of a flat world, which has no such air.
            Atmosphere::Physical(sky) => (
                RAYLEIGH_OPTICAL_DEPTH,
                sky.aerosol_optical_depth(),
                DVec3::ZERO,
            ),
            Atmosphere::Uniform(sky) => (
                DVec3::ZERO,
                0.0,
                DVec3::from_array(sky.radiance_w_per_m2_nm_sr()),
            ),
        };
        let radius_m = scene.planet().radius_m();
        let globe = if scene.planet().is_flat() {
            Globe::Flat
        } else {
            Globe::Sphere { radius_m }
        };
        let angular_radius_rad = SUN_ANGULAR_RADIUS_DEG.to_radians();
        let mut light = Self {
            sun_direction,
            sun_one_minus_mu: one_minus_mu_of_radius(angular_radius_rad),
            sun_irradiance,
            shows_disc: true,
            irradiance_at_clouds: DVec3::ZERO,
            mean_radiance: DVec3::ZERO,
            ground_radiance: DVec3::ZERO,
            environment_radiance,
            globe,
            air: scene
                .physical_air()
                .map(|air| Air::new(air, scene.planet(), angular_radius_rad)),
            radius_m,
            rayleigh,
            aerosol,
            lit: 0.0,
            sun_column: DVec3::ZERO,
            diffuse_per_sr: DVec3::ZERO,
        };
        let mu_sun = light.sun_direction.y;
        if let Some(air) = &light.air {
            let irradiance = light.sun_irradiance;
            light.irradiance_at_clouds =
                irradiance * air.sun_transmittance(cloud_altitude_m, mu_sun);
            light.environment_radiance = AIRGLOW_RADIANCE;
            light.mean_radiance = light.environment_radiance
                + irradiance * air.upper_mean_per_sr(cloud_altitude_m, mu_sun);
            light.ground_radiance = irradiance * air.ground_per_sr(mu_sun);
            return light;
        }
        let (sun_rayleigh, sun_aerosol) = light.column(mu_sun);
        light.sun_column = sun_rayleigh + sun_aerosol;
        light.lit = smoothstep(-0.1, 0.05, mu_sun);
        light.diffuse_per_sr = DIFFUSE_FACTOR / (4.0 * PI)
            * each(light.sun_column, |x| {
                -(-0.5 * x).exp_m1() * (-0.25 * x).exp()
            });
        // The sun stays visible until it is a disc's radius under the horizon, which dips with altitude.
        let visible = |altitude_m: f64| match globe {
            Globe::Flat => 1.0,
            Globe::Sphere { radius_m } => {
                let dip_rad = (radius_m / (radius_m + altitude_m.max(0.0))).acos();
                let above_rad = mu_sun.clamp(-1.0, 1.0).asin() + dip_rad;
                smoothstep(-angular_radius_rad, angular_radius_rad, above_rad)
            }
        };
        let share_above = |scale_m: f64| (-cloud_altitude_m.max(0.0) / scale_m).exp();
        let above_clouds = sun_rayleigh * share_above(RAYLEIGH_SCALE_HEIGHT_M)
            + sun_aerosol * share_above(AEROSOL_SCALE_HEIGHT_M);
        light.irradiance_at_clouds =
            light.sun_irradiance * each(above_clouds, |x| (-x).exp()) * visible(cloud_altitude_m);
        light.mean_radiance = light.hemisphere_mean(MEAN_RINGS, MEAN_SECTORS);
        let at_ground =
            light.sun_irradiance * each(light.sun_column, |x| (-x).exp()) * visible(0.0);
        let irradiance = at_ground * mu_sun.max(0.0) + PI * light.mean_radiance;
        light.ground_radiance = if scene.planet().is_flat() {
            // Nothing lies below: the sky goes on there.
            light.mean_radiance
        } else {
            scene.planet().ground_albedo() / PI * irradiance
        };
        light
    }

    /// Optical depths of air and aerosol along a direction with a cosine of the zenith angle.
    fn column(&self, mu: f64) -> (DVec3, f64) {
        (
            self.rayleigh * relative_air_mass(self.radius_m, RAYLEIGH_SCALE_HEIGHT_M, mu),
            self.aerosol * relative_air_mass(self.radius_m, AEROSOL_SCALE_HEIGHT_M, mu),
        )
    }

    /// The cloudless sky towards a direction; below the horizon as at it.
    ///
    /// A slab that scatters once: E P X_v (e^(−X_v) − e^(−X_s)) / (X_s − X_v), X the optical depths towards viewer and sun.
    /// The quotient is e^(−min) (1 − e^(−|X_s − X_v|)) / |X_s − X_v|.
    #[must_use]
    pub fn clear_sky(&self, direction: DVec3) -> ClearSky {
        let (rayleigh, aerosol) = self.column(direction.y);
        let view_column = rayleigh + aerosol;
        let x = one_minus_mu(direction, self.sun_direction);
        let mu = 1.0 - x;
        let scattered = rayleigh * (3.0 / (16.0 * PI) * (1.0 + mu * mu))
            + aerosol * hg_per_sr(AEROSOL_ASYMMETRY, x);
        let least = each(self.sun_column.min(view_column), |x| (-x).exp());
        let slab = least * each((self.sun_column - view_column).abs(), one_minus_exp_over);
        let lost = each(view_column, |x| -(-x).exp_m1());
        let air = self.lit * self.sun_irradiance * (scattered * slab + lost * self.diffuse_per_sr);
        ClearSky {
            radiance: self.environment_radiance + air,
            transmittance: each(view_column, |x| (-x).exp()),
        }
    }

    /// Mean radiance of the upper hemisphere over rings of equal solid angle.
    #[must_use]
    pub fn hemisphere_mean(&self, rings: u32, sectors: u32) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for ring in 0..rings {
            let mu = (f64::from(ring) + 0.5) / f64::from(rings);
            let across = (1.0 - mu * mu).sqrt();
            for sector in 0..sectors {
                let (sine, cosine) =
                    (2.0 * PI * (f64::from(sector) + 0.5) / f64::from(sectors)).sin_cos();
                sum += self
                    .clear_sky(DVec3::new(across * cosine, mu, across * sine))
                    .radiance;
            }
        }
        sum / f64::from(rings) / f64::from(sectors)
    }

    /// Radiance of the sun's disc as far as a direction sees it, above the air. Its rim is as soft as the renderer's.
    #[must_use]
    pub fn sun_disc_radiance(&self, direction: DVec3) -> DVec3 {
        if !self.shows_disc {
            return DVec3::ZERO;
        }
        let x = one_minus_mu(direction, self.sun_direction);
        let inside = 1.0
            - smoothstep(
                0.85 * self.sun_one_minus_mu,
                1.15 * self.sun_one_minus_mu,
                x,
            );
        let surface_mu = (1.0 - x / self.sun_one_minus_mu).max(0.0).sqrt();
        inside * limb(surface_mu) * self.sun_irradiance / (2.0 * PI * self.sun_one_minus_mu)
    }

    /// Spectral irradiance of the sun at an altitude, facing it; the closed formula knows only that at the clouds.
    #[must_use]
    pub fn sun_at(&self, altitude_m: f64) -> DVec3 {
        match &self.air {
            Some(air) => {
                self.sun_irradiance * air.sun_transmittance(altitude_m, self.sun_direction.y)
            }
            None => self.irradiance_at_clouds,
        }
    }

    /// Mean extinction of the air between the ground and an altitude, 1/m.
    #[must_use]
    pub fn air_extinction_per_m(&self, altitude_m: f64) -> DVec3 {
        let mean = |scale_m: f64| one_minus_exp_over(altitude_m.max(0.0) / scale_m) / scale_m;
        self.rayleigh * mean(RAYLEIGH_SCALE_HEIGHT_M) + self.aerosol * mean(AEROSOL_SCALE_HEIGHT_M)
    }

    /// What lies behind all clouds along a ray. `air_direction` is where clear air is looked up: the renderer shares one
    /// among four pixels.
    #[must_use]
    pub fn background(&self, ray: &Ray, air_direction: DVec3) -> Background {
        if let Some(air) = &self.air {
            return self.background_of_air(air, ray, air_direction, Fineness::Fine);
        }
        let sky = self.clear_sky(air_direction);
        let air_share = each(sky.transmittance, |t| 1.0 / (1.0 - t).max(1e-6));
        let ground_m = self.globe.ground_m(ray);
        let without_sun = match ground_m {
            None => sky.radiance,
            Some(_) => {
                // The ground's light is dimmed on the way and the air adds its share.
                let shared = Ray {
                    origin_m: ray.origin_m,
                    direction: air_direction,
                };
                let kept = each(
                    self.air_extinction_per_m(0.0) * self.nearest_ground_m(&shared),
                    |x| (-x).exp(),
                );
                self.ground_radiance * kept
                    + sky.radiance
                        * ((DVec3::ONE - kept) * air_share).clamp(DVec3::ZERO, DVec3::ONE)
            }
        };
        let sun = match ground_m {
            None => self.sun_disc_radiance(ray.direction) * sky.transmittance,
            Some(_) => DVec3::ZERO,
        };
        Background {
            radiance: without_sun + sun,
            without_sun,
            air: sky.radiance,
            air_share,
            on_ground: ground_m.is_some(),
            along: None,
        }
    }

    /// The same in air that clouds shade, where the scene has such: `sunlit` is the share of the sun's light that they let
    /// through to a place of the frame.
    #[must_use]
    pub fn shaded_background(
        &self,
        ray: &Ray,
        air_direction: DVec3,
        sunlit: &dyn Fn(DVec3) -> f64,
    ) -> Background {
        match &self.air {
            Some(air) => self.background_of_air(air, ray, air_direction, Fineness::Shaded(sunlit)),
            None => self.background(ray, air_direction),
        }
    }

    /// What lies behind all clouds along a ray that left them, without the sun's disc. Integrated air is integrated
    /// roughly.
    #[must_use]
    pub fn environment(&self, ray: &Ray) -> DVec3 {
        match &self.air {
            Some(air) => self.background_of_air(air, ray, ray.direction, Fineness::Rough),
            None => self.background(ray, ray.direction),
        }
        .without_sun
    }

    /// The air that is integrated, where the scene has such.
    #[must_use]
    pub fn air(&self) -> Option<&Air> {
        self.air.as_ref()
    }

    fn background_of_air(
        &self,
        air: &Air,
        ray: &Ray,
        air_direction: DVec3,
        fineness: Fineness<'_>,
    ) -> Background {
        let altitude_m = self.globe.altitude_m(ray.origin_m);
        let up = (ray.origin_m + DVec3::Y * self.radius_m).normalize_or(DVec3::Y);
        let on_ground = self.globe.ground_m(ray).is_some();
        let toward = Toward::new(air_direction, up, self.sun_direction);
        let along = match fineness {
            Fineness::Rough => air.roughly_along(altitude_m, toward, on_ground),
            Fineness::Fine => air.along(altitude_m, toward, on_ground),
            Fineness::Shaded(sunlit) => {
                let at = |distance_m: f64| ray.origin_m + air_direction * distance_m;
                air.along_shaded(altitude_m, toward, on_ground, |d| sunlit(at(d)))
            }
        };
        let all = along.all();
        let scattered = self.environment_radiance + self.sun_irradiance * all.scattered_per_sr;
        let ground = self.sun_irradiance * along.ground_per_sr * all.transmittance;
        let sun = if on_ground {
            DVec3::ZERO
        } else {
            self.sun_disc_radiance(ray.direction) * all.transmittance
        };
        Background {
            radiance: scattered + ground + sun,
            without_sun: scattered + ground,
            air: scattered,
            air_share: each(all.transmittance, |t| 1.0 / (1.0 - t).max(1e-6)),
            on_ground,
            along: Some(along),
        }
    }

    /// Where a ray meets the ground, or comes closest to it, m.
    fn nearest_ground_m(&self, ray: &Ray) -> f64 {
        let at = match self.globe.at_most(0.0, ray) {
            Some(line) => line.start_m,
            None => self.globe.lowest_m(ray),
        };
        at.max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn light(document: serde_json::Value) -> SkyLight {
        SkyLight::new(&Scene::from_json(&document).expect("a scene"), 2_000.0)
    }

    #[test]
    fn the_disc_of_the_sun_gives_its_irradiance() {
        let light = light(json!({"version": 1}));
        // ∫ L dω over rings in x = 1 − µ; the rim is soft, so the disc reaches 15 % beyond.
        let count = 20_000;
        let end = 1.2 * light.sun_one_minus_mu;
        let mut sum = DVec3::ZERO;
        for i in 0..count {
            let x = (f64::from(i) + 0.5) / f64::from(count) * end;
            let direction = crate::phase::turned(light.sun_direction, x, 0.3);
            sum += light.sun_disc_radiance(direction) * (2.0 * PI * end / f64::from(count));
        }
        assert!(
            ((sum - light.sun_irradiance) / light.sun_irradiance)
                .abs()
                .max_element()
                < 1e-4
        );
    }

    #[test]
    fn the_limb_is_darkened_as_measured() {
        // µ^α over its mean 2/(α + 2): within a few hundredths wherever the fit is not at the very rim.
        for mu in [0.2, 0.4, 0.6, 0.8, 1.0] {
            for (channel, wavelength_um) in [0.680, 0.550, 0.440].into_iter().enumerate() {
                let alpha = -0.023 + 0.292 / wavelength_um;
                let law = f64::powf(mu, alpha) * (alpha + 2.0) / 2.0;
                assert!(
                    (limb(mu)[channel] / law - 1.0).abs() < 0.03,
                    "{mu} {channel}"
                );
            }
        }
    }

    #[test]
    fn sixteen_rings_of_the_hemisphere_are_within_a_percent_of_all_of_it() {
        for elevation_deg in [5.0, 40.0, 80.0] {
            let light = light(json!({"version": 1, "sun": {"elevation_deg": elevation_deg}}));
            let fine = light.hemisphere_mean(512, 512);
            let off = ((light.mean_radiance - fine) / fine).abs().max_element();
            assert!(off < 0.01, "{elevation_deg}: {off}");
        }
    }

    #[test]
    fn a_uniform_environment_has_no_air() {
        let light = light(json!({"version": 1, "planet": null,
            "atmosphere": {"model": "uniform", "radiance_w_per_m2_nm_sr": [1.0, 2.0, 3.0]}}));
        let one_two_three = DVec3::new(1.0, 2.0, 3.0);
        assert_eq!(light.irradiance_at_clouds, light.sun_irradiance);
        assert!((light.mean_radiance - one_two_three).length() < 1e-12);
        let ray = Ray::new(DVec3::ZERO, DVec3::new(0.3, -0.5, 0.1)).expect("a ray");
        let background = light.background(&ray, ray.direction);
        assert_eq!(background.without_sun, one_two_three);
        assert!(!background.on_ground);
    }

    #[test]
    fn equal_columns_scatter_as_the_limit_says() {
        // X_s = X_v: the slab's quotient tends to e^−X. Sun and view at the same height, 90° apart.
        let light =
            light(json!({"version": 1, "sun": {"elevation_deg": 30.0, "azimuth_deg": 0.0}}));
        let toward = DVec3::new(light.sun_direction.z.abs(), light.sun_direction.y, 0.0);
        let near = light.clear_sky(DVec3::new(toward.x, toward.y + 1e-7, 0.0).normalize());
        let at = light.clear_sky(toward);
        assert!((near.radiance - at.radiance).length() < 1e-5 * at.radiance.length());
        assert!(at.radiance.is_finite() && at.radiance.min_element() > 0.0);
    }
}
