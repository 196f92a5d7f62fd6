//! Every path, with what may be asked of it and what it answers.

use axum::http::Method;
use serde_json::{Value, json};
use skycell_protocol::Camera;
use skycell_protocol::SUBPROTOCOL;
use skycell_protocol::camera::{
    PITCH_DEG, POSITION_ALTITUDE_M, POSITION_HORIZONTAL_M, VERTICAL_FOV_DEG, YAW_DEG,
};
use skycell_protocol::number_range::NumberRange;
use skycell_protocol::scene::ranges;
use skycell_protocol::view::{FRAME_HEIGHT_MAX, FRAME_WIDTH_MAX};

use super::operation::Operation;
use super::schemas::reference;
use crate::access::{Rule, rule_of};
use crate::api::revisions::{LIMIT, LIMIT_DEFAULT};
use crate::api::scene::{JSON_PATCH, MERGE_PATCH};
use crate::api::scene_events::SUBSCRIBERS_MAX;
use crate::api::snapshot;
use crate::scene::{GROUP_MAX_CHARS, GROUP_PATTERN};

pub(super) fn tags() -> Value {
    json!([
        {"name": "scene", "description": "The sky: its document, its clock, its maps."},
        {"name": "presets", "description": "Skies by name."},
        {"name": "figures", "description": "What the service does, in numbers."},
        {"name": "health", "description": "For those who run it."},
        {"name": "stream", "description": "Frames."},
        {"name": "documentation", "description": "This document."},
    ])
}

/// The paths, each operation with the role that it needs where the server has tokens.
pub(super) fn paths() -> Value {
    let mut paths = operations();
    for (path, item) in paths.as_object_mut().into_iter().flatten() {
        for (method, operation) in item.as_object_mut().into_iter().flatten() {
            let Ok(method) = Method::from_bytes(method.to_uppercase().as_bytes()) else {
                continue;
            };
            if let Rule::Needs(role) = rule_of(&method, path, false) {
                operation["security"] = json!([{(TOKEN): [role.name()]}, {}]);
            }
        }
    }
    paths
}

/// The name of the security scheme.
pub(super) const TOKEN: &str = "token";

fn operations() -> Value {
    json!({
        "/api/v1/scene": {"get": scene(), "patch": patch_scene()},
        "/api/v1/scene/time": {"get": time(), "put": change_time()},
        "/api/v1/scene/now": {"get": now()},
        "/api/v1/scene/events": {"get": events()},
        "/api/v1/scene/revisions": {"get": revisions()},
        "/api/v1/scene/revisions/{revision}": {"get": revision()},
        "/api/v1/scene/revert": {"post": revert()},
        "/api/v1/scene/preset": {"post": set_preset()},
        "/api/v1/scene/maps/{kind}": {"get": map(), "put": replace_map(), "delete": reset_map()},
        "/api/v1/presets": {"get": presets()},
        "/api/v1/presets/{name}": {"get": preset()},
        "/api/v1/cells": {"get": figures("getCells", "The view cells.", list_of("CellStats"))},
        "/api/v1/viewers": {"get": figures("getViewers", "Who is connected.", list_of("ViewerReport"))},
        "/api/v1/stats": {"get": figures("getStats", "The renderer's and the service's totals.", reference("StatsReport"))},
        "/api/v1/views": {"get": figures("getViews", "What frames can show, with the scales of colours.", list_of("ShowReport"))},
        "/api/v1/snapshot": {"get": snapshot()},
        "/api/v1/openapi.json": {"get": document()},
        "/api/v1/docs": {"get": documentation()},
        "/metrics": {"get": metrics()},
        "/livez": {"get": health("isAlive", "Whether the process runs.", false)},
        "/readyz": {"get": health("isReady", "Whether it can serve.", true)},
        "/ws": {"get": web_socket()},
    })
}

fn list_of(name: &str) -> Value {
    json!({"type": "array", "items": reference(name)})
}

fn scene() -> Value {
    Operation::new("getScene", "scene", "The scene document.")
        .with_known()
        .answer_json("The scene.", reference("Scene"), true)
        .value()
}

/// What a group of changes is.
const GROUP: &str = "Changes of one client under a name that it has made up, each within 10 s of the one before, with no other \
     change between: a slider that is dragged. Each has its own `ETag` and is on disk when it is answered, but in the list of \
     revisions, and to an undo, they are one: the last, which tells the `first`.";

fn group() -> Value {
    json!({"type": "string", "pattern": GROUP_PATTERN, "maxLength": GROUP_MAX_CHARS})
}

