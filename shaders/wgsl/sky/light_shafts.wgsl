// Of the light that the air along a ray scatters, the share that is left in the shadow of clouds: one invocation a direction,
// which walks through all distances. Both sums are taken by the same steps, so the share is exactly 1 where no cloud
// stands, and its error is that of a ratio. Light that is scattered once is shaded; the higher orders come from all around,
// and are not (S. Hillaire 2020, section 5: shadow is evaluated for single scattering, higher orders as without).
#import skycell::air::{air_path, phase_rayleigh_per_sr}
#import skycell::air_march::{air, Place, densities, extinction_per_m, place_along, sun_transmittance, higher_orders_per_sr}
#import skycell::phase::phase_hg_per_sr
#import skycell::shafts::{ShaftFrame, SHAFT_AZIMUTHS, SHAFT_ANGLES, SHAFT_SLICES, SHADOW_BEAMS, SHADOW_SLICES, BEAM_FAR_M, across_of_azimuth, beam_place, distance_of_slice_m, texel_of}

/// Half-planes that are made together.
struct ShaftWork {
    frame: ShaftFrame,
    /// Base and top of the layers, m.
    layers: array<vec4f, 4>,
    layer_count: u32,
    first_azimuth: u32,
    azimuths: u32,
    pad_work: u32,
}

@group(1) @binding(0) var<uniform> work: ShaftWork;
@group(1) @binding(1) var shadows: texture_3d<f32>;
/// Repeats across.
@group(1) @binding(2) var shadow_sampler: sampler;
@group(1) @binding(3) var shares_out: texture_storage_3d<rgba16float, write>;

/// Steps between two slices. Tuned: tests/light_shafts, share against the f64 twin.
const STEPS: u32 = 6u;
/// Length of the first slice, whose share is that of the air at the eye, m.
const FIRST_M: f32 = 1.0;
/// A ray that ends on the ground is followed this far below the horizon: neighbours above it are mixed with it.
const GROUND_FAR_M: f32 = 400000.0;
/// Least that is divided by; where no light is, none is shaded.
const LEAST: f32 = 1e-30;

/// Share of [`BEAM_FAR_M`] from which on shadow fades away: beyond the last sunbeam none is known.
const FADE_SHARE: f32 = 0.7;

/// Share of the sun's light that the layers let through to a place.
fn sunlit_share(azimuth: f32, offset_m: f32, altitude: f32) -> f32 {
    var share = 1.0;
    let beam = texel_of(beam_place(offset_m), SHADOW_BEAMS);
    let unknown = smoothstep(FADE_SHARE, 1.0, offset_m / BEAM_FAR_M);
    for (var i = 0u; i < work.layer_count; i += 1u) {
        let base_m = work.layers[i].x;
        let top_m = work.layers[i].y;
        let height = saturate((altitude - base_m) / max(top_m - base_m, 1e-3));
        let slice = (f32(i * SHADOW_SLICES) + 0.5 + height * f32(SHADOW_SLICES - 1u)) / f32(work.layer_count * SHADOW_SLICES);
        let kept = textureSampleLevel(shadows, shadow_sampler, vec3f(azimuth, beam, slice), 0.0).x;
        let here = select(kept, 1.0, altitude >= top_m);
        // In this form exactly 1 where nothing shades.
        share *= here + (1.0 - here) * unknown;
    }
    return share;
}

/// Light of both sums so far, and the optical depth.
struct ShaftSum {
    lit: vec3f,
    shaded: vec3f,
    depth: vec3f,
}

@compute @workgroup_size(8, 8, 1)
fn make_light_shafts(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= work.azimuths || id.y >= SHAFT_ANGLES { return; }
    let medium = air;
    let frame = work.frame;
    let azimuth = work.first_azimuth + id.x;
    let azimuth_at = (f32(azimuth) + 0.5) / f32(SHAFT_AZIMUTHS);
    let angle = f32(id.y) * (3.141592653589793 / f32(SHAFT_ANGLES - 1u));
    let direction = frame.sun * cos(angle) + across_of_azimuth(frame, azimuth) * sin(angle);
    let from_centre = vec3f(frame.origin.x, frame.origin.y + medium.radius_m, frame.origin.z) / (medium.radius_m + frame.altitude_m);
    let mu = clamp(dot(direction, from_centre), -1.0, 1.0);
    let half_sine = sin(0.5 * angle);
    let from_sun = 2.0 * half_sine * half_sine;
    let nu = 1.0 - from_sun;
    let rayleigh_per_sr = phase_rayleigh_per_sr(nu);
    let mie_per_sr = phase_hg_per_sr(medium.mie_asymmetry, from_sun);
    let b = (medium.radius_m + medium.altitude_m) * mu;
    let on_ground = b < 0.0 && b * b >= medium.altitude_m * (medium.altitude_m + 2.0 * medium.radius_m);
    let path = air_path(medium.radius_m, medium.top_m, medium.altitude_m, mu, false);
    let length = select(max(path.end_m - path.start_m, FIRST_M), GROUND_FAR_M, on_ground);
    let lowest_m = min(medium.altitude_m, 0.0);
    let sine = sin(angle);
    var sum = ShaftSum(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    var share = vec3f(1.0);
    var begin = 0.0;
    for (var slice = 0u; slice < SHAFT_SLICES; slice += 1u) {
        let last = slice + 1u == SHAFT_SLICES;
        let until = distance_of_slice_m(frame, min(f32(slice), f32(SHAFT_SLICES) - 1.5) / f32(SHAFT_SLICES - 1u));
        let end = min(select(max(until, FIRST_M), length, last), length);
        let step = (end - begin) / f32(STEPS);
        for (var i = 0u; i < STEPS && step > 0.0; i += 1u) {
            let distance = path.start_m + begin + (f32(i) + 0.5) * step;
            let along = place_along(medium, mu, nu, distance);
            // Below the ground, where only rays that are hidden go, air goes on as it is there.
            let place = Place(max(along.altitude_m, lowest_m), along.mu_sun);
            let here = densities(medium, place.altitude_m);
            let extinction = extinction_per_m(medium, here) * step;
            let rayleigh = medium.rayleigh_per_m * here.rayleigh;
            let mie = medium.mie_scattering_per_m * here.mie;
            let once = (rayleigh * rayleigh_per_sr + mie * mie_per_sr) * sun_transmittance(medium, place);
            let often = (rayleigh + mie) * higher_orders_per_sr(medium, place);
            let kept = exp(-(sum.depth + 0.5 * extinction)) * step;
            let sunlit = sunlit_share(azimuth_at, distance * sine, place.altitude_m);
            sum = ShaftSum(sum.lit + kept * (once + often), sum.shaded + kept * (once * sunlit + often), sum.depth + extinction);
        }
        begin = max(end, begin);
        share = select(vec3f(1.0), min(sum.shaded / max(sum.lit, vec3f(LEAST)), vec3f(1.0)), sum.lit > vec3f(LEAST));
        textureStore(shares_out, vec3u(azimuth, id.y, slice), vec4f(share, 1.0));
    }
}
