//! `skycell-server render`: one picture, or the numbers along given rays, without a server; by any of the renderers.

mod arguments;
mod device;
pub(crate) mod display;
mod processor;
mod rays;

pub use arguments::{Approximation, Chosen, Interpolation, RenderArguments, StillKind, SunChoice};

use crate::config::RenderConfig;
use crate::encode::exr_of;
use crate::march::EXPOSURE_AT_ZERO_EV;
use crate::scene::{Preset, preset, presets};
use anyhow::{Context, bail, ensure};
use display::Display;
use glam::DVec3;
use indicatif::{ProgressBar, ProgressStyle};
use rays::{CONVENTIONS, RayLine, RayReport, WorldRay, read_rays};
use serde_json::json;
use skycell_protocol::scene::ranges::SKY_TIME_S;
use skycell_protocol::{Camera, FrameSize, Moment, Scene};
use skycell_reference::picture::Projection;
use skycell_reference::{Ray, RayResult};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Folder for noise when none is named: the user's cache folder.
#[must_use]
pub fn default_noise_cache_dir() -> Option<PathBuf> {
    directories::ProjectDirs::from("", "", "skycell").map(|dirs| dirs.cache_dir().to_owned())
}

/// Where data are looked for.
#[derive(Clone, Debug)]
pub(crate) struct Folders {
    /// Noise, kept between runs.
    pub(crate) noise: PathBuf,
    /// Voxels and maps: beside the scene file.
    pub(crate) grids: PathBuf,
}

impl Folders {
    pub(crate) fn of(scene: Option<&Path>, noise: Option<&PathBuf>) -> Self {
        Self {
            noise: noise
                .cloned()
                .or_else(default_noise_cache_dir)
                .unwrap_or_else(|| PathBuf::from("skycell-cache")),
            grids: scene
                .and_then(Path::parent)
                .map_or_else(|| PathBuf::from("."), Path::to_owned),
        }
    }

    /// A renderer of its own with these, and with so much memory for caches.
    pub(crate) fn render_config(&self, cache_memory_mib: u32) -> RenderConfig {
        RenderConfig {
            cache_memory_mib,
            grids_dir: self.grids.clone(),
            maps_dir: self.grids.clone(),
            ..RenderConfig::new(self.noise.clone())
        }
    }
}

/// Reads a scene file; the default scene without one.
pub(crate) fn read_scene(path: Option<&Path>) -> anyhow::Result<Scene> {
    let Some(path) = path else {
        return Ok(Scene::default());
    };
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("the scene file {} cannot be read", path.display()))?;
    let value = serde_json::from_str(&text)
        .with_context(|| format!("the scene file {} is no JSON", path.display()))?;
    Scene::from_json(&value).with_context(|| format!("the scene file {}", path.display()))
}

pub(crate) fn triple(values: &[f64]) -> anyhow::Result<[f64; 3]> {
    <[f64; 3]>::try_from(values).map_err(|_| anyhow::anyhow!("a position has three numbers"))
}

/// What is looked at.
enum Target {
    Camera {
        camera: Camera,
        size: FrameSize,
        orthographic_height_m: Option<f64>,
    },
    Rays(Vec<WorldRay>),
}

/// What kind of file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Output {
    Png,
    Exr,
    Json,
}

fn output(arguments: &RenderArguments) -> anyhow::Result<Output> {
    let extension = arguments
        .out
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_lowercase();
    match (extension.as_str(), arguments.rays.is_some()) {
        ("png", false) => Ok(Output::Png),
        ("exr", false) => Ok(Output::Exr),
        ("json", true) => Ok(Output::Json),
        (other, true) => bail!("--out ends in {other:?}; with --rays allowed is .json"),
        (other, false) => bail!("--out ends in {other:?}; allowed are .png and .exr"),
    }
}

/// The camera of the arguments; what they leave out is the preset's.
fn camera(arguments: &RenderArguments) -> anyhow::Result<Camera> {
    let fallback = match &arguments.preset {
        Some(name) => named_preset(name)?.camera,
        None => Camera::new([0.0, 2.0, 0.0], 0.0, 15.0, 60.0)?,
    };
    let position_m = arguments.position_m.as_deref().map(triple).transpose()?;
    Ok(Camera::new(
        position_m.unwrap_or(fallback.position_m()),
        arguments.yaw_deg.unwrap_or(fallback.yaw_deg()),
        arguments.pitch_deg.unwrap_or(fallback.pitch_deg()),
        arguments.fov_deg.unwrap_or(fallback.vertical_fov_deg()),
    )?)
}

