//! How far two pictures are apart: NVIDIA's FLIP by its own code, and SSIM as its paper has it.
//!
//! SSIM is written out here because the crates at hand compute something else under its name (`image-compare` 0.5 sums
//! the products of a window without dividing by its area, which weighs faint noise 64 times too much). A test compares it
//! with scikit-image.

use crate::server::target_dir;
use anyhow::Context;
use image::{GrayImage, RgbImage};
use skycell_protocol::{Camera, FrameSize, RendererKind};
use skycell_server::config::{FrameFilter, RenderConfig};
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use skycell_server::march::MarchSettings;
use std::sync::Arc;

/// How far a picture is from a reference.
#[derive(Clone, Copy, Debug)]
pub struct Distance {
    /// Mean FLIP at its default viewing distance (67 pixels a degree); 0 for equal pictures.
    pub flip: f32,
    /// SSIM of luma (Z. Wang et al., "Image Quality Assessment", 2004: Gaussian window of 11 pixels, σ = 1.5); 1 for equal
    /// pictures.
    pub ssim: f64,
}

/// The distance between two pictures of one size.
///
/// # Errors
/// When their sizes differ.
pub fn distance(reference: &RgbImage, test: &RgbImage) -> anyhow::Result<Distance> {
    let flip_image = |image: &RgbImage| {
        nv_flip::FlipImageRgb8::with_data(image.width(), image.height(), image.as_raw())
    };
    anyhow::ensure!(
        reference.dimensions() == test.dimensions(),
        "pictures of {:?} and {:?} cannot be compared",
        reference.dimensions(),
        test.dimensions()
    );
    let error = nv_flip::flip(
        flip_image(reference),
        flip_image(test),
        nv_flip::DEFAULT_PIXELS_PER_DEGREE,
    );
    let luma = |image: &RgbImage| -> GrayImage {
        image::DynamicImage::ImageRgb8(image.clone()).to_luma8()
    };
    Ok(Distance {
        flip: nv_flip::FlipPool::from_image(&error).mean(),
        ssim: ssim(&luma(reference), &luma(test)),
    })
}

const WINDOW_RADIUS: usize = 5;
const WINDOW_SIGMA: f64 = 1.5;

/// A picture's window means, for every pixel whose window lies inside it.
fn window_means(values: &[f64], width: usize) -> Vec<f64> {
    let weights: Vec<f64> = (0..=2 * WINDOW_RADIUS)
        .map(|i| (-0.5 * ((i as f64 - WINDOW_RADIUS as f64) / WINDOW_SIGMA).powi(2)).exp())
        .collect();
    let total: f64 = weights.iter().sum();
    let rows: Vec<f64> = values
        .chunks_exact(width)
        .flat_map(|row| row.windows(weights.len()))
        .map(|window| window.iter().zip(&weights).map(|(v, w)| v * w).sum::<f64>() / total)
        .collect();
    let narrow = width - 2 * WINDOW_RADIUS;
    let height = values.len() / width;
    (0..height - 2 * WINDOW_RADIUS)
        .flat_map(|y| (0..narrow).map(move |x| (x, y)))
        .map(|(x, y)| {
            let column = weights.iter().enumerate();
            column
                .map(|(i, w)| rows[(y + i) * narrow + x] * w)
                .sum::<f64>()
                / total
        })
        .collect()
}

fn ssim(a: &GrayImage, b: &GrayImage) -> f64 {
    const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
    const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);
    let width = a.width() as usize;
    let products = |x: &GrayImage, y: &GrayImage| -> Vec<f64> {
        let pairs = x.as_raw().iter().zip(y.as_raw());
        let products: Vec<f64> = pairs.map(|(x, y)| f64::from(*x) * f64::from(*y)).collect();
        window_means(&products, width)
    };
    let means = |x: &GrayImage| -> Vec<f64> {
        let values: Vec<f64> = x.as_raw().iter().map(|v| f64::from(*v)).collect();
        window_means(&values, width)
    };
    let (mean_a, mean_b) = (means(a), means(b));
    let (aa, bb, ab) = (products(a, a), products(b, b), products(a, b));
    let sum: f64 = (0..mean_a.len())
        .map(|i| {
            let (m, n) = (mean_a[i], mean_b[i]);
            let (var_a, var_b, covariance) = (aa[i] - m * m, bb[i] - n * n, ab[i] - m * n);
            (2.0 * m * n + C1) * (2.0 * covariance + C2)
                / ((m * m + n * n + C1) * (var_a + var_b + C2))
        })
        .sum();
    sum / mean_a.len() as f64
}

/// How a picture for a comparison is made.
#[derive(Clone, Copy, Debug)]
pub struct Recipe {
    /// Which renderer.
    pub renderer: RendererKind,
    /// Samples of a texel or pixel.
    pub samples: u32,
    /// Levels by which the cache is coarser.
    pub mip_bias: f32,
    /// Steps through the layer's thickness.
    pub march_steps: u32,
    /// How the cache is read.
    pub filter: FrameFilter,
}

impl Recipe {
    /// The baseline: eight samples a pixel, 128 steps, no cache.
    #[must_use]
    pub fn screen_space() -> Self {
        Self {
            renderer: RendererKind::ScreenSpace,
            samples: 8,
            mip_bias: 0.0,
            march_steps: 128,
            filter: FrameFilter::CatmullRom,
        }
    }
}

/// A picture of the default scene from the default camera's place, looking 25° up, with how many texels were updated.
///
/// # Errors
/// When there is no device that renders it.
pub fn picture(recipe: Recipe, size: FrameSize) -> anyhow::Result<(RgbImage, u64)> {
    let mut config = RenderConfig::new(target_dir()?.join("noise-of-tests"));
    config.cache_memory_mib = 1024;
    let mut still = StillRenderer::new(config, Arc::default(), &[])?;
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0)?;
    let settings = StillSettings {
        renderer: recipe.renderer,
        march: MarchSettings {
            steps: recipe.march_steps,
            ..MarchSettings::default()
        },
        samples: recipe.samples,
        mip_bias: recipe.mip_bias,
        filter: recipe.filter,
        ..StillSettings::default()
    };
    let made = still.render_with(camera, size, &settings, |_| {})?;
    let rgb = made
        .display
        .chunks_exact(4)
        .flat_map(|p| [p[0], p[1], p[2]]);
    let picture = RgbImage::from_raw(size.width(), size.height(), rgb.collect())
        .context("a picture has all of its rows")?;
    Ok((picture, still.totals().texels_updated))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;

    /// Expected: scikit-image 0.26.0, `structural_similarity(a, b, gaussian_weights=True, sigma=1.5,
    /// use_sample_covariance=False, data_range=255)` of the same two pictures.
    #[test]
    fn ssim_is_that_of_scikit_image() {
        let a = GrayImage::from_fn(64, 48, |x, y| Luma([((x * 7 + y * 13) % 256) as u8]));
        let b = GrayImage::from_fn(64, 48, |x, y| {
            Luma([((x * 7 + y * 13) % 256).saturating_sub((x * y) % 17) as u8])
        });
        assert!((ssim(&a, &a) - 1.0).abs() < 1e-12);
        assert!((ssim(&a, &b) - 0.981441).abs() < 1e-4, "{}", ssim(&a, &b));
    }
}
