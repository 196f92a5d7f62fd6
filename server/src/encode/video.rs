//! What a stream of pictures that build on one another asks of its encoder. Another codec (HEVC, AV1) or an encoder in
//! hardware is another [`VideoEncoder`] that [`open`] knows.

use std::time::Duration;

use skycell_protocol::{Codec, ColourScale, FrameSize};

use super::EncodeError;
use super::h264::H264Encoder;

/// The least rate that an encoder aims at, kbit/s.
pub const KBIT_PER_S_MIN: u32 = 100;
/// The highest rate that an encoder aims at, kbit/s: what a stream of level 4.2 may have.
pub const KBIT_PER_S_MAX: u32 = 50_000;

/// The full rate of the smallest pictures.
const FULL_KBIT_PER_S_MIN: u32 = 500;
/// Rate at 1280 x 720, and in proportion to pixels: what nobody could tell from lossless (Weinrauch et al. 2023, 6.2).
const FULL_KBIT_PER_S: f64 = 8_000.0;
const FULL_PIXELS: f64 = 1280.0 * 720.0;

/// The rate at which a video of a size looks as its pictures do.
pub fn full_rate_kbit_per_s(size: FrameSize) -> u32 {
    let kbit_per_s = FULL_KBIT_PER_S * f64::from(size.pixels()) / FULL_PIXELS;
    (kbit_per_s.round() as u32).clamp(FULL_KBIT_PER_S_MIN, KBIT_PER_S_MAX)
}

/// How a picture is to be encoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VideoWish {
    /// The picture must need no earlier one.
    pub key: bool,
    /// The rate to aim at.
    pub target_kbit_per_s: u32,
    /// How many pictures a second come.
    pub fps: f32,
    /// When the picture was made, from the beginning of the stream on.
    pub time: Duration,
    /// Who decodes puts colours back that were spread ([`skycell_protocol::colour_scale`]).
    pub scales_colours: bool,
    /// The picture is that of two eyes, side by side.
    pub is_pair: bool,
}

/// What became of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AccessUnit {
    /// It needs no earlier one.
    pub is_key: bool,
    /// How its colours are spread; none where they are as the stream says itself.
    pub colours: Option<ColourScale>,
}

/// Makes one viewer's stream, of pictures of one size. Dropping it frees all that it holds.
pub trait VideoEncoder: Send {
    /// Appends the picture of `rgba` (rows from top to bottom, 4 bytes a pixel) to `out`. Whoever decodes must get every one
    /// in order, or a key.
    ///
    /// # Errors
    /// If the pixels do not fit the size or the encoder refuses.
    fn encode(
        &mut self,
        rgba: &[u8],
        wish: &VideoWish,
        out: &mut Vec<u8>,
    ) -> Result<AccessUnit, EncodeError>;
}

/// The encoder for a codec and a size.
///
/// # Errors
/// If there is none, or the encoder refuses the size.
pub fn open(
    codec: Codec,
    size: FrameSize,
    wish: &VideoWish,
) -> Result<Box<dyn VideoEncoder>, EncodeError> {
    match codec {
        Codec::H264 => Ok(Box::new(H264Encoder::new(size, wish)?)),
        codec => Err(EncodeError::WrongKind(codec)),
    }
}
