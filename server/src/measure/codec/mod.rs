//! `skycell-server measure codec`: what compression takes from the picture while a view turns (Weinrauch et al. 2023, 6.8).
//!
//! A camera turns within a cache that was marched once. Each picture goes through every encoder under study, as a viewer's
//! would, is decoded, and is compared with the picture before compression, which is the one that
//! viewers of PNG get.

mod page;
mod streams;

use super::arguments::parsed_size;
use super::distance::still_of;
use super::progress::{Progress, spoken};
use super::store::{write_json, write_whole};
use crate::encode::video::{KBIT_PER_S_MAX, KBIT_PER_S_MIN};
use crate::frame_loop::{FrameCosts, StillFrame, StillSettings};
use crate::march::MarchSettings;
use crate::render_command::{read_scene, triple};
use anyhow::{Context, ensure};
use serde::Serialize;
use skycell_protocol::{Camera, Codec, FrameSize};
use std::path::PathBuf;
use std::time::Instant;
use streams::Studied;

/// The mean FLIP that an H.264 stream of 8 Mbit/s and 1280 x 720 is to stay below.
const FLIP_MAX: f64 = 0.02;
/// The stream that it is about.
const BAR: ([u32; 2], u32) = ([1280, 720], 8_000);

/// What `measure codec` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct CodecArguments {
    /// Folder of codec.json and codec.html.
    #[arg(long, default_value = "skycell-codec", value_name = "DIR")]
    pub out: PathBuf,
    /// Scene document; the default scene without it. The wind stands still.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Sizes of the pictures.
    #[arg(long, value_name = "WIDTHxHEIGHT,...", value_delimiter = ',', value_parser = parsed_size, default_values = ["1280x720", "1920x1080"])]
    pub sizes: Vec<FrameSize>,
    /// Rates of H.264 streams, kbit/s.
    #[arg(long, value_name = "KBIT_PER_S,...", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(i64::from(KBIT_PER_S_MIN)..=i64::from(KBIT_PER_S_MAX)), default_values_t = [4_000, 8_000, 16_000, 25_000])]
    pub rates_kbit_per_s: Vec<u32>,
    /// Qualities of JPEG pictures.
    #[arg(long, value_name = "QUALITY,...", value_delimiter = ',', value_parser = clap::value_parser!(u8).range(1..=100), default_values_t = [50, 70, 85, 95])]
    pub jpeg_qualities: Vec<u8>,
    /// How long the view turns.
    #[arg(long, default_value_t = 3.0, value_parser = parsed_seconds)]
    pub seconds: f64,
    /// Pictures a second.
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=60))]
    pub fps: u32,
    /// How fast the view turns to the right, degrees a second.
    #[arg(long, default_value_t = 10.0, allow_negative_numbers = true)]
    pub turn_deg_per_s: f64,
    /// Pictures are compared this often: FLIP takes longer than all else.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub compared_every: u32,
    /// Eye: x (east), altitude, z (south), metres.
    #[arg(long, value_delimiter = ',', num_args = 1, value_name = "X,Y,Z", default_values_t = [0.0, 2.0, 0.0], allow_negative_numbers = true)]
    pub position_m: Vec<f64>,
    /// Where the middle of the first picture looks, clockwise from north.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    pub yaw_deg: f64,
    /// And above the horizon.
    #[arg(long, default_value_t = 15.0, allow_negative_numbers = true)]
    pub pitch_deg: f64,
    /// Vertical field of view.
    #[arg(long, default_value_t = 60.0)]
    pub fov_deg: f64,
    /// Steps through a layer's thickness.
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub steps: u32,
    /// Samples of a texel.
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=16))]
    pub samples: u32,
    /// Folder in which noise is kept.
    #[arg(long, env = "SKYCELL_CACHE_DIR")]
    pub noise_cache_dir: Option<PathBuf>,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
}

/// What a picture goes through.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compression {
    /// A stream of so many kbit/s, its colours spread, for who puts them back.
    H264(u32),
    /// The same with colours that any player shows.
    PlainH264(u32),
    /// Pictures of such a quality.
    Jpeg(u8),
    /// Nothing but the colours of a video: 8 bits of brightness a pixel, of colour for each 2 x 2. No video of that kind is
    /// closer.
    PlainColours,
    /// The same with colours spread.
    Colours,
}

impl Compression {
    /// For people.
    fn name(self) -> String {
        match self {
            Self::H264(kbit_per_s) => format!("H.264 at {} Mbit/s", f64::from(kbit_per_s) / 1000.0),
            Self::PlainH264(kbit_per_s) => {
                format!("H.264 at {} Mbit/s, plain", f64::from(kbit_per_s) / 1000.0)
            }
            Self::Jpeg(quality) => format!("JPEG {quality}"),
            Self::Colours => "colours of a video, not compressed".to_owned(),
            Self::PlainColours => "plain colours of a video, not compressed".to_owned(),
        }
    }
}

