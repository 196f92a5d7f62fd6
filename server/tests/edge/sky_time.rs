//! `/api/v1/scene/time`, `/now`, `/events` and `/preset`.

use reqwest::{Method, Response};
use serde_json::{Value, json};

use crate::world::{World, start};

async fn send(world: &World, method: Method, path: &str, body: Value) -> Response {
    world
        .request(method, path)
        .header("content-type", "application/json")
        .header("if-match", "*")
        .body(body.to_string())
        .send()
        .await
        .expect("an answer")
}

async fn put_time(world: &World, body: Value) -> Response {
    send(world, Method::PUT, "/api/v1/scene/time", body).await
}

async fn refused(response: Response, pointer: &str) {
    assert_eq!(response.status(), 422);
    let problem: Value = response.json().await.expect("JSON");
    assert_eq!(problem["pointer"], pointer, "{problem}");
}

fn number(value: &Value, pointer: &str) -> f64 {
    value
        .pointer(pointer)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("{pointer} of {value}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_sky_is_paused_set_and_goes_on_without_its_clouds_moving_at_once() {
    let world = start().await;
    let time = world.get_json("/api/v1/scene/time").await;
    assert!(
        number(&time, "/sky_s") < 60.0,
        "sky time 0 is when the scene was made: {time}"
    );
    assert_eq!(time["paused"], false);

    let paused = put_time(&world, json!({"paused": true, "sky_s": 7200})).await;
    assert_eq!(paused.headers()["etag"], "\"2\"");
    let paused: Value = paused.json().await.expect("JSON");
    assert_eq!(number(&paused, "/sky_s"), 7200.0);
    let before = world
        .get_json("/api/v1/scene/now?at=2050-01-01T00:00:00Z")
        .await;
    assert_eq!(number(&before, "/sky_s"), 7200.0);
    let east_m = number(&before, "/carried_m/0/0");
    assert!(east_m.abs() < 300.0, "clouds went {east_m} m in no time");

    let resumed: Value = put_time(
        &world,
        json!({"paused": false, "rate": -24, "wind_rate": 1}),
    )
    .await
    .json()
    .await
    .expect("JSON");
    let sky_s = number(&resumed, "/sky_s");
    assert!(sky_s <= 7200.0 && sky_s > 7200.0 - 24.0 * 60.0, "{resumed}");
    let later = world
        .get_json("/api/v1/scene/now?at=2050-01-01T00:00:00Z")
        .await;
    assert!(
        number(&later, "/carried_m/0/0") > 1e6,
        "the wind blows forwards"
    );
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_date_sets_the_clock_where_the_sun_stands_by_place() {
    let world = start().await;
    refused(
        put_time(&world, json!({"date": "2026-06-21T18:00:00Z"})).await,
        "/date",
    )
    .await;
    let place = json!({"sun": {"place_and_time": {"latitude_deg": 48.2, "longitude_deg": 16.4}}});
    assert_eq!(
        world.patch(Some("*"), &place.to_string()).await.status(),
        200
    );
    let change = json!({"date": "2026-06-21T18:00:00Z", "paused": true});
    let time: Value = put_time(&world, change).await.json().await.expect("JSON");
    assert_eq!(time["date"], "2026-06-21T18:00:00Z");
    // An hour before sunset in Vienna.
    let elevation_deg = number(&time, "/sun/elevation_deg");
    assert!((5.0..12.0).contains(&elevation_deg), "{elevation_deg}");
    let azimuth_deg = number(&time, "/sun/azimuth_deg");
    assert!((285.0..305.0).contains(&azimuth_deg), "{azimuth_deg}");
}

#[tokio::test(flavor = "multi_thread")]
async fn wrong_changes_of_the_clock_are_named_and_change_nothing() {
    let world = start().await;
    for (body, pointer) in [
        (json!({"rate": 1e9}), "/time/rate"),
        (json!({"rate": "fast"}), "/rate"),
        (json!({"paused": 1}), "/paused"),
        (json!({"sky_s": 1e12}), "/time/sky_s_at_epoch"),
        (json!({"wind_rate": -1e9}), "/time/wind_rate"),
        (json!({"hour": 7}), "/hour"),
        (json!([]), ""),
    ] {
        refused(put_time(&world, body).await, pointer).await;
    }
    let no_tag = world
        .request(Method::PUT, "/api/v1/scene/time")
        .header("content-type", "application/json")
        .body("{}")
        .send()
        .await
        .expect("an answer");
    assert_eq!(no_tag.status(), 428);
    assert_eq!(world.get("/api/v1/scene/now?at=never").await.status(), 422);
    assert_eq!(world.get("/api/v1/scene").await.headers()["etag"], "\"1\"");
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_preset_comes_over_its_time_and_can_be_left_on_the_way() {
    let world = start().await;
    let presets = world.get_json("/api/v1/presets").await;
    let names: Vec<&str> = presets
        .as_array()
        .expect("a list")
        .iter()
        .map(|preset| preset["name"].as_str().expect("a name"))
        .collect();
    assert!(names.len() >= 10 && names.contains(&"storm"), "{names:?}");
    let set = |name: &'static str, transition_s: f64| {
        send(
            &world,
            Method::POST,
            "/api/v1/scene/preset",
            json!({"name": name, "transition_s": transition_s}),
        )
    };
    refused(set("strom", 1.0).await, "/name").await;
    refused(set("storm", -1.0).await, "/transition_s").await;
    assert_eq!(world.get("/api/v1/presets/strom").await.status(), 404);

    let answer = set("storm", 3600.0).await;
    assert_eq!(answer.headers()["etag"], "\"2\"");
    let storm = world.get_json("/api/v1/presets/storm").await;
    let now = world.get_json("/api/v1/scene/now").await;
    assert!(number(&now, "/transition") < 0.001);
    // Hardly anything of the storm yet: the default sun.
    assert!((number(&now, "/scene/sun/elevation_deg") - 40.0).abs() < 0.1);

    // Half an hour later by the clock, the sky is halfway.
    let document = world.get_json("/api/v1/scene").await;
    let began = document["transition"]["began"].as_str().expect("a date");
    let began: skycell_protocol::Moment =
        skycell_protocol::Moment::parse(began, "").expect("a date");
    let half = world
        .get_json(&format!("/api/v1/scene/now?at={}", began.plus_s(1800.0)))
        .await;
    let expected = (40.0 + number(&storm, "/scene/sun/elevation_deg")) / 2.0;
    assert!((number(&half, "/scene/sun/elevation_deg") - expected).abs() < 1e-9);
    let end = world
        .get_json(&format!("/api/v1/scene/now?at={}", began.plus_s(3600.0)))
        .await;
    assert_eq!(end["scene"]["layers"], storm["scene"]["layers"]);

    // Another one on the way: nothing jumps, and it comes from what is seen.
    let before = world.get_json("/api/v1/scene/now").await;
    set("overcast", 60.0).await;
    let after = world.get_json("/api/v1/scene/now").await;
    let change =
        number(&after, "/scene/sun/elevation_deg") - number(&before, "/scene/sun/elevation_deg");
    assert!(change.abs() < 0.1, "{change}");
    assert_eq!(set("haze", 0.0).await.status(), 200);
    let haze = world.get_json("/api/v1/scene").await;
    assert_eq!(haze["transition"], Value::Null);
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_servers_with_one_document_show_one_sky() {
    let (a, b) = (start().await, start().await);
    let patch = json!({
        "time": {"rate": 24}, "sun": {"place_and_time": {"latitude_deg": 60}},
        "animation": [{"path": "/layers/0/density/coverage", "repeat": "ping-pong", "keyframes": [
            {"at_s": 0, "value": 0}, {"at_s": 60, "value": 1, "ease": "smooth"}]}],
    });
    assert_eq!(a.patch(Some("*"), &patch.to_string()).await.status(), 200);
    let preset = json!({"name": "broken-sunset", "transition_s": 1000});
    assert_eq!(
        send(&a, Method::POST, "/api/v1/scene/preset", preset)
            .await
            .status(),
        200
    );
    assert_eq!(put_time(&a, json!({"rate": 240})).await.status(), 200);
    let document = a.get_json("/api/v1/scene").await;
    assert_ne!(document["drift"], Value::Null);
    assert_eq!(
        b.patch(Some("*"), &document.to_string()).await.status(),
        200
    );
    assert_eq!(b.get_json("/api/v1/scene").await, document);
    for at in [
        "1950-01-01T00:00:00Z",
        "2026-06-21T10:00:00Z",
        "2099-01-01T00:00:00Z",
        "1800000000.5",
    ] {
        let path = format!("/api/v1/scene/now?at={at}");
        let mut of_a = a.get_json(&path).await;
        let mut of_b = b.get_json(&path).await;
        // Each server counts its own changes.
        of_a["revision"] = json!(0);
        of_b["revision"] = json!(0);
        assert_eq!(of_a, of_b, "{at}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_animation_changes_what_is_shown_and_neither_document_nor_revision() {
    let world = start().await;
    let patch = json!({"animation": [{"path": "/exposure_ev", "repeat": "ping-pong", "keyframes": [
        {"at_s": 0, "value": -2}, {"at_s": 0.2, "value": 2}]}]});
    assert_eq!(
        world.patch(Some("*"), &patch.to_string()).await.status(),
        200
    );
    let document = world.get_json("/api/v1/scene").await;
    let mut seen = Vec::new();
    for _ in 0..5 {
        let now = world.get_json("/api/v1/scene/now").await;
        assert_eq!(now["revision"], 2);
        seen.push(number(&now, "/scene/exposure_ev"));
        tokio::time::sleep(std::time::Duration::from_millis(37)).await;
    }
    assert!(seen.iter().any(|ev| *ev != seen[0]), "{seen:?}");
    assert_eq!(world.get_json("/api/v1/scene").await, document);
}

#[tokio::test(flavor = "multi_thread")]
async fn events_tell_of_the_scene_at_once_and_of_every_change() {
    let world = start().await;
    let mut events = world.get("/api/v1/scene/events").await;
    assert_eq!(events.headers()["content-type"], "text/event-stream");
    let mut text = String::new();
    let mut read_until = async |wanted: &str| {
        while !text.contains(wanted) {
            let chunk = tokio::time::timeout(std::time::Duration::from_secs(5), events.chunk());
            let chunk = chunk
                .await
                .expect("in time")
                .expect("a stream")
                .expect("more");
            text.push_str(&String::from_utf8_lossy(&chunk));
        }
    };
    read_until("\"revision\":1,").await;
    world.patch(Some("*"), "{\"exposure_ev\": 1}").await;
    read_until("\"revision\":2,").await;
    put_time(&world, json!({"paused": true})).await;
    read_until("\"paused\":true").await;
    world.goes_on().await;
    // A server that ends does not wait for those who listen.
    let World { service, .. } = world;
    let ended = tokio::time::timeout(std::time::Duration::from_secs(4), service.shutdown());
    ended.await.expect("in time");
}
