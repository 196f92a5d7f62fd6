//! One ray through one layer with the shaders' discretisation.

use super::blend::{Gathering, surroundings};
use super::seen::SeenParts;
use crate::error::checked;
use crate::scattering::Surroundings;
use crate::shell::Interval;
use crate::transport::one_minus_exp_over;
use crate::world::Medium;
use crate::{LayerGathered, Ray, ReferenceError, World, WorldLayer};
use glam::DVec3;
use serde::Serialize;

/// A ray stops where less than this share of the light behind could still come through.
const TRANSMITTANCE_MIN: f64 = 0.001;
/// Detail begins to fade where its voxels are seen under this angle, rad.
const DETAIL_ANGLE_RAD: f64 = 2.2e-3;
/// Voxels along a period of the detail noise that the fading counts with.
const DETAIL_VOXELS: f64 = 32.0;
/// Most samples of a ray that find no cloud.
const PROBES_MAX: u32 = 4096;

/// How finely a ray is marched.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MarchSteps {
    /// Steps through the thickness of a layer at close range, at least 1.
    pub steps: u32,
    /// Steps towards the sun; the scene's where there are none.
    pub sun_steps: Option<u32>,
    /// Where in a step samples stand, 0…1.
    pub start_fraction: f64,
    /// Whether a ray ends where hardly any light comes through.
    pub early_exit: bool,
    /// Whether layers above the eye are left out where the ray ends on the ground, as in the composite.
    pub ground_hides_layers: bool,
    /// Where the clear air behind is looked up; along the ray where there is none. The composite shares one direction
    /// among four pixels.
    pub air_direction: Option<DVec3>,
}

impl Default for MarchSteps {
    /// What the renderer does, its samples in the middle of their steps.
    fn default() -> Self {
        Self {
            steps: 96,
            sun_steps: None,
            start_fraction: 0.5,
            early_exit: true,
            ground_hides_layers: true,
            air_direction: None,
        }
    }
}

impl MarchSteps {
    /// # Errors
    /// Names the setting that is out of range.
    pub fn check(&self) -> Result<(), ReferenceError> {
        checked(
            "the number of steps",
            f64::from(self.steps),
            1.0..=1e9,
            "1 to 1e9",
        )?;
        checked(
            "the fraction of a step at which samples stand",
            self.start_fraction,
            0.0..=1.0,
            "0 to 1",
        )?;
        Ok(())
    }
}

/// Weight of the detail noise at a distance along a ray: it fades where its voxels become too small to be seen.
#[must_use]
pub fn detail_weight(detail_period_m: f64, distance_m: f64) -> f64 {
    let voxel_m = detail_period_m / DETAIL_VOXELS;
    (2.0 - distance_m * DETAIL_ANGLE_RAD / voxel_m).clamp(0.0, 1.0)
}

/// The grid of steps that all samples of a ray stand on: of equal length up to a distance, beyond it in proportion to the
/// distance. Steps are counted from the ray's origin, also across empty space.
#[derive(Clone, Copy, Debug)]
struct StepGrid {
    step_min_m: f64,
    step_per_distance: f64,
}

impl StepGrid {
    fn new(layer: &WorldLayer, steps: u32) -> Self {
        let steps = f64::from(steps.max(1));
        Self {
            step_min_m: (layer.top_altitude_m - layer.base_altitude_m) / steps,
            step_per_distance: 0.5 / steps,
        }
    }

    fn length_m(&self, distance_m: f64) -> f64 {
        self.step_min_m.max(distance_m * self.step_per_distance)
    }

    /// ∫ dt / length from 0 to a distance.
    fn steps_at(&self, distance_m: f64) -> f64 {
        let relative = distance_m * self.step_per_distance / self.step_min_m;
        let scaled = if relative > 1.0 {
            1.0 + relative.ln()
        } else {
            relative
        };
        scaled / self.step_per_distance
    }

    /// The inverse.
    fn distance_m(&self, steps: f64) -> f64 {
        let scaled = steps * self.step_per_distance;
        let relative = if scaled > 1.0 {
            (scaled - 1.0).exp()
        } else {
            scaled
        };
        relative * self.step_min_m / self.step_per_distance
    }

    /// Steps of the first sample at or beyond a distance.
    fn first_sample(&self, distance_m: f64, start_fraction: f64) -> f64 {
        (self.steps_at(distance_m) - start_fraction).ceil() + start_fraction
    }
}

/// Optical depth from a point of the frame towards the sun within its layer, by samples in the middles of parts that grow
/// with the square of their count.
#[must_use]
pub fn sun_optical_depth(
    world: &World,
    layer: &WorldLayer,
    position_m: DVec3,
    sun_steps: u32,
) -> f64 {
    depth_of_samples(
        layer,
        position_m,
        world.light().sun_direction,
        world.scene().light().sun_march_distance_m(),
        sun_steps,
        |at_m| world.smooth_density(layer, at_m),
    )
}

