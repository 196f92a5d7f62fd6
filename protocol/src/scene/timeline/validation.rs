//! Which numbers may be animated, and whether every keyframe's value may stand where it would.

use serde_json::Value;

use super::animation::Animation;
use super::transition::still_value;
use crate::ValueError;
use crate::scene::document::SceneDocument;
use crate::scene::{Scene, SceneError, ranges};

/// Numbers that are not animated, by the last part of their path, and why.
const REFUSED: [(&[&str], &str); 3] = [
    (
        &["towards_deg", "speed_m_per_s", "evolution_m_per_s"],
        "no wind: a transition or a patch changes it, and clouds go on from where they are",
    ),
    (
        &[
            "base_altitude_m",
            "top_altitude_m",
            "map_span_m",
            "shape_period_m",
            "detail_period_m",
            "fibre_period_m",
            "fibres_towards_deg",
            "radius_m",
        ],
        "no place or length of the sky's pattern: clouds would race past",
    ),
    (
        &["latitude_deg", "longitude_deg", "max_error", "budget_ms"],
        "nothing that is not of the sky",
    ),
];

/// Reads the animations of a document.
pub(super) fn animations_from(document: &SceneDocument) -> Result<Vec<Animation>, SceneError> {
    let count = document.animation.len();
    if count > ranges::ANIMATIONS_MAX {
        return Err(ValueError::new(
            "/animation",
            &Value::from(format!("{count} animations")),
            format!("0 to {} animations", ranges::ANIMATIONS_MAX),
        ));
    }
    if count == 0 {
        return Ok(Vec::new());
    }
    let value = still_value(document);
    let mut animations: Vec<Animation> = Vec::with_capacity(count);
    for (index, document) in document.animation.iter().enumerate() {
        let pointer = format!("/animation/{index}");
        let animation = Animation::try_from(document.clone()).map_err(|e| e.under(&pointer))?;
        let path_error = |allowed: String| {
            let path = Value::from(animation.path());
            ValueError::new(format!("{pointer}/path"), &path, allowed)
        };
        if animations
            .iter()
            .any(|other| other.path() == animation.path())
        {
            return Err(path_error(
                "a number that no other animation changes".into(),
            ));
        }
        check_path(&value, &animation).map_err(path_error)?;
        check_values(&value, &animation).map_err(|e| e.under(&pointer))?;
        animations.push(animation);
    }
    Ok(animations)
}

fn check_path(document: &Value, animation: &Animation) -> Result<(), String> {
    let path = animation.path();
    let last = path.rsplit('/').next().unwrap_or_default();
    let Some(number) = document.pointer(path) else {
        return Err("a JSON pointer of a number of the scene, such as /sun/elevation_deg".into());
    };
    if number.is_u64() {
        return Err("a number that is no count: counts have no values between".into());
    }
    if !number.is_f64() {
        return Err(format!("a number; {path} is {}", kind_of(number)));
    }
    if let Some((_, reason)) = REFUSED.iter().find(|(keys, _)| keys.contains(&last)) {
        return Err((*reason).into());
    }
    let by_place = document
        .pointer("/sun/place_and_time")
        .is_some_and(Value::is_object);
    if by_place && ["/sun/azimuth_deg", "/sun/elevation_deg"].contains(&path) {
        return Err("no angle of a sun that stands by place_and_time".into());
    }
    Ok(())
}

fn kind_of(value: &Value) -> &'static str {
    match value {
        Value::Object(_) => "an object",
        Value::Array(_) => "an array",
        Value::String(_) => "a string",
        Value::Null => "null",
        _ => "none",
    }
}

/// Puts every keyframe's value into the document: what the document's own rules refuse, they refuse.
fn check_values(document: &Value, animation: &Animation) -> Result<(), ValueError> {
    let mut document = document.clone();
    let mut seen: Vec<f64> = Vec::new();
    for (index, value) in animation.values().enumerate() {
        if seen.contains(&value) {
            continue;
        }
        seen.push(value);
        if let Some(number) = document.pointer_mut(animation.path()) {
            *number = Value::from(value);
        }
        // Should the document be wrong elsewhere, that is told where it is read as a whole.
        if let Err(error) = Scene::from_json(&document)
            && error.pointer == animation.path()
        {
            return Err(ValueError {
                pointer: format!("/keyframes/{index}/value"),
                ..error
            });
        }
    }
    Ok(())
}
