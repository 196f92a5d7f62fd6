//! Pictures of a video, in the order in which they arrive.

use image::RgbImage;
use openh264::decoder::Decoder;
use openh264::formats::YUVSource;
use skycell_protocol::colour_scale::{Plane, rgb_of_planes};
use skycell_protocol::frame::FrameHeader;
use skycell_protocol::{FrameCodec, FrameSize};
use yuv::{YuvPlanarImage, YuvRange, YuvStandardMatrix};

use crate::picture::PictureError;

/// Decodes the H.264 of one session. Pictures build on one another, so every frame of it must go in.
pub struct VideoDecoder {
    decoder: Decoder,
}

impl VideoDecoder {
    /// A decoder that has seen nothing; the first frame must be a key.
    ///
    /// # Errors
    /// If OpenH264 gives none.
    pub fn new() -> Result<Self, PictureError> {
        Ok(Self {
            decoder: Decoder::new()?,
        })
    }

    /// The picture of the next frame.
    ///
    /// # Errors
    /// If the payload is no access unit of the stream, or its picture is smaller than the header says.
    pub fn decode(
        &mut self,
        header: &FrameHeader,
        payload: &[u8],
    ) -> Result<RgbImage, PictureError> {
        if header.codec != FrameCodec::H264 {
            return Err(PictureError::NoFile(header.codec));
        }
        let planes = self
            .decoder
            .decode(payload)?
            .ok_or(PictureError::NoPicture)?;
        let (width, height) = (u32::from(header.width), u32::from(header.height));
        let (found_width, found_height) = planes.dimensions();
        // The encoder's sides are even and at least 16; what is beyond the frame repeats its edge.
        if (found_width as u64) < u64::from(width) || (found_height as u64) < u64::from(height) {
            let found = (found_width as u32, found_height as u32);
            return Err(PictureError::WrongSize(
                found.0,
                found.1,
                header.width,
                header.height,
            ));
        }
        let (found_width, found_height) = (found_width as u32, found_height as u32);
        let (y_stride, u_stride, v_stride) = planes.strides();
        if let Some(scale) = header.colours {
            let plane = |bytes, stride| Plane { bytes, stride };
            let planes = [
                plane(planes.y(), y_stride),
                plane(planes.u(), u_stride),
                plane(planes.v(), v_stride),
            ];
            let eye_width = if header.stereo { width / 2 } else { width };
            let wrong = || PictureError::Colours("planes of another size".into());
            let size = FrameSize::new(width, height).map_err(|_| wrong())?;
            return rgb_of_planes(planes, scale, size, eye_width as usize)
                .and_then(|rgb| RgbImage::from_raw(width, height, rgb))
                .ok_or_else(wrong);
        }
        let image = YuvPlanarImage {
            y_plane: planes.y(),
            y_stride: y_stride as u32,
            u_plane: planes.u(),
            u_stride: u_stride as u32,
            v_plane: planes.v(),
            v_stride: v_stride as u32,
            width: found_width,
            height: found_height,
        };
        let mut picture = RgbImage::new(found_width, found_height);
        // As the stream itself says: BT.709, full range.
        yuv::yuv420_to_rgb(
            &image,
            &mut picture,
            found_width * 3,
            YuvRange::Full,
            YuvStandardMatrix::Bt709,
        )
        .map_err(|error| PictureError::Colours(error.to_string()))?;
        if picture.dimensions() == (width, height) {
            return Ok(picture);
        }
        Ok(image::imageops::crop_imm(&picture, 0, 0, width, height).to_image())
    }
}
