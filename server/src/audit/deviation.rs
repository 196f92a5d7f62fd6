//! How far a cached texel is from a fresh one, in what would be shown of it.

use glam::DVec3;
use std::f64::consts::PI;

/// No deviation is larger: see [`ShownLight::deviation_percent`]. Texels that are no numbers count as much.
pub const DEVIATION_MAX_PERCENT: f64 = 300.0;

/// Weights of red, green and blue in luminance (ITU-R BT.709).
const LUMINANCE: DVec3 = DVec3::new(0.2126, 0.7152, 0.0722);

/// What the layer itself counts for in a texel's mean distance, as in `march/march.wgsl`.
const CLEAR_OPACITY: f64 = 1e-3;

/// The light that texels are multiplied by, and the air that they are seen through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShownLight {
    /// Luminance of the sun's irradiance at cloud height.
    sun_irradiance: f64,
    /// Luminance of the sky's mean radiance.
    sky_radiance: f64,
    /// Mean extinction of the air up to the layer, 1/m.
    air_extinction_per_m: DVec3,
}

/// What a texel holds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Texel {
    /// Single scattering without its phase.
    pub single: f64,
    /// Higher octaves, 1/sr.
    pub octaves: f64,
    /// Ambient light, as a share of the sky's mean radiance.
    pub ambient: f64,
    /// Transmittance.
    pub transmittance: f64,
    /// Distance of what is seen times its opacity, m.
    pub opacity_distance_m: f64,
}

impl Texel {
    /// From the four channels of the cache and the distance beside them.
    #[must_use]
    pub fn new(channels: [f32; 4], opacity_distance_m: f32) -> Self {
        let [single, octaves, ambient, transmittance] = channels.map(f64::from);
        Self {
            single,
            octaves,
            ambient,
            transmittance,
            opacity_distance_m: opacity_distance_m.into(),
        }
    }

    /// The mean of samples; all zero for none.
    #[must_use]
    pub fn mean(samples: impl ExactSizeIterator<Item = Self>) -> Self {
        let share = 1.0 / samples.len().max(1) as f64;
        samples.fold(Self::default(), |sum, sample| Self {
            single: sum.single + share * sample.single,
            octaves: sum.octaves + share * sample.octaves,
            ambient: sum.ambient + share * sample.ambient,
            transmittance: sum.transmittance + share * sample.transmittance,
            opacity_distance_m: sum.opacity_distance_m + share * sample.opacity_distance_m,
        })
    }
}

impl ShownLight {
    /// Of the sun's spectral irradiance at the clouds, the sky's mean spectral radiance and the air's mean extinction up
    /// to the layer.
    #[must_use]
    pub fn new(
        irradiance_at_clouds: DVec3,
        mean_sky_radiance: DVec3,
        air_extinction_per_m: DVec3,
    ) -> Self {
        Self {
            sun_irradiance: irradiance_at_clouds.dot(LUMINANCE),
            sky_radiance: mean_sky_radiance.dot(LUMINANCE),
            air_extinction_per_m,
        }
    }

    /// What reaches the eye of a texel: the cloud's radiance over black, and how much of a sky of radiance 1 it hides.
    fn shown(&self, texel: &Texel) -> [f64; 2] {
        let opacity = 1.0 - texel.transmittance;
        let distance_m = texel.opacity_distance_m / (opacity + CLEAR_OPACITY);
        let kept = LUMINANCE.dot((-distance_m * self.air_extinction_per_m).exp());
        // Single scattering has the isotropic phase: the true one is the viewer's.
        let radiance = self.sun_irradiance * (texel.single / (4.0 * PI) + texel.octaves)
            + self.sky_radiance * texel.ambient;
        [kept * radiance, kept * opacity]
    }

