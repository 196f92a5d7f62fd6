//! Moon and stars as the shaders read them.

use super::SkyLight;
use glam::DVec3;
use skycell_protocol::Scene;
use skycell_protocol::scene::Moon;
use skycell_shaders::layout;
use std::f64::consts::PI;

/// Uniforms of the moon and the stars of a scene; what it lacks stays 0.
pub(super) fn night_uniform(scene: &Scene, light: &SkyLight) -> layout::Night {
    let f32s = |v: DVec3| v.as_vec3().to_array();
    let mut night = layout::Night {
        sun_disc: f32::from(u8::from(!light.is_moon)),
        ..Default::default()
    };
    if let Some(moon) = scene.moon() {
        let direction = moon.direction();
        let to_sun = moon_to_sun(moon, scene.sun().direction());
        let radius_rad = Moon::ANGULAR_RADIUS_DEG.to_radians();
        let one_minus_mu = 2.0 * (0.5 * radius_rad).sin().powi(2);
        let sunlight = DVec3::from_array(scene.sun().irradiance_w_per_m2_nm());
        let mean = disc_mean(moon.phase_angle_deg().to_radians());
        let radiance = sunlight * moon.share_of_sunlight() / (2.0 * PI * one_minus_mu);
        night.moon_direction = f32s(direction);
        night.moon_one_minus_mu_disc = one_minus_mu as f32;
        // A new moon shows no surface that the sun lights.
        night.moon_radiance = f32s(if mean > 1e-4 {
            radiance / mean
        } else {
            DVec3::ZERO
        });
        night.moon_to_sun = f32s(to_sun);
    }
    if let Some(stars) = scene.stars() {
        let rows = stars.field_from_world().transpose();
        night.star_brightness = stars.brightness() as f32;
        night.star_x = f32s(rows.x_axis);
        night.star_y = f32s(rows.y_axis);
        night.star_z = f32s(rows.z_axis);
    }
    night
}

/// Towards the sun from the moon: away from the viewer's line by the phase angle, to where the sun stands in the sky.
fn moon_to_sun(moon: &Moon, sun: DVec3) -> DVec3 {
    let direction = moon.direction();
    let aside = sun - direction * sun.dot(direction);
    let aside = aside.normalize_or(direction.any_orthonormal_vector());
    let phase = moon.phase_angle_deg().abs().to_radians();
    phase.cos() * -direction + phase.sin() * aside
}

/// Mean over the disc of µ_i / (µ_i + µ_e), the law of Lommel and Seeliger, at a phase angle.
fn disc_mean(phase_rad: f64) -> f64 {
    const RINGS: u32 = 48;
    const SECTORS: u32 = 96;
    let mut sum = 0.0;
    for ring in 0..RINGS {
        // Rings of equal area.
        let square = (f64::from(ring) + 0.5) / f64::from(RINGS);
        let (radius, mu_view) = (square.sqrt(), (1.0 - square).sqrt());
        for sector in 0..SECTORS {
            let angle = 2.0 * PI * (f64::from(sector) + 0.5) / f64::from(SECTORS);
            let mu_sun = radius * angle.cos() * phase_rad.sin() + mu_view * phase_rad.cos();
            let mu_sun = mu_sun.max(0.0);
            sum += mu_sun / (mu_sun + mu_view);
        }
    }
    sum / f64::from(RINGS * SECTORS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_full_disc_is_even_and_a_half_moon_shows_less_than_half_of_it() {
        assert!((disc_mean(0.0) - 0.5).abs() < 1e-12);
        // In closed form (1 - sin(a/2) tan(a/2) ln cot(a/4)) / 2 for the mean of this law over the disc.
        for degrees in [30.0f64, 90.0, 150.0] {
            let a = degrees.to_radians();
            let closed =
                0.5 * (1.0 - (0.5 * a).sin() * (0.5 * a).tan() * (1.0 / (0.25 * a).tan()).ln());
            assert!((disc_mean(a) - closed).abs() < 2e-3, "{degrees}: {closed}");
        }
    }
}
