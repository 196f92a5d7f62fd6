// Tiles about a new anchor filled from those about the old one: what the cache holds at a point of the proxy sphere stays there.
#import skycell::shell::altitude_m
#import skycell::proxy::distance_to_proxy_m
#import skycell::scene::Proxy
#import skycell::octahedral::direction_from_octahedral
#import skycell::texel_ray::{TILE_STRIDE, texel_in_level}
#import skycell::accumulate::accumulated
#import skycell::cached::cached_radiance
#import skycell::view::PageTable

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

/// A layer's old and new addresses.
struct Resample {
    /// In the new frame.
    new_anchor: vec3f,
    planet_radius_m: f32,
    /// In the old frame.
    old_anchor: vec3f,
    proxy_altitude_m: f32,
    /// From the old frame's origin to the new one's, x and z, m.
    moved: vec2f,
    /// As those of the proxy.
    from_above: u32,
    least_m: f32,
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

@compute @workgroup_size(8, 8, 1)
fn resample_tiles(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let layer = resample;
    let item = work[group.z];
    let stored = group.xy * 8u + local.xy;
    let square = (texel_in_level(item.tile, stored) + 0.5) / item.texels_per_side;
    let from_anchor = direction_from_octahedral(square);
    var proxy: Proxy;
    proxy.anchor = layer.new_anchor;
    proxy.altitude_m = layer.proxy_altitude_m;
    proxy.from_above = layer.from_above;
    proxy.least_m = layer.least_m;
    let on_surface = layer.new_anchor + from_anchor * distance_to_proxy_m(layer.planet_radius_m, proxy, layer.new_anchor, from_anchor);
    // From above not all of the surface is on the sphere.
    let altitude = select(layer.proxy_altitude_m, altitude_m(layer.planet_radius_m, on_surface), layer.from_above > 0u);
    let before = in_other_frame(layer.planet_radius_m, altitude, on_surface, layer.moved);
    let held = cached_radiance(item.table, before - layer.old_anchor, false);
    let radiance = vec4f(held.single, held.octaves, held.ambient, held.transmittance);
    let target_texel = vec2u(0u, item.place * TILE_STRIDE) + stored;
    textureStore(page_radiance, target_texel, accumulated(vec4f(0.0), radiance, 1.0));
    textureStore(page_distance, target_texel, vec4f(held.opacity_distance_m, 0.0, 0.0, 0.0));
}
