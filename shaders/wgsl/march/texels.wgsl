// One ray per texel of a tile: fills the proxy-sphere cache.
#import skycell::march::{scene, march_layer, sample_offset, sample_start_fraction, LayerRadiance}
#import skycell::octahedral::direction_from_octahedral
#import skycell::shell::{altitude_m, shell_roots}
#ifdef COUNT_READS
#import skycell::density::texture_reads
#endif

/// Texels along a stored tile, its gutters of GUTTER texels on every side included.
const TILE_STRIDE: u32 = 64u;
const GUTTER: u32 = 2u;
const TILE_INTERIOR: u32 = 60u;
/// Tiles of a page (an array layer) of the atlas, one below the other.
const PAGE_TILES: u32 = 128u;

/// Width of what the samples of a texel cover. Texels are a half to 1.1 pixels wide; wider footprints bring their mean to
/// that of a pixel. Tuned: FLIP against the screen-space renderer (`tests/tests/accuracy.rs`).
const FOOTPRINT_TEXELS: f32 = 1.0;

/// One tile that takes one more sample.
struct TileWork {
    tile: vec2u,
    /// Texels along the whole octahedral square at the tile's level.
    texels_per_side: f32,
    /// Where the atlas keeps the tile.
    slot: u32,
    layer: u32,
    /// Which of the jittered samples this is.
    sample_index: u32,
    /// Share of this sample in the texel's new value; 1 replaces.
    weight: f32,
    /// Place of the old texels on the working page.
    previous: u32,
}

struct Reference {
    /// Where the rays of the cell start, in the cell's frame.
    position: vec3f,
}

@group(2) @binding(0) var<storage, read> work: array<TileWork>;
@group(2) @binding(1) var<uniform> reference: Reference;
@group(2) @binding(2) var previous_radiance: texture_2d<f32>;
@group(2) @binding(3) var previous_distance: texture_2d<f32>;
@group(2) @binding(4) var atlas_radiance: texture_storage_2d_array<rgba16float, write>;
@group(2) @binding(5) var atlas_distance: texture_storage_2d_array<r32float, write>;
/// Texture reads so far, low and high word.
@group(2) @binding(6) var<storage, read_write> read_counter: array<atomic<u32>, 2>;

/// A direction raised to the horizon of a position, where it lies below. Texels under the horizon repeat what stands on
/// it: viewers' own rays decide what the ground hides, and reads across the horizon find sky on both sides.
fn above_horizon(direction: vec3f, position: vec3f) -> vec3f {
    let altitude = max(altitude_m(scene.planet.radius_m, position), 0.0);
    // sin of the dip is sqrt(h (2R + h)) / (R + h); a little less, so that rounding does not bury the ray.
    let dip = sqrt(altitude * (2.0 * scene.planet.radius_m + altitude)) / (scene.planet.radius_m + altitude);
    return normalize(vec3f(direction.x, max(direction.y, 2e-5 - dip), direction.z));
}

/// Largest value that is stored: half floats end at 65 504, and the phases of unscaled octaves can exceed that.
const STORED_MAX: f32 = 6e4;

/// Rounded to the nearest value with a half float's eleven digits. Drivers may cut digits off where they store, and a mean
/// that is cut off with every sample becomes darker with every sample.
fn half_rounded(value: vec4f) -> vec4f {
    return bitcast<vec4f>((bitcast<vec4u>(value) + 0x1000u) & vec4u(0xffffe000u));
}

@compute @workgroup_size(8, 8, 1)
fn march_texels(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let item = work[group.z];
    let stored = group.xy * 8u + local.xy;
    let texel = vec2f(item.tile * TILE_INTERIOR) + vec2f(stored) - f32(GUTTER);
    let square = (texel + 0.5 + FOOTPRINT_TEXELS * sample_offset(item.sample_index)) / item.texels_per_side;

    let layer = scene.layers[item.layer];
    let from_anchor = direction_from_octahedral(square);
    let anchor_altitude = altitude_m(scene.planet.radius_m, layer.anchor);
    let sphere = shell_roots(scene.planet.radius_m, layer.proxy_altitude_m, layer.anchor, anchor_altitude, from_anchor);
    let on_sphere = layer.anchor + from_anchor * max(sphere.far_m, 1e-3);
    let direction = above_horizon(normalize(on_sphere - reference.position), reference.position);

    let start = sample_start_fraction(texel, item.sample_index);
    let sample = march_layer(item.layer, reference.position, direction, start);

#ifdef COUNT_READS
    let before = atomicAdd(&read_counter[0], texture_reads);
    if before + texture_reads < before { atomicAdd(&read_counter[1], 1u); }
#endif
    let scratch = vec2u(0u, item.previous * TILE_STRIDE) + stored;
    let old_radiance = textureLoad(previous_radiance, scratch, 0);
    let old_distance = textureLoad(previous_distance, scratch, 0).x;
    let new_radiance = min(vec4f(sample.single, sample.octaves, sample.ambient, sample.transmittance), vec4f(STORED_MAX));
    let new_distance = sample.opacity_distance_m;
    // select, not mix with weight 1: whatever a fresh slot holds, NaN included, must not leak in.
    let replaces = item.weight >= 1.0;
    let radiance = select(mix(old_radiance, new_radiance, item.weight), new_radiance, replaces);
    let distance = select(mix(old_distance, new_distance, item.weight), new_distance, replaces);

    let target_texel = vec2u(0u, item.slot % PAGE_TILES * TILE_STRIDE) + stored;
    let page = item.slot / PAGE_TILES;
    textureStore(atlas_radiance, target_texel, page, half_rounded(radiance));
    textureStore(atlas_distance, target_texel, page, vec4f(distance, 0.0, 0.0, 0.0));
}
