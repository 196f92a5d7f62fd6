//! What the path tracer says about the shapes, kept in a file so that nobody traces it again.

use super::shapes::{Droplets, SUN_ELEVATIONS_DEG, Shape, shapes, towards_sun};
use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;
use skycell_reference::path::{Mean, Random, Tracker};
use skycell_reference::phase::{one_minus_mu, turned};
use skycell_reference::{Ray, World};
use std::f64::consts::TAU;
use std::path::Path;

/// Samples that one task traces.
const CHUNK: u64 = 512;
const SUNS: usize = SUN_ELEVATIONS_DEG.len();

/// An estimate with its standard error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Mean.
    pub mean: f64,
    /// Its standard error.
    pub standard_error: f64,
}

/// One look at one shape in all lights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Index of the view in the shape's.
    pub view: usize,
    /// Paths.
    pub paths: u64,
    /// Share of the ray that does not pass through.
    pub opacity: Estimate,
    /// Scattered radiance per unit of the sun's irradiance, 1/sr, for each of [`SUN_ELEVATIONS_DEG`].
    pub sunlit: Vec<Estimate>,
    /// The part of it that was scattered once.
    pub sunlit_once: Vec<Estimate>,
    /// Share of an even sky above the horizon that is scattered towards the eye.
    pub sky: Estimate,
}

/// What was measured of one shape with one kind of droplets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShapeTruth {
    /// The shape's name.
    pub shape: String,
    /// The droplets' name.
    pub droplets: String,
    /// All looks.
    pub measured: Vec<Measured>,
}

/// All truth, with what made it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Seed of the random numbers.
    pub seed: u64,
    /// Paths of a look that collide, with Henyey-Greenstein droplets; twice as many with those of a narrower peak.
    pub paths: u64,
    /// By shape and droplets.
    pub shapes: Vec<ShapeTruth>,
}

/// How much is traced.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Seed of the random numbers.
    pub seed: u64,
    /// Paths of a look that collide, with Henyey-Greenstein droplets; others take twice as many.
    pub paths: u64,
}

impl Truth {
    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be read or is none.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("{} cannot be read", path.display()))?;
        serde_json::from_str(&text)
            .with_context(|| format!("{} is no truth of measure octaves", path.display()))
    }

    /// The truth of a shape with droplets.
    #[must_use]
    pub fn of(&self, shape: &Shape, droplets: Droplets) -> Option<&ShapeTruth> {
        self.shapes
            .iter()
            .find(|truth| truth.shape == shape.name && truth.droplets == droplets.name())
    }

    /// Traces all shapes.
    ///
    /// # Errors
    /// Never, unless a shape is no scene.
    pub fn trace(effort: Effort) -> anyhow::Result<Self> {
        let mut truth = Self {
            seed: effort.seed,
            paths: effort.paths,
            shapes: Vec::new(),
        };
        let bar = ProgressBar::new((shapes().len() * Droplets::ALL.len()) as u64);
        if let Ok(style) = ProgressStyle::with_template("[{bar:24}] {pos}/{len} {msg} {eta} left") {
            bar.set_style(style);
        }
        for shape in shapes() {
            for droplets in Droplets::ALL {
                bar.set_message(format!("{}, {}", shape.name, droplets.name()));
                truth.shapes.push(traced(&shape, droplets, effort)?);
                bar.inc(1);
            }
        }
        bar.finish_and_clear();
        Ok(truth)
    }
}

/// Traces a shape with one kind of droplets.
///
/// # Errors
/// Never, unless the shape is no scene.
pub fn traced(shape: &Shape, droplets: Droplets, effort: Effort) -> anyhow::Result<ShapeTruth> {
    let collisions = match droplets {
        Droplets::Hg => effort.paths,
        Droplets::HgDraine => 2 * effort.paths,
    } / shape.cost();
    let world = shape.world(droplets, 90.0, &json!({}))?;
    let measured = shape
        .views()
        .iter()
        .enumerate()
        .map(|(view, look)| all_paths(&world, &look.ray, view, collisions, effort.seed))
        .collect();
    Ok(ShapeTruth {
        shape: shape.name.to_owned(),
        droplets: droplets.name().to_owned(),
        measured,
    })
}

