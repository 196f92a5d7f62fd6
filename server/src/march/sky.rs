//! Light that is the same for a whole cell, computed in f64 when the scene changes: what reaches the clouds from the
//! sun, the sky above and the ground. The sky's formulas are those of `sky/analytic.wgsl`.

use crate::atmosphere::{AirLight, BaseTables};
use glam::DVec3;
use skycell_protocol::Scene;
use skycell_protocol::scene::Atmosphere;
use std::f64::consts::{FRAC_1_PI, PI};
use std::sync::Arc;

/// Rayleigh scattering at sea level at 680, 550 and 440 nm: 1.24062e-6 / λ⁴ per metre, λ in µm (the constant of
/// E. Bruneton's precomputed atmospheric scattering, 2017), times the scale height of 8 km.
const RAYLEIGH_OPTICAL_DEPTH: [f64; 3] = [0.046_418, 0.108_463, 0.264_804];
/// Scale heights of air and aerosol.
const SCALE_HEIGHTS_M: [f64; 2] = [8_000.0, 1_200.0];
/// Mean cosine of continental aerosol.
const AEROSOL_ASYMMETRY: f64 = 0.76;
/// What the higher orders of scattering add: what the beam loses comes back evenly. Tuned: brings the horizon to about
/// four times the zenith, as in photographs of clear skies.
const DIFFUSE_FACTOR: f64 = 1.5;
/// Angular radius of the sun as seen from the earth.
const SUN_ANGULAR_RADIUS_DEG: f64 = 0.2666;

/// The night sky's own light, airglow above all, W/(m² nm sr): 21.6 magnitudes per square arcsecond, a dark site without
/// moon (F. Patat 2003), are 2.5e-4 cd/m², and 683 lm/W over the eye's 107 nm make radiance of it.
/// Its colour is tuned: about neutral beside sunlight.
const AIRGLOW_RADIANCE: DVec3 = DVec3::new(2.8e-9, 3.4e-9, 3.9e-9);

/// Light from outside the clouds.
#[derive(Clone, Debug)]
pub struct SkyLight {
    /// Tables of the air, where it is no closed formula.
    air: Option<Arc<BaseTables>>,
    /// Unit vector towards the sun, or towards the moon where it gives more light.
    pub sun_direction: DVec3,
    /// Whether it is the moon.
    pub is_moon: bool,
    /// Angular radius of the sun, rad.
    pub sun_angular_radius_rad: f64,
    /// Spectral irradiance above the atmosphere.
    pub sun_irradiance: DVec3,
    /// Spectral irradiance at cloud height, facing the sun.
    pub irradiance_at_clouds: DVec3,
    /// Optical depth of the air straight up.
    pub rayleigh_optical_depth: DVec3,
    /// Optical depth of the aerosol straight up.
    pub aerosol_optical_depth: f64,
    /// Asymmetry of the aerosol.
    pub aerosol_asymmetry: f64,
    /// Mean radiance of the sky above.
    pub mean_radiance: DVec3,
    /// Radiance of the lit ground.
    pub ground_radiance: DVec3,
    /// How much of the sun's light the sky still has: 1 by day, 0 at night.
    pub lit: f64,
    /// Optical depth of the whole column towards the sun.
    pub sun_column: DVec3,
    /// e to its negative.
    pub sun_column_kept: DVec3,
    /// Higher orders of scattering per unit of what the column towards the viewer takes out, 1/sr.
    pub diffuse_per_sr: DVec3,
    /// Radiance from every direction beside that of the air.
    pub environment_radiance: DVec3,
}

fn exp(v: DVec3) -> DVec3 {
    DVec3::new(v.x.exp(), v.y.exp(), v.z.exp())
}

fn one_minus_exp_over(x: f64) -> f64 {
    if x < 1e-12 { 1.0 } else { -(-x).exp_m1() / x }
}

fn phase_hg_per_sr(g: f64, one_minus_mu: f64) -> f64 {
    let base = (1.0 - g).powi(2) + 2.0 * g * one_minus_mu;
    (1.0 - g * g) / (4.0 * PI * base.powf(1.5))
}

/// Path through a shell of height H in units of H.
fn relative_air_mass(planet_radius_m: f64, scale_height_m: f64, mu: f64) -> f64 {
    let r = planet_radius_m / scale_height_m;
    let along = r * mu.max(0.0);
    (2.0 * r + 1.0) / ((along * along + 2.0 * r + 1.0).sqrt() + along)
}

impl SkyLight {
    fn column(&self, planet_radius_m: f64, mu: f64) -> (DVec3, f64) {
        (
            self.rayleigh_optical_depth
                * relative_air_mass(planet_radius_m, SCALE_HEIGHTS_M[0], mu),
            self.aerosol_optical_depth * relative_air_mass(planet_radius_m, SCALE_HEIGHTS_M[1], mu),
        )
    }

