// The sky as it is seen from one altitude: one invocation a direction. Sky and ground are rows of one table.
#import skycell::air::{VIEW_COLUMNS, VIEW_SKY_ROWS, VIEW_GROUND_ROWS, LEAST_STORED, air_path, mu_of_elevation, cos_azimuth_of, phase_rayleigh_per_sr}
#import skycell::air_march::{air, AirSum, add_interval, step_m, place_along, lit_ground_per_sr}

/// Logarithms, which change evenly over dusk and limb, of means along a path towards the sky. What air scatters once and all more than once, with phase, and what of the ground comes through.
@group(1) @binding(0) var air_out: texture_storage_2d<rgba32float, write>;
/// What aerosol scatters once, without its phase.
@group(1) @binding(1) var mie_out: texture_storage_2d<rgba32float, write>;

/// Steps of a path at most; the last takes what is left.
const STEPS_MAX: u32 = 256u;
/// Optical depth behind which nothing is seen.
const OPAQUE: f32 = 20.0;

@compute @workgroup_size(16, 4, 1)
fn make_air_view(@builtin(global_invocation_id) id: vec3u) {
    let medium = air;
    let row = id.y + medium.first_row;
    if id.x >= VIEW_COLUMNS || row >= VIEW_SKY_ROWS + VIEW_GROUND_ROWS { return; }
    let on_ground = row >= VIEW_SKY_ROWS;
    let rows = select(VIEW_SKY_ROWS, VIEW_GROUND_ROWS, on_ground);
    let elevation = f32(row - select(0u, VIEW_SKY_ROWS, on_ground)) / f32(rows - 1u);
    let mu = mu_of_elevation(medium, elevation, on_ground);
    let azimuth = cos_azimuth_of(f32(id.x) / f32(VIEW_COLUMNS - 1u));
    let across = sqrt(max((1.0 - mu * mu) * (1.0 - medium.mu_sun * medium.mu_sun), 0.0));
    let nu = clamp(mu * medium.mu_sun + across * azimuth, -1.0, 1.0);
    let path = air_path(medium.radius_m, medium.top_m, medium.altitude_m, mu, on_ground);
    let rayleigh_per_sr = phase_rayleigh_per_sr(nu);
    var sum = AirSum(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    // At the air's rim a path has no length, and a short one stands for it.
    let end = max(path.end_m, path.start_m + select(1.0 + 1e-6 * path.start_m, 0.0, on_ground));
    var at = path.start_m;
    for (var i = 0u; i < STEPS_MAX && at < end; i += 1u) {
        let rest = end - at;
        let step = select(step_m(medium, mu, nu, at, rest, sum.depth), rest, i + 1u == STEPS_MAX);
        sum = add_interval(sum, medium, mu, nu, rayleigh_per_sr, at, step);
        at = select(at + step, end, step >= rest || min(sum.depth.x, min(sum.depth.y, sum.depth.z)) > OPAQUE);
    }
    if on_ground {
        let end = place_along(medium, mu, nu, path.end_m);
        sum.air_per_sr += exp(-sum.depth) * lit_ground_per_sr(medium, end.mu_sun);
    }
    // Towards the sky a mean along the path, which the eye's own length multiplies: it has no end at the air's rim.
    let share = select(1.0 / (end - path.start_m), 1.0, on_ground);
    textureStore(air_out, vec2u(id.x, row), vec4f(log(max(share * sum.air_per_sr, vec3f(LEAST_STORED))), 0.0));
    textureStore(mie_out, vec2u(id.x, row), vec4f(log(max(share * sum.mie, vec3f(LEAST_STORED))), 0.0));
}
