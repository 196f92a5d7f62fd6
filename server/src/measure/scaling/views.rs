//! Viewers at one place through the real renderer: overlap, number and mip bias against time, texels and memory.
//!
//! The viewers stand in a ring, turned about the vertical axis, as in "Clouds in the Cloud" 6.4 and in `skycell load`: each
//! has a horizontal field of view of 360° over their number, 90° at most, and is turned by (1 − overlap) of it.

use crate::frame_loop::{SharedFigures, StillRenderer, StillSettings};
use crate::march::MarchSettings;
use anyhow::Context;
use serde::Serialize;
use skycell_protocol::{Camera, FrameSize};

/// A wider picture stretches so much towards its edges that nobody would wish for it, degrees.
pub(super) const HORIZONTAL_FOV_MAX_DEG: f64 = 90.0;
/// Height of everybody's eyes, m.
const EYE_M: f64 = 2.0;
/// How far up everybody looks, degrees.
const PITCH_DEG: f64 = 12.0;

/// How many viewers, how much they share, how coarse the cache is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RingSetup {
    /// At one place.
    pub viewers: u32,
    /// Share of the field of view that neighbours have in common, 0 to 1.
    pub overlap: f64,
    /// Halvings of the cache's resolution below the screen's.
    pub mip_bias: f32,
    /// Of each picture.
    pub size: FrameSize,
    /// Steps through a layer's thickness.
    pub steps: u32,
    /// Samples of a texel.
    pub samples: u32,
    /// Where several texels make a pixel, it is their samples together that are so many.
    #[serde(default)]
    pub samples_by_area: bool,
}

/// What a ring took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RingOutcome {
    /// The ring.
    #[serde(flatten)]
    pub setup: RingSetup,
    /// Texels, times, memory.
    #[serde(flatten)]
    pub figures: SharedFigures,
    /// Rays that a screen-space renderer marches for the same pictures: one per pixel, sample and viewer.
    pub screen_space_rays: u64,
    /// Texels marched for each of those rays.
    pub marches_per_ray: f64,
}

impl RingSetup {
    /// Everybody's camera.
    ///
    /// # Errors
    /// When a picture is so flat or narrow that there is no such camera.
    pub fn cameras(&self) -> anyhow::Result<Vec<Camera>> {
        self.cameras_across((360.0 / f64::from(self.viewers)).min(HORIZONTAL_FOV_MAX_DEG))
    }

    /// The same with pictures of another width, degrees: neighbours share as much, and the ring may go round several times.
    ///
    /// # Errors
    /// As [`Self::cameras`].
    pub fn cameras_across(&self, across_deg: f64) -> anyhow::Result<Vec<Camera>> {
        let half_width = (across_deg.to_radians() / 2.0).tan();
        let aspect = f64::from(self.size.height()) / f64::from(self.size.width());
        let vertical_fov_deg = 2.0 * (half_width * aspect).atan().to_degrees();
        (0..self.viewers)
            .map(|viewer| {
                let yaw_deg = f64::from(viewer) * (1.0 - self.overlap) * across_deg;
                Camera::new([0.0, EYE_M, 0.0], yaw_deg, PITCH_DEG, vertical_fov_deg)
                    .context("a viewer of the ring (--viewers, --size)")
            })
            .collect()
    }

    /// Renders it.
    ///
    /// # Errors
    /// When there is no such camera or the device is lost.
    pub fn render(
        &self,
        still: &mut StillRenderer,
        progress: impl FnMut(f64),
    ) -> anyhow::Result<SharedFigures> {
        let settings = StillSettings {
            march: MarchSettings {
                steps: self.steps,
                ..MarchSettings::default()
            },
            samples: self.samples,
            samples_by_area: self.samples_by_area,
            mip_bias: self.mip_bias,
            shared_background: still.is_software(),
            ..StillSettings::default()
        };
        let cameras = self.cameras()?;
        Ok(still.render_shared(&cameras, self.size, &settings, progress)?)
    }

    /// What that took, beside what others take.
    #[must_use]
    pub fn outcome(&self, figures: SharedFigures) -> RingOutcome {
        let rays =
            u64::from(self.viewers) * u64::from(self.size.pixels()) * u64::from(self.samples);
        RingOutcome {
            setup: *self,
            figures,
            screen_space_rays: rays,
            marches_per_ray: figures.marches as f64 / rays as f64,
        }
    }

    /// A guess at the work: it shares the time that is left out among the rings.
    #[must_use]
    pub fn expected_work(&self) -> f64 {
        let unique = 1.0 + (f64::from(self.viewers) - 1.0) * (1.0 - self.overlap);
        unique * f64::from(-2.0 * self.mip_bias).exp2() + 0.2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_turned_by_what_they_do_not_share() {
        let setup = RingSetup {
            viewers: 8,
            overlap: 0.4,
            mip_bias: 0.0,
            size: FrameSize::new(320, 180).expect("a size"),
            steps: 64,
            samples: 8,
            samples_by_area: false,
        };
        let cameras = setup.cameras().expect("cameras");
        assert_eq!(cameras.len(), 8);
        let turn_deg = cameras[1].yaw_deg() - cameras[0].yaw_deg();
        assert!((turn_deg - 0.6 * 45.0).abs() < 1e-9, "{turn_deg}");
        // Square pixels: the tangents of half the angles are as width and height.
        let half = |deg: f64| (deg.to_radians() / 2.0).tan();
        let aspect = half(cameras[0].vertical_fov_deg()) / half(45.0);
        assert!((aspect - 9.0 / 16.0).abs() < 1e-12, "{aspect}");
    }
}