    /// Radiance of the cloudless sky towards a direction at or above the horizon.
    fn radiance(&self, planet_radius_m: f64, direction: DVec3) -> DVec3 {
        let (rayleigh, aerosol) = self.column(planet_radius_m, direction.y);
        let view_depth = rayleigh + aerosol;
        let sun_depth = self.sun_column;
        let angle = 0.5 * (direction - self.sun_direction).length_squared();
        let mu = 1.0 - angle;
        let scattered = rayleigh * (3.0 / (16.0 * PI) * (1.0 + mu * mu))
            + aerosol * phase_hg_per_sr(self.aerosol_asymmetry, angle);
        let difference = (sun_depth - view_depth).abs();
        let slab = exp(-sun_depth.min(view_depth))
            * DVec3::from_array(difference.to_array().map(one_minus_exp_over));
        let diffuse = (DVec3::ONE - exp(-view_depth)) * self.diffuse_per_sr;
        self.environment_radiance + self.lit * self.sun_irradiance * (scattered * slab + diffuse)
    }
}

impl SkyLight {
    /// Tables of the air, where it is no closed formula.
    #[must_use]
    pub fn air(&self) -> Option<&BaseTables> {
        self.air.as_deref()
    }

    /// Mean extinction of the air between the ground and an altitude, 1/m.
    #[must_use]
    pub fn air_extinction_per_m(&self, altitude_m: f64) -> DVec3 {
        let mean = |scale_m: f64| one_minus_exp_over(altitude_m.max(0.0) / scale_m) / scale_m;
        self.rayleigh_optical_depth * mean(SCALE_HEIGHTS_M[0])
            + self.aerosol_optical_depth * mean(SCALE_HEIGHTS_M[1])
    }
}

/// Angular radius of the sun, rad.
#[must_use]
pub fn sun_angular_radius_rad() -> f64 {
    SUN_ANGULAR_RADIUS_DEG.to_radians()
}

/// Evaluates the light of a scene for clouds around an altitude. `air`: the tables of its air, where it has such.
#[must_use]
pub fn sky_light(scene: &Scene, air: Option<&Arc<BaseTables>>, cloud_altitude_m: f64) -> SkyLight {
    let irradiance = DVec3::from_array(scene.sun().irradiance_w_per_m2_nm());
    let of = |direction, irradiance, is_moon| {
        light_of(scene, air, cloud_altitude_m, direction, irradiance, is_moon)
    };
    let sun = of(scene.sun().direction(), irradiance, false);
    let Some(moon) = scene.moon() else {
        return sun;
    };
    let moonlit = of(
        moon.direction(),
        irradiance * moon.share_of_sunlight(),
        true,
    );
    // One light at a time: where the moon's is more, the other adds little to it.
    let total = |light: &SkyLight| {
        (light.irradiance_at_clouds + PI * (light.mean_radiance - light.environment_radiance))
            .element_sum()
    };
    if total(&moonlit) > total(&sun) {
        moonlit
    } else {
        sun
    }
}

