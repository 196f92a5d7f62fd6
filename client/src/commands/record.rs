//! `skycell record`.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use clap::ValueEnum;
use skycell_client::ServerAddress;
use skycell_client::camera_path::CameraPath;
use skycell_client::record::{RECORDING_FRAMES_MAX, RecordOptions, record};
use skycell_protocol::{Camera, Codec};

use super::{
    AccessArguments, QualityArgument, print_line, progress_bar, read_json_file, size_and_eyes,
};

const EXAMPLES: &str = "\
Examples:
  skycell record --url ws://127.0.0.1:8080/ws --out out/turn --frames 48
  skycell record --url ws://127.0.0.1:8080/ws --out out/pair --frames 48 --stereo 0.064
  skycell record --url ws://127.0.0.1:8080/ws --out out/clouds --frames 48 --codec clouds
  skycell record --url ws://127.0.0.1:8080/ws --out out/video --frames 48 --codec h264 --raw
  skycell record --url ws://127.0.0.1:8080/ws --out out/flight --path flight.json --fps 30

A camera path is a JSON list of keys in order of time; between two keys every number goes in a
straight line (a yaw from 0 to 360 is a full turn):
  [{\"time_s\": 0, \"camera\": {\"position_m\": [0, 2, 0], \"yaw_deg\": 0, \"pitch_deg\": 12, \"vertical_fov_deg\": 60}},
   {\"time_s\": 8, \"camera\": {\"position_m\": [500, 80, 0], \"yaw_deg\": 360, \"pitch_deg\": 20, \"vertical_fov_deg\": 40}}]

Time goes by frames: each picture is waited for, so a slow server does not make larger steps.";

/// Follows a camera path and saves every picture as PNG, or clouds alone as EXR, with an index.json of their headers.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// The server's address.
    #[arg(long, default_value = "ws://127.0.0.1:8080/ws")]
    url: ServerAddress,
    #[command(flatten)]
    access: AccessArguments,
    /// Where to write frame-00000.png and so on, and index.json; made if missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The camera's path; without it a slow turn to the right from the north, 6 degrees a second.
    #[arg(long, value_name = "FILE")]
    path: Option<PathBuf>,
    /// How many frames; without it to the end of the path, or 120.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(RECORDING_FRAMES_MAX)))]
    frames: Option<u32>,
    /// Pixels in a row.
    #[arg(long, default_value_t = 960)]
    width: u32,
    /// Rows.
    #[arg(long, default_value_t = 540)]
    height: u32,
    /// Frames per second of the path's time.
    #[arg(long, default_value_t = 24.0)]
    fps: f64,
    /// How pictures travel: files are PNG; or clouds alone, for another renderer, as EXR: R, G, B, A = 1 - T, T, Z in metres.
    #[arg(long, value_enum, default_value = "png")]
    codec: CodecArgument,
    /// Clouds alone without the haze in front of them.
    #[arg(long)]
    without_haze: bool,
    /// With --codec h264: also writes the video as it came, video.h264 (Annex B), which most players open.
    #[arg(long)]
    raw: bool,
    /// Pictures of two eyes so far apart, metres, side by side in one file; width and height are those of one eye.
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    stereo: Option<f64>,
    /// How good pictures are to be; without it what the scene or the server says.
    #[arg(long, value_enum)]
    quality: Option<QualityArgument>,
    /// How long to wait for a picture at its full resolution before a coarse one is taken.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    sharp_wait_s: f64,
    /// How long to wait for any picture.
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    timeout_s: f64,
    /// Prints the index as JSON instead of a sentence.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum CodecArgument {
    /// Small and lossy.
    Jpeg,
    /// Exact.
    Png,
    /// Clouds alone.
    Clouds,
    /// What a viewer sees of a video.
    H264,
}

const DEFAULT_FRAMES: u32 = 120;
const DEFAULT_TURN_DEG_PER_S: f64 = 6.0;
const WAIT_MAX_S: f64 = 3600.0;

pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let json = arguments.json;
    let address = arguments.access.address(&arguments.url)?;
    let options = options(arguments)?;
    let progress = progress_bar("{bar:40} {pos}/{len} frames, {eta} left");
    let index = record(&address, &options, &progress).await?;
    if json {
        return print_line(&serde_json::to_string(&index)?);
    }
    let coarse = index
        .frames
        .iter()
        .filter(|frame| frame.header.coarse)
        .count();
    print_line(&format!(
        "{} frames in {}{}",
        index.frames.len(),
        options.directory.display(),
        if coarse > 0 {
            format!(", {coarse} of them coarse")
        } else {
            String::new()
        }
    ))
}

fn options(arguments: Arguments) -> anyhow::Result<RecordOptions> {
    let (size, stereo) = size_and_eyes(arguments.width, arguments.height, arguments.stereo)?;
    anyhow::ensure!(
        (1.0..=120.0).contains(&arguments.fps),
        "--fps is {}; allowed: 1 to 120",
        arguments.fps
    );
    let path = match &arguments.path {
        Some(file) => {
            let document = read_json_file(file)?;
            CameraPath::from_json(&document).with_context(|| file.display().to_string())?
        }
        None => {
            let frames = arguments.frames.unwrap_or(DEFAULT_FRAMES);
            let duration_s = f64::from(frames) / arguments.fps;
            CameraPath::turn(
                Camera::default(),
                DEFAULT_TURN_DEG_PER_S * duration_s,
                duration_s,
            )?
        }
    };
    let frames = match (arguments.frames, &arguments.path) {
        (Some(frames), _) => frames,
        (None, None) => DEFAULT_FRAMES,
        (None, Some(_)) => {
            // Both ends of the path are shown.
            let frames = (path.duration_s() * arguments.fps).floor() + 1.0;
            anyhow::ensure!(
                frames <= f64::from(RECORDING_FRAMES_MAX),
                "the path has {frames} frames; allowed: {RECORDING_FRAMES_MAX}, or say --frames"
            );
            frames as u32
        }
    };
    anyhow::ensure!(
        !arguments.raw || matches!(arguments.codec, CodecArgument::H264),
        "--raw keeps a video as it came; it needs --codec h264"
    );
    Ok(RecordOptions {
        raw: arguments.raw,
        directory: arguments.out,
        path,
        frames,
        fps: arguments.fps,
        size,
        stereo,
        codec: match arguments.codec {
            CodecArgument::Jpeg => Codec::Jpeg,
            CodecArgument::Png => Codec::Png,
            CodecArgument::Clouds => Codec::Clouds,
            CodecArgument::H264 => Codec::H264,
        },
        haze: !arguments.without_haze,
        quality: arguments.quality.map(QualityArgument::preset),
        sharp_wait: wait("--sharp-wait-s", arguments.sharp_wait_s)?,
        frame_timeout: wait("--timeout-s", arguments.timeout_s)?,
    })
}

fn wait(name: &str, seconds: f64) -> anyhow::Result<Duration> {
    anyhow::ensure!(
        (0.0..=WAIT_MAX_S).contains(&seconds),
        "{name} is {seconds}; allowed: 0 to {WAIT_MAX_S}"
    );
    Ok(Duration::from_secs_f64(seconds))
}
