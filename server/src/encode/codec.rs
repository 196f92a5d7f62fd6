//! One picture in one format.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageFormat};
use skycell_protocol::clouds::{self, CloudsError, CloudsHeader};
use skycell_protocol::{Codec, FrameSize};
use std::io::Cursor;
use thiserror::Error;

/// Why pixels are not a picture.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The pixels are not as many as the size tells.
    #[error("{found} bytes of pixels for a frame of {width}x{height}, which has {expected}")]
    WrongLength {
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The JPEG encoder refuses.
    #[error("JPEG: {0}")]
    Jpeg(#[from] jpeg_encoder::EncodingError),
    /// The PNG encoder refuses.
    #[error("PNG: {0}")]
    Png(#[from] image::ImageError),
    /// The EXR encoder refuses.
    #[error("EXR: {0}")]
    Exr(#[source] image::ImageError),
    /// They are no clouds.
    #[error("clouds: {0}")]
    Clouds(#[from] CloudsError),
    /// The pixels cannot be turned into a video's colours.
    #[error("colours: {0}")]
    Colours(String),
    /// The H.264 encoder refuses.
    #[error("H.264: {0}")]
    H264(#[from] openh264::Error),
    /// The H.264 encoder refuses an option.
    #[error("H.264: an option is refused with status {0}")]
    H264Option(i32),
    /// A picture of a stream was asked for by itself, or a picture as a stream.
    #[error("{0:?} is not made this way")]
    WrongKind(Codec),
    /// The picture is longer than a frame header can tell.
    #[error("a picture of {0} bytes is too long")]
    TooLong(usize),
}

/// Appends the picture of `rgba` (rows from top to bottom, 4 bytes a pixel) to `out`. Reads the
/// pixels once and copies none: they may be mapped GPU memory.
///
/// # Errors
/// If the pixels do not fit the size or the codec refuses them.
pub fn encode_after(
    out: &mut Vec<u8>,
    rgba: &[u8],
    size: FrameSize,
    codec: Codec,
    jpeg_quality: u8,
) -> Result<(), EncodeError> {
    let (width, height) = (size.width(), size.height());
    let expected = size.pixels() as usize * 4;
    if rgba.len() != expected {
        return Err(EncodeError::WrongLength {
            found: rgba.len(),
            expected,
            width,
            height,
        });
    }
    match codec {
        Codec::Jpeg => {
            // Width and height are at most 3840 and 2160.
            jpeg_encoder::Encoder::new(out, jpeg_quality).encode(
                rgba,
                width as u16,
                height as u16,
                jpeg_encoder::ColorType::Rgba,
            )?;
        }
        Codec::Png => {
            PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Sub).write_image(
                rgba,
                width,
                height,
                ExtendedColorType::Rgba8,
            )?;
        }
        Codec::H264 | Codec::Clouds => return Err(EncodeError::WrongKind(codec)),
    }
    Ok(())
}

/// An EXR file of linear radiance: 32-bit floats of red, green and blue, so that both the sun's disc and a night keep their
/// digits. `rgb` has three values a pixel, rows from top to bottom.
///
/// # Errors
/// If there are not as many values as the size tells.
pub fn exr_of(size: FrameSize, rgb: Vec<f32>) -> Result<Vec<u8>, EncodeError> {
    let (width, height) = (size.width(), size.height());
    let found = size_of_val(rgb.as_slice());
    let picture =
        image::Rgb32FImage::from_raw(width, height, rgb).ok_or(EncodeError::WrongLength {
            found,
            expected: size.pixels() as usize * 12,
            width,
            height,
        })?;
    let mut file = Cursor::new(Vec::new());
    picture
        .write_to(&mut file, ImageFormat::OpenExr)
        .map_err(EncodeError::Exr)?;
    Ok(file.into_inner())
}

/// Appends an EXR file of frames of linear radiance to `out`.
///
/// # Errors
/// If the pixels do not fit the size.
pub fn encode_exr_after(
    out: &mut Vec<u8>,
    pixels: &[u8],
    size: FrameSize,
) -> Result<(), EncodeError> {
    let rgb = pixels
        .chunks_exact(16)
        .flat_map(|pixel| [0, 4, 8].map(|at| bytemuck::pod_read_unaligned(&pixel[at..at + 4])))
        .collect();
    out.extend(exr_of(size, rgb)?);
    Ok(())
}

/// Appends clouds alone to `out`.
///
/// # Errors
/// If the pixels do not fit what the header says.
pub fn encode_clouds_after(
    out: &mut Vec<u8>,
    pixels: &[u8],
    header: &CloudsHeader,
) -> Result<(), EncodeError> {
    Ok(clouds::append(out, header, pixels)?)
}
