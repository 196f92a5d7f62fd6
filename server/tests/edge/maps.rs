//! `/api/v1/scene/maps/…`.

use reqwest::{Method, Response};
use serde_json::{Value, json};
use skycell_server::field::{GreyMap, MAP_FILE_MAX_BYTES, MapFileFormat};

use crate::client::Client;
use crate::stand_in::Behaviour;
use crate::world::{World, start, start_in};

/// A map that no seed makes.
fn ramp(width: u32, height: u32) -> GreyMap {
    let last = (width * height - 1).max(1) as f32;
    GreyMap {
        width,
        height,
        values: (0..width * height).map(|i| i as f32 / last).collect(),
    }
}

fn file(map: &GreyMap, format: MapFileFormat) -> Vec<u8> {
    map.encode(format).expect("written")
}

async fn put(world: &World, path: &str, tag: Option<&str>, body: Vec<u8>) -> Response {
    let mut request = world
        .request(Method::PUT, &format!("/api/v1/scene/maps/{path}"))
        .body(body);
    if let Some(tag) = tag {
        request = request.header("if-match", tag);
    }
    request.send().await.expect("an answer")
}

async fn problem(response: Response, status: u16) -> Value {
    assert_eq!(response.status(), status);
    assert_eq!(
        response.headers()["content-type"],
        "application/problem+json"
    );
    response.json().await.expect("JSON")
}

