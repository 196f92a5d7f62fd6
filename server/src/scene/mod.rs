//! The scene that the service shows: its revision, its changes, and its copy on disk.
//!
//! Invariant: a revision that anybody has seen is on disk. A change is written and synced before
//! it is announced: first to the journal of revisions, then as `scene.json`.

mod file;
mod group;
#[cfg(test)]
mod group_tests;
mod history;
mod journal;
mod json_patches;
mod map_folder;
mod maps;
mod presets;
mod revision;
#[cfg(test)]
mod tests;

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Instant;

use serde_json::Value;
use skycell_protocol::scene::{StillSceneDocument, TimeChange, TimeDocument, TransitionDocument};
use skycell_protocol::{Moment, Scene, SceneDocument, SceneError, ValueError};
use thiserror::Error;
use tokio::sync::watch;

use crate::clock;
use crate::field::{FieldStore, MapFileError, check_grids, check_maps};
use file::SceneFile;
pub use file::SceneFileError;
use group::OpenGroup;
pub use group::{ChangeGroup, GROUP_MAX_CHARS, GROUP_PATTERN, GROUP_PAUSE_MAX};
use history::{Revisions, all_named_files};
use journal::Journal;
pub use json_patches::{OPERATIONS_MAX, SceneJsonPatch};
use map_folder::MapFolder;
pub use maps::MapChoice;
pub use presets::{Preset, preset, presets};
use revision::Cause;
pub use revision::{ChangeKind, Revision};

/// How many revisions are kept: as many undos, and maps of as many revisions.
pub const REVISIONS_MAX: usize = 100;

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
    /// An operation of a JSON patch does not fit the scene that there is.
    #[error("{0}")]
    Conflict(ValueError),
    /// There is no room for another map.
    #[error("{error}; allowed: {allowed}")]
    MapsFull {
        /// How many bytes there would be.
        error: String,
        /// How many there may be.
        allowed: String,
    },
    /// There is no change left to undo.
    #[error("nothing is left to undo: revision {oldest} is the oldest that is kept")]
    NothingToUndo {
        /// The oldest revision that is kept.
        oldest: u64,
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
    change: Mutex<Journal>,
    /// The group of changes that may go on, if the newest revision belongs to one. Not kept: after a restart it is at its end.
    open_group: Mutex<Option<OpenGroup>>,
    /// What the journal holds. Apart from it, so that nobody who reads waits for a change.
    history: RwLock<Revisions>,
    current: watch::Sender<SceneSnapshot>,
}

