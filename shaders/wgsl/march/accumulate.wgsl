#define_import_path skycell::accumulate

/// Largest value that is stored: half floats end at 65 504, and the phases of unscaled octaves can exceed that.
const STORED_MAX: f32 = 6e4;

/// Rounded to the nearest value with a half float's eleven digits. Drivers may cut digits off where they store, and a mean
/// that is cut off with every sample becomes darker with every sample.
fn half_rounded(value: vec4f) -> vec4f {
    return bitcast<vec4f>((bitcast<vec4u>(value) + 0x1000u) & vec4u(0xffffe000u));
}

/// What a texel holds after one sample more: the old value moved by a weight towards the new one; a weight of 1 replaces.
/// Nothing is ever taken out of a sum, so rounding cannot pile up: each step forgets a share of all earlier errors.
fn accumulated(old: vec4f, sample: vec4f, weight: f32) -> vec4f {
    let bounded = min(sample, vec4f(STORED_MAX));
    // select, not mix with weight 1: whatever a fresh slot holds, NaN included, must not leak in.
    return half_rounded(select(mix(old, bounded, weight), bounded, weight >= 1.0));
}
