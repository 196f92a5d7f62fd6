// Air between an eye at one altitude and what it sees at a distance: one invocation a direction, which walks through all
// distances. As far as a distance d the air keeps e^(-e d) of the light behind and adds s (1 - e^(-e d)): e is its mean
// extinction, s its mean source. Both change little along a path, down to d = 0, where light and depth themselves vanish.
#import skycell::air::{HAZE_COLUMNS, HAZE_SKY_ROWS, HAZE_GROUND_ROWS, HAZE_EXTINCTION_SLICES, HAZE_SLICES_APART, air_path, mu_of_elevation, cos_azimuth_of, share_of_distance, phase_rayleigh_per_sr}
#import skycell::air_march::{air, AirSum, add_interval, step_m}
#import skycell::phase::phase_hg_per_sr

/// Source over the mixed phase, for directions and distances.
@group(1) @binding(0) var source_out: texture_storage_3d<rgba32float, write>;
/// Mean extinction, 1/m: across by distance, down by elevation. It does not depend on azimuth.
@group(1) @binding(1) var extinction_out: texture_storage_2d<rgba32float, write>;

/// Steps of a slice at most; the last takes what is left.
const STEPS_MAX: u32 = 48u;

@compute @workgroup_size(16, 4, 1)
fn make_air_haze(@builtin(global_invocation_id) id: vec3u) {
    let medium = air;
    let row = id.y + medium.first_row;
    if id.x >= HAZE_COLUMNS || row >= HAZE_SKY_ROWS + HAZE_GROUND_ROWS { return; }
    let on_ground = row >= HAZE_SKY_ROWS;
    let rows = select(HAZE_SKY_ROWS, HAZE_GROUND_ROWS, on_ground);
    let elevation = f32(row - select(0u, HAZE_SKY_ROWS, on_ground)) / f32(rows - 1u);
    let mu = mu_of_elevation(medium, elevation, on_ground);
    let azimuth = cos_azimuth_of(f32(id.x) / f32(HAZE_COLUMNS - 1u));
    let across = sqrt(max((1.0 - mu * mu) * (1.0 - medium.mu_sun * medium.mu_sun), 0.0));
    let nu = clamp(mu * medium.mu_sun + across * azimuth, -1.0, 1.0);
    let path = air_path(medium.radius_m, medium.top_m, medium.altitude_m, mu, on_ground);
    // A path without length still has a source where it begins.
    let length = max(path.end_m - path.start_m, 1.0);
    let rayleigh_per_sr = phase_rayleigh_per_sr(nu);
    let mie_per_sr = phase_hg_per_sr(medium.mie_asymmetry, 1.0 - nu);
    let mixed = rayleigh_per_sr + medium.haze_mie_weight * mie_per_sr;
    var sum = AirSum(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    // The first slice has no length: a short interval stands for it.
    var at = 0.0;
    for (var slice = 0u; slice < HAZE_EXTINCTION_SLICES; slice += 1u) {
        let first = select(0.0, 1e-4, slice == 0u);
        let end = length * max(share_of_distance(f32(slice) / f32(HAZE_EXTINCTION_SLICES - 1u), on_ground), first);
        for (var i = 0u; i < STEPS_MAX && at < end; i += 1u) {
            let rest = end - at;
            let step = select(step_m(medium, mu, nu, path.start_m + at, rest, sum.depth), rest, i + 1u == STEPS_MAX);
            sum = add_interval(sum, medium, mu, nu, rayleigh_per_sr, path.start_m + at, step);
            at = select(at + step, end, step >= rest);
        }
        let light = sum.air_per_sr + sum.mie * mie_per_sr;
        let series = sum.depth * (1.0 - sum.depth * (0.5 - sum.depth * (1.0 / 6.0)));
        let lost = select(1.0 - exp(-sum.depth), series, sum.depth < vec3f(1e-2));
        if slice % HAZE_SLICES_APART == 0u {
            textureStore(source_out, vec3u(id.x, row, slice / HAZE_SLICES_APART), vec4f(light / max(lost, vec3f(1e-20)) / mixed, 0.0));
        }
        if id.x == 0u {
            textureStore(extinction_out, vec2u(slice, row), vec4f(sum.depth / at, 0.0));
        }
    }
}
