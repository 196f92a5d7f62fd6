// Fills columns of the sun volume, one thread each: from the layer's top down along the sun's direction.
#import skycell::march::{scene, sun_density}
#ifdef COUNT_READS
#import skycell::density::texture_reads
#endif
#import skycell::sun_column::{rise_m, foot_m, slice_altitude_m}

/// Columns of one level of one layer that are made together.
struct SunColumns {
    direction: vec3f,
    /// Distance between feet, m.
    spacing_m: f32,
    /// Foot of the first column in the frame, m.
    first_foot_m: vec2f,
    /// Its texel.
    first_texel: vec2u,
    /// How many along x and z.
    columns: vec2u,
    /// Texels along the torus.
    columns_per_side: u32,
    /// The level's lowest slice in the texture.
    first_slice: u32,
    slices: u32,
    /// Samples between two slices.
    substeps: u32,
    /// Place among the shown layers.
    layer: u32,
    pad_layer: u32,
}

@group(2) @binding(0) var<uniform> work: SunColumns;
@group(2) @binding(1) var depths: texture_storage_3d<r32float, write>;

#ifdef COUNT_READS
/// Texture reads so far, low and high word.
@group(2) @binding(2) var<storage, read_write> read_counter: array<atomic<u32>, 2>;
#endif

@compute @workgroup_size(8, 8, 1)
fn sun_columns(@builtin(global_invocation_id) id: vec3u) {
    if any(id.xy >= work.columns) { return; }
    let planet_radius_m = scene.planet.radius_m;
    let layer = scene.layers[work.layer];
    let direction = work.direction;
    let slices = work.slices;
    let substeps = work.substeps;
    let foot_xz = work.first_foot_m + vec2f(id.xy) * work.spacing_m;
    let foot = foot_m(planet_radius_m, layer.base_altitude_m, foot_xz);
    let texel = (work.first_texel + id.xy) % work.columns_per_side;
    var amount_m = 0.0;
    var far_m = rise_m(planet_radius_m, foot, layer.base_altitude_m, direction, layer.top_altitude_m);
    textureStore(depths, vec3u(texel, work.first_slice + slices - 1u), vec4f(0.0));
    for (var k = 1u; k < slices; k += 1u) {
        let slice = slices - 1u - k;
        let altitude = slice_altitude_m(layer.base_altitude_m, layer.top_altitude_m, slice, slices);
        let near_m = rise_m(planet_radius_m, foot, layer.base_altitude_m, direction, altitude);
        let step_m = (far_m - near_m) / f32(substeps);
        var sum = 0.0;
        for (var i = 0u; i < substeps; i += 1u) {
            let sample = foot + direction * (near_m + (f32(i) + 0.5) * step_m);
            sum += sun_density(planet_radius_m, layer, sample);
        }
        amount_m += sum * step_m;
        textureStore(depths, vec3u(texel, work.first_slice + slice), vec4f(amount_m));
        far_m = near_m;
    }
#ifdef COUNT_READS
    let before = atomicAdd(&read_counter[0], texture_reads);
    if before + texture_reads < before { atomicAdd(&read_counter[1], 1u); }
#endif
}
