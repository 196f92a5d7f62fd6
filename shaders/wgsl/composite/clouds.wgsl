#define_import_path skycell::clouds
#import skycell::march::{LayerRadiance, distance_seen_m}

// Clouds alone, for a renderer that has a sky, a ground and things of its own. `skycell_protocol::clouds` tells the format.

/// Half floats of a pixel, two in a word: red and green, blue and transmittance, distance and nothing.
const CLOUDS_WORDS: u32 = 3u;
/// The largest half float.
const HALF_MAX: f32 = 65504.0;
/// The smallest normal one, 2^-14.
const HALF_NORMAL_MIN: f32 = 6.103515625e-5;
/// Half floats below that are whole multiples of 2^-24.
const HALF_STEPS: f32 = 16777216.0;

/// How far clouds hide what is behind them, and where they stand.
struct CloudsSeen {
    transmittance: f32,
    /// 1 - transmittance, without its cancellation where clouds are thin.
    opacity: f32,
    /// Distance of what is seen times its opacity, m.
    opacity_distance_m: f32,
}

fn no_clouds_seen() -> CloudsSeen {
    return CloudsSeen(1.0, 0.0, 0.0);
}

/// A layer in front of what is behind it.
fn layer_before(cloud: LayerRadiance, behind: CloudsSeen) -> CloudsSeen {
    let opacity = 1.0 - cloud.transmittance;
    let distance_m = distance_seen_m(cloud.opacity_distance_m, cloud.transmittance);
    return CloudsSeen(
        cloud.transmittance * behind.transmittance,
        opacity + cloud.transmittance * behind.opacity,
        opacity * distance_m + cloud.transmittance * behind.opacity_distance_m,
    );
}

/// The largest power of two that is no greater than a positive number: its bits without those of the fraction.
fn power_of_two_below(value: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(value) & 0x7f800000u);
}

/// A pixel as it is told.
struct CloudsPixel {
    /// Premultiplied by opacity and pre-exposed.
    radiance: vec3f,
    transmittance: f32,
    distance_km: f32,
}

fn clouds_pixel(radiance: vec3f, pre_exposure: f32, seen: CloudsSeen) -> CloudsPixel {
    let distance_m = select(0.0, seen.opacity_distance_m / max(seen.opacity, 1e-12), seen.opacity > 0.0);
    return CloudsPixel(radiance * pre_exposure, seen.transmittance, distance_m * 1e-3);
}

/// The half float next to a number; of two as near the even one. What is below 0 or no number is 0, what is too large the
/// largest. WGSL lets a device round either way when it packs a number; one that is a half float already has no choice.
fn half_nearest(value: f32) -> f32 {
    // A comparison with what is no number is false.
    let bounded = select(0.0, min(value, HALF_MAX), value > 0.0);
    let bits = bitcast<u32>(bounded);
    let normal = bitcast<f32>((bits + 0xfffu + ((bits >> 13u) & 1u)) & 0xffffe000u);
    let small = round(bounded * HALF_STEPS) / HALF_STEPS;
    return select(normal, small, bounded < HALF_NORMAL_MIN);
}

fn packed_clouds(pixel: CloudsPixel) -> array<u32, 3> {
    return array<u32, 3>(
        pack2x16float(vec2f(half_nearest(pixel.radiance.x), half_nearest(pixel.radiance.y))),
        pack2x16float(vec2f(half_nearest(pixel.radiance.z), half_nearest(min(pixel.transmittance, 1.0)))),
        pack2x16float(vec2f(half_nearest(pixel.distance_km), 0.0)),
    );
}

fn unpacked_clouds(words: array<u32, 3>) -> CloudsPixel {
    let first = unpack2x16float(words[0]);
    let second = unpack2x16float(words[1]);
    return CloudsPixel(vec3f(first, second.x), second.y, unpack2x16float(words[2]).x);
}

/// Clouds on the way from `a`, whose light times a_scale is pre-exposed as that of `b`, to `b`.
fn mixed_clouds(a: CloudsPixel, a_scale: f32, b: CloudsPixel, share: f32) -> CloudsPixel {
    let opacity_a = (1.0 - share) * (1.0 - a.transmittance);
    let opacity_b = share * (1.0 - b.transmittance);
    let opacity = opacity_a + opacity_b;
    // Where neither hides anything that a half float could tell, the farther one.
    let distance_km = (opacity_a * a.distance_km + opacity_b * b.distance_km) / max(opacity, 1e-12);
    return CloudsPixel(
        mix(a.radiance * a_scale, b.radiance, share),
        mix(a.transmittance, b.transmittance, share),
        select(max(a.distance_km, b.distance_km), distance_km, opacity > 0.0),
    );
}
