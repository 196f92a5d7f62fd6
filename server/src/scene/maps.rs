//! Maps of the scene's layers: replaced by files, brought back, read.

use std::collections::BTreeSet;
use std::sync::PoisonError;

use serde_json::{Value, json};
use skycell_protocol::scene::{DensityModel, MapKind, WeatherDensity};
use skycell_protocol::{Scene, SceneError};

use super::history::all_named_files;
use super::journal::Journal;
use super::map_folder::{KeepError, MAPS_TOTAL_MAX_BYTES};
use super::revision::{Cause, ChangeKind};
use super::{Precondition, ScenePatchError, SceneSnapshot, SceneStore, file};
use crate::field::{GreyMap, MapFileError, MapFileFormat, map_pointer, read_map_file};

/// Which map of which layer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapChoice {
    /// Which map.
    pub kind: MapKind,
    /// Name of the layer; not needed where only one has maps.
    pub layer: Option<String>,
}

/// The weather layer of a name, or the only one.
fn chosen_layer<'a>(
    scene: &'a Scene,
    name: Option<&str>,
) -> Result<(usize, &'a WeatherDensity), SceneError> {
    let weather: Vec<(usize, &str, &WeatherDensity)> = scene
        .layers()
        .iter()
        .enumerate()
        .filter_map(|(index, layer)| match layer.density() {
            DensityModel::Weather(weather) => Some((index, layer.name(), weather)),
            _ => None,
        })
        .collect();
    let allowed = || {
        let names: Vec<&str> = weather.iter().map(|(_, name, _)| *name).collect();
        if names.is_empty() {
            "no name: no layer of the scene has density model \"weather\"".to_owned()
        } else {
            format!("one of the layers with maps: {}", names.join(", "))
        }
    };
    match (name, weather.as_slice()) {
        (None, [(index, _, weather)]) => Ok((*index, weather)),
        (None, _) => Err(SceneError::missing("/layer", allowed())),
        (Some(name), _) => weather
            .iter()
            .find(|(_, other, _)| *other == name)
            .map(|(index, _, weather)| (*index, *weather))
            .ok_or_else(|| SceneError::new("/layer", &Value::from(name), allowed())),
    }
}

/// All files that a scene names.
pub(super) fn named_files(scene: &Scene) -> BTreeSet<String> {
    let mut named = BTreeSet::new();
    for layer in scene.layers() {
        if let DensityModel::Weather(weather) = layer.density() {
            let files = MapKind::ALL.iter().filter_map(|k| weather.maps().file(*k));
            named.extend(files.map(str::to_owned));
        }
    }
    named
}

impl SceneStore {
    /// Replaces a layer's map by a file and keeps both. Blocks while the file is read and the disk works. `transition_s`
    /// is the sky time that this change takes, and later ones until another is told.
    ///
    /// # Errors
    /// If the precondition does not hold, there is no such layer, the file is no map, or something cannot be kept. The
    /// scene and its maps are then as before.
    pub fn put_map(
        &self,
        precondition: &Precondition,
        choice: &MapChoice,
        transition_s: Option<f64>,
        bytes: &[u8],
    ) -> Result<SceneSnapshot, ScenePatchError> {
        // What can be known without reading the file is told first.
        let before = self.snapshot();
        precondition.check(&before)?;
        let (index, _) = chosen_layer(&before.scene, choice.layer.as_deref())?;
        let bad = |error| ScenePatchError::BadMap {
            pointer: map_pointer(index, choice.kind),
            error,
        };
        // Reads it all, outside the lock; kept for the renderer.
        self.field.map_of_bytes(bytes, choice.kind).map_err(bad)?;
        let format = MapFileFormat::of(bytes).ok_or_else(|| {
            bad(MapFileError::NoImage {
                start: String::new(),
            })
        })?;
        let mut journal = self.change.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.snapshot();
        precondition.check(&before)?;
        let name = self.keep_map(&mut journal, bytes, format)?;
        self.set_map(&mut journal, &before, choice, Some(name), transition_s)
    }

    /// Keeps a file. Where there is no room, the oldest revisions are forgotten together with their maps, until there is
    /// or only the present one is left. With the lock held.
    fn keep_map(
        &self,
        journal: &mut Journal,
        bytes: &[u8],
        format: MapFileFormat,
    ) -> Result<String, ScenePatchError> {
        let mut revisions = self.history();
        loop {
            match self.maps.keep(bytes, format, &all_named_files(&revisions)) {
                Ok(name) => {
                    if revisions.len() < self.history().len() {
                        journal.rewrite(&revisions)?;
                        let mut named = all_named_files(&revisions);
                        named.insert(name.clone());
                        self.maps.collect(&named);
                        self.set_history(revisions);
                    }
                    return Ok(name);
                }
                Err(KeepError::Io(error)) => return Err(ScenePatchError::NotKept(error)),
                Err(KeepError::Full { .. }) if revisions.len() > 1 => {
                    revisions.pop_front();
                }
                Err(error @ KeepError::Full { .. }) => {
                    return Err(ScenePatchError::MapsFull {
                        error: error.to_string(),
                        allowed: format!("at most {MAPS_TOTAL_MAX_BYTES} bytes"),
                    });
                }
            }
        }
    }

    /// Brings the map that is made from the seed back.
    ///
    /// # Errors
    /// If the precondition does not hold, there is no such layer, or the scene cannot be kept.
    pub fn reset_map(
        &self,
        precondition: &Precondition,
        choice: &MapChoice,
        transition_s: Option<f64>,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let mut journal = self.change.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.snapshot();
        precondition.check(&before)?;
        self.set_map(&mut journal, &before, choice, None, transition_s)
    }

    /// With the lock held.
    fn set_map(
        &self,
        journal: &mut Journal,
        before: &SceneSnapshot,
        choice: &MapChoice,
        name: Option<String>,
        transition_s: Option<f64>,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let (index, _) = chosen_layer(&before.scene, choice.layer.as_deref())?;
        let layer = before.scene.layers()[index].name();
        let cause = Cause {
            about: Some(format!("{} of {layer}", choice.kind.name())),
            ..Cause::of_kind(ChangeKind::Maps)
        };
        let mut document = file::document_of(&before.scene)?;
        let maps = &mut document["layers"][index]["density"]["maps"];
        maps[choice.kind.name()] = json!(name);
        if let Some(transition_s) = transition_s {
            maps["transition_s"] = json!(transition_s);
        }
        self.take_over(journal, before, &document, &cause)
    }

    /// A layer's map as it was put, or as it is made from the seed, and the scene that it belongs to. Blocks while the
    /// file is read.
    ///
    /// # Errors
    /// If there is no such layer, or the file cannot be read any more.
    pub fn map(&self, choice: &MapChoice) -> Result<(SceneSnapshot, GreyMap), ScenePatchError> {
        let snapshot = self.snapshot();
        let (index, weather) = chosen_layer(&snapshot.scene, choice.layer.as_deref())?;
        let map = match weather.maps().file(choice.kind) {
            Some(name) => read_map_file(self.maps.path(), name)
                .and_then(|bytes| GreyMap::decode(&bytes))
                .map_err(|error| ScenePatchError::BadMap {
                    pointer: map_pointer(index, choice.kind),
                    error,
                })?,
            None => self.field.generated_maps(weather).picture(choice.kind),
        };
        Ok((snapshot, map))
    }
}
