//! Clouds alone: what a frame of [`Codec::Clouds`](crate::Codec::Clouds) holds, for renderers that have a sky, a ground and
//! things of their own.
//!
//! A payload is 32 bytes, little-endian, and then a zlib stream (RFC 1950).
//!
//! | bytes | field | type | meaning |
//! | --- | --- | --- | --- |
//! | 0 | version | u8 | 1 |
//! | 1 | planes | u8 | 5 |
//! | 2..4 | flags | u16 | bit 0: colour includes the haze in front of the clouds; others are 0 |
//! | 4..8 | width | u32 | pixels in a row, of both eyes together where there are two |
//! | 8..12 | height | u32 | rows |
//! | 12..16 | pre_exposure | f32 | a power of two; colour was multiplied by it |
//! | 16..20 | data_bytes | u32 | length of the zlib stream |
//! | 20..32 | | | 0, for later |
//!
//! The stream inflates to `10 * width * height` bytes: five planes of half floats (IEEE 754 binary16), rows from top to bottom.
//!
//! 1. to 3. *Red, green, blue*: radiance of the clouds times `pre_exposure`, premultiplied by their opacity, linear,
//!    scene-referred: before exposure and tone curve. In units of W/(m² nm sr) over [`WHITE`], so that sunlight above the air
//!    has three equal channels, as in pictures.
//! 4. *Transmittance*: the share of the light from behind all clouds that comes through, 0 to 1; 1 where there are none. It is
//!    grey, as clouds are.
//! 5. *Distance*, km: the mean of where what hides the background hides it, weighted by opacity, along the ray through the
//!    pixel's middle; 0 where there are no clouds.
//!
//! A renderer composites `background * transmittance + colour / pre_exposure`.
//!
//! Every number is the half float next to the device's own: its relative error is at most 2⁻¹¹ from 2⁻¹⁴ on, its absolute error
//! at most 2⁻²⁵ below. So distances hold 2⁻¹¹ of themselves from 6 cm to 65 504 km. There are no negative numbers, infinities
//! or NaNs: what would be larger than 65 504 is 65 504. `pre_exposure` is the power of two below a picture's exposure, so a
//! picture's white is near 1 and that limit 16 stops above it.
//!
//! *How planes stand in the stream.* Each number, as the 16-bit whole number that its bits are, is told as its difference from
//! a prediction out of the left, the upper and the upper left one of its plane (`left`, `up`, `corner`; 0 beyond the edges):
//! `min(left, up)` where `corner >= max(left, up)`, `max(left, up)` where `corner <= min(left, up)`, else
//! `left + up - corner` (the median of these, LOCO-I, M. Weinberger et al. 2000). Of red and blue, what is told is that
//! difference less green's. It is taken modulo 2¹⁶ and folded, 0, -1, 1, -2 … to 0, 1, 2, 3 …: `(d << 1) ^ (d >> 15)` with the
//! sign shifted in. Of each plane all upper bytes come first, then all lower ones.

use std::io::{Read, Write};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use half::f16;
use thiserror::Error;

use crate::view::{FRAME_HEIGHT_MAX, FRAME_WIDTH_MAX};

/// Length of what stands in front of the stream.
pub const CLOUDS_HEADER_BYTES: usize = 32;
/// The version of the format.
pub const CLOUDS_VERSION: u8 = 1;
/// Planes of a picture.
pub const PLANES: usize = 5;
/// Bytes of a pixel as the renderer leaves it: the planes' half floats in their order and one that is not used.
pub const PIXEL_BYTES: usize = 12;
/// Spectral irradiance of the sun above the air at the three channels, relative to its mean: what looks white. Radiance in
/// W/(m² nm sr) is colour times this. The reference solar spectrum (ASTM G173) at 680, 550 and 440 nm.
pub const WHITE: [f32; 3] = [0.8444, 1.0602, 1.0954];

const FLAG_HAZE: u16 = 1 << 0;
const RED: usize = 0;
const GREEN: usize = 1;
const BLUE: usize = 2;
const TRANSMITTANCE: usize = 3;
const DISTANCE: usize = 4;
/// A picture of 3840×2160 has 83 million bytes before it is compressed.
const FAST: Compression = Compression::new(1);

