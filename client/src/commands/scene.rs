//! `skycell scene`.

use std::time::Duration;

use anyhow::Context;
use clap::Subcommand;
use serde_json::{Value, json};
use skycell_client::{HttpApi, SceneRevision, ServerAddress};
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::{print_line, read_json, scene_map};

const EXAMPLES: &str = "\
Examples:
  skycell scene get
  skycell scene patch '{\"wind\": {\"speed_m_per_s\": 12}}'
  skycell scene patch - < patch.json
  skycell scene watch --changes 3
  skycell scene map put coverage storm.png --transition-s 60";

/// Reads, changes or watches the scene.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// The server's address.
    #[arg(long, default_value = "ws://127.0.0.1:8080/ws", global = true)]
    url: ServerAddress,
    /// One JSON object a line: revision, etag, scene.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Prints the scene.
    #[command(
        after_help = "Example:\n  skycell scene get --url ws://127.0.0.1:8080/ws > scene.json"
    )]
    Get,
    /// Changes the scene by a merge patch (RFC 7396): what it names is replaced, null removes.
    ///
    /// Lists are replaced as a whole: to change one layer, give all of them.
    #[command(
        after_help = "Example:\n  skycell scene patch '{\"sun\": {\"elevation_deg\": 8}}' --if-match 12"
    )]
    Patch {
        /// The patch; - reads it from stdin.
        patch: String,
        /// Only if the scene is this revision; without it, whatever it is.
        #[arg(long, value_name = "REVISION")]
        if_match: Option<u64>,
    },
    /// Replaces, fetches or resets a map of a layer.
    Map(scene_map::Arguments),
    /// Prints the scene now and whenever it changes.
    #[command(after_help = "Example:\n  skycell scene watch --changes 3 --for-s 600")]
    Watch {
        /// Ends after this many changes.
        #[arg(long)]
        changes: Option<u64>,
        /// Ends after this long.
        #[arg(long, value_name = "SECONDS", default_value_t = 86_400, value_parser = clap::value_parser!(u64).range(1..=31_536_000))]
        for_s: u64,
        /// How often to ask.
        #[arg(long, value_name = "SECONDS", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=3600))]
        every_s: u64,
    },
}

/// A server may be away this often in a row, as while it is started anew.
const WATCH_FAILURES_MAX: u32 = 30;

pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let api = HttpApi::new(arguments.url)?;
    let json = arguments.json;
    match arguments.command {
        Command::Get => print_scene(&api.scene().await?, json),
        Command::Patch { patch, if_match } => {
            let patch = read_patch(&patch)?;
            let scene = match if_match {
                Some(revision) => api.patch_scene(&patch, &format!("\"{revision}\"")).await?,
                None => api.patch_current_scene(&patch).await?,
            };
            if json {
                return print_scene(&scene, json);
            }
            print_line(&format!("revision {}", revision_text(&scene)))
        }
        Command::Map(arguments) => scene_map::run(arguments, &api, json).await,
        Command::Watch {
            changes,
            for_s,
            every_s,
        } => {
            let end = Instant::now() + Duration::from_secs(for_s);
            watch(&api, json, changes, end, Duration::from_secs(every_s)).await
        }
    }
}

fn read_patch(text: &str) -> anyhow::Result<Value> {
    let patch: Value = if text == "-" {
        read_json(std::io::stdin()).context("stdin")?
    } else {
        serde_json::from_str(text).context("the patch is not JSON")?
    };
    anyhow::ensure!(
        patch.is_object(),
        "the patch is {patch}; allowed: an object, such as {{\"exposure_ev\": 1}}"
    );
    Ok(patch)
}

async fn watch(
    api: &HttpApi,
    json: bool,
    changes: Option<u64>,
    end: Instant,
    every: Duration,
) -> anyhow::Result<()> {
    let mut last: Option<SceneRevision> = None;
    let mut changes_left = changes;
    let mut failures = 0;
    let mut ticks = interval(every);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    while Instant::now() < end {
        ticks.tick().await;
        let scene = match api.scene().await {
            Ok(scene) => scene,
            // Not at the first time: then the address is probably wrong.
            Err(error) if last.is_some() && failures < WATCH_FAILURES_MAX => {
                failures += 1;
                eprintln!("{error}");
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        failures = 0;
        if last.as_ref() == Some(&scene) {
            continue;
        }
        print_scene(&scene, json)?;
        if last.is_some() {
            changes_left = changes_left.map(|left| left.saturating_sub(1));
        }
        if changes_left == Some(0) {
            break;
        }
        last = Some(scene);
    }
    Ok(())
}

pub(super) fn print_scene(scene: &SceneRevision, json: bool) -> anyhow::Result<()> {
    if json {
        let line =
            json!({"revision": scene.revision(), "etag": scene.etag, "scene": scene.document});
        return print_line(&line.to_string());
    }
    // Beside the document, so that `> scene.json` gets the document alone.
    eprintln!("revision {}", revision_text(scene));
    print_line(&serde_json::to_string_pretty(&scene.document)?)
}

pub(super) fn revision_text(scene: &SceneRevision) -> String {
    scene
        .revision()
        .map_or_else(|| scene.etag.clone(), |revision| revision.to_string())
}