fn light_of(
    scene: &Scene,
    air: Option<&Arc<BaseTables>>,
    cloud_altitude_m: f64,
    sun_direction: DVec3,
    sun_irradiance: DVec3,
    is_moon: bool,
) -> SkyLight {
    let radius_m = scene.planet().radius_m();
    let (rayleigh_optical_depth, aerosol_optical_depth, environment_radiance) =
        match scene.atmosphere() {
            Atmosphere::Analytic(sky) => (
                DVec3::from_array(RAYLEIGH_OPTICAL_DEPTH),
                sky.aerosol_optical_depth(),
                DVec3::ZERO,
            ),
            // Of a flat world, which has no such air.
            Atmosphere::Physical(sky) => (
                DVec3::from_array(RAYLEIGH_OPTICAL_DEPTH),
                sky.aerosol_optical_depth(),
                DVec3::ZERO,
            ),
            Atmosphere::Uniform(sky) => (
                DVec3::ZERO,
                0.0,
                DVec3::from_array(sky.radiance_w_per_m2_nm_sr()),
            ),
        };
    let mut light = SkyLight {
        air: air.cloned(),
        sun_direction,
        is_moon,
        sun_angular_radius_rad: SUN_ANGULAR_RADIUS_DEG.to_radians(),
        sun_irradiance,
        irradiance_at_clouds: DVec3::ZERO,
        rayleigh_optical_depth,
        aerosol_optical_depth,
        aerosol_asymmetry: AEROSOL_ASYMMETRY,
        mean_radiance: DVec3::ZERO,
        ground_radiance: DVec3::ZERO,
        lit: 0.0,
        sun_column: DVec3::ZERO,
        sun_column_kept: DVec3::ZERO,
        diffuse_per_sr: DVec3::ZERO,
        environment_radiance,
    };
    let mu_sun = light.sun_direction.y;
    if let Some(tables) = air {
        let air = AirLight::new(tables, cloud_altitude_m, mu_sun);
        light.irradiance_at_clouds = light.sun_irradiance * air.sun_at_clouds;
        light.environment_radiance = AIRGLOW_RADIANCE;
        light.mean_radiance =
            light.environment_radiance + light.sun_irradiance * air.sky_mean_per_sr;
        light.ground_radiance = light.sun_irradiance * air.ground_per_sr;
        return light;
    }
    let (rayleigh, aerosol) = light.column(radius_m, mu_sun);
    light.sun_column = rayleigh + aerosol;
    light.sun_column_kept = exp(-light.sun_column);
    let t = ((mu_sun + 0.1) / 0.15).clamp(0.0, 1.0);
    light.lit = t * t * (3.0 - 2.0 * t);
    light.diffuse_per_sr = DIFFUSE_FACTOR / (4.0 * PI)
        * (DVec3::ONE - exp(-0.5 * light.sun_column))
        * exp(-0.25 * light.sun_column);
    let share_above = |scale: f64| (-cloud_altitude_m.max(0.0) / scale).exp();
    let above_clouds =
        rayleigh * share_above(SCALE_HEIGHTS_M[0]) + aerosol * share_above(SCALE_HEIGHTS_M[1]);
    // Clouds see the sun until it is a disc's radius under their own, lower horizon.
    let visible = |altitude_m: f64| {
        if scene.planet().is_flat() {
            return 1.0;
        }
        let dip_rad = (radius_m / (radius_m + altitude_m.max(0.0))).acos();
        let elevation_rad = mu_sun.clamp(-1.0, 1.0).asin();
        let t = (elevation_rad + dip_rad) / (2.0 * light.sun_angular_radius_rad) + 0.5;
        let t = t.clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    light.irradiance_at_clouds =
        light.sun_irradiance * exp(-above_clouds) * visible(cloud_altitude_m);
    light.mean_radiance = hemisphere_mean(|direction| light.radiance(radius_m, direction));
    let at_ground = light.sun_irradiance * light.sun_column_kept * visible(0.0);
    let ground_irradiance = at_ground * mu_sun.max(0.0) + PI * light.mean_radiance;
    light.ground_radiance = if scene.planet().is_flat() {
        // Nothing lies below: what clouds get from there is sky.
        light.mean_radiance
    } else {
        scene.planet().ground_albedo() * FRAC_1_PI * ground_irradiance
    };
    light
}

/// Mean over the upper hemisphere, rings of equal solid angle.
fn hemisphere_mean(radiance: impl Fn(DVec3) -> DVec3) -> DVec3 {
    const RINGS: u32 = 16;
    const SECTORS: u32 = 32;
    let mut sum = DVec3::ZERO;
    for ring in 0..RINGS {
        let y = (f64::from(ring) + 0.5) / f64::from(RINGS);
        let across = (1.0 - y * y).sqrt();
        for sector in 0..SECTORS {
            let angle = 2.0 * PI * (f64::from(sector) + 0.5) / f64::from(SECTORS);
            sum += radiance(DVec3::new(across * angle.cos(), y, across * angle.sin()));
        }
    }
    sum / f64::from(RINGS * SECTORS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn light_at(elevation_deg: f64) -> SkyLight {
        let document = json!({"version": 1, "sun": {"elevation_deg": elevation_deg}});
        sky_light(&Scene::from_json(&document).expect("valid"), None, 2_000.0)
    }

    #[test]
    fn light_is_finite_and_never_negative_at_any_sun() {
        for elevation in [-90.0, -10.0, -1.0, 0.0, 0.1, 5.0, 45.0, 90.0] {
            let light = light_at(elevation);
            for value in [
                light.irradiance_at_clouds,
                light.mean_radiance,
                light.ground_radiance,
            ] {
                assert!(
                    value.is_finite() && value.min_element() >= 0.0,
                    "{elevation}: {value}"
                );
            }
        }
    }

    #[test]
    fn sunlight_reddens_towards_the_horizon_and_the_noon_sky_is_blue() {
        let ratio = |l: &SkyLight| l.irradiance_at_clouds.x / l.irradiance_at_clouds.z;
        assert!(ratio(&light_at(2.0)) > 2.0 * ratio(&light_at(60.0)));
        let noon = light_at(60.0).mean_radiance;
        assert!(noon.z > 1.5 * noon.x);
    }

    #[test]
    fn at_night_nothing_is_lit() {
        let light = light_at(-20.0);
        assert_eq!(light.irradiance_at_clouds, DVec3::ZERO);
        assert_eq!(light.ground_radiance, DVec3::ZERO);
    }
}
