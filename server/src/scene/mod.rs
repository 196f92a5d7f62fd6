//! The scene that the service shows: its revision, its changes, and its copy on disk.
//!
//! Invariant: a revision that anybody has seen is on disk. A change is written and synced before
//! it is announced.

mod file;
#[cfg(test)]
mod tests;

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use serde_json::Value;
use skycell_protocol::{Scene, SceneError};
use thiserror::Error;
use tokio::sync::watch;

use crate::field::check_grids;
use file::SceneFile;
pub use file::SceneFileError;

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
        let grids_dir = state_dir.join("grids");
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
        if let Precondition::OneOf(revisions) = precondition
            && !revisions.contains(&before.revision)
        {
            return Err(ScenePatchError::Stale {
                current: before.revision,
            });
        }
        let mut document = file::document_of(&before.scene)?;
        json_patch::merge(&mut document, patch);
        let scene = Scene::from_json(&document)?;
        if scene == *before.scene {
            return Ok(before);
        }
        check_grids(&scene, &self.grids_dir)?;
        let after = SceneSnapshot {
            scene: Arc::new(scene),
            revision: before.revision + 1,
        };
        self.file.write(&after)?;
        self.current.send_replace(after.clone());
        Ok(after)
    }
}
