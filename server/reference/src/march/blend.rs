//! Layers over what lies behind them.

use crate::phase::one_minus_mu;
use crate::sky::Haze;
use crate::{LayerGathered, Ray, RayResult, StandardErrors, World, WorldLayer};
use glam::DVec3;

/// Blends what a ray gathered in its layers, given lowest first, over sky or ground.
///
/// A layer is premultiplied by its opacity. Air in front of it keeps e^(−σ d) of its light and adds, where the layer is
/// opaque, the share of the clear air's light that so much of the column has.
pub(super) fn blended(
    world: &World,
    ray: &Ray,
    air_direction: DVec3,
    gathered: Vec<LayerGathered>,
) -> RayResult {
    let light = world.light();
    let background = light.background(ray, air_direction);
    let x = one_minus_mu(ray.direction, light.sun_direction);
    let hazed = world.settings().approximations.aerial_perspective;
    let (mut radiance, mut single) = (background.radiance, DVec3::ZERO);
    let (mut transmittance, mut optical_depth) = (1.0, 0.0);
    let layer_of = |cloud: &LayerGathered| {
        let mut layers = world.layers().iter();
        layers.find(|layer| layer.scene_index == cloud.scene_index)
    };
    // The farthest first: layers above the eye from the highest down, then those below it from the lowest up.
    let eye_m = world.globe().altitude_m(ray.origin_m);
    let is_above = |cloud: &&LayerGathered| {
        layer_of(cloud).is_some_and(|layer| layer.proxy_altitude_m >= eye_m)
    };
    let above = gathered.iter().rev().filter(is_above);
    let below = gathered.iter().filter(|cloud| !is_above(cloud));
    let mut order: Vec<&LayerGathered> = above.chain(below).collect();
    // Layers that share altitudes: what is seen farther away, in the mean, lies behind.
    if world.layers_overlap() {
        order.sort_by(|a, b| b.distance_seen_m().total_cmp(&a.distance_seen_m()));
    }
    for cloud in order {
        let Some(layer) = layer_of(cloud) else {
            continue;
        };
        let air_extinction_per_m = layer.air_extinction_per_m;
        let sun_phase_per_sr = layer.phase.over_disc_per_sr(x, light.sun_one_minus_mu);
        // The sun's colour at the altitude of what is seen.
        let seen_m = ray.at(cloud.distance_seen_m());
        let sun_irradiance = light.sun_at(world.globe().altitude_m(seen_m));
        let Haze { kept, added } = if hazed {
            background.haze(light, cloud.distance_seen_m(), air_extinction_per_m)
        } else {
            Haze::NONE
        };
        let lit_once = sun_irradiance * (sun_phase_per_sr * cloud.single);
        let lit = lit_once + sun_irradiance * cloud.octaves + light.mean_radiance * cloud.ambient;
        let opacity = 1.0 - cloud.transmittance;
        radiance = lit * kept + added * opacity + radiance * cloud.transmittance;
        single = lit_once * kept + single * cloud.transmittance;
        transmittance *= cloud.transmittance;
        optical_depth += cloud.optical_depth;
    }
    RayResult {
        radiance,
        single_scattered: single,
        transmittance,
        optical_depth,
        steps: 0,
        standard_error: StandardErrors::default(),
        layers: gathered,
    }
}

/// What the octaves of a ray are made of.
pub(super) struct Octaves {
    /// a^i: factors of the sun's optical depth.
    attenuation: Vec<f64>,
    /// b^i p(θ; c^i), 1/sr, from the second octave on.
    weight_per_sr: Vec<f64>,
}

impl Octaves {
    pub(super) fn new(world: &World, layer: &WorldLayer, ray: &Ray) -> Self {
        let light = world.scene().light();
        let x = one_minus_mu(ray.direction, world.light().sun_direction);
        let power = |base: f64, i: u32| base.powi(i as i32);
        let indices = 0..light.octaves();
        Self {
            attenuation: indices
                .clone()
                .map(|i| power(light.octave_attenuation(), i))
                .collect(),
            weight_per_sr: indices
                .skip(1)
                .map(|i| {
                    let eccentricity = power(light.octave_eccentricity(), i);
                    power(light.octave_contribution(), i) * layer.phase.per_sr(eccentricity, x)
                })
                .collect(),
        }
    }

    pub(super) fn sums(&self) -> Vec<f64> {
        vec![0.0; self.attenuation.len()]
    }

    /// Adds a part of a ray that shows `weight` of its light, under an optical depth towards the sun.
    pub(super) fn add(&self, sums: &mut [f64], weight: f64, sun_depth: f64) {
        for (sum, attenuation) in sums.iter_mut().zip(&self.attenuation) {
            *sum += weight * (-attenuation * sun_depth).exp();
        }
    }

    /// Single scattering without its phase, and all higher octaves with theirs, before the albedo.
    pub(super) fn single_and_octaves(&self, sums: &[f64]) -> (f64, f64) {
        let single = sums.first().copied().unwrap_or(0.0);
        let octaves = sums
            .iter()
            .skip(1)
            .zip(&self.weight_per_sr)
            .map(|(sum, weight)| sum * weight)
            .sum();
        (single, octaves)
    }
}

/// The model's share of the sky's mean radiance that a place in a cloud sees: less low down and deep inside.
pub(super) fn ambient_share(height_fraction: f64, profile: f64, density: f64) -> f64 {
    (0.3 + 0.7 * height_fraction) * (1.0 - 0.75 * profile * density).clamp(0.0, 1.0).sqrt()
}
