//! What `skycell-server measure` is asked for.

use super::ageing::AgeingArguments;
use super::codec::CodecArguments;
use super::distance::DistanceArguments;
use super::living::LivingArguments;
use super::metrics::COMPARED_SIDE_MIN;
use super::octaves::OctavesArguments;
use super::plan::{Axis, Extent};
use super::proxies::ProxiesArguments;
use super::reference::{ReferenceSource, TruthInputs};
use super::scaling::ScalingArguments;
use super::walk::WalkArguments;
use crate::render_command::{Folders, read_scene, triple};
use anyhow::Context;
use skycell_protocol::{Camera, FrameSize, Scene};
use std::path::PathBuf;

/// What to measure.
#[derive(Clone, Debug, clap::Args)]
pub struct MeasureArguments {
    /// Which measurement.
    #[command(subcommand)]
    pub what: Measurement,
}

/// Measurements.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Measurement {
    /// What each setting costs in time and in error: results.json, results.csv and report.html in the folder of --out.
    ///
    /// A run that was stopped goes on where it was when it is started again.
    #[command(
        after_help = "Example: skycell-server measure trade --quick --out trade && xdg-open trade/report.html"
    )]
    Trade(Box<TradeArguments>),
    /// A picture of every preset and of three views of the default scene, each beside the same by the reference renderer with
    /// its FLIP: pictures, gallery.json and README.md in the folder of --out.
    ///
    /// A run that was stopped goes on where it was when it is started again.
    #[command(
        after_help = "Examples:\n  skycell-server measure gallery --out docs/gallery\n  skycell-server measure gallery \
                      --size 192x108 --pair-size 96x54 --only haze,storm --out /tmp/gallery"
    )]
    Gallery(Box<GalleryArguments>),
    /// How the error of shared caches grows with the distance between a viewer and the reference point of its cell:
    /// distance.json and distance.html in the folder of --out.
    ///
    /// A run that was stopped goes on where it was when it is started again.
    #[command(
        after_help = "Example: skycell-server measure distance --quick --out distance && xdg-open distance/distance.html"
    )]
    Distance(Box<DistanceArguments>),
    /// Pictures in motion: an eye walks aside and climbs away from the reference of a cell while its texels stay. Frames of
    /// the cache and of rays of the eye's own, a sheet of both and walk.json with how differently they move, in the folder of
    /// --out.
    #[command(
        after_help = "Example: skycell-server measure walk --ways walk --variants phase,all --frames 16 --step-m 20 --out walk"
    )]
    Walk(Box<WalkArguments>),
    /// What many viewers cost: crowds of cameras that move for minutes, without a device, and viewers at one place, rendered:
    /// scaling.json and scaling.html in the folder of --out.
    #[command(
        after_help = "Examples:\n  skycell-server measure scaling --quick --out scaling && xdg-open scaling/scaling.html\n  \
                      skycell-server measure scaling --only crowds --crowd-viewers 1000 --motions fly"
    )]
    Scaling(Box<ScalingArguments>),
    /// The same figures for each setup of proxies: how far what a viewer beside the reference sees is from rays of its own, what
    /// is marched and kept for it.
    #[command(after_help = "Example: skycell-server measure proxies --size 160x90 --out proxies")]
    Proxies(Box<ProxiesArguments>),
    /// How fast cached texels age, by each cause: how far they are from fresh ones, and pictures from right ones, when the wind
    /// has blown, noise has risen, the sun has moved, clouds have become more, and nothing was marched: ageing.json in the
    /// folder of --out, beside the rates that caches reckon with.
    #[command(after_help = "Example: skycell-server measure ageing --quick --out ageing")]
    Ageing(Box<AgeingArguments>),
    /// What caches cost that live: viewers look around under wind for simulated minutes, and may walk together, texels are counted
    /// against the rays of a screen-space renderer for each, and pictures are compared with its: living.json in the folder of --out.
    #[command(
        after_help = "Examples:\n  skycell-server measure living --seconds 10 --size 96x54 --out living\n  skycell-server \
                      measure living --viewers 8 --spread-m 300 --walk-m-per-s 5 --beside-own-cells --texels-per-ray 2 \
                      --seconds 10 --fps 10 --pictures --out group"
    )]
    Living(Box<LivingArguments>),
    /// How far the light that clouds scatter more than once is from the path tracer's, over shapes from thin to thick.
    #[command(after_help = "Example: skycell-server measure octaves --fit")]
    Octaves(OctavesArguments),
    /// What compression takes from the picture while a view turns: H.264 at several rates, JPEG at several qualities, decoded
    /// and compared by FLIP with the picture before: codec.json and codec.html in the folder of --out.
    #[command(
        after_help = "Examples:\n  skycell-server measure codec --out codec && xdg-open codec/codec.html\n  skycell-server \
                      measure codec --sizes 320x180 --rates-kbit-per-s 500,1000 --seconds 1 --out codec"
    )]
    Codec(Box<CodecArguments>),
}

