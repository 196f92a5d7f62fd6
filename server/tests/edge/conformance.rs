//! RFC 6455, by the Autobahn test suite: its fuzzing client against this service's WebSocket.
//!
//! `SKYCELL_WSTEST` is its command `wstest`; without it the tests say SKIPPED. `SKYCELL_FULL` runs the large and slow
//! cases too (9.*).

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use axum::Router;
use axum::extract::WebSocketUpgrade;
use axum::routing::get;
use serde_json::{Value, json};
use skycell_server::service::{ConnectionSettings, serve_connections};
use skycell_server::stream::{echo, limit_messages};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use crate::world::start;

/// The largest message of the suite (9.1.6 and 9.2.6), which is more than a viewer may send.
const MESSAGE_MAX_BYTES: usize = 16 << 20;

/// Cases by their verdict.
type Verdicts = BTreeMap<String, Vec<String>>;

fn wstest() -> Option<std::ffi::OsString> {
    let command = std::env::var_os("SKYCELL_WSTEST");
    if command.is_none() {
        println!(
            "SKIPPED: SKYCELL_WSTEST is not set; deploy/test installs the Autobahn test suite and sets it"
        );
    }
    command
}

/// Runs the suite's fuzzing client and returns which cases have which verdict.
async fn run(
    command: std::ffi::OsString,
    server: Value,
    cases: &[&str],
    excluded: &[&str],
    judged: Judged,
) -> Verdicts {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let spec = json!({
        "outdir": folder.path().join("report"), "servers": [server],
        "cases": cases, "exclude-cases": excluded, "exclude-agent-cases": {},
    });
    let spec_file = folder.path().join("spec.json");
    std::fs::write(&spec_file, spec.to_string()).expect("written");
    let mut suite = std::process::Command::new(command);
    suite
        .args(["--mode", "fuzzingclient", "--spec"])
        .arg(&spec_file)
        .current_dir(folder.path());
    let ran = tokio::task::spawn_blocking(move || suite.output())
        .await
        .expect("no panic")
        .expect("wstest starts");
    let said = String::from_utf8_lossy(&ran.stdout) + String::from_utf8_lossy(&ran.stderr);
    assert!(ran.status.success(), "wstest: {said}");
    verdicts(&folder.path().join("report"), judged)
}

/// What is judged of a case.
#[derive(Clone, Copy)]
enum Judged {
    /// How it went and how the connection was closed.
    All,
    /// How the connection was closed.
    Close,
}

/// What the report says: the worse of how the case went and how the connection was closed.
fn verdicts(report: &Path, judged: Judged) -> Verdicts {
    let text = std::fs::read_to_string(report.join("index.json")).expect("a report");
    let index: Value = serde_json::from_str(&text).expect("JSON");
    let cases = index["skycell"].as_object().expect("the agent's cases");
    let mut verdicts = Verdicts::new();
    for (case, result) in cases {
        let (behavior, close) = (&result["behavior"], &result["behaviorClose"]);
        let behavior = behavior.as_str().expect("a verdict");
        let close = close.as_str().expect("a verdict");
        let behavior = match judged {
            Judged::All => behavior,
            Judged::Close => "OK",
        };
        let verdict = match (behavior, close) {
            ("OK", "OK") => "OK".to_owned(),
            ("OK", close) => format!("close {close}"),
            (behavior, _) => behavior.to_owned(),
        };
        verdicts.entry(verdict).or_default().push(case.clone());
    }
    for (verdict, cases) in &mut verdicts {
        cases.sort_by_key(|case| {
            case.split('.')
                .map(|n| n.parse().unwrap_or(0))
                .collect::<Vec<u32>>()
        });
        let list = if verdict == "OK" {
            String::new()
        } else {
            cases.join(" ")
        };
        println!("{verdict}: {} {list}", cases.len());
    }
    verdicts
}

/// No case may have another verdict than these.
fn assert_conforms(verdicts: &Verdicts, cases_min: usize) {
    const PASSED: [&str; 4] = ["OK", "NON-STRICT", "INFORMATIONAL", "close INFORMATIONAL"];
    let failed: Vec<_> = verdicts
        .iter()
        .filter(|(verdict, _)| !PASSED.contains(&verdict.as_str()))
        .collect();
    assert!(failed.is_empty(), "{failed:?}");
    let ran: usize = verdicts.values().map(Vec::len).sum();
    assert!(ran >= cases_min, "only {ran} cases ran");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_websocket_of_the_service_passes_the_autobahn_test_suite() {
    let Some(command) = wstest() else { return };
    let say_back = async |upgrade: WebSocketUpgrade| {
        limit_messages(upgrade, MESSAGE_MAX_BYTES).on_upgrade(echo)
    };
    let router = Router::new().route("/", get(say_back));
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("listens");
    let address = listener.local_addr().expect("an address");
    let settings = ConnectionSettings {
        proxies: Arc::default(),
        tls: None,
        per_peer_max: 16,
        gate: None,
    };
    let shutdown = CancellationToken::new();
    let server = tokio::spawn(serve_connections(
        listener,
        router,
        settings,
        shutdown.clone(),
    ));
    // Compression is not negotiated, so its cases are not this server's.
    let mut excluded = vec!["12.*", "13.*"];
    let is_full = std::env::var_os("SKYCELL_FULL").is_some();
    if !is_full {
        excluded.push("9.*");
    }
    let server_spec = json!({"agent": "skycell", "url": format!("ws://{address}/")});
    let verdicts = run(command, server_spec, &["*"], &excluded, Judged::All).await;
    assert_conforms(&verdicts, if is_full { 301 } else { 247 });
    shutdown.cancel();
    server.await.expect("no panic");
}

#[tokio::test(flavor = "multi_thread")]
async fn viewers_connections_pass_the_cases_that_need_no_echo() {
    let Some(command) = wstest() else { return };
    let world = start().await;
    let server = json!({
        "agent": "skycell", "url": format!("ws://{}/ws", world.address()), "protocols": ["skycell.v1"],
    });
    // Pings, and how a connection is closed by the client.
    let quiet = [
        "2.1", "2.2", "2.3", "2.4", "2.6", "2.7", "2.8", "2.9", "2.10", "2.11", "7.1.2", "7.1.3",
        "7.1.4", "7.1.5", "7.3.1", "7.3.3", "7.3.4", "7.3.5", "7.7.*", "7.9.*",
    ];
    let verdicts = run(command.clone(), server.clone(), &quiet, &[], Judged::All).await;
    assert_conforms(&verdicts, 40);
    // Violations: the error message that this protocol sends before it closes is none of the suite's.
    let violations = ["2.5", "3.*", "4.*", "7.3.2", "7.3.6", "7.5.1"];
    let verdicts = run(command, server, &violations, &[], Judged::Close).await;
    assert_conforms(&verdicts, 21);
    world.goes_on().await;
}