/// What one compression did to the pictures of one size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CodecPoint {
    /// Of the pictures.
    pub size: FrameSize,
    /// What they went through.
    pub compression: Compression,
    /// What the line would carry.
    pub mbit_per_s: f64,
    /// The largest picture, bytes.
    pub largest_bytes: usize,
    /// Mean FLIP of the compared pictures.
    pub flip: f64,
    /// That of the worst of them.
    pub flip_worst: f64,
    /// Mean SSIM of the compared pictures.
    pub ssim: f64,
    /// Peak signal to noise of all three channels, dB, of the mean square over the compared pictures.
    pub psnr_db: f64,
    /// Clock time of a picture's encoding, the median, ms.
    pub encode_ms: f64,
    /// How many pictures were compared.
    pub compared: u32,
}

/// All that is reported.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CodecReport {
    /// What rendered.
    pub adapter: String,
    /// Pictures of each stream.
    pub frames: u32,
    /// Pictures a second.
    pub fps: u32,
    /// How fast the view turned.
    pub turn_deg_per_s: f64,
    /// Steps through a layer's thickness.
    pub steps: u32,
    /// Samples of a texel.
    pub samples: u32,
    /// Every compression of every size.
    pub points: Vec<CodecPoint>,
    /// Whether H.264 at 8 Mbit/s and 1280 x 720 stays below a mean FLIP of 0.02; null where it was not measured.
    pub bar_is_met: Option<bool>,
}

impl CodecReport {
    fn new(adapter: String, arguments: &CodecArguments, points: Vec<CodecPoint>) -> Self {
        let ([width, height], kbit_per_s) = BAR;
        let at_bar = points.iter().find(|point| {
            (point.size.width(), point.size.height()) == (width, height)
                && point.compression == Compression::H264(kbit_per_s)
        });
        Self {
            adapter,
            frames: arguments.frames(),
            fps: arguments.fps,
            turn_deg_per_s: arguments.turn_deg_per_s,
            steps: arguments.steps,
            samples: arguments.samples,
            bar_is_met: at_bar.map(|point| point.flip <= FLIP_MAX),
            points,
        }
    }
}

fn parsed_seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok();
    seconds
        .filter(|s| (0.1..=600.0).contains(s))
        .ok_or_else(|| "allowed: 0.1 to 600 s".to_owned())
}

impl CodecArguments {
    fn frames(&self) -> u32 {
        (self.seconds * f64::from(self.fps)).round().max(2.0) as u32
    }

    fn cameras(&self) -> anyhow::Result<Vec<StillFrame>> {
        ensure!(
            self.turn_deg_per_s.abs() <= 360.0,
            "--turn-deg-per-s is {}; allowed: -360 to 360",
            self.turn_deg_per_s
        );
        let position_m = triple(&self.position_m)?;
        (0..self.frames())
            .map(|frame| {
                let turned_deg = self.turn_deg_per_s * f64::from(frame) / f64::from(self.fps);
                let yaw_deg = self.yaw_deg + turned_deg;
                let camera = Camera::new(position_m, yaw_deg, self.pitch_deg, self.fov_deg)
                    .context("the camera (--position-m, --yaw-deg, --pitch-deg, --fov-deg)")?;
                Ok(StillFrame {
                    camera,
                    parallax_steps: 0,
                    phase_of_reference: false,
                })
            })
            .collect()
    }

    fn compressions(&self) -> Vec<Compression> {
        let rates = self.rates_kbit_per_s.iter().copied();
        let qualities = self.jpeg_qualities.iter().copied().map(Compression::Jpeg);
        rates
            .clone()
            .map(Compression::H264)
            .chain(rates.map(Compression::PlainH264))
            .chain(qualities)
            .chain([Compression::Colours, Compression::PlainColours])
            .collect()
    }
}