/// Optical depth from a point along a direction over a reach in m, by samples of a density as those towards the sun.
pub(super) fn depth_of_samples(
    layer: &WorldLayer,
    position_m: DVec3,
    direction: DVec3,
    reach_m: f64,
    samples: u32,
    density: impl Fn(DVec3) -> f64,
) -> f64 {
    let count = f64::from(samples);
    let length_m: f64 = (0..samples)
        .map(|i| {
            let near_m = (f64::from(i) / count).powi(2) * reach_m;
            let far_m = (f64::from(i + 1) / count).powi(2) * reach_m;
            density(position_m + direction * (0.5 * (near_m + far_m))) * (far_m - near_m)
        })
        .sum();
    length_m * layer.extinction_per_m
}

/// What a sample finds: density, or how far the next one may be.
enum Found {
    Cloud { density: f64 },
    Clear { skip_m: f64 },
}

fn sample(
    world: &World,
    layer: &WorldLayer,
    position_m: DVec3,
    distance_m: f64,
    height_fraction: f64,
) -> Found {
    let place = world.field_place(layer, position_m);
    let density = match &layer.medium {
        Medium::Weather(weather) => {
            let (Some(noise), Some(maps)) = (world.noise(), world.maps(layer)) else {
                return Found::Clear { skip_m: 0.0 };
            };
            let profile = weather.dimensional_profile(maps, place, height_fraction);
            if profile == 0.0 {
                let skip_m = weather.skip_m(maps, place);
                return Found::Clear { skip_m };
            }
            let weight = detail_weight(weather.detail_period_m, distance_m);
            weather.carved_density(noise, place, height_fraction, profile, weight)
        }
        _ => world.density_at(layer, place, height_fraction, 1.0),
    };
    if density > 0.0 {
        Found::Cloud { density }
    } else {
        Found::Clear { skip_m: 0.0 }
    }
}

/// What a march has passed through.
struct Passed {
    transmittance: f64,
    optical_depth: f64,
    layer_distance_m: f64,
    evaluations: u64,
}

/// Marches one ray through one layer; also tells how often density was looked up.
#[must_use]
pub fn gather_layer(
    world: &World,
    layer: &WorldLayer,
    ray: &Ray,
    settings: &MarchSteps,
) -> (LayerGathered, u64) {
    if let Medium::Sheet(_) = layer.medium {
        return super::sheet::gather_sheet(world, layer, ray, settings);
    }
    let mut gathering = Gathering::new(world, layer, ray);
    let passed = each_lit_sample(
        world,
        layer,
        ray,
        settings,
        |weight, distance_m, sun_depth| {
            gathering.add(weight, distance_m, sun_depth);
        },
    );
    // What a ray that has ended early did not see is taken to be like the rest of it.
    let ended = settings.early_exit && passed.transmittance < TRANSMITTANCE_MIN;
    let transmittance = if ended {
        gathering.scale(1.0 / (1.0 - passed.transmittance));
        0.0
    } else {
        passed.transmittance
    };
    let gathered = gathering.finished(
        transmittance,
        passed.optical_depth,
        passed.layer_distance_m,
        |place_m, up| surroundings(world, layer, place_m, up),
    );
    (gathered, passed.evaluations)
}

/// What the model of scattered light knows of a ray.
#[derive(Clone, Debug, PartialEq)]
pub struct LitRay {
    /// Share of its light that each lit sample shows, and optical depth from there to the sun.
    pub samples: Vec<[f64; 2]>,
    /// The front of what is seen, and what lies behind.
    pub parts: Vec<LitPart>,
    /// The mean of the lit samples' heights in the layer, 0…1.
    pub height_fraction: f64,
}

/// A part of a ray that is lit as one place.
#[derive(Clone, Debug, PartialEq)]
pub struct LitPart {
    /// Share of the ray's light that it shows.
    pub shown: f64,
    /// Mean optical depth to the sun.
    pub sun_depth: f64,
    /// What is around the place where its light comes from on the mean.
    pub around: Surroundings,
    /// Sine of the ray's elevation there.
    pub rising: f64,
    /// Sine of the sun's.
    pub sun_rising: f64,
}

