//! One ray through a thin sheet, with the shaders' samples.

use super::MarchSteps;
use super::blend::Gathering;
use super::layer::layer_distance_m;
use crate::scattering::{SURROUNDINGS_REACH_M, Surroundings};
use crate::transport::one_minus_exp_over;
use crate::{LayerGathered, Ray, World, WorldLayer};
use glam::DVec3;

/// How far apart samples stand along the ground where their number allows it, m.
const SAMPLE_M: f64 = 120.0;
/// Samples on one part of a ray that every quality may take, and steps of a layer's march that one more stands for.
const SAMPLES_LEAST: f64 = 8.0;
const STEPS_PER_SAMPLE: f64 = 16.0;

/// Samples on a way of a length through a sheet, `across` metres along the ground per metre.
fn samples(length_m: f64, across: f64, most: f64) -> f64 {
    (length_m * across / SAMPLE_M)
        .ceil()
        .clamp(1.0, most.max(1.0))
}

/// Optical depth from a point of a sheet towards the sun, by samples in the middles of even parts, at most so many.
#[must_use]
pub fn sheet_sun_depth(
    world: &World,
    layer: &WorldLayer,
    position_m: DVec3,
    sun_steps: u32,
) -> f64 {
    let sun = world.light().sun_direction;
    let to_sun = Ray {
        origin_m: position_m,
        direction: sun,
    };
    let [way, _] =
        world
            .globe()
            .layer_intervals(layer.base_altitude_m, layer.top_altitude_m, &to_sun);
    let length_m = way
        .length_m()
        .min(world.scene().light().sun_march_distance_m());
    let count = samples(length_m, sun.x.hypot(sun.z), f64::from(sun_steps));
    let part_m = length_m / count;
    let sum: f64 = (0..count as u32)
        .map(|i| {
            let place =
                world.field_place(layer, position_m + sun * ((f64::from(i) + 0.5) * part_m));
            let height_fraction = layer.height_fraction(place.altitude_m).clamp(0.0, 1.0);
            world.density_at(layer, place, height_fraction, 1.0)
        })
        .sum();
    sum * part_m * layer.extinction_per_m
}

pub(super) fn gather_sheet(
    world: &World,
    layer: &WorldLayer,
    ray: &Ray,
    settings: &MarchSteps,
) -> (LayerGathered, u64) {
    let start_fraction = settings.start_fraction;
    let sun_steps = settings
        .sun_steps
        .unwrap_or(world.scene().light().sun_steps());
    let most = (f64::from(settings.steps) / STEPS_PER_SAMPLE)
        .round()
        .max(SAMPLES_LEAST);
    let mut gathering = Gathering::new(world, layer, ray);
    let parts = world
        .globe()
        .layer_intervals(layer.base_altitude_m, layer.top_altitude_m, ray);
    let across = ray.direction.x.hypot(ray.direction.z);
    let (mut transmittance, mut optical_depth, mut evaluations) = (1.0, 0.0, 0);
    for part in parts.iter().filter(|part| !part.is_empty()) {
        let count = samples(part.length_m(), across, most);
        let length_m = part.length_m() / count;
        for i in 0..count as u32 {
            let distance_m = part.start_m + (f64::from(i) + start_fraction) * length_m;
            let position_m = ray.at(distance_m);
            let place = world.field_place(layer, position_m);
            let height_fraction = layer.height_fraction(place.altitude_m).clamp(0.0, 1.0);
            let density = world.density_at(layer, place, height_fraction, 1.0);
            evaluations += 1;
            let depth = density * layer.extinction_per_m * length_m;
            let weight = transmittance * depth * one_minus_exp_over(depth);
            let sun_depth = sheet_sun_depth(world, layer, position_m, sun_steps);
            gathering.add(weight, distance_m, sun_depth);
            optical_depth += depth;
            transmittance *= (-depth).exp();
        }
    }
    let gathered = gathering.finished(
        transmittance,
        optical_depth,
        layer_distance_m(parts),
        |place_m, _| sheet_surroundings(world, layer, place_m),
    );
    (gathered, evaluations)
}

/// What is around a place of a sheet, as if it went on as it is there.
pub(super) fn sheet_surroundings(
    world: &World,
    layer: &WorldLayer,
    place_m: DVec3,
) -> Surroundings {
    let reach_m = SURROUNDINGS_REACH_M;
    let from_sun = Ray {
        origin_m: place_m,
        direction: -world.light().sun_direction,
    };
    let [away, _] =
        world
            .globe()
            .layer_intervals(layer.base_altitude_m, layer.top_altitude_m, &from_sun);
    let place = world.field_place(layer, place_m);
    let altitude_m = place
        .altitude_m
        .clamp(layer.base_altitude_m, layer.top_altitude_m);
    let height_fraction = layer.height_fraction(altitude_m).clamp(0.0, 1.0);
    let per_m = world.density_at(layer, place, height_fraction, 1.0) * layer.extinction_per_m;
    Surroundings {
        behind: per_m * away.length_m().min(2.0 * reach_m),
        above: per_m * (layer.top_altitude_m - altitude_m),
        below: per_m * (altitude_m - layer.base_altitude_m),
        beside: per_m * 4.0 * reach_m,
    }
}
