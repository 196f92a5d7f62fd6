// The sky as it is seen from one altitude: one invocation a direction. Sky and ground are rows of one table.
#import skycell::air::{VIEW_COLUMNS, VIEW_SKY_ROWS, VIEW_GROUND_ROWS, air_path, mu_of_elevation, cos_azimuth_of, phase_rayleigh_per_sr}
#import skycell::air_march::{air, AirSum, add_interval, place_along, lit_ground_per_sr}

/// What air scatters once and all more than once, with phase, and what of the ground comes through.
@group(1) @binding(0) var air_out: texture_storage_2d<rgba32float, write>;
/// What aerosol scatters once, without its phase.
@group(1) @binding(1) var mie_out: texture_storage_2d<rgba32float, write>;

/// Intervals on either side of the lowest place of a path.
const INTERVALS: u32 = 24u;

@compute @workgroup_size(16, 4, 1)
fn make_air_view(@builtin(global_invocation_id) id: vec3u) {
    let medium = air;
    let row = id.y + medium.first_row;
    if id.x >= VIEW_COLUMNS || row >= VIEW_SKY_ROWS + VIEW_GROUND_ROWS { return; }
    let on_ground = row >= VIEW_SKY_ROWS;
    let rows = select(VIEW_SKY_ROWS, VIEW_GROUND_ROWS, on_ground);
    let elevation = f32(row - select(0u, VIEW_SKY_ROWS, on_ground)) / f32(rows - 1u);
    let mu = mu_of_elevation(medium.radius_m, medium.top_m, medium.altitude_m, elevation, on_ground);
    let azimuth = cos_azimuth_of(f32(id.x) / f32(VIEW_COLUMNS - 1u));
    let across = sqrt(max((1.0 - mu * mu) * (1.0 - medium.mu_sun * medium.mu_sun), 0.0));
    let nu = clamp(mu * medium.mu_sun + across * azimuth, -1.0, 1.0);
    let path = air_path(medium.radius_m, medium.top_m, medium.altitude_m, mu, on_ground);
    let rayleigh_per_sr = phase_rayleigh_per_sr(nu);
    var sum = AirSum(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    // Distances grow with the square from the lowest place to either side: intervals are short where air is dense.
    let falling = path.lowest_m - path.start_m;
    let rising = path.end_m - path.lowest_m;
    let down = select(0u, INTERVALS, falling > 0.0);
    let count = down + select(0u, INTERVALS, rising > 0.0);
    for (var i = 0u; i < count; i += 1u) {
        let falls = i < down;
        let at = f32(select(i - down, INTERVALS - 1u - i, falls)) / f32(INTERVALS);
        let next = at + 1.0 / f32(INTERVALS);
        let length = select(rising, falling, falls) * (next - at) * (next + at);
        let middle = 0.5 * (at + next);
        let away = select(rising, -falling, falls) * middle * middle;
        sum = add_interval(sum, medium, mu, nu, rayleigh_per_sr, path.lowest_m + away, length);
    }
    if on_ground {
        let end = place_along(medium, mu, nu, path.end_m);
        sum.air_per_sr += exp(-sum.depth) * lit_ground_per_sr(medium, end.mu_sun);
    }
    textureStore(air_out, vec2u(id.x, row), vec4f(sum.air_per_sr, 0.0));
    textureStore(mie_out, vec2u(id.x, row), vec4f(sum.mie, 0.0));
}
