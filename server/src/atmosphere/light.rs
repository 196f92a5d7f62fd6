//! The light of one position of the sun.

use super::BaseTables;
use glam::DVec3;

/// Light on clouds around an altitude and on the ground, per unit of the sun's irradiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AirLight {
    /// Of the sun at the clouds, on a surface that faces it.
    pub sun_at_clouds: DVec3,
    /// Mean radiance of the sky above them, 1/sr.
    pub sky_mean_per_sr: DVec3,
    /// Radiance of the lit ground, 1/sr.
    pub ground_per_sr: DVec3,
}

impl AirLight {
    /// For a cosine of the sun's zenith angle.
    #[must_use]
    pub fn new(tables: &BaseTables, cloud_altitude_m: f64, mu_sun: f64) -> Self {
        Self {
            sun_at_clouds: tables.sun_transmittance(cloud_altitude_m, mu_sun),
            sky_mean_per_sr: tables.upper_mean_per_sr(cloud_altitude_m, mu_sun),
            ground_per_sr: tables.ground_per_sr(mu_sun),
        }
    }
}
