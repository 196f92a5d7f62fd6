//! `/api/v1/scene`.

use reqwest::{Method, Response};
use serde_json::{Value, json};

use crate::client::Client;
use crate::stand_in::Behaviour;
use crate::world::{start, start_in};

async fn problem(response: Response, status: u16) -> Value {
    assert_eq!(response.status(), status);
    assert_eq!(
        response.headers()["content-type"],
        "application/problem+json"
    );
    let problem: Value = response.json().await.expect("JSON");
    assert_eq!(problem["status"], status);
    problem
}

#[tokio::test(flavor = "multi_thread")]
async fn a_patch_with_the_right_tag_changes_the_scene_and_reaches_the_viewers() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    client.frame_with(|header| header.scene_revision == 1).await;
    let before = world.get("/api/v1/scene").await;
    assert_eq!(before.headers()["etag"], "\"1\"");
    let mut document: Value = before.json().await.expect("JSON");
    assert_eq!(document["version"], 1);

    let response = world
        .patch(Some("\"1\""), "{\"sun\": {\"elevation_deg\": 5}}")
        .await;
    assert_eq!(response.status(), 200);
    assert_eq!(response.headers()["etag"], "\"2\"");
    document["sun"]["elevation_deg"] = json!(5.0);
    assert_eq!(response.json::<Value>().await.expect("JSON"), document);
    assert_eq!(world.get_json("/api/v1/scene").await, document);
    client.frame_with(|header| header.scene_revision == 2).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_patch_without_a_tag_is_428_and_with_a_stale_one_412() {
    let world = start().await;
    let missing = world.patch(None, "{\"exposure_ev\": 1}").await;
    let missing = problem(missing, 428).await;
    assert!(
        missing["detail"]
            .as_str()
            .is_some_and(|detail| detail.contains("If-Match"))
    );
    assert_eq!(
        world
            .patch(Some("\"1\""), "{\"exposure_ev\": 1}")
            .await
            .status(),
        200
    );
    let stale = world.patch(Some("\"1\""), "{\"exposure_ev\": 2}").await;
    assert_eq!(stale.headers()["etag"], "\"2\"");
    problem(stale, 412).await;
    problem(world.patch(Some("W/\"2\""), "{}").await, 412).await;
    assert_eq!(world.get_json("/api/v1/scene").await["exposure_ev"], 1.0);
    assert_eq!(
        world
            .patch(Some("*"), "{\"exposure_ev\": 3}")
            .await
            .status(),
        200
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn of_patches_that_race_with_one_tag_exactly_one_wins() {
    let world = start().await;
    let patches = (1..=8).map(|number| {
        let world = &world;
        async move {
            let body = format!("{{\"exposure_ev\": {number}}}");
            world.patch(Some("\"1\""), &body).await.status().as_u16()
        }
    });
    let mut statuses = futures_util::future::join_all(patches).await;
    statuses.sort_unstable();
    assert_eq!(statuses, [200, 412, 412, 412, 412, 412, 412, 412]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bad_patch_is_refused_with_pointer_value_and_range() {
    let world = start().await;
    let bad = world
        .patch(
            Some("*"),
            "{\"layers\": [{\"density\": {\"model\": \"weather\", \"coverage\": 7}}]}",
        )
        .await;
    let bad = problem(bad, 422).await;
    assert_eq!(bad["pointer"], "/layers/0/density/coverage");
    assert_eq!(
        (&bad["value"], &bad["allowed"]),
        (&json!("7"), &json!("0 to 1"))
    );

    let unknown = problem(world.patch(Some("*"), "{\"exposure\": 1}").await, 422).await;
    assert_eq!(unknown["pointer"], "/exposure");
    assert!(
        unknown["allowed"]
            .as_str()
            .is_some_and(|text| text.contains("exposure_ev"))
    );

    for body in [
        "{\"exposure_ev\": NaN}",
        "{\"exposure_ev\": ",
        "",
        "{\"exposure_ev\": 1e999}",
    ] {
        problem(world.patch(Some("*"), body).await, 400).await;
    }
    // Not an object: by RFC 7396 it would replace the whole document.
    problem(world.patch(Some("*"), "[1]").await, 422).await;
    let deep = format!("{}{}", "{\"a\":".repeat(5000), "1");
    problem(world.patch(Some("*"), &deep).await, 400).await;
    let large = format!("{{\"exposure_ev\": {}1}}", " ".repeat(70_000));
    problem(world.patch(Some("*"), &large).await, 413).await;
    assert_eq!(world.get("/api/v1/scene").await.headers()["etag"], "\"1\"");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_patch_of_another_type_is_415_and_says_which_is_right() {
    let world = start().await;
    for kind in [Some("application/json"), Some("text/plain"), None] {
        let mut request = world
            .request(Method::PATCH, "/api/v1/scene")
            .header("if-match", "*")
            .body("{}");
        if let Some(kind) = kind {
            request = request.header("content-type", kind);
        }
        let response = request.send().await.expect("an answer");
        assert_eq!(
            response.headers()["accept-patch"],
            "application/merge-patch+json, application/json-patch+json"
        );
        problem(response, 415).await;
    }
    let with_charset = world
        .request(Method::PATCH, "/api/v1/scene")
        .header("if-match", "*")
        .header(
            "content-type",
            "application/merge-patch+json; charset=utf-8",
        )
        .body("{}");
    assert_eq!(with_charset.send().await.expect("an answer").status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scene_that_is_known_is_not_sent_again() {
    let world = start().await;
    let request = world
        .request(Method::GET, "/api/v1/scene")
        .header("if-none-match", "\"0\", \"1\"");
    assert_eq!(request.send().await.expect("an answer").status(), 304);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_scene_survives_a_restart() {
    let world = start().await;
    world.patch(Some("*"), "{\"exposure_ev\": 1.1}").await;
    let response = world
        .patch(Some("\"2\""), "{\"wind\": {\"speed_m_per_s\": 12.34}}")
        .await;
    assert_eq!(response.status(), 200);
    let document: Value = response.json().await.expect("JSON");
    let (folder, renderer) = (world.folder, world.renderer);
    world.service.shutdown().await;
    drop(renderer);

    let (service, _renderer) = start_in(folder.path(), Behaviour::default(), |_| {}).await;
    let url = format!("http://{}/api/v1/scene", service.address());
    let response = reqwest::get(url).await.expect("an answer");
    assert_eq!(response.headers()["etag"], "\"3\"");
    assert_eq!(response.json::<Value>().await.expect("JSON"), document);
}