/// What a picture of clouds says of itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudsHeader {
    /// Pixels in a row, 1 to 3840.
    pub width: u32,
    /// Rows, 1 to 2160.
    pub height: u32,
    /// What colour was multiplied by.
    pub pre_exposure: f32,
    /// Colour includes the haze in front of the clouds.
    pub haze: bool,
}

impl CloudsHeader {
    fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    fn checked(self) -> Result<Self, CloudsError> {
        for (name, value, max) in [
            ("width", self.width, FRAME_WIDTH_MAX),
            ("height", self.height, FRAME_HEIGHT_MAX),
        ] {
            if value == 0 || value > max {
                return Err(CloudsError::Size { name, value, max });
            }
        }
        // A power of two has no fraction, and subnormal ones are no exposure.
        if !self.pre_exposure.is_normal()
            || self.pre_exposure.is_sign_negative()
            || self.pre_exposure.to_bits() & 0x007f_ffff != 0
        {
            return Err(CloudsError::PreExposure(self.pre_exposure));
        }
        Ok(self)
    }
}

/// Why bytes are no picture of clouds, or pixels cannot become one.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum CloudsError {
    /// Fewer bytes than the header has.
    #[error("{0} bytes are too few for clouds, whose header has {CLOUDS_HEADER_BYTES}")]
    Truncated(usize),
    /// A version that this crate does not know.
    #[error("version {0} of clouds is unknown; known: {CLOUDS_VERSION}")]
    UnknownVersion(u8),
    /// Another number of planes than the version has.
    #[error("clouds of {0} planes; version {CLOUDS_VERSION} has {PLANES}")]
    Planes(u8),
    /// Flags or reserved bytes that this version does not have.
    #[error(
        "flags or reserved bytes of clouds are set that version {CLOUDS_VERSION} does not have"
    )]
    Reserved,
    /// No such picture.
    #[error("{name} of clouds is {value}; allowed: 1 to {max}")]
    Size {
        /// Width or height.
        name: &'static str,
        /// What it is.
        value: u32,
        /// What it may be.
        max: u32,
    },
    /// Nothing can be divided by it.
    #[error("pre_exposure of clouds is {0}; allowed: positive powers of two")]
    PreExposure(f32),
    /// The stream is not as long as the header says.
    #[error("clouds announce {announced} bytes of data and {found} follow")]
    WrongLength {
        /// What the header says.
        announced: u32,
        /// What follows the header.
        found: usize,
    },
    /// The stream is not zlib's, or damaged.
    #[error("the data of clouds cannot be inflated: {0}")]
    Inflate(String),
    /// The stream holds another number of bytes than the planes.
    #[error("the data of clouds inflates to {found} bytes instead of {expected} or to more")]
    WrongData {
        /// Bytes of the planes.
        expected: usize,
        /// How many there are; one more than expected where there are more.
        found: usize,
    },
    /// A number that clouds cannot have.
    #[error("plane {plane} of clouds holds {value} at pixel {pixel}; allowed: {allowed}")]
    Value {
        /// Which plane, from 0.
        plane: usize,
        /// Which pixel, row by row.
        pixel: usize,
        /// What stands there.
        value: f32,
        /// What may.
        allowed: &'static str,
    },
    /// The pixels are not as many as the size tells.
    #[error("{found} bytes of pixels for clouds of {expected}")]
    WrongPixels {
        /// How many there are.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// The stream cannot be written.
    #[error("clouds cannot be deflated: {0}")]
    Deflate(String),
}

/// A picture of clouds alone.
#[derive(Clone, Debug, PartialEq)]
pub struct Clouds {
    header: CloudsHeader,
    planes: [Vec<f16>; PLANES],
}

