//! Pictures and rays by the f64 renderers, on all cores.

use super::arguments::{Approximation, Chosen, RenderArguments, StillKind, SunChoice};
use anyhow::{Context, bail, ensure};
use glam::DVec2;
use rayon::prelude::*;
use skycell_reference::march::{ConvergeLimit, MarchSteps, converged_ray, march_ray};
use skycell_reference::path::{Moments, Orders, PathSettings, SunShape, trace_ray};
use skycell_reference::picture::Projection;
use skycell_reference::{Ray, RayResult, World};

/// Paths per pixel and round.
const FIRST_ROUND: u64 = 64;
/// Most paths per pixel of `--until-error`.
const PATHS_MAX: u64 = 1_000_000;
/// Most paths per pixel that can be asked for.
const SAMPLES_MAX: u64 = 1_000_000_000;

/// What a renderer on the processor found.
pub(super) struct Found {
    pub(super) rays: Vec<RayResult>,
    /// Rays whose steps could not be halved further; 0 if all converged.
    pub(super) not_converged: u64,
    /// Paths that a safety limit has cut: the picture is too dark if not 0.
    pub(super) cut_paths: u64,
    /// Paths or sub-pixels of each pixel.
    pub(super) samples: u64,
    /// Largest standard error of a pixel as a share of its radiance; 0 where nothing is random.
    pub(super) worst_error: f64,
}

/// The orders of scattering that an argument names.
pub(super) fn orders(text: &str) -> anyhow::Result<Option<u32>> {
    if text == "all" {
        return Ok(None);
    }
    match text.parse() {
        Ok(number) if number >= 1 => Ok(Some(number)),
        _ => bail!("--orders is {text:?}; allowed are all and numbers from 1"),
    }
}

