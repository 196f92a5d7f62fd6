//! One point of a sweep: plain values, which the store keys by and the report prints.

use crate::config::FrameFilter;
use crate::frame_loop::StillSettings;
use crate::march::{MarchSettings, WindowPlan};
use crate::sun_volume::SunVolumeSize;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use skycell_protocol::{Camera, RendererKind, SunDepth};

/// How the cache stores a texel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TexelFormat {
    /// Four half floats, rounded to eleven digits in the kernel, and a float of distance: 12 bytes.
    Rgba16Float,
}

/// How a shown picture is compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PictureCodec {
    /// JPEG of a quality from 1 to 100.
    Jpeg(u8),
    /// PNG: nothing is lost.
    Png,
}

/// A point of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointSettings {
    /// Which renderer.
    pub renderer: RendererKind,
    /// Steps through a layer's thickness, of each sample.
    pub steps: u32,
    /// Steps towards the sun; the scene's without.
    pub sun_steps: Option<u32>,
    /// How optical depth towards the sun comes about; the scene's choice without.
    #[serde(default)]
    pub sun_depth: Option<SunDepth>,
    /// Size of the sun volume, where one is used.
    #[serde(default)]
    pub sun_volume: SunVolumeSize,
    /// Terms of the multiple-scattering sum; the scene's without.
    pub octaves: Option<u32>,
    /// Rays end where nothing behind can be seen.
    pub early_exit: bool,
    /// Space without cloud is crossed without reading it.
    pub low_density_skip: bool,
    /// Steps grow where they may.
    pub adaptive_step: bool,
    /// Noise interpolated in full precision instead of by the device.
    pub exact_interpolation: bool,
    /// Samples of a pixel or texel.
    pub samples: u32,
    /// Where several texels make a pixel, it is their samples together that are so many (cached).
    #[serde(default)]
    pub samples_by_area: bool,
    /// Frames over which the samples are spread: a frame costs the picture's cost divided by this.
    pub window_frames: u32,
    /// Parts into which a window shares out the steps: a frame takes one (screen-space).
    pub depth_segments: u32,
    /// Parts into which a window cuts a step where cloud begins (screen-space).
    pub refinement: u32,
    /// The marched picture's sides are the shown one's divided by this (screen-space).
    pub resolution_divisor: u32,
    /// Halvings of the cache's resolution below the screen's (cached).
    pub mip_bias: f32,
    /// How the cache is read (cached).
    pub filter: FrameFilter,
    /// How texels are stored (cached).
    pub texel_format: TexelFormat,
    /// How far to the right of the eye the rays start, m (cached).
    pub reference_sideways_m: f64,
    /// What the shown picture went through before it was compared; nothing without.
    pub codec: Option<PictureCodec>,
}

impl PointSettings {
    /// One ray per pixel and sample, with all that saves work.
    #[must_use]
    pub fn screen_space(steps: u32, samples: u32) -> Self {
        Self {
            renderer: RendererKind::ScreenSpace,
            steps,
            sun_steps: None,
            sun_depth: None,
            sun_volume: SunVolumeSize::default(),
            octaves: None,
            early_exit: true,
            low_density_skip: true,
            adaptive_step: true,
            exact_interpolation: false,
            samples,
            samples_by_area: false,
            window_frames: 1,
            depth_segments: 1,
            refinement: 1,
            resolution_divisor: 1,
            mip_bias: 0.0,
            filter: FrameFilter::CatmullRom,
            texel_format: TexelFormat::Rgba16Float,
            reference_sideways_m: 0.0,
            codec: None,
        }
    }

    /// One ray per texel and sample, from the eye.
    #[must_use]
    pub fn cached(steps: u32, samples: u32, mip_bias: f32) -> Self {
        Self {
            renderer: RendererKind::Cached,
            mip_bias,
            ..Self::screen_space(steps, samples)
        }
    }

