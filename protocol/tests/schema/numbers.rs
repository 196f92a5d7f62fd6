//! Every number of the schema, in scenes in which it can stand.

use serde_json::{Value, json};

use super::maker::Schemas;

/// A scene in which every object of the schema stands, for numbers to be set in.
pub(crate) fn full_scenes() -> Vec<Value> {
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
pub(crate) fn numbers_of(
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

/// Sets a value, which may not be there yet.
pub(crate) fn put(scene: &mut Value, at: &str, value: Value) {
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