/// Renders every ray of a projection. `progress` gets how many more rays are done and how many there are.
pub(super) fn render(
    world: &World,
    projection: &Projection,
    arguments: &RenderArguments,
    chosen: &Chosen,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> anyhow::Result<Found> {
    match arguments.renderer {
        StillKind::PathTraced => path_traced(world, projection, arguments, chosen, progress),
        _ => marched(world, projection, arguments, chosen, progress),
    }
}

fn count(projection: &Projection) -> usize {
    let [width, height] = projection.size();
    width * height
}

/// The ray through a place inside a pixel, each part in 0…1.
fn pixel_ray(world: &World, projection: &Projection, index: usize, within: DVec2) -> Option<Ray> {
    let width = projection.size()[0];
    let pixel = DVec2::new((index % width) as f64, (index / width) as f64);
    projection.ray(world, pixel + within)
}

fn mean(results: &[RayResult]) -> RayResult {
    let n = results.len().max(1) as f64;
    let mut sum = RayResult::default();
    for result in results {
        sum.radiance += result.radiance / n;
        sum.single_scattered += result.single_scattered / n;
        sum.transmittance += result.transmittance / n;
        sum.optical_depth += result.optical_depth / n;
        sum.steps += result.steps;
    }
    sum
}

fn marched(
    world: &World,
    projection: &Projection,
    arguments: &RenderArguments,
    chosen: &Chosen,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> anyhow::Result<Found> {
    // A grid inside the pixel is a mean over its area as the device's samples are.
    let samples = arguments.samples.unwrap_or(8);
    ensure!(
        (1..=256).contains(&samples),
        "--samples is {samples}; allowed is 1 to 256 for the reference"
    );
    let along = if chosen.has(Approximation::Jitter) && !matches!(projection, Projection::Rays(_)) {
        (samples as f64).sqrt().ceil() as usize
    } else {
        1
    };
    let total = count(projection);
    let steps = arguments.steps.map(|steps| MarchSteps {
        steps,
        sun_steps: arguments.sun_steps,
        early_exit: chosen.has(Approximation::EarlyExit),
        ground_hides_layers: true,
        ..MarchSteps::default()
    });
    let found: Vec<(RayResult, bool)> = (0..total)
        .into_par_iter()
        .map(|index| {
            let mut results = Vec::with_capacity(along * along);
            let mut converged = true;
            for sub in 0..along * along {
                let place = DVec2::new((sub % along) as f64 + 0.5, (sub / along) as f64 + 0.5);
                let Some(ray) = pixel_ray(world, projection, index, place / along as f64) else {
                    continue;
                };
                results.push(match &steps {
                    Some(steps) => march_ray(world, &ray, steps),
                    None => {
                        let limit = ConvergeLimit::default();
                        let found = converged_ray(world, &ray, None, arguments.tolerance, &limit)?;
                        converged &= found.converged;
                        found.result
                    }
                });
            }
            progress(1, total as u64);
            Ok((mean(&results), converged))
        })
        .collect::<anyhow::Result<_>>()?;
    Ok(Found {
        not_converged: found.iter().filter(|(_, converged)| !converged).count() as u64,
        rays: found.into_iter().map(|(result, _)| result).collect(),
        cut_paths: 0,
        samples: (along * along) as u64,
        worst_error: 0.0,
    })
}

fn path_settings(arguments: &RenderArguments) -> anyhow::Result<PathSettings> {
    Ok(PathSettings {
        orders: orders(&arguments.orders)?.map_or(Orders::All, Orders::UpTo),
        sun: match arguments.sun {
            SunChoice::Disc => SunShape::Disc,
            SunChoice::Point => SunShape::Point,
        },
        ..PathSettings::default()
    })
}

/// A number in 0…1 that depends on all of its arguments: splitmix64.
fn hashed_unit(seed: u64, index: u64, sample: u64) -> f64 {
    let mut bits = seed ^ index.rotate_left(32) ^ sample.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    for multiplier in [0xbf58_476d_1ce4_e5b9u64, 0x94d0_49bb_1331_11eb] {
        bits = (bits ^ (bits >> 30)).wrapping_mul(multiplier);
    }
    ((bits ^ (bits >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

fn path_traced(
    world: &World,
    projection: &Projection,
    arguments: &RenderArguments,
    chosen: &Chosen,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> anyhow::Result<Found> {
    let settings = path_settings(arguments)?;
    let seed = arguments.seed;
    let asked = arguments.samples.unwrap_or(FIRST_ROUND);
    ensure!(
        (1..=SAMPLES_MAX).contains(&asked),
        "--samples is {asked}; allowed is 1 to {SAMPLES_MAX} paths"
    );
    if let Some(error) = arguments.until_error {
        ensure!(
            (1e-5..=1.0).contains(&error),
            "--until-error is {error}; allowed is 1e-5 to 1"
        );
    }
    let jitter = chosen.has(Approximation::Jitter) && !matches!(projection, Projection::Rays(_));
    let total = count(projection);
    let mut moments = vec![Moments::default(); total];
    let (mut done, mut round) = (0, asked);
    loop {
        let range = done..done + round;
        moments
            .par_iter_mut()
            .enumerate()
            .for_each(|(index, held)| {
                let at = index as u64;
                if jitter {
                    for sample in range.clone() {
                        let place = DVec2::new(
                            hashed_unit(seed, at, 2 * sample),
                            hashed_unit(seed, at, 2 * sample + 1),
                        );
                        if let Some(ray) = pixel_ray(world, projection, index, place) {
                            let one = sample..sample + 1;
                            held.merge(&trace_ray(world, &ray, at, one, seed, &settings));
                        }
                    }
                } else if let Some(ray) = pixel_ray(world, projection, index, DVec2::splat(0.5)) {
                    held.merge(&trace_ray(world, &ray, at, range.clone(), seed, &settings));
                }
                progress(1, total as u64);
            });
        done += round;
        let rays: Vec<RayResult> = moments.iter().map(Moments::result).collect();
        let worst_error = worst_error(&rays);
        let enough = arguments
            .until_error
            .is_none_or(|error| worst_error <= error);
        if enough || 2 * done > PATHS_MAX.max(asked) {
            let above: u64 = moments.iter().map(|m| m.above_majorant).sum();
            ensure!(
                above == 0,
                "the density exceeded its upper bound {above} times: please report the scene"
            );
            return Ok(Found {
                rays,
                not_converged: 0,
                cut_paths: moments.iter().map(|m| m.cut_paths).sum(),
                samples: done,
                worst_error,
            });
        }
        round = done;
    }
}

/// Largest standard error as a share of a pixel's radiance, or of a hundredth of the brightest pixel's where that is more.
fn worst_error(rays: &[RayResult]) -> f64 {
    let brightness = |ray: &RayResult| ray.radiance.element_sum() / 3.0;
    let floor = rays.iter().map(brightness).fold(0.0, f64::max) / 100.0;
    rays.iter()
        .map(|ray| {
            let error = ray.standard_error.radiance.max_element();
            if error == 0.0 {
                0.0
            } else {
                error / brightness(ray).max(floor)
            }
        })
        .fold(0.0, f64::max)
}

/// A world for the renderers of this module.
pub(super) fn world(
    scene: &skycell_protocol::Scene,
    arguments: &RenderArguments,
    chosen: &Chosen,
    folders: &super::Folders,
    origin_m: glam::DVec3,
) -> anyhow::Result<World> {
    crate::truth::reference_world(
        scene,
        &folders.noise,
        &folders.grids,
        arguments.time_s,
        origin_m,
        chosen.of_reference(),
    )
    .context("the scene cannot be given to the reference")
}
