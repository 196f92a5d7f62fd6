//! Maps in files: PNG with 8 or 16 bits of grey, EXR with one channel. What a file is, its content says, not its name.

use exr::prelude::{
    AnyChannel, AnyChannels, FlatSamples, Image, ReadChannels, ReadLayers, WritableImage,
};
use image::codecs::png::{PngDecoder, PngEncoder};
use image::{ColorType, ExtendedColorType, ImageDecoder, ImageEncoder};
use skycell_protocol::SceneError;
use skycell_protocol::scene::MapKind;
use std::io::Cursor;
use std::path::Path;

/// The longest file that is read. A map of 8192 × 8192 with 16 bits has 128 MiB before it is compressed.
pub const MAP_FILE_MAX_BYTES: u64 = 64 << 20;
/// The longest side of a map.
pub const MAP_SIDE_MAX: u32 = 8192;
/// What a decoder may hold while it reads: a map of that size with 16 bits, and rows.
const DECODER_MAX_BYTES: u64 = 256 << 20;

const PNG_START: &[u8] = b"\x89PNG\r\n\x1a\n";
const EXR_START: &[u8] = &[0x76, 0x2f, 0x31, 0x01];

/// How a file is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapFileFormat {
    /// Grey, 16 bits.
    Png,
    /// One channel, 32-bit floats.
    Exr,
}

impl MapFileFormat {
    /// What the first bytes of a file say.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(PNG_START) {
            Some(Self::Png)
        } else if bytes.starts_with(EXR_START) {
            Some(Self::Exr)
        } else {
            None
        }
    }

    /// The end of a file's name.
    #[must_use]
    pub const fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Exr => "exr",
        }
    }

    /// Its media type.
    #[must_use]
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Exr => "image/x-exr",
        }
    }
}

/// Grey values 0…1 as a file has them, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct GreyMap {
    /// Texels along a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// As many values as texels.
    pub values: Vec<f32>,
}

/// Why a file is no map.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapFileError {
    /// The file is not there or cannot be read.
    #[error("{file} cannot be read in the folder of maps: {error}")]
    Unreadable {
        /// Its name.
        file: String,
        /// What went wrong.
        error: std::io::Error,
    },
    /// It has too many bytes.
    #[error("a file of {bytes} bytes")]
    TooLong {
        /// How many.
        bytes: u64,
    },
    /// Neither PNG nor EXR.
    #[error("a file that begins with {start}")]
    NoImage {
        /// Its first bytes.
        start: String,
    },
    /// It ends too early, or its content contradicts itself.
    #[error("a broken {} file ({reason})", .format.extension().to_uppercase())]
    Broken {
        /// What it says that it is.
        format: MapFileFormat,
        /// What is wrong.
        reason: String,
    },
    /// It has colours, or transparency.
    #[error("an image with {found}")]
    WrongColour {
        /// What it has.
        found: String,
    },
    /// A side is too long, or 0.
    #[error("an image of {width} x {height}")]
    WrongSize {
        /// Texels along a row.
        width: u64,
        /// Rows.
        height: u64,
    },
    /// A value is none of a map.
    #[error("the value {value} in column {column}, row {row}")]
    WrongValue {
        /// What stands there.
        value: f32,
        /// Counted from 0 at the left.
        column: u32,
        /// Counted from 0 at the top.
        row: u32,
    },
}

impl MapFileError {
    /// What is allowed instead.
    #[must_use]
    pub fn allowed(&self) -> String {
        match self {
            Self::Unreadable { .. } => {
                "the name of a file in the folder of maps, or null".to_owned()
            }
            Self::TooLong { .. } => format!("at most {MAP_FILE_MAX_BYTES} bytes"),
            Self::NoImage { .. } | Self::Broken { .. } => "a whole PNG or EXR file".to_owned(),
            Self::WrongColour { .. } => {
                "PNG with 8 or 16 bits of grey and nothing else, or EXR with one channel".to_owned()
            }
            Self::WrongSize { .. } => format!("1 x 1 to {MAP_SIDE_MAX} x {MAP_SIDE_MAX}"),
            Self::WrongValue { .. } => "values from 0 to 1".to_owned(),
        }
    }

    /// The same as an error of the document at `pointer`.
    #[must_use]
    pub fn at(&self, pointer: impl Into<String>) -> SceneError {
        SceneError {
            pointer: pointer.into(),
            value: self.to_string(),
            allowed: self.allowed(),
        }
    }
}

/// Reads the bytes of a map's file in a folder.
///
/// # Errors
/// When it is not there or too long.
pub fn read_map_file(folder: &Path, file: &str) -> Result<Vec<u8>, MapFileError> {
    let path = folder.join(file);
    let unreadable = |error| MapFileError::Unreadable {
        file: file.to_owned(),
        error,
    };
    let bytes = std::fs::metadata(&path).map_err(unreadable)?.len();
    if bytes > MAP_FILE_MAX_BYTES {
        return Err(MapFileError::TooLong { bytes });
    }
    std::fs::read(&path).map_err(unreadable)
}

