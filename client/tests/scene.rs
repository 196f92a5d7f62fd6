//! The scene over HTTP, by the library and by the binary.

mod support;

use std::process::{Command, Output};

use serde_json::{Value, json};
use skycell_client::HttpApiError;
use support::{Behaviour, FakeServer};

async fn skycell(arguments: &[&str], server: &FakeServer) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_skycell"));
    command
        .args(arguments)
        .args(["--url", &server.address.to_string()]);
    tokio::task::spawn_blocking(move || command.output())
        .await
        .expect("no panic")
        .expect("the binary runs")
}

#[tokio::test]
async fn a_patch_of_a_stale_revision_is_refused_in_the_servers_words() {
    let server = FakeServer::start(Behaviour::default()).await;
    let error = server
        .api()
        .patch_scene(&json!({"exposure_ev": 1}), "\"0\"")
        .await
        .expect_err("stale");
    assert!(
        error
            .to_string()
            .contains("412 Precondition Failed: the scene has another revision"),
        "{error}"
    );
}

#[tokio::test]
async fn a_patch_of_the_current_scene_outlasts_others_but_not_for_ever() {
    let patch = json!({"exposure_ev": 1});
    let contended = |lost_races| Behaviour {
        lost_races,
        ..Behaviour::default()
    };
    let server = FakeServer::start(contended(3)).await;
    let scene = server
        .api()
        .patch_current_scene(&patch)
        .await
        .expect("the fourth try");
    assert_eq!(
        (scene.revision(), &scene.document["exposure_ev"]),
        (Some(5), &json!(1))
    );

    let server = FakeServer::start(contended(1_000)).await;
    let error = server
        .api()
        .patch_current_scene(&patch)
        .await
        .expect_err("never first");
    assert!(matches!(error, HttpApiError::Refused { .. }), "{error}");
}

#[tokio::test]
async fn the_binary_gets_patches_and_watches() {
    let server = FakeServer::start(Behaviour::default()).await;
    let output = skycell(
        &["scene", "patch", "{\"exposure_ev\": 2}", "--json"],
        &server,
    )
    .await;
    assert!(output.status.success(), "{output:?}");
    let line: Value = serde_json::from_slice(&output.stdout).expect("a JSON line");
    assert_eq!(
        (&line["revision"], &line["scene"]["exposure_ev"]),
        (&json!(2), &json!(2))
    );

    let output = skycell(&["scene", "get"], &server).await;
    let scene: Value = serde_json::from_slice(&output.stdout).expect("the document alone");
    assert_eq!(scene["exposure_ev"], 2);

    let output = skycell(&["scene", "watch", "--for-s", "1", "--json"], &server).await;
    assert!(output.status.success(), "{output:?}");
    assert_eq!(
        output.stdout.iter().filter(|byte| **byte == b'\n').count(),
        1
    );
}

#[tokio::test]
async fn the_binary_says_what_is_wrong_and_fails() {
    let server = FakeServer::start(Behaviour::default()).await;
    for (arguments, part) in [
        (&["scene", "patch", "[1]"][..], "allowed: an object"),
        (&["scene", "patch", "{"], "the patch is not JSON"),
        (
            &["scene", "patch", "{}", "--if-match", "7"],
            "412 Precondition Failed",
        ),
        (
            &["load", "--viewers", "0"],
            "/viewers is 0; allowed: 1 to 128",
        ),
        (
            &["load", "--overlaps", "0,101"],
            "--overlaps is 101; allowed: 0 to 100",
        ),
        (&["load", "--width", "0"], "/width is 0"),
        (
            &["load", "--width", "2000", "--stereo", "0.064"],
            "/width is 2000; allowed: 1 to 1920 for each of two eyes",
        ),
        (
            &["record", "--out", "unused", "--stereo", "-1"],
            "/eye_distance_m is -1; allowed: 0 to 100",
        ),
        (
            &["record", "--out", "unused", "--fps", "0"],
            "--fps is 0; allowed: 1 to 120",
        ),
        (
            &["record", "--out", "unused", "--path", "no-such-file.json"],
            "no-such-file.json",
        ),
    ] {
        let output = skycell(arguments, &server).await;
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {text}");
        assert!(text.contains(part), "{arguments:?}: {text}");
    }
}

#[tokio::test]
async fn every_command_explains_itself_with_an_example() {
    let server = FakeServer::start(Behaviour::default()).await;
    for command in [
        &["record"][..],
        &["load"],
        &["scene"],
        &["scene", "get"],
        &["scene", "patch"],
        &["scene", "watch"],
    ] {
        let output = skycell(&[command, &["--help"]].concat(), &server).await;
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(
            text.contains("Example") && text.contains("  skycell "),
            "{command:?}: {text}"
        );
    }
}
