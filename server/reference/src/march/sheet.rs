//! One ray through a thin sheet, with the shaders' samples.

use super::CLEAR_OPACITY;
use super::blend::{Octaves, ambient_share};
use super::layer::{finished, layer_distance_m};
use crate::transport::one_minus_exp_over;
use crate::{LayerGathered, Ray, World, WorldLayer};
use glam::DVec3;

/// How far apart samples stand along the ground where their number allows it, m.
const SAMPLE_M: f64 = 120.0;
/// Most samples on one part of a ray.
const SAMPLES_MAX: f64 = 8.0;

/// Optical depth from a point of a sheet towards the sun, as if the sheet were everywhere as dense as there.
#[must_use]
pub fn sheet_sun_depth(world: &World, layer: &WorldLayer, position_m: DVec3, density: f64) -> f64 {
    let to_sun = Ray {
        origin_m: position_m,
        direction: world.light().sun_direction,
    };
    let [way, _] =
        world
            .globe()
            .layer_intervals(layer.base_altitude_m, layer.top_altitude_m, &to_sun);
    let length_m = way
        .length_m()
        .min(world.scene().light().sun_march_distance_m());
    density * layer.extinction_per_m * length_m
}

pub(super) fn gather_sheet(
    world: &World,
    layer: &WorldLayer,
    ray: &Ray,
    start_fraction: f64,
) -> (LayerGathered, u64) {
    let octaves = Octaves::new(world, layer, ray);
    let mut sums = octaves.sums();
    let parts = world
        .globe()
        .layer_intervals(layer.base_altitude_m, layer.top_altitude_m, ray);
    let across = ray.direction.x.hypot(ray.direction.z);
    let (mut transmittance, mut optical_depth, mut evaluations) = (1.0, 0.0, 0);
    let (mut ambient, mut weighted_distance_m) = (0.0, 0.0);
    for part in parts.iter().filter(|part| !part.is_empty()) {
        let count = (part.length_m() * across / SAMPLE_M)
            .ceil()
            .clamp(1.0, SAMPLES_MAX);
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
            let sun_depth = sheet_sun_depth(world, layer, position_m, density);
            octaves.add(&mut sums, weight, sun_depth);
            ambient += weight * ambient_share(height_fraction, density, density);
            weighted_distance_m += weight * distance_m;
            optical_depth += depth;
            transmittance *= (-depth).exp();
        }
    }
    let gathered = finished(
        world,
        layer,
        octaves.single_and_octaves(&sums),
        ambient,
        transmittance,
        weighted_distance_m + CLEAR_OPACITY * layer_distance_m(parts),
        optical_depth,
    );
    (gathered, evaluations)
}
