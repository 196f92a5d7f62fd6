//! What arrives in frames, as PNG files.

use std::io::Cursor;

use image::{DynamicImage, ImageFormat, ImageReader, Limits, RgbImage};
use skycell_protocol::FrameCodec;
use skycell_protocol::frame::FrameHeader;
use skycell_protocol::view::{FRAME_HEIGHT_MAX, FRAME_WIDTH_MAX};
use thiserror::Error;

/// Why a payload is no picture.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PictureError {
    /// A frame without a picture.
    #[error("the frame holds no picture")]
    NoPicture,
    /// A part of a stream, or no colours.
    #[error("a frame of {0:?} is no picture by itself")]
    NoFile(FrameCodec),
    /// Not a JPEG or PNG file.
    #[error("the picture cannot be read: {0}")]
    Unreadable(#[from] image::ImageError),
    /// Not a part of the video that came before.
    #[error("the video cannot be decoded: {0}")]
    Video(#[from] openh264::Error),
    /// The colours of a video cannot be turned into pixels.
    #[error("the video's colours cannot be read: {0}")]
    Colours(String),
    /// Another size than the header says.
    #[error("the picture has {0}x{1} pixels, its header says {2}x{3}")]
    WrongSize(u32, u32, u16, u16),
}

/// The picture of a frame as a PNG file: as it came, or a JPEG written anew.
///
/// # Errors
/// If the payload is not the picture that the header describes.
pub fn to_png(header: &FrameHeader, payload: &[u8]) -> Result<Vec<u8>, PictureError> {
    let picture = decode(header, payload)?;
    if header.codec == FrameCodec::Png {
        return Ok(payload.to_vec());
    }
    png_of(&picture.to_rgb8())
}

/// The picture of a frame.
///
/// # Errors
/// If the payload is not the picture that the header describes.
pub fn decode(header: &FrameHeader, payload: &[u8]) -> Result<DynamicImage, PictureError> {
    let format = match header.codec {
        FrameCodec::Jpeg => ImageFormat::Jpeg,
        FrameCodec::Png => ImageFormat::Png,
        FrameCodec::None => return Err(PictureError::NoPicture),
        FrameCodec::H264 | FrameCodec::Clouds => return Err(PictureError::NoFile(header.codec)),
    };
    let mut reader = ImageReader::with_format(Cursor::new(payload), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(FRAME_WIDTH_MAX);
    limits.max_image_height = Some(FRAME_HEIGHT_MAX);
    reader.limits(limits);
    let picture = reader.decode()?;
    if (picture.width(), picture.height()) != (header.width.into(), header.height.into()) {
        return Err(PictureError::WrongSize(
            picture.width(),
            picture.height(),
            header.width,
            header.height,
        ));
    }
    Ok(picture)
}

/// Pixels as a PNG file.
///
/// # Errors
/// If the encoder refuses them.
pub fn png_of(picture: &RgbImage) -> Result<Vec<u8>, PictureError> {
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png)?;
    Ok(png.into_inner())
}

#[cfg(test)]
mod tests {
    use skycell_protocol::{CellId, FrameSequence, FrameStages, InputSequence, ViewerId};

    use super::*;

    fn header(codec: FrameCodec, width: u16, height: u16) -> FrameHeader {
        FrameHeader {
            codec,
            heartbeat: false,
            coarse: false,
            stereo: false,
            key: true,
            exact: false,
            sequence: FrameSequence(1),
            width,
            height,
            scene_revision: 1,
            input: InputSequence(0),
            cell: CellId(0),
            viewer: ViewerId(1),
            render_unix_us: 0,
            stages: FrameStages::default(),
            payload_bytes: 0,
            target_kbit_per_s: 0,
            colours: None,
        }
    }

    fn file(format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        RgbImage::from_pixel(32, 16, image::Rgb([90, 140, 200]))
            .write_to(&mut bytes, format)
            .expect("written");
        bytes.into_inner()
    }

    #[test]
    fn a_png_is_kept_as_it_came_and_a_jpeg_becomes_one() {
        let png = file(ImageFormat::Png);
        assert_eq!(
            to_png(&header(FrameCodec::Png, 32, 16), &png).expect("a picture"),
            png
        );
        let from_jpeg =
            to_png(&header(FrameCodec::Jpeg, 32, 16), &file(ImageFormat::Jpeg)).expect("a picture");
        let picture =
            image::load_from_memory_with_format(&from_jpeg, ImageFormat::Png).expect("a PNG");
        assert!((i32::from(picture.to_rgb8().get_pixel(3, 3)[2]) - 200).abs() < 4);
    }

    #[test]
    fn what_is_not_the_announced_picture_is_refused() {
        let png = file(ImageFormat::Png);
        assert!(matches!(
            to_png(&header(FrameCodec::Jpeg, 32, 16), &png),
            Err(PictureError::Unreadable(_))
        ));
        assert!(matches!(
            to_png(&header(FrameCodec::Png, 16, 32), &png),
            Err(PictureError::WrongSize(32, 16, 16, 32))
        ));
        assert!(matches!(
            to_png(&header(FrameCodec::None, 0, 0), &[]),
            Err(PictureError::NoPicture)
        ));
        assert!(to_png(&header(FrameCodec::Png, 32, 16), &png[..png.len() / 2]).is_err());
    }
}
