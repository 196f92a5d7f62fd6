//! `/api/v1/scene/revisions` and `/revert`.

use reqwest::Method;
use serde_json::{Value, json};

use crate::client::Client;
use crate::world::{World, start};

async fn revert(world: &World, if_match: Option<&str>, body: Option<Value>) -> reqwest::Response {
    let mut request = world.request(Method::POST, "/api/v1/scene/revert");
    if let Some(body) = body {
        request = request
            .header("content-type", "application/json")
            .body(body.to_string());
    }
    if let Some(tag) = if_match {
        request = request.header("if-match", tag);
    }
    request.send().await.expect("an answer")
}

async fn expose(world: &World, exposure_ev: u32) {
    let body = format!("{{\"exposure_ev\": {exposure_ev}}}");
    assert_eq!(world.patch(Some("*"), &body).await.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn revisions_are_listed_newest_first_in_pages_and_each_has_its_document() {
    let world = start().await;
    let first = world.get_json("/api/v1/scene").await;
    for exposure_ev in 1..=5 {
        expose(&world, exposure_ev).await;
    }
    let page = world.get_json("/api/v1/scene/revisions?limit=2").await;
    assert_eq!(
        (&page["revision"], &page["next_before"]),
        (&json!(6), &json!(5))
    );
    let newest = &page["revisions"][0];
    assert_eq!(
        (&newest["revision"], &newest["kind"]),
        (&json!(6), &json!("patch"))
    );
    assert_eq!(newest["changed"], json!(["/exposure_ev"]));
    assert!(newest.get("scene").is_none(), "a list has no documents");
    let last = world
        .get_json("/api/v1/scene/revisions?limit=4&before=5")
        .await;
    let numbers: Vec<&Value> = last["revisions"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|revision| &revision["revision"])
        .collect();
    assert_eq!(numbers, [4, 3, 2, 1]);
    assert_eq!(last["next_before"], Value::Null);

    let kept = world.get("/api/v1/scene/revisions/1").await;
    assert_eq!(kept.headers()["etag"], "\"1\"");
    assert_eq!(kept.json::<Value>().await.expect("JSON"), first);
    for (path, status) in [
        ("/api/v1/scene/revisions/7", 404),
        ("/api/v1/scene/revisions/x", 404),
        ("/api/v1/scene/revisions?limit=0", 422),
        ("/api/v1/scene/revisions?limit=101", 422),
        ("/api/v1/scene/revisions?count=1", 400),
    ] {
        let refused = world.get(path).await;
        assert_eq!(refused.status(), status, "{path}");
        assert_eq!(
            refused.headers()["content-type"],
            "application/problem+json"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revert_is_a_new_revision_that_viewers_see_and_bad_ones_change_nothing() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    let first = world.get_json("/api/v1/scene").await;
    expose(&world, 1).await;
    expose(&world, 2).await;

    assert_eq!(revert(&world, None, None).await.status(), 428);
    assert_eq!(revert(&world, Some("\"2\""), None).await.status(), 412);
    for (body, pointer) in [
        (json!({"revision": 9}), "/revision"),
        (json!({"revision": "1"}), "/revision"),
        (json!({"transition_s": -1}), "/transition_s"),
        (json!({"revison": 1}), "/revison"),
    ] {
        let refused = revert(&world, Some("*"), Some(body)).await;
        assert_eq!(refused.status(), 422);
        let problem: Value = refused.json().await.expect("JSON");
        assert_eq!(problem["pointer"], pointer);
    }
    assert_eq!(world.get("/api/v1/scene").await.headers()["etag"], "\"3\"");

    let undone = revert(&world, Some("\"3\""), None).await;
    assert_eq!(undone.headers()["etag"], "\"4\"");
    assert_eq!(
        undone.json::<Value>().await.expect("JSON")["exposure_ev"],
        1.0
    );
    client.frame_with(|header| header.scene_revision == 4).await;
    let back = revert(&world, Some("*"), Some(json!({"revision": 1}))).await;
    assert_eq!(back.headers()["etag"], "\"5\"");
    assert_eq!(back.json::<Value>().await.expect("JSON"), first);
    let nothing = revert(&world, Some("*"), None).await;
    assert_eq!(nothing.status(), 409);
    assert_eq!(world.get("/api/v1/scene").await.headers()["etag"], "\"5\"");
}