fn patch_scene() -> Value {
    Operation::new("patchScene", "scene", "Changes the scene.")
        .description(
            "By a merge patch (RFC 7396) or a JSON patch (RFC 6902). Lists are replaced as a whole by a merge patch; a JSON \
             patch reaches into them. A patch that changes nothing makes no new revision. The document as a whole has to be \
             a scene after the change; otherwise the scene stays as it was.",
        )
        .with_precondition()
        .query("group", GROUP, group())
        .body(json!({
            MERGE_PATCH: {
                "schema": reference("ScenePatch"),
                "examples": {
                    "evening": {"value": {"sun": {"elevation_deg": 5}}},
                    "flat": {"value": {"planet": "flat"}},
                },
            },
            JSON_PATCH: {
                "schema": reference("JsonPatch"),
                "examples": {
                    "coverage": {"value": [
                        {"op": "test", "path": "/layers/0/name", "value": "low"},
                        {"op": "replace", "path": "/layers/0/density/coverage", "value": 0.6},
                    ]},
                },
            },
        }))
        .answer_json("The scene after the change.", reference("Scene"), true)
        .problem(400, "The body is not JSON, or no JSON patch.")
        .problem(409, "A JSON patch does not fit the scene: a test failed, or a path leads nowhere. `pointer` tells which.")
        .problem(422, "The change makes no scene: `pointer`, `value` and `allowed` tell why.")
        .value()
}

fn time() -> Value {
    Operation::new("getTime", "scene", "The sky's clock.")
        .answer_json(
            "The clock now; `ETag` is the scene's revision.",
            reference("TimeReport"),
            true,
        )
        .value()
}

fn change_time() -> Value {
    Operation::new("changeTime", "scene", "Stops the sky's clock, lets it go on, or sets it.")
        .with_precondition()
        .query("group", GROUP, group())
        .body(json!({"application/json": {
            "schema": reference("TimeChange"),
            "examples": {"stop": {"value": {"paused": true}}, "day": {"value": {"rate": 24, "wind_rate": 1}}},
        }}))
        .answer_json("The clock after the change.", reference("TimeReport"), true)
        .problem(400, "The body is not JSON.")
        .problem(422, "A value is not allowed.")
        .value()
}

fn now() -> Value {
    Operation::new("getSceneNow", "scene", "The scene of a moment.")
        .description(
            "A still scene, with what has moved moved, and where the wind has carried each layer.",
        )
        .query(
            "at",
            "Which moment: a date and time, or seconds since 1970; now where it is left out.",
            json!({"type": "string"}),
        )
        .answer_json(
            "The scene then; `ETag` is the document's revision.",
            reference("SceneNow"),
            true,
        )
        .problem(400, "The query cannot be read.")
        .problem(422, "The moment is none.")
        .value()
}

fn events() -> Value {
    Operation::new("listenToScene", "scene", "Word of every change of the scene.")
        .description(&format!(
            "Server-sent events `scene` (`SceneEvent`): one at once and one for every change, with the revision as `id`, the clock \
             and what was changed as `data`. Who comes back with `Last-Event-ID` hears of every revision that was missed, one by \
             one, and of nothing if there is none. Where some of those are not kept any more, an event `gap` (`GapEvent`, without \
             `id`) comes first: the scene is to be read anew; after it comes the newest revision alone. A group of changes is told as \
             its last one. Comments keep the connection alive; it ends when the server does, or when the token that it was opened \
             with is taken away. At most {SUBSCRIBERS_MAX} may listen."
        ))
        .header("Last-Event-ID", "The last revision that was heard of.", json!({"type": "string"}))
        .answer(
            "Events without end.",
            json!({"text/event-stream": {"schema": {"type": "string"}}}),
            false,
        )
        .problem(503, "Too many listen, or the server is ending.")
        .value()
}

fn revisions() -> Value {
    Operation::new("getRevisions", "scene", "What the scene was, newest first, without the documents.")
        .query(
            "limit",
            "How many.",
            json!({"type": "integer", "minimum": LIMIT.min as u64, "maximum": LIMIT.max as u64, "default": LIMIT_DEFAULT}),
        )
        .query("before", "Only older ones than this: `next_before` of the page before.", json!({"type": "integer", "minimum": 0}))
        .answer_json("A page of the list.", reference("RevisionPage"), false)
        .problem(422, "A value is not allowed.")
        .value()
}

fn revision() -> Value {
    Operation::new("getRevision", "scene", "The scene of a revision.")
        .path(
            "revision",
            "Its number.",
            json!({"type": "integer", "minimum": 1}),
        )
        .with_known()
        .answer_json(
            "The scene then; `ETag` is that revision.",
            reference("Scene"),
            true,
        )
        .problem(404, "No such revision is kept.")
        .value()
}

