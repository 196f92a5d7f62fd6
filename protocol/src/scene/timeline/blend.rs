//! Two scene documents mixed: numbers go from one to the other, what has no way between changes where it is not seen.

use serde_json::{Map, Value};

/// A layer fades to this share of its extinction and no further: one that is about to appear keeps its place among the
/// layers, and nobody sees it.
const FADED_MIN: f64 = 1e-9;

/// What a scene may lack, and the number of it that makes it as good as absent: the moon rises and sets, stars fade.
const LIGHTS_OF_THE_NIGHT: [(&str, &str, f64); 2] = [
    ("moon", "elevation_deg", -20.0),
    ("stars", "brightness", 0.0),
];

/// Keys whose numbers are places or lengths in the sky's pattern: between two values clouds would race past.
const PATTERN_SUFFIXES: [&str; 8] = [
    "towards_deg",
    "_period_m",
    "_span_m",
    "altitude_m",
    "center_m",
    "size_m",
    "bounds_min_m",
    "bounds_max_m",
];

/// A document with `share` (0 to 1) of `to`. Both are still and have every key.
pub(super) fn blend(from: &Value, to: &Value, share: f64) -> Value {
    if share >= 1.0 {
        return to.clone();
    }
    let mut mixed = mix("", from, to, share);
    for (key, number, gone) in LIGHTS_OF_THE_NIGHT {
        let without = |present: &Value| {
            let mut absent = present.clone();
            absent[number] = Value::from(gone);
            absent
        };
        let sides = (from.get(key), to.get(key));
        if let (Some(Value::Null), Some(there @ Value::Object(_))) = sides {
            mixed[key] = mix(key, &without(there), there, share);
        } else if let (Some(there @ Value::Object(_)), Some(Value::Null)) = sides {
            mixed[key] = mix(key, there, &without(there), share);
        }
    }
    if from.pointer("/planet/radius_m") != to.pointer("/planet/radius_m") {
        // Everything stands on the planet: it changes at once.
        mixed["planet"] = to["planet"].clone();
    }
    if let (Some(from), Some(to)) = (layers(from), layers(to)) {
        mixed["layers"] = Value::from(blend_layers(from, to, share));
    }
    mixed
}

fn layers(document: &Value) -> Option<&Vec<Value>> {
    document.get("layers")?.as_array()
}

fn mix(key: &str, from: &Value, to: &Value, share: f64) -> Value {
    match (from, to) {
        (Value::Object(from), Value::Object(to)) if same_model(from, to) => Value::Object(
            to.iter()
                .map(|(key, to)| {
                    let mixed = from.get(key).map(|from| mix(key, from, to, share));
                    (key.clone(), mixed.unwrap_or_else(|| to.clone()))
                })
                .collect(),
        ),
        (Value::Array(from), Value::Array(to)) if from.len() == to.len() => from
            .iter()
            .zip(to)
            .map(|(from, to)| mix(key, from, to, share))
            .collect(),
        _ => match (fraction(from), fraction(to)) {
            (Some(from), Some(to)) => Value::from(mix_numbers(key, from, to, share)),
            _ => to.clone(),
        },
    }
}

/// A number that is no count: counts have no values between.
fn fraction(value: &Value) -> Option<f64> {
    value.as_f64().filter(|_| value.is_f64())
}

fn mix_numbers(key: &str, from: f64, to: f64, share: f64) -> f64 {
    if from == to {
        return to;
    }
    if key.ends_with("azimuth_deg") || key == "towards_deg" {
        // The short way round.
        let way = (to - from + 180.0).rem_euclid(360.0) - 180.0;
        return (from + way * share).rem_euclid(360.0);
    }
    from + (to - from) * share
}

/// Whether two objects are of the same kind: `model` or `form` and so on agree.
fn same_model(a: &Map<String, Value>, b: &Map<String, Value>) -> bool {
    ["model", "form"]
        .iter()
        .all(|key| a.get(*key) == b.get(*key))
}

/// Layers of the same name and pattern change into each other. Of the rest, those of `from` fade in the first half, those
/// of `to` come in the second, so that there are never more than one of the two has.
fn blend_layers(from: &[Value], to: &[Value], share: f64) -> Vec<Value> {
    let partner = |layer: &Value, others: &[Value]| {
        let found = others.iter().find(|other| same_pattern("", layer, other));
        found.cloned()
    };
    if share < 0.5 {
        from.iter()
            .map(|layer| match partner(layer, to) {
                Some(other) => mix("", layer, &other, share),
                None => faded(layer, 1.0 - 2.0 * share),
            })
            .collect()
    } else {
        to.iter()
            .map(|layer| match partner(layer, from) {
                Some(other) => mix("", &other, layer, share),
                None => faded(layer, 2.0 * share - 1.0),
            })
            .collect()
    }
}

/// Whether all but numbers that may change in sight agree. The wind may change, too.
fn same_pattern(key: &str, a: &Value, b: &Value) -> bool {
    match (a, b) {
        _ if key == "wind" => true,
        (Value::Object(a), Value::Object(b)) => {
            a.len() == b.len()
                && a.iter()
                    .all(|(key, a)| b.get(key).is_some_and(|b| same_pattern(key, a, b)))
        }
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same_pattern(key, a, b))
        }
        _ if PATTERN_SUFFIXES.iter().any(|suffix| key.ends_with(suffix)) => a == b,
        _ => (a.is_f64() && b.is_f64()) || a == b,
    }
}

/// A layer of which a share is left: its clouds are fewer and thinner.
fn faded(layer: &Value, share: f64) -> Value {
    let mut layer = layer.clone();
    let scale = |value: Option<&mut Value>, by: f64| {
        if let Some(value) = value
            && let Some(number) = value.as_f64()
        {
            *value = Value::from(number * by.max(FADED_MIN));
        }
    };
    // Clouds of a high optical depth stay opaque until little of it is left, so it has to fall faster than evenly.
    scale(layer.get_mut("extinction_per_m"), share * share);
    scale(layer.pointer_mut("/density/optical_depth"), share * share);
    scale(layer.pointer_mut("/density/coverage"), share);
    layer
}
