//! Measures points: renders, compares, keeps.

use super::metrics::{flip_map, linear_errors, shown_errors};
use super::reference::{PathTraced, Reference, without_alpha};
use super::settings::{PictureCodec, PointSettings};
use super::store::{Cost, Measurement, Record, Store, key_of, write_whole};
use crate::encode::encode_after;
use crate::frame_loop::{StillFigures, StillRenderer};
use anyhow::Context;
use image::{ImageFormat, RgbImage};
use skycell_protocol::{Camera, Codec, FrameSize};
use std::io::Cursor;
use std::path::PathBuf;
use std::time::Instant;

/// A picture that takes less is rendered twice, and the faster time taken.
const TIMED_TWICE_BELOW_S: f64 = 0.5;

/// All that points are measured with.
pub struct Sweep {
    /// Renders them.
    pub still: StillRenderer,
    /// Where the eye is.
    pub camera: Camera,
    /// Of the shown picture.
    pub size: FrameSize,
    /// What they are compared with.
    pub reference: Reference,
    /// The truth about the model's approximations, if it was rendered.
    pub path_traced: Option<PathTraced>,
    /// Where results are kept.
    pub store: Store,
    /// Folder of the store.
    pub folder: PathBuf,
    /// All that a result depends on beside settings and reference.
    pub depends_on: Vec<String>,
    /// Points that were measured and not read.
    pub measured: u32,
    /// Points whose pipelines were run.
    pub warm: Vec<PointSettings>,
}

impl Sweep {
    /// The picture of a point, shown, as PNG.
    #[must_use]
    pub fn picture_path(&self, key: &str) -> PathBuf {
        self.folder.join("pictures").join(format!("{key}.png"))
    }

    /// Its FLIP map, in Magma's colours, as PNG.
    #[must_use]
    pub fn flip_path(&self, key: &str) -> PathBuf {
        self.folder.join("flip").join(format!("{key}.png"))
    }

    /// The key of a point.
    ///
    /// # Errors
    /// When settings are no JSON, which only a change of theirs can bring about.
    pub fn key(&self, settings: &PointSettings) -> anyhow::Result<String> {
        let settings = serde_json::to_string(settings)?;
        let mut parts: Vec<&str> = self.depends_on.iter().map(String::as_str).collect();
        parts.extend([self.reference.key.as_str(), settings.as_str()]);
        let paths = self
            .path_traced
            .as_ref()
            .map(|traced| traced.paths.to_string());
        parts.extend(paths.as_deref());
        Ok(key_of(&parts))
    }

    /// Whether a point needs no rendering.
    #[must_use]
    pub fn is_kept(&self, settings: &PointSettings) -> bool {
        self.key(settings)
            .is_ok_and(|key| self.kept(&key).is_some())
    }

    fn kept(&self, key: &str) -> Option<&Record> {
        let pictures = [self.picture_path(key), self.flip_path(key)];
        self.store
            .get(key)
            .filter(|_| pictures.iter().all(|path| path.is_file()))
    }

    /// A point's result, measured if it is not there yet. `progress` gets the share that is done.
    ///
    /// # Errors
    /// When the device fails or the result cannot be kept.
    pub fn measure(
        &mut self,
        settings: &PointSettings,
        mut progress: impl FnMut(f64),
    ) -> anyhow::Result<Record> {
        let key = self.key(settings)?;
        if let Some(record) = self.kept(&key) {
            return Ok(record.clone());
        }
        let (shown, measurement) = match settings.codec {
            Some(codec) => self.measure_codec(codec, settings, &mut progress)?,
            None => self.measure_picture(settings, &mut progress)?,
        };
        self.keep_picture(&self.picture_path(&key), &shown)?;
        let flip = flip_map(&self.reference.shown, &shown)?;
        self.keep_picture(&self.flip_path(&key), &flip.colours)?;
        let record = Record {
            key,
            settings: *settings,
            measurement,
        };
        self.store.put(record.clone())?;
        self.measured += 1;
        Ok(record)
    }

    /// Runs the pipelines of a point once: a driver may compile at the first dispatch, which is no cost of the point.
    fn warm_up(&mut self, settings: &PointSettings) -> anyhow::Result<()> {
        let tiny = settings.of_least_work();
        if !self.warm.contains(&tiny) {
            let size = FrameSize::new(8, 8)?;
            self.still.render_with(
                self.camera,
                size,
                &tiny.still_settings(&self.camera, false),
                |_| {},
            )?;
            self.warm.push(tiny);
        }
        Ok(())
    }

