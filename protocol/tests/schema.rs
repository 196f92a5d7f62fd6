//! The scene's schema against the scene's reader: what one takes, the other takes.

use std::collections::BTreeSet;

use fastrand::Rng;
use jsonschema::Validator;
use serde_json::{Map, Value, json};
use skycell_protocol::scene::{Family, Scene, SceneDocument};
use skycell_protocol::schema::{COMPONENTS, scene_schemas};

struct Schemas {
    all: Map<String, Value>,
}

impl Schemas {
    fn new() -> Self {
        Self {
            all: scene_schemas(),
        }
    }

    fn validator(&self, name: &str) -> Validator {
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
    fn resolved<'a>(&'a self, schema: &'a Value) -> &'a Value {
        match schema.get("$ref").and_then(Value::as_str) {
            Some(at) => self.resolved(&self.all[at.trim_start_matches(COMPONENTS)]),
            None => schema,
        }
    }
}

fn complaints(validator: &Validator, document: &Value) -> String {
    let all: Vec<String> = validator
        .iter_errors(document)
        .take(3)
        .map(|error| format!("{}: {error}", error.instance_path()))
        .collect();
    all.join("; ")
}

/// A document of the schema: keys are left out or there, numbers at their ends or between.
struct Maker<'a> {
    schemas: &'a Schemas,
    rng: Rng,
}