/// What `measure gallery` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct GalleryArguments {
    /// Folder of the pictures; what is there already is not made again.
    #[arg(long, default_value = "docs/gallery", value_name = "DIR")]
    pub out: PathBuf,
    /// Size of the pictures.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parsed_size, default_value = "1920x1080")]
    pub size: FrameSize,
    /// Steps through a layer's thickness in the pictures.
    #[arg(long, default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub picture_steps: u32,
    /// Rays a pixel of the pictures.
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub picture_samples: u32,
    /// Pictures alone: the references take longer than all else.
    #[arg(long)]
    pub without_pairs: bool,
    /// Size of the pictures that are compared. On two cores the reference takes from one minute to some ten for 96x54.
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parsed_size, default_value = "96x54")]
    pub pair_size: FrameSize,
    /// Only these pictures; all without.
    #[arg(long, value_delimiter = ',', value_name = "NAME,...")]
    pub only: Vec<String>,
    /// Folder in which reference pictures are kept in full precision [default: gallery in the noise's].
    #[arg(long, value_name = "DIR")]
    pub work: Option<PathBuf>,
    /// Make everything anew.
    #[arg(long)]
    pub fresh: bool,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print figures as JSON.
    #[arg(long)]
    pub json: bool,
}

/// What `measure trade` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct TradeArguments {
    /// Folder of the results; what is there already is not measured again.
    #[arg(long, default_value = "skycell-trade", value_name = "DIR")]
    pub out: PathBuf,
    /// Scene document; the default scene without it.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Size of the picture [default: 128x72 with --quick, else 640x360].
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = parsed_size)]
    pub size: Option<FrameSize>,
    /// Few points and a small picture: a minute on two cores.
    #[arg(long, conflicts_with = "full")]
    pub quick: bool,
    /// Fine sweeps, and the front until nothing changes: hours on a software driver.
    #[arg(long)]
    pub full: bool,
    /// Only these sweeps; all without.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "AXIS,...")]
    pub only: Vec<Axis>,
    /// Eye: x (east), altitude, z (south), metres.
    #[arg(long, value_delimiter = ',', num_args = 1, value_name = "X,Y,Z", default_values_t = [0.0, 2.0, 0.0], allow_negative_numbers = true)]
    pub position_m: Vec<f64>,
    /// Where the middle of the picture looks, clockwise from north.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub yaw_deg: f64,
    /// And above the horizon.
    #[arg(long, default_value_t = 15.0, allow_negative_numbers = true)]
    pub pitch_deg: f64,
    /// Vertical field of view.
    #[arg(long, default_value_t = 60.0)]
    pub fov_deg: f64,
    /// Seconds for which the wind has blown.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub time_s: f64,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// What pictures are measured against.
    #[arg(long, value_enum, default_value_t = ReferenceKind::ScreenSpace)]
    pub reference: ReferenceKind,
    /// Rays across and down a pixel of the converged reference, 1 to 16.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub reference_grid: u32,
    /// Relative change that counts as none when the converged reference halves its steps.
    #[arg(long, default_value_t = 1e-3)]
    pub tolerance: f64,
    /// Also measure against the path tracer, with so many paths a pixel: for small pictures.
    #[arg(long, value_name = "PATHS", value_parser = clap::value_parser!(u64).range(16..=1_000_000))]
    pub path_traced: Option<u64>,
    /// Rounds of the search along the front, 0 to 64; 0 measures only where it starts: the points that presets are made of.
    #[arg(long, value_parser = clap::value_parser!(u32).range(0..=64))]
    pub front_rounds: Option<u32>,
    /// Measure everything anew, whatever is in the folder.
    #[arg(long)]
    pub fresh: bool,
    /// Write the quality points that a server picks from here.
    #[arg(long, value_name = "FILE")]
    pub write_quality: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// What pictures are measured against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ReferenceKind {
    /// The screen-space renderer, finer than all that is swept.
    ScreenSpace,
    /// The same model on the processor in f64, steps halved until nothing changes: hours for a large picture.
    Converged,
}

