//! Layers over what lies behind them.

use super::CLEAR_OPACITY;
use super::layer::depth_of_samples;
use super::seen::SeenParts;
use crate::phase::one_minus_mu;
use crate::scattering::{
    SURROUNDINGS_REACH_M, SURROUNDINGS_SAMPLES, Surroundings, diffuse_share, sky_share,
};
use crate::sky::Haze;
use crate::world::Medium;
use crate::{LayerGathered, Ray, RayResult, StandardErrors, World, WorldLayer};
use glam::DVec3;
use skycell_protocol::scene::{FITTED, Scattering};

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
    let background = super::shaded_background(world, ray, air_direction);
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
        // An even light from all around would be scattered by all of the opacity: what is not the sky's is the ground's.
        let even = if world.settings().approximations.ambient {
            layer.albedo * world.scene().light().ambient() * (1.0 - cloud.transmittance)
        } else {
            0.0
        };
        let from_below = (even - cloud.ambient).max(0.0);
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
        let lit = lit_once
            + sun_irradiance * cloud.octaves
            + light.mean_radiance * cloud.ambient
            + light.ground_radiance * from_below;
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

/// The light of a ray's lit samples.
pub(super) struct Gathering<'a> {
    world: &'a World,
    layer: &'a WorldLayer,
    ray: &'a Ray,
    one_minus_mu: f64,
    /// Factors of the sun's optical depth.
    attenuation: Vec<f64>,
    /// Strength times phase, 1/sr, from the second octave on.
    weight_per_sr: Vec<f64>,
    sums: Vec<f64>,
    seen: SeenParts,
}

impl<'a> Gathering<'a> {
    pub(super) fn new(world: &'a World, layer: &'a WorldLayer, ray: &'a Ray) -> Self {
        let light = world.scene().light();
        let one_minus_mu = one_minus_mu(ray.direction, world.light().sun_direction);
        let phase = |eccentricity| layer.phase.per_sr(eccentricity, one_minus_mu);
        let (attenuation, weight_per_sr): (Vec<f64>, Vec<f64>) = match light.scattering() {
            _ if light.octaves() == 1 => (vec![1.0], Vec::new()),
            Scattering::Octaves => {
                let power = |base: f64, i: u32| base.powi(i as i32);
                (
                    (0..light.octaves())
                        .map(|i| power(light.octave_attenuation(), i))
                        .collect(),
                    (1..light.octaves())
                        .map(|i| {
                            power(light.octave_contribution(), i)
                                * phase(power(light.octave_eccentricity(), i))
                        })
                        .collect(),
                )
            }
            Scattering::Fitted => (
                vec![
                    1.0,
                    (FITTED.forward_attenuation * layer.phase.transport_share()).min(1.0),
                ],
                vec![FITTED.forward_strength * phase(FITTED.forward_eccentricity)],
            ),
        };
        Self {
            world,
            layer,
            ray,
            one_minus_mu,
            sums: vec![0.0; attenuation.len()],
            attenuation,
            weight_per_sr,
            seen: match layer.medium {
                Medium::Sheet(_) => SeenParts::of_sheet(),
                _ => SeenParts::of_volume(),
            },
        }
    }

    /// Adds a part of the ray that shows `weight` of its light, at a distance, under an optical depth towards the sun.
    pub(super) fn add(&mut self, weight: f64, distance_m: f64, sun_depth: f64) {
        for (sum, attenuation) in self.sums.iter_mut().zip(&self.attenuation) {
            *sum += weight * (-attenuation * sun_depth).exp();
        }
        self.seen.add(weight, distance_m, sun_depth);
    }

    /// As if every part showed `factor` times as much.
    pub(super) fn scale(&mut self, factor: f64) {
        for sum in &mut self.sums {
            *sum *= factor;
        }
        self.seen.scale(factor);
    }

    /// All of it. `around_place` tells what is around a place where a direction is up.
    pub(super) fn finished(
        &self,
        transmittance: f64,
        optical_depth: f64,
        layer_distance_m: f64,
        around_place: impl Fn(DVec3, DVec3) -> Surroundings,
    ) -> LayerGathered {
        let (light, layer) = (self.world.scene().light(), self.layer);
        let mut octaves: f64 = self
            .sums
            .iter()
            .skip(1)
            .zip(&self.weight_per_sr)
            .map(|(sum, weight)| sum * weight)
            .sum();
        let mut ambient = 0.0;
        let shown_ambient = if self.world.settings().approximations.ambient {
            light.ambient()
        } else {
            0.0
        };
        let diffuse = light.scattering() == Scattering::Fitted && light.octaves() > 1;
        if diffuse || shown_ambient > 0.0 {
            let transport_share = layer.phase.transport_share();
            let sun_direction = self.world.light().sun_direction;
            let diffuse_phase_per_sr = layer
                .phase
                .per_sr(FITTED.diffuse_eccentricity, self.one_minus_mu);
            for seen in self.seen.each() {
                let middle_m = self.ray.at(seen.distance_m());
                let up = self.world.globe().up(middle_m);
                let around = around_place(middle_m, up);
                if diffuse {
                    let rising = sun_direction.dot(up);
                    let depth = seen.sun_depth();
                    let share = diffuse_share(&FITTED, transport_share, depth, rising, &around);
                    octaves += seen.shown * share * diffuse_phase_per_sr;
                }
                let rising = self.ray.direction.dot(up);
                let share = sky_share(&FITTED, transport_share, &around, rising);
                ambient += shown_ambient * seen.shown * share;
            }
        }
        LayerGathered {
            scene_index: layer.scene_index,
            single: layer.albedo * self.sums.first().copied().unwrap_or(0.0),
            octaves: layer.albedo * octaves,
            ambient: layer.albedo * ambient,
            transmittance,
            opacity_distance_m: self.seen.weighted_distance_m() + CLEAR_OPACITY * layer_distance_m,
            optical_depth,
        }
    }
}

/// What is around a place by short marches of [`SURROUNDINGS_SAMPLES`], as coarse as the renderer's: the constants are
/// fitted with these. Clouds are wider than they are high: ways beside reach twice as far.
pub(super) fn surroundings(
    world: &World,
    layer: &WorldLayer,
    place_m: DVec3,
    up: DVec3,
) -> Surroundings {
    let sun = world.light().sun_direction;
    let depth = |way: DVec3, reach: f64| {
        let reach_m = reach * SURROUNDINGS_REACH_M;
        depth_of_samples(layer, place_m, way, reach_m, SURROUNDINGS_SAMPLES, |at_m| {
            world.surrounding_density(layer, at_m)
        })
    };
    let across = sun.cross(up);
    let side = if across.length_squared() > 1e-6 {
        across.normalize()
    } else {
        DVec3::X
    };
    Surroundings {
        behind: depth(-sun, 2.0),
        above: depth(up, 1.0),
        below: depth(-up, 1.0),
        beside: depth(side, 2.0) + depth(-side, 2.0),
    }
}
