//! `skycell-server measure distance`: the error of a shared cache over the distance from its reference point.
//!
//! `plan` says what is rendered, `report` what comes of it, `page` how it is shown.

mod page;
pub mod plan;
pub mod report;

use super::arguments::{parsed_metres, parsed_size};
use super::metrics::{ShownErrors, shown_errors};
use super::progress::{Progress, spoken};
use super::reference::without_alpha;
use super::store::{key_of, write_json, write_whole};
use super::trade::version;
use crate::frame_loop::{FrameCosts, FrameFigures, StillFrame, StillRenderer, StillSettings};
use crate::render_command::{Folders, read_scene};
use anyhow::{Context, ensure};
use image::RgbImage;
use plan::{Direction, Fineness, Variant, View};
use report::{DistancePoint, DistanceReport};
use serde::{Deserialize, Serialize};
use skycell_protocol::{Camera, FrameSize, Scene};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// GPU memory for the cache: a picture of 1920×1080 at full resolution.
const CACHE_MEMORY_MIB: u32 = 2048;
/// Height of the eye, m.
const EYE_M: f64 = 2.0;
/// Times that a picture is composited to find out what that costs.
const TIMED: u32 = 5;
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
    /// Only these distances, m, from small to large; those of the direction without. Upwards those are left out that are in or above a
    /// layer.
    #[arg(long, value_delimiter = ',', value_name = "M,...", value_parser = parsed_metres)]
    pub distances_m: Vec<f64>,
    /// Only these views; both without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "VIEW,...")]
    pub views: Vec<View>,
    /// Only these ways to read the cache [default: plain, phase, parallax, slabs, all; with --write-curve every one].
    #[arg(long, value_enum, value_delimiter = ',', value_name = "VARIANT,...")]
    pub variants: Vec<Variant>,
    /// Where the middle of the pictures looks above the horizon.
    #[arg(long, default_value_t = 20.0, allow_negative_numbers = true)]
    pub pitch_deg: f64,
    /// Write the curves that the limit of cells follows from here: of the variants but for plain.
    #[arg(long, value_name = "FILE")]
    pub write_curve: Option<PathBuf>,
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

    fn distances_m(&self, direction: Direction, scene: &Scene) -> Vec<f64> {
        let asked_m = match &self.distances_m[..] {
            [] => direction.distances_m(self.quick),
            asked_m => asked_m,
        };
        direction.shared_m(scene, EYE_M, asked_m)
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
pub(super) fn asked<T: Copy + PartialEq>(all: &[T], asked: &[T]) -> Vec<T> {
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
    write_json(&out.join("distance.json"), &report)?;
    let page_path = out.join("distance.html");
    write_whole(&page_path, page::page(&report).as_bytes())?;
    if let Some(path) = &arguments.write_curve {
        let curve = report.curve_file()?;
        write_json(path, &curve)?;
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
struct Kept(BTreeMap<String, Measured>);

/// What was measured of one picture.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Measured {
    errors: ShownErrors,
    figures: FrameFigures,
}

/// Renders and compares.
struct Bench {
    still: StillRenderer,
    size: FrameSize,
    fineness: Fineness,
    kept: Kept,
    path: PathBuf,
    depends_on: [String; 3],
    progress: Progress,
}

/// Where a reference stands, seen from an eye.
struct Place {
    view: View,
    camera: Camera,
    direction: Direction,
    distance_m: f64,
}

fn measured(arguments: &DistanceArguments) -> anyhow::Result<DistanceReport> {
    let scene = read_scene(arguments.scene.as_deref())?.at_sky_s(0.0);
    let size = arguments.picture_size()?;
    let directions = asked(&Direction::ALL, &arguments.directions);
    let views = asked(&View::ALL, &arguments.views);
    let variants = match (arguments.variants.is_empty(), &arguments.write_curve) {
        (true, None) => Variant::COMPARED.to_vec(),
        _ => asked(&Variant::ALL, &arguments.variants),
    };
    let points = directions
        .iter()
        .map(|direction| arguments.distances_m(*direction, &scene).len())
        .sum::<usize>()
        * views.len()
        * variants.len();
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("--out {} cannot be made", arguments.out.display()))?;
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
    let still = still_of(
        &scene,
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    )?;
    let path = arguments.out.join("measured.json");
    let mut bench = Bench {
        size,
        fineness: arguments.fineness(),
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
    let mut found = Vec::new();
    for (view, camera) in cameras {
        // Rendered when the first point needs it.
        let mut truth: Option<RgbImage> = None;
        for direction in &directions {
            for distance_m in arguments.distances_m(*direction, &scene) {
                let place = Place {
                    view,
                    camera,
                    direction: *direction,
                    distance_m,
                };
                // Variants of as many slabs read the same texels.
                for slabs in 1..=4 {
                    let alike: Vec<Variant> = variants
                        .iter()
                        .copied()
                        .filter(|variant| variant.slabs() == slabs)
                        .collect();
                    found.extend(bench.points(&place, &alike, &mut truth)?);
                }
            }
        }
    }
    bench.progress.finish();
    let order = |p: &DistancePoint| (p.view, p.direction, p.variant);
    found.sort_by(|a, b| {
        let by_distance = a.distance_m.total_cmp(&b.distance_m);
        order(a).cmp(&order(b)).then(by_distance)
    });
    Ok(DistanceReport::new(
        bench.still.adapter(),
        size,
        bench.fineness,
        arguments.pitch_deg,
        serde_json::to_value(scene.to_document())?,
        found,
    ))
}

/// A renderer of one scene in calm air.
pub(super) fn still_of(
    scene: &Scene,
    file: Option<&Path>,
    noise_cache_dir: Option<&PathBuf>,
) -> anyhow::Result<StillRenderer> {
    let folders = Folders::of(file, noise_cache_dir);
    let config = folders.render_config(CACHE_MEMORY_MIB);
    Ok(StillRenderer::new(config, Arc::new(scene.clone()), &[])?)
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
    /// Measures variants that read the same texels.
    fn points(
        &mut self,
        place: &Place,
        variants: &[Variant],
        truth: &mut Option<RgbImage>,
    ) -> anyhow::Result<Vec<DistancePoint>> {
        let offset_m = place.direction.offset_m(&place.camera, place.distance_m);
        let settings = |variant: Variant| self.fineness.cached(variant, offset_m);
        let keys = variants
            .iter()
            .map(|variant| Ok((*variant, self.key(&place.camera, &settings(*variant))?)))
            .collect::<anyhow::Result<Vec<(Variant, String)>>>()?;
        let missing: Vec<&(Variant, String)> = keys
            .iter()
            .filter(|(_, key)| !self.kept.0.contains_key(key))
            .collect();
        if let Some((first, _)) = missing.first() {
            self.progress.begin(&label(place, *first), 1.0);
            let wanted: Vec<Variant> = missing.iter().map(|(variant, _)| *variant).collect();
            let pictures = self
                .pictures(place, &wanted, settings(*first))
                .with_context(|| label(place, *first))?;
            let truth = match truth {
                Some(truth) => truth,
                None => truth.insert(self.own_rays(place.camera)?),
            };
            for ((_, key), (picture, figures)) in missing.iter().zip(pictures) {
                let errors = shown_errors(truth, &picture)?;
                ensure!(
                    errors.flip.is_finite(),
                    "a picture has values that are no numbers"
                );
                self.kept
                    .0
                    .insert(key.clone(), Measured { errors, figures });
            }
            write_whole(&self.path, &serde_json::to_vec(&self.kept)?)?;
        }
        let mut found = Vec::new();
        for (variant, key) in &keys {
            let Some(Measured { errors, figures }) = self.kept.0.get(key) else {
                continue;
            };
            let is_new = missing.iter().any(|(one, _)| one == variant);
            if !is_new {
                self.progress.begin(&label(place, *variant), 1.0);
            }
            let told = format!("FLIP {:.4}", errors.flip);
            self.progress.done(if is_new { &told } else { "is there" });
            found.push(DistancePoint {
                view: place.view,
                direction: place.direction,
                variant: *variant,
                distance_m: place.distance_m,
                errors: *errors,
                figures: *figures,
            });
        }
        Ok(found)
    }

    fn key(&self, camera: &Camera, settings: &StillSettings) -> anyhow::Result<String> {
        let parts = [
            serde_json::to_string(settings)?,
            serde_json::to_string(camera)?,
            serde_json::to_string(&self.size)?,
        ];
        let parts: Vec<&str> = parts
            .iter()
            .chain(&self.depends_on)
            .map(String::as_str)
            .collect();
        Ok(key_of(&parts))
    }

    /// What variants show. Costs are looked at where they are compared.
    fn pictures(
        &mut self,
        place: &Place,
        variants: &[Variant],
        settings: StillSettings,
    ) -> anyhow::Result<Vec<(RgbImage, FrameFigures)>> {
        let frames: Vec<StillFrame> = variants
            .iter()
            .map(|variant| StillFrame {
                camera: place.camera,
                parallax_steps: variant.parallax_steps(),
                phase_of_reference: *variant == Variant::Plain,
            })
            .collect();
        let is_compared = place.distance_m == place.direction.compared_at_m();
        let costs = FrameCosts {
            timed: if is_compared { TIMED } else { 0 },
            counts_reads: is_compared,
        };
        let mut pictures = Vec::new();
        self.still.render_frames(
            self.size,
            &settings,
            &frames,
            costs,
            |_, display, figures| {
                pictures.push((display, figures));
                Ok(())
            },
        )?;
        pictures
            .into_iter()
            .map(|(display, figures)| Ok((rgb_of(self.size, &display)?, figures)))
            .collect()
    }

    fn own_rays(&mut self, camera: Camera) -> anyhow::Result<RgbImage> {
        let settings = self.fineness.screen_space();
        let picture = self
            .still
            .render_with(camera, self.size, &settings, |_| {})?;
        rgb_of(self.size, &picture.display)
    }
}

fn label(place: &Place, variant: Variant) -> String {
    format!(
        "{}, {} {} m, {}",
        place.view.name(),
        place.direction.name(),
        place.distance_m,
        variant.name()
    )
}

/// A picture of 4 bytes a pixel without its alpha.
pub(super) fn rgb_of(size: FrameSize, display: &[u8]) -> anyhow::Result<RgbImage> {
    RgbImage::from_raw(size.width(), size.height(), without_alpha(display))
        .context("the device gave a picture of another size")
}
