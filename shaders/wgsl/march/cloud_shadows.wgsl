// The shadow that one layer throws into the air: one thread for each sunbeam, from the layer's top down to its base. A
// reader below the layer reads the lowest slice, one inside it the slice of its altitude.
#import skycell::march::{scene, sun_density}
#ifdef COUNT_READS
#import skycell::density::texture_reads
#endif
#import skycell::shell::{altitude_m, shell_roots}
#import skycell::sun_column::slice_altitude_m
#import skycell::shafts::{ShaftFrame, SHADOW_BEAMS, SHADOW_SLICES, across_of_azimuth, offset_of_beam_m}

/// Sunbeams of one layer that are made together.
struct ShadowWork {
    frame: ShaftFrame,
    first_azimuth: u32,
    azimuths: u32,
    /// Place among the shown layers.
    layer: u32,
    /// Samples between two slices.
    substeps: u32,
}

@group(2) @binding(0) var<uniform> work: ShadowWork;
/// The layer's transmittance from a place towards the sun: across by azimuth, down by sunbeam, deep by layer and altitude.
@group(2) @binding(1) var shadows_out: texture_storage_3d<r32float, write>;

#ifdef COUNT_READS
/// Texture reads so far, low and high word.
@group(2) @binding(2) var<storage, read_write> read_counter: array<atomic<u32>, 2>;
#endif

/// Distance along a sunbeam at which it rises through an altitude, m; where it stays above, its lowest place.
fn rises_at_m(planet_radius_m: f32, altitude: f32, start: vec3f, start_altitude_m: f32, direction: vec3f) -> f32 {
    let roots = shell_roots(planet_radius_m, altitude, start, start_altitude_m, direction);
    let lowest_m = -(dot(direction, start) + planet_radius_m * direction.y);
    return select(lowest_m, roots.far_m, roots.hit);
}

@compute @workgroup_size(8, 8, 1)
fn cloud_shadows(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= work.azimuths || id.y >= SHADOW_BEAMS { return; }
    let frame = work.frame;
    let planet_radius_m = scene.planet.radius_m;
    let layer = scene.layers[work.layer];
    let substeps = work.substeps;
    let azimuth = work.first_azimuth + id.x;
    let first_slice = work.layer * SHADOW_SLICES;
    let offset_m = offset_of_beam_m(f32(id.y) / f32(SHADOW_BEAMS - 1u));
    let start = frame.origin + across_of_azimuth(frame, azimuth) * offset_m;
    let start_altitude_m = altitude_m(planet_radius_m, start);
    var amount_m = 0.0;
    var far_m = rises_at_m(planet_radius_m, layer.top_altitude_m, start, start_altitude_m, frame.sun);
    textureStore(shadows_out, vec3u(azimuth, id.y, first_slice + SHADOW_SLICES - 1u), vec4f(1.0));
    for (var k = 1u; k < SHADOW_SLICES; k += 1u) {
        let slice = SHADOW_SLICES - 1u - k;
        let altitude = slice_altitude_m(layer.base_altitude_m, layer.top_altitude_m, slice, SHADOW_SLICES);
        let near_m = rises_at_m(planet_radius_m, altitude, start, start_altitude_m, frame.sun);
        let step_m = (far_m - near_m) / f32(substeps);
        var sum = 0.0;
        for (var i = 0u; i < substeps; i += 1u) {
            sum += sun_density(planet_radius_m, layer, start + frame.sun * (near_m + (f32(i) + 0.5) * step_m));
        }
        amount_m += sum * step_m;
        // The exponent is 0 or less: densities, extinction and steps are not negative.
        textureStore(shadows_out, vec3u(azimuth, id.y, first_slice + slice), vec4f(exp(-amount_m * layer.extinction_per_m)));
        far_m = near_m;
    }
#ifdef COUNT_READS
    let before = atomicAdd(&read_counter[0], texture_reads);
    if before + texture_reads < before { atomicAdd(&read_counter[1], 1u); }
#endif
}
