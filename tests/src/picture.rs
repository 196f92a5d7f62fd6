//! Pictures as numbers.

use std::collections::HashSet;

use anyhow::{Context, ensure};
use image::RgbImage;
use skycell_client::Frame;
use skycell_protocol::FrameSize;

/// The decoded picture of a frame, of the size that its header says.
///
/// # Errors
/// When it is not the picture that the header describes.
pub fn decoded(frame: &Frame) -> anyhow::Result<RgbImage> {
    let picture = image::load_from_memory(frame.payload())?.to_rgb8();
    let said = (
        u32::from(frame.header.width),
        u32::from(frame.header.height),
    );
    ensure!(
        picture.dimensions() == said,
        "the header says {said:?}, the picture has {:?}",
        picture.dimensions()
    );
    Ok(picture)
}

/// What a renderer gives as red, green, blue and alpha, without alpha.
///
/// # Errors
/// When it has other rows than a picture of that size.
pub fn without_alpha(rgba: &[u8], size: FrameSize) -> anyhow::Result<RgbImage> {
    let rgb = rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]);
    RgbImage::from_raw(size.width(), size.height(), rgb.collect())
        .with_context(|| format!("{} bytes are no picture of that size", rgba.len()))
}

/// How many colours a picture has.
pub fn colours(picture: &RgbImage) -> usize {
    picture
        .pixels()
        .map(|pixel| pixel.0)
        .collect::<HashSet<_>>()
        .len()
}

/// Mean absolute difference of two pictures of one size, in 8-bit steps.
pub fn mean_difference(a: &RgbImage, b: &RgbImage) -> f64 {
    let sum: u64 = a
        .as_raw()
        .iter()
        .zip(b.as_raw())
        .map(|(a, b)| u64::from(a.abs_diff(*b)))
        .sum();
    sum as f64 / a.as_raw().len().max(1) as f64
}
