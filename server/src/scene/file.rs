//! The scene on disk: `scene.json`, replaced as a whole.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::{Value, json};
use skycell_protocol::read_json::ObjectReader;
use skycell_protocol::value_error::ValueError;
use skycell_protocol::{Scene, SceneError};
use thiserror::Error;

use super::SceneSnapshot;

/// No scene that this service writes is a hundredth as long.
const FILE_MAX_BYTES: u64 = 1024 * 1024;

/// Why the scene cannot be read from or kept on disk.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SceneFileError {
    /// The operating system refuses.
    #[error("cannot {action} {path}: {error}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// With what.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// The file holds no scene.
    #[error(
        "{path} holds no scene: {reason}. Nothing was overwritten: mend the file, or move it away \
         to start with the last revision in revisions.log, or without that with the default scene"
    )]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The scene cannot be written as JSON.
    #[error("the scene cannot be written as JSON: {0}")]
    Unwritable(#[from] serde_json::Error),
}

/// The file `scene.json` of a folder: `{"revision": 7, "scene": {...}}`.
pub(super) struct SceneFile {
    folder: PathBuf,
    path: PathBuf,
}

impl SceneFile {
    pub(super) fn in_folder(folder: PathBuf) -> Result<Self, SceneFileError> {
        fs::create_dir_all(&folder).map_err(|error| io_error("make", &folder, error))?;
        Ok(Self {
            path: folder.join("scene.json"),
            folder,
        })
    }

    /// The scene, or none if there is no file.
    pub(super) fn read(&self) -> Result<Option<SceneSnapshot>, SceneFileError> {
        let bytes_len = match fs::metadata(&self.path) {
            Ok(metadata) => metadata.len(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(io_error("read", &self.path, error)),
        };
        if bytes_len > FILE_MAX_BYTES {
            return Err(self.corrupt(format!("{bytes_len} bytes are too many")));
        }
        let bytes = fs::read(&self.path).map_err(|error| io_error("read", &self.path, error))?;
        let value: Value =
            serde_json::from_slice(&bytes).map_err(|error| self.corrupt(error.to_string()))?;
        read_snapshot(&value)
            .map(Some)
            .map_err(|error| self.corrupt(error.to_string()))
    }

    /// Replaces the file. Whenever the machine stops, the old scene or the new one is there: the
    /// new one is complete on disk before it takes the old one's name.
    pub(super) fn write(&self, snapshot: &SceneSnapshot) -> Result<(), SceneFileError> {
        let value = json!({
            "revision": snapshot.revision,
            "scene": document_of(&snapshot.scene)?,
        });
        let mut text = serde_json::to_string_pretty(&value)?;
        text.push('\n');
        let new_path = self.folder.join("scene.json.new");
        write_and_sync(&new_path, text.as_bytes())
            .map_err(|error| io_error("write", &new_path, error))?;
        fs::rename(&new_path, &self.path)
            .map_err(|error| io_error("replace", &self.path, error))?;
        sync_folder(&self.folder).map_err(|error| io_error("sync", &self.folder, error))
    }

    fn corrupt(&self, reason: String) -> SceneFileError {
        SceneFileError::Corrupt {
            path: self.path.clone(),
            reason,
        }
    }
}

/// The scene as JSON with every key.
pub(crate) fn document_of(scene: &Scene) -> Result<Value, SceneFileError> {
    Ok(serde_json::to_value(scene.to_document())?)
}

fn read_snapshot(value: &Value) -> Result<SceneSnapshot, SceneError> {
    let members = ObjectReader::new(value, "")?;
    members.only(&["revision", "scene"])?;
    let revision: u64 = members.required("revision", "a whole number from 1")?;
    if revision == 0 {
        return Err(ValueError::new(
            "/revision",
            &Value::from(0),
            "a whole number from 1",
        ));
    }
    let document: Value = members.required("scene", "a scene")?;
    Ok(SceneSnapshot {
        scene: Arc::new(Scene::from_json(&document).map_err(|error| error.under("/scene"))?),
        revision,
    })
}

pub(super) fn write_and_sync(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

/// Makes the new name last. Elsewhere than on Unix a folder cannot be opened; there the system
/// keeps names in order.
pub(super) fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) {
        File::open(folder)?.sync_all()
    } else {
        Ok(())
    }
}

pub(super) fn io_error(action: &'static str, path: &Path, error: io::Error) -> SceneFileError {
    SceneFileError::Io {
        action,
        path: path.to_owned(),
        error,
    }
}
