//! How far one moment's scene is from another's, in steps that are just not seen, and how wrong texels are that show the other.

use crate::cache::{AgeingRates, SkyWay};
use glam::DVec3;
use serde_json::Value;
use skycell_protocol::Scene;
use skycell_protocol::scene::{DensityDocument, LayerDocument, MapsDocument};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

/// The sun's way that is a step: half its diameter. What it lights looks the same.
const SUN_STEP_RAD: f64 = 0.25 * PI / 180.0;
/// Steps in the whole range of coverage or type.
const COVER_STEPS: f64 = 256.0;
/// Steps in a doubling or so of any other number.
const RELATIVE_STEPS: f64 = 64.0;
/// Numbers below are as good as nothing: extinction per metre, optical depth, irradiance.
const NOTHING: f64 = 1e-3;
/// How wrong what is a step behind is.
const RATES: AgeingRates = AgeingRates::RECKONED;
/// As many steps as make texels start anew.
const JUMP: f64 = 1e6;

/// How far a scene has moved.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Steps {
    /// What the texels of all layers hold.
    pub(super) light: SkyWay,
    /// What those of one hold, by its name; layers that are in both scenes.
    pub(super) layers: BTreeMap<String, SkyWay>,
    /// What is put on where texels are shown: colour of the light, air, exposure; in steps.
    pub(super) look: f64,
    /// The list of layers is another one.
    pub(super) layers_change: bool,
    /// Layers that read other maps now.
    maps: BTreeSet<String>,
}

impl Steps {
    /// The way of what the texels of a layer hold; new ones hold nothing yet.
    pub(super) fn of_layer(&self, name: &str) -> SkyWay {
        let maps = if self.maps.contains(name) { JUMP } else { 0.0 };
        let maps = SkyWay {
            steps: maps,
            percent: maps,
        };
        self.light + self.layers.get(name).copied().unwrap_or_default() + maps
    }

    /// Steps of what the texels hold that move farthest, but for maps, which may come slowly.
    pub(super) fn march(&self) -> f64 {
        let layers = self.layers.values().map(|way| way.steps);
        self.light.steps + layers.fold(0.0, f64::max)
    }

    pub(super) fn largest(&self) -> f64 {
        if self.layers_change {
            JUMP
        } else {
            let maps = if self.maps.is_empty() { 0.0 } else { JUMP };
            self.march().max(self.look).max(maps)
        }
    }
}

/// How far `new` is from `old`, both scenes of moments.
pub(super) fn steps_between(old: &Scene, new: &Scene) -> Steps {
    let (before, after) = (old.to_document(), new.to_document());
    let mut steps = Steps::default();
    let names = |scene: &Scene| -> Vec<String> {
        scene.layers().iter().map(|l| l.name().to_owned()).collect()
    };
    steps.layers_change = names(old) != names(new);
    for b in &after.layers {
        if let Some(a) = before.layers.iter().find(|a| a.name == b.name) {
            let mut of_layer = SkyWay::default();
            add("", &value(a), &value(b), &mut of_layer);
            steps.layers.insert(b.name.clone(), of_layer);
            if maps_of(a) != maps_of(b) {
                steps.maps.insert(b.name.clone());
            }
        }
    }
    add(
        "",
        &value(&before.light),
        &value(&after.light),
        &mut steps.light,
    );
    let sun = angle_rad(old.sun().direction(), new.sun().direction()) / SUN_STEP_RAD;
    steps.light += SkyWay {
        steps: sun,
        percent: sun * RATES.percent_per_step_of_sun,
    };
    let colour = |scene: &Scene| Value::from(scene.sun().irradiance_w_per_m2_nm().to_vec());
    let mut look = SkyWay::default();
    add("", &colour(old), &colour(new), &mut look);
    add(
        "",
        &value(&before.atmosphere),
        &value(&after.atmosphere),
        &mut look,
    );
    add("", &value(&before.planet), &value(&after.planet), &mut look);
    steps.look = look.steps + (old.exposure_ev() - new.exposure_ev()).abs() * RELATIVE_STEPS;
    steps
}

