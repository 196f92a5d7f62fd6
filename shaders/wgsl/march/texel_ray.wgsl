#define_import_path skycell::texel_ray
#import skycell::scene::Proxy
#import skycell::octahedral::{direction_from_octahedral, octahedral_from_direction}
#import skycell::shell::altitude_m
#import skycell::surface::surface_point

/// Texels along a stored tile, its gutters of GUTTER texels on every side included.
const TILE_STRIDE: u32 = 64u;
const GUTTER: u32 = 2u;
const TILE_INTERIOR: u32 = 60u;
/// Tiles of a page (an array layer) of the atlas, one below the other.
const PAGE_TILES: u32 = 128u;

/// Width of what the samples of a texel cover. Texels are a half to 1.1 pixels wide; wider footprints bring their mean to
/// that of a pixel. Tuned: FLIP against the screen-space renderer (`tests/tests/accuracy.rs`).
const FOOTPRINT_TEXELS: f32 = 1.0;

/// Coordinates of a texel at its level, from its tile and its place in the stored tile.
fn texel_in_level(tile: vec2u, stored: vec2u) -> vec2f {
    return vec2f(tile * TILE_INTERIOR) + vec2f(stored) - f32(GUTTER);
}

/// A direction raised to the horizon of a position, where it lies below. Texels under the horizon repeat what stands on
/// it: viewers' own rays decide what the ground hides, and reads across the horizon find sky on both sides.
fn above_horizon(planet_radius_m: f32, direction: vec3f, position: vec3f) -> vec3f {
    let altitude = max(altitude_m(planet_radius_m, position), 0.0);
    // sin of the dip is sqrt(h (2R + h)) / (R + h); a little less, so that rounding does not bury the ray.
    let dip = sqrt(altitude * (2.0 * planet_radius_m + altitude)) / (planet_radius_m + altitude);
    return normalize(vec3f(direction.x, max(direction.y, 2e-5 - dip), direction.z));
}

/// Direction from the reference point through the point of a proxy's surface that has a place of the octahedral
/// square, 0...1, as its address.
fn texel_direction(planet_radius_m: f32, proxy: Proxy, reference: vec3f, square: vec2f) -> vec3f {
    let from_anchor = direction_from_octahedral(square);
    let anchor_altitude = altitude_m(planet_radius_m, proxy.anchor);
    let on_surface = surface_point(planet_radius_m, proxy, proxy.anchor, anchor_altitude, from_anchor);
    let direction = normalize(on_surface - reference);
#ifdef ABOVE
    // From above the ground hides nothing of the layer in front of it.
    let goes_down = proxy.from_above > 0u;
#ifdef INSIDE
    // Nor does it where rays start in the layer.
    return select(above_horizon(planet_radius_m, direction, reference), direction, goes_down || proxy.radius_m > 0.0);
#else
    return select(above_horizon(planet_radius_m, direction, reference), direction, goes_down);
#endif
#else
    return above_horizon(planet_radius_m, direction, reference);
#endif
}

/// The place of the octahedral square, 0...1, whose texel shows a point to rays that start at an origin.
fn place_on_surface(planet_radius_m: f32, proxy: Proxy, origin: vec3f, point: vec3f) -> vec2f {
    let direction = normalize(point - origin);
    let on_surface = surface_point(planet_radius_m, proxy, origin, altitude_m(planet_radius_m, origin), direction);
    return octahedral_from_direction(on_surface - proxy.anchor);
}
