//! What is acknowledged survives a server that is killed at any instant.
//!
//! The killed process is this test binary itself: the same store behind the same HTTP edge, with a stand-in for the
//! renderer, so that it starts fast enough to be killed a hundred times.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::{Value, json};
use skycell_server::scene::SceneStore;

use crate::stand_in::Behaviour;
use crate::world::start_in;

const STATE_VARIABLE: &str = "KILLED_SERVER_STATE";
const ADDRESS_MARK: &str = "listening on ";
const CLIENTS: u64 = 3;

#[tokio::test(flavor = "multi_thread")]
#[ignore = "the process that the other tests kill"]
async fn serves_until_it_is_killed() {
    let Some(folder) = std::env::var_os(STATE_VARIABLE) else {
        return;
    };
    let (service, _renderer) = start_in(Path::new(&folder), Behaviour::default(), |_| {}).await;
    println!("{ADDRESS_MARK}{}", service.address());
    std::future::pending::<()>().await;
}

/// A server in a process of its own; killed (SIGKILL on Unix) when dropped.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts a server; its address comes when it listens.
fn spawn(folder: &Path) -> (Killed, mpsc::Receiver<SocketAddr>) {
    let mut child = Command::new(std::env::current_exe().expect("this binary"))
        .args(["--exact", "durability::serves_until_it_is_killed"])
        .args(["--ignored", "--nocapture"])
        .env(STATE_VARIABLE, OsString::from(folder))
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts");
    let stdout = child.stdout.take().expect("a pipe");
    let (sender, address) = mpsc::channel();
    std::thread::spawn(move || {
        for line in BufReader::new(stdout).lines().map_while(Result::ok) {
            // The test harness writes the test's name before.
            if let Some((_, address)) = line.split_once(ADDRESS_MARK) {
                let _ = sender.send(address.parse().expect("an address"));
            }
        }
    });
    (Killed(child), address)
}

/// What the server has acknowledged: the sun's azimuth by revision.
#[derive(Clone, Default)]
struct Acknowledged(Arc<Mutex<BTreeMap<u64, f64>>>);

impl Acknowledged {
    fn note(&self, revision: u64, azimuth_deg: f64) {
        let mut known = self.0.lock().expect("not poisoned");
        let twice = known.insert(revision, azimuth_deg);
        assert_eq!(twice, None, "revision {revision} was given twice");
    }

    fn newest(&self) -> u64 {
        let known = self.0.lock().expect("not poisoned");
        known.last_key_value().map_or(0, |(revision, _)| *revision)
    }

    fn after(&self, revision: u64) -> Vec<(u64, f64)> {
        let known = self.0.lock().expect("not poisoned");
        known.range(revision..).map(|(r, a)| (*r, *a)).collect()
    }
}

fn revision_of(response: &reqwest::Response) -> u64 {
    let tag = response.headers()["etag"].to_str().expect("a tag");
    tag.trim_matches('"').parse().expect("a number")
}

/// Patches until the server is gone. Every patch has another azimuth. `query` may name a group.
async fn patch_on(
    address: SocketAddr,
    client: u64,
    query: &str,
    counter: Arc<Mutex<u64>>,
    all: Acknowledged,
) {
    let http = reqwest::Client::new();
    let mut last = 0;
    loop {
        let azimuth_deg = {
            let mut count = counter.lock().expect("not poisoned");
            *count += 1;
            (*count % 35_999) as f64 * 0.01
        };
        let sent = http
            .patch(format!("http://{address}/api/v1/scene{query}"))
            .header("content-type", "application/merge-patch+json")
            .header("if-match", "*")
            .body(json!({"sun": {"azimuth_deg": azimuth_deg}}).to_string())
            .send()
            .await;
        let Ok(response) = sent else { return };
        assert_eq!(response.status(), 200, "client {client}");
        let revision = revision_of(&response);
        assert!(revision > last, "client {client}: {revision} after {last}");
        last = revision;
        all.note(revision, azimuth_deg);
    }
}

/// Everything that was acknowledged is there, over HTTP.
async fn check(address: SocketAddr, all: &Acknowledged, checked: u64) {
    let get = async |path: String| {
        let response = reqwest::get(format!("http://{address}{path}")).await;
        let response = response.expect("an answer");
        assert_eq!(response.status(), 200, "{path}");
        response
    };
    let newest = revision_of(&get("/api/v1/scene".to_owned()).await);
    assert!(newest >= all.newest(), "{newest} after {}", all.newest());
    // What was under way when the server was killed may be there, and nothing else.
    assert!(newest <= all.newest().max(1) + CLIENTS, "{newest}");
    let page: Value = get("/api/v1/scene/revisions?limit=100".to_owned())
        .await
        .json()
        .await
        .expect("JSON");
    let numbers: Vec<u64> = page["revisions"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|revision| revision["revision"].as_u64().expect("a number"))
        .collect();
    let oldest = newest.saturating_sub(99).max(1);
    assert!(
        numbers.iter().copied().eq((oldest..=newest).rev()),
        "{numbers:?}"
    );
    for (revision, azimuth_deg) in all.after(checked.max(newest.saturating_sub(20))) {
        let path = format!("/api/v1/scene/revisions/{revision}");
        let document: Value = get(path).await.json().await.expect("JSON");
        let found = document["sun"]["azimuth_deg"].as_f64().expect("a number");
        assert!((found - azimuth_deg).abs() < 1e-9, "revision {revision}");
    }
}

