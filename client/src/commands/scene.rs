//! `skycell scene`.

use std::time::Duration;

use anyhow::Context;
use clap::Subcommand;
use serde_json::{Value, json};
use skycell_client::{HttpApi, SceneRevision, ServerAddress};
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::{AccessArguments, print_line, read_json, scene_map, scene_snapshot};

const EXAMPLES: &str = "\
Examples:
  skycell scene get
  skycell scene patch '{\"wind\": {\"speed_m_per_s\": 12}}'
  skycell scene patch - < patch.json
  skycell scene watch --changes 3
  skycell scene map put coverage storm.png --transition-s 60
  skycell scene snapshot sky.png --yaw-deg 90
  skycell scene time --pause
  skycell scene preset set broken-sunset --transition-s 20
  skycell scene revisions
  skycell scene revert";

/// Reads, changes or watches the scene.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// The server's address.
    #[arg(long, default_value = "ws://127.0.0.1:8080/ws", global = true)]
    url: ServerAddress,
    #[command(flatten)]
    access: AccessArguments,
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
    /// Writes a picture of the sky as it is now.
    #[command(
        after_help = "Example:\n  skycell scene snapshot noon.png --yaw-deg 90 --pitch-deg 20 --width 1280 --height 720"
    )]
    Snapshot(scene_snapshot::Arguments),
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
    /// Prints the sky's clock, after changing it if told to.
    #[command(
        after_help = "Examples:\n  skycell scene time\n  skycell scene time --rate 24 --wind-rate 1   # a day in an hour\n  \
                      skycell scene time --date 2026-06-21T18:30:00Z --pause"
    )]
    Time(TimeArguments),
    /// Lists the last revisions, newest first.
    #[command(after_help = "Example:\n  skycell scene revisions --limit 5")]
    Revisions {
        /// How many.
        #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=100))]
        limit: u32,
    },
    /// Brings an earlier revision back, or undoes the last change; done again, the change before.
    #[command(
        after_help = "Examples:\n  skycell scene revert                        # undo\n  \
                      skycell scene revert 12 --transition-s 10"
    )]
    Revert {
        /// The revision; without it, the last change is undone.
        revision: Option<u64>,
        /// How long the sky takes to get there.
        #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
        transition_s: f64,
        /// Only if the scene is this revision; without it, whatever it is.
        #[arg(long, value_name = "REVISION")]
        if_match: Option<u64>,
    },
    /// Skies by name.
    #[command(
        after_help = "Examples:\n  skycell scene preset list\n  skycell scene preset set storm --transition-s 30"
    )]
    Preset {
        #[command(subcommand)]
        command: PresetCommand,
    },
}

#[derive(Debug, clap::Args)]
struct TimeArguments {
    /// Stops the sky.
    #[arg(long, conflicts_with = "resume")]
    pause: bool,
    /// Lets it go on.
    #[arg(long)]
    resume: bool,
    /// Sets sky time, seconds.
    #[arg(
        long,
        value_name = "SECONDS",
        conflicts_with = "date",
        allow_negative_numbers = true
    )]
    sky_s: Option<f64>,
    /// Sets sky time by the date at the sun's place, as 2026-06-21T18:30:00Z.
    #[arg(long, value_name = "DATE")]
    date: Option<String>,
    /// Seconds of sky time in a second; 24 shows a day in an hour.
    #[arg(long, allow_negative_numbers = true)]
    rate: Option<f64>,
    /// Seconds of wind in a second.
    #[arg(long, value_name = "RATE", allow_negative_numbers = true)]
    wind_rate: Option<f64>,
}

impl TimeArguments {
    /// What is to be changed, as the API takes it.
    fn change(&self) -> Value {
        let mut change = serde_json::Map::new();
        if self.pause || self.resume {
            change.insert("paused".into(), self.pause.into());
        }
        let numbers = [
            ("sky_s", self.sky_s),
            ("rate", self.rate),
            ("wind_rate", self.wind_rate),
        ];
        for (key, number) in numbers {
            if let Some(number) = number {
                change.insert(key.into(), number.into());
            }
        }
        if let Some(date) = &self.date {
            change.insert("date".into(), date.as_str().into());
        }
        Value::Object(change)
    }
}

#[derive(Debug, Subcommand)]
enum PresetCommand {
    /// Lists their names and what is seen.
    #[command(after_help = "Example:\n  skycell scene preset list --json")]
    List,
    /// Makes the sky one of them.
    #[command(after_help = "Example:\n  skycell scene preset set mackerel-sky --transition-s 20")]
    Set {
        /// Its name.
        name: String,
        /// How long the sky takes to get there.
        #[arg(long, value_name = "SECONDS", default_value_t = 10.0)]
        transition_s: f64,
    },
}

/// A server may be away this often in a row, as while it is started anew.
const WATCH_FAILURES_MAX: u32 = 30;

pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let api = HttpApi::new(arguments.access.address(&arguments.url)?)?;
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
        Command::Snapshot(arguments) => scene_snapshot::run(arguments, &api, json).await,
        Command::Map(arguments) => scene_map::run(arguments, &api, json).await,
        Command::Watch {
            changes,
            for_s,
            every_s,
        } => {
            let end = Instant::now() + Duration::from_secs(for_s);
            watch(&api, json, changes, end, Duration::from_secs(every_s)).await
        }
        Command::Time(time) => {
            let change = time.change();
            let is_empty = change.as_object().is_none_or(serde_json::Map::is_empty);
            let report = if is_empty {
                api.get_json("api/v1/scene/time").await?
            } else {
                api.change_time(&change).await?
            };
            print_line(&if json {
                report.to_string()
            } else {
                time_text(&report)
            })
        }
        Command::Revisions { limit } => list_revisions(&api, json, limit).await,
        Command::Revert {
            revision,
            transition_s,
            if_match,
        } => {
            let etag = if_match.map_or_else(|| "*".to_owned(), |number| format!("\"{number}\""));
            let scene = api.revert(revision, transition_s, &etag).await?;
            if json {
                return print_scene(&scene, json);
            }
            print_line(&format!("revision {}", revision_text(&scene)))
        }
        Command::Preset {
            command: PresetCommand::List,
        } => {
            let presets = api.get_json("api/v1/presets").await?;
            if json {
                return print_line(&presets.to_string());
            }
            for preset in presets.as_array().into_iter().flatten() {
                let text = |key: &str| preset[key].as_str().unwrap_or_default();
                print_line(&format!("{:<24}{}", text("name"), text("about")))?;
            }
            Ok(())
        }
        Command::Preset {
            command: PresetCommand::Set { name, transition_s },
        } => {
            let document = api.set_preset(&name, transition_s).await?;
            if json {
                return print_line(&document.to_string());
            }
            print_line(&format!("{name} in {transition_s} s"))
        }
    }
}

/// What is kept, a line each.
async fn list_revisions(api: &HttpApi, json: bool, limit: u32) -> anyhow::Result<()> {
    let page = api
        .get_json(&format!("api/v1/scene/revisions?limit={limit}"))
        .await?;
    for revision in page["revisions"].as_array().into_iter().flatten() {
        print_line(&if json {
            revision.to_string()
        } else {
            line_of_revision(revision)
        })?;
    }
    Ok(())
}

fn line_of_revision(revision: &Value) -> String {
    let text = |key: &str| revision[key].as_str().unwrap_or_default();
    let mut what = text("kind").to_owned();
    if let Some(about) = revision["about"].as_str() {
        what.push_str(&format!(" {about}"));
    }
    if let Some(of) = revision["of"].as_u64() {
        what.push_str(&format!(" to {of}"));
    }
    // A group of changes stands for all of them.
    let own = revision["revision"].as_u64();
    if let Some(first) = revision["first"]
        .as_u64()
        .filter(|first| Some(*first) < own)
    {
        what.push_str(&format!(" since {first}"));
    }
    let mut changed: Vec<&str> = revision["changed"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
        .collect();
    let more = revision["changed_more"].as_u64().unwrap_or(0);
    let more = (more > 0).then(|| format!("and {more} more"));
    changed.extend(more.as_deref());
    format!(
        "{:>6}  {:<27}  {what:<24}  {}",
        revision["revision"],
        text("time"),
        changed.join(" ")
    )
}

/// The clock in a line.
fn time_text(report: &Value) -> String {
    let number = |pointer: &str| {
        report
            .pointer(pointer)
            .and_then(Value::as_f64)
            .unwrap_or_default()
    };
    let date = report["date"].as_str().map(|date| format!(" ({date})"));
    let state = if report["paused"] == true {
        "paused".to_owned()
    } else {
        format!(
            "{} s of sky and {} s of wind in a second",
            number("/rate"),
            number("/wind_rate")
        )
    };
    format!(
        "sky time {:.1} s{}, {state}; sun at azimuth {:.1}°, elevation {:.1}°",
        number("/sky_s"),
        date.unwrap_or_default(),
        number("/sun/azimuth_deg"),
        number("/sun/elevation_deg"),
    )
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_revision_is_told_in_a_line() {
        let revision = json!({
            "revision": 12, "time": "2026-06-21T10:00:00Z", "kind": "revert", "about": null, "of": 3,
            "changed": ["/exposure_ev"], "changed_more": 2
        });
        let line = line_of_revision(&revision);
        let words: Vec<&str> = line.split_whitespace().collect();
        assert_eq!(
            words,
            [
                "12",
                "2026-06-21T10:00:00Z",
                "revert",
                "to",
                "3",
                "/exposure_ev",
                "and",
                "2",
                "more"
            ]
        );
        let drag = json!({"revision": 12, "first": 9, "time": "", "kind": "patch", "changed": []});
        let words = line_of_revision(&drag);
        assert_eq!(
            words.split_whitespace().collect::<Vec<_>>(),
            ["12", "patch", "since", "9"]
        );
    }
}
