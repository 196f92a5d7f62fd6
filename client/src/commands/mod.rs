//! The subcommands: arguments in, library calls, text out.

pub(crate) mod load;
pub(crate) mod record;
pub(crate) mod scene;
mod scene_map;
mod scene_snapshot;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;
use skycell_client::{Access, ServerAddress};
use skycell_protocol::{FrameSize, QualityPreset, Stereo};

/// A camera path or a merge patch is no longer than this.
const INPUT_MAX_BYTES: u64 = 8 << 20;

/// The variable that holds the token, unless a flag names a file.
const TOKEN_VARIABLE: &str = "SKYCELL_TOKEN";

/// How this client is let in.
#[derive(Debug, clap::Args)]
pub(crate) struct AccessArguments {
    /// The file whose first line is the token that the server demands; without it SKYCELL_TOKEN, if that is set.
    #[arg(long, value_name = "FILE", global = true)]
    token_file: Option<PathBuf>,
    /// PEM file of the authorities that are trusted to name a server, instead of the system's.
    #[arg(long, value_name = "FILE", global = true)]
    ca_file: Option<PathBuf>,
}

impl AccessArguments {
    /// The address with what lets this client in.
    fn address(&self, url: &ServerAddress) -> anyhow::Result<ServerAddress> {
        let mut access = Access::default();
        if let Some(path) = &self.token_file {
            access = access.with_token_file(path).context("--token-file")?;
        } else if let Some(text) = std::env::var_os(TOKEN_VARIABLE) {
            access = access.with_token_text(&text.to_string_lossy(), TOKEN_VARIABLE)?;
        }
        if let Some(path) = &self.ca_file {
            access = access.with_ca_file(path).context("--ca-file")?;
        }
        Ok(url.clone().with_access(access))
    }
}

/// `--quality`.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum QualityArgument {
    /// Soon there.
    Draft,
    /// For software drivers and small GPUs.
    Balanced,
    /// For GPUs.
    High,
    /// Whatever it takes.
    Reference,
}

impl QualityArgument {
    fn preset(self) -> QualityPreset {
        match self {
            Self::Draft => QualityPreset::Draft,
            Self::Balanced => QualityPreset::Balanced,
            Self::High => QualityPreset::High,
            Self::Reference => QualityPreset::Reference,
        }
    }
}

/// The size and the eyes that `--width`, `--height` and `--stereo` say.
fn size_and_eyes(
    width: u32,
    height: u32,
    eye_distance_m: Option<f64>,
) -> anyhow::Result<(FrameSize, Option<Stereo>)> {
    let stereo = eye_distance_m
        .map(Stereo::new)
        .transpose()
        .context("--stereo")?;
    Ok((FrameSize::new(width, height)?.for_eyes(stereo)?, stereo))
}

/// A bar on stderr; nothing where stderr is no terminal.
fn progress_bar(template: &str) -> ProgressBar {
    let progress = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template(template) {
        progress.set_style(style);
    }
    progress
}

/// Writes a line to stdout. A reader that went away (`skycell … | head`) ends the command quietly.
fn print_line(text: &str) -> anyhow::Result<()> {
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => std::process::exit(0),
        result => result.context("stdout"),
    }
}

/// Reads a JSON file of a bounded size.
fn read_json_file(path: &Path) -> anyhow::Result<Value> {
    let file = std::fs::File::open(path).with_context(|| path.display().to_string())?;
    read_json(file).with_context(|| path.display().to_string())
}

fn read_json(reader: impl std::io::Read) -> anyhow::Result<Value> {
    let mut text = String::new();
    let mut bounded = reader.take(INPUT_MAX_BYTES + 1);
    std::io::Read::read_to_string(&mut bounded, &mut text)?;
    anyhow::ensure!(
        text.len() as u64 <= INPUT_MAX_BYTES,
        "longer than {INPUT_MAX_BYTES} bytes"
    );
    Ok(serde_json::from_str(&text)?)
}

/// Ready when the user (Ctrl-C) or the system asks the process to end.
async fn asked_to_stop() {
    let interrupted = async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    #[cfg(unix)]
    let terminated = async {
        match tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
            Ok(mut signal) => {
                signal.recv().await;
            }
            Err(_) => std::future::pending().await,
        }
    };
    #[cfg(not(unix))]
    let terminated = std::future::pending::<()>();
    tokio::select! {
        () = interrupted => {}
        () = terminated => {}
    }
}
