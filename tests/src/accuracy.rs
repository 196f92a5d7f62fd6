//! How far two pictures are apart, by measures that are someone else's tools: NVIDIA's FLIP and an SSIM crate.

use anyhow::Context;
use image::{GrayImage, RgbImage};
use skycell_protocol::{Camera, FrameSize, RendererKind};
use skycell_server::config::{FrameFilter, RenderConfig};
use skycell_server::frame_loop::{StillPixels, StillRenderer};
use std::path::PathBuf;
use std::sync::Arc;

/// How far a picture is from a reference.
#[derive(Clone, Copy, Debug)]
pub struct Distance {
    /// Mean FLIP at its default viewing distance (67 pixels a degree); 0 for equal pictures.
    pub flip: f32,
    /// SSIM of luma; 1 for equal pictures.
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
    let ssim = image_compare::gray_similarity_structure(
        &image_compare::Algorithm::MSSIMSimple,
        &luma(reference),
        &luma(test),
    )?;
    Ok(Distance {
        flip: nv_flip::FlipPool::from_image(&error).mean(),
        ssim: ssim.score,
    })
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

/// A picture of the default scene from the default camera's place, looking 25° up, with how many texels were updated.
///
/// # Errors
/// When there is no device that renders it.
pub fn picture(recipe: Recipe, size: FrameSize) -> anyhow::Result<(RgbImage, u64)> {
    let mut config = RenderConfig::new(
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target/noise-of-tests"),
    );
    config.samples = recipe.samples;
    config.march_steps = Some(recipe.march_steps);
    config.mip_bias = Some(recipe.mip_bias);
    config.frame_filter = Some(recipe.filter);
    config.cache_memory_mib = 1024;
    let mut still = StillRenderer::new(config, Arc::default(), &[])?;
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0)?;
    let StillPixels::Display(bytes) = still.render(camera, size, recipe.renderer, false, |_| {})?
    else {
        anyhow::bail!("asked for a picture of bytes");
    };
    let rgb = bytes.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]);
    let picture = RgbImage::from_raw(size.width(), size.height(), rgb.collect())
        .context("a picture has all of its rows")?;
    Ok((picture, still.totals().texels_updated))
}
