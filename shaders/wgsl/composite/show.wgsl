#define_import_path skycell::show
#import skycell::scene::{Scene, Phase}
#import skycell::march::{LayerRadiance, CLEAR_OPACITY, distance_seen_m}
#import skycell::shade::{Background, Ray, layer_over}
#import skycell::colour_scale::{viridis, log_share, NOTHING}
#ifdef SHOW_CACHE
#import skycell::octahedral::octahedral_from_direction
#import skycell::view::PageTable
#import skycell::cached::{page_table, TABLE_WIDTH, NO_TILE}
#endif

// What stands in the place of the composite's functions where a viewer looks at one quantity instead of the picture. The
// plain composite imports nothing of this.

/// Nothing behind the clouds.
fn black_background(world: Scene, back: Background, ray: Ray) -> vec3f {
    return vec3f(0.0);
}

/// The phase of a medium that scatters evenly, 1/sr.
fn isotropic_per_sr(world: Scene, phase: Phase, ray: Ray) -> f32 {
    return 1.0 / 12.566370614359172;
}

/// As layer_over, of one part of the light alone and without haze in front.
fn part_over(world: Scene, back: Background, sun_phase_per_sr: f32, behind: vec3f, cloud: LayerRadiance, air_extinction_per_m: vec3f, albedo: f32) -> vec3f {
    var part = LayerRadiance(0.0, 0.0, 0.0, cloud.transmittance, 0.0);
#ifdef SHOW_SINGLE
    part.single = cloud.single;
#endif
#ifdef SHOW_MULTIPLE
    part.octaves = cloud.octaves;
#endif
#ifdef SHOW_AMBIENT
    part.ambient = cloud.ambient;
#endif
    // What the ground adds belongs to the ambient part.
#ifdef SHOW_AMBIENT
    let below = albedo;
#else
    let below = 0.0;
#endif
    var clear = back;
    clear.air = vec3f(0.0);
    return layer_over(world, clear, sun_phase_per_sr, behind, part, vec3f(0.0), below);
}

/// What is nothing yet: no cloud seen, all let through, no value of the cache.
fn no_values(world: Scene, back: Background, ray: Ray) -> vec3f {
    return vec3f(0.0, 1.0, -1.0);
}

/// Values of a layer over those of what is behind: distance times opacity, m; transmittance; value of the cache, which is
/// that of the layer that shows most, the nearer of two that show alike.
fn values_over(world: Scene, back: Background, sun_phase_per_sr: f32, behind: vec3f, cloud: LayerRadiance, air_extinction_per_m: vec3f, albedo: f32) -> vec3f {
    let opacity_distance_m = max(cloud.opacity_distance_m - CLEAR_OPACITY * distance_seen_m(cloud.opacity_distance_m, cloud.transmittance), 0.0);
    return vec3f(
        opacity_distance_m + behind.x * cloud.transmittance,
        behind.y * cloud.transmittance,
        max(behind.z, cloud.single),
    );
}

#ifdef SHOW_CACHE
/// What a page table says of a direction, in the place of what the cache holds: level or age code of the tile, -1 for none.
fn cached_entry(table: PageTable, from_anchor: vec3f, hidden: bool) -> LayerRadiance {
    let square = octahedral_from_direction(from_anchor);
    let tile = min(vec2u(square * f32(table.tiles_per_side)), vec2u(max(table.tiles_per_side, 1u) - 1u));
    let index = table.offset + tile.y * table.tiles_per_side + tile.x;
    let entry = textureLoad(page_table, vec2u(index % TABLE_WIDTH, index / TABLE_WIDTH), 0).x;
    let held = entry != NO_TILE && table.tiles_per_side != 0u && !hidden;
#ifdef SHOW_CACHE_AGE
    let value = f32(entry >> 24u);
#else
    let value = f32((entry >> 16u) & 0xffu);
#endif
    return LayerRadiance(select(-1.0, value, held), 0.0, 0.0, 1.0, 0.0);
}
#endif

/// Ends of the scales, as `skycell_protocol::show` has them (a test compares).
const DISTANCE_LOW_M: f32 = 500.0;
const DISTANCE_HIGH_M: f32 = 200000.0;
const MIP_HIGH: f32 = 6.0;
/// Ages are coded in 255 steps of equal ratio between both ends of the scale.
const AGE_CODES: f32 = 255.0;

/// The colour of the values of a pixel, sRGB-encoded.
fn colour_of_values(values: vec3f) -> vec3f {
#ifdef SHOW_TRANSMITTANCE
    return viridis(values.y);
#else
#ifdef SHOW_DISTANCE
    let opacity = 1.0 - values.y;
    let distance_m = values.x / max(opacity, 1e-6);
    return select(NOTHING, viridis(log_share(distance_m, DISTANCE_LOW_M, DISTANCE_HIGH_M)), opacity > 0.01);
#else
#ifdef SHOW_CACHE_AGE
    return select(NOTHING, viridis(values.z / AGE_CODES), values.z >= 0.0);
#else
    return select(NOTHING, viridis(values.z / MIP_HIGH), values.z >= 0.0);
#endif
#endif
#endif
}
