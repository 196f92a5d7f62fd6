// Texels marched once more, beside what the cache holds of them: how wrong is it? The scene that is bound has finer steps
// than the one that the cache was marched with.
#import skycell::march::{scene, march_layer, sample_offset, sample_start_fraction}
#import skycell::texel_ray::{TILE_STRIDE, PAGE_TILES, FOOTPRINT_TEXELS, texel_in_level, texel_direction}

/// Places of a texel that are marched; their mean is the texel's middle.
const PLACES: u32 = 8u;

struct AuditWork {
    tile: vec2u,
    /// Column and row in the stored tile, gutters included.
    texel: vec2u,
    /// Texels along the whole octahedral square at the tile's level.
    texels_per_side: f32,
    /// Where the atlas keeps the tile.
    slot: u32,
    /// Index among the scene's proxies.
    proxy: u32,
}

/// Single scattering, octaves, ambient, transmittance; and the distance times opacity, m.
struct AuditSample {
    cached: vec4f,
    fresh: vec4f,
    cached_distance: f32,
    fresh_distance: f32,
}

struct Reference {
    /// Where the rays of the cell start, in the cell's frame.
    position: vec3f,
}

@group(2) @binding(0) var<storage, read> work: array<AuditWork>;
@group(2) @binding(1) var<uniform> reference: Reference;
@group(2) @binding(2) var atlas_radiance: texture_2d_array<f32>;
@group(2) @binding(3) var atlas_distance: texture_2d_array<f32>;
@group(2) @binding(4) var<storage, read_write> samples: array<AuditSample>;

/// x is the place inside the texel, y the texel.
@compute @workgroup_size(8, 8, 1)
fn audit_texels(@builtin(global_invocation_id) id: vec3u) {
    if id.y >= arrayLength(&work) { return; }
    let item = work[id.y];
    let texel = texel_in_level(item.tile, item.texel);
    let square = (texel + 0.5 + FOOTPRINT_TEXELS * sample_offset(texel, id.x)) / item.texels_per_side;
    let proxy = scene.proxies[item.proxy];
    let direction = texel_direction(scene.planet.radius_m, proxy, reference.position, square);
    let start = sample_start_fraction(texel, id.x);
    let fresh = march_layer(proxy.layer, proxy.part, reference.position, direction, start);
    let stored = vec2u(0u, item.slot % PAGE_TILES * TILE_STRIDE) + item.texel;
    let page = item.slot / PAGE_TILES;
    let cached = textureLoad(atlas_radiance, stored, page, 0);
    let cached_distance = textureLoad(atlas_distance, stored, page, 0).x;
    let sample = vec4f(fresh.single, fresh.octaves, fresh.ambient, fresh.transmittance);
    samples[id.y * PLACES + id.x] = AuditSample(cached, sample, cached_distance, fresh.opacity_distance_m);
}
