//! Figures, health, the page, and errors of resources that do not exist.

use std::time::Duration;

use reqwest::Method;
use serde_json::{Value, json};

use crate::client::Client;
use crate::stand_in::Behaviour;
use crate::world::{start, start_with};

#[tokio::test(flavor = "multi_thread")]
async fn the_figures_tell_of_viewers_cells_and_frames() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    let until = tokio::time::Instant::now() + Duration::from_millis(1500);
    let mut frames = 0;
    while tokio::time::Instant::now() < until {
        client.frame().await;
        frames += 1;
    }
    // Figures are published a moment after the frames that they count.
    tokio::time::sleep(Duration::from_millis(300)).await;
    let viewers = world.get_json("/api/v1/viewers").await;
    let viewer = &viewers[0];
    assert_eq!((&viewer["id"], &viewer["cell"]), (&json!(1), &json!(0)));
    assert_eq!(
        (&viewer["width"], &viewer["codec"]),
        (&json!(64), &json!("png"))
    );
    assert_eq!(viewer["decode_us"], 1500);
    assert_eq!(viewer["texels_requested"], 1234);
    assert!(
        viewer["fps"].as_f64().is_some_and(|fps| fps > 5.0),
        "{viewer}"
    );
    assert!(
        viewer["mbit_per_s"].as_f64().is_some_and(|rate| rate > 0.1),
        "{viewer}"
    );
    let age_ms = |key: &str| viewer[key].as_f64().expect("an age");
    assert!(age_ms("frame_age_p50_ms") > 0.0);
    assert!(age_ms("frame_age_p50_ms") <= age_ms("frame_age_p95_ms"));
    assert!(
        viewer["frames_sent"]
            .as_u64()
            .is_some_and(|sent| sent >= frames)
    );

    let cells = world.get_json("/api/v1/cells").await;
    assert_eq!(
        (&cells[0]["name"], &cells[0]["viewers"]),
        (&json!("everywhere"), &json!([1]))
    );
    let stats = world.get_json("/api/v1/stats").await;
    assert_eq!(stats["adapter"]["name"], "stand-in");
    assert_eq!(
        (&stats["samples"], &stats["service"]["viewers"]),
        (&json!(8), &json!(1))
    );
    assert!(
        stats["totals"]["frames_composited"]
            .as_u64()
            .is_some_and(|n| n >= frames)
    );

    let response = world.get("/metrics").await;
    assert!(
        response.headers()["content-type"]
            .to_str()
            .expect("text")
            .starts_with("text/plain")
    );
    let page = response.text().await.expect("text");
    let value = |name: &str| -> f64 {
        page.lines()
            .find_map(|line| line.strip_prefix(name)?.trim().parse().ok())
            .unwrap_or_else(|| panic!("{name} in\n{page}"))
    };
    assert_eq!(value("skycell_viewers "), 1.0);
    assert!(value("skycell_frames_sent_total ") >= frames as f64);
    assert!(value("skycell_bytes_sent_total ") > 1000.0);
    assert!(value("skycell_encode_seconds_count{codec=\"png\"} ") >= frames as f64);
    assert!(value("skycell_frame_age_seconds_count ") >= 1.0);
    assert_eq!(
        value("skycell_cell_overlap{cell=\"0\",name=\"everywhere\"} "),
        0.0
    );
    assert!(value("skycell_frames_composited_total ") >= frames as f64);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_is_alive_before_it_is_ready() {
    let behaviour = Behaviour {
        never_ready: true,
        ..Behaviour::default()
    };
    let world = start_with(behaviour, |_| {}).await;
    assert_eq!(world.get("/livez").await.status(), 200);
    let response = world.get("/readyz").await;
    assert_eq!(response.status(), 503);
    assert_eq!(
        response.headers()["content-type"],
        "application/problem+json"
    );

    let world = start().await;
    // The stand-in's thread may not have come to it yet.
    for _ in 0..100 {
        if world.get("/readyz").await.status() == 200 {
            return;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("never ready");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_does_not_exist_is_told_as_a_problem() {
    let world = start().await;
    for (method, path, status) in [
        (Method::GET, "/api/v1/sceen", 404),
        (Method::GET, "/api/v2/scene", 404),
        (Method::GET, "/../Cargo.toml", 404),
        (Method::POST, "/nothing", 404),
        (Method::DELETE, "/api/v1/scene", 405),
        (Method::POST, "/metrics", 405),
        (Method::POST, "/", 405),
    ] {
        let response = world.request(method, path).send().await.expect("an answer");
        assert_eq!(response.status(), status, "{path}");
        assert_eq!(
            response.headers()["content-type"],
            "application/problem+json"
        );
        if status == 405 && path != "/" {
            assert!(response.headers().contains_key("allow"), "{path}");
        }
        let problem: Value = response.json().await.expect("JSON");
        assert_eq!(problem["status"], status);
        assert!(
            problem["detail"]
                .as_str()
                .is_some_and(|detail| !detail.is_empty())
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_is_served_and_locked_down() {
    let world = start().await;
    let page = world.get("/").await;
    assert_eq!(page.status(), 200);
    for (name, part) in [
        ("content-type", "text/html"),
        ("x-content-type-options", "nosniff"),
        ("cache-control", "no-cache"),
        ("content-security-policy", "default-src 'none'"),
        ("x-frame-options", "DENY"),
        ("referrer-policy", "no-referrer"),
    ] {
        let value = page.headers()[name].to_str().expect("text");
        assert!(value.contains(part), "{name}: {value}");
    }
    assert!(page.text().await.expect("text").contains("Skycell"));
}
