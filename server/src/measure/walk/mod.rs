//! `skycell-server measure walk`: pictures in motion. Stills do not show what swims or pops.
//!
//! An eye leaves the reference point of its cell while the texels stay, and each frame is rendered from the cache and by
//! rays of its own. `motion` tells how the one sequence moves beside the other.

pub mod motion;

use super::animation::side_by_side;
use super::arguments::parsed_size;
use super::distance::plan::{Fineness, Variant};
use super::distance::{rgb_of, still_of};
use super::progress::{Progress, spoken};
use super::sheet::sheet;
use super::store::{write_json, write_whole};
use crate::frame_loop::{FrameCosts, StillFrame, StillRenderer};
use crate::render_command::read_scene;
use anyhow::Context;
use glam::DVec3;
use image::RgbImage;
use motion::Motion;
use serde::{Deserialize, Serialize};
use skycell_protocol::{Camera, FrameSize};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Height of the eye where a walk begins, m.
const EYE_M: f64 = 2.0;
/// Vertical field of view, degrees.
const FOV_DEG: f64 = 60.0;

/// Which way the eye goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Way {
    /// To the right.
    Walk,
    /// Upwards.
    Climb,
}

impl Way {
    /// Both.
    const ALL: [Self; 2] = [Self::Walk, Self::Climb];

    /// As files are named.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Walk => "walk",
            Self::Climb => "climb",
        }
    }

    fn direction(self, camera: &Camera) -> DVec3 {
        match self {
            Self::Walk => camera.right(),
            Self::Climb => DVec3::Y,
        }
    }
}

/// What `measure walk` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct WalkArguments {
    /// Folder of frames, sheets, animated PNGs (own rays beside each variant) and walk.json.
    #[arg(long, default_value = "skycell-walk", value_name = "DIR")]
    pub out: PathBuf,
    /// Scene document; the default scene without it. The wind stands still.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Size of the pictures.
    #[arg(long, default_value = "320x180", value_name = "WIDTHxHEIGHT", value_parser = parsed_size)]
    pub size: FrameSize,
    /// Steps through a layer's thickness.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub steps: u32,
    /// Samples of a pixel and of a texel.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub samples: u32,
    /// Only these ways; both without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "WAY,...")]
    pub ways: Vec<Way>,
    /// Ways to read the cache.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "VARIANT,...", default_values_t = [Variant::Phase, Variant::Parallax, Variant::All])]
    pub variants: Vec<Variant>,
    /// Frames of a sequence, the one at the reference among them.
    #[arg(long, default_value_t = 61, value_parser = clap::value_parser!(u32).range(3..=2000))]
    pub frames: u32,
    /// Frames a second of the animations.
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u16).range(1..=60))]
    pub fps: u16,
    /// How far the eye is from the reference in the first frame, m.
    #[arg(long, default_value_t = 0.0, value_parser = super::arguments::parsed_metres)]
    pub from_m: f64,
    /// How far it goes from frame to frame, m.
    #[arg(long, default_value_t = 5.0, value_parser = super::arguments::parsed_metres)]
    pub step_m: f64,
    /// Where the middle of the pictures looks, clockwise from north [default: away from the sun].
    #[arg(long, allow_negative_numbers = true)]
    pub yaw_deg: Option<f64>,
    /// Where it looks above the horizon.
    #[arg(long, default_value_t = 20.0, allow_negative_numbers = true)]
    pub pitch_deg: f64,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
}

/// A sequence of one variant beside that of the eye's own rays.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sequence {
    /// Which way the eye went.
    pub way: Way,
    /// How the cache was read.
    pub variant: Variant,
    /// How it moved.
    #[serde(flatten)]
    pub motion: Motion,
}

/// All that is reported.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WalkReport {
    /// What rendered.
    pub adapter: String,
    /// Of the pictures.
    pub size: FrameSize,
    /// Steps through a layer's thickness.
    pub steps: u32,
    /// Samples of a texel and of a pixel.
    pub samples: u32,
    /// How far the eye was from the reference in each frame, m.
    pub distances_m: Vec<f64>,
    /// Every sequence.
    pub sequences: Vec<Sequence>,
}

