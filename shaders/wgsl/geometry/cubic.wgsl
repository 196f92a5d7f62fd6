#define_import_path skycell::cubic

// Cubic filters of D. Mitchell & A. Netravali, "Reconstruction Filters in Computer Graphics", 1988, with C = (1 - B) / 2: from
// that of Catmull & Rom (B = 0), which is sharp, to the B-spline (B = 1), which is wide. B is called softness here.

/// Softness of a read for a pixel that so many texels cover.
///
/// A pixel shows the mean over its square, of variance 1/12 pixel². Texels of width t pixels that are read with softness B show
/// t²/12 + t² B/3: the same for B = (1/t² - 1) / 4. Sharper ones are nearer to the screen-space renderer's pictures, since what
/// varies within a texel is lost anyway; the factor is tuned (`tests/tests/accuracy.rs`).
fn softness(texels_per_pixel: f32) -> f32 {
    return clamp(0.12 * (texels_per_pixel - 1.0), 0.0, 1.0);
}

/// Weights of the four texels around a place that lies `f` of the way from the second to the third.
fn cubic_weights(f: f32, soft: f32) -> vec4f {
    let g = 1.0 - f;
    let sharp = vec4f(f * (-0.5 + f * (1.0 - 0.5 * f)), 1.0 + f * f * (-2.5 + 1.5 * f), f * (0.5 + f * (2.0 - 1.5 * f)), f * f * (-0.5 + 0.5 * f));
    let spline = vec4f(g * g * g, 4.0 + f * f * (-6.0 + 3.0 * f), 4.0 + g * g * (-6.0 + 3.0 * g), f * f * f) / 6.0;
    return mix(sharp, spline, soft);
}