impl Maker<'_> {
    fn value_of(&mut self, schema: &Value, depth: usize) -> Value {
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
fn ends(schema: &Value) -> (f64, f64) {
    let end = |key: &str, default: f64| schema.get(key).and_then(Value::as_f64).unwrap_or(default);
    (end("minimum", -1.0e3), end("maximum", 1.0e3))
}

/// Rules between several values, by the words of the reader's error: no schema tells them.
const RULES_BETWEEN_VALUES: [&str; 15] = [
    "(not below base_altitude_m)",
    "(above bounds_min_m)",
    "(min_ev) or more",
    "a name that no other layer has",
    "the time of the keyframe before",
    "a loop does not jump",
    "a number that no other animation changes",
    "a JSON pointer of a number of the scene",
    "a number that is no count",
    "a number; ",
    "no wind: ",
    "no place or length of the sky's pattern",
    "no angle of a sun that stands by place_and_time",
    "false on a flat planet",
    "voxels",
];

/// The document's own part of an animation's path is a text; all else about it is a rule between values, too: whatever a
/// keyframe's value breaks where the path leads.
fn is_rule_between_values(pointer: &str, allowed: &str) -> bool {
    RULES_BETWEEN_VALUES
        .iter()
        .any(|words| allowed.contains(words))
        || (pointer.starts_with("/animation/") || pointer.contains("/animation/"))
            && pointer.ends_with("/value")
}

/// What a reader takes and the schema does not: a density without the name of its model in a layer of a family of ice.
fn is_taken_beyond_the_schema(document: &Value) -> bool {
    let layers = |scene: &Value| -> Vec<Value> {
        scene
            .get("layers")
            .and_then(Value::as_array)
            .cloned()
            .unwrap_or_default()
    };
    let mut all = layers(document);
    if let Some(from) = document.pointer("/transition/from") {
        all.extend(layers(from));
    }
    all.iter().any(|layer| {
        ["cirrus", "cirrostratus"]
            .iter()
            .any(|name| layer["family"] == *name)
            && layer
                .get("density")
                .is_some_and(|density| density.get("model").is_none())
    })
}

#[test]
fn every_document_that_the_reader_writes_is_one_of_the_schema() {
    let schemas = Schemas::new();
    let validator = schemas.validator("Scene");
    let default = serde_json::to_value(SceneDocument::default()).expect("JSON");
    assert!(
        validator.is_valid(&default),
        "{}",
        complaints(&validator, &default)
    );
    for family in Family::ALL {
        let named = json!({"version": 1, "layers": [{"family": family.name()}]});
        assert!(
            validator.is_valid(&named),
            "{}",
            complaints(&validator, &named)
        );
        let whole = serde_json::to_value(Scene::from_json(&named).expect("a scene").to_document())
            .expect("JSON");
        assert!(
            validator.is_valid(&whole),
            "{}",
            complaints(&validator, &whole)
        );
    }
}

#[test]
fn random_documents_of_the_schema_are_scenes_but_for_rules_between_values() {
    let schemas = Schemas::new();
    let validator = schemas.validator("Scene");
    let mut maker = Maker {
        schemas: &schemas,
        rng: Rng::with_seed(1),
    };
    let (mut taken, mut rules) = (0, BTreeSet::new());
    for _ in 0..3000 {
        let document = maker.value_of(&schemas.all["Scene"], 0);
        if is_taken_beyond_the_schema(&document) {
            assert!(!validator.is_valid(&document), "{document}");
            continue;
        }
        assert!(
            validator.is_valid(&document),
            "the maker is wrong: {document}: {}",
            complaints(&validator, &document)
        );
        match Scene::from_json(&document) {
            Ok(scene) => {
                taken += 1;
                let written = serde_json::to_value(scene.to_document()).expect("JSON");
                assert!(
                    validator.is_valid(&written),
                    "{document} is written as {written}: {}",
                    complaints(&validator, &written)
                );
            }
            Err(error) => {
                assert!(
                    is_rule_between_values(&error.pointer, &error.allowed),
                    "{document} is of the schema, but {error}"
                );
                rules.insert(error.allowed);
            }
        }
    }
    println!(
        "3000 documents, {taken} are scenes; {} kinds of refusals",
        rules.len()
    );
    assert!(taken > 300, "{taken}");
}

#[test]
fn documents_with_a_fault_are_refused_by_both() {
    let schemas = Schemas::new();
    let validator = schemas.validator("Scene");
    let mut maker = Maker {
        schemas: &schemas,
        rng: Rng::with_seed(2),
    };
    let (mut refused, mut harmless) = (0, 0);
    for _ in 0..6000 {
        let mut document = maker.value_of(&schemas.all["Scene"], 0);
        let mut places = Vec::new();
        places_of(&document, String::new(), &mut places);
        let place = places[maker.rng.usize(..places.len())].clone();
        let fault = [
            json!(null),
            json!(true),
            json!(-3),
            json!(0.5),
            json!(1e300),
            json!("x y"),
            json!([]),
            json!({}),
            json!({"colour": 1}),
        ][maker.rng.usize(..9)]
        .clone();
        *document.pointer_mut(&place).expect("it is there") = fault;
        let by_schema = validator.is_valid(&document);
        match (by_schema, Scene::from_json(&document)) {
            (true, Ok(_)) => harmless += 1,
            (false, Err(_)) => refused += 1,
            (true, Err(error)) => assert!(
                is_rule_between_values(&error.pointer, &error.allowed),
                "{place} of {document} is of the schema, but {error}"
            ),
            (false, Ok(_)) => assert!(
                is_taken_beyond_the_schema(&document),
                "{place} of {document} is a scene, but {}",
                complaints(&validator, &document)
            ),
        }
    }
    println!("6000 documents with a fault: {refused} refused by both, {harmless} taken by both");
    assert!(refused > 2000, "{refused}");
}

/// Pointers of everything below a value.
fn places_of(value: &Value, at: String, places: &mut Vec<String>) {
    match value {
        Value::Object(members) => {
            for (key, below) in members {
                places_of(below, format!("{at}/{key}"), places);
            }
        }
        Value::Array(items) => {
            for (index, below) in items.iter().enumerate() {
                places_of(below, format!("{at}/{index}"), places);
            }
        }
        _ => {}
    }
    if !at.is_empty() {
        places.push(at);
    }
}

/// A scene in which every object of the schema stands, for numbers to be set in.
fn full_scenes() -> Vec<Value> {
    let base = json!({
        "version": 1,
        "planet": {"radius_m": 6.36e6},
        "sun": {"place_and_time": {"latitude_deg": 1.0}, "irradiance_w_per_m2_nm": [1.0, 1.0, 1.0]},
        "moon": {},
        "stars": {},
        "quality": {"preset": "high"},
        "atmosphere": {"model": "physical"},
        "layers": [{"name": "a", "density": {"model": "weather", "maps": {}}, "wind": {}, "phase": {"model": "draine"}}],
        "light": {"phase": {"model": "hg-draine"}},
        "tone": {"auto_exposure": {"min_ev": 0.0, "max_ev": 0.0}},
        "time": {"wind_rate": 1.0},
        "animation": [{"path": "/exposure_ev", "keyframes": [{"at_s": 0.0}]}],
        "transition": {"duration_s": 1.0, "from": {"version": 1}},
        "drift": {"since": 0, "layers_m": {"a": [0.0, 0.0, 0.0]}},
    });
    let with = |pointer: &str, value: Value| {
        let mut scene = base.clone();
        *scene.pointer_mut(pointer).expect("it is there") = value;
        scene
    };
    vec![
        base.clone(),
        with("/atmosphere", json!({"model": "analytic"})),
        with(
            "/atmosphere",
            json!({"model": "uniform", "radiance_w_per_m2_nm_sr": [0.0, 0.0, 0.0]}),
        ),
        with("/quality", json!({"max_error": 0.1})),
        with("/quality", json!({"budget_ms": 1.0})),
        with("/layers/0/density", json!({"model": "cirrus"})),
        with(
            "/layers/0/density",
            json!({"model": "homogeneous", "shape": {"form": "box", "center_m": [0.0, 0.0, 0.0], "size_m": [1.0, 1.0, 1.0]}}),
        ),
        with(
            "/layers/0/density",
            json!({"model": "homogeneous", "shape": {"form": "sphere", "center_m": [0.0, 0.0, 0.0]}}),
        ),
        with(
            "/layers/0/density",
            json!({"model": "grid", "file": "a.raw", "dimensions": [1, 1, 1], "bounds_min_m": [-2.0e7, -2.0e5, -2.0e7], "bounds_max_m": [2.0e7, 4.0e5, 2.0e7]}),
        ),
        with("/layers/0/phase", json!({"model": "hg"})),
        with("/layers/0/phase", json!({"model": "hg-draine"})),
    ]
}

/// Calls `each` for every number of the schema that can stand in the scene, with its pointer and its own schema.
fn numbers_of(
    schemas: &Schemas,
    schema: &Value,
    scene: &Value,
    at: String,
    each: &mut dyn FnMut(&str, &Value),
) {
    let schema = schemas.resolved(schema);
    for key in ["oneOf", "anyOf"] {
        for choice in schema
            .get(key)
            .and_then(Value::as_array)
            .into_iter()
            .flatten()
        {
            let choice = schemas.resolved(choice);
            let tags_fit = choice
                .get("properties")
                .and_then(Value::as_object)
                .into_iter()
                .flatten()
                .all(|(key, property)| {
                    property.get("const").is_none_or(|constant| {
                        scene
                            .pointer(&format!("{at}/{key}"))
                            .is_none_or(|tag| tag == constant)
                    })
                });
            let required = choice.get("required").and_then(Value::as_array);
            let is_meant = required
                .into_iter()
                .flatten()
                .filter_map(Value::as_str)
                .all(|key| scene.pointer(&format!("{at}/{key}")).is_some());
            if tags_fit && is_meant {
                numbers_of(schemas, choice, scene, at.clone(), each);
            }
        }
    }
    if scene.pointer(&at).is_some_and(Value::is_object) {
        for (key, property) in schema
            .get("properties")
            .and_then(Value::as_object)
            .into_iter()
            .flatten()
        {
            numbers_of(schemas, property, scene, format!("{at}/{key}"), each);
        }
    }
    let each_item = schema.get("prefixItems").and_then(Value::as_array);
    // The two corners of a grid bound each other, and stand at their ends already.
    if !at.contains("/bounds_") {
        for (index, item) in each_item.into_iter().flatten().enumerate() {
            if scene.pointer(&format!("{at}/{index}")).is_some() {
                numbers_of(schemas, item, scene, format!("{at}/{index}"), each);
            }
        }
    }
    let items = schema.get("items").filter(|items| items.is_object());
    if let (Some(items), Some(Value::Array(there))) = (items, scene.pointer(&at)) {
        for index in 0..there.len() {
            numbers_of(schemas, items, scene, format!("{at}/{index}"), each);
        }
    }
    let kind = &schema["type"];
    let is_number = ["number", "integer"].iter().any(|name| {
        kind == name
            || kind
                .as_array()
                .is_some_and(|all| all.contains(&json!(name)))
    });
    if is_number && schema.get("const").is_none() {
        each(&at, schema);
    }
}

#[test]
fn both_ends_of_every_range_are_taken_and_what_lies_beyond_is_refused() {
    let schemas = Schemas::new();
    let validator = schemas.validator("Scene");
    let mut tried = BTreeSet::new();
    for scene in full_scenes() {
        Scene::from_json(&scene).expect("a scene");
        assert!(
            validator.is_valid(&scene),
            "{}",
            complaints(&validator, &scene)
        );
        let mut each = |at: &str, schema: &Value| {
            if schema.get("minimum").is_none() {
                // The value of a keyframe, which is what the number that it animates may be.
                assert!(at.ends_with("/value"), "{at} has no range");
                return;
            }
            let (low, high) = ends(schema);
            let beyond = |end: f64, sign: f64| end + sign * (end.abs() * 1e-9).max(1e-9);
            let is_count = schema["type"] == "integer";
            let (under, over) = if is_count {
                (low - 1.0, high + 1.0)
            } else {
                (beyond(low, -1.0), beyond(high, 1.0))
            };
            for (number, is_allowed) in [(low, true), (high, true), (under, false), (over, false)] {
                let mut scene = scene.clone();
                put(&mut scene, at, json!(number));
                // The other end of a pair has to give way.
                match at.rsplit('/').next() {
                    Some("base_altitude_m") if is_allowed => {
                        put(&mut scene, &at.replace("base", "top"), json!(high));
                    }
                    Some("top_altitude_m") if is_allowed => {
                        put(&mut scene, &at.replace("top", "base"), json!(low));
                    }
                    Some("min_ev") if is_allowed => {
                        put(&mut scene, &at.replace("min", "max"), json!(high));
                    }
                    Some("max_ev") if is_allowed => {
                        put(&mut scene, &at.replace("max", "min"), json!(low));
                    }
                    _ => {}
                }
                assert_eq!(
                    validator.is_valid(&scene),
                    is_allowed,
                    "schema: {at} = {number}"
                );
                let read = Scene::from_json(&scene);
                match (&read, is_allowed) {
                    (Ok(_), true) => {}
                    (Err(error), false) => assert_eq!(error.pointer, at, "{error}"),
                    _ => panic!("reader: {at} = {number}: {read:?}"),
                }
            }
            tried.insert(at.to_owned());
        };
        numbers_of(
            &schemas,
            &schemas.all["Scene"],
            &scene,
            String::new(),
            &mut each,
        );
    }
    println!("{} numbers", tried.len());
    assert!(tried.len() > 80, "{} numbers: {tried:?}", tried.len());
}

/// Sets a value, which may not be there yet.
fn put(scene: &mut Value, at: &str, value: Value) {
    let (parent, key) = at.rsplit_once('/').expect("a pointer");
    match scene.pointer_mut(parent) {
        Some(Value::Object(members)) => {
            members.insert(key.to_owned(), value);
        }
        Some(Value::Array(items)) => {
            let index: usize = key.parse().expect("an index");
            items[index] = value;
        }
        other => panic!("{at}: {other:?}"),
    }
}

#[test]
fn every_key_of_the_scene_says_what_it_is_and_every_number_its_default() {
    let schemas = Schemas::new();
    for (name, schema) in &schemas.all {
        let properties = schema.get("properties").and_then(Value::as_object);
        for (key, property) in properties.into_iter().flatten() {
            let named = ["version", "model", "form"].contains(&key.as_str());
            if !name.ends_with("Patch") && !named && name != "Drift" {
                assert!(
                    property.get("description").is_some(),
                    "{name}/{key}: {property}"
                );
                let has_default = property.get("default").is_some();
                let must_be_there = schema["required"]
                    .as_array()
                    .is_some_and(|all| all.contains(&json!(key)));
                assert!(has_default != must_be_there, "{name}/{key}: {property}");
            }
        }
    }
    let unit = |pointer: &str| {
        schemas.all["Sun"]
            .pointer(&format!("/properties/{pointer}/x-unit"))
            .cloned()
    };
    assert_eq!(unit("azimuth_deg"), Some(json!("deg")));
}

#[test]
fn a_merge_patch_of_the_schema_may_leave_out_everything_and_takes_keys_away_with_null() {
    let schemas = Schemas::new();
    let validator = schemas.validator("ScenePatch");
    for patch in [
        json!({}),
        json!({"sun": {"elevation_deg": 20}}),
        json!({"sun": null, "layers": null}),
        json!({"planet": "flat"}),
        json!({"atmosphere": {"model": "physical", "aerosol_optical_depth": 0.2}}),
        json!({"light": {"phase": {"model": "hg", "droplet_diameter_um": null, "g": 0.5}}}),
        json!({"tone": {"auto_exposure": {"min_ev": null}}}),
        json!({"quality": {"preset": "high", "budget_ms": null}}),
        json!({"quality": "draft"}),
        json!({"drift": {"layers_m": {"low": null}}}),
        json!({"layers": [{"family": "cumulus"}]}),
    ] {
        assert!(
            validator.is_valid(&patch),
            "{patch}: {}",
            complaints(&validator, &patch)
        );
    }
    for patch in [
        json!({"sun": {"elevation_deg": 91}}),
        json!({"sun": {"elevation": 20}}),
        json!({"layers": [{"density": {"coverage": 2}}]}),
        json!({"quality": "best"}),
        json!([]),
        json!(null),
    ] {
        assert!(!validator.is_valid(&patch), "{patch}");
    }
}