    fn measure_picture(
        &mut self,
        settings: &PointSettings,
        progress: &mut impl FnMut(f64),
    ) -> anyhow::Result<(RgbImage, Measurement)> {
        self.warm_up(settings)?;
        let plain = settings.still_settings(&self.camera, false);
        let counting = settings.still_settings(&self.camera, true);
        let picture = self
            .still
            .render_with(self.camera, self.size, &plain, |share| {
                progress(0.5 * share)
            })?;
        let StillFigures {
            marches,
            mut gpu_ns,
            mut wall_s,
            ..
        } = picture.figures;
        if wall_s < TIMED_TWICE_BELOW_S {
            let again = self
                .still
                .render_with(self.camera, self.size, &plain, |_| {})?
                .figures;
            wall_s = wall_s.min(again.wall_s);
            gpu_ns = gpu_ns.min(again.gpu_ns);
        }
        // Counting costs time: a run of its own.
        let counted = self
            .still
            .render_with(self.camera, self.size, &counting, |share| {
                progress(0.5 + 0.5 * share)
            })?;
        let StillFigures {
            texture_reads,
            density_evaluations,
            ..
        } = counted.figures;
        let shown = RgbImage::from_raw(
            self.size.width(),
            self.size.height(),
            without_alpha(&picture.display),
        )
        .context("the device gave a picture of another size")?;
        let radiance = without_alpha(&picture.linear);
        let width = self.size.width();
        let linear = linear_errors(&self.reference.linear, &radiance, width)?;
        let path_traced = match &self.path_traced {
            Some(traced) => {
                let found = linear_errors(&traced.linear, &radiance, width)?.relative_mse;
                Some((found - traced.noise).max(0.0))
            }
            None => None,
        };
        let measurement = Measurement {
            shown: shown_errors(&self.reference.shown, &shown)?,
            linear: Some(linear),
            path_traced_relative_mse: path_traced,
            cost: Cost {
                marches,
                texture_reads,
                density_evaluations,
                sun_volume_evaluations: picture.figures.sun_volume_evaluations,
                gpu_ns,
                wall_s,
                ..Cost::default()
            },
        };
        Ok((shown, measurement))
    }

    /// Compresses the picture that the point would show without its codec.
    fn measure_codec(
        &mut self,
        codec: PictureCodec,
        settings: &PointSettings,
        progress: &mut impl FnMut(f64),
    ) -> anyhow::Result<(RgbImage, Measurement)> {
        let raw = PointSettings {
            codec: None,
            ..*settings
        };
        let record = self.measure(&raw, &mut *progress as &mut dyn FnMut(f64))?;
        let path = self.picture_path(&record.key);
        let bytes =
            std::fs::read(&path).with_context(|| format!("{} cannot be read", path.display()))?;
        let picture = image::load_from_memory(&bytes)?;
        let encoded = encoded(&picture.to_rgba8(), self.size, codec)?;
        let shown = image::load_from_memory(&encoded.bytes)?.to_rgb8();
        let measurement = Measurement {
            shown: shown_errors(&self.reference.shown, &shown)?,
            linear: None,
            path_traced_relative_mse: None,
            cost: Cost {
                encoded_bytes: Some(encoded.bytes.len() as u64),
                encode_s: Some(encoded.wall_s),
                ..record.measurement.cost
            },
        };
        Ok((shown, measurement))
    }

    fn keep_picture(&self, path: &std::path::Path, picture: &RgbImage) -> anyhow::Result<()> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("{} cannot be made", folder.display()))?;
        }
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, ImageFormat::Png)?;
        Ok(write_whole(path, bytes.get_ref())?)
    }
}

/// A compressed picture.
pub struct Encoded {
    /// The file.
    pub bytes: Vec<u8>,
    /// Time to make it, the faster of two.
    pub wall_s: f64,
}

/// Compresses a picture as the service does.
///
/// # Errors
/// When the codec refuses it.
pub fn encoded(
    picture: &image::RgbaImage,
    size: FrameSize,
    codec: PictureCodec,
) -> anyhow::Result<Encoded> {
    let (codec, quality) = match codec {
        PictureCodec::Jpeg(quality) => (Codec::Jpeg, quality),
        PictureCodec::Png => (Codec::Png, 100),
    };
    let mut encoded = Encoded {
        bytes: Vec::new(),
        wall_s: f64::INFINITY,
    };
    for _ in 0..2 {
        encoded.bytes.clear();
        let start = Instant::now();
        encode_after(&mut encoded.bytes, picture.as_raw(), size, codec, quality)?;
        encoded.wall_s = encoded.wall_s.min(start.elapsed().as_secs_f64());
    }
    Ok(encoded)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jpeg_of_lower_quality_is_smaller_and_worse_and_png_is_exact() {
        let size = FrameSize::new(96, 64).expect("a size");
        let picture = image::RgbaImage::from_fn(96, 64, |x, y| {
            let wave = (f64::from(x) * 0.3).sin() * (f64::from(y) * 0.2).cos();
            image::Rgba([
                (128.0 + 100.0 * wave) as u8,
                (x * 2) as u8,
                (y * 3) as u8,
                255,
            ])
        });
        let rgb = image::DynamicImage::ImageRgba8(picture.clone()).to_rgb8();
        let mut last: Option<(f64, f64, usize)> = None;
        for quality in [95, 70, 30] {
            let file = encoded(&picture, size, PictureCodec::Jpeg(quality)).expect("encoded");
            let back = image::load_from_memory(&file.bytes)
                .expect("a picture")
                .to_rgb8();
            let errors = shown_errors(&rgb, &back).expect("comparable");
            if let Some((flip, ssim, bytes)) = last {
                assert!(
                    errors.flip > flip && errors.ssim < ssim && file.bytes.len() < bytes,
                    "{quality}"
                );
            }
            last = Some((errors.flip, errors.ssim, file.bytes.len()));
        }
        let png = encoded(&picture, size, PictureCodec::Png).expect("encoded");
        assert_eq!(
            image::load_from_memory(&png.bytes)
                .expect("a picture")
                .to_rgb8(),
            rgb
        );
    }
}
