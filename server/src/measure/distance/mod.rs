//! `skycell-server measure distance`: the error of a shared cache over the distance from its reference point.
//!
//! `plan` says what is rendered, `report` what comes of it, `page` how it is shown.

mod page;
pub mod plan;
pub mod report;

use super::arguments::parsed_size;
use super::metrics::{ShownErrors, shown_errors};
use super::progress::{Progress, spoken};
use super::reference::without_alpha;
use super::store::{key_of, write_whole};
use super::trade::version;
use crate::config::RenderConfig;
use crate::frame_loop::{StillRenderer, StillSettings};
use crate::render_command::{Folders, read_scene};
use anyhow::{Context, ensure};
use image::RgbImage;
use plan::{Direction, Fineness, Variant, View};
use report::{DistancePoint, DistanceReport};
use serde::{Deserialize, Serialize};
use skycell_protocol::{Camera, FrameSize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// GPU memory for the cache: a picture of 1920×1080 at full resolution.
const CACHE_MEMORY_MIB: u32 = 2048;
/// Height of the eye, m.
const EYE_M: f64 = 2.0;
/// Vertical field of view, degrees.
const FOV_DEG: f64 = 60.0;

/// What `measure distance` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct DistanceArguments {
    /// Folder of the results; what is there already is not measured again.
    #[arg(long, default_value = "skycell-distance", value_name = "DIR")]
    pub out: PathBuf,
    /// Scene document; the default scene without it. The wind stands still.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Size of the pictures [default: 96x54 with --quick, else 320x180].
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parsed_size)]
    pub size: Option<FrameSize>,
    /// Few distances, small pictures and short marches: a minute on two cores.
    #[arg(long)]
    pub quick: bool,
    /// Steps through a layer's thickness [default: 16 with --quick, else 64].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub steps: Option<u32>,
    /// Samples of a pixel and of a texel [default: 2 with --quick, else 8].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub samples: Option<u32>,
    /// Only these directions; all without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "DIRECTION,...")]
    pub directions: Vec<Direction>,
    /// Only these views; both without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "VIEW,...")]
    pub views: Vec<View>,
    /// Only these ways to read the cache; all without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "VARIANT,...")]
    pub variants: Vec<Variant>,
    /// Where the middle of the pictures looks above the horizon.
    #[arg(long, default_value_t = 20.0, allow_negative_numbers = true)]
    pub pitch_deg: f64,
    /// Write the curves that the limit of cells follows from here.
    #[arg(long, value_name = "FILE")]
    pub write_curve: Option<PathBuf>,
    /// The way to read the cache that --write-curve tells of.
    #[arg(long, value_enum, default_value_t = Variant::SERVED)]
    pub curve_of: Variant,
    /// Measure everything anew, whatever is in the folder.
    #[arg(long)]
    pub fresh: bool,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
}

impl DistanceArguments {
    fn fineness(&self) -> Fineness {
        let (steps, samples) = if self.quick { (16, 2) } else { (64, 8) };
        Fineness {
            steps: self.steps.unwrap_or(steps),
            samples: self.samples.unwrap_or(samples),
        }
    }

    fn picture_size(&self) -> anyhow::Result<FrameSize> {
        Ok(match (self.size, self.quick) {
            (Some(size), _) => size,
            (None, true) => FrameSize::new(96, 54)?,
            (None, false) => FrameSize::new(320, 180)?,
        })
    }
}

/// Those that are asked for, in the order of the report.
fn asked<T: Copy + PartialEq>(all: &[T], asked: &[T]) -> Vec<T> {
    let is_asked = |one: &&T| asked.is_empty() || asked.contains(one);
    all.iter().filter(is_asked).copied().collect()
}

/// Measures and writes the report.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, an impossible camera, a missing device.
pub(super) fn run(arguments: &DistanceArguments) -> anyhow::Result<()> {
    let begun = Instant::now();
    let report = measured(arguments)?;
    let out = &arguments.out;
    let text = format!("{:#}\n", serde_json::to_value(&report)?);
    write_whole(&out.join("distance.json"), text.as_bytes())?;
    let page_path = out.join("distance.html");
    write_whole(&page_path, page::page(&report).as_bytes())?;
    if let Some(path) = &arguments.write_curve {
        let curve = report.curve_file(arguments.curve_of)?;
        let text = format!("{:#}\n", serde_json::to_value(&curve)?);
        write_whole(path, text.as_bytes())?;
    }
    if arguments.json {
        println!("{}", serde_json::to_string(&report)?);
        return Ok(());
    }
    println!(
        "{} points in {}, on {}",
        report.points.len(),
        spoken(begun.elapsed().as_secs_f64()),
        report.adapter
    );
    for reach in &report.reaches {
        println!(
            "{}, {}, {}: {}",
            reach.view.name(),
            reach.direction.name(),
            reach.variant.name(),
            reach.told()
        );
    }
    println!("{}", page_path.display());
    Ok(())
}

/// What is kept of measured pictures, by a hash of all that they depend on.
#[derive(Default, Serialize, Deserialize)]
struct Kept(BTreeMap<String, ShownErrors>);

