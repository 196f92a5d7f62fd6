#define_import_path skycell::sky
#import skycell::scene::{Planet, Sky, Sun}
#import skycell::phase::phase_hg_per_sr

// A plain sky without tables: single scattering in a homogeneous shell of air and one of aerosol, plus an isotropic
// estimate of the higher orders. Its place is taken by precomputed tables where a scene asks for them.

const RAYLEIGH_SCALE_HEIGHT_M: f32 = 8000.0;
const AEROSOL_SCALE_HEIGHT_M: f32 = 1200.0;
const RAYLEIGH_PHASE_FACTOR: f32 = 0.05968310365946075; // 3 / (16 π)

/// Length of a slanted path through a shell of height H around a planet of radius R, in units of H; mu: cosine of the
/// zenith angle, clamped to the horizon. sqrt((r µ)² + 2 r + 1) - r µ with r = R/H, without cancellation.
fn relative_air_mass(planet_radius_m: f32, scale_height_m: f32, mu: f32) -> f32 {
    let r = planet_radius_m / scale_height_m;
    let along = r * max(mu, 0.0);
    return (2.0 * r + 1.0) / (sqrt(along * along + 2.0 * r + 1.0) + along);
}

/// Clear air along a direction.
struct ClearSky {
    /// Without the sun's disc.
    radiance: vec3f,
    /// Of the whole column.
    transmittance: vec3f,
}

/// The cloudless sky towards a direction at or above the horizon; angle: 1 - cos of the angle to the sun.
/// Single scattering of a slab: E P X_v (e^(-X_v) - e^(-X_s)) / (X_s - X_v), X the optical depths towards the viewer and
/// the sun; where they are within 0.02 of each other by the first terms of its series.
fn clear_sky(planet: Planet, sky: Sky, sun: Sun, direction: vec3f, angle: f32) -> ClearSky {
    let rayleigh = sky.rayleigh_optical_depth * relative_air_mass(planet.radius_m, RAYLEIGH_SCALE_HEIGHT_M, direction.y);
    let aerosol = sky.aerosol_optical_depth * relative_air_mass(planet.radius_m, AEROSOL_SCALE_HEIGHT_M, direction.y);
    let view_depth = rayleigh + aerosol;
    let kept = exp(-view_depth);
    let mu_sun_view = 1.0 - angle;
    let scattered = rayleigh * (RAYLEIGH_PHASE_FACTOR * (1.0 + mu_sun_view * mu_sun_view))
        + aerosol * phase_hg_per_sr(sky.aerosol_asymmetry, angle);
    let difference = sky.sun_column - view_depth;
    let near = abs(difference) < vec3f(0.02);
    let series = sky.sun_column_kept * (1.0 + difference * (0.5 + difference * (1.0 / 6.0)));
    let slab = select((kept - sky.sun_column_kept) / select(difference, vec3f(1.0), near), series, near);
    // Higher orders: what the column takes out of the beam comes back evenly. The factor is tuned: it brings the horizon
    // to about four times the zenith, as in photographs of clear skies.
    let diffuse = (vec3f(1.0) - kept) * sky.diffuse_per_sr;
    return ClearSky(sky.environment_radiance + sky.lit * sun.irradiance * (scattered * slab + diffuse), kept);
}

/// The sun's limb darkening: radiance over its mean as a polynomial in µ, the cosine at which the disc's surface is seen.
/// Least-squares fit over the disc (1 % rms) of µ^α with α = -0.023 + 0.292 / λ, λ in µm (Hestroffer & Magnan 1998), so
/// that the disc with its soft rim gives the sun's irradiance.
const LIMB_CONSTANT: vec3f = vec3f(0.380422, 0.2804915, 0.1747753);
const LIMB_LINEAR: vec3f = vec3f(1.3026393, 1.4478985, 1.5582438);
const LIMB_SQUARE: vec3f = vec3f(-0.4853348, -0.4776354, -0.4120427);

/// Radiance of the sun's disc times how much of it a direction sees, before the atmosphere dims it.
fn sun_disc_radiance(sun: Sun, angle: f32) -> vec3f {
    let inside = 1.0 - smoothstep(0.85 * sun.one_minus_mu_disc, 1.15 * sun.one_minus_mu_disc, angle);
    let mu_square = max(1.0 - angle / sun.one_minus_mu_disc, 0.0);
    let limb = LIMB_CONSTANT + LIMB_LINEAR * sqrt(mu_square) + LIMB_SQUARE * mu_square;
    // Solid angle of the disc: 2π (1 - cos r).
    return inside * limb * sun.irradiance / (6.283185307179586 * sun.one_minus_mu_disc);
}
