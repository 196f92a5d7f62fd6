//! How far two pictures are apart.
//!
//! FLIP is NVIDIA's own code. SSIM is the crate `iqa`, which a test holds against scikit-image (`image-compare` 0.5 sums
//! the products of a window without dividing by its area, which weighs faint noise 64 times too much).

use image::RgbImage;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The smallest width and height that can be compared: SSIM's window.
pub const COMPARED_SIDE_MIN: u32 = 11;
/// ε of [`LinearErrors::relative_mse_per_pixel`] and floor of [`WorstPixel`]: a share of the reference's mean.
pub const DARK_SHARE: f64 = 0.01;

/// Rec. 709 luminance of linear RGB.
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Why pictures cannot be compared.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum CompareError {
    /// They differ in size.
    #[error("pictures of {reference:?} and {test:?} pixels cannot be compared")]
    Sizes {
        /// Width and height of the reference.
        reference: (u32, u32),
        /// Width and height of the other.
        test: (u32, u32),
    },
    /// SSIM's window does not fit.
    #[error(
        "a picture of {0}x{1} is too small to be compared; allowed: from {COMPARED_SIDE_MIN}x{COMPARED_SIDE_MIN}"
    )]
    TooSmall(u32, u32),
}

/// How far a shown picture (8-bit sRGB) is from a reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShownErrors {
    /// Mean FLIP at its default viewing distance (67 pixels a degree); 0 for equal pictures.
    pub flip: f64,
    /// Mean SSIM of luma (Z. Wang et al., "Image Quality Assessment", 2004: Gaussian window of 11 pixels, σ = 1.5); 1 for
    /// equal pictures.
    pub ssim: f64,
}

/// FLIP of every pixel, with its mean.
pub struct FlipMap {
    /// Mean over the picture.
    pub mean: f64,
    /// Each pixel's, in the colours of Magma: black is 0, light yellow 1.
    pub colours: RgbImage,
}

/// The distance between two shown pictures.
///
/// # Errors
/// When their sizes differ or they are smaller than SSIM's window.
pub fn shown_errors(reference: &RgbImage, test: &RgbImage) -> Result<ShownErrors, CompareError> {
    check_sizes(reference.dimensions(), test.dimensions())?;
    Ok(ShownErrors {
        flip: f64::from(nv_flip::FlipPool::from_image(&flip(reference, test)).mean()),
        ssim: ssim(reference, test).ok_or(CompareError::TooSmall(
            reference.width(),
            reference.height(),
        ))?,
    })
}

/// FLIP pixel by pixel.
///
/// # Errors
/// When their sizes differ or they are too small.
pub fn flip_map(reference: &RgbImage, test: &RgbImage) -> Result<FlipMap, CompareError> {
    check_sizes(reference.dimensions(), test.dimensions())?;
    let errors = flip(reference, test);
    let colours = errors.apply_color_lut(&nv_flip::magma_lut());
    Ok(FlipMap {
        mean: f64::from(nv_flip::FlipPool::from_image(&errors).mean()),
        colours: RgbImage::from_raw(reference.width(), reference.height(), colours.to_vec())
            .unwrap_or_default(),
    })
}

fn check_sizes(reference: (u32, u32), test: (u32, u32)) -> Result<(), CompareError> {
    if reference != test {
        return Err(CompareError::Sizes { reference, test });
    }
    if reference.0.min(reference.1) < COMPARED_SIDE_MIN {
        return Err(CompareError::TooSmall(reference.0, reference.1));
    }
    Ok(())
}

fn flip(reference: &RgbImage, test: &RgbImage) -> nv_flip::FlipImageFloat {
    let [reference, test] = [reference, test].map(|image| {
        nv_flip::FlipImageRgb8::with_data(image.width(), image.height(), image.as_raw())
    });
    nv_flip::flip(reference, test, nv_flip::DEFAULT_PIXELS_PER_DEGREE)
}

fn ssim(reference: &RgbImage, test: &RgbImage) -> Option<f64> {
    let luma = |image: &RgbImage| {
        let luma = image::DynamicImage::ImageRgb8(image.clone()).to_luma8();
        iqa::Image::gray8(luma.width(), luma.height(), luma.into_raw()).ok()
    };
    iqa::ssim(&luma(reference)?, &luma(test)?, iqa::SsimOptions::default()).ok()
}

/// How far a picture of linear radiance (RGB) is from a reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearErrors {
    /// mean((a − b)²) / mean(b²) over all pixels and channels, b the reference.
    pub relative_mse: f64,
    /// mean((a − b)² / (b² + ε)), after F. Rousselle et al., "Adaptive Sampling and Reconstruction using Greedy Error
    /// Minimization", 2011, with ε = [`DARK_SHARE`] · mean(b²), so that the figure does not depend on exposure.
    pub relative_mse_per_pixel: f64,
    /// The pixel that is farthest off.
    pub worst_pixel: WorstPixel,
}

/// The pixel with the largest deviation in luminance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorstPixel {
    /// |Y(a) − Y(b)| / max(Y(b), [`DARK_SHARE`] · mean Y(b)), b the reference.
    pub relative_deviation: f64,
    /// Column from the left.
    pub x: u32,
    /// Row from the top.
    pub y: u32,
}

