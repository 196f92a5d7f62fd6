//! Pictures as numbers.

use std::collections::HashSet;

use anyhow::ensure;
use image::RgbImage;
use skycell_client::Frame;

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
