//! Pictures one after another from one cache: other eyes, or other ways to read it.

use super::still::{StillRenderer, VIEWER};
use super::still_settings::StillSettings;
use crate::composite::{Picture, ground_key};
use crate::config::PlacedCell;
use crate::gpu::{GpuError, PipelineKey, TimedPass, read_buffer_blocking};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use skycell_protocol::{Camera, FrameSize, InputSequence};
use skycell_shaders::Features;

/// One of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StillFrame {
    /// From where.
    pub camera: Camera,
    /// As [`StillSettings::parallax_steps`].
    pub parallax_steps: u32,
    /// As [`StillSettings::phase_of_reference`].
    pub phase_of_reference: bool,
}

/// What one of them took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameFigures {
    /// Texels marched since the frame before.
    pub marches: u64,
    /// Device time of its composite, the least of several, where the device can tell, ns.
    pub composite_ns: Option<u64>,
    /// Reads of atlas, page tables and origins by its composite, for each pixel.
    pub reads_per_pixel: Option<f64>,
}

/// What is found out about each frame beside its picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameCosts {
    /// Times that it is composited to find the least time; 0: not timed.
    pub timed: u32,
    /// Whether reads are counted.
    pub counts_reads: bool,
}

impl StillRenderer {
    /// Renders frames from one cache whose rays start `reference_offset_m` from the first camera, and stay there: texels
    /// that a frame wants and an earlier one has marched are there. The settings of the first frame count, but for how the
    /// cache is read. `made` gets each picture, tone-mapped sRGB of 4 bytes a pixel.
    ///
    /// # Errors
    /// When the device is lost, the picture does not fit on it, an eye has rays of its own, or `made` fails.
    pub fn render_frames(
        &mut self,
        size: FrameSize,
        settings: &StillSettings,
        frames: &[StillFrame],
        costs: FrameCosts,
        mut made: impl FnMut(usize, Vec<u8>, FrameFigures) -> Result<(), GpuError>,
    ) -> Result<(), GpuError> {
        let Some(first) = frames.first() else {
            return Ok(());
        };
        self.begin(settings)?;
        let offset_m = DVec3::from_array(settings.reference_offset_m);
        let reference_m = DVec3::from_array(first.camera.position_m()) + offset_m;
        self.join_cell(first.camera, size, settings, Some(reference_m));
        for (index, frame) in frames.iter().enumerate() {
            let settings = StillSettings {
                parallax_steps: frame.parallax_steps,
                phase_of_reference: frame.phase_of_reference,
                ..*settings
            };
            let before = self.totals().texels_updated;
            let renderer = &mut self.renderer;
            renderer.parallax_steps = settings.parallax_steps;
            renderer.refresh_quality(VIEWER);
            renderer.set_camera(VIEWER, InputSequence(index as u64), frame.camera);
            if !renderer
                .viewers
                .get(&VIEWER)
                .is_some_and(|viewer| viewer.reads_cache())
            {
                return Err(GpuError::Device("an eye that has rays of its own".into()));
            }
            self.renderer.refresh_cells();
            self.prepare_composites(false, &settings, false)?;
            self.march_all(false, |_| {})?;
            let [keys, linear_keys] = self.composite_keys(false, &settings);
            let display = self.composite_bytes(size, &keys, false)?;
            let marches = self.totals().texels_updated - before;
            let composite_ns = self.least_composite_ns(size, &keys, costs.timed)?;
            let reads_per_pixel = if costs.counts_reads {
                Some(self.reads_per_pixel(size, &linear_keys)?)
            } else {
                None
            };
            let figures = FrameFigures {
                marches,
                composite_ns,
                reads_per_pixel,
            };
            made(index, display, figures)?;
        }
        Ok(())
    }

    fn composite_bytes(
        &mut self,
        size: FrameSize,
        keys: &[PipelineKey],
        linear: bool,
    ) -> Result<Vec<u8>, GpuError> {
        let renderer = &mut self.renderer;
        let picture = Picture::new(&renderer.gpu, &renderer.pipelines, size, linear);
        renderer.composite_still(VIEWER, &picture, keys, None)?;
        read_buffer_blocking(&renderer.gpu, picture.pixels())
    }

    /// The least of some times: what others do beside it can only lengthen one.
    fn least_composite_ns(
        &mut self,
        size: FrameSize,
        keys: &[PipelineKey],
        times: u32,
    ) -> Result<Option<u64>, GpuError> {
        let mut least: Option<u64> = None;
        for _ in 0..times {
            let before_ns = self.renderer.gpu_time(TimedPass::Composite).0;
            self.composite_bytes(size, keys, false)?;
            let ns = self.renderer.gpu_time(TimedPass::Composite).0 - before_ns;
            if ns > 0 {
                least = Some(least.map_or(ns, |least| least.min(ns)));
            }
        }
        Ok(least)
    }

