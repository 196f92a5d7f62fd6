//! Clouds alone without a server.

use super::clouds::of_format;
use super::still::{StillRenderer, VIEWER};
use super::still_settings::StillSettings;
use crate::composite::{Picture, PictureFormat, ground_key};
use crate::gpu::{GpuError, PipelineKey, read_buffer_blocking};
use skycell_protocol::clouds::CloudsHeader;
use skycell_protocol::{FrameSize, RendererKind};

/// A picture of clouds alone, as the device leaves it.
#[derive(Clone, Debug, PartialEq)]
pub struct StillClouds {
    /// What it says of itself.
    pub header: CloudsHeader,
    /// What [`skycell_protocol::clouds::append`] takes.
    pub pixels: Vec<u8>,
}

impl StillRenderer {
    /// Clouds alone of the picture that was rendered last, of its size and settings: from the same texels or rays.
    ///
    /// # Errors
    /// When no picture was rendered before, or the device is lost.
    pub fn clouds_of_last(
        &mut self,
        size: FrameSize,
        settings: &StillSettings,
        haze: bool,
    ) -> Result<StillClouds, GpuError> {
        let gone = || GpuError::Device("no picture was rendered before".into());
        let viewer = self.renderer.viewers.get(&VIEWER).ok_or_else(gone)?;
        let (cell, screen_space) = (viewer.cell, viewer.kind == RendererKind::ScreenSpace);
        let [display_keys, _] = self.composite_keys(screen_space, settings);
        let keys: Vec<PipelineKey> = display_keys
            .into_iter()
            .map(|key| of_format(key, PictureFormat::Clouds, haze))
            .collect();
        let renderer = &mut self.renderer;
        for key in &keys {
            renderer.pipelines.prepare(&renderer.gpu, *key)?;
            let ground = ground_key(*key);
            renderer.pipelines.prepare(&renderer.gpu, ground)?;
        }
        let (gpu, pipelines) = (&renderer.gpu, &renderer.pipelines);
        let format = PictureFormat::Clouds;
        let picture = Picture::of_format(gpu, pipelines, size, keys.len(), format, None);
        renderer.composite_still(VIEWER, &picture, &keys, None)?;
        let shown = settings.stereo.map_or(size, |_| size.pair());
        Ok(StillClouds {
            header: CloudsHeader {
                width: shown.width(),
                height: shown.height(),
                pre_exposure: renderer.pre_exposure_in(cell),
                haze,
            },
            pixels: read_buffer_blocking(&renderer.gpu, picture.pixels())?,
        })
    }
}
