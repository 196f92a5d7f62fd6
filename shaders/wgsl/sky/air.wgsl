#define_import_path skycell::air

// Air that scatters, aerosol and ozone around a sphere, after S. Hillaire (A Scalable and Production Ready Sky and
// Atmosphere Rendering Technique, 2020) and E. Bruneton (Precomputed Atmospheric Scattering, 2008 and 2017): what the
// passes that make its tables and the composite that reads them both need. Radiances are per unit of the sun's irradiance.

/// The medium, and where the tables of a view were made. Extinctions are at the ground, ozone's in its middle.
struct Air {
    rayleigh_per_m: vec3f,
    rayleigh_scale_m: f32,
    mie_scattering_per_m: vec3f,
    mie_scale_m: f32,
    mie_extinction_per_m: vec3f,
    mie_asymmetry: f32,
    ozone_per_m: vec3f,
    /// Altitude above which there is no air, m.
    top_m: f32,
    radius_m: f32,
    /// From where the tables look, m above the ground.
    altitude_m: f32,
    /// Cosine of the sun's zenith angle there.
    mu_sun: f32,
    /// Lowest cosine of the sun's zenith angle for which the higher orders are tabulated.
    mu_sun_lowest: f32,
    sun_angular_radius_rad: f32,
    /// Weight of the aerosol's phase in what divides the haze's radiance.
    haze_mie_weight: f32,
    /// First row that a pass makes.
    first_row: u32,
    /// Height over which what dims most falls to 1/e: sets how dense rows stand at the horizon.
    row_scale_m: f32,
}

const PI: f32 = 3.141592653589793;
const OZONE_MIDDLE_M: f32 = 25000.0;
const OZONE_HALF_WIDTH_M: f32 = 15000.0;

/// Texels of the sky's table: across by azimuth, first rows towards the sky, then towards the ground.
const VIEW_COLUMNS: u32 = 192u;
const VIEW_SKY_ROWS: u32 = 160u;
const VIEW_GROUND_ROWS: u32 = 96u;
/// Texels of the haze's tables, whose slices are distances. Mean extinction bends more than the source does, and has no
/// columns: it has more of them.
const HAZE_COLUMNS: u32 = 32u;
const HAZE_SKY_ROWS: u32 = 32u;
const HAZE_GROUND_ROWS: u32 = 24u;
const HAZE_SLICES: u32 = 31u;
const HAZE_EXTINCTION_SLICES: u32 = 61u;
/// Slices of the extinction for one of the source.
const HAZE_SLICES_APART: u32 = 2u;

/// Cosine of the zenith angle of the horizon. Below the ground's level the horizon is level.
fn mu_horizon(radius_m: f32, altitude_m: f32) -> f32 {
    let h = max(altitude_m, 0.0);
    return -sqrt(h * (h + 2.0 * radius_m)) / (radius_m + h);
}

/// The part of a ray that has air, m; empty where end <= start. A ray that ends on the ground ends where it comes
/// closest, should it miss by rounding.
struct AirPath {
    start_m: f32,
    end_m: f32,
    /// Where it is lowest.
    lowest_m: f32,
}

/// From an altitude in a direction with cosine mu of the zenith angle. The form of the roots is that of shell_roots.
fn air_path(radius_m: f32, top_m: f32, altitude_m: f32, mu: f32, on_ground: bool) -> AirPath {
    let b = (radius_m + altitude_m) * mu;
    let c_top = (altitude_m - top_m) * (altitude_m + top_m + 2.0 * radius_m);
    let disc_top = b * b - c_top;
    let root_top = sqrt(max(disc_top, 0.0));
    let q = select(-(b + root_top), root_top - b, b < 0.0);
    let other = select(0.0, c_top / q, q != 0.0);
    let start = max(min(q, other), 0.0);
    let far = max(q, other);
    // Downwards both roots of the ground are in front: the nearer is c / (√disc - b).
    let c_ground = altitude_m * (altitude_m + 2.0 * radius_m);
    let ground = max(c_ground, 0.0) / max(sqrt(max(b * b - c_ground, 0.0)) - b, 1e-3);
    let end = select(select(start, far, disc_top >= 0.0), max(ground, start), on_ground);
    return AirPath(start, end, clamp(-b, start, end));
}

