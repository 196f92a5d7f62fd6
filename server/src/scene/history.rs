//! The last revisions: which are kept, how they are found again at the start, and how one is brought back.

use std::collections::{BTreeSet, VecDeque};
use std::path::PathBuf;
use std::sync::{Arc, PoisonError};

use skycell_protocol::scene::{StillSceneDocument, TransitionDocument};
use skycell_protocol::{Moment, SceneDocument, SceneError};

use super::file::{SceneFile, SceneFileError};
use super::journal::Journal;
use super::maps::named_files;
use super::revision::{Cause, ChangeKind, Revision};
use super::{Precondition, REVISIONS_MAX, ScenePatchError, SceneSnapshot, SceneStore, first_scene};

/// All revisions that are kept, oldest first; never empty.
pub(super) type Revisions = VecDeque<Arc<Revision>>;

/// Finds the scene and its revisions in a folder, or makes the first ones. What a server that was stopped at any instant
/// has left is put in order.
pub(super) fn recover(
    folder: PathBuf,
    file: &SceneFile,
    now: Moment,
) -> Result<(SceneSnapshot, Revisions, Journal), SceneFileError> {
    let (mut journal, found) = Journal::open(folder)?;
    if found.is_torn {
        tracing::warn!("the last revision was not written to its end; it was never acknowledged");
    }
    if found.damaged > 0 {
        tracing::warn!(
            lines = found.damaged,
            "lines of revisions.log are damaged; those revisions are lost"
        );
    }
    let mut revisions = found.revisions;
    let newest = revisions.back().cloned();
    let (snapshot, kind) = match (file.read()?, &newest) {
        (None, None) => {
            let scene = Arc::new(first_scene(now));
            (
                SceneSnapshot { scene, revision: 1 },
                Some(ChangeKind::Start),
            )
        }
        // Written ahead, and then the server was stopped: nobody was told otherwise, so it holds. Without a `scene.json`
        // whoever moved that away gets the last scene that was whole.
        (None, Some(newest)) => (snapshot_of(newest), None),
        (Some(read), Some(newest)) if read.revision < newest.revision => {
            (snapshot_of(newest), None)
        }
        (Some(read), Some(newest)) if read == snapshot_of(newest) => (read, None),
        // Changed by hand under the same number: clients may have seen that number with another scene.
        (Some(read), Some(newest)) if read.revision == newest.revision => {
            let revision = read.revision + 1;
            (SceneSnapshot { revision, ..read }, Some(ChangeKind::File))
        }
        (Some(read), _) => (read, Some(ChangeKind::File)),
    };
    if let Some(kind) = kind {
        let before = newest.as_ref().map(|newest| &*newest.scene);
        let scene = Arc::clone(&snapshot.scene);
        let cause = Cause::of_kind(kind);
        add(
            &mut revisions,
            Revision::new(
                snapshot.revision,
                snapshot.revision,
                now,
                &cause,
                before,
                scene,
            )?,
        );
        journal.keep(&revisions)?;
    } else if !journal.is_whole() {
        journal.rewrite(&revisions)?;
    }
    // The file may be of the revision before, or its name not synced.
    file.write(&snapshot)?;
    Ok((snapshot, revisions, journal))
}

fn snapshot_of(revision: &Revision) -> SceneSnapshot {
    SceneSnapshot {
        scene: Arc::clone(&revision.scene),
        revision: revision.revision,
    }
}

/// Adds a revision; the oldest goes when there are too many.
pub(super) fn add(revisions: &mut Revisions, revision: Revision) {
    revisions.push_back(Arc::new(revision));
    while revisions.len() > REVISIONS_MAX {
        revisions.pop_front();
    }
}

/// Takes the newest revision out, for one that stands for it as well. None where it is the only one: then nothing would tell
/// what there was before.
pub(super) fn take_newest(revisions: &mut Revisions) -> Option<Arc<Revision>> {
    if revisions.len() < 2 {
        return None;
    }
    revisions.pop_back()
}

/// All files that kept revisions name.
pub(super) fn all_named_files<'a>(
    revisions: impl IntoIterator<Item = &'a Arc<Revision>>,
) -> BTreeSet<String> {
    revisions
        .into_iter()
        .flat_map(|revision| named_files(&revision.scene))
        .collect()
}

/// Where in the history the newest revision stands: itself, or what it has brought back.
fn position(revisions: &Revisions) -> Option<u64> {
    let mut at = revisions.back()?;
    while let Some(of) = at.of {
        match revisions
            .iter()
            .find(|revision| revision.revision == of && of < at.revision)
        {
            Some(found) => at = found,
            None => return Some(of),
        }
    }
    Some(at.revision)
}

/// What an undo brings back: the revision before that which is shown, so that undoing again goes further back. One that shows
/// the same (a group of changes may end where it began) would be no undo.
fn undone(revisions: &Revisions) -> Option<Arc<Revision>> {
    let position = position(revisions)?;
    let shown = &revisions.back()?.scene;
    revisions
        .iter()
        .rev()
        .find(|revision| revision.revision < position && revision.scene != *shown)
        .cloned()
}

