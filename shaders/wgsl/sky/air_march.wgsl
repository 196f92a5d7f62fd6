#define_import_path skycell::air_march
#import skycell::air::{Air, PI, OZONE_MIDDLE_M, OZONE_HALF_WIDTH_M, mu_horizon}

// Marches through clear air for the passes that make its tables.

@group(0) @binding(0) var<uniform> air: Air;
/// Logarithm of the optical depth to the top of the air: across by direction, down by altitude.
@group(0) @binding(1) var depth_table: texture_2d<f32>;
/// Logarithm of the higher orders' radiance: across by the sun, down by altitude.
@group(0) @binding(2) var orders_table: texture_2d<f32>;
/// Radiance of the lit ground: across by the sun.
@group(0) @binding(3) var ground_table: texture_2d<f32>;
@group(0) @binding(4) var table_sampler: sampler;

struct Densities {
    rayleigh: f32,
    mie: f32,
    ozone: f32,
}

/// Air and aerosol fall off exponentially; ozone is a tent (Bruneton 2017).
fn densities(medium: Air, altitude_m: f32) -> Densities {
    return Densities(
        exp(-altitude_m / medium.rayleigh_scale_m),
        exp(-altitude_m / medium.mie_scale_m),
        max(1.0 - abs(altitude_m - OZONE_MIDDLE_M) / OZONE_HALF_WIDTH_M, 0.0),
    );
}

fn extinction_per_m(medium: Air, here: Densities) -> vec3f {
    return medium.rayleigh_per_m * here.rayleigh + medium.mie_extinction_per_m * here.mie + medium.ozone_per_m * here.ozone;
}

/// A place along a ray: its altitude, and the cosine of the sun's zenith angle there.
struct Place {
    altitude_m: f32,
    mu_sun: f32,
}

/// (R + a)² = (R + h)² + t² + 2 (R + h) t µ, solved for the altitude a without cancellation.
fn place_along(medium: Air, mu: f32, nu: f32, distance_m: f32) -> Place {
    let r = medium.radius_m;
    let h = medium.altitude_m;
    let excess = h * (h + 2.0 * r) + distance_m * (distance_m + 2.0 * (r + h) * mu);
    let radius = sqrt(max(r * r + excess, 1.0));
    let mu_sun = ((r + h) * medium.mu_sun + distance_m * nu) / radius;
    return Place(excess / (radius + r), clamp(mu_sun, -1.0, 1.0));
}

/// Cosines of the sun are dense around the horizon in the tables: by the root of what they are over the lowest or one.
fn sun_place(medium: Air, mu_sun: f32) -> f32 {
    let below = sqrt(saturate(mu_sun / medium.mu_sun_lowest));
    let above = sqrt(saturate(mu_sun));
    return 0.5 + 0.5 * select(above, -below, mu_sun < 0.0);
}

fn altitude_place(medium: Air, altitude_m: f32) -> f32 {
    return sqrt(saturate(altitude_m / medium.top_m));
}

fn table_place(place: vec2f, table: texture_2d<f32>) -> vec2f {
    let size = vec2f(textureDimensions(table));
    return (0.5 + place * (size - 1.0)) / size;
}

/// Share of the sun's light that reaches a place. In the table of optical depths, after Bruneton 2008, directions are
/// told apart by the distance to the top of the air and altitudes by that to the horizon. The share of the disc above the
/// horizon is a smooth step over its diameter.
fn sun_transmittance(medium: Air, place: Place) -> vec3f {
    let r = medium.radius_m;
    let h = clamp(place.altitude_m, 0.0, medium.top_m);
    let horizon = mu_horizon(r, place.altitude_m);
    let above = (place.mu_sun - horizon) * (r + h) / (r * medium.sun_angular_radius_rad);
    let visible = smoothstep(-1.0, 1.0, above);
    let mu = max(place.mu_sun, horizon);
    let to_horizon = sqrt(h * (h + 2.0 * r));
    let farthest = sqrt(medium.top_m * (medium.top_m + 2.0 * r));
    let b = (r + h) * mu;
    let c = (medium.top_m - h) * (medium.top_m + h + 2.0 * r);
    let root = sqrt(b * b + c);
    let to_top = select(root - b, c / max(root + b, 1e-3), b > 0.0);
    let least = medium.top_m - h;
    let direction = saturate((to_top - least) / max(to_horizon + farthest - least, 1e-3));
    let at = table_place(vec2f(direction, to_horizon / farthest), depth_table);
    let depth = textureSampleLevel(depth_table, table_sampler, at, 0.0).xyz;
    return visible * exp(-exp(depth) * denser_below(medium, place.altitude_m, mu));
}

