// One ray per texel of a tile: fills the proxy-sphere cache.
#import skycell::march::{scene, march_layer, sample_offset, sample_start_fraction, LayerRadiance}
#import skycell::texel_ray::{TILE_STRIDE, PAGE_TILES, FOOTPRINT_TEXELS, texel_in_level, texel_direction}
#import skycell::accumulate::accumulated
#ifdef COUNT_READS
#import skycell::density::texture_reads
#endif

/// One tile that takes one more sample.
struct TileWork {
    tile: vec2u,
    /// Texels along the whole octahedral square at the tile's level.
    texels_per_side: f32,
    /// Where the atlas keeps the tile.
    slot: u32,
    /// Index among the scene's proxies.
    proxy: u32,
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

@compute @workgroup_size(8, 8, 1)
fn march_texels(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let item = work[group.z];
    let stored = group.xy * 8u + local.xy;
    let texel = texel_in_level(item.tile, stored);
    let square = (texel + 0.5 + FOOTPRINT_TEXELS * sample_offset(item.sample_index)) / item.texels_per_side;
    let proxy = scene.proxies[item.proxy];
    let direction = texel_direction(scene.planet.radius_m, proxy, reference.position, square);

    let start = sample_start_fraction(texel, item.sample_index);
    let sample = march_layer(proxy.layer, proxy.part, reference.position, direction, start);

#ifdef COUNT_READS
    let before = atomicAdd(&read_counter[0], texture_reads);
    if before + texture_reads < before { atomicAdd(&read_counter[1], 1u); }
#endif
    let scratch = vec2u(0u, item.previous * TILE_STRIDE) + stored;
    let old_radiance = textureLoad(previous_radiance, scratch, 0);
    let old_distance = textureLoad(previous_distance, scratch, 0).x;
    let new_radiance = vec4f(sample.single, sample.octaves, sample.ambient, sample.transmittance);
    let new_distance = sample.opacity_distance_m;
    let radiance = accumulated(old_radiance, new_radiance, item.weight);
    let replaces = item.weight >= 1.0;
    let distance = select(mix(old_distance, new_distance, item.weight), new_distance, replaces);

    let target_texel = vec2u(0u, item.slot % PAGE_TILES * TILE_STRIDE) + stored;
    let page = item.slot / PAGE_TILES;
    textureStore(atlas_radiance, target_texel, page, radiance);
    textureStore(atlas_distance, target_texel, page, vec4f(distance, 0.0, 0.0, 0.0));
}
