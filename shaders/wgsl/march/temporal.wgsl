#define_import_path skycell::temporal
#import skycell::march::LayerRadiance

/// Most frames of a temporal window.
const WINDOW_FRAMES_MAX: u32 = 16u;
/// Columns and rows of the blue noise.
const BLUE_NOISE_SIZE: u32 = 64u;

/// One frame of the window: the camera that it was marched from and where its samples stand.
struct WindowSlice {
    /// Eye, m.
    position: vec3f,
    /// Share of a step by which all samples are moved: the frame's part of the steps.
    segment: f32,
    forward: vec3f,
    /// 1: the camera is the shown one's; nothing is reprojected.
    is_same_view: u32,
    /// Half the picture's width over its square: with a direction at distance 1, its place in -1...1.
    across: vec3f,
    /// 0: the slice holds nothing that can be shown.
    weight: f32,
    upward: vec3f,
    /// How far from where the shown rays start its own did, m, where that is not the eye.
    start_moved_m: f32,
    /// Which of a marched pixel's picture pixels has the sample, and where in it, 0...1.
    pixel: vec2f,
    within: vec2f,
    /// By how much the clouds of each layer have moved since, m: x and z of two layers each.
    drift: array<vec4f, 2>,
}

/// The sliding window of one viewer.
struct Window {
    slices: array<WindowSlice, 16>,
    /// Slices in the ring.
    frames: u32,
    /// The slice that is marched, or the newest one.
    newest: u32,
    /// Picture pixels along a marched pixel.
    divisor: u32,
    /// 1: gaps are filled from the marched pixels around them in the newest slice.
    fills_gaps: u32,
    /// 1 / (2 σ²) of the weight of a sample by its distance in picture pixels.
    sharpness: f32,
    /// How many steps of the whole march one step of a frame is long.
    step_scale: f32,
    /// Into how many parts such a step is cut where cloud begins.
    refinement: f32,
    /// Share of a picture pixel over which its samples are spread: 0 where it has but one, which stands in the middle.
    spread: f32,
    /// Which of a marched pixel's picture pixels the newest slice has samples of.
    newest_pixel: vec2f,
    /// How many slices have samples of one and the same picture pixel.
    slices_per_pixel: u32,
    pad_end: u32,
    /// Slices by the picture pixel that they have samples of, row by row.
    order: array<vec4u, 4>,
}

/// Blue noise of a picture pixel: x and y in the pixel, depth, each 0...1. Three masks of 8 bits in one word.
fn blue_noise_shift(word: u32) -> vec3f {
    return (vec3f(f32(word & 255u), f32((word >> 8u) & 255u), f32((word >> 16u) & 255u)) + 0.5) / 256.0;
}

/// Index of a picture pixel's blue noise; pixels left of and above the picture have some too.
fn blue_noise_index(pixel: vec2f) -> u32 {
    let size = f32(BLUE_NOISE_SIZE);
    let place = vec2u(pixel - floor(pixel / size) * size);
    return min(place.y, BLUE_NOISE_SIZE - 1u) * BLUE_NOISE_SIZE + min(place.x, BLUE_NOISE_SIZE - 1u);
}

/// A place or a part of a step moved by a shift, going round: a pattern that is spread evenly stays so (the toroidal shift
/// of R. Cranley and T. Patterson, 1976).
fn shifted(place: vec3f, shift: vec3f) -> vec3f {
    return fract(place + shift);
}

/// Where a point of the frame is in a slice's picture, in pixels from its upper left corner; z is 1 when it is in front of
/// that camera, else 0.
fn reprojected(forward: vec3f, across: vec3f, upward: vec3f, size: vec2f, point_from_eye: vec3f) -> vec3f {
    let depth = dot(point_from_eye, forward);
    // Behind the camera or beside it nothing is divided by what may be 0.
    let is_in_front = depth > 1e-4 * length(point_from_eye);
    let ndc = vec2f(dot(point_from_eye, across), -dot(point_from_eye, upward)) / select(1.0, depth, is_in_front);
    return vec3f((0.5 * ndc + 0.5) * size, select(0.0, 1.0, is_in_front));
}

/// Weight of a sample that is a distance away, in picture pixels: Gaussian, cut off where it no longer counts.
fn window_weight(offset: vec2f, sharpness: f32) -> f32 {
    return exp(-min(dot(offset, offset) * sharpness, 60.0));
}

/// How much parallax takes from what an eye elsewhere saw: 1 without, half where the cloud is seen from a fiftieth of its
/// distance beside. A cloud's near parts hide others by then.
fn parallax_weight(moved_m: f32, distance_m: f32) -> f32 {
    let angle = 50.0 * moved_m / max(distance_m, 1.0);
    return 1.0 / (1.0 + angle * angle);
}

/// Marched light in 16 bytes: transmittance in 16 bits of even steps, distance in the upper 16 bits of a float (to a part
/// in 512: it says where to look and how much haze there is), the rest in full.
fn packed(cloud: LayerRadiance) -> vec4u {
    let transmittance = u32(saturate(cloud.transmittance) * 65535.0 + 0.5);
    let distance = (bitcast<u32>(cloud.opacity_distance_m) + 0x8000u) & 0xffff0000u;
    return vec4u(bitcast<u32>(cloud.single), bitcast<u32>(cloud.octaves), bitcast<u32>(cloud.ambient), distance | transmittance);
}

fn unpacked(words: vec4u) -> LayerRadiance {
    return LayerRadiance(
        bitcast<f32>(words.x),
        bitcast<f32>(words.y),
        bitcast<f32>(words.z),
        f32(words.w & 0xffffu) / 65535.0,
        bitcast<f32>(words.w & 0xffff0000u),
    );
}
