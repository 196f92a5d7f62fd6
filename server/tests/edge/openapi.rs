//! `/api/v1/openapi.json` against what the server answers.

use std::collections::BTreeSet;

use jsonschema::Validator;
use reqwest::{Method, Response};
use serde_json::{Value, json};

use crate::stand_in::Behaviour;
use crate::world::{World, eventually, start, start_with};

const METHODS: [&str; 5] = ["get", "put", "post", "patch", "delete"];

/// Paths whose answers have no end or are no HTTP.
const ENDLESS: [&str; 2] = ["/api/v1/scene/events", "/ws"];

async fn document(world: &World) -> Value {
    world.get_json("/api/v1/openapi.json").await
}

fn validator(document: &Value, schema: &Value) -> Validator {
    let mut whole = schema.clone();
    whole["components"] = document["components"].clone();
    jsonschema::validator_for(&whole).expect("a schema")
}

/// A path with its parameters filled in.
fn filled(path: &str) -> String {
    path.replace("{kind}", "coverage")
        .replace("{name}", "storm")
        .replace("{revision}", "1")
}

/// The answer is one of those that the document has for the operation.
async fn check(document: &Value, operation: &Value, what: &str, response: Response) {
    let status = response.status().as_u16().to_string();
    let described = &operation["responses"][&status];
    assert!(
        described.is_object(),
        "{what}: {status} is not in the document"
    );
    for header in described["headers"].as_object().into_iter().flatten() {
        assert!(
            response.headers().contains_key(header.0),
            "{what}: no {}",
            header.0
        );
    }
    let kind = response.headers().get("content-type").map(|kind| {
        kind.to_str()
            .expect("ASCII")
            .split(';')
            .next()
            .expect("a type")
            .to_owned()
    });
    let contents = described["content"].as_object();
    match (kind, contents) {
        (None, None) => {}
        (Some(kind), Some(contents)) => {
            let content = contents
                .get(&kind)
                .unwrap_or_else(|| panic!("{what}: {kind} is not in the document"));
            if kind.ends_with("json") {
                let body: Value = response.json().await.expect("JSON");
                let validator = validator(document, &content["schema"]);
                let wrong: Vec<String> = validator
                    .iter_errors(&body)
                    .take(5)
                    .map(|error| format!("{}: {error}", error.instance_path()))
                    .collect();
                assert!(wrong.is_empty(), "{what}: {wrong:?}");
            }
        }
        (kind, contents) => panic!("{what}: {kind:?}, {contents:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_answer_to_get_is_as_the_document_says() {
    let world = start().await;
    let _client = crate::client::Client::join(world.address()).await;
    let document = document(&world).await;
    for (path, item) in document["paths"].as_object().expect("paths") {
        let Some(operation) = item
            .get("get")
            .filter(|_| !ENDLESS.contains(&path.as_str()))
        else {
            continue;
        };
        let response = world.get(&filled(path)).await;
        assert_eq!(response.status(), 200, "{path}");
        let tag = response.headers().get("etag").cloned();
        let kind = response.headers().get("content-type").cloned();
        check(&document, operation, path, response).await;
        // HEAD is the same without a body.
        let head = world
            .request(Method::HEAD, &filled(path))
            .send()
            .await
            .expect("an answer");
        assert_eq!(head.status(), 200, "HEAD {path}");
        assert_eq!(
            head.headers().get("content-type"),
            kind.as_ref(),
            "HEAD {path}"
        );
        assert!(
            head.bytes().await.expect("a body").is_empty(),
            "HEAD {path}"
        );
        if operation["responses"].get("304").is_some() {
            let tag = tag.expect("an ETag");
            let request = world
                .request(Method::GET, &filled(path))
                .header("if-none-match", tag);
            let again = request.send().await.expect("an answer");
            assert_eq!(again.status(), 304, "{path}");
            check(&document, operation, path, again).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn changes_and_refusals_are_as_the_document_says() {
    let world = start().await;
    let document = document(&world).await;
    let merge = "application/merge-patch+json";
    let patch = "application/json-patch+json";
    let json = "application/json";
    let bad_name = json!({"name": "no such sky"}).to_string();
    for (method, path, kind, tag, body, status) in [
        (
            "patch",
            "/api/v1/scene",
            merge,
            "*",
            "{\"exposure_ev\": 1}",
            200,
        ),
        ("patch", "/api/v1/scene", merge, "*", "{", 400),
        ("patch", "/api/v1/scene", merge, "\"77\"", "{}", 412),
        ("patch", "/api/v1/scene", merge, "", "{}", 428),
        ("patch", "/api/v1/scene", json, "*", "{}", 415),
        (
            "patch",
            "/api/v1/scene",
            merge,
            "*",
            "{\"exposure_ev\": 99}",
            422,
        ),
        ("patch", "/api/v1/scene", patch, "*", "[]", 200),
        (
            "patch",
            "/api/v1/scene",
            patch,
            "*",
            "[{\"op\": \"add\"}]",
            400,
        ),
        (
            "patch",
            "/api/v1/scene",
            patch,
            "*",
            "[{\"op\": \"remove\", \"path\": \"/x\"}]",
            409,
        ),
        (
            "put",
            "/api/v1/scene/time",
            json,
            "*",
            "{\"paused\": true}",
            200,
        ),
        (
            "put",
            "/api/v1/scene/time",
            json,
            "*",
            "{\"rate\": true}",
            422,
        ),
        ("put", "/api/v1/scene/time", json, "*", "", 400),
        (
            "post",
            "/api/v1/scene/preset",
            json,
            "*",
            bad_name.as_str(),
            422,
        ),
        ("post", "/api/v1/scene/revert", json, "*", "", 200),
        (
            "post",
            "/api/v1/scene/revert",
            json,
            "*",
            "{\"revision\": 77}",
            422,
        ),
        ("delete", "/api/v1/scene/maps/{kind}", json, "*", "", 200),
        (
            "put",
            "/api/v1/scene/maps/{kind}",
            "image/png",
            "*",
            "none",
            415,
        ),
    ] {
        let method_name = method.to_uppercase();
        let what = format!("{method_name} {path} {body}");
        let mut request = world
            .request(method_name.parse().expect("a method"), &filled(path))
            .header("content-type", kind)
            .body(body.to_owned());
        if !tag.is_empty() {
            request = request.header("if-match", tag);
        }
        let response = request.send().await.expect("an answer");
        assert_eq!(response.status(), status, "{what}");
        check(&document, &document["paths"][path][method], &what, response).await;
    }
    for (path, real, status) in [
        ("/api/v1/presets/{name}", "/api/v1/presets/none", 404),
        ("/api/v1/scene/maps/{kind}", "/api/v1/scene/maps/none", 404),
        (
            "/api/v1/scene/maps/{kind}",
            "/api/v1/scene/maps/type?layer=none",
            422,
        ),
        (
            "/api/v1/scene/maps/{kind}",
            "/api/v1/scene/maps/type?colour=1",
            400,
        ),
        ("/api/v1/scene/now", "/api/v1/scene/now?at=noon", 422),
        ("/ws", "/ws", 400),
    ] {
        let response = world.get(real).await;
        assert_eq!(response.status(), status, "{real}");
        check(&document, &document["paths"][path]["get"], real, response).await;
    }
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_cannot_serve_says_so_as_the_document_says() {
    let behaviour = Behaviour {
        never_ready: true,
        ..Behaviour::default()
    };
    let world = start_with(behaviour, |_| {}).await;
    let document = document(&world).await;
    let response = world.get("/readyz").await;
    assert_eq!(response.status(), 503);
    check(
        &document,
        &document["paths"]["/readyz"]["get"],
        "/readyz",
        response,
    )
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_path_of_the_document_takes_a_method_that_the_document_does_not_have() {
    let world = start().await;
    let document = document(&world).await;
    for (path, item) in document["paths"].as_object().expect("paths") {
        let documented: BTreeSet<String> = METHODS
            .into_iter()
            .filter(|method| item.get(*method).is_some())
            .map(str::to_uppercase)
            .collect();
        for method in METHODS.map(str::to_uppercase) {
            if documented.contains(&method) {
                continue;
            }
            let request = world.request(method.parse().expect("a method"), &filled(path));
            let response = request.send().await.expect("an answer");
            assert_eq!(response.status(), 405, "{method} {path}");
            let allowed: BTreeSet<String> = response.headers()["allow"]
                .to_str()
                .expect("ASCII")
                .split(',')
                .map(|name| name.trim().to_owned())
                .filter(|name| name != "HEAD")
                .collect();
            assert_eq!(allowed, documented, "{method} {path}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_reference_of_the_document_leads_somewhere_and_every_operation_has_its_own_name() {
    fn references<'a>(value: &'a Value, found: &mut Vec<&'a str>) {
        match value {
            Value::Object(members) => {
                found.extend(members.get("$ref").and_then(Value::as_str));
                members.values().for_each(|below| references(below, found));
            }
            Value::Array(items) => items.iter().for_each(|below| references(below, found)),
            _ => {}
        }
    }
    let world = start().await;
    let document = document(&world).await;
    let mut found = Vec::new();
    references(&document, &mut found);
    assert!(found.len() > 50, "{}", found.len());
    for at in found {
        let pointer = at.strip_prefix('#').expect("in the document");
        assert!(document.pointer(pointer).is_some(), "{at}");
    }
    let mut names = BTreeSet::new();
    for item in document["paths"].as_object().expect("paths").values() {
        for method in METHODS {
            if let Some(name) = item.pointer(&format!("/{method}/operationId")) {
                assert!(names.insert(name.as_str().expect("a name")), "{name} twice");
            }
        }
    }
    assert!(names.len() >= 20, "{names:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_every_operation_and_loads_only_what_the_server_has() {
    let world = start().await;
    let document = document(&world).await;
    let page = world.get("/api/v1/docs").await.text().await.expect("text");
    for (path, item) in document["paths"].as_object().expect("paths") {
        for method in METHODS
            .into_iter()
            .filter(|method| item.get(*method).is_some())
        {
            assert!(
                page.contains(&format!("{} {path}", method.to_uppercase())),
                "{method} {path}"
            );
        }
    }
    assert!(
        !page.contains("<script") && !page.contains("https://"),
        "something from elsewhere"
    );
    assert!(
        !page.contains(" style=") && !page.contains("<style"),
        "the server's policy forbids it"
    );
    assert_eq!(world.get("/docs.css").await.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_json_patch_changes_all_or_nothing_and_a_conflict_names_its_pointer() {
    let world = start().await;
    let send = async |body: Value| {
        world
            .request(Method::PATCH, "/api/v1/scene")
            .header("content-type", "application/json-patch+json")
            .header("if-match", "*")
            .body(body.to_string())
            .send()
            .await
            .expect("an answer")
    };
    let changed = send(json!([
        {"op": "test", "path": "/layers/0/name", "value": "low"},
        {"op": "replace", "path": "/layers/0/density/coverage", "value": 0.6},
        {"op": "add", "path": "/layers/-", "value": {"family": "cirrus"}},
    ]))
    .await;
    assert_eq!(changed.status(), 200);
    assert_eq!(changed.headers()["etag"], "\"2\"");
    let scene: Value = changed.json().await.expect("JSON");
    assert_eq!(scene["layers"][0]["density"]["coverage"], 0.6);
    assert_eq!(scene["layers"][1]["family"], "cirrus");
    let conflict = send(json!([
        {"op": "replace", "path": "/exposure_ev", "value": 3},
        {"op": "test", "path": "/layers/1/name", "value": "nimbus"},
    ]))
    .await;
    assert_eq!(conflict.status(), 409);
    let problem: Value = conflict.json().await.expect("JSON");
    assert_eq!(problem["pointer"], "/layers/1/name");
    let many = vec![json!({"op": "test", "path": "/version", "value": 1}); 257];
    let refused = send(many.into()).await;
    assert_eq!(refused.status(), 400);
    let problem: Value = refused.json().await.expect("JSON");
    assert_eq!(problem["allowed"], "0 to 256 operations");
    assert_eq!(world.get_json("/api/v1/scene").await, scene);
}

#[tokio::test(flavor = "multi_thread")]
async fn who_has_heard_of_the_last_change_hears_of_the_next_alone() {
    let world = start().await;
    let listen = async |id: &str| {
        let request = world
            .request(Method::GET, "/api/v1/scene/events")
            .header("last-event-id", id);
        request.send().await.expect("an answer")
    };
    let mut up_to_date = listen("1").await;
    let mut behind = listen("0").await;
    let first = behind.chunk().await.expect("a stream").expect("an event");
    assert!(String::from_utf8_lossy(&first).contains("id: 1\n"));
    world.patch(Some("*"), "{\"exposure_ev\": 1}").await;
    let next = up_to_date
        .chunk()
        .await
        .expect("a stream")
        .expect("an event");
    let next = String::from_utf8_lossy(&next).into_owned();
    assert!(
        next.contains("id: 2\n") && !next.contains("id: 1\n"),
        "{next}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_is_a_picture_by_a_viewer_who_leaves() {
    let world = start().await;
    let response = world
        .get("/api/v1/snapshot?width=64&height=36&yaw_deg=90")
        .await;
    assert_eq!(response.status(), 200);
    assert_eq!(response.headers()["content-type"], "image/png");
    assert_eq!(response.headers()["skycell-scene-revision"], "1");
    assert_eq!(response.headers()["skycell-exact"], "true");
    let picture = response.bytes().await.expect("a body");
    let picture = image::load_from_memory(&picture).expect("a PNG");
    assert_eq!((picture.width(), picture.height()), (64, 36));
    eventually("the viewer has left", || {
        world
            .renderer
            .witness
            .left
            .lock()
            .expect("not poisoned")
            .len()
            == 1
    })
    .await;
    let response = world
        .get("/api/v1/snapshot?width=32&height=18&format=exr")
        .await;
    assert_eq!(response.headers()["content-type"], "image/x-exr");
    let exr = image::load_from_memory(&response.bytes().await.expect("a body")).expect("an EXR");
    assert_eq!((exr.width(), exr.height()), (32, 18));
    assert_eq!(exr.color(), image::ColorType::Rgb32F);
    let document = document(&world).await;
    for (query, status) in [
        ("?yaw_deg=east", 400),
        ("?colour=1", 400),
        ("?fov_deg=180", 422),
        ("?format=tiff", 422),
        ("?format=EXR", 422),
        ("?width=3840&height=2160", 422),
    ] {
        let path = format!("/api/v1/snapshot{query}");
        let refused = world.get(&path).await;
        assert_eq!(refused.status(), status, "{path}");
        check(
            &document,
            &document["paths"]["/api/v1/snapshot"]["get"],
            &path,
            refused,
        )
        .await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn more_snapshots_than_may_wait_are_told_to_come_back() {
    let behaviour = Behaviour {
        breaks_frames: false,
        rests: true,
        ..Behaviour::default()
    };
    let world = start_with(behaviour, |_| {}).await;
    // A renderer at rest sends one coarse frame and none that has settled: all of them wait.
    let waiting: Vec<_> = (0..5)
        .map(|_| {
            let request = world.request(Method::GET, "/api/v1/snapshot?width=8&height=8");
            tokio::spawn(request.send())
        })
        .collect();
    let mut status = 0;
    for _ in 0..500 {
        let request = world.request(Method::GET, "/api/v1/snapshot?width=8&height=8");
        let sent = tokio::time::timeout(std::time::Duration::from_millis(200), request.send());
        if let Ok(Ok(response)) = sent.await {
            status = response.status().as_u16();
            assert_eq!(response.headers()["retry-after"], "1");
            break;
        }
    }
    assert_eq!(status, 429);
    waiting.into_iter().for_each(|task| task.abort());
}
