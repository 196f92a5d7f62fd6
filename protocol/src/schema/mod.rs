//! JSON Schemas (draft 2020-12, as OpenAPI 3.1 has them) of what this crate reads.
//!
//! They are derived from the wire types; the ranges are those of [`crate::scene::ranges`]. A range that is told here and one
//! that is checked there name the same constant, and `protocol/tests/schema` holds schema and reader against each other.
//! What only several values together decide (a layer's top above its base) no schema tells.
//!
//! Beside the standard's own keys: `x-unit`, the unit of a number, which is the end of its key (`m`, `deg`, `per_m`);
//! `x-order`, the keys of an object in the order in which they are written; `x-enum-descriptions`, what each name of an
//! `enum` means.

mod merge_patch;

use schemars::generate::SchemaSettings;
use schemars::{Schema, SchemaGenerator};
use serde_json::{Map, Value, json};

pub use merge_patch::merge_patch_of;

use crate::camera::{POSITION_ALTITUDE_M, POSITION_HORIZONTAL_M};
use crate::scene::{SCENE_VERSION, SceneDocument, ranges};

/// Where the schemas of an OpenAPI document stand, as its references write it.
pub const COMPONENTS: &str = "#/components/schemas/";

/// Units at the ends of keys; of two that fit, the first holds.
const UNITS: [&str; 15] = [
    "w_per_m2_nm_sr",
    "w_per_m2_nm",
    "m_per_s",
    "kbit_per_s",
    "mbit_per_s",
    "per_m",
    "deg",
    "dobson",
    "bytes",
    "ev",
    "um",
    "ms",
    "us",
    "m",
    "s",
];

/// Makes schemas of what is read; they refer to each other under [`COMPONENTS`].
pub fn generator_of_requests() -> SchemaGenerator {
    settings().for_deserialize().into_generator()
}

/// Makes schemas of what is written, in which keys that are always there are required.
pub fn generator_of_responses() -> SchemaGenerator {
    settings().for_serialize().into_generator()
}

fn settings() -> SchemaSettings {
    SchemaSettings::draft2020_12().with(|settings| {
        settings.definitions_path = COMPONENTS
            .trim_start_matches('#')
            .trim_end_matches('/')
            .into();
        settings.meta_schema = None;
    })
}

/// The schemas that a generator has made, by name, with units.
pub fn definitions_of(mut generator: SchemaGenerator) -> Map<String, Value> {
    generator
        .take_definitions(true)
        .into_iter()
        .map(|(name, mut schema)| {
            finish(&mut schema, None);
            (short_name(&name).to_owned(), schema)
        })
        .collect()
}

/// The scene's schemas, by name: `Scene`, `ScenePatch` (a merge patch of it) and what the two refer to.
pub fn scene_schemas() -> Map<String, Value> {
    let mut generator = generator_of_requests();
    generator.subschema_for::<SceneDocument>();
    let mut schemas = definitions_of(generator);
    merge_patch_of("Scene", &mut schemas);
    schemas
}

/// `SceneDocument` is `Scene` to the world.
fn short_name(name: &str) -> &str {
    name.strip_suffix("Document").unwrap_or(name)
}

/// Names, units and enumerations of a schema and all below. `key` is the property that it is of.
fn finish(schema: &mut Value, key: Option<&str>) {
    match schema {
        Value::Array(items) => items.iter_mut().for_each(|item| finish(item, key)),
        Value::Object(members) => {
            finish_one(members, key);
            for (name, below) in members.iter_mut() {
                match name.as_str() {
                    "properties" => {
                        for (key, property) in below.as_object_mut().into_iter().flatten() {
                            finish(property, Some(key));
                        }
                    }
                    "items" | "prefixItems" | "anyOf" | "oneOf" | "allOf" => finish(below, key),
                    "additionalProperties" => finish(below, None),
                    _ => {}
                }
            }
        }
        _ => {}
    }
}

fn finish_one(schema: &mut Map<String, Value>, key: Option<&str>) {
    if let Some(Value::String(reference)) = schema.get_mut("$ref") {
        *reference = short_name(reference).to_owned();
    }
    if has_type(schema, "integer") {
        if schema.get("format").and_then(Value::as_str) == Some("uint32") {
            schema.entry("maximum").or_insert(u32::MAX.into());
        }
        for end in ["minimum", "maximum"] {
            if let Some(number) = schema.get(end).and_then(Value::as_f64) {
                schema.insert(end.to_owned(), (number as u64).into());
            }
        }
    }
    if has_type(schema, "integer") || has_type(schema, "number") {
        // `double` and `uint32` say nothing about what is allowed.
        schema.remove("format");
        if let Some(unit) = key.and_then(unit_of) {
            schema.entry("x-unit").or_insert(unit.into());
        }
    }
    name_enumeration(schema);
}

/// Whether a value of the type may stand there.
fn has_type(schema: &Map<String, Value>, kind: &str) -> bool {
    match schema.get("type") {
        Some(Value::String(only)) => only == kind,
        Some(Value::Array(kinds)) => kinds.iter().any(|each| each == kind),
        _ => false,
    }
}

