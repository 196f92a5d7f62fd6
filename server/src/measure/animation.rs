//! Moving pictures: PNG files with several frames, which keep every value and play in browsers.

use anyhow::Context;
use image::{RgbImage, imageops};
use png::{BitDepth, BlendOp, ColorType, Encoder};

/// Pixels between pictures side by side.
const GAP: u32 = 4;

/// An animated PNG of two sequences side by side that begins anew for ever; `fps` frames a second.
///
/// # Errors
/// For sequences without frames, of different lengths or of frames of different sizes.
pub(super) fn side_by_side(
    left: &[RgbImage],
    right: &[RgbImage],
    fps: u16,
) -> anyhow::Result<Vec<u8>> {
    anyhow::ensure!(
        left.len() == right.len(),
        "one sequence has {} frames, the other {}",
        left.len(),
        right.len()
    );
    let size = left
        .first()
        .context("a sequence has no frames")?
        .dimensions();
    let [width, height] = [2 * size.0 + GAP, size.1];
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, width, height);
    encoder.set_color(ColorType::Rgb);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_animated(u32::try_from(left.len())?, 0)?;
    encoder.set_frame_delay(1, fps.max(1))?;
    encoder.set_blend_op(BlendOp::Source)?;
    let mut writer = encoder.write_header()?;
    for (left, right) in left.iter().zip(right) {
        anyhow::ensure!(
            [left.dimensions(), right.dimensions()] == [size; 2],
            "a frame is of another size"
        );
        let mut frame = RgbImage::from_pixel(width, height, image::Rgb([255; 3]));
        imageops::replace(&mut frame, left, 0, 0);
        imageops::replace(&mut frame, right, i64::from(size.0 + GAP), 0);
        writer.write_image_data(frame.as_raw())?;
    }
    writer.finish()?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::png::PngDecoder;
    use image::{AnimationDecoder, Rgb};
    use std::io::Cursor;

    fn grey(value: u8) -> RgbImage {
        RgbImage::from_pixel(6, 3, Rgb([value; 3]))
    }

    #[test]
    fn an_animation_shows_both_sequences_frame_by_frame() {
        let file = side_by_side(&[grey(1), grey(2)], &[grey(3), grey(4)], 10).expect("a file");
        let decoder = PngDecoder::new(Cursor::new(file)).expect("a PNG");
        let frames = decoder.apng().expect("animated").into_frames();
        let frames = frames.collect_frames().expect("frames");
        assert_eq!(frames.len(), 2);
        for (frame, [left, right]) in frames.iter().zip([[1, 3], [2, 4]]) {
            assert_eq!(frame.delay().numer_denom_ms(), (100, 1));
            let picture = frame.buffer();
            assert_eq!(picture.dimensions(), (16, 3));
            assert_eq!(picture.get_pixel(5, 2).0, [left, left, left, 255]);
            assert_eq!(picture.get_pixel(7, 1).0, [255; 4]);
            assert_eq!(picture.get_pixel(10, 0).0, [right, right, right, 255]);
        }
    }

    #[test]
    fn sequences_that_do_not_fit_are_refused() {
        assert!(side_by_side(&[], &[], 10).is_err());
        assert!(side_by_side(&[grey(1)], &[], 10).is_err());
        assert!(side_by_side(&[grey(1)], &[RgbImage::new(5, 3)], 10).is_err());
    }
}