fn check_size(width: u64, height: u64) -> Result<(u32, u32), MapFileError> {
    let wrong = || MapFileError::WrongSize { width, height };
    let side = |n: u64| {
        u32::try_from(n)
            .ok()
            .filter(|n| (1..=MAP_SIDE_MAX).contains(n))
            .ok_or_else(wrong)
    };
    Ok((side(width)?, side(height)?))
}

impl GreyMap {
    /// Reads a file.
    ///
    /// # Errors
    /// When it is no map; the size is checked before memory is taken for it.
    pub fn decode(bytes: &[u8]) -> Result<Self, MapFileError> {
        if bytes.len() as u64 > MAP_FILE_MAX_BYTES {
            return Err(MapFileError::TooLong {
                bytes: bytes.len() as u64,
            });
        }
        let format = MapFileFormat::of(bytes).ok_or_else(|| {
            let start: Vec<String> = bytes.iter().take(8).map(|b| format!("{b:02x}")).collect();
            MapFileError::NoImage {
                start: if start.is_empty() {
                    "nothing".to_owned()
                } else {
                    start.join(" ")
                },
            }
        })?;
        // Decoders of strangers' files: a panic in one is a broken file, not an end of the service.
        let decoded = std::panic::catch_unwind(|| match format {
            MapFileFormat::Png => decode_png(bytes),
            MapFileFormat::Exr => decode_exr(bytes),
        })
        .unwrap_or_else(|_| {
            Err(MapFileError::Broken {
                format,
                reason: "its decoder failed".to_owned(),
            })
        })?;
        match decoded
            .values
            .iter()
            .position(|value| !(0.0..=1.0).contains(value))
        {
            None => Ok(decoded),
            Some(index) => Err(MapFileError::WrongValue {
                value: decoded.values[index],
                column: index as u32 % decoded.width,
                row: index as u32 / decoded.width,
            }),
        }
    }

    /// Writes a file.
    ///
    /// # Errors
    /// When the encoder fails; for a map that was decoded or generated it does not.
    pub fn encode(&self, format: MapFileFormat) -> Result<Vec<u8>, MapFileError> {
        let failed = |reason: String| MapFileError::Broken { format, reason };
        let mut file = Vec::new();
        match format {
            MapFileFormat::Png => {
                let texels: Vec<u8> = self
                    .values
                    .iter()
                    .flat_map(|value| ((value * 65_535.0).round() as u16).to_ne_bytes())
                    .collect();
                PngEncoder::new(&mut file)
                    .write_image(&texels, self.width, self.height, ExtendedColorType::L16)
                    .map_err(|error| failed(error.to_string()))?;
            }
            MapFileFormat::Exr => {
                let channel = AnyChannel::new("Y", FlatSamples::F32(self.values.clone()));
                let size = (self.width as usize, self.height as usize);
                let mut channels = AnyChannels::sort(Default::default());
                channels.list.push(channel);
                Image::from_channels(size, channels)
                    .write()
                    .non_parallel()
                    .to_buffered(Cursor::new(&mut file))
                    .map_err(|error| failed(error.to_string()))?;
            }
        }
        Ok(file)
    }
}

fn decode_png(bytes: &[u8]) -> Result<GreyMap, MapFileError> {
    let broken = |error: image::ImageError| MapFileError::Broken {
        format: MapFileFormat::Png,
        reason: error.to_string(),
    };
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(DECODER_MAX_BYTES);
    let decoder = PngDecoder::with_limits(Cursor::new(bytes), limits).map_err(broken)?;
    let (width, height) = decoder.dimensions();
    let (width, height) = check_size(width.into(), height.into())?;
    let texels = width as usize * height as usize;
    let values = match decoder.color_type() {
        ColorType::L8 => {
            let mut read = vec![0u8; texels];
            decoder.read_image(&mut read).map_err(broken)?;
            read.iter().map(|v| f32::from(*v) / 255.0).collect()
        }
        ColorType::L16 => {
            let mut read = vec![0u8; 2 * texels];
            decoder.read_image(&mut read).map_err(broken)?;
            read.chunks_exact(2)
                .map(|two| f32::from(u16::from_ne_bytes([two[0], two[1]])) / 65_535.0)
                .collect()
        }
        other => {
            return Err(MapFileError::WrongColour {
                found: match other {
                    ColorType::La8 | ColorType::La16 => "grey and transparency",
                    ColorType::Rgba8 | ColorType::Rgba16 => "colours and transparency",
                    _ => "colours",
                }
                .to_owned(),
            });
        }
    };
    Ok(GreyMap {
        width,
        height,
        values,
    })
}

