// The sliding window of the screen-space renderer: what its frames have marched, summed up anew for the shown camera.
// Nothing is ever added to a running sum and taken out again, so there is nothing that could drift.
#import skycell::march::{LayerRadiance, distance_seen_m}
#import skycell::view::{View, pixel_direction}
#import skycell::temporal::{Window, WindowSlice, reprojected, window_weight, parallax_weight, unpacked}

/// Per layer and pixel: single, octaves, ambient, transmittance and the distance.
@group(2) @binding(0) var<storage, read_write> marched: array<f32>;
/// Per layer, slice and marched pixel: see temporal.wgsl.
@group(2) @binding(1) var<storage, read_write> ring: array<vec4u>;
@group(3) @binding(0) var<uniform> view: View;
@group(3) @binding(2) var<uniform> window: Window;

/// How different a gap's filling may be in transmittance from the nearest sample.
const EDGE_TRANSMITTANCE: f32 = 0.25;

/// A sum of weighted samples. Opacity is summed in the place of transmittance, so that nothing weighs nothing.
struct Sum {
    /// Single, octaves, ambient, opacity.
    light: vec4f,
    opacity_distance_m: f32,
    weight: f32,
}

fn added(sum: Sum, cloud: LayerRadiance, weight: f32) -> Sum {
    let light = vec4f(cloud.single, cloud.octaves, cloud.ambient, 1.0 - cloud.transmittance);
    return Sum(sum.light + weight * light, sum.opacity_distance_m + weight * cloud.opacity_distance_m, sum.weight + weight);
}

fn store(id: vec3u, size: vec2u, mean: Sum) {
    if id.x >= size.x || id.y >= size.y { return; }
    let at = ((id.z * size.y + id.y) * size.x + id.x) * 5u;
    marched[at] = mean.light.x;
    marched[at + 1u] = mean.light.y;
    marched[at + 2u] = mean.light.z;
    marched[at + 3u] = saturate(1.0 - mean.light.w);
    marched[at + 4u] = mean.opacity_distance_m;
}

#ifdef WINDOW_AT_REST
/// The window of a camera at rest: the mean of the samples that stand in the pixel, nothing else.
@compute @workgroup_size(8, 8, 1)
fn resolve_window(@builtin(global_invocation_id) id: vec3u) {
    let size = vec2u(view.width, view.height);
    let marched_size = vec2u(view.marched_width, view.marched_height);
    let divisor = window.divisor;
    let count = window.slices_per_pixel;
    let slice_length = marched_size.x * marched_size.y;
    let start = id.z * window.frames * slice_length;
    let texel = min(id.xy / divisor, marched_size - 1u);
    let within = id.xy % divisor;
    let place = (within.y * divisor + within.x) * count;
    var sum = Sum(vec4f(0.0), 0.0, 0.0);
    for (var k = 0u; k < count; k += 1u) {
        let slice = window.order[(place + k) / 4u][(place + k) % 4u];
        sum = added(sum, unpacked(ring[start + slice * slice_length + texel.y * marched_size.x + texel.x]), 1.0);
    }
    let scale = 1.0 / f32(count);
    store(id, size, Sum(scale * sum.light, scale * sum.opacity_distance_m, 1.0));
}
#else
/// What a pixel's taps have in common.
struct Pixel {
    /// Its middle.
    at: vec2f,
    /// From the eye to what is seen of the layer.
    point: vec3f,
    distance_m: f32,
    eye: vec3f,
    size: vec2f,
    marched_size: vec2i,
    divisor: f32,
    sharpness: f32,
    layer: u32,
}

/// The sum with the sample of a slice that is nearest to what the pixel shows. `first` is the slice's place in the ring.
fn tapped(sum: Sum, slice: WindowSlice, pixel: Pixel, first: u32) -> Sum {
    let drifts = select(slice.drift[0], slice.drift[1], pixel.layer >= 2u);
    let drift = select(drifts.xy, drifts.zw, (pixel.layer & 1u) == 1u);
    let moved = pixel.eye - slice.position;
    let place = reprojected(slice.forward, slice.across, slice.upward, pixel.size, pixel.point + moved - vec3f(drift.x, 0.0, drift.y));
    let is_same = slice.is_same_view == 1u;
    let at = select(place.xy, pixel.at, is_same);
    let is_inside = is_same || (place.z > 0.0 && all(at >= vec2f(0.0)) && all(at < pixel.size));
    let texel = clamp(vec2i(floor((at - 0.5 - slice.pixel) / pixel.divisor + 0.5)), vec2i(0), pixel.marched_size - 1);
    // Samples count as the middles of their pixels: where they are in them is lost in a pixel's mean anyway.
    let offset = at - (vec2f(texel) * pixel.divisor + slice.pixel + 0.5);
    let parallax = parallax_weight(length(moved) + slice.start_moved_m, pixel.distance_m);
    let weight = select(0.0, slice.weight * parallax * window_weight(offset, pixel.sharpness), is_inside);
    return added(sum, unpacked(ring[first + u32(texel.y * pixel.marched_size.x + texel.x)]), weight);
}

