#define_import_path skycell::colour_scale

/// Viridis (N. Smith, S. van der Walt, matplotlib 2015, CC0) by M. Zucker's polynomial of degree six (2019, CC0): evenly
/// spaced for the eye, in grey and for the colour-blind too. share is cut off at 0 and 1. sRGB-encoded.
fn viridis(share: f32) -> vec3f {
    let t = saturate(share);
    let c0 = vec3f(0.2777273272, 0.0054073445, 0.3340998053);
    let c1 = vec3f(0.1050930431, 1.4046135299, 1.3845901626);
    let c2 = vec3f(-0.3308618287, 0.2148475595, 0.0950951630);
    let c3 = vec3f(-4.6342304990, -5.7991009734, -19.3324409563);
    let c4 = vec3f(6.2282699363, 14.1799333668, 56.6905526007);
    let c5 = vec3f(4.7763849977, -13.7451453777, -65.3530326334);
    let c6 = vec3f(-5.4354558559, 4.6458526122, 26.3124352496);
    return saturate(c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * (c5 + t * c6))))));
}

/// Where there is nothing to show: a dark grey that is not on the scale.
const NOTHING: vec3f = vec3f(0.13, 0.13, 0.14);

/// Share of a logarithmic scale between two values; low > 0, value >= 0.
fn log_share(value: f32, low: f32, high: f32) -> f32 {
    return log(max(value, low) / low) / log(high / low);
}
