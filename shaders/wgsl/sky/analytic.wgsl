#define_import_path skycell::sky
#import skycell::scene::{Planet, Sky, Sun}
#import skycell::phase::{phase_hg_per_sr, one_minus_mu}
#import skycell::transport::one_minus_exp_over

// A plain sky without tables: single scattering in a homogeneous shell of air and one of aerosol, plus an isotropic
// estimate of the higher orders. Its place is taken by precomputed tables where a scene asks for them.

const RAYLEIGH_SCALE_HEIGHT_M: f32 = 8000.0;
const AEROSOL_SCALE_HEIGHT_M: f32 = 1200.0;
const RAYLEIGH_PHASE_FACTOR: f32 = 0.05968310365946075; // 3 / (16 π)
const ISOTROPIC_PER_SR: f32 = 0.07957747154594767; // 1 / (4 π)

/// Length of a slanted path through a shell of height H around a planet of radius R, in units of H; mu: cosine of the
/// zenith angle, clamped to the horizon. sqrt((r µ)² + 2 r + 1) - r µ with r = R/H, without cancellation.
fn relative_air_mass(planet_radius_m: f32, scale_height_m: f32, mu: f32) -> f32 {
    let r = planet_radius_m / scale_height_m;
    let along = r * max(mu, 0.0);
    return (2.0 * r + 1.0) / (sqrt(along * along + 2.0 * r + 1.0) + along);
}

/// Optical depth of the whole atmosphere along a direction, per channel.
fn column_optical_depth(planet: Planet, sky: Sky, mu: f32) -> vec3f {
    return sky.rayleigh_optical_depth * relative_air_mass(planet.radius_m, RAYLEIGH_SCALE_HEIGHT_M, mu)
        + sky.aerosol_optical_depth * relative_air_mass(planet.radius_m, AEROSOL_SCALE_HEIGHT_M, mu);
}

/// Radiance of the cloudless sky towards a direction at or above the horizon, without the sun's disc.
/// Single scattering of a slab: E P X_v e^(-min) (1 - e^(-|X_s - X_v|)) / |X_s - X_v|, X the optical depths towards the
/// viewer and the sun.
fn sky_radiance(planet: Planet, sky: Sky, sun: Sun, direction: vec3f) -> vec3f {
    let mu = max(direction.y, 0.0);
    let rayleigh = sky.rayleigh_optical_depth * relative_air_mass(planet.radius_m, RAYLEIGH_SCALE_HEIGHT_M, mu);
    let aerosol = sky.aerosol_optical_depth * relative_air_mass(planet.radius_m, AEROSOL_SCALE_HEIGHT_M, mu);
    let view_depth = rayleigh + aerosol;
    let sun_depth = column_optical_depth(planet, sky, sun.direction.y);
    let angle = one_minus_mu(direction, sun.direction);
    let mu_sun_view = 1.0 - angle;
    let scattered = rayleigh * (RAYLEIGH_PHASE_FACTOR * (1.0 + mu_sun_view * mu_sun_view))
        + aerosol * phase_hg_per_sr(sky.aerosol_asymmetry, angle);
    let difference = abs(sun_depth - view_depth);
    let slab = exp(-min(sun_depth, view_depth))
        * vec3f(one_minus_exp_over(difference.x), one_minus_exp_over(difference.y), one_minus_exp_over(difference.z));
    // Higher orders: what the column takes out of the beam comes back evenly. The factor is tuned: it brings the horizon
    // to about four times the zenith, as in photographs of clear skies.
    let diffuse = 1.5 * (vec3f(1.0) - exp(-view_depth)) * (vec3f(1.0) - exp(-0.5 * sun_depth)) * exp(-0.25 * sun_depth);
    let lit = smoothstep(-0.1, 0.05, sun.direction.y);
    return lit * sun.irradiance * (scattered * slab + ISOTROPIC_PER_SR * diffuse);
}

/// Optical depth of the air between the ground and a point at a distance and altitude.
fn path_optical_depth(sky: Sky, distance_m: f32, altitude_m: f32) -> vec3f {
    let height = max(altitude_m, 0.0);
    let rayleigh = sky.rayleigh_optical_depth * (distance_m / RAYLEIGH_SCALE_HEIGHT_M * one_minus_exp_over(height / RAYLEIGH_SCALE_HEIGHT_M));
    let aerosol = sky.aerosol_optical_depth * (distance_m / AEROSOL_SCALE_HEIGHT_M * one_minus_exp_over(height / AEROSOL_SCALE_HEIGHT_M));
    return rayleigh + aerosol;
}

/// Radiance of the sun's disc times how much of it a direction sees, before the atmosphere dims it.
fn sun_disc_radiance(sun: Sun, direction: vec3f) -> vec3f {
    let angle = one_minus_mu(direction, sun.direction);
    let inside = 1.0 - smoothstep(0.85 * sun.one_minus_mu_disc, 1.15 * sun.one_minus_mu_disc, angle);
    // Solid angle of the disc: 2π (1 - cos r).
    return inside * sun.irradiance / (6.283185307179586 * sun.one_minus_mu_disc);
}