/// The window from any cameras.
@compute @workgroup_size(8, 8, 1)
fn resolve_window(@builtin(global_invocation_id) id: vec3u) {
    let shown_size = vec2u(view.width, view.height);
    let marched_size = vec2i(i32(view.marched_width), i32(view.marched_height));
    let direction = pixel_direction(view, vec2f(id.xy) + 0.5);
    let newest = window.newest;
    let newest_pixel = window.newest_pixel;
    let fills_gaps = select(0, 4, window.fills_gaps == 1u);
    let layer = id.z;
    let slice_length = u32(marched_size.x * marched_size.y);
    let start = layer * window.frames * slice_length;
    let eye = view.position;
    let divisor = f32(window.divisor);
    let sharpness = window.sharpness;
    let shown_at = vec2f(id.xy) + 0.5;
    let newest_start = start + newest * slice_length;
    // What the newest slice has around the pixel: how far away the layer is.
    let from_samples = (shown_at - 0.5 - newest_pixel) / divisor;
    let nearest = clamp(vec2i(floor(from_samples + 0.5)), vec2i(0), marched_size - 1);
    let near_cloud = unpacked(ring[newest_start + u32(nearest.y * marched_size.x + nearest.x)]);
    let distance_m = distance_seen_m(near_cloud.opacity_distance_m, near_cloud.transmittance);
    let pixel = Pixel(shown_at, direction * distance_m, distance_m, eye, vec2f(shown_size), marched_size, divisor, sharpness, layer);

    // Written out with constant indices: software drivers read uniform arrays at others lane by lane.
    var sum = Sum(vec4f(0.0), 0.0, 0.0);
    sum = tapped(sum, window.slices[0], pixel, start + 0u * slice_length);
#if WINDOW_FRAMES >= 2
    sum = tapped(sum, window.slices[1], pixel, start + 1u * slice_length);
#endif
#if WINDOW_FRAMES >= 3
    sum = tapped(sum, window.slices[2], pixel, start + 2u * slice_length);
#endif
#if WINDOW_FRAMES >= 4
    sum = tapped(sum, window.slices[3], pixel, start + 3u * slice_length);
#endif
#if WINDOW_FRAMES >= 5
    sum = tapped(sum, window.slices[4], pixel, start + 4u * slice_length);
#endif
#if WINDOW_FRAMES >= 6
    sum = tapped(sum, window.slices[5], pixel, start + 5u * slice_length);
#endif
#if WINDOW_FRAMES >= 7
    sum = tapped(sum, window.slices[6], pixel, start + 6u * slice_length);
#endif
#if WINDOW_FRAMES >= 8
    sum = tapped(sum, window.slices[7], pixel, start + 7u * slice_length);
#endif
#if WINDOW_FRAMES >= 9
    sum = tapped(sum, window.slices[8], pixel, start + 8u * slice_length);
#endif
#if WINDOW_FRAMES >= 10
    sum = tapped(sum, window.slices[9], pixel, start + 9u * slice_length);
#endif
#if WINDOW_FRAMES >= 11
    sum = tapped(sum, window.slices[10], pixel, start + 10u * slice_length);
#endif
#if WINDOW_FRAMES >= 12
    sum = tapped(sum, window.slices[11], pixel, start + 11u * slice_length);
#endif
#if WINDOW_FRAMES >= 13
    sum = tapped(sum, window.slices[12], pixel, start + 12u * slice_length);
#endif
#if WINDOW_FRAMES >= 14
    sum = tapped(sum, window.slices[13], pixel, start + 13u * slice_length);
#endif
#if WINDOW_FRAMES >= 15
    sum = tapped(sum, window.slices[14], pixel, start + 14u * slice_length);
#endif
#if WINDOW_FRAMES >= 16
    sum = tapped(sum, window.slices[15], pixel, start + 15u * slice_length);
#endif

    // Joint bilateral filling: the four marched pixels around in the newest slice, by their distance and by how much they
    // let through beside what the window knows of this pixel.
    // How much the window knows: all where a quarter of a sample's weight is near.
    let certain = select(1.0, saturate(4.0 * sum.weight), fills_gaps > 0);
    let share = certain * certain * (3.0 - 2.0 * certain);
    let known = select(near_cloud.transmittance, 1.0 - sum.light.w / max(sum.weight, 1e-20), sum.weight > 1e-3);
    let corner = vec2i(floor(from_samples));
    var around = Sum(vec4f(0.0), 0.0, 0.0);
    for (var k = 0; k < fills_gaps; k += 1) {
        let texel = clamp(corner + vec2i(k & 1, k >> 1u), vec2i(0), marched_size - 1);
        let apart = max(1.0 - abs(from_samples - vec2f(texel)), vec2f(0.02));
        let cloud = unpacked(ring[newest_start + u32(texel.y * marched_size.x + texel.x)]);
        let edge = share * (cloud.transmittance - known) / EDGE_TRANSMITTANCE;
        around = added(around, cloud, apart.x * apart.y / (1.0 + edge * edge));
    }
    let known_scale = share / max(sum.weight, 1e-20);
    let around_scale = (1.0 - share) / max(around.weight, 1e-20);
    let light = sum.light * known_scale + around.light * around_scale;
    store(id, shown_size, Sum(light, sum.opacity_distance_m * known_scale + around.opacity_distance_m * around_scale, 1.0));
}
#endif