/// Kills a server that many times; returns how many patches were acknowledged.
async fn kill_at_random_instants(rounds: u32) -> usize {
    // As in `world`: any client that may speak TLS asks for it.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let counter = Arc::new(Mutex::new(0));
    let all = Acknowledged::default();
    let mut checked = 0;
    let mut killed_before_it_listened = 0;
    for round in 0..=rounds {
        let (server, address) = spawn(folder.path());
        if round % 4 == 3 && round < rounds {
            // While it starts, too.
            tokio::time::sleep(Duration::from_micros(fastrand::u64(0..60_000))).await;
            killed_before_it_listened += u32::from(address.try_recv().is_err());
            drop(server);
            continue;
        }
        let waited =
            tokio::task::spawn_blocking(move || address.recv_timeout(Duration::from_secs(30)));
        let address = waited.await.expect("no panic").expect("an address");
        check(address, &all, checked).await;
        checked = all.newest();
        if round == rounds {
            break;
        }
        let clients: Vec<_> = (0..CLIENTS)
            .map(|client| {
                let (counter, all) = (Arc::clone(&counter), all.clone());
                tokio::spawn(patch_on(address, client, "", counter, all))
            })
            .collect();
        tokio::time::sleep(Duration::from_micros(fastrand::u64(0..200_000))).await;
        drop(server);
        for client in clients {
            client.await.expect("no client saw anything wrong");
        }
    }
    // All of them, not only those whose documents were asked for.
    let store = SceneStore::open(folder.path().to_owned()).expect("opens");
    let kept = store.revisions();
    for revision in &kept {
        if let Some((_, azimuth_deg)) = all
            .after(revision.revision)
            .first()
            .filter(|(number, _)| *number == revision.revision)
        {
            assert!((revision.scene.sun().azimuth_deg() - azimuth_deg).abs() < 1e-9);
        }
    }
    let count = all.after(0).len();
    println!(
        "killed {rounds} times, {killed_before_it_listened} of them before it listened; {count} patches acknowledged, \
         all there; newest revision {}",
        store.snapshot().revision
    );
    count
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_acknowledged_survives_a_hundred_kills_at_random_instants() {
    assert!(kill_at_random_instants(100).await > 100);
}

#[tokio::test(flavor = "multi_thread")]
async fn every_acknowledged_change_of_a_drag_survives_a_kill_and_each_drag_is_one_revision() {
    const ROUNDS: u64 = 12;
    let _ = rustls::crypto::ring::default_provider().install_default();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let counter = Arc::new(Mutex::new(0));
    let all = Acknowledged::default();
    let mut before = 1;
    for _ in 0..ROUNDS {
        let (server, address) = spawn(folder.path());
        let waited =
            tokio::task::spawn_blocking(move || address.recv_timeout(Duration::from_secs(30)));
        let address = waited.await.expect("no panic").expect("an address");
        let dragging = patch_on(address, 0, "?group=drag", Arc::clone(&counter), all.clone());
        let dragging = tokio::spawn(dragging);
        tokio::time::sleep(Duration::from_micros(fastrand::u64(20_000..150_000))).await;
        drop(server);
        dragging.await.expect("the client saw nothing wrong");

        let store = SceneStore::open(folder.path().to_owned()).expect("opens");
        let (newest, kept) = (store.snapshot(), store.revisions());
        assert!(
            newest.revision >= all.newest(),
            "an acknowledged change is lost"
        );
        // And one more at most, that was written and not acknowledged any more.
        assert!(newest.revision <= all.newest().max(before) + 1);
        before = newest.revision;
        if let Some((_, azimuth_deg)) = all.after(newest.revision).first() {
            assert!((newest.scene.sun().azimuth_deg() - azimuth_deg).abs() < 1e-9);
        }
        for pair in kept.windows(2) {
            assert_eq!(pair[1].first, pair[0].revision + 1, "nothing is missing");
        }
        assert!(kept.len() as u64 <= 1 + ROUNDS, "{} revisions", kept.len());
    }
    let changes = all.after(0).len();
    println!("{changes} changes of {ROUNDS} drags acknowledged, all there");
    assert!(changes as u64 > 2 * ROUNDS);
}
