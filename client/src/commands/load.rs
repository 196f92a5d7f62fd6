//! `skycell load`.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use skycell_client::ServerAddress;
use skycell_client::load::{self, LoadOptions, LoadReport, SoakOptions, StormOptions, ViewerRing};
use skycell_protocol::FrameSize;

use super::{
    AccessArguments, QualityArgument, asked_to_stop, print_line, progress_bar, size_and_eyes,
};

const EXAMPLES: &str = "\
Examples:
  skycell load --url ws://127.0.0.1:8080/ws --viewers 16 --overlaps 0,20,40,60,80,100 --json load.json
  skycell load --url ws://127.0.0.1:8080/ws --viewers 4 --overlaps 0,100 --wind-off --renderer-baseline
  skycell load --crowd migrate --viewers 6 --seconds 600 --width 96 --height 54 --fps 5 --max-error 0.1

All viewers stand at one place. With n of them a picture is 360/n degrees wide at most, and
neighbours are turned by (1 - overlap) of that about the vertical axis: at 0 % they close the
circle, at 100 % all look the same way. Per overlap: fresh viewers join an empty server, hold still
until its sky has converged, turn together for some seconds, and leave. They acknowledge frames
without decoding them. The server must have no other viewers.

With --crowd migrate viewers do not stand: groups travel for --seconds, meet and part, so that view
cells merge, split and move. The server's memory, heartbeats, pictures and cache error are watched
and held to bars; the command fails when one is missed.

Ideal is: texels updated = unique texels x samples, and GPU time in proportion to unique texels.";

/// Measures what it saves that viewers see the same sky.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// The server's address.
    #[arg(long, default_value = "ws://127.0.0.1:8080/ws")]
    url: ServerAddress,
    #[command(flatten)]
    access: AccessArguments,
    /// How many viewers.
    #[arg(long, default_value_t = 16)]
    viewers: u32,
    /// Overlaps of neighbours in %, in the order of measuring.
    #[arg(long, value_delimiter = ',', default_value = "0,20,40,60,80,100")]
    overlaps: Vec<f64>,
    /// Where to save the report as JSON, after each overlap; - for stdout instead of the table.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Pixels in a row.
    #[arg(long, default_value_t = 640)]
    width: u32,
    /// Rows.
    #[arg(long, default_value_t = 360)]
    height: u32,
    /// Frames per second that each viewer wishes.
    #[arg(long, default_value_t = 30.0)]
    fps: f64,
    /// How long to turn per overlap; 0 leaves it out.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    seconds: f64,
    /// Viewers who move for --seconds instead of standing.
    #[arg(long, value_enum)]
    crowd: Option<CrowdArgument>,
    /// Error that viewers of a crowd ask for, FLIP.
    #[arg(long, value_name = "FLIP", default_value_t = 0.1)]
    max_error: f64,
    /// How many seconds of its way a crowd goes in one.
    #[arg(long, default_value_t = 1.0)]
    pace: f64,
    /// How fast to turn.
    #[arg(
        long,
        value_name = "DEG_PER_S",
        default_value_t = 10.0,
        allow_negative_numbers = true
    )]
    turn_speed: f64,
    /// How wide a picture is; without it 360/viewers, 90 at most.
    #[arg(long, value_name = "DEG")]
    horizontal_fov_deg: Option<f64>,
    /// How far up all look.
    #[arg(
        long,
        value_name = "DEG",
        default_value_t = 12.0,
        allow_negative_numbers = true
    )]
    pitch_deg: f64,
    /// Where all stand: east, altitude, south.
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_delimiter = ',',
        default_value = "0,2,0",
        allow_negative_numbers = true
    )]
    position_m: Vec<f64>,
    /// How long to wait for a converged sky per overlap.
    #[arg(long, value_name = "SECONDS", default_value_t = 300.0)]
    converge_timeout_s: f64,
    /// Updates until a texel has converged, if the server does not tell.
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=64))]
    samples: u32,
    /// Viewers have two eyes so far apart, metres; width and height are those of one eye.
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    stereo: Option<f64>,
    /// How good pictures are to be; without it what the scene or the server says.
    #[arg(long, value_enum)]
    quality: Option<QualityArgument>,
    /// Has the same views by the screen-space renderer as well, one frame each.
    #[arg(long)]
    renderer_baseline: bool,
    /// Decodes frames before it acknowledges them, as a viewer does who shows them.
    #[arg(long)]
    decode: bool,
    /// All viewers connect at once, are cut off and connect at once again, instead of overlaps. Fails where one has no
    /// picture within 5 s.
    #[arg(long)]
    storm: bool,
    /// Takes the wind out of the scene first and puts it back afterwards.
    #[arg(long)]
    wind_off: bool,
}