impl SceneStore {
    /// Opens the store in a folder, which is made if there is none. Without a file there, the
    /// scene is the default one with sky time 0 now, revision 1, and is written.
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
        let file = SceneFile::in_folder(state_dir.clone())?;
        let (snapshot, revisions, journal) = history::recover(state_dir, &file, clock::now())?;
        Ok(Self {
            file,
            grids_dir,
            maps,
            field,
            change: Mutex::new(journal),
            open_group: Mutex::default(),
            history: RwLock::new(revisions),
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
    /// patch that changes nothing makes no new revision. Clouds go on from where they are, whatever
    /// happens to wind and clock, unless the patch itself says where they are (`/drift`).
    ///
    /// # Errors
    /// If the precondition does not hold, the result is no scene, or it cannot be kept. The scene
    /// is then as before.
    pub fn patch(
        &self,
        precondition: &Precondition,
        patch: &Value,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        self.patch_in(precondition, patch, None)
    }

    /// As [`Self::patch`], of a group of changes: one that goes on with its group takes the place of the one before it in the
    /// history.
    ///
    /// # Errors
    /// As [`Self::patch`].
    pub fn patch_in(
        &self,
        precondition: &Precondition,
        patch: &Value,
        group: Option<ChangeGroup>,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let says_where = patch.get("drift").is_some();
        let cause = Cause {
            group,
            ..Cause::of_kind(ChangeKind::Patch)
        };
        self.change(precondition, says_where, &cause, |before, _| {
            let mut document = file::document_of(before)?;
            json_patch::merge(&mut document, patch);
            Ok(SceneDocument::from_json(&document)?)
        })
    }

    /// Changes the scene by a JSON patch (RFC 6902): all of its operations or none. Otherwise as [`Self::patch_in`].
    ///
    /// # Errors
    /// As [`Self::patch`]; also if an operation finds nothing where it points to, or a test finds something else.
    pub fn apply(
        &self,
        precondition: &Precondition,
        patch: &SceneJsonPatch,
        group: Option<ChangeGroup>,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let cause = Cause {
            group,
            ..Cause::of_kind(ChangeKind::Patch)
        };
        let says_where = patch.says_where_clouds_are();
        self.change(precondition, says_where, &cause, |before, _| {
            let mut document = file::document_of(before)?;
            patch.apply_to(&mut document)?;
            Ok(SceneDocument::from_json(&document)?)
        })
    }

    /// Stops the sky's clock, lets it go on, sets it or gives it another rate, from now on. As [`Self::patch_in`] for groups.
    ///
    /// # Errors
    /// If the precondition does not hold, a number is out of range, or the scene cannot be kept.
    pub fn change_time(
        &self,
        precondition: &Precondition,
        time_change: &TimeChange,
        group: Option<ChangeGroup>,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let cause = Cause {
            group,
            ..Cause::of_kind(ChangeKind::Time)
        };
        self.change(precondition, false, &cause, |before, now| {
            let mut document = before.to_document();
            document.time = document.time.changed(now, time_change);
            Ok(document)
        })
    }

    /// Makes the sky a preset's, on the way there for `transition_s`. Clock and quality stay.
    ///
    /// # Errors
    /// If the precondition does not hold, the time is out of range, or the scene cannot be kept.
    pub fn set_preset(
        &self,
        precondition: &Precondition,
        preset: &Preset,
        transition_s: f64,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let cause = Cause {
            about: Some(preset.name.clone()),
            ..Cause::of_kind(ChangeKind::Preset)
        };
        self.change(precondition, false, &cause, |before, now| {
            let transition = TransitionDocument {
                began: now,
                duration_s: transition_s,
                from: Box::new(StillSceneDocument(before.at(now).to_document())),
            };
            Ok(SceneDocument {
                time: TimeDocument::from(before.clock()),
                quality: before.quality(),
                transition: (transition_s != 0.0).then_some(transition),
                ..preset.scene.to_document()
            })
        })
    }

    /// Makes a document from the present scene, and a revision from that.
    fn change(
        &self,
        precondition: &Precondition,
        says_where_clouds_are: bool,
        cause: &Cause,
        edit: impl Fn(&Scene, Moment) -> Result<SceneDocument, ScenePatchError>,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        // A journal that a panic has left in the middle of a line says so itself.
        let mut journal = self.change.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.snapshot();
        precondition.check(&before)?;
        self.edit(&mut journal, &before, says_where_clouds_are, cause, edit)
    }

    /// The same with the lock held.
    fn edit(
        &self,
        journal: &mut Journal,
        before: &SceneSnapshot,
        says_where_clouds_are: bool,
        cause: &Cause,
        edit: impl Fn(&Scene, Moment) -> Result<SceneDocument, ScenePatchError>,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        // Maps of a seed or a pattern that nobody has asked for yet take seconds. They are made here, before the moment
        // of the change: a renderer that made them would hold its viewers up, and then the sky would jump.
        let wanted = Scene::try_from(edit(&before.scene, clock::now())?)?;
        self.field.prepare(&wanted, &before.scene);
        let now = clock::now();
        let document = edit(&before.scene, now)?;
        self.make(journal, before, document, says_where_clouds_are, now, cause)
    }

    /// Makes a document the scene, keeps it and tells of it. With the lock held.
    fn take_over(
        &self,
        journal: &mut Journal,
        before: &SceneSnapshot,
        document: &Value,
        cause: &Cause,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let document = SceneDocument::from_json(document)?;
        self.make(journal, before, document, false, clock::now(), cause)
    }

    /// With the lock held.
    fn make(
        &self,
        journal: &mut Journal,
        before: &SceneSnapshot,
        mut document: SceneDocument,
        says_where_clouds_are: bool,
        now: Moment,
        cause: &Cause,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let mut scene = Scene::try_from(document.clone())?;
        if scene == *before.scene {
            return Ok(before.clone());
        }
        if !says_where_clouds_are {
            document.drift = before.scene.continued_drift(&scene, now);
            // What has come needs not be told any more.
            document.transition = document
                .transition
                .filter(|_| scene.transition().is_some_and(|t| now < t.ends()));
            scene = Scene::try_from(document)?;
        }
        check_grids(&scene, &self.grids_dir)?;
        check_maps(&scene, &self.field, self.maps.path())?;
        let after = SceneSnapshot {
            scene: Arc::new(scene),
            revision: before.revision + 1,
        };
        self.keep(journal, before, &after, now, cause)?;
        self.current.send_replace(after.clone());
        Ok(after)
    }

    /// Writes a revision ahead, then the scene.
    #[tracing::instrument(
        target = "skycell_traces",
        level = "trace",
        name = "keep revision",
        skip_all
    )]
    fn keep(
        &self,
        journal: &mut Journal,
        before: &SceneSnapshot,
        after: &SceneSnapshot,
        now: Moment,
        cause: &Cause,
    ) -> Result<(), SceneFileError> {
        let kept = self.history();
        let mut revisions = kept.clone();
        let mut open_group = self
            .open_group
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let made = Instant::now();
        let continued = open_group
            .as_ref()
            .filter(|open| open.is_continued_by(cause, before.revision, made))
            .and_then(|_| history::take_newest(&mut revisions));
        let first = continued.map_or(after.revision, |newest| newest.first);
        let base = revisions.back().map(|base| Arc::clone(&base.scene));
        let base = base.as_deref().unwrap_or(&before.scene);
        let scene = Arc::clone(&after.scene);
        let revision = Revision::new(after.revision, first, now, cause, Some(base), scene)?;
        history::add(&mut revisions, revision);
        journal.keep(&revisions)?;
        if let Err(error) = self.file.write(after) {
            journal.take_back(&kept);
            // Its name may have reached the disk.
            let _ = self.file.write(before);
            return Err(error);
        }
        self.maps.collect(&all_named_files(&revisions));
        self.set_history(revisions);
        *open_group = OpenGroup::of(cause, after.revision, made);
        Ok(())
    }
}

/// The default scene with sky time 0 now.
fn first_scene(now: Moment) -> Scene {
    let document = SceneDocument {
        time: TimeDocument {
            epoch: now,
            ..TimeDocument::default()
        },
        ..SceneDocument::default()
    };
    // The defaults are a scene at any epoch.
    Scene::try_from(document).unwrap_or_default()
}
