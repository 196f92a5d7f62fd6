//! How a server is run: its end, its start anew under those who look, its log and its figures.

use std::collections::BTreeSet;
use std::time::Duration;

use anyhow::{Context, ensure};
use serde_json::{Value, json};
use skycell_client::camera_path::CameraPath;
use skycell_client::record::{RecordOptions, record};
use skycell_client::{Connection, ConnectionError, ConnectionLimits};
use skycell_protocol::message::Hello;
use skycell_protocol::{Codec, FrameSize};
use skycell_tests::viewer::camera;
use skycell_tests::{Server, ServerOptions, Viewer, until};

type Outcome = anyhow::Result<()>;

fn small_hello() -> anyhow::Result<Hello> {
    let camera = camera([0.0, 2.0, 0.0], 0.0, 20.0)?;
    Ok(Hello::new(FrameSize::new(160, 90)?, 30.0, camera))
}

async fn status(server: &Server, path: &str) -> anyhow::Result<u16> {
    let answer = server.http().get(server.url(path)).send().await?;
    Ok(answer.status().as_u16())
}

/// Hears on until the server closes: code and reason.
async fn closed(connection: &mut Connection) -> anyhow::Result<(Option<u16>, String)> {
    loop {
        match connection.next_event().await {
            Ok(_) => {}
            Err(ConnectionError::Closed { code, reason }) => return Ok((code, reason)),
            Err(error) => return Err(error.into()),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn sigterm_drains_then_closes_each_with_its_own_time_to_come_back_and_ends_well() -> Outcome {
    let server = Server::start_with(ServerOptions {
        top_level_toml: "drain_s = 2".to_owned(),
        ..ServerOptions::default()
    })
    .await?;
    let address = server.client_address()?;
    let mut viewers = Vec::new();
    for _ in 0..3 {
        viewers
            .push(Connection::open(&address, small_hello()?, ConnectionLimits::default()).await?);
    }
    ensure!(status(&server, "readyz").await? == 200);
    server.signal("TERM")?;
    let begun = std::time::Instant::now();
    until("not ready", async || {
        Ok((status(&server, "readyz").await? == 503).then_some(()))
    })
    .await?;
    // It lives, answers, and takes changes; new viewers are sent away.
    ensure!(status(&server, "livez").await? == 200);
    server.patch(&json!({"exposure_ev": 1.0})).await?;
    let refused = Connection::open(&address, small_hello()?, ConnectionLimits::default()).await;
    let refusal = refused
        .err()
        .context("a viewer was taken while draining")?
        .to_string();
    ensure!(refusal.contains("503"), "{refusal}");

    let mut waits = BTreeSet::new();
    for viewer in &mut viewers {
        let (code, reason) = closed(viewer).await?;
        ensure!(code == Some(1012), "{reason}");
        let (_, told) = reason
            .split_once("retry_after_s=")
            .with_context(|| reason.clone())?;
        waits.insert(told.chars().take(4).collect::<String>());
    }
    println!("told to come back after {waits:?} s");
    ensure!(waits.len() > 1, "all come back at once: {waits:?}");
    ensure!(
        begun.elapsed() >= Duration::from_millis(1900),
        "{:?}",
        begun.elapsed()
    );
    drop(viewers);
    let (ended, log) = server.end().await?;
    ensure!(ended.code() == Some(0), "{ended}: {log}");
    ensure!(log.contains("draining"), "{log}");
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_signal_ends_at_once_and_sigint_does_not_drain() -> Outcome {
    let options = ServerOptions {
        top_level_toml: "drain_s = 3000".to_owned(),
        ..ServerOptions::default()
    };
    let server = Server::start_with(options.clone()).await?;
    server.signal("TERM")?;
    until("draining", async || {
        Ok((status(&server, "readyz").await? == 503).then_some(()))
    })
    .await?;
    server.signal("TERM")?;
    let (ended, _) = server.end().await?;
    ensure!(ended.code() == Some(1), "{ended}");

    let server = Server::start_with(options).await?;
    server.signal("INT")?;
    let (ended, log) = server.end().await?;
    ensure!(ended.code() == Some(0), "{ended}: {log}");
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_goes_on_when_the_server_is_killed_and_started_again() -> Outcome {
    let state = tempfile::tempdir()?;
    let options = ServerOptions {
        state_dir: Some(state.path().to_owned()),
        ..ServerOptions::default()
    };
    let server = Server::start_with(options.clone()).await?;
    let revision = server.calm().await?;
    let listen = server.address().to_owned();
    let folder = tempfile::tempdir()?;
    let recording = RecordOptions {
        directory: folder.path().to_owned(),
        path: CameraPath::turn(camera([0.0, 2.0, 0.0], 0.0, 20.0)?, 40.0, 4.0)?,
        frames: 40,
        fps: 10.0,
        size: FrameSize::new(96, 54)?,
        stereo: None,
        codec: Codec::Png,
        haze: true,
        raw: false,
        quality: None,
        sharp_wait: Duration::from_millis(200),
        frame_timeout: Duration::from_secs(60),
    };
    let address = server.client_address()?;
    let progress = indicatif::ProgressBar::hidden();
    let seen = progress.clone();
    let running = tokio::spawn(async move { record(&address, &recording, &progress).await });
    until("some frames", async || {
        Ok((seen.position() >= 5).then_some(()))
    })
    .await?;
    server.kill()?;
    ensure!(
        seen.position() < 40,
        "the recording was over before the server was killed"
    );
    let server = Server::start_with(ServerOptions {
        listen: Some(listen),
        ..options
    })
    .await?;
    let index = running.await??;
    ensure!(index.frames.len() == 40);
    let viewers: BTreeSet<(u32, u64)> = index
        .frames
        .iter()
        .map(|frame| (frame.header.viewer, frame.header.scene_revision))
        .collect();
    println!("frames by viewer and scene revision: {viewers:?}");
    ensure!(
        viewers.iter().all(|(_, seen)| *seen == revision),
        "{viewers:?}"
    );
    drop(server);
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn acknowledged_changes_survive_kills_of_the_real_server() -> Outcome {
    let state = tempfile::tempdir()?;
    let options = ServerOptions {
        state_dir: Some(state.path().to_owned()),
        ..ServerOptions::default()
    };
    let mut last = 1;
    for round in 0..3 {
        let server = Server::start_with(options.clone()).await?;
        let found = server.api().scene().await?;
        ensure!(
            found.revision() >= Some(last),
            "{} after {last}",
            found.etag
        );
        if round > 0 {
            let path = format!("api/v1/scene/revisions/{last}");
            let document = server.get(&path).await?;
            ensure!(
                document["exposure_ev"] == json!(f64::from(round) * 0.1),
                "{document}"
            );
        }
        for number in 0..10 {
            let exposure_ev = f64::from(round + 1) * 0.1;
            let patch = json!({"exposure_ev": exposure_ev, "sun": {"azimuth_deg": number}});
            last = server.patch(&patch).await?;
        }
        server.kill()?;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn the_log_is_one_json_object_a_line_on_request() -> Outcome {
    let server = Server::start_with(ServerOptions {
        arguments: vec!["--log-format".to_owned(), "json".to_owned()],
        environment: vec![("SKYCELL_LISTN".to_owned(), "x".to_owned())],
        ..ServerOptions::default()
    })
    .await?;
    server.patch(&json!({"exposure_ev": 1.0})).await?;
    let log = server.log()?;
    let mut messages = Vec::new();
    for line in log.lines() {
        let entry: Value = serde_json::from_str(line).with_context(|| line.to_owned())?;
        ensure!(
            entry["timestamp"].is_string() && entry["level"].is_string(),
            "{line}"
        );
        messages.push(entry);
    }
    let has = |text: &str| messages.iter().any(|entry| entry["message"] == text);
    ensure!(has("configuration") && has("scene changed"), "{log}");
    let warned = messages
        .iter()
        .find(|entry| entry["message"] == "unknown environment variable")
        .context("no warning of a variable that nobody knows")?;
    ensure!(
        warned["nearest"].to_string().contains("SKYCELL_LISTEN"),
        "{warned}"
    );
    Ok(())
}

/// Names of figures in the expressions of a text.
fn figures_of(text: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for (at, _) in text.match_indices("skycell_") {
        let is_start = !text[..at].ends_with(|c: char| c.is_ascii_alphanumeric() || c == '_');
        let name: String = text[at..]
            .chars()
            .take_while(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || *c == '_')
            .collect();
        if is_start {
            names.insert(name);
        }
    }
    names
}

fn expressions(value: &Value, found: &mut Vec<String>) {
    match value {
        Value::Object(members) => {
            for (key, value) in members {
                match value {
                    Value::String(text) if ["expr", "query", "definition"].contains(&&**key) => {
                        found.push(text.clone());
                    }
                    other => expressions(other, found),
                }
            }
        }
        Value::Array(items) => items.iter().for_each(|item| expressions(item, found)),
        _ => {}
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_figure_of_the_dashboard_and_of_the_alerts_is_one_that_the_server_has() -> Outcome {
    let server = Server::start().await?;
    let viewer = Viewer::join_as(&server, small_hello()?).await?;
    // A while, so that what is counted only when it happens has happened.
    viewer
        .wait_for("frames, and a status of the cache's error", |seen| {
            let audited = seen
                .status
                .as_ref()
                .is_some_and(|status| status.cache_error_p95_percent.is_some());
            seen.frames > 3 && audited
        })
        .await?;
    let page = server.http().get(server.url("metrics")).send().await?;
    let page = page.text().await?;
    let series: BTreeSet<String> = page
        .lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| line.split(['{', ' ']).next())
        .filter(|name| !name.is_empty())
        .map(str::to_owned)
        .collect();

    let deploy = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy");
    let text = std::fs::read_to_string(deploy.join("grafana/skycell.json"))?;
    let dashboard: Value = serde_json::from_str(&text)?;
    let panels = dashboard["panels"].as_array().context("panels")?;
    let ids: BTreeSet<u64> = panels
        .iter()
        .filter_map(|panel| panel["id"].as_u64())
        .collect();
    ensure!(ids.len() == panels.len(), "panels share ids");
    for panel in panels.iter().filter(|panel| panel["type"] != "row") {
        ensure!(
            panel["title"].is_string() && panel["description"].is_string(),
            "a panel says nothing: {panel}"
        );
        ensure!(
            panel["fieldConfig"]["defaults"]["unit"].is_string(),
            "no unit: {panel}"
        );
    }
    let mut asked = Vec::new();
    expressions(&dashboard, &mut asked);
    ensure!(asked.len() > 30, "{} expressions", asked.len());
    for expression in &asked {
        let opened = expression.matches('(').count();
        ensure!(opened == expression.matches(')').count(), "{expression}");
    }
    let alerts = std::fs::read_to_string(deploy.join("prometheus/skycell.rules.yml"))?;
    let mut names = figures_of(&asked.join("\n"));
    let of_dashboard = names.len();
    names.extend(figures_of(&alerts));
    let missing: Vec<&String> = names.difference(&series).collect();
    println!(
        "{} expressions of the dashboard name {of_dashboard} figures, the alerts {} more; the server has {}",
        asked.len(),
        names.len() - of_dashboard,
        series.len()
    );
    ensure!(missing.is_empty(), "the server has no {missing:?}");
    drop(viewer);
    Ok(())
}
