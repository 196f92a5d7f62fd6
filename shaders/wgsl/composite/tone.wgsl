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

/// AgX (T. Sobotka, 2022) by B. Wrensch's fit ("Minimal AgX Implementation", 2023), with its Punchy look, sRGB-encoded: the
/// channels are mixed before the curve, so that what is bright loses colour instead of turning to another one. The curve is
/// one of log2 radiance between 2^-12.47 and 2^4.03; AGX_GAIN (tuned) brings the noon sky to where the ACES fit has it.
const AGX_GAIN: f32 = 2.0;
const AGX_MIN_EV: f32 = -12.47393;
const AGX_MAX_EV: f32 = 4.026069;

fn agx_encoded(radiance: vec3f) -> vec3f {
    let inset = mat3x3f(
        vec3f(0.842479062253094, 0.0423282422610123, 0.0423756549057051),
        vec3f(0.0784335999999992, 0.878468636469772, 0.0784336),
        vec3f(0.0792237451477643, 0.0791661274605434, 0.879142973793104),
    );
    let outset = mat3x3f(
        vec3f(1.19687900512017, -0.0528968517574562, -0.0529716355144438),
        vec3f(-0.0980208811401368, 1.15190312990417, -0.0980434501171241),
        vec3f(-0.0990297440797205, -0.0989611768448433, 1.15107367264116),
    );
    // The floor is far below AGX_MIN_EV and keeps the logarithm finite; the ceiling keeps products with the matrix so.
    let mixed = inset * clamp(AGX_GAIN * radiance, vec3f(1e-10), vec3f(1e30));
    let x = clamp((log2(mixed) - AGX_MIN_EV) / (AGX_MAX_EV - AGX_MIN_EV), vec3f(0.0), vec3f(1.0));
    let x2 = x * x;
    let x4 = x2 * x2;
    let curve = 15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x - 0.00232;
    let punchy = pow(max(curve, vec3f(0.0)), vec3f(1.35));
    let luma = dot(punchy, vec3f(0.2126, 0.7152, 0.0722));
    return saturate(outset * (luma + 1.4 * (punchy - luma)));
}

/// Khronos PBR Neutral, 2024: linear up to 0.8 - 0.04, above it compressed by the largest channel, which keeps the hue, and
/// mixed with white. NEUTRAL_GAIN (tuned) brings the noon sky to where the ACES fit has it.
const NEUTRAL_GAIN: f32 = 1.7;

fn neutral(radiance: vec3f) -> vec3f {
    let colour = NEUTRAL_GAIN * min(radiance, vec3f(1e30));
    let least = min(colour.x, min(colour.y, colour.z));
    let shifted = colour - select(0.04, least - 6.25 * least * least, least < 0.08);
    let peak = max(shifted.x, max(shifted.y, shifted.z));
    let start = 0.8 - 0.04;
    let room = 1.0 - start;
    let compressed = 1.0 - room * room / (max(peak, start) + room - start);
    let white = 1.0 - 1.0 / (0.15 * (peak - compressed) + 1.0);
    let shoulder = mix(shifted * (compressed / max(peak, start)), vec3f(compressed), white);
    return saturate(select(shoulder, shifted, peak < start));
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

/// The scene's curve, sRGB-encoded.
fn encoded(radiance: vec3f) -> vec3f {
#ifdef TONE_AGX
    return agx_encoded(radiance);
#else
#ifdef TONE_NEUTRAL
    return srgb_from_linear(neutral(radiance));
#else
    return srgb_from_linear(filmic(radiance));
#endif
#endif
}

/// Moves an encoded value by a fixed pattern of half an 8-bit step to either side before it is rounded, so that a smooth
/// sky has no bands and a resting picture does not flicker. place: the pixel, or the square of pixels that is moved as one.
fn dithered(encoded: vec3f, place: vec2u) -> vec3f {
    let noise = fract(52.9829189 * fract(dot(vec2f(place), vec2f(0.06711056, 0.00583715)))) - 0.5;
    return saturate(encoded + noise / 255.0);
}

/// As above, packed.
fn dithered_bytes(encoded: vec3f, place: vec2u) -> u32 {
    return pack4x8unorm(vec4f(dithered(encoded, place), 1.0));
}