async fn revision(world: &World) -> String {
    let scene = world.get("/api/v1/scene").await;
    scene.headers()["etag"].to_str().expect("text").to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_that_is_put_is_the_scenes_comes_back_survives_a_restart_and_can_be_reset() {
    let world = start().await;
    let mut client = Client::join(world.address()).await;
    let map = ramp(37, 21);
    let answer = put(
        &world,
        "coverage?transition_s=30",
        Some("\"1\""),
        file(&map, MapFileFormat::Exr),
    )
    .await;
    assert_eq!(answer.status(), 200);
    assert_eq!(answer.headers()["etag"], "\"2\"");
    let document: Value = answer.json().await.expect("JSON");
    let maps = &document["layers"][0]["density"]["maps"];
    assert_eq!(maps["transition_s"], 30.0);
    let name = maps["coverage"].as_str().expect("a name").to_owned();
    assert!(name.ends_with(".exr"), "{name}");
    assert!(world.folder.path().join("maps").join(&name).exists());
    client.frame_with(|header| header.scene_revision == 2).await;

    // As EXR to the last bit, as PNG to 16 bits.
    let exr = world
        .get("/api/v1/scene/maps/coverage?format=exr&layer=low")
        .await;
    assert_eq!(exr.headers()["content-type"], "image/x-exr");
    let bytes = exr.bytes().await.expect("bytes");
    assert_eq!(GreyMap::decode(&bytes).expect("a map"), map);
    let png = world.get("/api/v1/scene/maps/coverage").await;
    assert_eq!(png.headers()["content-type"], "image/png");
    assert_eq!(png.headers()["etag"], "\"2\"");
    let read = GreyMap::decode(&png.bytes().await.expect("bytes")).expect("a map");
    for (a, b) in read.values.iter().zip(&map.values) {
        assert!((a - b).abs() < 1.0 / 65_535.0);
    }
    let known = world
        .request(Method::GET, "/api/v1/scene/maps/coverage")
        .header("if-none-match", "\"2\"")
        .send()
        .await
        .expect("an answer");
    assert_eq!(known.status(), 304);

    // The same file again changes nothing; another kind does.
    let again = put(
        &world,
        "coverage",
        Some("*"),
        file(&map, MapFileFormat::Exr),
    )
    .await;
    assert_eq!(again.headers()["etag"], "\"2\"");
    let other = put(
        &world,
        "profile",
        Some("\"2\""),
        file(&map, MapFileFormat::Png),
    )
    .await;
    assert_eq!(other.headers()["etag"], "\"3\"");

    let World {
        service, folder, ..
    } = world;
    service.shutdown().await;
    let (service, _renderer) = start_in(folder.path(), Behaviour::default(), |_| {}).await;
    let url = format!("http://{}/api/v1/scene", service.address());
    let http = reqwest::Client::new();
    let kept: Value = http
        .get(&url)
        .send()
        .await
        .expect("an answer")
        .json()
        .await
        .expect("JSON");
    assert_eq!(
        kept["layers"][0]["density"]["maps"]["coverage"],
        json!(name)
    );
    let kept = http
        .get(format!("{url}/maps/coverage?format=exr"))
        .send()
        .await;
    let bytes = kept.expect("an answer").bytes().await.expect("bytes");
    assert_eq!(GreyMap::decode(&bytes).expect("a map"), map);

    let reset = http
        .delete(format!("{url}/maps/coverage"))
        .header("if-match", "\"3\"")
        .send()
        .await
        .expect("an answer");
    assert_eq!(reset.status(), 200);
    let document: Value = reset.json().await.expect("JSON");
    assert_eq!(
        document["layers"][0]["density"]["maps"]["coverage"],
        Value::Null
    );
    service.shutdown().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_map_is_refused_with_a_reason_and_the_old_map_stays() {
    let world = start().await;
    let good = file(&ramp(4, 4), MapFileFormat::Png);
    assert_eq!(
        put(&world, "type", Some("\"1\""), good.clone())
            .await
            .status(),
        200
    );
    let before = world.get_json("/api/v1/scene").await;

    let mut broken = good.clone();
    broken.truncate(40);
    let nan = |value: f32| {
        let mut map = ramp(3, 2);
        map.values[4] = value;
        file(&map, MapFileFormat::Exr)
    };
    let mut colours = std::io::Cursor::new(Vec::new());
    image::RgbImage::new(2, 2)
        .write_to(&mut colours, image::ImageFormat::Png)
        .expect("written");
    let mut long = std::io::Cursor::new(Vec::new());
    image::GrayImage::new(8193, 1)
        .write_to(&mut long, image::ImageFormat::Png)
        .expect("written");
    for (body, status, value, allowed) in [
        (Vec::new(), 415, "begins with nothing", "PNG or EXR"),
        (b"GIF89a".to_vec(), 415, "47 49 46", "PNG or EXR"),
        (broken, 422, "broken PNG", "whole PNG"),
        (nan(f32::NAN), 422, "NaN in column 1, row 1", "0 to 1"),
        (nan(f32::INFINITY), 422, "inf in column 1, row 1", "0 to 1"),
        (nan(1.25), 422, "1.25 in column 1, row 1", "0 to 1"),
        (colours.into_inner(), 422, "colours", "grey"),
        (long.into_inner(), 422, "8193 x 1", "8192 x 8192"),
    ] {
        let refused = problem(put(&world, "type", Some("*"), body).await, status).await;
        assert_eq!(refused["pointer"], "/layers/0/density/maps/type");
        let told = |key: &str| refused[key].as_str().unwrap_or_default().to_owned();
        assert!(told("value").contains(value), "{refused}");
        assert!(told("allowed").contains(allowed), "{refused}");
    }
    let huge = vec![0; MAP_FILE_MAX_BYTES as usize + 1];
    let refused = problem(put(&world, "type", Some("*"), huge).await, 413).await;
    assert!(
        refused["detail"]
            .as_str()
            .is_some_and(|d| d.contains("67108864"))
    );

    // Not for this scene, not this map, not this layer, not this time.
    problem(put(&world, "type", None, good.clone()).await, 428).await;
    problem(put(&world, "type", Some("\"1\""), good.clone()).await, 412).await;
    problem(put(&world, "height", Some("*"), good.clone()).await, 404).await;
    let refused = put(&world, "type?layer=high", Some("*"), good.clone()).await;
    let refused = problem(refused, 422).await;
    assert!(
        refused["allowed"]
            .as_str()
            .is_some_and(|a| a.contains("low"))
    );
    let refused = put(&world, "coverage?transition_s=-1", Some("*"), good.clone()).await;
    let refused = problem(refused, 422).await;
    assert_eq!(refused["pointer"], "/layers/0/density/maps/transition_s");
    problem(
        put(&world, "coverage?transition=1", Some("*"), good).await,
        400,
    )
    .await;
    let unknown = world.get("/api/v1/scene/maps/type?format=tiff").await;
    let unknown = problem(unknown, 422).await;
    assert_eq!(
        (&unknown["pointer"], &unknown["allowed"]),
        (&json!("/format"), &json!("png, exr"))
    );

    assert_eq!(world.get_json("/api/v1/scene").await, before);
    assert_eq!(revision(&world).await, "\"2\"");
    let kept = world.get("/api/v1/scene/maps/type").await;
    let kept = GreyMap::decode(&kept.bytes().await.expect("bytes")).expect("a map");
    assert_eq!((kept.width, kept.height), (4, 4));
    world.goes_on().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_generated_map_can_be_fetched_and_put_back_and_layers_are_told_apart() {
    let world = start().await;
    let made = world.get("/api/v1/scene/maps/profile").await;
    let made = made.bytes().await.expect("bytes").to_vec();
    let map = GreyMap::decode(&made).expect("a map");
    // The base is at the bottom: nothing there and at the top.
    let row = |y: usize| &map.values[y * map.width as usize..(y + 1) * map.width as usize];
    assert!(row(0).iter().all(|v| *v < 0.1), "{:?}", row(0));
    assert!(row(map.height as usize * 3 / 4).iter().any(|v| *v > 0.5));

    let two =
        json!([{"name": "low"}, {"name": "high", "base_altitude_m": 5000, "top_altitude_m": 6000}]);
    let patched = world
        .patch(Some("*"), &json!({"layers": two}).to_string())
        .await;
    assert_eq!(patched.status(), 200);
    let unnamed = put(&world, "profile", Some("*"), made.clone()).await;
    let unnamed = problem(unnamed, 422).await;
    assert!(
        unnamed["allowed"]
            .as_str()
            .is_some_and(|a| a.ends_with("low, high"))
    );
    let named = put(&world, "profile?layer=high", Some("*"), made.clone()).await;
    let document: Value = named.json().await.expect("JSON");
    let file = |layer: usize| &document["layers"][layer]["density"]["maps"]["profile"];
    assert!(file(0).is_null() && file(1).is_string(), "{document}");
    // A scene may name it twice; a file that is not there is refused.
    let name = file(1).clone();
    let mut layers = document["layers"].clone();
    layers[0]["density"]["maps"]["profile"] = name;
    let shared = world
        .patch(Some("*"), &json!({"layers": layers}).to_string())
        .await;
    assert_eq!(shared.status(), 200);
    layers[0]["density"]["maps"]["type"] = json!("nowhere.png");
    let missing = world
        .patch(Some("*"), &json!({"layers": layers}).to_string())
        .await;
    let missing = problem(missing, 422).await;
    assert_eq!(missing["pointer"], "/layers/0/density/maps/type");
    world.goes_on().await;
}
