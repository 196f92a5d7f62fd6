//! Groups of changes in the history and on disk.

use std::fs;

use serde_json::json;

use super::*;

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn open(folder: &tempfile::TempDir) -> SceneStore {
    SceneStore::open(folder.path().to_owned()).expect("opens")
}

fn group(writer: &str) -> ChangeGroup {
    ChangeGroup::new(writer.to_owned(), "drag").expect("a group")
}

/// Exposes by a change of a group, or by one that stands alone.
fn expose(store: &SceneStore, exposure_ev: f64, group: Option<ChangeGroup>) -> u64 {
    store
        .patch_in(
            &Precondition::Any,
            &json!({"exposure_ev": exposure_ev}),
            group,
        )
        .expect("a good patch")
        .revision
}

/// First and last number of each revision that is kept.
fn kept(store: &SceneStore) -> Vec<(u64, u64)> {
    let kept = store.revisions();
    kept.iter()
        .map(|kept| (kept.first, kept.revision))
        .collect()
}

#[test]
fn a_drag_is_one_revision_to_whoever_looks_back_and_one_undo() {
    let folder = folder();
    let store = open(&folder);
    expose(&store, 0.5, None);
    for tick in 1..=5 {
        let revision = expose(&store, f64::from(tick), Some(group("a")));
        assert_eq!(revision, 2 + tick as u64, "every change has its own number");
    }
    assert_eq!(kept(&store), [(1, 1), (2, 2), (3, 7)]);
    assert!(store.revision(5).is_none());
    drop(store);
    let store = open(&folder);
    assert_eq!(kept(&store), [(1, 1), (2, 2), (3, 7)]);
    assert_eq!(store.snapshot().scene.exposure_ev(), 5.0);
    let undone = store.revert(&Precondition::Any, None, 0.0).expect("undone");
    assert_eq!((undone.revision, undone.scene.exposure_ev()), (8, 0.5));
    let undone = store.revert(&Precondition::Any, None, 0.0).expect("undone");
    assert_eq!((undone.revision, undone.scene.exposure_ev()), (9, 0.0));
}

#[test]
fn what_a_group_changed_is_what_differs_from_before_it() {
    let folder = folder();
    let store = open(&folder);
    for patch in [
        json!({"exposure_ev": 1}),
        json!({"sun": {"azimuth_deg": 7}}),
    ] {
        store
            .patch_in(&Precondition::Any, &patch, Some(group("a")))
            .expect("a good patch");
    }
    let newest = store.revision(3).expect("kept");
    assert_eq!(newest.changed, ["/exposure_ev", "/sun/azimuth_deg"]);
}

#[test]
fn whatever_comes_between_ends_a_group() {
    let folder = folder();
    let store = open(&folder);
    expose(&store, 1.0, Some(group("a")));
    expose(&store, 2.0, Some(group("b")));
    expose(&store, 3.0, Some(group("a")));
    expose(&store, 4.0, Some(group("a")));
    expose(&store, 5.0, None);
    expose(&store, 6.0, Some(group("a")));
    let faster = TimeChange {
        rate: Some(2.0),
        ..TimeChange::default()
    };
    store
        .change_time(&Precondition::Any, &faster, Some(group("a")))
        .expect("taken");
    assert_eq!(
        kept(&store),
        [(1, 1), (2, 2), (3, 3), (4, 5), (6, 6), (7, 7), (8, 8)]
    );
}

#[test]
fn a_long_drag_uses_up_one_revision_and_its_journal_does_not_grow() {
    let folder = folder();
    let store = open(&folder);
    for step in 1..=3 {
        expose(&store, f64::from(step), None);
    }
    for tick in 0..3 * REVISIONS_MAX as u32 {
        expose(&store, f64::from(tick) / 100.0, Some(group("a")));
    }
    let newest = 4 + 3 * REVISIONS_MAX as u64;
    let expected = [(1, 1), (2, 2), (3, 3), (4, 4), (5, newest)];
    assert_eq!(kept(&store), expected);
    let log = fs::read_to_string(folder.path().join("revisions.log")).expect("there");
    assert!(
        log.lines().count() <= 2 * REVISIONS_MAX,
        "{}",
        log.lines().count()
    );
    drop(store);
    assert_eq!(kept(&open(&folder)), expected);
}

#[test]
fn a_drag_that_ends_where_it_began_is_no_step_of_undo() {
    let folder = folder();
    let store = open(&folder);
    expose(&store, 1.0, None);
    for exposure_ev in [2.0, 3.0, 1.0] {
        expose(&store, exposure_ev, Some(group("a")));
    }
    assert_eq!(kept(&store), [(1, 1), (2, 2), (3, 5)]);
    assert_eq!(store.revision(5).expect("kept").changed, [""; 0]);
    let undone = store.revert(&Precondition::Any, None, 0.0).expect("undone");
    assert_eq!((undone.revision, undone.scene.exposure_ev()), (6, 0.0));
}

#[test]
fn a_stop_within_a_drag_leaves_the_last_change_that_was_acknowledged() {
    let folder = folder();
    let store = open(&folder);
    expose(&store, 0.5, None);
    expose(&store, 1.0, Some(group("a")));
    expose(&store, 2.0, Some(group("a")));
    let scene_before = fs::read(folder.path().join("scene.json")).expect("there");
    expose(&store, 3.0, Some(group("a")));
    let scene_after = fs::read(folder.path().join("scene.json")).expect("there");
    let log = fs::read(folder.path().join("revisions.log")).expect("there");
    let line_before: usize = log
        .split_inclusive(|byte| *byte == b'\n')
        .take(4)
        .map(<[u8]>::len)
        .sum();
    assert!(line_before < log.len());
    for cut in [
        line_before,
        line_before + 1,
        (line_before + log.len()) / 2,
        log.len() - 1,
        log.len(),
    ] {
        for scene in [&scene_before, &scene_after] {
            // The scene of after is written when the line is whole.
            let is_whole = cut == log.len();
            if !is_whole && std::ptr::eq(scene, &scene_after) {
                continue;
            }
            let stopped = self::folder();
            fs::write(stopped.path().join("revisions.log"), &log[..cut]).expect("written");
            fs::write(stopped.path().join("scene.json"), scene).expect("written");
            let store = open(&stopped);
            let (last, exposure_ev) = if is_whole { (5, 3.0) } else { (4, 2.0) };
            assert_eq!(kept(&store), [(1, 1), (2, 2), (3, last)], "cut at {cut}");
            assert_eq!(store.snapshot().scene.exposure_ev(), exposure_ev);
            // After a restart a group is at its end.
            assert_eq!(expose(&store, 4.0, Some(group("a"))), last + 1);
            assert_eq!(kept(&store).len(), 4);
        }
    }
}