fn revert() -> Value {
    Operation::new(
        "revertScene",
        "scene",
        "Brings a revision back, or undoes the last change.",
    )
    .with_precondition()
    .optional_body(json!({"application/json": {
        "schema": reference("RevertChoice"),
        "examples": {"undo": {"value": {"transition_s": 5}}},
    }}))
    .answer_json("The scene after the change.", reference("Scene"), true)
    .problem(409, "Nothing is left to undo.")
    .problem(422, "No such revision is kept, or a value is not allowed.")
    .value()
}

fn set_preset() -> Value {
    Operation::new("setPreset", "presets", "Makes the sky a preset's.")
        .with_precondition()
        .body(json!({"application/json": {
            "schema": reference("PresetChoice"),
            "examples": {"storm": {"value": {"name": "storm", "transition_s": 30}}},
        }}))
        .answer_json("The scene after the change.", reference("Scene"), true)
        .problem(400, "The body is not JSON.")
        .problem(422, "There is no such preset, or a value is not allowed.")
        .value()
}

fn with_map_choice(operation: Operation) -> Operation {
    operation
        .path(
            "kind",
            "Which map.",
            json!({"type": "string", "enum": ["coverage", "type", "profile"]}),
        )
        .query(
            "layer",
            "Name of the layer; not needed where only one has maps.",
            json!({"type": "string"}),
        )
        .problem(400, "The query cannot be read.")
        .problem(404, "There is no such map.")
        .problem(422, "There is no such layer, or a value is not allowed.")
}

fn with_transition(operation: Operation) -> Operation {
    operation.query(
        "transition_s",
        "Sky time that the change takes; what the layer says where it is left out.",
        json!({"type": "number", "minimum": ranges::TRANSITION_S.min, "maximum": ranges::TRANSITION_S.max, "x-unit": "s"}),
    )
}

fn picture_files() -> Value {
    json!({
        "image/png": {"schema": {"type": "string", "contentMediaType": "image/png"}},
        "image/x-exr": {"schema": {"type": "string", "contentMediaType": "image/x-exr"}},
    })
}

fn map() -> Value {
    with_map_choice(Operation::new(
        "getMap",
        "scene",
        "A layer's map as a picture.",
    ))
    .query(
        "format",
        "The format; by `Accept` where it is left out.",
        json!({"type": "string", "enum": ["png", "exr"]}),
    )
    .with_known()
    .answer(
        "PNG with 16 bits of grey, or EXR with 32-bit floats.",
        picture_files(),
        true,
    )
    .problem(406, "`Accept` names neither.")
    .problem(503, "The server is ending.")
    .value()
}

fn replace_map() -> Value {
    with_transition(with_map_choice(Operation::new("replaceMap", "scene", "Replaces a layer's map by a file.")))
        .description(
            "PNG with 8 or 16 bits of grey or EXR with one channel, sides of 1 to 8192, at most 64 MiB. The file tells what \
             it is; its content type is not looked at.",
        )
        .with_precondition()
        .body(json!({
            "image/png": {"schema": {"type": "string", "contentMediaType": "image/png"}},
            "image/x-exr": {"schema": {"type": "string", "contentMediaType": "image/x-exr"}},
        }))
        .answer_json("The scene that names the map.", reference("Scene"), true)
        .problem(415, "The file is no picture.")
        .problem(503, "The server is ending.")
        .problem(507, "There is no room for another map.")
        .value()
}

fn reset_map() -> Value {
    with_transition(with_map_choice(Operation::new(
        "resetMap",
        "scene",
        "Brings the map back that is made from the seed.",
    )))
    .with_precondition()
    .answer_json("The scene without the file.", reference("Scene"), true)
    .value()
}

fn presets() -> Value {
    Operation::new(
        "getPresets",
        "presets",
        "Names, titles and cameras of the presets.",
    )
    .answer_json("All presets.", list_of("Preset"), false)
    .value()
}

fn preset() -> Value {
    Operation::new("getPreset", "presets", "A preset with its scene.")
        .path("name", "Its name.", json!({"type": "string"}))
        .answer_json("The preset.", reference("WholePreset"), false)
        .problem(400, "The name is no text.")
        .problem(404, "There is no such preset.")
        .value()
}

fn figures(id: &str, summary: &str, schema: Value) -> Value {
    Operation::new(id, "figures", summary)
        .answer_json(summary, schema, false)
        .value()
}

