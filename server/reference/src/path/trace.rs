//! Camera paths.

use super::{Moments, Random, Tracker};
use crate::error::checked;
use crate::march::shaded_background;
use crate::phase::{one_minus_mu, turned};
use crate::sky::Haze;
use crate::{Ray, ReferenceError, World};
use glam::DVec3;
use serde::Serialize;
use skycell_protocol::scene::Atmosphere;
use std::f64::consts::TAU;
use std::ops::Range;

/// Which orders of scattering count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Orders {
    /// All.
    All,
    /// Up to this many; 1 is single scattering, 0 shows only what is behind the clouds.
    UpTo(u32),
}

/// How the sun is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum SunShape {
    /// As one direction.
    Point,
    /// As a disc of even radiance.
    Disc,
}

/// How paths are traced.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PathSettings {
    /// Which orders of scattering count.
    pub orders: Orders,
    /// How the sun is looked for.
    pub sun: SunShape,
    /// A path whose weight has fallen below this goes on by chance, with its weight restored.
    pub roulette_below: f64,
    /// Safety limit of scatterings of a path. Paths that it cuts are counted.
    pub scatterings_max: u32,
}

impl Default for PathSettings {
    fn default() -> Self {
        Self {
            orders: Orders::All,
            sun: SunShape::Disc,
            roulette_below: 0.1,
            scatterings_max: 1_000_000,
        }
    }
}

impl PathSettings {
    /// # Errors
    /// Names the setting that is out of range.
    pub fn check(&self) -> Result<(), ReferenceError> {
        checked(
            "the weight below which paths play roulette",
            self.roulette_below,
            0.0..=1.0,
            "0 to 1",
        )?;
        Ok(())
    }
}

/// One in so many samples follows its ray to the end for the optical depth.
const DEPTH_EVERY: u64 = 16;

/// What one path brought.
#[derive(Default)]
struct Gathered {
    /// Sun light per unit of irradiance, 1/sr.
    sunlit: f64,
    /// The part of it that was scattered once.
    sunlit_once: f64,
    /// From sky, ground and environment.
    environment: DVec3,
    cut: bool,
    scatterings: u64,
}

/// Traces samples of a ray. The same seed, ray index and sample indices give the same numbers, bit by bit, wherever and in
/// whatever order they are traced; merge ranges in a fixed order ([`Moments::merge`]).
#[must_use]
pub fn trace_ray(
    world: &World,
    ray: &Ray,
    ray_index: u64,
    samples: Range<u64>,
    seed: u64,
    settings: &PathSettings,
) -> Moments {
    trace_with(
        Tracker::new(world),
        world,
        ray,
        ray_index,
        samples,
        seed,
        settings,
    )
}

pub(super) fn trace_with(
    mut tracker: Tracker<'_>,
    world: &World,
    ray: &Ray,
    ray_index: u64,
    samples: Range<u64>,
    seed: u64,
    settings: &PathSettings,
) -> Moments {
    let light = world.light();
    let background = shaded_background(world, ray, ray.direction);
    let hazed = world.settings().approximations.aerial_perspective;
    let mut moments = Moments::default();
    for sample in samples {
        let mut random = Random::new(seed, ray_index, sample);
        let transmittance = if sample % DEPTH_EVERY == 0 {
            let (transmittance, depth) = tracker.transmittance_and_depth(ray, &mut random);
            moments.optical_depth.add(depth);
            transmittance
        } else {
            tracker.transmittance(ray, &mut random)
        };
        let mut radiance = background.radiance * transmittance;
        let mut once = DVec3::ZERO;
        if let Some(first) = tracker.collision(ray, &mut random) {
            let Haze { kept, added } = if hazed {
                let air = world.layers()[first.layer].air_extinction_per_m;
                background.haze(light, first.distance_m, air)
            } else {
                Haze::NONE
            };
            let path = scattered(&mut tracker, world, ray, first, &mut random, settings);
            once = light.irradiance_at_clouds * path.sunlit_once * kept;
            radiance +=
                (light.irradiance_at_clouds * path.sunlit + path.environment) * kept + added;
            moments.cut_paths += u64::from(path.cut);
            moments.scatterings += path.scatterings;
        }
        moments.add(radiance, once, transmittance);
    }
    moments.evaluations = tracker.evaluations;
    moments.above_majorant = tracker.above_majorant;
    moments
}

/// What a path brings from its first collision on.
fn scattered(
    tracker: &mut Tracker<'_>,
    world: &World,
    ray: &Ray,
    first: super::Collision,
    random: &mut Random,
    settings: &PathSettings,
) -> Gathered {
    let light = world.light();
    let environment_factor = environment_factor(world);
    let mut gathered = Gathered::default();
    let (mut at, mut towards, mut weight) = (first, ray.direction, 1.0);
    let mut order = 0;
    loop {
        if let Orders::UpTo(most) = settings.orders
            && order >= most
        {
            return gathered;
        }
        order += 1;
        gathered.scatterings += 1;
        if order > settings.scatterings_max {
            gathered.cut = true;
            return gathered;
        }
        weight *= at.albedo;
        if weight <= 0.0 {
            return gathered;
        }
        let phase = &world.layers()[at.scatterer].phase;
        // The sun, directly.
        let to_sun = match settings.sun {
            SunShape::Point => light.sun_direction,
            SunShape::Disc => turned(
                light.sun_direction,
                light.sun_one_minus_mu * random.unit(),
                TAU * random.unit(),
            ),
        };
        let shadow_ray = Ray {
            origin_m: at.position_m,
            direction: to_sun,
        };
        if light.irradiance_at_clouds.max_element() > 0.0
            && world.globe().ground_m(&shadow_ray).is_none()
        {
            let seen = tracker.transmittance(&shadow_ray, random)
                * phase.per_sr(1.0, one_minus_mu(towards, to_sun))
                * weight;
            gathered.sunlit += seen;
            if order == 1 {
                gathered.sunlit_once = seen;
            }
        }
        if weight < settings.roulette_below {
            if random.unit() * settings.roulette_below >= weight {
                return gathered;
            }
            weight = settings.roulette_below;
        }
        // Onwards.
        let x = phase.sample(|| random.unit());
        towards = turned(towards, x, TAU * random.unit());
        let onwards = Ray {
            origin_m: at.position_m,
            direction: towards,
        };
        match tracker.collision(&onwards, random) {
            Some(collision) => at = collision,
            None => {
                if environment_factor > 0.0 {
                    let behind = light.environment(&onwards);
                    gathered.environment += behind * (weight * environment_factor);
                }
                return gathered;
            }
        }
    }
}

/// Factor of the light that paths find where they leave the clouds.
fn environment_factor(world: &World) -> f64 {
    let uniform = matches!(world.scene().atmosphere(), Atmosphere::Uniform(_));
    if uniform || world.settings().approximations.ambient {
        world.scene().light().ambient()
    } else {
        0.0
    }
}