/// Share of the angle in which air changes over which rows stand evenly. Tuned: tests/atmosphere, errors at the horizon.
const NEAR_SHARE: f32 = 0.15;
/// Least that is stored: tables hold logarithms.
const LEAST_STORED: f32 = 1e-30;

/// Nearest distance from which ground is told apart, m.
const GROUND_NEAREST_M: f32 = 0.1;

/// Elevations of the table's rows towards the sky, seen from within the air: with w the tangent of half the angle above
/// the horizon, rows stand evenly in ln(1 + w/near). Near the horizon what is seen changes over the angle in which a ray's
/// lowest place rises by a scale height; above it over a share of the elevation.
struct SkyRows {
    sine_dip: f32,
    cosine_dip: f32,
    near: f32,
    /// ln(1 + w/near) at the zenith.
    span: f32,
}

fn sky_rows(radius_m: f32, scale_m: f32, altitude_m: f32) -> SkyRows {
    let sine = -mu_horizon(radius_m, altitude_m);
    let cosine = radius_m / (radius_m + max(altitude_m, 0.0));
    // A lowest place rises by R sin(dip) an angle, and by R/2 of its square.
    let thinnest = 2.0 * scale_m / radius_m;
    let near = NEAR_SHARE * thinnest / (sine + sqrt(sine * sine + thinnest));
    // tan(45° + dip/2)
    let zenith = (1.0 + sine) / max(cosine, 1e-6);
    return SkyRows(sine, cosine, near, log(1.0 + zenith / near));
}

/// The elevation's place among the rows, 0 at the viewer's own horizon. From outside of the air, where only directions up
/// to the air's upper rim have any, it is the root of the lowest place's altitude as a share of the air's: rays that pass
/// the same air have the same row from wherever they come. Towards the ground a
/// cosine of it goes with the distance's logarithm in that of the horizon: dense there, and even in angle around the nadir.
fn elevation_place(medium: Air, altitude_m: f32, mu: f32, on_ground: bool) -> f32 {
    let radius_m = medium.radius_m;
    let top_m = medium.top_m;
    let from_centre = radius_m + altitude_m;
    let rows = sky_rows(radius_m, medium.row_scale_m, altitude_m);
    let level = sqrt(max(1.0 - mu * mu, 0.0));
    let sine = max(mu * rows.cosine_dip + level * rows.sine_dip, 0.0);
    let cosine = level * rows.cosine_dip - mu * rows.sine_dip;
    let inside = saturate(log(1.0 + sine / (max(1.0 + cosine, 1e-6) * rows.near)) / rows.span);
    // The lowest place of a ray from outside, without a difference of radii; upwards there is no air.
    let lowest_m = altitude_m - from_centre * mu * mu / (1.0 + level);
    let limb = sqrt(saturate(select(lowest_m / top_m, 1.0, mu > 0.0)));
    let h = max(altitude_m, GROUND_NEAREST_M);
    let c = h * (h + 2.0 * radius_m);
    let b = from_centre * mu;
    let ground_m = max(c / max(sqrt(max(b * b - c, 0.0)) - b, 1e-3), h);
    let share = saturate(log(ground_m / h) / (0.5 * log(c) - log(h)));
    let ground = acos(1.0 - 2.0 * share) / PI;
    return select(select(inside, limb, medium.altitude_m > top_m), ground, on_ground);
}

