//! Several viewers of one cell without a server: what sharing costs and saves.

use super::interface::CellStats;
use super::still::StillRenderer;
use super::still_settings::StillSettings;
use crate::cells::CellLimit;
use crate::composite::{Picture, ground_key};
use crate::gpu::{GpuError, TimedPass, read_buffer_blocking};
use serde::{Deserialize, Serialize};
use skycell_protocol::{Camera, FrameSize};
use std::time::Instant;

/// What the pictures of several viewers took, from empty caches until nothing was left to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SharedFigures {
    /// Texels that the viewers request, summed over them.
    pub texels_requested: u64,
    /// The same, each texel once.
    pub texels_unique: u64,
    /// Texels of the coarse level that no viewer requests.
    pub texels_coarse: u64,
    /// Texels marched, each with all its samples.
    pub marches: u64,
    /// Share of requested texels that another viewer requests too, 0 to 1.
    pub measured_overlap: f64,
    /// GPU memory of the caches, bytes.
    pub cache_bytes: u64,
    /// Device time of marching, where it can tell.
    pub march_ns: Option<u64>,
    /// Device time of one picture for each viewer, where it can tell.
    pub composite_ns: Option<u64>,
    /// Time that passed until all was marched.
    pub march_wall_s: f64,
    /// Time that passed for one picture for each viewer.
    pub composite_wall_s: f64,
}

impl StillRenderer {
    /// Lets viewers share a cell until everything is marched, and makes a picture for each; `progress` gets the share that
    /// is done.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn render_shared(
        &mut self,
        cameras: &[Camera],
        size: FrameSize,
        settings: &StillSettings,
        mut progress: impl FnMut(f64),
    ) -> Result<SharedFigures, GpuError> {
        self.begin(settings)?;
        let ids = self.join_together(cameras, size, settings, CellLimit::default());
        let key = self.key_together(settings);
        let renderer = &mut self.renderer;
        renderer.pipelines.prepare(&renderer.gpu, key)?;
        renderer.pipelines.prepare(&renderer.gpu, ground_key(key))?;
        let before = renderer.stats(0.0).totals;
        let march_before_ns = renderer.gpu_time(TimedPass::Cache).0;
        let begun = Instant::now();
        self.march_all(false, &mut progress)?;
        let renderer = &mut self.renderer;
        renderer.gpu.wait()?;
        let march_wall_s = begun.elapsed().as_secs_f64();
        let stats = renderer.stats(0.0);
        let sum = |of: fn(&CellStats) -> u64| stats.cells.iter().map(of).sum();
        let march_ns = renderer.gpu_time(TimedPass::Cache).0 - march_before_ns;
        let composite_before_ns = renderer.gpu_time(TimedPass::Composite).0;
        let begun = Instant::now();
        for id in &ids {
            let picture = Picture::new(&renderer.gpu, &renderer.pipelines, size, false);
            renderer.composite_still(*id, &picture, &[key], None)?;
            read_buffer_blocking(&renderer.gpu, picture.pixels())?;
        }
        let composite_wall_s = begun.elapsed().as_secs_f64();
        let composite_ns = renderer.gpu_time(TimedPass::Composite).0 - composite_before_ns;
        let figures = SharedFigures {
            texels_requested: sum(|cell| cell.texels_requested),
            texels_unique: sum(|cell| cell.texels_unique),
            texels_coarse: sum(|cell| cell.texels_coarse),
            marches: stats.totals.texels_updated - before.texels_updated,
            // All stand at one place: there is one cell.
            measured_overlap: stats.cells.first().map_or(0.0, |cell| cell.overlap),
            cache_bytes: stats.totals.cache_bytes,
            march_ns: (march_ns > 0).then_some(march_ns),
            composite_ns: (composite_ns > 0).then_some(composite_ns),
            march_wall_s,
            composite_wall_s,
        };
        for id in ids {
            renderer.leave(id);
        }
        Ok(figures)
    }
}
