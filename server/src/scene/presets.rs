//! Skies by name: scene files that come with the binary, each with a camera that shows it well.

use std::sync::LazyLock;

use include_dir::{Dir, include_dir};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use skycell_protocol::read_json::{ObjectReader, ReadJson};
use skycell_protocol::{Camera, CameraDocument, Scene, SceneError};

static FILES: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/presets");

static PRESETS: LazyLock<Vec<Preset>> = LazyLock::new(|| {
    let mut presets: Vec<Preset> = FILES
        .files()
        .filter_map(|file| {
            let name = file.path().file_stem()?.to_str()?;
            // The files are part of the binary; `every_preset_is_a_scene` reads them all.
            read_preset(name, file.contents())
                .inspect_err(|error| tracing::error!(name, error, "a preset is no scene"))
                .ok()
        })
        .collect();
    presets.sort_by(|a, b| a.name.cmp(&b.name));
    presets
});

/// A sky by name.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Preset {
    /// What the sky does, in a word or three.
    pub name: String,
    /// The same for people.
    pub title: String,
    /// What is seen, in a sentence.
    pub about: String,
    /// A camera that shows it well.
    pub camera: Camera,
    /// The sky.
    #[serde(skip)]
    pub scene: Scene,
}

/// Every preset, by name.
pub fn presets() -> &'static [Preset] {
    &PRESETS
}

/// The preset of a name.
pub fn preset(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|preset| preset.name == name)
}

fn read_preset(name: &str, bytes: &[u8]) -> Result<Preset, String> {
    let value: Value = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    read_value(name, &value).map_err(|error| error.to_string())
}

fn read_value(name: &str, value: &Value) -> Result<Preset, SceneError> {
    let members = ObjectReader::new(value, "")?;
    members.only(&["title", "about", "camera", "scene"])?;
    let scene: Value = members.required("scene", "a scene")?;
    let camera: CameraDocument = members.required("camera", "a camera")?;
    Ok(Preset {
        name: name.to_owned(),
        title: members.required("title", "a string")?,
        about: members.required("about", "a string")?,
        camera: Camera::try_from(camera).map_err(|error| error.under("/camera"))?,
        scene: Scene::from_json(&scene).map_err(|error| error.under("/scene"))?,
    })
}

impl ReadJson for &'static Preset {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, SceneError> {
        value.as_str().and_then(preset).ok_or_else(|| {
            let names: Vec<&str> = presets()
                .iter()
                .map(|preset| preset.name.as_str())
                .collect();
            SceneError::new(pointer, value, format!("one of {}", names.join(", ")))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_is_a_scene() {
        for file in FILES.files() {
            let name = file.path().display().to_string();
            if let Err(error) = read_preset(&name, file.contents()) {
                panic!("{name}: {error}");
            }
        }
        assert_eq!(presets().len(), FILES.files().count());
        assert!(presets().len() >= 10);
    }

    #[test]
    fn presets_have_no_clock_of_their_own() {
        for preset in presets() {
            assert_eq!(
                preset.scene.clock(),
                Scene::default().clock(),
                "{}",
                preset.name
            );
            assert!(preset.scene.transition().is_none(), "{}", preset.name);
        }
    }
}
