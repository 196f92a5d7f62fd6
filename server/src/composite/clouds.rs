//! Clouds alone, for renderers that have a background of their own.

use crate::gpu::PipelineKey;
use skycell_shaders::{CloudsAlone, Features, Tone};

/// Bytes of a pixel: half floats of red, green, blue, transmittance and distance, and one that is not used.
pub const CLOUDS_PIXEL_BYTES: usize = 12;

/// A composite, or a mix of two, of clouds alone: with the haze in front of them or without. What only the background has is
/// not compiled in.
#[must_use]
pub fn clouds_key(key: PipelineKey, haze: bool) -> PipelineKey {
    PipelineKey {
        features: Features {
            clouds_alone: if haze {
                CloudsAlone::InHaze
            } else {
                CloudsAlone::WithoutHaze
            },
            tone: Tone::default(),
            moon: false,
            stars: false,
            ..key.features
        },
        ..key
    }
}

/// What a half float's radiance is multiplied by: the largest power of two that is no greater than a picture's exposure, so
/// that what a picture shows neither overflows nor loses digits. As the shaders have it, to the bit.
#[must_use]
pub fn pre_exposure(exposure: f32) -> f32 {
    f32::from_bits(exposure.to_bits() & 0x7f80_0000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pre_exposure_is_the_power_of_two_below_an_exposure() {
        for (exposure, expected) in [(1.0, 1.0), (1.99, 1.0), (0.3, 0.25), (1536.0, 1024.0)] {
            assert_eq!(pre_exposure(exposure), expected);
        }
    }
}
