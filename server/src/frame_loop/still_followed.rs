//! One picture of a viewer that has come from elsewhere: what domes that follow it show before anything is marched again.

#[cfg(test)]
mod tests;

use super::still::{Start, StillRenderer, VIEWER};
use super::still_settings::{StillPicture, StillSettings};
use crate::gpu::GpuError;
use skycell_protocol::{Camera, FrameSize, InputSequence};

/// Time between two places of a way, s.
const STEP_S: f64 = 0.1;

impl StillRenderer {
    /// Marches all that is seen from the first camera of a way, lets the viewer go to the others one after another without
    /// marching anything, and renders what it sees from the last; `progress` gets the share that is done.
    ///
    /// # Errors
    /// Without a camera, or when the device is lost.
    pub fn render_followed(
        &mut self,
        way: &[Camera],
        size: FrameSize,
        settings: &StillSettings,
        progress: impl FnMut(f64),
    ) -> Result<StillPicture, GpuError> {
        let [first, others @ ..] = way else {
            return Err(GpuError::Device("a way has at least one place".into()));
        };
        let settings = &StillSettings {
            reference_offset_m: [0.0; 3],
            ..*settings
        };
        let start = Start::of(self, settings)?;
        let screen_space = self.join(*first, size, settings);
        self.prepare_composites(screen_space, settings, false)?;
        self.renderer.refresh_cells();
        self.march_all(screen_space, progress)?;
        for (place, camera) in (1..).zip(others) {
            let renderer = &mut self.renderer;
            renderer.set_camera(VIEWER, InputSequence(place), *camera);
            renderer.regroup(STEP_S);
            renderer.refresh_cells();
            renderer.gpu.wait()?;
        }
        self.prepare_composites(screen_space, settings, false)?;
        let (display, linear) = self.composites(size, screen_space, settings)?;
        Ok(StillPicture {
            size,
            display,
            linear,
            figures: start.figures(self)?,
        })
    }
}