/// Renders, compresses, compares and writes.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, an impossible camera, a missing device, a codec that refuses.
pub(super) fn run(arguments: &CodecArguments) -> anyhow::Result<()> {
    let begun = Instant::now();
    let frames = arguments.cameras()?;
    let out = &arguments.out;
    std::fs::create_dir_all(out)
        .with_context(|| format!("the folder {} cannot be made (--out)", out.display()))?;
    let scene = read_scene(arguments.scene.as_deref())?.at_sky_s(0.0);
    let noise = arguments.noise_cache_dir.as_ref();
    let mut still = still_of(&scene, arguments.scene.as_deref(), noise)?;
    let settings = StillSettings {
        march: MarchSettings {
            steps: arguments.steps,
            ..MarchSettings::default()
        },
        samples: arguments.samples,
        // What all are compared with.
        codec: Codec::Png,
        ..StillSettings::default()
    };
    let work = |size: &FrameSize| f64::from(size.pixels());
    let mut progress = Progress::new(
        arguments.sizes.len() as u64,
        arguments.sizes.iter().map(work).sum(),
    );
    let mut points = Vec::new();
    for size in &arguments.sizes {
        let label = format!("{}x{}", size.width(), size.height());
        progress.begin(&label, work(size));
        let mut studied = arguments
            .compressions()
            .into_iter()
            .map(|compression| Studied::new(compression, *size, arguments.fps))
            .collect::<Result<Vec<_>, _>>()?;
        let mut failed = None;
        let costs = FrameCosts::default();
        let rendered =
            still.render_frames(*size, &settings, &frames, costs, |index, display, _| {
                let is_compared = ((index + 1) as u32).is_multiple_of(arguments.compared_every)
                    || index + 1 == frames.len();
                let taken = studied
                    .iter_mut()
                    .try_for_each(|one| one.take(&display, is_compared));
                progress.share((index + 1) as f64 / frames.len() as f64);
                taken.map_err(|error| {
                    let text = format!("{error:#}");
                    failed = Some(error);
                    crate::gpu::GpuError::Device(text)
                })
            });
        if let Some(error) = failed {
            return Err(error);
        }
        rendered.with_context(|| label.clone())?;
        points.extend(studied.iter().map(Studied::point));
        progress.done("compressed");
    }
    progress.finish();
    let report = CodecReport::new(still.adapter(), arguments, points);
    write_json(&out.join("codec.json"), &report)?;
    let page_path = out.join("codec.html");
    write_whole(&page_path, page::page(&report).as_bytes())?;
    if arguments.json {
        println!("{}", serde_json::to_string(&report)?);
        return Ok(());
    }
    for point in &report.points {
        println!("{}", told(point));
    }
    if let Some(is_met) = report.bar_is_met {
        println!(
            "H.264 at 8 Mbit/s and 1280x720 stays {} a mean FLIP of {FLIP_MAX}",
            if is_met { "below" } else { "ABOVE" }
        );
    }
    println!(
        "{} pictures of each size in {}, on {}: {}",
        report.frames,
        spoken(begun.elapsed().as_secs_f64()),
        report.adapter,
        page_path.display()
    );
    Ok(())
}

fn told(point: &CodecPoint) -> String {
    format!(
        "{}x{}, {}: {:.2} Mbit/s, FLIP {:.4} (worst {:.4}), SSIM {:.4}, PSNR {:.2} dB, {:.1} ms to encode",
        point.size.width(),
        point.size.height(),
        point.compression.name(),
        point.mbit_per_s,
        point.flip,
        point.flip_worst,
        point.ssim,
        point.psnr_db,
        point.encode_ms,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(size: [u32; 2], compression: Compression, flip: f64) -> CodecPoint {
        CodecPoint {
            size: FrameSize::new(size[0], size[1]).expect("in range"),
            compression,
            mbit_per_s: 8.0,
            largest_bytes: 1,
            flip,
            flip_worst: flip,
            ssim: 1.0,
            psnr_db: 50.0,
            encode_ms: 1.0,
            compared: 1,
        }
    }

    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        codec: CodecArguments,
    }

    fn arguments(list: &[&str]) -> CodecArguments {
        let all = ["codec"].iter().chain(list);
        <Cli as clap::Parser>::parse_from(all).codec
    }

    #[test]
    fn the_view_turns_as_fast_as_it_is_told() {
        let arguments = arguments(&["--seconds", "2", "--fps", "30", "--turn-deg-per-s", "9"]);
        let cameras = arguments.cameras().expect("cameras");
        assert_eq!(cameras.len(), 60);
        assert!((cameras[30].camera.yaw_deg() - 9.0).abs() < 1e-9);
    }

    #[test]
    fn the_bar_is_that_of_one_stream() {
        let arguments = arguments(&[]);
        let report = |points| CodecReport::new(String::new(), &arguments, points).bar_is_met;
        let stream = Compression::H264(8_000);
        assert_eq!(report(vec![point([1280, 720], stream, 0.019)]), Some(true));
        assert_eq!(report(vec![point([1280, 720], stream, 0.021)]), Some(false));
        let plain = Compression::PlainH264(8_000);
        assert_eq!(report(vec![point([1280, 720], plain, 0.01)]), None);
        assert_eq!(report(vec![point([1920, 1080], stream, 0.01)]), None);
        assert_eq!(
            report(vec![point([1280, 720], Compression::Jpeg(85), 0.01)]),
            None
        );
    }
}
