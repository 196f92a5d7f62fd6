#define_import_path skycell::cached
#import skycell::octahedral::octahedral_from_direction
#import skycell::march::LayerRadiance

/// Page tables as rows of TABLE_WIDTH entries. A texture and no buffer: software drivers read buffers lane by lane.
@group(2) @binding(0) var page_table: texture_2d<u32>;
@group(2) @binding(1) var atlas_radiance: texture_2d_array<f32>;
@group(2) @binding(2) var atlas_distance: texture_2d_array<f32>;
@group(2) @binding(3) var atlas_sampler: sampler;

const TABLE_WIDTH: u32 = 1024u;
const NO_TILE: u32 = 0xffffffffu;
const TILE_STRIDE: u32 = 64u;
const TILE_INTERIOR: f32 = 60.0;
const GUTTER: f32 = 2.0;
const PAGE_TILES: u32 = 16u;
const PAGE_TEXELS: f32 = 1024.0;
/// Tiles along the octahedral square at level 0.
const BASE_TILES: u32 = 5u;

#ifdef CATMULL_ROM
/// Catmull-Rom reconstruction from nine bilinear reads (the separable form with merged middle taps). The gutter of two
/// texels keeps every tap inside the tile.
fn read_radiance(texel: vec2f, page: u32) -> vec4f {
    let centre = floor(texel - 0.5) + 0.5;
    let f = texel - centre;
    let w_first = f * (-0.5 + f * (1.0 - 0.5 * f));
    let w_second = 1.0 + f * f * (-2.5 + 1.5 * f);
    let w_third = f * (0.5 + f * (2.0 - 1.5 * f));
    let w_last = f * f * (-0.5 + 0.5 * f);
    // w_second + w_third is at least 1 for f in 0...1.
    let w_middle = w_second + w_third;
    let at_first = (centre - 1.0) / PAGE_TEXELS;
    let at_middle = (centre + w_third / w_middle) / PAGE_TEXELS;
    let at_last = (centre + 2.0) / PAGE_TEXELS;
    var sum = textureSampleLevel(atlas_radiance, atlas_sampler, at_middle, page, 0.0) * (w_middle.x * w_middle.y);
    sum += textureSampleLevel(atlas_radiance, atlas_sampler, vec2f(at_first.x, at_middle.y), page, 0.0) * (w_first.x * w_middle.y);
    sum += textureSampleLevel(atlas_radiance, atlas_sampler, vec2f(at_last.x, at_middle.y), page, 0.0) * (w_last.x * w_middle.y);
    sum += textureSampleLevel(atlas_radiance, atlas_sampler, vec2f(at_middle.x, at_first.y), page, 0.0) * (w_middle.x * w_first.y);
    sum += textureSampleLevel(atlas_radiance, atlas_sampler, vec2f(at_middle.x, at_last.y), page, 0.0) * (w_middle.x * w_last.y);
    // The four corners weigh at most 1/64 each; dropping them and dividing by what is left costs less than they do.
    let total = w_middle.x * w_middle.y + (w_first.x + w_last.x) * w_middle.y + w_middle.x * (w_first.y + w_last.y);
    let value = max(sum / total, vec4f(0.0));
    return vec4f(value.xyz, min(value.w, 1.0));
}
#else
fn read_radiance(texel: vec2f, page: u32) -> vec4f {
    return textureSampleLevel(atlas_radiance, atlas_sampler, texel / PAGE_TEXELS, page, 0.0);
}
#endif

/// What the cache holds of a layer in a direction from its anchor. Without any tile: clear sky.
fn cached_radiance(offset: u32, tiles_per_side: u32, from_anchor: vec3f) -> LayerRadiance {
    if tiles_per_side == 0u { return LayerRadiance(0.0, 0.0, 0.0, 1.0, 0.0); }
    let square = octahedral_from_direction(from_anchor);
    let tiles = f32(tiles_per_side);
    let tile = min(vec2u(square * tiles), vec2u(tiles_per_side - 1u));
    let index = offset + tile.y * tiles_per_side + tile.x;
    let entry = textureLoad(page_table, vec2u(index % TABLE_WIDTH, index / TABLE_WIDTH), 0).x;
    let level = (entry >> 16u) & 0xffu;
    let slot = entry & 0xffffu;
    let level_tiles = BASE_TILES << min(level, 16u);
    let level_tile = vec2f(tile * level_tiles / tiles_per_side);
    let within = (square * f32(level_tiles) - level_tile) * TILE_INTERIOR;
    let in_page = slot % (PAGE_TILES * PAGE_TILES);
    let origin = vec2f(f32((in_page % PAGE_TILES) * TILE_STRIDE), f32((in_page / PAGE_TILES) * TILE_STRIDE));
    let texel = origin + GUTTER + clamp(within, vec2f(0.0), vec2f(TILE_INTERIOR));
    let page = slot / (PAGE_TILES * PAGE_TILES);
    let held = entry != NO_TILE;
    let safe_page = select(0u, page, held);
    let safe_texel = select(vec2f(0.5), texel, held);
    let radiance = select(vec4f(0.0, 0.0, 0.0, 1.0), read_radiance(safe_texel, safe_page), held);
    let distance_m = select(0.0, textureLoad(atlas_distance, vec2u(safe_texel), safe_page, 0).x, held);
    return LayerRadiance(radiance.x, radiance.y, radiance.z, radiance.w, distance_m);
}
