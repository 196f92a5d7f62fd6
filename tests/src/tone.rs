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