/// What the paths of a look bring.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    opacity: Mean,
    sunlit: [Mean; SUNS],
    sunlit_once: [Mean; SUNS],
    sky: Mean,
}

/// All paths of a ray, in chunks that are merged in their order: the same bits on any number of threads. Where most rays
/// pass, more are traced, so that as many collide.
fn all_paths(world: &World, ray: &Ray, view: usize, collisions: u64, seed: u64) -> Measured {
    let index = view as u64;
    let mut tracker = Tracker::new(world);
    let tries = 256;
    let passed: f64 = (0..tries)
        .map(|i| tracker.transmittance(ray, &mut Random::new(!seed, index, i)))
        .sum();
    let opacity = (1.0 - passed / tries as f64).clamp(0.05, 1.0);
    let paths = (collisions as f64 / opacity) as u64;
    let parts: Vec<Sums> = (0..paths.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut tracker = Tracker::new(world);
            let mut sums = Sums::default();
            for sample in chunk * CHUNK..((chunk + 1) * CHUNK).min(paths) {
                walk(
                    &mut tracker,
                    world,
                    ray,
                    &mut Random::new(seed, index, sample),
                    &mut sums,
                );
            }
            sums
        })
        .collect();
    let mut all = Sums::default();
    for part in &parts {
        all.opacity.merge(&part.opacity);
        all.sky.merge(&part.sky);
        for sun in 0..SUNS {
            all.sunlit[sun].merge(&part.sunlit[sun]);
            all.sunlit_once[sun].merge(&part.sunlit_once[sun]);
        }
    }
    let estimate = |mean: &Mean| Estimate {
        mean: rounded(mean.mean),
        standard_error: rounded(mean.standard_error()),
    };
    Measured {
        view,
        paths,
        opacity: estimate(&all.opacity),
        sunlit: all.sunlit.iter().map(estimate).collect(),
        sunlit_once: all.sunlit_once.iter().map(estimate).collect(),
        sky: estimate(&all.sky),
    }
}

/// Five digits: what is below is noise.
fn rounded(value: f64) -> f64 {
    format!("{value:.4e}").parse().unwrap_or(value)
}

/// One path: all suns are looked for at every scattering, and where it leaves upwards it has found the sky. Nothing is
/// absorbed, so its weight stays 1 and nothing but leaving ends it.
fn walk(tracker: &mut Tracker<'_>, world: &World, ray: &Ray, random: &mut Random, sums: &mut Sums) {
    let mut sunlit = [0.0; SUNS];
    let mut once = [0.0; SUNS];
    let mut towards = *ray;
    let mut order = 0;
    let mut sky = 0.0;
    while let Some(at) = tracker.collision(&towards, random) {
        order += 1;
        for (sun, elevation_deg) in SUN_ELEVATIONS_DEG.into_iter().enumerate() {
            let to_sun = Ray {
                origin_m: at.position_m,
                direction: towards_sun(elevation_deg),
            };
            let phase = world
                .phase()
                .per_sr(1.0, one_minus_mu(towards.direction, to_sun.direction));
            let seen = phase * tracker.transmittance(&to_sun, random);
            sunlit[sun] += seen;
            if order == 1 {
                once[sun] = seen;
            }
        }
        let x = world.phase().sample(|| random.unit());
        towards = Ray {
            origin_m: at.position_m,
            direction: turned(towards.direction, x, TAU * random.unit()),
        };
    }
    if order > 0 && towards.direction.y > 0.0 {
        sky = 1.0;
    }
    sums.opacity.add(if order > 0 { 1.0 } else { 0.0 });
    sums.sky.add(sky);
    for sun in 0..SUNS {
        sums.sunlit[sun].add(sunlit[sun]);
        sums.sunlit_once[sun].add(once[sun]);
    }
}
