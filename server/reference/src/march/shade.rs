//! The shadow of clouds in the air.

use super::converged::LayerMarch;
use crate::sky::Background;
use crate::{Ray, World, WorldLayer};
use glam::DVec3;

/// Samples through a layer towards the sun, in those of the first level of a converged march: shadow is integrated once
/// more along the ray, so that it needs fewer than light inside a cloud.
const FINENESS: f64 = 0.5;

/// Share of the sun's light that all layers let through to a place of the frame, to their ends.
#[must_use]
pub fn sunlit_share(world: &World, position_m: DVec3) -> f64 {
    let altitude_m = world.globe().altitude_m(position_m);
    let to_sun = world.light().sun_direction;
    let rises = to_sun.dot(world.globe().up(position_m)) >= 0.0;
    let depth: f64 = (0..world.layers().len())
        // Nothing stands above the top of a layer on a way that rises.
        .filter(|place| !(rises && altitude_m >= world.layers()[*place].top_altitude_m))
        .map(|place| {
            let march = LayerMarch::new(world, place, FINENESS);
            march.sun_depth_of(place, position_m, f64::INFINITY).0
        })
        .sum();
    (-depth).exp()
}

/// What lies behind all clouds along a ray: in their shadow, where the scene has light shafts.
#[must_use]
pub fn shaded_background(world: &World, ray: &Ray, air_direction: DVec3) -> Background {
    let light = world.light();
    if !world.scene().light_shafts() || world.layers().is_empty() {
        return light.background(ray, air_direction);
    }
    let highest_m = world
        .layers()
        .iter()
        .map(|layer: &WorldLayer| layer.top_altitude_m)
        .fold(0.0, f64::max);
    light.shaded_background(ray, air_direction, &|position_m| {
        let rises = light.sun_direction.dot(world.globe().up(position_m)) >= 0.0;
        if rises && world.globe().altitude_m(position_m) >= highest_m {
            1.0
        } else {
            sunlit_share(world, position_m)
        }
    })
}
