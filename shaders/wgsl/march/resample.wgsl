// Tiles about a new anchor filled from those about the old one: what the cache holds at a point of the proxy sphere stays there.
#import skycell::shell::altitude_m
#import skycell::scene::Proxy
#import skycell::march::LayerRadiance
#import skycell::texel_ray::{TILE_STRIDE, texel_in_level}
#import skycell::accumulate::accumulated
#ifdef DOMES
#import skycell::texel_ray::texel_direction
#import skycell::cached::{Kept, cached_part}
#import skycell::view::{PageTable, View}
#else
#import skycell::octahedral::direction_from_octahedral
#import skycell::surface::surface_point
#import skycell::cached::cached_radiance
#import skycell::view::PageTable
#endif

/// One tile about the new anchor.
struct ResampleWork {
    tile: vec2u,
    /// Texels along the whole octahedral square at the tile's level.
    texels_per_side: f32,
    /// Place on the working page that is written.
    place: u32,
    /// Where the old tiles are found.
    table: PageTable,
}

/// Old and new addresses of a part of a layer.
struct Resample {
    /// In the new frame.
    new_proxy: Proxy,
    /// In the old frame.
    old_proxy: Proxy,
    /// Where rays start about the new anchor, in the new frame (domes).
    reference: vec3f,
    planet_radius_m: f32,
    /// From the old frame's origin to the new one's, x and z, m.
    moved: vec2f,
    /// Most places of a search for what the old texels show (domes).
    parallax_steps: u32,
    /// Angle of a texel of the old tiles, rad (domes).
    texel_angle_rad: f32,
}

@group(0) @binding(0) var<uniform> resample: Resample;
@group(0) @binding(1) var<storage, read> work: array<ResampleWork>;
@group(0) @binding(2) var page_radiance: texture_storage_2d<rgba16float, write>;
@group(0) @binding(3) var page_distance: texture_storage_2d<r32float, write>;

/// A point at an altitude in a frame whose origin lies elsewhere on the ground. As `CellFrame::from_world`: x and z are moved,
/// and y is what keeps the altitude.
fn in_other_frame(planet_radius_m: f32, altitude: f32, position: vec3f, moved: vec2f) -> vec3f {
    let across = position.xz + moved;
    let r = planet_radius_m;
    let across_squared = dot(across, across);
    // Beyond a quarter of the planet there is no such point; the farthest one stands for it.
    let root = sqrt(max((r + altitude) * (r + altitude) - across_squared, 0.0));
    let y = (altitude * (2.0 * r + altitude) - across_squared) / (root + r);
    // In the same frame nothing is to be rounded.
    return vec3f(across.x, select(y, position.y, all(moved == vec2f(0.0))), across.y);
}

#ifdef DOMES
/// What is seen about the old anchor from where rays start about the new one, along a texel's ray: a dome's texels are no
/// places in the sky but directions.
fn shown_before(way: Resample, table: PageTable, square: vec2f) -> LayerRadiance {
    let r = way.planet_radius_m;
    let direction = texel_direction(r, way.new_proxy, way.reference, square);
    let along = way.reference + direction * way.new_proxy.radius_m;
    var eye: View;
    eye.altitude_m = altitude_m(r, way.reference);
    eye.position = in_other_frame(r, eye.altitude_m, way.reference, way.moved);
    eye.parallax_steps = way.parallax_steps;
    eye.pixel_angle_rad = way.texel_angle_rad;
    let toward = in_other_frame(r, altitude_m(r, along), along, way.moved) - eye.position;
    return cached_part(r, eye, Kept(way.old_proxy, table), normalize(toward), false);
}
#else
/// What the cache holds at a point of the surface.
fn shown_before(way: Resample, table: PageTable, square: vec2f) -> LayerRadiance {
    let r = way.planet_radius_m;
    let anchor = way.new_proxy.anchor;
    let on_surface = surface_point(r, way.new_proxy, anchor, altitude_m(r, anchor), direction_from_octahedral(square));
    // From above not all of the surface is on the shell.
    let altitude = select(way.new_proxy.altitude_m, altitude_m(r, on_surface), way.new_proxy.from_above > 0u);
    let before = in_other_frame(r, altitude, on_surface, way.moved);
#ifdef INSIDE
    // On a dome about rays that start in a layer: where the old dome is along the new texel's ray.
    if way.new_proxy.radius_m > 0.0 {
        let there = in_other_frame(r, altitude_m(r, on_surface), on_surface, way.moved);
        let starts = in_other_frame(r, altitude_m(r, way.reference), way.reference, way.moved);
        let direction = normalize(there - starts);
        let seen = surface_point(r, way.old_proxy, starts, altitude_m(r, starts), direction);
        return cached_radiance(table, seen - way.old_proxy.anchor, 0.0, false);
    }
#endif
    return cached_radiance(table, before - way.old_proxy.anchor, 0.0, false);
}
#endif

@compute @workgroup_size(8, 8, 1)
fn resample_tiles(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let item = work[group.z];
    let stored = group.xy * 8u + local.xy;
    let square = (texel_in_level(item.tile, stored) + 0.5) / item.texels_per_side;
    let held = shown_before(resample, item.table, square);
    let radiance = vec4f(held.single, held.octaves, held.ambient, held.transmittance);
    let target_texel = vec2u(0u, item.place * TILE_STRIDE) + stored;
    textureStore(page_radiance, target_texel, accumulated(vec4f(0.0), radiance, 1.0));
    textureStore(page_distance, target_texel, vec4f(held.opacity_distance_m, 0.0, 0.0, 0.0));
}