impl Clouds {
    /// Reads a payload.
    ///
    /// # Errors
    /// Says what is wrong with it. Takes no more memory than the size that it tells needs.
    pub fn parse(payload: &[u8]) -> Result<Self, CloudsError> {
        let (header, data) = read_header(payload)?;
        let expected = header.pixels() * PLANES * 2;
        let mut stream = ZlibDecoder::new(data);
        let mut bytes = Vec::with_capacity(expected.min(data.len().saturating_mul(1100)) + 1);
        // One more than there may be tells that there is more.
        (&mut stream)
            .take(expected as u64 + 1)
            .read_to_end(&mut bytes)
            .map_err(|error| CloudsError::Inflate(error.to_string()))?;
        if bytes.len() != expected {
            return Err(CloudsError::WrongData {
                expected,
                found: bytes.len(),
            });
        }
        let (pixels, width) = (header.pixels(), header.width as usize);
        let differences = |index: usize| unfolded(&bytes[2 * index * pixels..][..2 * pixels]);
        let green = differences(GREEN);
        let planes = [RED, GREEN, BLUE, TRANSMITTANCE, DISTANCE].map(|index| {
            let mut of_plane = differences(index);
            if index == RED || index == BLUE {
                for (difference, greens) in of_plane.iter_mut().zip(&green) {
                    *difference = difference.wrapping_add(*greens);
                }
            }
            restored(of_plane, width)
        });
        for (index, plane) in planes.iter().enumerate() {
            let (max, allowed) = if index == TRANSMITTANCE {
                (f16::ONE, "0 to 1")
            } else {
                (f16::MAX, "0 to 65504")
            };
            // Bits of positive half floats are in their order.
            let is_wrong = |value: &f16| value.to_bits() > max.to_bits();
            if let Some(pixel) = plane.iter().position(is_wrong) {
                return Err(CloudsError::Value {
                    plane: index,
                    pixel,
                    value: plane[pixel].to_f32(),
                    allowed,
                });
            }
        }
        Ok(Self { header, planes })
    }

    /// What it says of itself.
    pub fn header(&self) -> &CloudsHeader {
        &self.header
    }

    /// Pixels in a row.
    pub fn width(&self) -> u32 {
        self.header.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.header.height
    }

    /// Red, green, blue times `pre_exposure`, transmittance, distance in km: as they were sent, row by row.
    pub fn planes(&self) -> &[Vec<f16>; PLANES] {
        &self.planes
    }

    /// Premultiplied radiance at a pixel (column plus row times width), without the pre-exposure. 0 beyond the last one.
    pub fn radiance(&self, pixel: usize) -> [f32; 3] {
        [0, 1, 2].map(|channel| self.at(channel, pixel) / self.header.pre_exposure)
    }

    /// Transmittance at a pixel, 0 to 1.
    pub fn transmittance(&self, pixel: usize) -> f32 {
        self.at(TRANSMITTANCE, pixel)
    }

    /// Mean distance of what is seen at a pixel, m; 0 where there are no clouds.
    pub fn distance_m(&self, pixel: usize) -> f32 {
        self.at(DISTANCE, pixel) * 1000.0
    }

    fn at(&self, plane: usize, pixel: usize) -> f32 {
        self.planes[plane]
            .get(pixel)
            .map_or(0.0, |value| value.to_f32())
    }
}

fn read_header(payload: &[u8]) -> Result<(CloudsHeader, &[u8]), CloudsError> {
    let Some((header, data)) = payload.split_first_chunk::<CLOUDS_HEADER_BYTES>() else {
        return Err(CloudsError::Truncated(payload.len()));
    };
    let u32_at = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|place| header[at + place]));
    if header[0] != CLOUDS_VERSION {
        return Err(CloudsError::UnknownVersion(header[0]));
    }
    if usize::from(header[1]) != PLANES {
        return Err(CloudsError::Planes(header[1]));
    }
    let flags = u16::from_le_bytes([header[2], header[3]]);
    if flags & !FLAG_HAZE != 0 || header[20..].iter().any(|byte| *byte != 0) {
        return Err(CloudsError::Reserved);
    }
    let told = CloudsHeader {
        width: u32_at(4),
        height: u32_at(8),
        pre_exposure: f32::from_bits(u32_at(12)),
        haze: flags & FLAG_HAZE != 0,
    }
    .checked()?;
    let announced = u32_at(16);
    if data.len() as u64 != u64::from(announced) {
        return Err(CloudsError::WrongLength {
            announced,
            found: data.len(),
        });
    }
    Ok((told, data))
}

