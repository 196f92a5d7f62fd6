//! `skycell scene map`.

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::Subcommand;
use serde_json::json;
use skycell_client::{HttpApi, MapChoice, SceneRevision};
use skycell_protocol::scene::MapKind;

use super::print_line;
use super::scene::{print_scene, revision_text};

const EXAMPLES: &str = "\
Examples:
  skycell scene map get coverage coverage.png
  skycell scene map put coverage storm.png --transition-s 60
  skycell scene map reset coverage";

/// The longest file that a server takes.
const FILE_MAX_BYTES: u64 = 64 << 20;

/// Replaces, fetches or resets a map of a layer: coverage (where clouds are; the top is north), type (how tall they are)
/// or profile (types across, heights up).
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

/// Which map.
#[derive(Debug, clap::Args)]
struct Which {
    /// coverage, type or profile.
    kind: MapKind,
    /// Name of the layer; needed where several have maps.
    #[arg(long)]
    layer: Option<String>,
}

impl Which {
    fn choice(self) -> MapChoice {
        MapChoice {
            kind: self.kind,
            layer: self.layer,
        }
    }
}

/// How a map is changed.
#[derive(Debug, clap::Args)]
struct How {
    /// Sky time that the change takes, and later ones until another is told; without it, as the scene says.
    #[arg(long, value_name = "SECONDS")]
    transition_s: Option<f64>,
    /// Only if the scene is this revision; without it, whatever it is.
    #[arg(long, value_name = "REVISION")]
    if_match: Option<u64>,
}

impl How {
    fn etag(&self) -> String {
        self.if_match
            .map_or_else(|| "*".to_owned(), |revision| format!("\"{revision}\""))
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Replaces a map by a file: PNG with 8 or 16 bits of grey, or EXR with one channel, values 0 to 1.
    #[command(
        after_help = "Example:\n  skycell scene map put coverage storm.png --layer low --transition-s 60"
    )]
    Put {
        #[command(flatten)]
        which: Which,
        /// The file.
        file: PathBuf,
        #[command(flatten)]
        how: How,
    },
    /// Fetches a map, as PNG with 16 bits or, by the name of the file, as EXR.
    #[command(after_help = "Example:\n  skycell scene map get type type.exr --layer low")]
    Get {
        #[command(flatten)]
        which: Which,
        /// Where to write it: NAME.png or NAME.exr.
        file: PathBuf,
    },
    /// Brings the map that is made from the seed back.
    #[command(after_help = "Example:\n  skycell scene map reset coverage --transition-s 60")]
    Reset {
        #[command(flatten)]
        which: Which,
        #[command(flatten)]
        how: How,
    },
}

pub(super) async fn run(arguments: Arguments, api: &HttpApi, json: bool) -> anyhow::Result<()> {
    match arguments.command {
        Command::Put { which, file, how } => {
            let bytes = read_file(&file)?;
            let scene = api
                .set_map(&which.choice(), Some(bytes), how.transition_s, &how.etag())
                .await?;
            tell(&scene, json)
        }
        Command::Reset { which, how } => {
            let scene = api
                .set_map(&which.choice(), None, how.transition_s, &how.etag())
                .await?;
            tell(&scene, json)
        }
        Command::Get { which, file } => {
            let extension = file.extension().and_then(|extension| extension.to_str());
            let format = match extension {
                Some("png") => "png",
                Some("exr") => "exr",
                _ => anyhow::bail!(
                    "the file is {}; allowed: a name that ends with .png or .exr",
                    file.display()
                ),
            };
            let bytes = api.map(&which.choice(), format).await?;
            std::fs::write(&file, &bytes)
                .with_context(|| format!("{} cannot be written", file.display()))?;
            let told = if json {
                json!({"file": file, "bytes": bytes.len()}).to_string()
            } else {
                format!("{}: {} bytes", file.display(), bytes.len())
            };
            print_line(&told)
        }
    }
}

fn read_file(file: &Path) -> anyhow::Result<Vec<u8>> {
    let unreadable = || format!("{} cannot be read", file.display());
    let bytes = std::fs::metadata(file).with_context(unreadable)?.len();
    ensure!(
        bytes <= FILE_MAX_BYTES,
        "{} has {bytes} bytes; allowed: at most {FILE_MAX_BYTES}",
        file.display()
    );
    std::fs::read(file).with_context(unreadable)
}

fn tell(scene: &SceneRevision, json: bool) -> anyhow::Result<()> {
    if json {
        print_scene(scene, json)
    } else {
        print_line(&format!("revision {}", revision_text(scene)))
    }
}