/// Renders, compares and writes.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, an impossible camera, a missing device.
pub(super) fn run(arguments: &WalkArguments) -> anyhow::Result<()> {
    let begun = Instant::now();
    let scene = read_scene(arguments.scene.as_deref())?.at_sky_s(0.0);
    let still = still_of(
        &scene,
        arguments.scene.as_deref(),
        arguments.noise_cache_dir.as_ref(),
    )?;
    let ways = match arguments.ways.is_empty() {
        true => Way::ALL.to_vec(),
        false => arguments.ways.clone(),
    };
    let yaw_deg = arguments
        .yaw_deg
        .unwrap_or((scene.sun().azimuth_deg() + 180.0) % 360.0);
    let sequences = (ways.len() * (arguments.variants.len() + 1)) as u64;
    let mut walker = Walker {
        still,
        arguments,
        fineness: Fineness {
            steps: arguments.steps,
            samples: arguments.samples,
        },
        progress: Progress::new(sequences, sequences as f64),
    };
    let mut found = Vec::new();
    for way in ways {
        let cameras = cameras(arguments, way, yaw_deg)?;
        let own = walker.own_rays(way, &cameras)?;
        let mut rows = vec![("own rays".to_owned(), own.clone())];
        for variant in &arguments.variants {
            let seen = walker.cached(way, *variant, &cameras)?;
            found.push(Sequence {
                way,
                variant: *variant,
                motion: Motion::of(&own, &seen)?,
            });
            let animation = side_by_side(&own, &seen, arguments.fps)?;
            let name = format!("{}-{}.png", way.name(), variant.file_name()?);
            write_whole(&arguments.out.join(name), &animation)?;
            rows.push((variant.name().to_owned(), seen));
        }
        let sheet = sheet(&rows)?;
        write_whole(&arguments.out.join(format!("{}.jpg", way.name())), &sheet)?;
    }
    walker.progress.finish();
    let report = WalkReport {
        adapter: walker.still.adapter(),
        size: arguments.size,
        steps: arguments.steps,
        samples: arguments.samples,
        distances_m: (0..arguments.frames)
            .map(|frame| arguments.from_m + f64::from(frame) * arguments.step_m)
            .collect(),
        sequences: found,
    };
    write_json(&arguments.out.join("walk.json"), &report)?;
    if arguments.json {
        println!("{}", serde_json::to_string(&report)?);
        return Ok(());
    }
    println!(
        "{} sequences of {} frames in {}, on {}",
        report.sequences.len(),
        arguments.frames,
        spoken(begun.elapsed().as_secs_f64()),
        report.adapter
    );
    for sequence in &report.sequences {
        println!(
            "{}, {}: {}",
            sequence.way.name(),
            sequence.variant.name(),
            sequence.motion.told()
        );
    }
    println!("{}", arguments.out.display());
    Ok(())
}

/// From the reference on. The first eye that renders stands at the reference, whatever `--from-m` says.
fn cameras(arguments: &WalkArguments, way: Way, yaw_deg: f64) -> anyhow::Result<Vec<Camera>> {
    let at = |distance_m: f64| {
        let origin = DVec3::new(0.0, EYE_M, 0.0);
        let pitch_deg = arguments.pitch_deg;
        let first = Camera::new(origin.to_array(), yaw_deg, pitch_deg, FOV_DEG)
            .context("the camera (--yaw-deg, --pitch-deg)")?;
        let place = origin + way.direction(&first) * distance_m;
        Camera::new(place.to_array(), yaw_deg, pitch_deg, FOV_DEG)
            .context("the camera (--from-m, --step-m, --frames)")
    };
    (0..arguments.frames)
        .map(|frame| at(arguments.from_m + f64::from(frame) * arguments.step_m))
        .collect()
}

struct Walker<'a> {
    still: StillRenderer,
    arguments: &'a WalkArguments,
    fineness: Fineness,
    progress: Progress,
}

impl Walker<'_> {
    /// Every frame by rays of the eye's own.
    fn own_rays(&mut self, way: Way, cameras: &[Camera]) -> anyhow::Result<Vec<RgbImage>> {
        let label = format!("{}, own rays", way.name());
        self.progress.begin(&label, 1.0);
        let settings = self.fineness.screen_space();
        let size = self.arguments.size;
        let mut pictures = Vec::new();
        for (index, camera) in cameras.iter().enumerate() {
            let made = self
                .still
                .render_with(*camera, size, &settings, |_| {})
                .with_context(|| label.clone())?;
            pictures.push(rgb_of(size, &made.display)?);
            self.progress
                .share((index + 1) as f64 / cameras.len() as f64);
        }
        self.write(way, "own-rays", &pictures)?;
        self.progress.done("rendered");
        Ok(pictures)
    }

    /// Every frame from the texels of the first eye's place.
    fn cached(
        &mut self,
        way: Way,
        variant: Variant,
        cameras: &[Camera],
    ) -> anyhow::Result<Vec<RgbImage>> {
        let label = format!("{}, {}", way.name(), variant.name());
        self.progress.begin(&label, 1.0);
        let size = self.arguments.size;
        let frames: Vec<StillFrame> = cameras
            .iter()
            .map(|camera| StillFrame {
                camera: *camera,
                parallax_steps: variant.parallax_steps(),
                phase_of_reference: variant == Variant::Plain,
            })
            .collect();
        let back_m = cameras
            .first()
            .map_or(DVec3::ZERO, |first| way.direction(first))
            * -self.arguments.from_m;
        let settings = self.fineness.cached(variant, back_m);
        let mut pictures = Vec::new();
        let (progress, count) = (&self.progress, frames.len() as f64);
        self.still
            .render_frames(
                size,
                &settings,
                &frames,
                FrameCosts::default(),
                |index, display, _| {
                    pictures.push(display);
                    progress.share((index + 1) as f64 / count);
                    Ok(())
                },
            )
            .with_context(|| label.clone())?;
        let pictures = pictures
            .iter()
            .map(|display| rgb_of(size, display))
            .collect::<anyhow::Result<Vec<_>>>()?;
        self.write(way, &variant.file_name()?, &pictures)?;
        self.progress.done("rendered");
        Ok(pictures)
    }

    fn write(&self, way: Way, name: &str, pictures: &[RgbImage]) -> anyhow::Result<()> {
        let folder = self.arguments.out.join(format!("{}-{name}", way.name()));
        std::fs::create_dir_all(&folder)
            .with_context(|| format!("--out {} cannot be made", folder.display()))?;
        for (index, picture) in pictures.iter().enumerate() {
            let path: &Path = &folder.join(format!("{index:04}.png"));
            picture
                .save(path)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }
}
