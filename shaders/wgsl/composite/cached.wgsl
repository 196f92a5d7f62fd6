#define_import_path skycell::cached
#import skycell::octahedral::octahedral_from_direction
#import skycell::march::{LayerRadiance, CLEAR_OPACITY}
#import skycell::view::PageTable

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
/// Tiles of a page, one below the other, and its texels.
const PAGE_TILES: u32 = 128u;
const PAGE_TEXELS: vec2f = vec2f(64.0, 8192.0);
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

/// What the cache holds of a layer in a direction from its anchor. Without any tile, and where something hides the layer:
/// clear sky.
fn cached_radiance(table: PageTable, from_anchor: vec3f, hidden: bool) -> LayerRadiance {
    let square = octahedral_from_direction(from_anchor);
    let tile = min(vec2u(square * f32(table.tiles_per_side)), vec2u(max(table.tiles_per_side, 1u) - 1u));
    let index = table.offset + tile.y * table.tiles_per_side + tile.x;
    let entry = textureLoad(page_table, vec2u(index % TABLE_WIDTH, index / TABLE_WIDTH), 0).x;
    let held = entry != NO_TILE && table.tiles_per_side != 0u && !hidden;
    let level = min((entry >> 16u) & 0xffu, table.level);
    let slot = select(0u, entry & 0xffffu, held);
    // Tiles double with each level, so a tile of a coarser level is found by a shift.
    let level_tile = vec2f(tile >> vec2u(table.level - level));
    let within = (square * f32(BASE_TILES << level) - level_tile) * TILE_INTERIOR;
    let origin = vec2f(0.0, f32(slot % PAGE_TILES * TILE_STRIDE));
    let texel = origin + GUTTER + clamp(within, vec2f(0.0), vec2f(TILE_INTERIOR));
    let page = slot / PAGE_TILES;
    let radiance = select(vec4f(0.0, 0.0, 0.0, 1.0), read_radiance(texel, page), held);
    var opacity_distance_m = textureSampleLevel(atlas_distance, atlas_sampler, texel / PAGE_TEXELS, page, 0.0).x;
#ifdef CATMULL_ROM
    // Its opacity must come from the same filter, or the distance jumps at edges.
    let transmittance = textureSampleLevel(atlas_radiance, atlas_sampler, texel / PAGE_TEXELS, page, 0.0).w;
    opacity_distance_m *= (1.0 - radiance.w + CLEAR_OPACITY) / (1.0 - transmittance + CLEAR_OPACITY);
#endif
    return LayerRadiance(radiance.x, radiance.y, radiance.z, radiance.w, select(0.0, opacity_distance_m, held));
}