impl SceneStore {
    /// All revisions that are kept, oldest first.
    pub fn revisions(&self) -> Vec<Arc<Revision>> {
        self.history().iter().cloned().collect()
    }

    /// A revision, if it is kept.
    pub fn revision(&self, number: u64) -> Option<Arc<Revision>> {
        self.history()
            .iter()
            .find(|revision| revision.revision == number)
            .cloned()
    }

    pub(super) fn history(&self) -> Revisions {
        // Only whole histories are put there.
        self.history
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    pub(super) fn set_history(&self, revisions: Revisions) {
        *self.history.write().unwrap_or_else(PoisonError::into_inner) = revisions;
    }

    /// Brings the document of an earlier revision back, as a new revision, on the way there for `transition_s`. Without a
    /// number the last change is undone, and when that was an undo, the change before. Clouds stay where they are.
    ///
    /// # Errors
    /// If the precondition does not hold, the revision is not kept, a map that it names is gone, the time is out of range,
    /// or the scene cannot be kept.
    pub fn revert(
        &self,
        precondition: &Precondition,
        number: Option<u64>,
        transition_s: f64,
    ) -> Result<SceneSnapshot, ScenePatchError> {
        let mut journal = self.change.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.snapshot();
        precondition.check(&before)?;
        let history = self.history();
        let target = match number {
            Some(number) => self
                .revision(number)
                .ok_or_else(|| unknown_revision(number, &history))?,
            None => undone(&history).ok_or(ScenePatchError::NothingToUndo {
                oldest: history.front().map_or(0, |oldest| oldest.revision),
            })?,
        };
        let cause = Cause {
            of: Some(target.revision),
            ..Cause::of_kind(ChangeKind::Revert)
        };
        self.edit(&mut journal, &before, false, &cause, |before, now| {
            let document = target.scene.to_document();
            let way = TransitionDocument {
                began: now,
                duration_s: transition_s,
                from: Box::new(StillSceneDocument(before.at(now).to_document())),
            };
            Ok(SceneDocument {
                transition: if transition_s == 0.0 {
                    document.transition
                } else {
                    Some(way)
                },
                ..document
            })
        })
    }
}

fn unknown_revision(number: u64, history: &Revisions) -> ScenePatchError {
    let kept = match (history.front(), history.back()) {
        (Some(oldest), Some(newest)) => {
            format!("a kept one, {} to {}", oldest.revision, newest.revision)
        }
        _ => "none".to_owned(),
    };
    SceneError::new("/revision", &serde_json::Value::from(number), kept).into()
}

#[cfg(test)]
mod tests {
    use skycell_protocol::Scene;

    use super::*;

    /// A revision with one of many scenes.
    fn of_scene(revision: u64, cause: &Cause, shown: u64) -> Revision {
        let document = SceneDocument {
            exposure_ev: shown as f64 / 100.0,
            ..SceneDocument::default()
        };
        let scene = Arc::new(Scene::try_from(document).expect("a scene"));
        let epoch = Moment::UNIX_EPOCH;
        Revision::new(revision, revision, epoch, cause, None, scene).expect("JSON")
    }

    fn history(of: &[Option<u64>]) -> Revisions {
        (1..)
            .zip(of)
            .map(|(revision, of)| {
                let kind = of.map_or(ChangeKind::Patch, |_| ChangeKind::Revert);
                let cause = Cause {
                    of: *of,
                    ..Cause::of_kind(kind)
                };
                let shown = of.filter(|of| *of < revision).unwrap_or(revision);
                Arc::new(of_scene(revision, &cause, shown))
            })
            .collect()
    }

    fn undone_number(of: &[Option<u64>]) -> Option<u64> {
        undone(&history(of)).map(|revision| revision.revision)
    }

    #[test]
    fn undo_goes_back_change_by_change_and_a_new_change_is_undone_first() {
        assert_eq!(undone_number(&[None]), None);
        assert_eq!(undone_number(&[None, None, None]), Some(2));
        assert_eq!(undone_number(&[None, None, None, Some(2)]), Some(1));
        assert_eq!(undone_number(&[None, None, None, Some(2), Some(1)]), None);
        // A change after an undo.
        let changed = [None, None, None, Some(2), None];
        assert_eq!(undone_number(&changed), Some(4));
        let undone_again = [None, None, None, Some(2), None, Some(4)];
        assert_eq!(undone_number(&undone_again), Some(1));
        // A revision that names itself or a later one leads nowhere.
        assert_eq!(undone_number(&[None, Some(2)]), Some(1));
    }

    #[test]
    fn an_undo_brings_back_what_looks_different() {
        let cause = Cause::of_kind(ChangeKind::Patch);
        let shown = |numbers: &[u64]| -> Option<u64> {
            let revisions = (1..)
                .zip(numbers)
                .map(|(revision, shown)| Arc::new(of_scene(revision, &cause, *shown)))
                .collect();
            undone(&revisions).map(|revision| revision.revision)
        };
        assert_eq!(shown(&[1, 2, 2]), Some(1));
        assert_eq!(shown(&[1, 1]), None);
    }
}
