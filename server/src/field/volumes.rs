//! The noise volumes that carve clouds: two channels, tiling in all directions.

use super::noise::{billow, octaves, perlin};
use rayon::prelude::*;

/// Seed of the noise volumes: the same for every scene, the scene's seeds are those of its maps.
pub const VOLUME_SEED: u32 = 1;

/// A cube of texels with two channels of 8 bits: billowy and wispy noise, 0…1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NoiseVolume {
    /// Texels along an edge.
    pub size: u32,
    /// Two bytes per texel, x fastest.
    pub texels: Vec<u8>,
}

/// Which of the two volumes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VolumeKind {
    /// The bodies of clouds.
    Shape,
    /// What erodes their surfaces.
    Detail,
}

impl VolumeKind {
    /// Texels along an edge (CitC, section 5: 128³ and 32³).
    #[must_use]
    pub const fn size(self) -> u32 {
        match self {
            Self::Shape => 128,
            Self::Detail => 32,
        }
    }

    /// Name in file names.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Shape => "shape",
            Self::Detail => "detail",
        }
    }

    /// Billowy and wispy noise at a place in the cube, before they are spread over 0…1.
    fn sample(self, at: [f32; 3], seed: u32) -> [f32; 2] {
        match self {
            Self::Shape => {
                let body = 0.5 + 0.5 * octaves(perlin, at, 3, 4, 0.5, seed);
                let bulges = octaves(billow, at, 6, 4, 0.42, seed ^ 0x55);
                let wisps = 0.5 + 0.5 * octaves(perlin, at, 4, 5, 0.6, seed ^ 0xaa);
                // Gradient noise decides where bodies are, cellular noise rounds their outline. Its octaves fall faster than
                // their frequency rises: noise that is steeper than the profile would leave crumbs above the clouds.
                [0.4 * body + 0.6 * bulges, 0.6 * wisps + 0.4 * bulges]
            }
            Self::Detail => {
                let bulges = octaves(billow, at, 2, 3, 0.5, seed ^ 0x1234);
                let wisps = 0.5 + 0.5 * octaves(perlin, at, 3, 3, 0.6, seed ^ 0x4321);
                [bulges, wisps]
            }
        }
    }
}

impl NoiseVolume {
    /// Makes a volume; `progress` is called with the number of finished slices, from any thread.
    #[must_use]
    pub fn generate(kind: VolumeKind, seed: u32, progress: impl Fn() + Sync) -> Self {
        let size = kind.size();
        let slices: Vec<Vec<[f32; 2]>> = (0..size)
            .into_par_iter()
            .map(|z| {
                let mut slice = Vec::with_capacity((size * size) as usize);
                for y in 0..size {
                    for x in 0..size {
                        let at = [x, y, z].map(|v| (v as f32 + 0.5) / size as f32);
                        slice.push(kind.sample(at, seed));
                    }
                }
                progress();
                slice
            })
            .collect();
        let values: Vec<[f32; 2]> = slices.into_iter().flatten().collect();
        let channels = [0, 1].map(|c| spread(values.iter().map(|v| v[c]).collect()));
        let texels = channels[0]
            .iter()
            .zip(&channels[1])
            .flat_map(|(a, b)| [*a, *b])
            .collect();
        Self { size, texels }
    }
}

/// Values moved to mean one half and stretched so that all but 1 in 1000 at either end fit into 0…255.
fn spread(values: Vec<f32>) -> Vec<u8> {
    let mut sorted = values.clone();
    sorted.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
    let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64;
    let half_width = f64::from(at(0.999) - mean as f32)
        .max(f64::from(mean as f32 - at(0.001)))
        .max(1e-6);
    values
        .iter()
        .map(|v| {
            let unit = 0.5 + 0.5 * (f64::from(*v) - mean) / half_width;
            (unit.clamp(0.0, 1.0) * 255.0).round() as u8
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn detail_has_mean_one_half_in_both_channels() {
        let volume = NoiseVolume::generate(VolumeKind::Detail, 1, || {});
        for channel in 0..2 {
            let texels = volume.texels.iter().skip(channel).step_by(2);
            let mean = texels.map(|t| f64::from(*t)).sum::<f64>() / (32.0f64.powi(3) * 255.0);
            assert!((mean - 0.5).abs() < 0.01, "channel {channel}: {mean}");
        }
    }
}