pub(crate) fn named_preset(name: &str) -> anyhow::Result<&'static Preset> {
    let names: Vec<&str> = presets().iter().map(|p| p.name.as_str()).collect();
    preset(name).with_context(|| {
        format!(
            "--preset is {name:?}; allowed is one of {}",
            names.join(", ")
        )
    })
}

/// The scene of the arguments at the time of the arguments.
fn scene_of(arguments: &RenderArguments) -> anyhow::Result<Scene> {
    let scene = match &arguments.preset {
        Some(name) => named_preset(name)?.scene.clone(),
        None => read_scene(arguments.scene.as_deref())?,
    };
    Ok(match &arguments.at {
        Some(at) => scene.at(Moment::parse(at, "--at")?),
        None => {
            SKY_TIME_S.check("--time-s", arguments.time_s)?;
            scene.at_sky_s(arguments.time_s)
        }
    })
}

fn target(arguments: &RenderArguments) -> anyhow::Result<Target> {
    if let Some(path) = &arguments.rays {
        return Ok(Target::Rays(read_rays(path)?));
    }
    let camera = camera(arguments)?;
    if let Some(height_m) = arguments.orthographic_height_m {
        ensure!(
            (1e-3..=4e7).contains(&height_m),
            "--orthographic-height-m is {height_m}; allowed is 0.001 to 4e7"
        );
    }
    Ok(Target::Camera {
        camera,
        size: FrameSize::new(arguments.width, arguments.height)?,
        orthographic_height_m: arguments.orthographic_height_m,
    })
}

/// A bar that shows how far a renderer is and how long it will take.
fn progress_bar() -> anyhow::Result<ProgressBar> {
    let bar = ProgressBar::new(1000);
    bar.set_style(ProgressStyle::with_template(
        "rendering [{bar:30}] {percent} % {eta} left",
    )?);
    Ok(bar)
}

/// Renders and writes.
///
/// # Errors
/// For an unreadable scene or list of rays, an impossible camera, size or setting, a missing device, an unwritable file.
pub fn run(arguments: &RenderArguments) -> anyhow::Result<()> {
    let output = output(arguments)?;
    let scene = scene_of(arguments)?;
    let folders = Folders::of(
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    );
    crate::field::check_grids(&scene, &folders.grids)?;
    let store = crate::field::FieldStore::new(Some(folders.noise.clone()));
    crate::field::check_maps(&scene, &store, &folders.grids)?;
    let chosen = Chosen::new(arguments.approximations.as_deref(), output != Output::Png);
    let target = target(arguments)?;
    match arguments.renderer {
        StillKind::Cached | StillKind::ScreenSpace => {
            device::run(arguments, scene, &folders, &chosen, target, output)
        }
        StillKind::Reference | StillKind::PathTraced => {
            ensure!(
                arguments.stereo.is_none(),
                "--stereo needs --renderer cached or screen-space"
            );
            on_processor(arguments, &scene, &folders, &chosen, target, output)
        }
    }
}

fn on_processor(
    arguments: &RenderArguments,
    scene: &Scene,
    folders: &Folders,
    chosen: &Chosen,
    target: Target,
    output: Output,
) -> anyhow::Result<()> {
    let marches = arguments.renderer == StillKind::Reference;
    let scene = &single_scattering_if_asked(scene, arguments, marches)?;
    let origin_m = match &target {
        Target::Camera { camera, .. } => DVec3::from_array(camera.position_m()),
        Target::Rays(rays) => rays[0].origin_m,
    };
    let world = processor::world(scene, arguments, chosen, folders, origin_m)?;
    let projection = match &target {
        Target::Camera {
            camera,
            size,
            orthographic_height_m: None,
        } => Projection::Pinhole {
            camera: *camera,
            size: *size,
        },
        Target::Camera {
            camera,
            size,
            orthographic_height_m: Some(height_m),
        } => Projection::Orthographic {
            camera: *camera,
            size: *size,
            height_m: *height_m,
        },
        Target::Rays(rays) => Projection::Rays(
            rays.iter()
                .map(|ray| Ray::new(world.frame_from_world_m(ray.origin_m), ray.direction))
                .collect::<Result<_, _>>()?,
        ),
    };
    let bar = progress_bar()?;
    let start = Instant::now();
    let count = |more: u64, all: u64| {
        if bar.length() != Some(all) {
            bar.set_length(all);
        }
        if bar.position() + more > all {
            bar.set_position(0);
        }
        bar.inc(more);
    };
    let found = processor::render(&world, &projection, arguments, chosen, &count)?;
    bar.finish_and_clear();
    let wall_s = start.elapsed().as_secs_f64();
    let steps: u64 = found.rays.iter().map(|ray| ray.steps).sum();
    let name = if marches { "reference" } else { "path-traced" };
    match &target {
        Target::Rays(rays) => {
            let lines = rays.iter().zip(&found.rays);
            let lines = lines.map(|(ray, result)| RayLine::new(ray, result, !marches));
            let settings = json!({
                "samples": found.samples, "seed": arguments.seed, "orders": arguments.orders,
                "steps": arguments.steps, "tolerance": arguments.tolerance, "time_s": arguments.time_s,
                "approximations": format!("{:?}", chosen.of_reference()),
                "not_converged": found.not_converged, "cut_paths": found.cut_paths,
            });
            write_rays(&arguments.out, name, settings, lines.collect())?;
        }
        Target::Camera { size, .. } => {
            write_found(arguments, scene, chosen, *size, &found.rays, output)?;
        }
    }
    if found.not_converged > 0 {
        eprintln!(
            "{} of {} rays did not converge to {}",
            found.not_converged,
            found.rays.len(),
            arguments.tolerance
        );
    }
    if arguments.json {
        let figures = json!({
            "out": arguments.out, "renderer": name, "wall_s": wall_s, "rays": found.rays.len(), "steps": steps,
            "samples": found.samples, "not_converged": found.not_converged, "cut_paths": found.cut_paths,
            "worst_standard_error": found.worst_error, "threads": rayon::current_num_threads(),
        });
        println!("{figures}");
    } else {
        println!(
            "{} in {wall_s:.1} s: {} rays, {} samples each, {steps} evaluations of density{}",
            arguments.out.display(),
            found.rays.len(),
            found.samples,
            if marches {
                String::new()
            } else {
                format!(
                    ", largest standard error {:.2} %",
                    100.0 * found.worst_error
                )
            }
        );
    }
    Ok(())
}