/// How a crowd moves.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum CrowdArgument {
    /// Groups that travel, meet and part.
    Migrate,
}

const OVERLAPS_MAX: usize = 100;
/// Viewers of a crowd.
const CROWD_VIEWERS_MAX: u32 = 1024;
const WAIT_MAX_S: f64 = 3600.0;
/// A day.
const CROWD_MAX_S: f64 = 86_400.0;

pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    if let Some(CrowdArgument::Migrate) = arguments.crowd {
        return soak(&arguments).await;
    }
    if arguments.storm {
        return storm(&arguments).await;
    }
    let options = options(&arguments)?;
    let to_stdout = arguments.json.as_deref() == Some(Path::new("-"));
    let file = arguments.json.as_deref().filter(|_| !to_stdout);
    // Before minutes are spent on figures that nobody can save.
    if let Some(file) = file {
        std::fs::File::create(file).with_context(|| file.display().to_string())?;
    }
    let address = arguments.access.address(&arguments.url)?;
    let progress = progress_bar("{spinner} {pos}/{len} overlaps  {msg}");
    progress.set_length(options.overlaps.len() as u64);
    progress.enable_steady_tick(Duration::from_millis(200));
    let mut saved = Ok(());
    let result = load::run(&address, &options, &progress, asked_to_stop(), |report| {
        if let (Some(file), Ok(())) = (file, &saved) {
            saved = save(file, report);
        }
    })
    .await;
    progress.finish_and_clear();
    let report = result?;
    saved?;
    if to_stdout {
        return print_line(&serde_json::to_string_pretty(&report)?);
    }
    print_line(load::table(&report).trim_end())
}

async fn soak(arguments: &Arguments) -> anyhow::Result<()> {
    anyhow::ensure!(
        (1..=CROWD_VIEWERS_MAX).contains(&arguments.viewers),
        "--viewers is {}; allowed: 1 to {CROWD_VIEWERS_MAX}",
        arguments.viewers
    );
    in_range("--fps", arguments.fps, 1.0, 120.0)?;
    in_range("--seconds", arguments.seconds, 5.0, CROWD_MAX_S)?;
    in_range("--max-error", arguments.max_error, 0.001, 1.0)?;
    in_range("--pace", arguments.pace, 0.01, 100.0)?;
    let options = SoakOptions {
        viewers: arguments.viewers as usize,
        duration: Duration::from_secs_f64(arguments.seconds),
        size: FrameSize::new(arguments.width, arguments.height)?,
        fps: arguments.fps,
        max_error: arguments.max_error,
        pace: arguments.pace,
    };
    let address = arguments.access.address(&arguments.url)?;
    let progress = progress_bar("{spinner} {pos}/{len} s  {msg}");
    let result = load::soak(&address, &options, &progress, asked_to_stop()).await;
    progress.finish_and_clear();
    let report = result?;
    tell(
        arguments.json.as_deref(),
        &serde_json::to_string_pretty(&report)?,
        &report.table(),
    )?;
    anyhow::ensure!(report.is_kept(), "a bar was missed");
    Ok(())
}

