//! Pixels as video encoders take them: brightness for each pixel, colour for each 2 x 2.
//!
//! BT.709, full range: the 256 steps of brightness that a screen has stay 256, where the limited range of television has
//! 220 and a smooth sky shows it.

use openh264::formats::YUVSource;
use skycell_protocol::colour_scale::{Plane, rgb_of_planes};
use skycell_protocol::{ColourScale, FrameSize};
use yuv::{
    BufferStoreMut, YuvConversionMode, YuvPlanarImage, YuvPlanarImageMut, YuvRange,
    YuvStandardMatrix,
};

use super::EncodeError;

/// Encoders take no less in either direction.
const SIDE_MIN: u32 = 16;

/// Three planes of a picture whose sides are even; what is beyond the frame repeats its edge.
#[derive(Debug)]
pub struct I420 {
    size: FrameSize,
    coded: [u32; 2],
    /// Brightness, then blue and red differences.
    planes: [Vec<u8>; 3],
    /// The frame's pixels with their edge repeated, where its sides are not those of the planes; else empty.
    padded: Vec<u8>,
}

impl I420 {
    /// Black planes for frames of a size.
    pub fn new(size: FrameSize) -> Self {
        let sides = [size.width(), size.height()];
        let coded = sides.map(|side| side.next_multiple_of(2).max(SIDE_MIN));
        let pixels = coded[0] as usize * coded[1] as usize;
        Self {
            size,
            coded,
            planes: [vec![0; pixels], vec![0; pixels / 4], vec![0; pixels / 4]],
            padded: vec![0; if coded == sides { 0 } else { pixels * 4 }],
        }
    }

    /// The frames' size.
    pub fn size(&self) -> FrameSize {
        self.size
    }

    /// Bytes of the planes.
    pub fn bytes(&self) -> usize {
        self.planes.iter().map(Vec::len).sum()
    }

    /// Values in a row of brightness.
    pub(super) fn coded_width(&self) -> usize {
        self.coded[0] as usize
    }

    /// The pixels of a frame as wide and as high as the planes, its edge repeated; and the planes.
    ///
    /// # Errors
    /// If they are not as many as the size tells.
    pub(super) fn pixels_and_planes<'a>(
        &'a mut self,
        rgba: &'a [u8],
    ) -> Result<(&'a [u8], [&'a mut [u8]; 3]), EncodeError> {
        let (width, height) = (self.size.width(), self.size.height());
        let expected = self.size.pixels() as usize * 4;
        if rgba.len() != expected {
            return Err(EncodeError::WrongLength {
                found: rgba.len(),
                expected,
                width,
                height,
            });
        }
        let coded_width = self.coded[0];
        let rgba = if self.padded.is_empty() {
            rgba
        } else {
            pad(
                &mut self.padded,
                coded_width as usize * 4,
                rgba,
                width as usize * 4,
            );
            self.padded.as_slice()
        };
        Ok((rgba, self.planes.each_mut().map(Vec::as_mut_slice)))
    }

    /// Takes the pixels of a frame: red, green, blue, alpha, rows from top to bottom.
    ///
    /// # Errors
    /// If they are not as many as the size tells.
    pub fn fill(&mut self, rgba: &[u8]) -> Result<(), EncodeError> {
        let [coded_width, coded_height] = self.coded;
        let (rgba, [luma, blue, red]) = self.pixels_and_planes(rgba)?;
        let mut image = YuvPlanarImageMut {
            y_plane: BufferStoreMut::Borrowed(luma),
            y_stride: coded_width,
            u_plane: BufferStoreMut::Borrowed(blue),
            u_stride: coded_width / 2,
            v_plane: BufferStoreMut::Borrowed(red),
            v_stride: coded_width / 2,
            width: coded_width,
            height: coded_height,
        };
        yuv::rgba_to_yuv420(
            &mut image,
            rgba,
            coded_width * 4,
            YuvRange::Full,
            YuvStandardMatrix::Bt709,
            YuvConversionMode::Balanced,
        )
        .map_err(|error| EncodeError::Colours(error.to_string()))
    }
}

/// Lays rows into wider ones, of which there are more: beyond what is known the picture goes on as it ends, which costs a codec
/// least.
fn pad(into: &mut [u8], into_stride: usize, from: &[u8], from_stride: usize) {
    let rows = from.chunks_exact(from_stride);
    let last = rows.clone().next_back();
    for (into, from) in into
        .chunks_exact_mut(into_stride)
        .zip(rows.chain(std::iter::repeat_n(last.unwrap_or_default(), usize::MAX)))
    {
        into[..from_stride].copy_from_slice(from);
        for at in (from_stride..into_stride).step_by(4) {
            into.copy_within(from_stride - 4..from_stride, at);
        }
    }
}

impl YUVSource for I420 {
    fn dimensions(&self) -> (usize, usize) {
        (self.coded[0] as usize, self.coded[1] as usize)
    }

    fn strides(&self) -> (usize, usize, usize) {
        let width = self.coded[0] as usize;
        (width, width / 2, width / 2)
    }

    fn y(&self) -> &[u8] {
        &self.planes[0]
    }

    fn u(&self) -> &[u8] {
        &self.planes[1]
    }

    fn v(&self) -> &[u8] {
        &self.planes[2]
    }
}

/// The pixels of planes as [`I420`] has them: red, green, blue; the top left `size` of what they hold.
///
/// # Errors
/// If they hold less.
pub fn rgb_of(planes: &impl YUVSource, size: FrameSize) -> Result<Vec<u8>, EncodeError> {
    let (width, height) = planes.dimensions();
    if (width as u64) < u64::from(size.width()) || (height as u64) < u64::from(size.height()) {
        return Err(EncodeError::Colours(format!(
            "{width}x{height} pixels for a frame of {}x{}",
            size.width(),
            size.height()
        )));
    }
    let (y_stride, u_stride, v_stride) = planes.strides();
    let image = YuvPlanarImage {
        y_plane: planes.y(),
        y_stride: y_stride as u32,
        u_plane: planes.u(),
        u_stride: u_stride as u32,
        v_plane: planes.v(),
        v_stride: v_stride as u32,
        width: width as u32,
        height: height as u32,
    };
    let mut rgb = vec![0; width * height * 3];
    yuv::yuv420_to_rgb(
        &image,
        &mut rgb,
        width as u32 * 3,
        YuvRange::Full,
        YuvStandardMatrix::Bt709,
    )
    .map_err(|error| EncodeError::Colours(error.to_string()))?;
    if width == size.width() as usize {
        rgb.truncate(size.pixels() as usize * 3);
        return Ok(rgb);
    }
    let rows = rgb.chunks_exact(width * 3).take(size.height() as usize);
    Ok(rows
        .flat_map(|row| &row[..size.width() as usize * 3])
        .copied()
        .collect())
}

/// The pixels of planes whose colours are spread, as [`rgb_of`].
///
/// # Errors
/// If they hold less.
pub fn rgb_of_spread(
    planes: &impl YUVSource,
    scale: ColourScale,
    size: FrameSize,
) -> Result<Vec<u8>, EncodeError> {
    let (y_stride, u_stride, v_stride) = planes.strides();
    let plane = |bytes, stride| Plane { bytes, stride };
    let planes = [
        plane(planes.y(), y_stride),
        plane(planes.u(), u_stride),
        plane(planes.v(), v_stride),
    ];
    rgb_of_planes(planes, scale, size, size.width() as usize).ok_or_else(|| {
        EncodeError::Colours(format!(
            "too few values for a frame of {}x{}",
            size.width(),
            size.height()
        ))
    })
}
