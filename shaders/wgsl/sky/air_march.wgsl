#define_import_path skycell::air_march
#import skycell::air::{Air, PI, OZONE_MIDDLE_M, OZONE_HALF_WIDTH_M, mu_horizon}

// Marches through clear air for the passes that make its tables.

@group(0) @binding(0) var<uniform> air: Air;
/// Optical depth to the top of the air: across by direction, down by altitude.
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
    return visible * exp(-depth);
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

/// Adds an interval of a ray, its light that of its middle, where half of its own depth is in front; the mean over the
/// interval is kept by (1 - e^-x)/x.
fn add_interval(sum: AirSum, medium: Air, mu: f32, nu: f32, rayleigh_per_sr: f32, middle_m: f32, length_m: f32) -> AirSum {
    let place = place_along(medium, mu, nu, middle_m);
    let here = densities(medium, place.altitude_m);
    let depth = extinction_per_m(medium, here) * length_m;
    let sun = sun_transmittance(medium, place);
    let higher = higher_orders_per_sr(medium, place);
    let rayleigh = medium.rayleigh_per_m * here.rayleigh;
    let mie = medium.mie_scattering_per_m * here.mie;
    // Below 1e-2 by the first terms of the series.
    let series = 1.0 - depth * (0.5 - depth * (1.0 / 6.0));
    let mean = select((1.0 - exp(-depth)) / max(depth, vec3f(1e-20)), series, depth < vec3f(1e-2));
    let seen = exp(-sum.depth) * mean * length_m;
    return AirSum(
        sum.air_per_sr + seen * (rayleigh * rayleigh_per_sr * sun + (rayleigh + mie) * higher),
        sum.mie + seen * mie * sun,
        sum.depth + depth,
    );
}
