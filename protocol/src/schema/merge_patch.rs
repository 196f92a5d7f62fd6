//! The schema of a merge patch (RFC 7396) out of that of the document that it changes.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};

use super::COMPONENTS;

/// Adds the schema `<name>Patch`, and those that it refers to, to `schemas`: every key may be left out, null takes it
/// away, arrays are replaced as a whole. Keys of a tagged document's alternatives may stand together, since those of the
/// alternative of before are taken away with null.
pub fn merge_patch_of(name: &str, schemas: &mut Map<String, Value>) {
    let mut waiting = vec![name.to_owned()];
    let mut known: BTreeSet<String> = waiting.iter().cloned().collect();
    while let Some(name) = waiting.pop() {
        let Some(schema) = schemas.get(&name) else {
            continue;
        };
        let mut maker = PatchMaker {
            schemas,
            found: Vec::new(),
        };
        let patch = maker.patch_of(schema);
        for found in maker.found {
            if known.insert(found.clone()) {
                waiting.push(found);
            }
        }
        schemas.insert(format!("{name}Patch"), patch);
    }
}

struct PatchMaker<'a> {
    schemas: &'a Map<String, Value>,
    /// Schemas of which a patch is referred to.
    found: Vec<String>,
}

impl PatchMaker<'_> {
    fn patch_of(&mut self, schema: &Value) -> Value {
        let Some(members) = schema.as_object() else {
            return schema.clone();
        };
        if let Some(name) = members
            .get("$ref")
            .and_then(Value::as_str)
            .and_then(|at| at.strip_prefix(COMPONENTS))
        {
            if !self.is_patched(schema) {
                return schema.clone();
            }
            self.found.push(name.to_owned());
            return with_text(members, json!({"$ref": format!("{COMPONENTS}{name}Patch")}));
        }
        if let Some(choices) = members
            .get("oneOf")
            .or_else(|| members.get("anyOf"))
            .and_then(Value::as_array)
        {
            let (objects, others): (Vec<&Value>, Vec<&Value>) = choices
                .iter()
                .partition(|choice| choice.get("properties").is_some());
            let mut patches = Vec::new();
            if !objects.is_empty() {
                patches.push(self.patch_of_any(&objects));
            }
            patches.extend(others.into_iter().map(|other| self.patch_of(other)));
            return match <[Value; 1]>::try_from(patches) {
                Ok([Value::Object(one)]) => with_text(members, Value::Object(one)),
                Ok([other]) => other,
                Err(patches) => with_text(members, json!({"anyOf": patches})),
            };
        }
        if members.contains_key("properties") {
            return with_text(members, self.patch_of_any(&[schema]));
        }
        if let Some(values @ Value::Object(_)) = members.get("additionalProperties") {
            let value = nullable(self.patch_of(values));
            return with_text(
                members,
                json!({"type": "object", "additionalProperties": value}),
            );
        }
        let mut same = members.clone();
        same.remove("default");
        Value::Object(same)
    }

    /// A patch that may hold the keys of any of several objects.
    fn patch_of_any(&mut self, objects: &[&Value]) -> Value {
        let mut properties: Map<String, Value> = Map::new();
        let mut order: Vec<Value> = Vec::new();
        for object in objects {
            let keys = object.get("x-order").and_then(Value::as_array);
            for key in keys.into_iter().flatten() {
                if !order.contains(key) {
                    order.push(key.clone());
                }
            }
            for (key, value) in object
                .get("properties")
                .and_then(Value::as_object)
                .into_iter()
                .flatten()
            {
                let patch = self.patch_of(value);
                match properties.get_mut(key) {
                    None => {
                        properties.insert(key.clone(), patch);
                    }
                    Some(before) => *before = either(before.take(), patch),
                }
            }
        }
        for (_, property) in &mut properties {
            *property = nullable(property.take());
        }
        let mut patch =
            json!({"type": "object", "properties": properties, "additionalProperties": false});
        if !order.is_empty() {
            patch["x-order"] = order.into();
        }
        patch
    }

    /// Whether a patch of it is anything else than a value in its place: whether there are keys.
    fn is_patched(&self, schema: &Value) -> bool {
        if schema.get("properties").is_some()
            || schema
                .get("additionalProperties")
                .is_some_and(Value::is_object)
        {
            return true;
        }
        let named = schema
            .get("$ref")
            .and_then(Value::as_str)
            .and_then(|at| at.strip_prefix(COMPONENTS))
            .and_then(|name| self.schemas.get(name));
        let choices = ["oneOf", "anyOf"]
            .into_iter()
            .filter_map(|key| schema.get(key)?.as_array())
            .flatten();
        named
            .into_iter()
            .chain(choices)
            .any(|below| self.is_patched(below))
    }
}

/// Keeps what is said about a schema in words.
fn with_text(members: &Map<String, Value>, mut patch: Value) -> Value {
    for key in ["description", "x-unit"] {
        if let (Some(text), Value::Object(patch)) = (members.get(key), &mut patch) {
            patch.entry(key).or_insert_with(|| text.clone());
        }
    }
    patch
}

/// One or the other; two names become one enumeration.
fn either(one: Value, other: Value) -> Value {
    if one == other {
        return one;
    }
    let names = |schema: &Value| -> Option<Vec<Value>> {
        schema
            .get("const")
            .map(|name| vec![name.clone()])
            .or_else(|| schema.get("enum")?.as_array().cloned())
    };
    if let (Some(mut all), Some(more)) = (names(&one), names(&other)) {
        all.extend(more);
        return json!({"type": "string", "enum": all});
    }
    match one {
        Value::Object(mut members) if members.contains_key("anyOf") && members.len() == 1 => {
            if let Some(Value::Array(choices)) = members.get_mut("anyOf")
                && !choices.contains(&other)
            {
                choices.push(other);
            }
            Value::Object(members)
        }
        one => json!({"anyOf": [one, other]}),
    }
}

/// The schema, or null.
fn nullable(mut schema: Value) -> Value {
    if let Value::Object(members) = &mut schema {
        if let Some(Value::Array(choices)) = members.get_mut("anyOf") {
            let null = json!({"type": "null"});
            if !choices.contains(&null) {
                choices.push(null);
            }
            return schema;
        }
        if let Some(constant) = members.remove("const") {
            members.insert("enum".into(), json!([constant]));
        }
        if let Some(Value::Array(names)) = members.get_mut("enum")
            && !names.contains(&Value::Null)
        {
            names.push(Value::Null);
        }
        let is_enumeration = members.contains_key("enum");
        match members.get_mut("type") {
            Some(Value::Array(kinds)) => {
                if !kinds.iter().any(|kind| kind == "null") {
                    kinds.push("null".into());
                }
                return schema;
            }
            Some(kind) => {
                *kind = json!([kind.take(), "null"]);
                return schema;
            }
            None if is_enumeration => return schema,
            None => {}
        }
    }
    let description = schema.get("description").cloned();
    let mut either = json!({"anyOf": [schema, {"type": "null"}]});
    if let Some(text) = description {
        either["description"] = text;
    }
    either
}
