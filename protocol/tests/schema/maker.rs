//! The scene's schemas, a validator, and random documents that are made of them.

use fastrand::Rng;
use jsonschema::Validator;
use serde_json::{Map, Value, json};
use skycell_protocol::schema::{COMPONENTS, scene_schemas};

pub(crate) struct Schemas {
    pub(crate) all: Map<String, Value>,
}

impl Schemas {
    pub(crate) fn new() -> Self {
        Self {
            all: scene_schemas(),
        }
    }

    pub(crate) fn validator(&self, name: &str) -> Validator {
        let document = json!({
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "$ref": format!("{COMPONENTS}{name}"),
            "components": {"schemas": self.all},
        });
        jsonschema::options()
            .should_validate_formats(true)
            .build(&document)
            .expect("a schema")
    }

    /// What a schema refers to.
    pub(crate) fn resolved<'a>(&'a self, schema: &'a Value) -> &'a Value {
        match schema.get("$ref").and_then(Value::as_str) {
            Some(at) => self.resolved(&self.all[at.trim_start_matches(COMPONENTS)]),
            None => schema,
        }
    }
}

pub(crate) fn complaints(validator: &Validator, document: &Value) -> String {
    let all: Vec<String> = validator
        .iter_errors(document)
        .take(3)
        .map(|error| format!("{}: {error}", error.instance_path()))
        .collect();
    all.join("; ")
}

/// A document of the schema: keys are left out or there, numbers at their ends or between.
pub(crate) struct Maker<'a> {
    pub(crate) schemas: &'a Schemas,
    pub(crate) rng: Rng,
}

impl Maker<'_> {
    pub(crate) fn value_of(&mut self, schema: &Value, depth: usize) -> Value {
        let schema = self.schemas.resolved(schema).clone();
        if let Some(constant) = schema.get("const") {
            return constant.clone();
        }
        if let Some(names) = schema.get("enum").and_then(Value::as_array) {
            return names[self.rng.usize(..names.len())].clone();
        }
        for key in ["oneOf", "anyOf"] {
            if let Some(choices) = schema.get(key).and_then(Value::as_array) {
                let choice = choices[self.rng.usize(..choices.len())].clone();
                return self.value_of(&choice, depth);
            }
        }
        let kinds: Vec<&str> = match &schema["type"] {
            Value::String(kind) => vec![kind],
            Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).collect(),
            other => panic!("no type {other} in {schema}"),
        };
        match kinds[self.rng.usize(..kinds.len())] {
            "null" => Value::Null,
            "boolean" => self.rng.bool().into(),
            "integer" => {
                let (low, high) = ends(&schema);
                match self.rng.u8(..4) {
                    0 => json!(low as u64),
                    1 => json!(high as u64),
                    _ => json!(self.rng.u64(low as u64..=high as u64)),
                }
            }
            "number" => {
                let (low, high) = ends(&schema);
                match self.rng.u8(..4) {
                    0 => json!(low),
                    1 => json!(high),
                    _ => json!((low + self.rng.f64() * (high - low)).clamp(low, high)),
                }
            }
            "string" => self.text_of(&schema).into(),
            "array" => {
                if let Some(each) = schema.get("prefixItems").and_then(Value::as_array) {
                    return each.iter().map(|item| self.value_of(item, depth)).collect();
                }
                let least = schema.get("minItems").and_then(Value::as_u64).unwrap_or(0);
                let most = schema.get("maxItems").and_then(Value::as_u64).unwrap_or(3);
                let count = self.rng.u64(least..=most.min(least.max(2)));
                (0..count)
                    .map(|_| self.value_of(&schema["items"], depth + 1))
                    .collect()
            }
            "object" => self.object_of(&schema, depth),
            kind => panic!("no {kind} can be made"),
        }
    }

    fn text_of(&mut self, schema: &Value) -> String {
        if schema.get("format") == Some(&json!("date-time")) {
            return ["2026-06-21T10:30:00Z", "1999-12-31T23:59:59.5+02:00"][self.rng.usize(..2)]
                .to_owned();
        }
        let letters = self.rng.usize(1..=12);
        (0..letters).map(|_| self.rng.alphanumeric()).collect()
    }

    fn object_of(&mut self, schema: &Value, depth: usize) -> Value {
        let mut object = Map::new();
        let required = schema.get("required").cloned().unwrap_or(json!([]));
        let required: Vec<&str> = required
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
            .collect();
        let properties = schema.get("properties").and_then(Value::as_object);
        for (key, property) in properties.into_iter().flatten() {
            // Scenes in scenes go on for ever.
            let is_there = self.rng.u8(..10) < if depth > 6 { 1 } else { 5 };
            if is_there || required.contains(&key.as_str()) {
                object.insert(key.clone(), self.value_of(property, depth + 1));
            }
        }
        if let Some(values @ Value::Object(_)) = schema.get("additionalProperties") {
            for _ in 0..self.rng.usize(..3) {
                let key = self.text_of(&Value::Null);
                object.insert(key, self.value_of(values, depth + 1));
            }
        }
        Value::Object(object)
    }
}

/// The ends of a number.
pub(crate) fn ends(schema: &Value) -> (f64, f64) {
    let end = |key: &str, default: f64| schema.get(key).and_then(Value::as_f64).unwrap_or(default);
    (end("minimum", -1.0e3), end("maximum", 1.0e3))
}
