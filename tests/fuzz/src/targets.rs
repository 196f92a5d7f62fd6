//! The parsers, and what holds for what they take. Each says whether it took the input.

use serde_json::{Map, Value};
use skycell_client::camera_path::CameraPath;
use skycell_protocol::clouds::Clouds;
use skycell_protocol::message::{ClientMessage, ServerMessage};
use skycell_protocol::scene::Scene;
use skycell_protocol::{FrameHeader, Moment};
use skycell_server::access::TokenEntry;
use skycell_server::config::Config;
use skycell_server::field::{GreyMap, MapFileFormat};
use skycell_server::scene::SceneJsonPatch;

fn json_of(bytes: &[u8]) -> Option<Value> {
    serde_json::from_slice(bytes).ok()
}

pub(crate) fn client_message(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return false;
    };
    match ClientMessage::from_json_text(text) {
        Ok(_) => true,
        Err(error) => {
            let message = error.to_message();
            assert!(!message.message.is_empty());
            false
        }
    }
}

pub(crate) fn server_message(bytes: &[u8]) -> bool {
    serde_json::from_slice::<ServerMessage>(bytes).is_ok()
}

/// A scene that was read is written and read as the same, and shows something at any moment.
fn is_scene(document: &Value) -> bool {
    let Ok(scene) = Scene::from_json(document) else {
        return false;
    };
    let written = serde_json::to_value(scene.to_document()).expect("JSON");
    assert_eq!(Scene::from_json(&written).as_ref(), Ok(&scene));
    for moment in [Moment::MIN, Moment::UNIX_EPOCH, Moment::MAX] {
        let shown = scene.at(moment);
        assert!(shown.sun().direction().is_finite());
        for layer in 0..shown.layers().len() {
            assert!(shown.carried_m(layer).is_finite());
        }
    }
    true
}

pub(crate) fn scene(bytes: &[u8]) -> bool {
    json_of(bytes).is_some_and(|document| is_scene(&document))
}

fn default_document() -> Value {
    serde_json::to_value(Scene::default().to_document()).expect("JSON")
}

pub(crate) fn merge_patch(bytes: &[u8]) -> bool {
    json_of(bytes).is_some_and(|patch| {
        let mut document = default_document();
        json_patch::merge(&mut document, &patch);
        is_scene(&document)
    })
}

pub(crate) fn json_patch(bytes: &[u8]) -> bool {
    let Some(Ok(patch)) = json_of(bytes).map(|patch| SceneJsonPatch::from_json(&patch)) else {
        return false;
    };
    let mut document = default_document();
    patch.apply_to(&mut document).is_ok() && is_scene(&document)
}

pub(crate) fn map(bytes: &[u8]) -> bool {
    let Ok(map) = GreyMap::decode(bytes) else {
        return false;
    };
    assert_eq!(map.values.len(), map.width as usize * map.height as usize);
    let exr = map.encode(MapFileFormat::Exr).expect("a file");
    assert_eq!(GreyMap::decode(&exr).as_ref().ok(), Some(&map));
    true
}

pub(crate) fn frame(bytes: &[u8]) -> bool {
    let Ok((header, payload)) = FrameHeader::split(bytes) else {
        return false;
    };
    assert_eq!(payload.len(), header.payload_bytes as usize);
    assert_eq!(FrameHeader::decode(&header.encode()), Ok(header));
    true
}

pub(crate) fn clouds(bytes: &[u8]) -> bool {
    let Ok(clouds) = Clouds::parse(bytes) else {
        return false;
    };
    let pixels = (clouds.width() * clouds.height()) as usize;
    assert!(clouds.planes().iter().all(|plane| plane.len() == pixels));
    assert!((0..pixels).all(|pixel| (0.0..=1.0).contains(&clouds.transmittance(pixel))));
    true
}

pub(crate) fn token_line(bytes: &[u8]) -> bool {
    std::str::from_utf8(bytes).is_ok_and(|line| TokenEntry::parse(line).is_some())
}

pub(crate) fn camera_path(bytes: &[u8]) -> bool {
    json_of(bytes).is_some_and(|path| CameraPath::from_json(&path).is_ok())
}

pub(crate) fn configuration(bytes: &[u8]) -> bool {
    std::str::from_utf8(bytes)
        .ok()
        .and_then(|text| toml::from_str::<Map<String, Value>>(text).ok())
        .is_some_and(|tree| Config::from_json(&tree.into(), "state".into()).is_ok())
}