    /// What the renderer is told. This is the only place in which a point becomes a picture's settings.
    #[must_use]
    pub fn still_settings(&self, camera: &Camera, count_reads: bool) -> StillSettings {
        let offset_m: DVec3 = camera.right() * self.reference_sideways_m;
        StillSettings {
            renderer: self.renderer,
            march: MarchSettings {
                steps: self.steps,
                sun_steps: self.sun_steps,
                sun_depth: self.sun_depth,
                sun_volume: self.sun_volume,
                octaves: self.octaves,
                early_exit: self.early_exit,
                low_density_skip: self.low_density_skip,
                adaptive_step: self.adaptive_step,
                exact_interpolation: self.exact_interpolation,
                count_reads,
                // A single sample stands in the middle of its pixel, else it would shift the picture.
                jitter: self.samples > 1,
                ..MarchSettings::default()
            },
            samples: self.samples,
            samples_by_area: self.samples_by_area,
            show: skycell_protocol::Show::Picture,
            stereo: None,
            codec: skycell_protocol::Codec::Png,
            window: self.window(),
            frames: self.samples,
            resting_frames: 1,
            turn_deg_per_frame: 0.0,
            mip_bias: self.mip_bias,
            filter: self.filter,
            reference_offset_m: offset_m.to_array(),
            parallax_steps: crate::quality::default_parallax_steps(),
            shared_background: false,
            ..StillSettings::default()
        }
    }

    /// The temporal window, where there is one: samples are its frames. A picture that is marched with fewer pixels has one
    /// too, which finds the others.
    fn window(&self) -> Option<WindowPlan> {
        let has_window = self.window_frames > 1 || self.resolution_divisor > 1;
        (has_window && self.renderer == RendererKind::ScreenSpace).then_some(WindowPlan {
            frames: self.samples,
            divisor: self.resolution_divisor,
            depth_segments: self.depth_segments,
            refinement: self.refinement,
        })
    }

    /// Whether a server can be set so: the cache, read from where viewers are, nothing switched off.
    #[must_use]
    pub fn is_quality(&self) -> bool {
        let served = Self {
            sun_steps: self.sun_steps,
            sun_depth: self.sun_depth,
            octaves: self.octaves,
            filter: self.filter,
            samples_by_area: self.samples_by_area,
            ..Self::cached(self.steps, self.samples, self.mip_bias)
        };
        *self == served
    }

    /// A point that runs the same pipelines with next to no work.
    #[must_use]
    pub fn of_least_work(&self) -> Self {
        Self {
            steps: 1,
            sun_steps: Some(1),
            // Octaves come in groups of four, which pipelines are specialised to.
            octaves: self.octaves.map(|n| n.next_multiple_of(4)),
            // One sample would not be jittered.
            samples: self.samples.min(2),
            window_frames: 1,
            mip_bias: 4.0,
            reference_sideways_m: 0.0,
            codec: None,
            ..*self
        }
    }

    /// A guess at the work, in marched steps a pixel: it shares the time that is left out among the points.
    #[must_use]
    pub fn expected_work(&self) -> f64 {
        let area = match self.renderer {
            RendererKind::ScreenSpace => f64::from(self.resolution_divisor).powi(-2),
            // Texels are finer than pixels, whole tiles are marched, and the coarse level always is.
            RendererKind::Cached if self.samples_by_area && self.mip_bias < 0.5 => 2.0,
            RendererKind::Cached => 4.0 * f64::from(-2.0 * self.mip_bias).exp2() + 1.0,
        };
        let sun = 1.0 + f64::from(self.sun_steps.unwrap_or(6)) / 6.0;
        let waste = if self.low_density_skip { 1.0 } else { 3.0 };
        area * sun * waste * f64::from(self.samples) * (f64::from(self.steps) + 16.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_point_lies_to_the_right_of_the_eye() {
        // Looking east, the right is south: z grows.
        let camera = Camera::new([5.0, 2.0, 5.0], 90.0, 20.0, 60.0).expect("a camera");
        let point = PointSettings {
            reference_sideways_m: 300.0,
            ..PointSettings::cached(64, 8, 0.0)
        };
        let [x, y, z] = point.still_settings(&camera, false).reference_offset_m;
        assert!(
            x.abs() < 1e-9 && y == 0.0 && (z - 300.0).abs() < 1e-9,
            "{x} {y} {z}"
        );
    }

    #[test]
    fn a_server_can_be_set_to_cached_points_alone() {
        assert!(PointSettings::cached(64, 8, 1.0).is_quality());
        assert!(!PointSettings::screen_space(64, 8).is_quality());
        let far = PointSettings {
            reference_sideways_m: 300.0,
            ..PointSettings::cached(64, 8, 1.0)
        };
        assert!(!far.is_quality());
    }
}