/// The unit at the end of a key.
fn unit_of(key: &str) -> Option<&'static str> {
    UNITS.into_iter().find(|unit| {
        key.strip_suffix(unit)
            .is_some_and(|before| before.ends_with('_'))
    })
}

/// `oneOf` names that each have a description become one `enum`.
fn name_enumeration(schema: &mut Map<String, Value>) {
    let Some(Value::Array(choices)) = schema.get("oneOf") else {
        return;
    };
    let mut names = Vec::new();
    let mut meanings = Map::new();
    for choice in choices {
        let Some(Value::String(name)) = choice.get("const") else {
            return;
        };
        if let Some(meaning) = choice.get("description") {
            meanings.insert(name.clone(), meaning.clone());
        }
        names.push(Value::from(name.clone()));
    }
    schema.remove("oneOf");
    schema.insert("type".to_owned(), "string".into());
    schema.insert("enum".to_owned(), names.into());
    if !meanings.is_empty() {
        schema.insert("x-enum-descriptions".to_owned(), meanings.into());
    }
}

/// x, altitude and z of what a layer holds.
pub(crate) fn place(schema: &mut Schema) {
    three_numbers(
        schema,
        [
            ranges::SHAPE_HORIZONTAL_M,
            ranges::SHAPE_ALTITUDE_M,
            ranges::SHAPE_HORIZONTAL_M,
        ],
    );
}

/// x, altitude and z of a viewer.
pub(crate) fn position(schema: &mut Schema) {
    three_numbers(
        schema,
        [
            POSITION_HORIZONTAL_M,
            POSITION_ALTITUDE_M,
            POSITION_HORIZONTAL_M,
        ],
    );
}

fn three_numbers(schema: &mut Schema, each: [crate::number_range::NumberRange; 3]) {
    schema.remove("items");
    let items =
        each.map(|range| json!({"type": "number", "minimum": range.min, "maximum": range.max}));
    schema.insert("prefixItems".into(), Value::from(items.to_vec()));
}

/// A document must tell its version, and there is one.
pub(crate) fn with_version(schema: &mut Schema) {
    schema.insert("required".into(), json!(["version"]));
    if let Some(version) = schema
        .pointer_mut("/properties/version")
        .and_then(Value::as_object_mut)
    {
        version.insert("const".into(), SCENE_VERSION.into());
    }
}

/// Keys whose defaults are not allowed.
pub(crate) fn must_have(keys: &'static [&'static str]) -> impl FnMut(&mut Schema) {
    move |schema| {
        schema.insert("required".into(), json!(keys));
        for key in keys {
            if let Some(property) = schema
                .pointer_mut(&format!("/properties/{key}"))
                .and_then(Value::as_object_mut)
            {
                property.remove("default");
            }
        }
    }
}

/// One of a tagged document's alternatives is meant where there is no tag.
pub(crate) fn optional_tag(tag: &'static str, default: &'static str) -> impl FnMut(&mut Schema) {
    move |schema| {
        let choices = schema.get_mut("oneOf").and_then(Value::as_array_mut);
        for choice in choices
            .into_iter()
            .flatten()
            .filter_map(Value::as_object_mut)
        {
            match choice.get_mut("x-order") {
                Some(Value::Array(order)) => order.insert(0, tag.into()),
                _ => {
                    choice.insert("x-order".into(), json!([tag]));
                }
            }
            choice.entry("additionalProperties").or_insert(false.into());
            let property = choice
                .get_mut("properties")
                .and_then(|properties| properties.get_mut(tag))
                .and_then(Value::as_object_mut);
            let is_default = property
                .as_ref()
                .is_some_and(|property| property.get("const") == Some(&default.into()));
            if is_default {
                if let Some(property) = property {
                    property.insert("default".into(), default.into());
                }
                if let Some(Value::Array(required)) = choice.get_mut("required") {
                    required.retain(|key| key != tag);
                }
            }
        }
    }
}

/// Takes properties out of an object.
pub(crate) fn remove_properties(schema: &mut Schema, keys: &[&str]) {
    if let Some(Value::Object(properties)) = schema.get_mut("properties") {
        properties.retain(|key, _| !keys.contains(&key.as_str()));
    }
    if let Some(Value::Array(order)) = schema.get_mut("x-order") {
        order.retain(|key| key.as_str().is_none_or(|key| !keys.contains(&key)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_what_a_key_ends_with() {
        for (key, unit) in [
            ("radius_m", Some("m")),
            ("speed_m_per_s", Some("m_per_s")),
            ("extinction_per_m", Some("per_m")),
            ("irradiance_w_per_m2_nm", Some("w_per_m2_nm")),
            ("radiance_w_per_m2_nm_sr", Some("w_per_m2_nm_sr")),
            ("exposure_ev", Some("ev")),
            ("coverage", None),
            ("layers", None),
            ("s", None),
        ] {
            assert_eq!(unit_of(key), unit, "{key}");
        }
    }
}