/// The inverse for the altitude of the tables: the cosine of the zenith angle.
fn mu_of_elevation(medium: Air, place: f32, on_ground: bool) -> f32 {
    let radius_m = medium.radius_m;
    let top_m = medium.top_m;
    let altitude_m = medium.altitude_m;
    let from_centre = radius_m + altitude_m;
    let horizon = mu_horizon(radius_m, altitude_m);
    let rows = sky_rows(radius_m, medium.row_scale_m, altitude_m);
    let w = rows.near * (exp(place * rows.span) - 1.0);
    let inside = (2.0 * w * rows.cosine_dip - (1.0 - w * w) * rows.sine_dip) / (1.0 + w * w);
    let lowest_m = top_m * place * place;
    let limb = -sqrt(max((altitude_m - lowest_m) * (altitude_m + lowest_m + 2.0 * radius_m), 0.0)) / from_centre;
    let sky = select(clamp(inside, horizon, 1.0), max(limb, horizon), altitude_m > top_m);
    let h = max(altitude_m, GROUND_NEAREST_M);
    let c = h * (h + 2.0 * radius_m);
    let ground_m = h * exp((0.5 - 0.5 * cos(PI * place)) * (0.5 * log(c) - log(h)));
    // Of the triangle with the planet's centre: (R + h)² + d² + 2 (R + h) d µ = R².
    let ground = clamp(-(c + ground_m * ground_m) / (2.0 * from_centre * ground_m), -1.0, horizon);
    return select(sky, ground, on_ground);
}

/// Azimuth from the sun's as sin(φ/2) / (sin(φ/2) + cos(φ/2)): what mirrors at the sun's azimuth and at the opposite one is
/// smooth in it, and it is dense at both.
fn azimuth_place(cos_azimuth: f32) -> f32 {
    let sine = sqrt(saturate(0.5 - 0.5 * cos_azimuth));
    let cosine = sqrt(saturate(0.5 + 0.5 * cos_azimuth));
    return sine / (sine + cosine);
}

fn cos_azimuth_of(place: f32) -> f32 {
    let sine = place * place;
    let cosine = (1.0 - place) * (1.0 - place);
    return (cosine - sine) / (cosine + sine);
}

/// Cosine of the azimuth from the sun's, from the cosines of the angles between direction, sun and zenith. At the zenith
/// it means nothing, and what is read there does not depend on it.
fn cos_azimuth(mu: f32, mu_sun: f32, nu: f32) -> f32 {
    let across = max((1.0 - mu * mu) * (1.0 - mu_sun * mu_sun), 1e-12);
    return clamp((nu - mu * mu_sun) * inverseSqrt(across), -1.0, 1.0);
}

/// Distance along the air of a path as a place 0…1: dense where air is, near the eye towards the sky, near the ground
/// towards the ground.
fn distance_place(share: f32, on_ground: bool) -> f32 {
    let near = sqrt(saturate(share));
    return select(near, 1.0 - sqrt(saturate(1.0 - share)), on_ground);
}

fn share_of_distance(place: f32, on_ground: bool) -> f32 {
    let rest = 1.0 - place;
    return select(place * place, 1.0 - rest * rest, on_ground);
}

/// Middle of a texel's row: sky and ground are kept apart, so that no read mixes them.
fn row_place(elevation: f32, sky_rows: u32, ground_rows: u32, on_ground: bool) -> f32 {
    let rows = f32(sky_rows + ground_rows);
    let sky = 0.5 + elevation * f32(sky_rows - 1u);
    let ground = f32(sky_rows) + 0.5 + elevation * f32(ground_rows - 1u);
    return select(sky, ground, on_ground) / rows;
}

fn texel_place(place: f32, texels: u32) -> f32 {
    return (0.5 + place * f32(texels - 1u)) / f32(texels);
}

/// Rayleigh's phase, 1/sr.
fn phase_rayleigh_per_sr(nu: f32) -> f32 {
    return 3.0 / (16.0 * PI) * (1.0 + nu * nu);
}