fn snapshot() -> Value {
    let usual = Camera::default();
    let [x_m, altitude_m, z_m] = usual.position_m();
    let number = |range: NumberRange, default: f64, unit: &str| json!({"type": "number", "minimum": range.min, "maximum": range.max, "default": default, "x-unit": unit});
    let pixels = |most: u32, default: u32| json!({"type": "integer", "minimum": 1, "maximum": most, "default": default});
    let [width, height] = snapshot::SIZE;
    let mut operation = Operation::new("getSnapshot", "stream", "A picture of the sky as it is now.")
        .description(&format!(
            "From a viewer that is there for a moment: the first frame that has settled, or, under a sky that moves, one in \
             which nothing is coarse any more. At most {} pixels. One is made at a time, {} may wait, and none takes longer \
             than {} s.",
            snapshot::PIXELS_MAX,
            snapshot::WAITING_MAX,
            snapshot::TIMEOUT.as_secs()
        ))
        .query("x_m", "East.", number(POSITION_HORIZONTAL_M, x_m, "m"))
        .query("altitude_m", "Above the ground sphere.", number(POSITION_ALTITUDE_M, altitude_m, "m"))
        .query("z_m", "South.", number(POSITION_HORIZONTAL_M, z_m, "m"))
        .query("yaw_deg", "Clockwise from north.", number(YAW_DEG, usual.yaw_deg(), "deg"))
        .query("pitch_deg", "Up from the horizon.", number(PITCH_DEG, usual.pitch_deg(), "deg"))
        .query("fov_deg", "The angle between the upper and the lower edge.", number(VERTICAL_FOV_DEG, usual.vertical_fov_deg(), "deg"))
        .query("width", "Pixels in a row.", pixels(FRAME_WIDTH_MAX, width))
        .query("height", "Rows.", pixels(FRAME_HEIGHT_MAX, height))
        .query(
            "format",
            "The format; by `Accept` where it is left out.",
            json!({"type": "string", "enum": ["png", "exr"], "default": "png"}),
        )
        .answer(
            "PNG as it is shown, or EXR: radiance in W/(m² nm sr) at 680, 550 and 440 nm as 32-bit floats R, G and B, before \
             white balance, exposure and curve.",
            picture_files(),
            false,
        )
        .problem(400, "The query cannot be read.")
        .problem(406, "`Accept` names neither.")
        .problem(422, "A value is not allowed.")
        .problem(429, "Too many wait already, or too many requests of this address: `Retry-After` tells when to try again.")
        .problem(503, "No frame was ready in time, too many viewers are connected, or the server is ending.")
        .value();
    operation["responses"]["200"]["headers"] = json!({
        "Skycell-Scene-Revision": {"description": "The scene that is shown.", "schema": {"type": "integer"}},
        "Skycell-Exact": {
            "description": "Whether nothing finer would come.",
            "schema": {"type": "string", "enum": ["true", "false"]},
        },
    });
    operation
}

fn document() -> Value {
    Operation::new("getOpenApi", "documentation", "This document.")
        .with_known()
        .answer_json("OpenAPI 3.1.", json!({"type": "object"}), true)
        .value()
}

fn documentation() -> Value {
    Operation::new(
        "getDocumentation",
        "documentation",
        "This document for people.",
    )
    .with_known()
    .answer(
        "A page.",
        json!({"text/html": {"schema": {"type": "string"}}}),
        true,
    )
    .value()
}

fn metrics() -> Value {
    Operation::new("getMetrics", "health", "Figures for Prometheus.")
        .answer(
            "Text format 0.0.4.",
            json!({"text/plain": {"schema": {"type": "string"}}}),
            false,
        )
        .value()
}

fn health(id: &str, summary: &str, may_fail: bool) -> Value {
    let operation = Operation::new(id, "health", summary).answer(
        "It does.",
        json!({"text/plain": {"schema": {"type": "string"}}}),
        false,
    );
    if may_fail {
        operation
            .problem(503, "It cannot serve yet, or not any more.")
            .value()
    } else {
        operation.value()
    }
}

fn web_socket() -> Value {
    let mut operation = Operation::new("stream", "stream", "The WebSocket over which frames come.")
        .description(&format!(
            "Subprotocol `{SUBPROTOCOL}`. Its messages and its frames are described in the README, and with every field in \
             the documentation of the crate `skycell-protocol`."
        ))
        .problem(400, "This is no WebSocket handshake, or one of another subprotocol.")
        .problem(426, "The connection cannot become a WebSocket.")
        .problem(503, "Too many are connected, or the server is ending.")
        .value();
    operation["responses"]["101"] = json!({"description": "The connection becomes a WebSocket."});
    operation
}