fn luminance(pixel: &[f32]) -> f64 {
    pixel
        .iter()
        .zip(LUMINANCE)
        .map(|(v, w)| f64::from(*v) * w)
        .sum()
}

/// The distance between two pictures of linear radiance: three values a pixel, rows of `width` pixels.
///
/// # Errors
/// When their sizes differ or they are empty.
pub fn linear_errors(
    reference: &[f32],
    test: &[f32],
    width: u32,
) -> Result<LinearErrors, CompareError> {
    let rows = |values: &[f32]| (values.len() / 3) as u32 / width.max(1);
    if reference.len() != test.len() || reference.is_empty() {
        return Err(CompareError::Sizes {
            reference: (width, rows(reference)),
            test: (width, rows(test)),
        });
    }
    let count = reference.len() as f64;
    let squares = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
        let pairs = test.iter().zip(reference);
        pairs
            .map(|(a, b)| f(f64::from(*a), f64::from(*b)))
            .sum::<f64>()
            / count
    };
    let mean_square = squares(&|_, b| b * b);
    // A black reference has no scale: then the error counts as it is.
    let scale = if mean_square > 0.0 { mean_square } else { 1.0 };
    let epsilon = DARK_SHARE * scale;
    let pixels = || test.chunks_exact(3).zip(reference.chunks_exact(3));
    let mean_luminance = pixels().map(|(_, b)| luminance(b)).sum::<f64>() / (count / 3.0);
    let floor = (DARK_SHARE * mean_luminance).max(f64::MIN_POSITIVE);
    let (index, relative_deviation) = pixels()
        .map(|(a, b)| (luminance(a) - luminance(b)).abs() / luminance(b).max(floor))
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or_default();
    Ok(LinearErrors {
        relative_mse: squares(&|a, b| (a - b) * (a - b)) / scale,
        relative_mse_per_pixel: squares(&|a, b| (a - b) * (a - b) / (b * b + epsilon)),
        worst_pixel: WorstPixel {
            relative_deviation,
            x: index as u32 % width.max(1),
            y: index as u32 / width.max(1),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, Luma, Rgb};

    fn grey(picture: &GrayImage) -> RgbImage {
        image::DynamicImage::ImageLuma8(picture.clone()).to_rgb8()
    }

    /// Expected: scikit-image 0.26.0, `structural_similarity(a, b, gaussian_weights=True, sigma=1.5,
    /// use_sample_covariance=False, data_range=255)` of the same two pictures.
    #[test]
    fn ssim_is_that_of_scikit_image() {
        let a = GrayImage::from_fn(64, 48, |x, y| Luma([((x * 7 + y * 13) % 256) as u8]));
        let b = GrayImage::from_fn(64, 48, |x, y| {
            Luma([((x * 7 + y * 13) % 256).saturating_sub((x * y) % 17) as u8])
        });
        let equal = ssim(&grey(&a), &grey(&a)).expect("comparable");
        let apart = ssim(&grey(&a), &grey(&b)).expect("comparable");
        assert!((equal - 1.0).abs() < 1e-12, "{equal}");
        assert!((apart - 0.981_441).abs() < 1e-4, "{apart}");
    }

    #[test]
    fn flip_of_equal_pictures_is_zero_and_of_opposite_ones_is_one() {
        let black = RgbImage::new(32, 32);
        let white = RgbImage::from_pixel(32, 32, Rgb([255; 3]));
        let equal = flip_map(&white, &white).expect("comparable");
        assert!(equal.mean < 1e-6, "{}", equal.mean);
        let opposite = flip_map(&black, &white).expect("comparable");
        assert!(opposite.mean > 0.95, "{}", opposite.mean);
        assert_eq!(opposite.colours.dimensions(), (32, 32));
    }

    #[test]
    fn relative_errors_have_their_closed_forms() {
        // Twice the reference everywhere: (b)²/(b)² = 1, and 1/(1 + ε).
        let reference = vec![0.5; 3 * 4];
        let double = vec![1.0; 3 * 4];
        let errors = linear_errors(&reference, &double, 2).expect("comparable");
        assert!((errors.relative_mse - 1.0).abs() < 1e-12);
        assert!((errors.relative_mse_per_pixel - 1.0 / (1.0 + DARK_SHARE)).abs() < 1e-12);
        assert!((errors.worst_pixel.relative_deviation - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_worst_pixel_is_found_where_it_is_even_beside_black() {
        let mut reference = vec![1.0; 3 * 6];
        reference[..3].fill(0.0);
        let mut test = reference.clone();
        test[3 * 5] = 3.0;
        let worst = linear_errors(&reference, &test, 3)
            .expect("comparable")
            .worst_pixel;
        assert_eq!((worst.x, worst.y), (2, 1));
        assert!((worst.relative_deviation - 2.0 * LUMINANCE[0]).abs() < 1e-9);
        assert_eq!(
            linear_errors(&reference, &reference, 3)
                .expect("comparable")
                .relative_mse,
            0.0
        );
    }

    #[test]
    fn pictures_of_different_or_tiny_sizes_are_refused() {
        let size = |w, h| RgbImage::new(w, h);
        assert!(shown_errors(&size(32, 32), &size(32, 31)).is_err());
        assert_eq!(
            shown_errors(&size(10, 32), &size(10, 32)),
            Err(CompareError::TooSmall(10, 32))
        );
    }
}