/// The lit samples of a ray in one layer, for fits of what is made of them.
#[must_use]
pub fn lit_ray(world: &World, layer: &WorldLayer, ray: &Ray, settings: &MarchSteps) -> LitRay {
    let mut samples = Vec::new();
    let mut seen = SeenParts::of_volume();
    each_lit_sample(
        world,
        layer,
        ray,
        settings,
        |weight, distance_m, sun_depth| {
            samples.push([weight, sun_depth]);
            seen.add(weight, distance_m, sun_depth);
        },
    );
    let parts = seen.each().map(|part| {
        let middle_m = ray.at(part.distance_m());
        let up = world.globe().up(middle_m);
        LitPart {
            shown: part.shown,
            sun_depth: part.sun_depth(),
            around: surroundings(world, layer, middle_m, up),
            rising: ray.direction.dot(up),
            sun_rising: world.light().sun_direction.dot(up),
        }
    });
    let shown = seen.shown();
    let middle_m = ray.at(if shown > 0.0 {
        seen.weighted_distance_m() / shown
    } else {
        0.0
    });
    LitRay {
        samples,
        parts: parts.collect(),
        height_fraction: layer.height_fraction(world.globe().altitude_m(middle_m)),
    }
}

/// Visits the lit samples of a ray in one layer: the share of its light that each shows, its distance, and the optical
/// depth to the sun.
fn each_lit_sample(
    world: &World,
    layer: &WorldLayer,
    ray: &Ray,
    settings: &MarchSteps,
    mut visit: impl FnMut(f64, f64, f64),
) -> Passed {
    let grid = StepGrid::new(layer, settings.steps);
    let sun_steps = settings
        .sun_steps
        .unwrap_or(world.scene().light().sun_steps())
        .max(1);
    let parts = world
        .globe()
        .layer_intervals(layer.base_altitude_m, layer.top_altitude_m, ray);
    let layer_distance_m = 0.5 * (parts[0].start_m + parts[0].end_m);
    // Horizontal metres per metre of ray; the floor keeps the quotient finite for vertical rays.
    let across = ray.direction.x.hypot(ray.direction.z).max(1e-3);
    let (mut transmittance, mut optical_depth) = (1.0, 0.0);
    let (mut probes, mut evaluations) = (0, 0);
    'ray: for part in parts.iter().filter(|part| !part.is_empty()) {
        let mut steps = grid.first_sample(part.start_m, settings.start_fraction);
        loop {
            let distance_m = grid.distance_m(steps);
            if distance_m >= part.end_m {
                break;
            }
            if probes >= PROBES_MAX {
                break 'ray;
            }
            let position_m = ray.at(distance_m);
            let altitude_m = world.globe().altitude_m(position_m);
            let height_fraction = layer.height_fraction(altitude_m).clamp(0.0, 1.0);
            evaluations += 1;
            let density = match sample(world, layer, position_m, distance_m, height_fraction) {
                Found::Cloud { density } => density,
                Found::Clear { skip_m } => {
                    probes += 1;
                    let skipped = grid.steps_at(distance_m + skip_m / across) - steps;
                    steps += skipped.ceil().max(1.0);
                    continue;
                }
            };
            let depth = density * layer.extinction_per_m * grid.length_m(distance_m);
            let weight = transmittance * depth * one_minus_exp_over(depth);
            let sun_depth = sun_optical_depth(world, layer, position_m, sun_steps);
            evaluations += u64::from(sun_steps);
            visit(weight, distance_m, sun_depth);
            optical_depth += depth;
            transmittance *= (-depth).exp();
            steps += 1.0;
            if settings.early_exit && transmittance < TRANSMITTANCE_MIN {
                break 'ray;
            }
        }
    }
    Passed {
        transmittance,
        optical_depth,
        layer_distance_m,
        evaluations,
    }
}

/// The middle of a layer along a ray, m: what stands for the distance where nothing is seen.
pub(super) fn layer_distance_m(parts: [Interval; 2]) -> f64 {
    0.5 * (parts[0].start_m + parts[0].end_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_and_distances_are_inverse_and_steps_have_their_length() {
        let grid = StepGrid {
            step_min_m: 26.0,
            step_per_distance: 0.5 / 96.0,
        };
        for distance_m in [0.0, 3.0, 4_991.0, 4_993.0, 50_000.0, 2.0e5] {
            let steps = grid.steps_at(distance_m);
            assert!((grid.distance_m(steps) - distance_m).abs() < 1e-9 * distance_m.max(1.0));
            // The derivative of the distance is the length of a step.
            let h = 1e-4;
            let length = (grid.distance_m(steps + h) - grid.distance_m(steps - h)) / (2.0 * h);
            assert!((length - grid.length_m(distance_m)).abs() < 1e-3 * length);
        }
    }

    #[test]
    fn the_first_sample_is_at_or_beyond_its_distance_and_less_than_a_step_away() {
        let grid = StepGrid {
            step_min_m: 10.0,
            step_per_distance: 0.01,
        };
        for fraction in [0.0, 0.3, 0.99] {
            for distance_m in [0.0, 95.0, 1_005.0, 30_000.0] {
                let first = grid.first_sample(distance_m, fraction);
                let beyond = first - grid.steps_at(distance_m);
                assert!((0.0..1.0).contains(&beyond));
                let counted = first - fraction;
                assert!((counted - counted.round()).abs() < 1e-9);
            }
        }
    }
}
