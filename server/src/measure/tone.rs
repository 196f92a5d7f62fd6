//! The shown picture of linear radiance: the twin of `composite/tone.wgsl`, for pictures that no GPU has made.

use crate::march::EXPOSURE_AT_ZERO_EV;
use image::{Rgb, RgbImage};
use skycell_protocol::{FrameSize, Scene};

/// Spectral irradiance of the sun at 680, 550 and 440 nm relative to its mean (ASTM G173): what looks white.
const WHITE: [f64; 3] = [0.8444, 1.0602, 1.0954];

/// K. Narkowicz's fit of the ACES reference transform, 2015.
fn filmic(radiance: f64) -> f64 {
    let numerator = radiance * (2.51 * radiance + 0.03);
    (numerator / (radiance * (2.43 * radiance + 0.59) + 0.14)).clamp(0.0, 1.0)
}

/// sRGB's transfer function (IEC 61966-2-1).
fn srgb_from_linear(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

/// The composite's dither, −0.5 to 0.5 of an 8-bit step: the same pattern, so that two pictures do not differ by it.
fn dither(x: u32, y: u32) -> f64 {
    let along = (0.067_110_56 * f64::from(x) + 0.005_837_15 * f64::from(y)).fract();
    (52.982_918_9 * along).fract() - 0.5
}

/// The shown picture of `linear`: three values a pixel.
#[must_use]
pub fn shown_picture(linear: &[f32], size: FrameSize, scene: &Scene) -> RgbImage {
    let exposure = EXPOSURE_AT_ZERO_EV * scene.exposure_ev().exp2();
    RgbImage::from_fn(size.width(), size.height(), |x, y| {
        let first = 3 * (y as usize * size.width() as usize + x as usize);
        Rgb(std::array::from_fn(|channel| {
            let radiance = linear.get(first + channel).copied().unwrap_or_default();
            let shown = srgb_from_linear(filmic(f64::from(radiance) / WHITE[channel] * exposure));
            (255.0 * (shown + dither(x, y) / 255.0).clamp(0.0, 1.0)).round() as u8
        }))
    })
}
