//! What requests and answers hold.

use serde_json::{Map, Value, json};
use skycell_protocol::ShowReport;
use skycell_protocol::scene::ranges;
use skycell_protocol::schema::{
    COMPONENTS, definitions_of, generator_of_requests, generator_of_responses, merge_patch_of,
};
use skycell_protocol::{Moment, SceneDocument};

use super::super::figures::{StatsReport, ViewerReport};
use super::super::presets::WholePreset;
use super::super::problem::Problem;
use super::super::revisions::Page;
use super::super::scene_events::{GapEvent, SceneEvent};
use super::super::scene_time::{SceneNow, TimeReport};
use crate::frame_loop::interface::CellStats;
use crate::scene::{OPERATIONS_MAX, Preset, presets};

/// A reference to a schema.
pub(super) fn reference(name: &str) -> Value {
    json!({"$ref": format!("{COMPONENTS}{name}")})
}

/// Every schema, by name.
pub(super) fn all() -> Map<String, Value> {
    let mut requests = generator_of_requests();
    requests.subschema_for::<SceneDocument>();
    requests.subschema_for::<Moment>();
    let mut schemas = definitions_of(requests);
    merge_patch_of("Scene", &mut schemas);
    let mut responses = generator_of_responses();
    responses.subschema_for::<TimeReport>();
    responses.subschema_for::<SceneNow>();
    responses.subschema_for::<Preset>();
    responses.subschema_for::<WholePreset<'_>>();
    responses.subschema_for::<CellStats>();
    responses.subschema_for::<ViewerReport>();
    responses.subschema_for::<StatsReport>();
    responses.subschema_for::<ShowReport>();
    responses.subschema_for::<Problem>();
    responses.subschema_for::<Page<'_>>();
    responses.subschema_for::<SceneEvent<'_>>();
    responses.subschema_for::<GapEvent>();
    for (name, schema) in definitions_of(responses) {
        // What is read is described with its defaults; it holds for what is written, too.
        schemas.entry(name).or_insert(schema);
    }
    schemas.insert("JsonPatch".to_owned(), json_patch());
    schemas.insert("TimeChange".to_owned(), time_change());
    schemas.insert("PresetChoice".to_owned(), preset_choice());
    schemas.insert("RevertChoice".to_owned(), revert_choice());
    schemas
}

/// RFC 6902.
fn json_patch() -> Value {
    let pointer = |about: &str| json!({"type": "string", "pattern": "^(/([^~/]|~[01])*)*$", "description": about});
    let operation = |names: &[&str], other: Option<&str>| {
        let mut properties = json!({
            "op": {"type": "string", "enum": names},
            "path": pointer("JSON pointer (RFC 6901) of the value."),
        });
        let mut required = vec!["op", "path"];
        if let Some(other) = other {
            properties[other] = match other {
                "from" => pointer("JSON pointer of the value that is moved or copied."),
                _ => json!({"description": "Any JSON value."}),
            };
            required.push(other);
        }
        json!({"type": "object", "properties": properties, "required": required})
    };
    json!({
        "description": "A JSON patch (RFC 6902): all of its operations or none.",
        "type": "array",
        "maxItems": OPERATIONS_MAX,
        "items": {
            "oneOf": [
                operation(&["add", "replace", "test"], Some("value")),
                operation(&["remove"], None),
                operation(&["move", "copy"], Some("from")),
            ],
        },
    })
}

fn time_change() -> Value {
    let rate = |about: &str, kind: Value| {
        json!({
            "type": kind,
            "minimum": ranges::TIME_RATE.min,
            "maximum": ranges::TIME_RATE.max,
            "description": about,
        })
    };
    json!({
        "description": "What is to change about the sky's clock; the rest stays. `sky_s` and `date` not together.",
        "type": "object",
        "properties": {
            "paused": {"type": "boolean", "description": "Whether the sky stands still."},
            "rate": rate("Seconds of sky time in a second.", json!("number")),
            "wind_rate": rate("Seconds of wind in a second; null for `rate`.", json!(["number", "null"])),
            "sky_s": {
                "type": "number",
                "minimum": ranges::SKY_TIME_S.min,
                "maximum": ranges::SKY_TIME_S.max,
                "description": "Sky time.",
                "x-unit": "s",
            },
            "date": {
                "description": "Sky time by the date at the sun's place, where the sun has one.",
                "$ref": format!("{COMPONENTS}Moment"),
            },
        },
        "not": {"required": ["sky_s", "date"]},
        "additionalProperties": false,
        "x-order": ["paused", "rate", "wind_rate", "sky_s", "date"],
    })
}

fn revert_choice() -> Value {
    json!({
        "description": "Which revision is to come back; the one before the last change where none is named.",
        "type": "object",
        "properties": {
            "revision": {
                "type": ["integer", "null"],
                "minimum": 0,
                "maximum": 9_007_199_254_740_991_u64,
                "default": null,
                "description": "Its number.",
            },
            "transition_s": {
                "type": "number",
                "minimum": ranges::TRANSITION_S.min,
                "maximum": ranges::TRANSITION_S.max,
                "default": 0.0,
                "description": "How long the change takes.",
                "x-unit": "s",
            },
        },
        "additionalProperties": false,
        "x-order": ["revision", "transition_s"],
    })
}

fn preset_choice() -> Value {
    let names: Vec<&str> = presets()
        .iter()
        .map(|preset| preset.name.as_str())
        .collect();
    json!({
        "description": "A sky by name, and how long the present one takes to become it.",
        "type": "object",
        "properties": {
            "name": {"type": "string", "enum": names, "description": "The preset's name."},
            "transition_s": {
                "type": "number",
                "minimum": ranges::TRANSITION_S.min,
                "maximum": ranges::TRANSITION_S.max,
                "default": super::super::presets::TRANSITION_S,
                "description": "How long the change takes.",
                "x-unit": "s",
            },
        },
        "required": ["name"],
        "additionalProperties": false,
        "x-order": ["name", "transition_s"],
    })
}
