//! A still sky for the time of a test.

use serde_json::{Map, Value, json};

use crate::{HttpApi, HttpApiError};

/// The wind of a scene that was taken out, to be put back.
#[derive(Clone, Debug, PartialEq)]
pub struct StilledWind {
    restore: Option<Value>,
}

impl StilledWind {
    /// Takes the wind out of the server's scene.
    ///
    /// # Errors
    /// If the server is not there or refuses.
    pub async fn still(api: &HttpApi) -> Result<Self, HttpApiError> {
        let scene = api.scene().await?;
        let Some((still, restore)) = patches(&scene.document) else {
            return Ok(Self { restore: None });
        };
        // With the revision that was read: what is restored must be what was there.
        api.patch_scene(&still, &scene.etag).await?;
        Ok(Self {
            restore: Some(restore),
        })
    }

    /// Puts the wind back, whatever else has changed in the scene meanwhile.
    ///
    /// # Errors
    /// If the server is not there or refuses.
    pub async fn restore(self, api: &HttpApi) -> Result<(), HttpApiError> {
        if let Some(patch) = self.restore {
            api.patch_current_scene(&patch).await?;
        }
        Ok(())
    }
}

/// The merge patch that stills the wind and the one that undoes it; none if there is no wind.
fn patches(scene: &Value) -> Option<(Value, Value)> {
    let mut still = Map::new();
    let mut restore = Map::new();
    let speed = &scene["wind"]["speed_m_per_s"];
    // A missing wind is the default one, which blows.
    if speed.as_f64() != Some(0.0) {
        still.insert("wind".to_owned(), json!({"speed_m_per_s": 0}));
        restore.insert("wind".to_owned(), json!({"speed_m_per_s": speed}));
    }
    // A merge patch replaces a list as a whole.
    if let Some(layers) = scene["layers"].as_array() {
        let mut stilled = layers.clone();
        for layer in &mut stilled {
            if layer["wind"].is_object() {
                layer["wind"]["speed_m_per_s"] = json!(0);
            }
        }
        if stilled != *layers {
            still.insert("layers".to_owned(), Value::Array(stilled));
            restore.insert("layers".to_owned(), Value::Array(layers.clone()));
        }
    }
    (!still.is_empty()).then_some((Value::Object(still), Value::Object(restore)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scenes_wind_is_stilled_and_put_back() {
        let scene = json!({"wind": {"towards_deg": 90, "speed_m_per_s": 5}, "layers": [{"name": "low", "wind": null}]});
        assert_eq!(
            patches(&scene),
            Some((
                json!({"wind": {"speed_m_per_s": 0}}),
                json!({"wind": {"speed_m_per_s": 5}})
            ))
        );
    }

    #[test]
    fn a_layer_with_its_own_wind_is_stilled_too_and_the_others_stay() {
        let scene = json!({"wind": {"speed_m_per_s": 0}, "layers": [
            {"name": "low", "wind": {"towards_deg": 10, "speed_m_per_s": 3}}, {"name": "high", "wind": null}]});
        let (still, restore) = patches(&scene).expect("wind");
        assert_eq!(
            still["layers"][0]["wind"],
            json!({"towards_deg": 10, "speed_m_per_s": 0})
        );
        assert_eq!(still["layers"][1], scene["layers"][1]);
        assert_eq!(restore, json!({"layers": scene["layers"]}));
    }

    #[test]
    fn a_still_scene_is_left_alone() {
        assert_eq!(
            patches(&json!({"wind": {"speed_m_per_s": 0.0}, "layers": []})),
            None
        );
    }
}