/// How much more there is on the way to the sun from below the ground's level, where the tables end: each constituent's
/// column grows as its density. Columns along a slant: β H / √(µ² + 2 H / (π R)), the grazing one being β √(π R H / 2).
fn denser_below(medium: Air, altitude_m: f32, mu: f32) -> vec3f {
    let below = min(altitude_m, 0.0);
    let r = medium.rayleigh_scale_m;
    let m = medium.mie_scale_m;
    let slant = 2.0 / (PI * medium.radius_m);
    let air = medium.rayleigh_per_m * (r * inverseSqrt(mu * mu + slant * r));
    let aerosol = medium.mie_extinction_per_m * (m * inverseSqrt(mu * mu + slant * m));
    return (air * exp(-below / r) + aerosol * exp(-below / m) + vec3f(1e-20)) / (air + aerosol + vec3f(1e-20));
}

/// Radiance of the higher orders of scattering at a place, 1/sr.
fn higher_orders_per_sr(medium: Air, place: Place) -> vec3f {
    let at = table_place(vec2f(sun_place(medium, place.mu_sun), altitude_place(medium, place.altitude_m)), orders_table);
    return exp(textureSampleLevel(orders_table, table_sampler, at, 0.0).xyz);
}

/// Radiance of the lit ground where the sun's zenith angle has a cosine, 1/sr.
fn lit_ground_per_sr(medium: Air, mu_sun: f32) -> vec3f {
    let at = table_place(vec2f(sun_place(medium, mu_sun), 0.0), ground_table);
    return exp(textureSampleLevel(ground_table, table_sampler, at, 0.0).xyz);
}

/// Light on the way to the eye: what air (with the higher orders of both) and what aerosol without its phase scatter into
/// the ray, and the optical depth so far.
struct AirSum {
    air_per_sr: vec3f,
    mie: vec3f,
    depth: vec3f,
}

/// Where a walk stands: how its air and light are there.
struct Footing {
    /// Extinction by the colours, 1/m.
    extinction_per_m: vec3f,
    /// Height over which extinction changes by an e-fold, m.
    scale_m: f32,
    /// Altitude a metre along the ray, and how that grows.
    slope: f32,
    bend_per_m: f32,
    /// Logarithm of the sun's light, cut off where higher orders take over.
    sun_log: vec3f,
}

/// How much more aerosol scatters forwards than evenly, as far as steps are told by it.
const PEAK: f32 = 10.0;
/// Sunlight below this share is no longer resolved: the higher orders are more.
const SUN_LOG_LEAST: f32 = -7.0;

fn footing(medium: Air, mu: f32, nu: f32, distance_m: f32) -> Footing {
    let place = place_along(medium, mu, nu, distance_m);
    let here = densities(medium, place.altitude_m);
    let air = medium.rayleigh_per_m * here.rayleigh;
    let aerosol = PEAK * medium.mie_extinction_per_m * here.mie;
    let all = extinction_per_m(medium, here);
    let change = (air / medium.rayleigh_scale_m + aerosol / medium.mie_scale_m) / max(air + aerosol, vec3f(1e-30));
    let most = max(change.x, max(change.y, change.z));
    let radius = medium.radius_m + place.altitude_m;
    let slope = clamp(((medium.radius_m + medium.altitude_m) * mu + distance_m) / radius, -1.0, 1.0);
    let sun = max(log(max(sun_transmittance(medium, place), vec3f(1e-30))), vec3f(SUN_LOG_LEAST));
    let scale = 1.0 / max(most, 1.0 / max(medium.rayleigh_scale_m, medium.mie_scale_m));
    return Footing(all, scale, slope, 0.5 * (1.0 - slope * slope) / radius, sun);
}

/// Largest optical depth of a step where nothing is dimmed yet, and e-folds of depth over which it grows by one.
const STEP_DEPTH: f32 = 0.8;
const STEP_GROWTH: f32 = 0.25;
/// Largest change of altitude in a step, in scale heights.
const STEP_HEIGHTS: f32 = 1.0;
/// Largest e-folds of sunlight in a step.
const STEP_SUN: f32 = 1.5;
/// Longest step: air is thin there, and the light changes with the sun's height alone. In radii of the planet; around a
/// planet that is small for its air, whose paths are many radii long, a share of what is left, which bounds their number.
const STEP_RADII: f32 = 0.01;
const STEP_SHARE: f32 = 0.02;

