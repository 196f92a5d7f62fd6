//! The scene's schema against the scene's reader: what one takes, the other takes.

mod maker;
mod numbers;

use std::collections::BTreeSet;

use fastrand::Rng;
use maker::{Maker, Schemas, complaints, ends};
use numbers::{full_scenes, numbers_of, put};
use serde_json::{Value, json};
use skycell_protocol::scene::{Family, Scene, SceneDocument};

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
    let by_words = RULES_BETWEEN_VALUES
        .iter()
        .any(|words| allowed.contains(words));
    by_words || pointer.contains("/animation/") && pointer.ends_with("/value")
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
