//! Caches that are kept alive while time passes, and what came of them.

use crate::cells::CellLimit;
use crate::frame_loop::{LivingViewers, StillRenderer, StillSettings};
use crate::measure::metrics::ShownErrors;
use serde::Serialize;
use skycell_protocol::{Camera, FrameSize};

/// Texels that are audited in a simulated second, as many as a server audits while frames wait.
const AUDITED_PER_S: usize = 64;

/// A picture from living caches against one of the same moment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LivingPicture {
    /// When, s.
    pub at_s: f64,
    /// Whose.
    pub viewer: usize,
    /// How far it is from the screen-space renderer's.
    #[serde(flatten)]
    pub errors: ShownErrors,
}

/// What came of caches that were kept alive.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LivingFigures {
    /// Cells with members at the end.
    pub cells: usize,
    /// GPU memory of the caches at the end, bytes.
    pub cache_bytes: u64,
    /// Texels marched until nothing was left to do, before time began.
    pub texels_at_start: u64,
    /// Texels marched while it passed.
    pub texels: u64,
    /// Texels for each ray of a screen-space renderer with one ray a pixel, frame and viewer.
    pub texels_per_ray: f64,
    /// Mean FLIP of the pictures before time began, when all was marched: the cache's own error.
    pub flip_at_start: f64,
    /// Mean SSIM of those.
    pub ssim_at_start: f64,
    /// Mean FLIP of all later pictures.
    pub flip: f64,
    /// The largest.
    pub flip_most: f64,
    /// Mean SSIM.
    pub ssim: f64,
    /// The smallest.
    pub ssim_least: f64,
    /// Mean deviation of audited texels at the end, percent.
    pub audit_mean_percent: f64,
    /// Every later picture.
    pub pictures: Vec<LivingPicture>,
}

impl LivingFigures {
    /// For people.
    #[must_use]
    pub fn told(&self, rays: u64) -> String {
        format!(
            "{} texels for {rays} rays, 1/{:.1}, {} cells, {:.1} MB\n\
             FLIP {:.4} in the mean, {:.4} at most; SSIM {:.4}, {:.4} at least; before time began {:.4} and {:.4}\n\
             audit: {:.2} % in the mean",
            self.texels,
            1.0 / self.texels_per_ray.max(1e-9),
            self.cells,
            self.cache_bytes as f64 / 1e6,
            self.flip,
            self.flip_most,
            self.ssim,
            self.ssim_least,
            self.flip_at_start,
            self.ssim_at_start,
            self.audit_mean_percent,
        )
    }
}

/// A renderer and the viewers who read its caches.
pub(super) struct LivingCaches {
    name: &'static str,
    still: StillRenderer,
    viewers: LivingViewers,
    /// Tiles that may be marched and were not, less than one where nothing was left to do.
    credit: f64,
    texels_at_start: u64,
    at_start: Vec<LivingPicture>,
    pictures: Vec<LivingPicture>,
    audited_percent: Vec<f64>,
}

impl LivingCaches {
    /// Marches all that the viewers see at first.
    ///
    /// # Errors
    /// When a pipeline cannot be made or the device is lost.
    pub(super) fn begin(
        name: &'static str,
        mut still: StillRenderer,
        cameras: &[Camera],
        size: FrameSize,
        settings: &StillSettings,
        limit: CellLimit,
    ) -> anyhow::Result<Self> {
        let viewers = still.begin_living(cameras, size, settings, limit)?;
        still.settle_living()?;
        Ok(Self {
            name,
            texels_at_start: still.totals().texels_updated,
            still,
            viewers,
            credit: 0.0,
            at_start: Vec::new(),
            pictures: Vec::new(),
            audited_percent: Vec::new(),
        })
    }

    /// As files are named.
    pub(super) fn name(&self) -> &'static str {
        self.name
    }

    /// One turn, in which so many tiles may be marched.
    ///
    /// # Errors
    /// When the device is lost.
    pub(super) fn turn(
        &mut self,
        cameras: &[Camera],
        passed_s: f64,
        tiles: f64,
    ) -> anyhow::Result<()> {
        self.credit += tiles;
        let most = self.credit as usize;
        let marched = self
            .still
            .turn_living(&self.viewers, cameras, passed_s, most)?;
        // What is not wanted now is not saved up for later, but for less than a tile.
        self.credit = (self.credit - marched as f64).min(1.0);
        Ok(())
    }

    /// Lets the audit correct what is expected of tiles.
    ///
    /// # Errors
    /// When the device is lost.
    pub(super) fn audit(&mut self) -> anyhow::Result<()> {
        let found = self.still.audit_living(AUDITED_PER_S)?;
        self.audited_percent = found.iter().map(|texel| texel.deviation_percent).collect();
        Ok(())
    }

    /// What a viewer sees, 4 bytes a pixel.
    ///
    /// # Errors
    /// When the device is lost.
    pub(super) fn show(&mut self, viewer: usize) -> anyhow::Result<Vec<u8>> {
        Ok(self.still.show_living(&self.viewers, viewer)?)
    }

    /// Keeps what a picture was like.
    pub(super) fn note(&mut self, picture: LivingPicture) {
        self.pictures.push(picture);
    }

    /// The pictures so far were before time began.
    pub(super) fn start(&mut self) {
        self.at_start = std::mem::take(&mut self.pictures);
    }

    /// Mean FLIP of the last picture.
    pub(super) fn last_flip(&self) -> f64 {
        self.pictures.last().map_or(0.0, |p| p.errors.flip)
    }

    /// Texels marched while time passed.
    pub(super) fn texels(&self) -> u64 {
        self.still.totals().texels_updated - self.texels_at_start
    }

    /// What came of them, beside so many rays.
    pub(super) fn figures(&self, rays: u64) -> LivingFigures {
        let flips = |of: &[LivingPicture]| of.iter().map(|p| p.errors.flip).collect::<Vec<_>>();
        let ssims = |of: &[LivingPicture]| of.iter().map(|p| p.errors.ssim).collect::<Vec<_>>();
        let [flip_at_start, ssim_at_start] = [flips(&self.at_start), ssims(&self.at_start)];
        let [flip, ssim] = [flips(&self.pictures), ssims(&self.pictures)];
        let texels = self.texels();
        LivingFigures {
            cells: self.still.living_cells(),
            cache_bytes: self.still.totals().cache_bytes,
            texels_at_start: self.texels_at_start,
            texels,
            texels_per_ray: texels as f64 / rays as f64,
            flip_at_start: mean(&flip_at_start),
            ssim_at_start: mean(&ssim_at_start),
            flip_most: flip.iter().copied().fold(0.0, f64::max),
            flip: mean(&flip),
            ssim_least: ssim.iter().copied().fold(1.0, f64::min),
            ssim: mean(&ssim),
            audit_mean_percent: mean(&self.audited_percent),
            pictures: self.pictures.clone(),
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