async fn storm(arguments: &Arguments) -> anyhow::Result<()> {
    anyhow::ensure!(
        (1..=CROWD_VIEWERS_MAX).contains(&arguments.viewers),
        "--viewers is {}; allowed: 1 to {CROWD_VIEWERS_MAX}",
        arguments.viewers
    );
    in_range("--fps", arguments.fps, 1.0, 120.0)?;
    let options = StormOptions {
        viewers: arguments.viewers,
        size: FrameSize::new(arguments.width, arguments.height)?,
        fps: arguments.fps,
    };
    let address = arguments.access.address(&arguments.url)?;
    let report = tokio::select! {
        report = load::storm::run(&address, &options) => report?,
        () = asked_to_stop() => anyhow::bail!("interrupted"),
    };
    tell(
        arguments.json.as_deref(),
        &serde_json::to_string_pretty(&report)?,
        &report.table(),
    )?;
    anyhow::ensure!(report.is_kept(), "a viewer had no picture in time");
    Ok(())
}

/// Prints the table, and writes the JSON where `--json` says; to standard output it is the only thing that is written.
fn tell(file: Option<&Path>, json: &str, table: &str) -> anyhow::Result<()> {
    match file {
        Some(file) if file == Path::new("-") => return print_line(json),
        Some(file) => std::fs::write(file, json).with_context(|| file.display().to_string())?,
        None => {}
    }
    print_line(table.trim_end())
}

fn save(file: &Path, report: &LoadReport) -> anyhow::Result<()> {
    let text = serde_json::to_vec_pretty(report)?;
    std::fs::write(file, text).with_context(|| file.display().to_string())
}

fn options(arguments: &Arguments) -> anyhow::Result<LoadOptions> {
    let (size, stereo) = size_and_eyes(arguments.width, arguments.height, arguments.stereo)?;
    let &[x_m, altitude_m, z_m] = arguments.position_m.as_slice() else {
        anyhow::bail!(
            "--position-m has {} numbers; allowed: 3",
            arguments.position_m.len()
        );
    };
    let ring = ViewerRing::new(
        arguments.viewers,
        size,
        [x_m, altitude_m, z_m],
        arguments.pitch_deg,
        arguments.horizontal_fov_deg,
    )?;
    anyhow::ensure!(
        (1..=OVERLAPS_MAX).contains(&arguments.overlaps.len()),
        "--overlaps has {} numbers; allowed: 1 to {OVERLAPS_MAX}",
        arguments.overlaps.len()
    );
    for &percent in &arguments.overlaps {
        in_range("--overlaps", percent, 0.0, 100.0)?;
    }
    in_range("--fps", arguments.fps, 1.0, 120.0)?;
    in_range("--turn-speed", arguments.turn_speed, -360.0, 360.0)?;
    in_range("--seconds", arguments.seconds, 0.0, WAIT_MAX_S)?;
    in_range(
        "--converge-timeout-s",
        arguments.converge_timeout_s,
        1.0,
        WAIT_MAX_S,
    )?;
    Ok(LoadOptions {
        ring,
        overlaps: arguments
            .overlaps
            .iter()
            .map(|percent| percent / 100.0)
            .collect(),
        size,
        stereo,
        fps: arguments.fps,
        converge_timeout: Duration::from_secs_f64(arguments.converge_timeout_s),
        turn_duration: Duration::from_secs_f64(arguments.seconds),
        turn_speed_deg_per_s: arguments.turn_speed,
        decodes: arguments.decode,
        samples_per_texel: arguments.samples,
        quality: arguments.quality.map(QualityArgument::preset),
        renderer_baseline: arguments.renderer_baseline,
        wind_off: arguments.wind_off,
    })
}

fn in_range(name: &str, value: f64, low: f64, high: f64) -> anyhow::Result<()> {
    anyhow::ensure!(
        (low..=high).contains(&value),
        "{name} is {value}; allowed: {low} to {high}"
    );
    Ok(())
}
