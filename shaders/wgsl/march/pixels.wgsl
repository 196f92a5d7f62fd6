// One ray per pixel of one viewer: the screen-space renderer.
#import skycell::march::{scene, march_layer, whole, sample_offset, sample_start_fraction, LayerRadiance}
#import skycell::scene::Part
#import skycell::surface::dome_distance_m
#ifdef MOVED_START
#import skycell::surface::surface_point
#endif
#import skycell::view::{View, ListedRay, pixel_direction}
#ifdef RAY_LIST
#import skycell::march::{steps_taken, optical_depth_seen}
#endif
#ifdef COUNT_READS
#import skycell::density::{texture_reads, density_evaluations}
#endif
#ifdef WINDOW
#import skycell::march::{step_scale, refinement}
#import skycell::temporal::{Window, blue_noise_shift, blue_noise_index, shifted, packed}
#endif

/// Per layer and pixel: single, octaves, ambient, transmittance and the distance; for listed rays steps and optical depth
/// too.
#ifdef WINDOW
/// Per layer, slice and marched pixel: see temporal.wgsl.
@group(2) @binding(0) var<storage, read_write> ring: array<vec4u>;
#else
@group(2) @binding(0) var<storage, read_write> marched: array<f32>;
#endif
/// Texture reads so far, low and high word, and density evaluations likewise.
@group(2) @binding(1) var<storage, read_write> read_counter: array<atomic<u32>, 4>;
@group(3) @binding(0) var<uniform> view: View;
#ifdef WINDOW
@group(3) @binding(1) var<storage, read> blue_noise: array<u32>;
@group(3) @binding(2) var<uniform> window: Window;
#else
@group(3) @binding(1) var<storage, read> rays: array<ListedRay>;
#endif

#ifdef RAY_LIST
const VALUES: u32 = 7u;
#else
const VALUES: u32 = 5u;
#endif

/// How much of its layer a ray goes through: all of it, or what is near. That ends on a sphere about where the rays of the far
/// part start, so that nothing is in both or in neither, wherever the eye is in it.
fn marched_part(eye: View, origin: vec3f, direction: vec3f) -> Part {
    var part = whole(scene.layers[eye.layer]);
    let is_near = eye.reach_fade_m > 0.0;
    let end_m = dome_distance_m(eye.reach_m, origin - eye.reach_from, direction);
    part.far_m = select(part.far_m, end_m, is_near);
    part.full_far_m = select(part.full_far_m, end_m - eye.reach_fade_m, is_near);
    return part;
}

/// A ray that is marched.
struct MarchedRay {
    origin: vec3f,
    direction: vec3f,
}

/// The ray for what an eye sees in a direction.
fn marched_ray(eye: View, direction: vec3f) -> MarchedRay {
#ifdef MOVED_START
    // As a texel's: from where rays start through the place of the proxy's surface that the eye looks at.
    let seen = surface_point(scene.planet.radius_m, scene.proxies[eye.layer], eye.position, eye.altitude_m, direction);
    return MarchedRay(eye.start, normalize(seen - eye.start));
#else
    return MarchedRay(eye.position, direction);
#endif
}

#ifdef COUNT_READS
fn count() {
    let reads_before = atomicAdd(&read_counter[0], texture_reads);
    if reads_before + texture_reads < reads_before { atomicAdd(&read_counter[1], 1u); }
    let evaluations_before = atomicAdd(&read_counter[2], density_evaluations);
    if evaluations_before + density_evaluations < evaluations_before { atomicAdd(&read_counter[3], 1u); }
}
#endif

#ifdef WINDOW
/// Marches a strip of rows of one layer into the window's newest slice: one ray per marched pixel, at the frame's place in
/// it, and of its march the frame's part of the samples.
@compute @workgroup_size(8, 8, 1)
fn march_pixels(@builtin(global_invocation_id) id: vec3u) {
    let texel = vec2u(id.x, id.y + view.first_row);
    let size = vec2u(view.marched_width, view.marched_height);
    let newest = window.newest;
    let pixel = vec2f(texel) * f32(window.divisor) + window.slices[newest].pixel;
    let place = vec3f(window.slices[newest].within, window.slices[newest].segment);
    let spread = window.spread;
    step_scale = window.step_scale;
    refinement = window.refinement;
    let at = ((view.place * window.frames + newest) * size.y + texel.y) * size.x + texel.x;
    if texel.x >= size.x || texel.y >= size.y { return; }
    let moved = shifted(place, blue_noise_shift(blue_noise[blue_noise_index(pixel)]));
    let ray = marched_ray(view, pixel_direction(view, pixel + 0.5 + spread * (moved.xy - 0.5)));
    ring[at] = packed(march_layer(view.layer, marched_part(view, ray.origin, ray.direction), ray.origin, ray.direction, moved.z));
#ifdef COUNT_READS
    count();
#endif
}
#else
/// Adds one sample to a strip of rows of one layer.
@compute @workgroup_size(8, 8, 1)
fn march_pixels(@builtin(global_invocation_id) id: vec3u) {
    let pixel = vec2u(id.x, id.y + view.first_row);
    if pixel.x >= view.width || pixel.y >= view.height { return; }
    let offset = view.jitter * sample_offset(vec2f(pixel), view.sample_index);
#ifdef RAY_LIST
    let ray = rays[pixel.y * view.width + pixel.x];
    // Across and down a pixel.
    let origin = ray.origin + offset.x * view.right - offset.y * view.up;
    let direction = ray.direction;
#else
    let ray = marched_ray(view, pixel_direction(view, vec2f(pixel) + 0.5 + offset));
    let origin = ray.origin;
    let direction = ray.direction;
#endif
    // Without jitter every sample stands in the middle of its step.
    let start = mix(0.5, sample_start_fraction(vec2f(pixel), view.sample_index), view.jitter);
    let sample = march_layer(view.layer, marched_part(view, origin, direction), origin, direction, start);
    let at = ((view.place * view.height + pixel.y) * view.width + pixel.x) * VALUES;
    let weight = view.sample_weight;
#ifdef COUNT_READS
    count();
#endif
#ifdef RAY_LIST
    marched[at + 5u] = f32(steps_taken);
    marched[at + 6u] = optical_depth_seen;
#endif
    if view.sample_is_first == 1u {
        marched[at] = sample.single;
        marched[at + 1u] = sample.octaves;
        marched[at + 2u] = sample.ambient;
        marched[at + 3u] = sample.transmittance;
        marched[at + 4u] = sample.opacity_distance_m;
        return;
    }
    marched[at] = mix(marched[at], sample.single, weight);
    marched[at + 1u] = mix(marched[at + 1u], sample.octaves, weight);
    marched[at + 2u] = mix(marched[at + 2u], sample.ambient, weight);
    marched[at + 3u] = mix(marched[at + 3u], sample.transmittance, weight);
    marched[at + 4u] = mix(marched[at + 4u], sample.opacity_distance_m, weight);
}
#endif