    fn reads_per_pixel(
        &mut self,
        size: FrameSize,
        linear_keys: &[PipelineKey],
    ) -> Result<f64, GpuError> {
        let counting = |key: &PipelineKey| PipelineKey {
            features: Features {
                count_reads: true,
                ..key.features
            },
            ..*key
        };
        let keys: Vec<PipelineKey> = linear_keys.iter().map(counting).collect();
        let renderer = &mut self.renderer;
        for key in &keys {
            renderer.pipelines.prepare(&renderer.gpu, *key)?;
            renderer
                .pipelines
                .prepare(&renderer.gpu, ground_key(*key))?;
        }
        let values: Vec<f32> =
            bytemuck::pod_collect_to_vec(&self.composite_bytes(size, &keys, true)?);
        let reads: f64 = values.chunks_exact(4).map(|p| f64::from(p[3])).sum();
        Ok(reads / f64::from(size.pixels()))
    }
}

/// A cell that everybody is in and whose rays start at a place.
pub(super) fn cell_around(reference_m: DVec3) -> PlacedCell {
    PlacedCell {
        name: "reference".into(),
        center_m: reference_m.to_array(),
        radius_m: 1.0e6,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::RenderConfig;
    use crate::march::MarchSettings;
    use std::path::PathBuf;
    use std::sync::Arc;

    fn still() -> StillRenderer {
        let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
        let config = RenderConfig::new(PathBuf::from(noise));
        StillRenderer::new(config, Arc::default(), &[]).expect("a device")
    }

    fn settings(offset_m: [f64; 3]) -> StillSettings {
        StillSettings {
            march: MarchSettings {
                steps: 16,
                ..MarchSettings::default()
            },
            samples: 1,
            reference_offset_m: offset_m,
            ..StillSettings::default()
        }
    }

    #[test]
    fn frames_of_one_cache_show_what_pictures_of_their_own_caches_show() {
        let mut still = still();
        let size = FrameSize::new(64, 36).expect("a size");
        let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0).expect("a camera");
        let frame = |parallax_steps, phase_of_reference| StillFrame {
            camera,
            parallax_steps,
            phase_of_reference,
        };
        let settings = settings([800.0, 0.0, 0.0]);
        let frames = [frame(16, false), frame(0, false), frame(0, true)];
        let costs = FrameCosts {
            timed: 1,
            counts_reads: true,
        };
        let mut found = Vec::new();
        still
            .render_frames(size, &settings, &frames, costs, |_, picture, figures| {
                found.push((picture, figures));
                Ok(())
            })
            .expect("frames");
        // What is asked for on the spheres alone, the search has asked for too.
        assert!(found[0].1.marches > 0);
        assert_eq!(found[2].1.marches, 0);
        let reads: Vec<f64> = found.iter().filter_map(|f| f.1.reads_per_pixel).collect();
        // Catmull-Rom's five, opacity, distance and the page table for those pixels that are no ground.
        assert!(reads[1] <= 8.0 && reads[1] > 6.0, "{reads:?}");
        // The texel on the sphere, and some places.
        assert!(reads[0] > 1.5 * reads[1], "{reads:?}");
        for (frame, (picture, _)) in frames.iter().zip(&found) {
            let own = StillSettings {
                parallax_steps: frame.parallax_steps,
                phase_of_reference: frame.phase_of_reference,
                ..settings
            };
            let own = still
                .render_with(camera, size, &own, |_| {})
                .expect("a picture");
            let apart = picture
                .iter()
                .zip(&own.display)
                .filter(|(a, b)| a.abs_diff(**b) > 2)
                .count();
            // Tiles of neighbouring levels may be there for one and not for the other.
            assert!(apart * 100 < picture.len(), "{frame:?}: {apart}");
        }
    }

    #[test]
    fn the_phase_that_a_texel_keeps_differs_beside_the_reference_and_is_the_viewers_own_at_it() {
        let mut still = still();
        let size = FrameSize::new(64, 36).expect("a size");
        let azimuth_deg = still.scene().sun().azimuth_deg();
        let camera = Camera::new([0.0, 2.0, 0.0], azimuth_deg, 25.0, 60.0).expect("a camera");
        let mut apart = Vec::new();
        for offset_m in [0.0, 2_000.0] {
            let offset_m = camera.right() * offset_m;
            let frames = [false, true].map(|phase_of_reference| StillFrame {
                camera,
                parallax_steps: 0,
                phase_of_reference,
            });
            let mut pictures = Vec::new();
            let settings = settings(offset_m.to_array());
            still
                .render_frames(
                    size,
                    &settings,
                    &frames,
                    FrameCosts::default(),
                    |_, picture, _| {
                        pictures.push(picture);
                        Ok(())
                    },
                )
                .expect("frames");
            let most = pictures[0]
                .iter()
                .zip(&pictures[1])
                .map(|(a, b)| a.abs_diff(*b))
                .max();
            apart.push(most.unwrap_or(0));
        }
        assert!(apart[0] <= 1, "{apart:?}");
        // Ten times what rounding may do.
        assert!(apart[1] > 10, "{apart:?}");
    }
}
