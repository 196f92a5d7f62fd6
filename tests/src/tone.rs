//! The renderer's tone curve in f64, so that pictures from different sources are compared as they would be shown.

use image::{Rgb, RgbImage};

/// Spectral irradiance of the sun at the three channels relative to its mean: ASTM G173 at 680, 550 and 440 nm.
const WHITE: [f64; 3] = [0.8444, 1.0602, 1.0954];
/// Factor from radiance to the curve at 0 EV.
const EXPOSURE: f64 = 3.6;

/// K. Narkowicz's fit of the ACES reference transform, 2015.
#[must_use]
pub fn filmic(x: f64) -> f64 {
    ((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)).clamp(0.0, 1.0)
}

/// A vector times a matrix that is given by columns, as WGSL writes them.
fn product(columns: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|row| (0..3).map(|column| columns[column][row] * v[column]).sum())
}

/// T. Sobotka's AgX, 2022, by B. Wrensch's fit ("Minimal AgX Implementation", 2023) with its Punchy look, of twice the
/// radiance; sRGB-encoded.
#[must_use]
pub fn agx(radiance: [f64; 3]) -> [f64; 3] {
    const INSET: [[f64; 3]; 3] = [
        [0.842479062253094, 0.0423282422610123, 0.0423756549057051],
        [0.0784335999999992, 0.878468636469772, 0.0784336],
        [0.0792237451477643, 0.0791661274605434, 0.879142973793104],
    ];
    const OUTSET: [[f64; 3]; 3] = [
        [1.19687900512017, -0.0528968517574562, -0.0529716355144438],
        [-0.0980208811401368, 1.15190312990417, -0.0980434501171241],
        [-0.0990297440797205, -0.0989611768448433, 1.15107367264116],
    ];
    let looked = product(INSET, radiance.map(|c| (2.0 * c).max(1e-10))).map(|c| {
        let x = ((c.log2() + 12.47393) / (4.026069 + 12.47393)).clamp(0.0, 1.0);
        let curve = 15.5 * x.powi(6) - 40.14 * x.powi(5) + 31.96 * x.powi(4) - 6.868 * x.powi(3)
            + 0.4298 * x * x
            + 0.1191 * x
            - 0.00232;
        curve.max(0.0).powf(1.35)
    });
    let luma = 0.2126 * looked[0] + 0.7152 * looked[1] + 0.0722 * looked[2];
    product(OUTSET, looked.map(|c| luma + 1.4 * (c - luma))).map(|c| c.clamp(0.0, 1.0))
}

/// Khronos PBR Neutral (specification of 2024) of 1.7 times the radiance; linear.
#[must_use]
pub fn neutral(radiance: [f64; 3]) -> [f64; 3] {
    let [r, g, b] = radiance.map(|c| 1.7 * c);
    let x = r.min(g).min(b);
    let offset = if x < 0.08 { x - 6.25 * x * x } else { 0.04 };
    let colour = [r - offset, g - offset, b - offset];
    let peak = colour[0].max(colour[1]).max(colour[2]);
    if peak < 0.76 {
        return colour.map(|c| c.clamp(0.0, 1.0));
    }
    let new_peak = 1.0 - 0.24 * 0.24 / (peak + 0.24 - 0.76);
    let g = 1.0 - 1.0 / (0.15 * (peak - new_peak) + 1.0);
    colour.map(|c| ((1.0 - g) * c * new_peak / peak + g * new_peak).clamp(0.0, 1.0))
}

/// IEC 61966-2-1.
#[must_use]
pub fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

/// A picture of linear radiance at 0 EV, not dithered.
///
/// # Panics
/// When there are not as many values as pixels.
#[must_use]
pub fn shown(width: u32, height: u32, radiance: &[[f64; 3]]) -> RgbImage {
    assert_eq!(radiance.len(), (width * height) as usize);
    RgbImage::from_fn(width, height, |x, y| {
        let pixel = radiance[(y * width + x) as usize];
        let channels = [0, 1, 2].map(|c| {
            let value = srgb(filmic(pixel[c] / WHITE[c] * EXPOSURE));
            (value * 255.0).round() as u8
        });
        Rgb(channels)
    })
}