/// How far a place's air lets a step go, m.
fn reach_m(medium: Air, at: Footing, depth: vec3f, rest_m: f32) -> f32 {
    let allowed = STEP_DEPTH * exp(STEP_GROWTH * min(depth, vec3f(40.0))) / max(at.extinction_per_m, vec3f(1e-20));
    // |slope| t + bend t² = height
    let height = STEP_HEIGHTS * at.scale_m;
    let slope = abs(at.slope);
    let climb = 2.0 * height / (slope + sqrt(slope * slope + 4.0 * at.bend_per_m * height));
    return min(min(allowed.x, min(allowed.y, allowed.z)), min(climb, max(STEP_RADII * medium.radius_m, STEP_SHARE * rest_m)));
}

/// Length of the next step of a walk that stands at a distance: as far as the air and the sun's light, here and where it
/// would end, change little.
fn step_m(medium: Air, mu: f32, nu: f32, distance_m: f32, rest_m: f32, depth: vec3f) -> f32 {
    let here = footing(medium, mu, nu, distance_m);
    let far = min(reach_m(medium, here, depth, rest_m), rest_m);
    let there = footing(medium, mu, nu, distance_m + far);
    let near = min(far, max(reach_m(medium, there, depth, rest_m), 0.125 * far));
    let change = abs(there.sun_log - here.sun_log);
    let most = max(change.x, max(change.y, change.z));
    return max(near / max(most / STEP_SUN, 1.0), 1e-4 * rest_m);
}

/// Adds an interval of a ray by the two points of Gauss and Legendre's rule, depths between them by the parabola whose
/// slopes are the extinctions there.
fn add_interval(sum: AirSum, medium: Air, mu: f32, nu: f32, rayleigh_per_sr: f32, start_m: f32, length_m: f32) -> AirSum {
    let near_place = place_along(medium, mu, nu, start_m + NEAR_POINT * length_m);
    let far_place = place_along(medium, mu, nu, start_m + (1.0 - NEAR_POINT) * length_m);
    let near = densities(medium, near_place.altitude_m);
    let far = densities(medium, far_place.altitude_m);
    let near_extinction = extinction_per_m(medium, near);
    let far_extinction = extinction_per_m(medium, far);
    let all = 0.5 * length_m * (near_extinction + far_extinction);
    // The chord between the points goes 0.5 NEAR_POINT / (1 - 2 NEAR_POINT) of its change beyond them.
    let beyond = 0.1830127 * (far_extinction - near_extinction);
    let to_near = max(NEAR_POINT * length_m * (near_extinction - beyond), vec3f(0.0));
    let from_far = max(NEAR_POINT * length_m * (far_extinction + beyond), vec3f(0.0));
    let near_kept = exp(-(sum.depth + to_near)) * (0.5 * length_m);
    let far_kept = exp(-(sum.depth + max(all - from_far, vec3f(0.0)))) * (0.5 * length_m);
    let near_light = scattered(medium, near_place, near, rayleigh_per_sr);
    let far_light = scattered(medium, far_place, far, rayleigh_per_sr);
    return AirSum(
        sum.air_per_sr + near_kept * near_light.air + far_kept * far_light.air,
        sum.mie + near_kept * near_light.mie + far_kept * far_light.mie,
        sum.depth + all,
    );
}

/// First point of the rule on 0…1: (1 - 1/√3) / 2.
const NEAR_POINT: f32 = 0.21132487;

struct Scattered {
    /// By air with its phase, and all higher orders, 1/(m sr).
    air: vec3f,
    /// By aerosol without its phase, 1/m.
    mie: vec3f,
}

/// Light that a place scatters into a ray.
fn scattered(medium: Air, place: Place, here: Densities, rayleigh_per_sr: f32) -> Scattered {
    let sun = sun_transmittance(medium, place);
    let higher = higher_orders_per_sr(medium, place);
    let rayleigh = medium.rayleigh_per_m * here.rayleigh;
    let mie = medium.mie_scattering_per_m * here.mie;
    return Scattered(rayleigh * rayleigh_per_sr * sun + (rayleigh + mie) * higher, mie * sun);
}