/// Renders and compares.
struct Bench {
    still: StillRenderer,
    size: FrameSize,
    kept: Kept,
    path: PathBuf,
    depends_on: [String; 3],
    progress: Progress,
}

fn measured(arguments: &DistanceArguments) -> anyhow::Result<DistanceReport> {
    let scene = read_scene(arguments.scene.as_deref())?.at_sky_s(0.0);
    let size = arguments.picture_size()?;
    let directions = asked(&Direction::ALL, &arguments.directions);
    let views = asked(&View::ALL, &arguments.views);
    let variants = asked(&Variant::ALL, &arguments.variants);
    let points = directions
        .iter()
        .map(|direction| direction.distances_m(arguments.quick).len())
        .sum::<usize>()
        * views.len()
        * variants.len();
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("--out {} cannot be made", arguments.out.display()))?;
    let folders = Folders::of(
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    );
    let config = RenderConfig {
        cache_memory_mib: CACHE_MEMORY_MIB,
        grids_dir: folders.grids.clone(),
        maps_dir: folders.grids.clone(),
        ..RenderConfig::new(folders.noise.clone())
    };
    let sun_azimuth_deg = scene.sun().azimuth_deg();
    let cameras = views
        .iter()
        .map(|view| {
            let yaw_deg = view.yaw_deg(sun_azimuth_deg);
            let camera = Camera::new([0.0, EYE_M, 0.0], yaw_deg, arguments.pitch_deg, FOV_DEG)
                .context("the camera (--pitch-deg)")?;
            Ok((*view, camera))
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    let still = StillRenderer::new(config, Arc::new(scene.clone()), &[])?;
    let path = arguments.out.join("measured.json");
    let mut bench = Bench {
        size,
        kept: kept(&path, arguments.fresh)?,
        path,
        depends_on: [
            serde_json::to_string(&scene.to_document())?,
            still.adapter(),
            version(),
        ],
        still,
        progress: Progress::new(points as u64, points as f64),
    };
    let fineness = arguments.fineness();
    let mut found = Vec::new();
    for (view, camera) in cameras {
        // Rendered when the first point needs it.
        let mut truth: Option<RgbImage> = None;
        for direction in &directions {
            for variant in &variants {
                for distance_m in direction.distances_m(arguments.quick) {
                    let offset_m = direction.offset_m(&camera, *distance_m);
                    let settings = fineness.cached(*variant, offset_m);
                    let label = format!(
                        "{}, {} {distance_m} m, {}",
                        view.name(),
                        direction.name(),
                        variant.name()
                    );
                    let exact = fineness.screen_space();
                    let errors = bench
                        .errors(&label, camera, &settings, &exact, &mut truth)
                        .with_context(|| label.clone())?;
                    found.push(DistancePoint {
                        view,
                        direction: *direction,
                        variant: *variant,
                        distance_m: *distance_m,
                        errors,
                    });
                }
            }
        }
    }
    bench.progress.finish();
    Ok(DistanceReport::new(
        bench.still.adapter(),
        size,
        fineness,
        arguments.pitch_deg,
        serde_json::to_value(scene.to_document())?,
        found,
    ))
}

fn kept(path: &Path, is_fresh: bool) -> anyhow::Result<Kept> {
    if is_fresh || !path.exists() {
        return Ok(Kept::default());
    }
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_slice(&bytes)
        .with_context(|| format!("{} is damaged; --fresh measures anew", path.display()))
}

impl Bench {
    fn errors(
        &mut self,
        label: &str,
        camera: Camera,
        settings: &StillSettings,
        exact: &StillSettings,
        truth: &mut Option<RgbImage>,
    ) -> anyhow::Result<ShownErrors> {
        self.progress.begin(label, 1.0);
        let parts = [
            serde_json::to_string(settings)?,
            serde_json::to_string(&camera)?,
            serde_json::to_string(&self.size)?,
        ];
        let parts: Vec<&str> = parts
            .iter()
            .chain(&self.depends_on)
            .map(String::as_str)
            .collect();
        let key = key_of(&parts);
        if let Some(errors) = self.kept.0.get(&key) {
            self.progress.done("is there");
            return Ok(*errors);
        }
        let truth = match truth {
            Some(truth) => truth,
            None => truth.insert(self.shown(camera, exact)?),
        };
        let errors = shown_errors(truth, &self.shown(camera, settings)?)?;
        ensure!(
            errors.flip.is_finite(),
            "a picture has values that are no numbers"
        );
        self.kept.0.insert(key, errors);
        write_whole(&self.path, &serde_json::to_vec(&self.kept)?)?;
        self.progress.done(&format!("FLIP {:.4}", errors.flip));
        Ok(errors)
    }

    fn shown(&mut self, camera: Camera, settings: &StillSettings) -> anyhow::Result<RgbImage> {
        let progress = &self.progress;
        let picture = self
            .still
            .render_with(camera, self.size, settings, |share| progress.share(share))?;
        let pixels = without_alpha(&picture.display);
        RgbImage::from_raw(self.size.width(), self.size.height(), pixels)
            .context("the device gave a picture of another size")
    }
}
