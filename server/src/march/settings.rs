//! What a march does and leaves out: the knobs that trade time for error.

use crate::sun_volume::SunVolumeSize;
use serde::{Deserialize, Serialize};
use skycell_protocol::SunDepth;

/// How rays are marched. Every renderer of a scene takes the same settings; what they cost is the same for all.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MarchSettings {
    /// Steps through the thickness of a layer at close range, 1 to 4096.
    pub steps: u32,
    /// Samples towards the sun, 1 to 64; without: the scene's.
    pub sun_steps: Option<u32>,
    /// How optical depth towards the sun comes about; without: the scene's choice.
    pub sun_depth: Option<SunDepth>,
    /// Size of the sun volume, where one is used.
    pub sun_volume: SunVolumeSize,
    /// Terms of the multiple-scattering sum, 1 to 16; without: the scene's.
    pub octaves: Option<u32>,
    /// A ray ends where hardly any light comes through any more.
    pub early_exit: bool,
    /// Steps without cloud are not lit, and clear sky is crossed in leaps.
    pub low_density_skip: bool,
    /// Steps grow with distance.
    pub adaptive_step: bool,
    /// Samples stand beside the middles of pixels and steps, so that several of them make one finer picture. Texels of the
    /// cache always are.
    pub jitter: bool,
    /// Noise frays the edges of clouds.
    pub detail_noise: bool,
    /// Clouds scatter the light of sky and ground.
    pub ambient: bool,
    /// Air dims clouds and adds its own light.
    pub aerial_perspective: bool,
    /// Maps, noise and voxels are interpolated in f32 instead of with a sampler's few bits.
    pub exact_interpolation: bool,
    /// Texture reads are counted.
    pub count_reads: bool,
}

impl Default for MarchSettings {
    /// What viewers get, with 128 steps.
    fn default() -> Self {
        Self {
            steps: 128,
            sun_steps: None,
            sun_depth: None,
            sun_volume: SunVolumeSize::default(),
            octaves: None,
            early_exit: true,
            low_density_skip: true,
            adaptive_step: true,
            jitter: true,
            detail_noise: true,
            ambient: true,
            aerial_perspective: true,
            exact_interpolation: false,
            count_reads: false,
        }
    }
}

impl MarchSettings {
    /// For numbers that are compared with others': one sample in the middle of each pixel and step, no approximation that
    /// is not asked for, nothing cut short, f32 throughout.
    #[must_use]
    pub fn plain(steps: u32) -> Self {
        Self {
            steps,
            early_exit: false,
            jitter: false,
            detail_noise: false,
            ambient: false,
            aerial_perspective: false,
            sun_depth: Some(SunDepth::Cone),
            exact_interpolation: true,
            ..Self::default()
        }
    }
}