fn decode_exr(bytes: &[u8]) -> Result<GreyMap, MapFileError> {
    let broken = |error: exr::error::Error| MapFileError::Broken {
        format: MapFileFormat::Exr,
        reason: error.to_string(),
    };
    let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), true).map_err(broken)?;
    let [header] = meta.headers.as_slice() else {
        return Err(MapFileError::WrongColour {
            found: format!("{} layers", meta.headers.len()),
        });
    };
    let size = header.layer_size;
    let (width, height) = check_size(size.width() as u64, size.height() as u64)?;
    let names: Vec<String> = header
        .channels
        .list
        .iter()
        .map(|channel| channel.name.to_string())
        .collect();
    if header.deep || names.len() != 1 {
        return Err(MapFileError::WrongColour {
            found: if header.deep {
                "deep data".to_owned()
            } else {
                format!("the channels {}", names.join(", "))
            },
        });
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .pedantic()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(broken)?;
    let channels = image.layer_data.channel_data.list;
    let values: Vec<f32> = match channels.into_iter().next().map(|c| c.sample_data) {
        Some(FlatSamples::F16(values)) => values.iter().map(|v| v.to_f32()).collect(),
        Some(FlatSamples::F32(values)) => values,
        Some(FlatSamples::U32(_)) | None => {
            return Err(MapFileError::WrongColour {
                found: "whole numbers".to_owned(),
            });
        }
    };
    if values.len() != width as usize * height as usize {
        return Err(MapFileError::Broken {
            format: MapFileFormat::Exr,
            reason: "as many values as texels are missing".to_owned(),
        });
    }
    Ok(GreyMap {
        width,
        height,
        values,
    })
}

/// Where an error about a layer's map stands in the scene document.
#[must_use]
pub fn map_pointer(layer: usize, kind: MapKind) -> String {
    format!("/layers/{layer}/density/maps/{kind}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: u32, height: u32) -> GreyMap {
        let count = width * height;
        GreyMap {
            width,
            height,
            values: (0..count)
                .map(|i| i as f32 / (count - 1).max(1) as f32)
                .collect(),
        }
    }

    #[test]
    fn a_map_comes_back_from_both_formats() {
        for (width, height) in [(1, 1), (1, 64), (37, 5)] {
            let map = ramp(width, height);
            let exr = map.encode(MapFileFormat::Exr).expect("written");
            assert_eq!(GreyMap::decode(&exr).expect("read"), map);
            let png = map.encode(MapFileFormat::Png).expect("written");
            let read = GreyMap::decode(&png).expect("read");
            for (a, b) in read.values.iter().zip(&map.values) {
                assert!((a - b).abs() <= 0.5 / 65_535.0 + 1e-7, "{a} {b}");
            }
        }
    }

    #[test]
    fn what_is_no_map_is_refused_with_what_it_is_and_what_is_allowed() {
        let told = |bytes: &[u8]| {
            let error = GreyMap::decode(bytes).expect_err("refused");
            format!("{error}; {}", error.allowed())
        };
        assert!(told(b"").contains("begins with nothing"));
        assert!(told(b"\xff\xd8\xff\xe0").contains("begins with ff d8"));
        let mut png = ramp(8, 8).encode(MapFileFormat::Png).expect("written");
        png.truncate(png.len() / 2);
        assert!(told(&png).contains("broken PNG"), "{}", told(&png));
        let mut exr = ramp(64, 64).encode(MapFileFormat::Exr).expect("written");
        exr.truncate(exr.len() / 2);
        assert!(told(&exr).contains("broken EXR"), "{}", told(&exr));
        let mut colours = Vec::new();
        PngEncoder::new(&mut colours)
            .write_image(&[0; 12], 2, 2, ExtendedColorType::Rgb8)
            .expect("written");
        assert!(told(&colours).contains("colours; PNG with 8 or 16 bits"));
        for (value, text) in [
            (f32::NAN, "NaN"),
            (f32::INFINITY, "inf"),
            (-0.25, "-0.25"),
            (1.5, "1.5"),
        ] {
            let mut map = ramp(4, 4);
            map.values[6] = value;
            let exr = map.encode(MapFileFormat::Exr).expect("written");
            let expected = format!("the value {text} in column 2, row 1; values from 0 to 1");
            assert_eq!(told(&exr), expected);
        }
        let mut long = Vec::new();
        PngEncoder::new(&mut long)
            .write_image(&[7; 8193], 8193, 1, ExtendedColorType::L8)
            .expect("written");
        assert_eq!(told(&long), "an image of 8193 x 1; 1 x 1 to 8192 x 8192");
    }

    #[test]
    fn no_prefix_of_a_file_and_no_flipped_byte_ends_the_decoder() {
        for format in [MapFileFormat::Png, MapFileFormat::Exr] {
            let file = ramp(9, 7).encode(format).expect("written");
            for length in 0..file.len() {
                let _ = GreyMap::decode(&file[..length]);
                let mut other = file.clone();
                other[length] ^= 0x55;
                let _ = GreyMap::decode(&other);
            }
        }
    }
}
