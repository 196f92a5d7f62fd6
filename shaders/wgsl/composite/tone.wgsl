#define_import_path skycell::tone

/// Spectral irradiance of the sun above the atmosphere at the three channels, relative to its mean: what looks white.
/// The reference solar spectrum (ASTM G173) at 680, 550 and 440 nm.
const WHITE: vec3f = vec3f(0.8444, 1.0602, 1.0954);

/// Radiance as the eye sees it that takes sunlight for white.
fn balanced(radiance: vec3f) -> vec3f {
    return radiance / WHITE;
}

/// Filmic curve: K. Narkowicz's fit of the ACES reference transform, 2015. radiance >= 0, so the denominator is > 0.14.
fn filmic(radiance: vec3f) -> vec3f {
    let numerator = radiance * (2.51 * radiance + 0.03);
    let denominator = radiance * (2.43 * radiance + 0.59) + 0.14;
    return saturate(numerator / denominator);
}

/// sRGB's transfer function (IEC 61966-2-1) for linear in 0...1 by three square roots instead of a power, which costs
/// five times as much on a CPU. The coefficients are a least-squares fit; the error is below 1/100 of an 8-bit step
/// (tested).
fn srgb_from_linear(linear: vec3f) -> vec3f {
    let root = sqrt(linear);
    let fourth = sqrt(root);
    let eighth = sqrt(fourth);
    let curve = 0.65398588 * root + 0.68870963 * fourth - 0.31847071 * eighth - 0.02018783 * linear - 0.00406823;
    return select(curve, 12.92 * linear, linear <= vec3f(0.0031308));
}

/// Moves an encoded value by a fixed pattern of half an 8-bit step to either side before it is rounded, so that a smooth
/// sky has no bands and a resting picture does not flicker.
fn dithered(encoded: vec3f, pixel: vec2u) -> vec3f {
    let noise = fract(52.9829189 * fract(dot(vec2f(pixel), vec2f(0.06711056, 0.00583715)))) - 0.5;
    return saturate(encoded + noise / 255.0);
}

/// As above, packed.
fn dithered_bytes(encoded: vec3f, pixel: vec2u) -> u32 {
    return pack4x8unorm(vec4f(dithered(encoded, pixel), 1.0));
}
