// One picture for one viewer: the layers of its cell, back to front, over sky and ground.
#import skycell::march::{scene, LayerRadiance}
#import skycell::shell::shell_roots
#import skycell::shade::{Background, background, layer_over}
#import skycell::tone::{balanced, filmic, srgb_from_linear, dithered_bytes}
#import skycell::view::{View, pixel_direction}
#ifndef SCREEN_SPACE
#import skycell::cached::cached_radiance
#endif

@group(3) @binding(0) var<uniform> view: View;
#ifdef LINEAR_OUTPUT
@group(3) @binding(1) var<storage, read_write> picture: array<vec4f>;
#else
@group(3) @binding(1) var<storage, read_write> picture: array<u32>;
#endif
#ifdef SCREEN_SPACE
/// Per layer and pixel: single, octaves, ambient, transmittance and the distance, as marched by march_pixels.
@group(2) @binding(0) var<storage, read> marched: array<f32>;
#endif

/// What the viewer sees of one layer along a direction.
fn layer_radiance(layer_index: u32, pixel: vec2u, direction: vec3f, on_ground: bool) -> LayerRadiance {
#ifdef SCREEN_SPACE
    let at = ((layer_index * view.height + pixel.y) * view.width + pixel.x) * 5u;
    return LayerRadiance(marched[at], marched[at + 1u], marched[at + 2u], marched[at + 3u], marched[at + 4u]);
#else
    let layer = scene.layers[layer_index];
    let sphere = shell_roots(scene.planet.radius_m, layer.proxy_altitude_m, view.position, view.altitude_m, direction);
    let on_sphere = view.position + direction * max(sphere.far_m, 1e-3);
    let table = view.tables[layer_index];
    var cloud = cached_radiance(table.offset, table.tiles_per_side, on_sphere - layer.anchor);
    // Texels straddle the horizon; the viewer's own ray decides whether the ground hides the layer.
    if on_ground { cloud = LayerRadiance(0.0, 0.0, 0.0, 1.0, 0.0); }
    return cloud;
#endif
}

/// Radiance that reaches the viewer through the middle of a pixel.
fn pixel_radiance(pixel: vec2u) -> vec3f {
    let direction = pixel_direction(view, vec2f(pixel) + 0.5);
    let back = background(view.position, view.altitude_m, direction);
    var radiance = back.radiance;
    // Layers are sorted by altitude; from below the highest lies farthest back. Written out with constant indices: a
    // software driver reads uniforms at a computed index lane by lane, which costs more than all else here.
#if LAYERS >= 4
    radiance = layer_over(back, radiance, layer_radiance(3u, pixel, direction, back.on_ground), scene.layers[3].air_extinction_per_m);
#endif
#if LAYERS >= 3
    radiance = layer_over(back, radiance, layer_radiance(2u, pixel, direction, back.on_ground), scene.layers[2].air_extinction_per_m);
#endif
#if LAYERS >= 2
    radiance = layer_over(back, radiance, layer_radiance(1u, pixel, direction, back.on_ground), scene.layers[1].air_extinction_per_m);
#endif
#if LAYERS >= 1
    radiance = layer_over(back, radiance, layer_radiance(0u, pixel, direction, back.on_ground), scene.layers[0].air_extinction_per_m);
#endif
    return radiance;
}

@compute @workgroup_size(16, 16, 1)
fn composite(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= view.width || id.y >= view.height { return; }
    let radiance = pixel_radiance(id.xy);
#ifdef LINEAR_OUTPUT
    picture[id.y * view.width + id.x] = vec4f(radiance, 1.0);
#else
    picture[id.y * view.width + id.x] = dithered_bytes(srgb_from_linear(filmic(balanced(radiance) * scene.exposure)), id.xy);
#endif
}
