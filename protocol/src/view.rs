//! What a viewer wants to be sent: size, codec, quality, renderer.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::ValueError;
use crate::number_range::NumberRange;
use crate::read_json::{ReadJson, read_name};

/// The widest frame that a viewer may ask for.
pub const FRAME_WIDTH_MAX: u32 = 3840;
/// The highest frame that a viewer may ask for.
pub const FRAME_HEIGHT_MAX: u32 = 2160;
/// How many frames a second a viewer may ask for.
pub const FRAMES_PER_SECOND: NumberRange = NumberRange::new(1.0, 120.0);

const FRAME_WIDTH: NumberRange = NumberRange::new(1.0, FRAME_WIDTH_MAX as f64);
const FRAME_HEIGHT: NumberRange = NumberRange::new(1.0, FRAME_HEIGHT_MAX as f64);

/// Width and height of a frame in pixels: 1x1 to 3840x2160.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub struct FrameSize {
    width: u32,
    height: u32,
}

impl FrameSize {
    /// A size in pixels.
    ///
    /// # Errors
    /// Names `/width` or `/height`, the number and the range, if one is 0 or too large.
    pub fn new(width: u32, height: u32) -> Result<Self, ValueError> {
        Ok(Self {
            width: FRAME_WIDTH.check_u32("/width", width)?,
            height: FRAME_HEIGHT.check_u32("/height", height)?,
        })
    }

    /// Pixels in a row.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// The picture of two eyes side by side, each of this size.
    pub fn pair(&self) -> Self {
        Self {
            width: 2 * self.width,
            ..*self
        }
    }

    /// Pixels of the frame.
    pub fn pixels(&self) -> u32 {
        // At most 3840 * 2160, or twice that.
        self.width * self.height
    }
}

/// How a frame's pixels are compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Codec {
    /// Small and lossy.
    #[default]
    Jpeg,
    /// Exact and slow.
    Png,
    /// A stream in which pictures build on earlier ones.
    H264,
    /// Clouds alone, as half floats: see [`crate::clouds`].
    Clouds,
}

impl Codec {
    /// Every codec by its name on the wire.
    pub const NAMES: [(&'static str, Self); 4] = [
        ("jpeg", Self::Jpeg),
        ("png", Self::Png),
        ("h264", Self::H264),
        ("clouds", Self::Clouds),
    ];

    /// The codec of a name on the wire.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::NAMES
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, codec)| *codec)
    }

    /// Whether its pictures build on earlier ones.
    pub fn is_stream(self) -> bool {
        match self {
            Self::Jpeg | Self::Png | Self::Clouds => false,
            Self::H264 => true,
        }
    }

    /// All names, for messages.
    pub(crate) fn names() -> String {
        Self::NAMES.map(|(name, _)| format!("{name:?}")).join(", ")
    }
}

impl ReadJson for Codec {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &Self::NAMES)
    }
}

/// Which renderer makes a viewer's frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RendererKind {
    /// Reads the caches that the viewers of a cell share.
    #[default]
    Cached,
    /// Marches one ray per pixel, for comparison.
    ScreenSpace,
}

impl ReadJson for RendererKind {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(
            value,
            pointer,
            &[
                ("cached", Self::Cached),
                ("screen-space", Self::ScreenSpace),
            ],
        )
    }
}

/// The quality of JPEG frames: 1 (small) to 100 (good).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(transparent)]
pub struct JpegQuality(u8);

impl JpegQuality {
    const RANGE: NumberRange = NumberRange::new(1.0, 100.0);

    /// A quality from 1 to 100.
    ///
    /// # Errors
    /// Names `/jpeg_quality`, the number and the range.
    pub fn new(quality: u32) -> Result<Self, ValueError> {
        Self::RANGE.check_u32("/jpeg_quality", quality)?;
        // In 1..=100, so it fits.
        Ok(Self(quality as u8))
    }

    /// The quality as jpeg encoders count it.
    pub fn get(self) -> u8 {
        self.0
    }
}

impl Default for JpegQuality {
    fn default() -> Self {
        Self(85)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_has_at_least_one_pixel_and_at_most_3840x2160() {
        assert_eq!(FrameSize::new(1, 1).map(|size| size.pixels()), Ok(1));
        assert_eq!(
            FrameSize::new(3840, 2160).map(|size| size.pixels()),
            Ok(8_294_400)
        );
        for (width, height, pointer) in [
            (0, 0, "/width"),
            (1, 0, "/height"),
            (100_000, 100_000, "/width"),
            (3840, 2161, "/height"),
            (u32::MAX, 1, "/width"),
        ] {
            let error = FrameSize::new(width, height).expect_err("out of range");
            assert_eq!(error.pointer, pointer);
        }
    }

    #[test]
    fn jpeg_quality_is_1_to_100() {
        assert!(JpegQuality::new(0).is_err() && JpegQuality::new(101).is_err());
        assert_eq!(JpegQuality::new(100).map(JpegQuality::get), Ok(100));
    }
}