    /// How far two texels are apart as shown before the mean sky, in percent of what is shown there. With L the cloud's
    /// radiance over black, α its opacity, both times the air's transmittance on the way, and M the sky's mean radiance
    /// (which is also what haze fades to):
    ///
    ///   (|L₁ − L₂| + M |α₁ − α₂|) / ((L₁ + L₂)/2 + M).
    ///
    /// As |L₁ − L₂| ≤ L₁ + L₂ and |α₁ − α₂| ≤ 1, it is below 300 %.
    #[must_use]
    pub fn deviation_percent(&self, a: &Texel, b: &Texel) -> f64 {
        let [radiance_a, opacity_a] = self.shown(a);
        let [radiance_b, opacity_b] = self.shown(b);
        let apart =
            (radiance_a - radiance_b).abs() + self.sky_radiance * (opacity_a - opacity_b).abs();
        // At night nothing is shown of either.
        if apart == 0.0 {
            return 0.0;
        }
        let percent = 100.0 * apart / (0.5 * (radiance_a + radiance_b) + self.sky_radiance);
        // NaN fails the comparison, and counts as the worst.
        if percent <= DEVIATION_MAX_PERCENT {
            percent
        } else {
            DEVIATION_MAX_PERCENT
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const NOON: ShownLight = ShownLight {
        sun_irradiance: 1.8,
        sky_radiance: 0.1,
        air_extinction_per_m: DVec3::splat(1e-5),
    };

    fn texel() -> impl Strategy<Value = Texel> {
        (
            0.0..1.0f64,
            0.0..6e4f64,
            0.0..10.0f64,
            0.0..=1.0f64,
            0.0..2e5f64,
        )
            .prop_map(
                |(single, octaves, ambient, transmittance, distance_m)| Texel {
                    single,
                    octaves,
                    ambient,
                    transmittance,
                    opacity_distance_m: distance_m * (1.0 - transmittance + CLEAR_OPACITY),
                },
            )
    }

    proptest! {
        #[test]
        fn a_deviation_is_symmetric_below_its_bound_and_none_between_equals(a in texel(), b in texel()) {
            let deviation = NOON.deviation_percent(&a, &b);
            prop_assert!((0.0..=DEVIATION_MAX_PERCENT).contains(&deviation));
            prop_assert_eq!(deviation, NOON.deviation_percent(&b, &a));
            prop_assert_eq!(NOON.deviation_percent(&a, &a), 0.0);
        }
    }

    #[test]
    fn one_percent_more_light_in_a_bright_cloud_is_about_one_percent() {
        let cloud = Texel {
            single: 0.5,
            octaves: 0.3,
            ambient: 0.5,
            opacity_distance_m: 2_000.0,
            ..Texel::default()
        };
        let brighter = Texel {
            single: 0.505,
            octaves: 0.303,
            ambient: 0.505,
            ..cloud
        };
        let deviation = NOON.deviation_percent(&cloud, &brighter);
        assert!((0.8..1.0).contains(&deviation), "{deviation}");
    }

    #[test]
    fn what_haze_hides_deviates_less() {
        let at = |distance_m: f64, single: f64| Texel {
            single,
            opacity_distance_m: distance_m,
            ..Texel::default()
        };
        let near = NOON.deviation_percent(&at(2e3, 0.5), &at(2e3, 0.6));
        let far = NOON.deviation_percent(&at(2e5, 0.5), &at(2e5, 0.6));
        assert!(far < 0.5 * near, "{far} {near}");
    }

    #[test]
    fn what_is_no_number_counts_as_the_worst_and_night_as_nothing() {
        let broken = Texel {
            octaves: f64::NAN,
            ..Texel::default()
        };
        assert_eq!(
            NOON.deviation_percent(&broken, &Texel::default()),
            DEVIATION_MAX_PERCENT
        );
        let night = ShownLight::new(DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        let opaque = Texel {
            single: 0.3,
            ..Texel::default()
        };
        assert_eq!(night.deviation_percent(&opaque, &Texel::default()), 0.0);
    }

    #[test]
    fn the_mean_of_samples_is_that_of_their_channels() {
        let samples = [
            Texel::new([0.0, 2.0, 4.0, 1.0], 10.0),
            Texel::new([1.0, 4.0, 0.0, 0.0], 30.0),
        ];
        let mean = Texel::mean(samples.into_iter());
        assert_eq!(mean, Texel::new([0.5, 3.0, 2.0, 0.5], 20.0));
    }
}
