//! How large and how fine a volume is.

use serde::{Deserialize, Serialize};

/// Levels that shaders know, as in `march/sun_volume.wgsl`.
pub const LEVELS_MAX: u32 = 5;

/// Largest volume of one place, of all its layers, bytes. While the sun moves there are two of a place.
pub const BYTES_MAX: u64 = 64 << 20;
/// Most samples before the read.
const NEAR_STEPS_MAX: u32 = 16;

/// Size and fineness of the volume of one layer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SunVolumeSize {
    /// Columns along x and along z of each level: 32 to 512, a multiple of 32.
    pub columns: u32,
    /// Slices through the layer's thickness, 2 to 128.
    pub slices: u32,
    /// Levels, 1 to 5, each twice as wide as the one before.
    pub levels: u32,
    /// Distance between the columns of the finest level, m.
    pub spacing_m: f64,
    /// Samples of density between a place and where the volume is read, 0 to 16; without: a sixth of the steps that a cone
    /// would take.
    pub near_steps: Option<u32>,
    /// How far before the place the volume is read, in columns of the level that is read for each of these samples.
    pub near_columns: f64,
}

impl Default for SunVolumeSize {
    /// Tuned: `skycell-server render --sun-depth volume --sun-volume JSON` of the default scene. A third level, of columns 200 m apart,
    /// errs more than the cone of six steps that serves beyond the second.
    fn default() -> Self {
        Self {
            columns: 256,
            slices: 64,
            levels: 2,
            spacing_m: 50.0,
            near_steps: None,
            near_columns: 1.0,
        }
    }
}

impl SunVolumeSize {
    /// As it is, or the nearest that is allowed.
    #[must_use]
    pub fn bounded(self) -> Self {
        let spacing_m = if self.spacing_m.is_finite() {
            self.spacing_m.clamp(1.0, 1e4)
        } else {
            Self::default().spacing_m
        };
        let near_columns = if self.near_columns.is_finite() {
            self.near_columns.clamp(0.0, 8.0)
        } else {
            1.0
        };
        Self {
            columns: (self.columns.clamp(32, 512) / 32) * 32,
            slices: self.slices.clamp(2, 128),
            levels: self.levels.clamp(1, LEVELS_MAX),
            spacing_m,
            near_steps: self.near_steps.map(|steps| steps.min(NEAR_STEPS_MAX)),
            near_columns,
        }
    }

    /// The size with as many fewer columns as it takes for the volume of some layers to stay within [`BYTES_MAX`].
    #[must_use]
    pub fn fitting(self, layers: usize) -> Self {
        let mut size = self.bounded();
        while size.columns > 32 && size.bytes(layers) > BYTES_MAX {
            size.columns -= 32;
        }
        size
    }

    /// Samples before the read, where a cone would take `sun_steps`.
    #[must_use]
    pub fn near_steps_for(&self, sun_steps: u32) -> u32 {
        self.near_steps
            .unwrap_or(sun_steps.div_ceil(6))
            .min(NEAR_STEPS_MAX)
    }

    /// Columns that are made together along the side at which a window grows.
    #[must_use]
    pub fn strip(&self) -> i64 {
        i64::from(self.columns / 16)
    }

    /// Distance between the columns of a level, m.
    #[must_use]
    pub fn spacing_of_level_m(&self, level: u32) -> f64 {
        self.spacing_m * f64::from(1u32 << level)
    }

    /// Slices of the texture that holds the volumes of some layers.
    #[must_use]
    pub fn depth(&self, layers: usize) -> u32 {
        layers as u32 * self.levels * self.slices
    }

    /// Bytes of that texture: a float each.
    #[must_use]
    pub fn bytes(&self, layers: usize) -> u64 {
        4 * u64::from(self.columns).pow(2) * u64::from(self.depth(layers))
    }
}
