//! Pictures through an encoder and back.

use super::{CodecPoint, Compression};
use crate::encode::colours::Spread;
use crate::encode::i420::{I420, rgb_of, rgb_of_spread};
use crate::encode::{StreamPicture, ViewerStream, encode_after};
use crate::measure::metrics::{ShownErrors, shown_errors};
use crate::measure::reference::without_alpha;
use anyhow::Context;
use image::RgbImage;
use openh264::decoder::Decoder;
use skycell_protocol::{Codec, FrameSize};
use std::time::{Duration, Instant};

/// One compression under study, and what it did so far.
pub(super) struct Studied {
    compression: Compression,
    size: FrameSize,
    fps: u32,
    stream: ViewerStream,
    decoder: Decoder,
    planes: I420,
    spread: Spread,
    /// When the next picture is made, by a clock that goes by pictures.
    now: Instant,
    bytes: Vec<usize>,
    encode_s: Vec<f64>,
    errors: Vec<ShownErrors>,
    /// Of 8-bit steps, of every compared picture.
    mean_squares: Vec<f64>,
}

impl Studied {
    pub(super) fn new(compression: Compression, size: FrameSize, fps: u32) -> anyhow::Result<Self> {
        Ok(Self {
            compression,
            size,
            fps,
            stream: ViewerStream::default(),
            decoder: Decoder::new()?,
            planes: I420::new(size),
            spread: Spread::default(),
            now: Instant::now(),
            bytes: Vec::new(),
            encode_s: Vec::new(),
            errors: Vec::new(),
            mean_squares: Vec::new(),
        })
    }

    /// The next picture: tone-mapped sRGB, 4 bytes a pixel. Single pictures are compressed only where they are compared.
    pub(super) fn take(&mut self, rgba: &[u8], is_compared: bool) -> anyhow::Result<()> {
        self.now += Duration::from_secs_f64(1.0 / f64::from(self.fps));
        match self.compression {
            Compression::H264(target_kbit_per_s) | Compression::PlainH264(target_kbit_per_s) => {
                let picture = StreamPicture {
                    rgba,
                    size: self.size,
                    codec: Codec::H264,
                    target_kbit_per_s,
                    fps_max: self.fps as f32,
                    scales_colours: matches!(self.compression, Compression::H264(_)),
                    is_pair: false,
                };
                let mut unit = Vec::new();
                let begun = Instant::now();
                let made = self
                    .stream
                    .encode(&picture, &mut false, self.now, &mut unit)?;
                self.encode_s.push(begun.elapsed().as_secs_f64());
                self.bytes.push(unit.len());
                let planes = self.decoder.decode(&unit)?.context("no picture came")?;
                if is_compared {
                    let decoded = match made.colours {
                        Some(scale) => rgb_of_spread(&planes, scale, self.size)?,
                        None => rgb_of(&planes, self.size)?,
                    };
                    self.compare(rgba, decoded)?;
                }
            }
            Compression::Jpeg(quality) if is_compared => {
                let mut file = Vec::new();
                let begun = Instant::now();
                encode_after(&mut file, rgba, self.size, Codec::Jpeg, quality)?;
                self.encode_s.push(begun.elapsed().as_secs_f64());
                self.bytes.push(file.len());
                let format = image::ImageFormat::Jpeg;
                let decoded = image::load_from_memory_with_format(&file, format)?;
                self.compare(rgba, decoded.to_rgb8().into_raw())?;
            }
            Compression::Colours if is_compared => {
                let begun = Instant::now();
                let (scale, _) = self.spread.fill(&mut self.planes, rgba, true, false)?;
                self.encode_s.push(begun.elapsed().as_secs_f64());
                self.bytes.push(self.planes.bytes());
                let decoded = rgb_of_spread(&self.planes, scale, self.size)?;
                self.compare(rgba, decoded)?;
            }
            Compression::PlainColours if is_compared => {
                let begun = Instant::now();
                self.planes.fill(rgba)?;
                self.encode_s.push(begun.elapsed().as_secs_f64());
                self.bytes.push(self.planes.bytes());
                let decoded = rgb_of(&self.planes, self.size)?;
                self.compare(rgba, decoded)?;
            }
            Compression::Jpeg(_) | Compression::Colours | Compression::PlainColours => {}
        }
        Ok(())
    }

    fn compare(&mut self, rgba: &[u8], decoded: Vec<u8>) -> anyhow::Result<()> {
        let picture = |rgb| {
            RgbImage::from_raw(self.size.width(), self.size.height(), rgb)
                .context("a picture of another size")
        };
        let before = picture(without_alpha(rgba))?;
        let after = picture(decoded)?;
        let pairs = before.as_raw().iter().zip(after.as_raw());
        let sum: u64 = pairs.map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2)).sum();
        self.mean_squares
            .push(sum as f64 / before.as_raw().len() as f64);
        self.errors.push(shown_errors(&before, &after)?);
        Ok(())
    }

    pub(super) fn point(&self) -> CodecPoint {
        let mean = |values: &mut dyn Iterator<Item = f64>| {
            let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
            sum / f64::max(count, 1.0)
        };
        let mut encode_s = self.encode_s.clone();
        encode_s.sort_by(f64::total_cmp);
        let median_s = encode_s.get(encode_s.len() / 2).copied().unwrap_or(0.0);
        let bytes = mean(&mut self.bytes.iter().map(|bytes| *bytes as f64));
        CodecPoint {
            size: self.size,
            compression: self.compression,
            mbit_per_s: bytes * 8e-6 * f64::from(self.fps),
            largest_bytes: self.bytes.iter().copied().max().unwrap_or(0),
            flip: mean(&mut self.errors.iter().map(|errors| errors.flip)),
            flip_worst: self
                .errors
                .iter()
                .map(|errors| errors.flip)
                .fold(0.0, f64::max),
            ssim: mean(&mut self.errors.iter().map(|errors| errors.ssim)),
            psnr_db: 10.0
                * (255.0_f64.powi(2) / mean(&mut self.mean_squares.iter().copied())).log10(),
            encode_ms: median_s * 1e3,
            compared: self.errors.len() as u32,
        }
    }
}