pub(super) fn parsed_size(text: &str) -> Result<FrameSize, String> {
    let allowed = "allowed: WIDTHxHEIGHT such as 640x360, from 11x11 to 3840x2160";
    let numbers = text
        .split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    let size = numbers.and_then(|(w, h)| FrameSize::new(w, h).ok());
    size.filter(|s| s.width().min(s.height()) >= COMPARED_SIDE_MIN)
        .ok_or_else(|| allowed.to_owned())
}

pub(super) fn parsed_metres(text: &str) -> Result<f64, String> {
    let metres = text.parse::<f64>().ok();
    metres
        .filter(|m| (0.0..=1e6).contains(m))
        .ok_or_else(|| "allowed: 0 to 1000000 m".to_owned())
}

impl TradeArguments {
    /// How much is measured.
    #[must_use]
    pub fn extent(&self) -> Extent {
        match (self.quick, self.full) {
            (true, _) => Extent::Quick,
            (_, true) => Extent::Full,
            _ => Extent::Default,
        }
    }

    /// Of the shown picture.
    ///
    /// # Errors
    /// Never: the sizes that are not the user's are allowed ones.
    pub fn picture_size(&self) -> anyhow::Result<FrameSize> {
        match self.size {
            Some(size) => Ok(size),
            None if self.quick => Ok(FrameSize::new(128, 72)?),
            None => Ok(FrameSize::new(640, 360)?),
        }
    }

    /// Where the eye is.
    ///
    /// # Errors
    /// Names the number that is not allowed.
    pub fn camera(&self) -> anyhow::Result<Camera> {
        Camera::new(
            triple(&self.position_m)?,
            self.yaw_deg,
            self.pitch_deg,
            self.fov_deg,
        )
        .context("the camera (--position-m, --yaw-deg, --pitch-deg, --fov-deg)")
    }

    /// The scene.
    ///
    /// # Errors
    /// When its file cannot be read or holds no scene.
    pub fn read_scene(&self) -> anyhow::Result<Scene> {
        read_scene(self.scene.as_deref()).map(|scene| scene.at_sky_s(self.time_s))
    }

    /// What the f64 renderers need; where data lie.
    #[must_use]
    pub fn truth_inputs(&self, scene: &Scene) -> TruthInputs {
        let folders = Folders::of(self.scene.as_deref(), self.noise_cache_dir.as_ref());
        TruthInputs {
            scene: scene.clone(),
            noise_dir: folders.noise,
            grids_dir: folders.grids,
            time_s: self.time_s,
        }
    }

    /// What pictures are measured against.
    #[must_use]
    pub fn reference_source(&self, camera: &Camera) -> ReferenceSource {
        match self.reference {
            ReferenceKind::ScreenSpace => {
                ReferenceSource::screen_space(camera, self.extent().reference_fineness())
            }
            ReferenceKind::Converged => ReferenceSource::Converged {
                grid: self.reference_grid,
                tolerance: self.tolerance,
            },
        }
    }

    /// The sweeps, in the report's order.
    #[must_use]
    pub fn axes(&self) -> Vec<Axis> {
        let asked = |axis: &Axis| self.only.is_empty() || self.only.contains(axis);
        Axis::ALL.into_iter().filter(asked).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        measure: MeasureArguments,
    }

    fn parsed(arguments: &[&str]) -> Result<TradeArguments, String> {
        let all = ["measure", "trade"].iter().chain(arguments);
        let cli = Cli::try_parse_from(all).map_err(|error| error.to_string())?;
        let Measurement::Trade(trade) = cli.measure.what else {
            return Err("no trade".into());
        };
        Ok(*trade)
    }

    #[test]
    fn wrong_values_are_refused_with_field_value_and_what_is_allowed() {
        for (arguments, said) in [
            (
                ["--only", "steps,colour"],
                ["--only", "colour", "sun-steps"],
            ),
            (["--size", "10x400"], ["--size", "10x400", "11x11"]),
            (["--size", "big"], ["--size", "big", "WIDTHxHEIGHT"]),
        ] {
            let refused = parsed(&arguments).expect_err("refused");
            assert!(said.iter().all(|word| refused.contains(word)), "{refused}");
        }
        let camera = parsed(&["--fov-deg", "180"])
            .expect("parsed")
            .camera()
            .expect_err("refused");
        assert!(format!("{camera:#}").contains("180"), "{camera:#}");
    }

    #[test]
    fn axes_keep_the_order_of_the_report() {
        let trade = parsed(&["--only", "codec,steps"]).expect("parsed");
        assert_eq!(trade.axes(), [Axis::Steps, Axis::Codec]);
        assert_eq!(parsed(&[]).expect("parsed").axes(), Axis::ALL);
    }
}
