//! The scene that the service shows: its revision, its changes, and its copy on disk.
//!
//! Invariant: a revision that anybody has seen is on disk. A change is written and synced before
//! it is announced.

mod file;
mod map_folder;
mod maps;
#[cfg(test)]
mod tests;

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use serde_json::Value;
use skycell_protocol::{Scene, SceneError};
use thiserror::Error;
use tokio::sync::watch;

use crate::field::{FieldStore, MapFileError, check_grids, check_maps};
use file::SceneFile;
pub use file::SceneFileError;
use map_folder::MapFolder;
pub use maps::MapChoice;

/// A scene and the number of its revision.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneSnapshot {
    /// The scene.
    pub scene: Arc<Scene>,
    /// Counts changes, from 1 upwards, across restarts.
    pub revision: u64,
}

/// Which revision a change is meant for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Precondition {
    /// Whatever there is (`If-Match: *`).
    Any,
    /// One of these.
    OneOf(Vec<u64>),
}

impl Precondition {
    fn check(&self, snapshot: &SceneSnapshot) -> Result<(), ScenePatchError> {
        match self {
            Self::OneOf(revisions) if !revisions.contains(&snapshot.revision) => {
                Err(ScenePatchError::Stale {
                    current: snapshot.revision,
                })
            }
            _ => Ok(()),
        }
    }
}

/// Why a change was not made.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ScenePatchError {
    /// The scene has another revision than the change was meant for.
    #[error("the scene has revision {current}")]
    Stale {
        /// The revision that it has.
        current: u64,
    },
    /// A file is no map.
    #[error("{pointer} is {error}; allowed: {}", .error.allowed())]
    BadMap {
        /// Where it would stand in the document.
        pointer: String,
        /// What is wrong with it.
        error: MapFileError,
    },
    /// There is no room for another map.
    #[error("{error}; allowed: {allowed}")]
    MapsFull {
        /// How many bytes there would be.
        error: String,
        /// How many there may be.
        allowed: String,
    },
    /// What the change would make is no scene.
    #[error("{0}")]
    Invalid(#[from] SceneError),
    /// The new scene cannot be kept.
    #[error("{0}")]
    NotKept(#[from] SceneFileError),
}

/// Owner of the scene.
pub struct SceneStore {
    file: SceneFile,
    /// Where the files of voxels lie that a scene may name.
    grids_dir: PathBuf,
    /// The files of maps that a scene may name.
    maps: MapFolder,
    /// Where maps are kept as the device reads them.
    field: FieldStore,
    /// Held while a change is made, so that changes follow each other.
    change: Mutex<()>,
    current: watch::Sender<SceneSnapshot>,
}

impl SceneStore {
    /// Opens the store in a folder, which is made if there is none. Without a file there, the
    /// scene is the default one, revision 1, and is written.
    ///
    /// # Errors
    /// If the file is there and holds no scene (it is then left as it is), or cannot be read or
    /// written.
    pub fn open(state_dir: PathBuf) -> Result<Self, SceneFileError> {
        let field = FieldStore::new(Some(state_dir.join("cache")));
        Self::open_with(state_dir, field)
    }

    /// As [`Self::open`], with another place for what is made from maps.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with(state_dir: PathBuf, field: FieldStore) -> Result<Self, SceneFileError> {
        let grids_dir = state_dir.join("grids");
        let maps = MapFolder::new(state_dir.join("maps"));
        let file = SceneFile::in_folder(state_dir)?;
        let snapshot = match file.read()? {
            Some(snapshot) => snapshot,
            None => {
                let snapshot = SceneSnapshot {
                    scene: Arc::new(Scene::default()),
                    revision: 1,
                };
                file.write(&snapshot)?;
                snapshot
            }
        };
        Ok(Self {
            file,
            grids_dir,
            maps,
            field,
            change: Mutex::new(()),
            current: watch::Sender::new(snapshot),
        })
    }

    /// The scene as it is now.
    pub fn snapshot(&self) -> SceneSnapshot {
        self.current.borrow().clone()
    }

    /// Tells of every change; who is slow sees only the last.
    pub fn subscribe(&self) -> watch::Receiver<SceneSnapshot> {
        self.current.subscribe()
    }

    /// Changes the scene by a merge patch (RFC 7396) and keeps it. Blocks while the disk works. A
    /// patch that changes nothing makes no new revision.
    ///
    /// # Errors
    /// If the precondition does not hold, the result is no scene, or it cannot be kept. The scene
    /// is then as before.
    pub fn patch(
        &self,
        precondition: &Precondition,
        patch: &Value,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        // The lock guards no data, so a panic while it was held has broken nothing.
        let _change = self.change.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.snapshot();
        precondition.check(&before)?;
        let mut document = file::document_of(&before.scene)?;
        json_patch::merge(&mut document, patch);
        self.take_over(&before, &document)
    }

    /// Makes a document the scene, keeps it and tells of it. With the lock held.
    fn take_over(
        &self,
        before: &SceneSnapshot,
        document: &Value,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let scene = Scene::from_json(document)?;
        if scene == *before.scene {
            return Ok(before.clone());
        }
        check_grids(&scene, &self.grids_dir)?;
        check_maps(&scene, &self.field, self.maps.path())?;
        let after = SceneSnapshot {
            scene: Arc::new(scene),
            revision: before.revision + 1,
        };
        self.file.write(&after)?;
        self.current.send_replace(after.clone());
        self.maps.collect(&maps::named_files(&after.scene));
        Ok(after)
    }
}