/// The scene with one octave where single scattering is asked for. Other orders are the path tracer's.
fn single_scattering_if_asked(
    scene: &Scene,
    arguments: &RenderArguments,
    marches: bool,
) -> anyhow::Result<Scene> {
    match (processor::orders(&arguments.orders)?, marches) {
        (None, _) | (_, false) => Ok(scene.clone()),
        (Some(1), true) => {
            let mut document = scene.to_document();
            document.light.octaves = 1;
            Ok(Scene::try_from(document)?.carried_like(scene))
        }
        (Some(other), true) => bail!(
            "--orders is {other}; the marching renderers know 1 (single scattering) and all (the scene's octaves)"
        ),
    }
}

fn write_rays(
    path: &Path,
    renderer: &'static str,
    settings: serde_json::Value,
    rays: Vec<RayLine>,
) -> anyhow::Result<()> {
    let report = RayReport {
        renderer,
        conventions: CONVENTIONS,
        settings,
        rays,
    };
    std::fs::write(path, serde_json::to_vec_pretty(&report)?)
        .with_context(|| format!("{} cannot be written", path.display()))
}

/// Writes a picture of what the processor found; of the path tracer, the standard errors beside it.
fn write_found(
    arguments: &RenderArguments,
    scene: &Scene,
    chosen: &Chosen,
    size: FrameSize,
    rays: &[RayResult],
    output: Output,
) -> anyhow::Result<()> {
    let (width, height) = (size.width(), size.height());
    let floats = |of: &dyn Fn(&RayResult) -> DVec3| -> Vec<f32> {
        rays.iter()
            .flat_map(|ray| of(ray).as_vec3().to_array())
            .collect()
    };
    match output {
        Output::Exr => write_exr(&arguments.out, size, floats(&|ray| ray.radiance))?,
        _ => {
            let display = Display {
                exposure: EXPOSURE_AT_ZERO_EV * scene.exposure_ev().exp2(),
                curve: scene.tone().curve(),
                tone_map: chosen.has(Approximation::ToneMap),
                dither: chosen.has(Approximation::Dither),
            };
            let bytes = (0..).zip(rays).flat_map(|(index, ray)| {
                display.bytes(ray.radiance.to_array(), index % width, index / width)
            });
            image::RgbImage::from_raw(width, height, bytes.collect())
                .context("as many rays as pixels")?
                .save(&arguments.out)
                .with_context(|| format!("{} cannot be written", arguments.out.display()))?;
        }
    }
    if arguments.renderer == StillKind::PathTraced {
        let beside = arguments.out.with_extension("error.exr");
        write_exr(&beside, size, floats(&|ray| ray.standard_error.radiance))?;
    }
    Ok(())
}

/// Writes linear values, three a pixel.
fn write_exr(path: &Path, size: FrameSize, values: Vec<f32>) -> anyhow::Result<()> {
    std::fs::write(path, exr_of(size, values)?)
        .with_context(|| format!("{} cannot be written", path.display()))
}