/// What a layer's maps come from.
fn maps_of(layer: &LayerDocument) -> Option<(u32, Option<&MapsDocument>)> {
    match &layer.density {
        DensityDocument::Weather(weather) => Some((weather.seed, Some(&weather.maps))),
        DensityDocument::Cirrus(sheet) => Some((sheet.seed, None)),
        _ => None,
    }
}

/// The angle between unit vectors; exact for small ones.
fn angle_rad(a: DVec3, b: DVec3) -> f64 {
    2.0 * (0.5 * a.distance(b)).clamp(0.0, 1.0).asin()
}

fn add(key: &str, a: &Value, b: &Value, way: &mut SkyWay) {
    match (a, b) {
        // Where clouds are is no part of what they look like, and maps are told apart.
        _ if ["wind", "evolution_m_per_s", "maps", "seed"].contains(&key) => {}
        (Value::Object(a), Value::Object(b)) if a.len() == b.len() => {
            for (key, a) in a {
                add(key, a, b.get(key).unwrap_or(&Value::Null), way);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (a, b) in a.iter().zip(b) {
                add(key, a, b, way);
            }
        }
        _ if a == b => {}
        _ => {
            let steps = match (a.as_f64(), b.as_f64()) {
                (Some(a), Some(b)) => match key {
                    "coverage" | "type" => (a - b).abs() * COVER_STEPS,
                    _ => (a - b).abs() / a.abs().max(b.abs()).max(NOTHING) * RELATIVE_STEPS,
                },
                _ => JUMP,
            };
            let rate = match key {
                "coverage" => RATES.percent_per_step_of_coverage,
                "type" => RATES.percent_per_step_of_type,
                _ => RATES.percent_per_step,
            };
            *way += SkyWay {
                steps,
                percent: steps * rate,
            };
        }
    }
}

/// Anything that is written as JSON.
fn value(of: impl serde::Serialize) -> Value {
    // Documents are plain data with string keys, which always can be written.
    serde_json::to_value(of).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn scene(mut members: Value) -> Scene {
        members["version"] = json!(1);
        Scene::from_json(&members).expect("a scene")
    }

    #[test]
    fn steps_count_what_texels_hold_apart_from_what_is_put_on() {
        let base = Scene::default();
        assert_eq!(steps_between(&base, &base).largest(), 0.0);
        let sun = steps_between(&base, &scene(json!({"sun": {"elevation_deg": 40.5}})));
        assert!((sun.light.steps - 2.0).abs() < 1e-6, "{sun:?}");
        assert!((sun.light.percent - 0.2).abs() < 1e-6, "{sun:?}");
        let exposure = steps_between(&base, &scene(json!({"exposure_ev": 0.5})));
        assert_eq!((exposure.march(), exposure.look), (0.0, 32.0));
        let cover = scene(json!({"layers": [{"density": {"coverage": 0.45 + 1.0 / 256.0}}]}));
        let way = steps_between(&base, &cover).of_layer("low");
        assert!(
            (way.steps - 1.0).abs() < 1e-6 && (way.percent - 2.0).abs() < 1e-6,
            "{way:?}"
        );
        let wind = steps_between(&base, &scene(json!({"wind": {"speed_m_per_s": 50}})));
        assert_eq!(wind.largest(), 0.0);
    }

    #[test]
    fn a_layer_that_changes_leaves_the_others_texels_alone() {
        let two = |seed: u32| {
            scene(json!({"layers": [{"name": "low"}, {"name": "high", "density": {"seed": seed}}]}))
        };
        let steps = steps_between(&two(1), &two(2));
        assert!(!steps.layers_change);
        assert_eq!(steps.of_layer("low"), SkyWay::default());
        assert!(steps.of_layer("high").steps >= 64.0);
    }

    #[test]
    fn another_list_of_layers_is_seen() {
        for layers in [
            json!([]),
            json!([{"name": "other"}]),
            json!([{}, {"name": "b"}]),
        ] {
            let other = scene(json!({"layers": layers}));
            assert!(steps_between(&Scene::default(), &other).layers_change);
        }
    }

    #[test]
    fn a_layer_that_fades_away_takes_few_steps_at_its_end() {
        let faded = |extinction: f64| scene(json!({"layers": [{"extinction_per_m": extinction}]}));
        assert!(steps_between(&faded(1e-9), &faded(1e-6)).march() < 0.1);
    }
}