/// Appends the payload of `pixels` to `out`: rows from top to bottom, [`PIXEL_BYTES`] a pixel, little-endian. Reads the pixels
/// once, in their order.
///
/// # Errors
/// If the pixels do not fit the size, or the header is none.
pub fn append(out: &mut Vec<u8>, header: &CloudsHeader, pixels: &[u8]) -> Result<(), CloudsError> {
    let header = header.checked()?;
    let expected = header.pixels() * PIXEL_BYTES;
    if pixels.len() != expected {
        return Err(CloudsError::WrongPixels {
            found: pixels.len(),
            expected,
        });
    }
    let begun = out.len();
    out.extend([CLOUDS_VERSION, PLANES as u8]);
    out.extend((if header.haze { FLAG_HAZE } else { 0 }).to_le_bytes());
    out.extend(header.width.to_le_bytes());
    out.extend(header.height.to_le_bytes());
    out.extend(header.pre_exposure.to_le_bytes());
    out.resize(begun + CLOUDS_HEADER_BYTES, 0);
    let deflate = |error: std::io::Error| CloudsError::Deflate(error.to_string());
    let mut stream = ZlibEncoder::new(&mut *out, FAST);
    stream
        .write_all(&folded(pixels, header.width as usize))
        .map_err(deflate)?;
    stream.finish().map_err(deflate)?;
    let data_bytes = u32::try_from(out.len() - begun - CLOUDS_HEADER_BYTES)
        .map_err(|_| CloudsError::Deflate("more than 4 GiB".to_owned()))?;
    out[begun + 16..begun + 20].copy_from_slice(&data_bytes.to_le_bytes());
    Ok(())
}

/// What a number is expected to be beside its neighbours.
fn predicted(left: u16, up: u16, corner: u16) -> u16 {
    let (low, high) = (left.min(up), left.max(up));
    if corner >= high {
        low
    } else if corner <= low {
        high
    } else {
        // Between the two, so no more than either end is beyond the other.
        left.wrapping_add(up).wrapping_sub(corner)
    }
}

/// Small differences to either side become small numbers.
fn fold(difference: u16) -> u16 {
    let signed = difference as i16;
    ((signed << 1) ^ (signed >> 15)) as u16
}

fn unfold(folded: u16) -> u16 {
    (folded >> 1) ^ (folded & 1).wrapping_neg()
}

/// The planes of pixels as the stream has them.
fn folded(pixels: &[u8], width: usize) -> Vec<u8> {
    let count = pixels.len() / PIXEL_BYTES;
    let mut bytes = vec![0; count * PLANES * 2];
    // Of the row above, with a column of nothing on its left.
    let mut above = vec![[0u16; PLANES]; width + 1];
    for (row, line) in pixels.chunks_exact(width * PIXEL_BYTES).enumerate() {
        let (mut left, mut corner) = ([0u16; PLANES], [0u16; PLANES]);
        for (column, pixel) in line.chunks_exact(PIXEL_BYTES).enumerate() {
            let at = row * width + column;
            let up = above[column + 1];
            let mut differences = [0u16; PLANES];
            for plane in 0..PLANES {
                let value = u16::from_le_bytes([pixel[2 * plane], pixel[2 * plane + 1]]);
                let expected = predicted(left[plane], up[plane], corner[plane]);
                differences[plane] = value.wrapping_sub(expected);
                left[plane] = value;
            }
            for plane in [RED, BLUE] {
                differences[plane] = differences[plane].wrapping_sub(differences[GREEN]);
            }
            for (plane, difference) in differences.into_iter().enumerate() {
                let [upper, lower] = fold(difference).to_be_bytes();
                bytes[2 * plane * count + at] = upper;
                bytes[(2 * plane + 1) * count + at] = lower;
            }
            above[column + 1] = left;
            corner = up;
        }
    }
    bytes
}

/// Differences out of their upper and their lower bytes.
fn unfolded(folded: &[u8]) -> Vec<u16> {
    let (upper, lower) = folded.split_at(folded.len() / 2);
    let pairs = upper.iter().zip(lower);
    pairs
        .map(|(upper, lower)| unfold(u16::from_be_bytes([*upper, *lower])))
        .collect()
}

/// A plane out of its differences from what was predicted.
fn restored(differences: Vec<u16>, width: usize) -> Vec<f16> {
    let mut plane = Vec::with_capacity(differences.len());
    let mut above = vec![0u16; width];
    for row in differences.chunks_exact(width) {
        let (mut left, mut corner) = (0, 0);
        for (up, difference) in above.iter_mut().zip(row) {
            left = predicted(left, *up, corner).wrapping_add(*difference);
            corner = *up;
            *up = left;
            plane.push(f16::from_bits(left));
        }
    }
    plane
}

#[cfg(test)]
mod tests;
