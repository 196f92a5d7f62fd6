// The picture of one view cell on its way to that of another, for a viewer who goes from one to the other.

#ifdef CLOUDS_ALONE
#import skycell::clouds::{CLOUDS_WORDS, mixed_clouds, packed_clouds, unpacked_clouds}
#endif

struct Fade {
    /// Share of the new picture, 0...1.
    share: f32,
    width: u32,
    height: u32,
    /// Squares of 2^dither_shift pixels are rounded by the same threshold.
    dither_shift: u32,
    /// Columns of one eye's part of the picture.
    eye_width: u32,
    /// What the light of the old picture is multiplied by to be told as that of the new one (clouds alone).
    old_scale: f32,
}

@group(0) @binding(0) var<uniform> fade: Fade;
@group(0) @binding(1) var<storage, read> old_picture: array<u32>;
/// The new picture, which becomes the mix.
@group(0) @binding(2) var<storage, read_write> picture: array<u32>;

/// Where a mix between two 8-bit steps turns to the upper one: a fixed pattern in 0...1. With one threshold for all, pixels of
/// pictures that differ by a step would turn all at once. Not the pattern that either picture was dithered by.
fn threshold(place: vec2u) -> f32 {
    return fract(52.9829189 * fract(dot(vec2f(place.yx) + vec2f(11.5, 47.5), vec2f(0.06711056, 0.00583715))));
}

/// Bytes on the way from `a` to `b`; each of them at its end.
fn mixed(a: u32, b: u32, share: f32, threshold: f32) -> u32 {
    let from_bytes = round(unpack4x8unorm(a) * 255.0);
    let to_bytes = round(unpack4x8unorm(b) * 255.0);
    return pack4x8unorm(floor(mix(from_bytes, to_bytes, share) + min(threshold, 0.999)) / 255.0);
}

@compute @workgroup_size(16, 8, 1)
fn fade_pictures(@builtin(global_invocation_id) id: vec3u) {
    let way = fade;
    if id.x >= way.width || id.y >= way.height { return; }
#ifdef CLOUDS_ALONE
    let at = (id.y * way.width + id.x) * CLOUDS_WORDS;
    let old = unpacked_clouds(array<u32, 3>(old_picture[at], old_picture[at + 1u], old_picture[at + 2u]));
    let late = unpacked_clouds(array<u32, 3>(picture[at], picture[at + 1u], picture[at + 2u]));
    let words = packed_clouds(mixed_clouds(old, way.old_scale, late, way.share));
    picture[at] = words[0];
    picture[at + 1u] = words[1];
    picture[at + 2u] = words[2];
#else
    let at = id.y * way.width + id.x;
    // Both eyes have the same pattern, which would else float in front of the sky or behind it.
    let pixel = vec2u(id.x % way.eye_width, id.y);
    picture[at] = mixed(old_picture[at], picture[at], way.share, threshold(pixel >> vec2u(way.dither_shift)));
#endif
}
