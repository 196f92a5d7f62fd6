use std::fs;

use serde_json::json;

use super::*;

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn open(folder: &tempfile::TempDir) -> SceneStore {
    SceneStore::open(folder.path().to_owned()).expect("opens")
}

#[test]
fn a_new_store_holds_the_default_scene_as_revision_one() {
    let folder = folder();
    let snapshot = open(&folder).snapshot();
    let sky_s = snapshot.scene.clock().sky_s(crate::clock::now());
    assert!((0.0..60.0).contains(&sky_s), "sky time 0 is now: {sky_s}");
    let mut document = snapshot.scene.to_document();
    document.time = TimeDocument::default();
    assert_eq!(
        (Scene::try_from(document), snapshot.revision),
        (Ok(Scene::default()), 1)
    );
    assert!(folder.path().join("scene.json").exists());
}

#[test]
fn a_patch_is_announced_and_survives_a_restart() {
    let folder = folder();
    let store = open(&folder);
    let mut changes = store.subscribe();
    let after = store
        .patch(&Precondition::OneOf(vec![1]), &json!({"exposure_ev": 2.5}))
        .expect("a good patch");
    assert_eq!((after.revision, after.scene.exposure_ev()), (2, 2.5));
    assert!(changes.has_changed().expect("the store lives"));
    assert_eq!(*changes.borrow_and_update(), after);
    drop(store);
    assert_eq!(open(&folder).snapshot(), after);
}

#[test]
fn a_patch_that_changes_nothing_makes_no_revision() {
    let folder = folder();
    let store = open(&folder);
    let after = store
        .patch(&Precondition::Any, &json!({"exposure_ev": 0}))
        .expect("a good patch");
    assert_eq!(after.revision, 1);
}

#[test]
fn a_stale_patch_and_a_bad_one_leave_scene_and_file_as_they_were() {
    let folder = folder();
    let store = open(&folder);
    let text = fs::read_to_string(folder.path().join("scene.json")).expect("written");
    match store.patch(&Precondition::OneOf(vec![2, 3]), &json!({"exposure_ev": 1})) {
        Err(ScenePatchError::Stale { current: 1 }) => {}
        other => panic!("not stale: {other:?}"),
    }
    match store.patch(&Precondition::Any, &json!({"sun": {"elevation_deg": 99}})) {
        Err(ScenePatchError::Invalid(error)) => assert_eq!(error.pointer, "/sun/elevation_deg"),
        other => panic!("not invalid: {other:?}"),
    }
    assert_eq!(store.snapshot().revision, 1);
    assert_eq!(
        fs::read_to_string(folder.path().join("scene.json")).expect("still there"),
        text
    );
}

#[test]
fn null_in_a_patch_brings_the_default_back_and_a_model_can_be_changed() {
    let folder = folder();
    let store = open(&folder);
    let patch = |value| store.patch(&Precondition::Any, &value);
    patch(json!({"exposure_ev": 3})).expect("a good patch");
    let after = patch(json!({"exposure_ev": null})).expect("a good patch");
    assert_eq!(after.scene.exposure_ev(), 0.0);
    let advice = patch(json!({"light": {"phase": {"model": "isotropic"}}}))
        .expect_err("the old model's key is left over")
        .to_string();
    assert!(advice.contains("null removes a key"), "{advice}");
    patch(json!({"light": {"phase": {"model": "isotropic", "droplet_diameter_um": null}}}))
        .expect("a good patch");
}

#[test]
fn a_corrupt_file_is_told_and_not_overwritten() {
    for (text, reason) in [
        ("{\"revision\": 3, \"sce", "EOF"),
        ("", "EOF"),
        (
            "{\"revision\": 0, \"scene\": {\"version\": 1}}",
            "/revision is 0",
        ),
        (
            "{\"revision\": 1, \"scene\": {\"version\": 1, \"exposure_ev\": 99}}",
            "/scene/exposure_ev is 99",
        ),
        (
            "{\"revision\": 1, \"scene\": {\"version\": 1}, \"more\": 1}",
            "/more",
        ),
    ] {
        let folder = folder();
        let path = folder.path().join("scene.json");
        fs::write(&path, text).expect("written");
        match SceneStore::open(folder.path().to_owned()) {
            Err(error @ SceneFileError::Corrupt { .. }) => {
                assert!(error.to_string().contains(reason), "{error}");
                assert!(error.to_string().contains("scene.json"), "{error}");
            }
            Err(other) => panic!("another error: {other}"),
            Ok(_) => panic!("opened {text:?}"),
        }
        assert_eq!(fs::read_to_string(&path).expect("still there"), text);
    }
}

#[test]
fn a_write_that_was_cut_short_before_the_rename_leaves_the_old_scene() {
    let folder = folder();
    let before = open(&folder).snapshot();
    fs::write(folder.path().join("scene.json.new"), "{\"revi").expect("written");
    assert_eq!(open(&folder).snapshot(), before);
}

#[cfg(unix)]
#[test]
fn a_folder_that_takes_no_file_is_told_and_the_scene_stays() {
    let folder = folder();
    let store = open(&folder);
    // A folder of the new file's name makes writing fail for every user, root too.
    fs::create_dir(folder.path().join("scene.json.new")).expect("made");
    match store.patch(&Precondition::Any, &json!({"exposure_ev": 1})) {
        Err(ScenePatchError::NotKept(SceneFileError::Io { .. })) => {}
        other => panic!("kept: {other:?}"),
    }
    assert_eq!(store.snapshot().revision, 1);
}

#[test]
fn changes_that_race_each_get_their_own_revision() {
    let folder = folder();
    let store = open(&folder);
    std::thread::scope(|scope| {
        for number in 1..=8 {
            let store = &store;
            scope.spawn(move || {
                store
                    .patch(&Precondition::Any, &json!({"exposure_ev": number}))
                    .expect("a good patch")
            });
        }
    });
    assert_eq!(store.snapshot().revision, 9);
}

#[test]
fn a_patch_that_names_voxels_is_taken_when_they_are_there_and_else_leaves_the_scene_as_it_was() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = open(&folder);
    let before = store.snapshot();
    let patch = json!({"layers": [{"density": {"model": "grid", "file": "two.f32", "dimensions": [2, 1, 1]}}]});
    match store.patch(&Precondition::Any, &patch) {
        Err(ScenePatchError::Invalid(error)) => {
            assert_eq!(error.pointer, "/layers/0/density/file");
            assert!(error.allowed.contains("cannot be read"), "{error}");
        }
        other => panic!("{other:?}"),
    }
    assert_eq!(store.snapshot(), before);
    let grids = folder.path().join("grids");
    std::fs::create_dir_all(&grids).expect("a folder");
    std::fs::write(grids.join("two.f32"), [0u8; 8]).expect("written");
    let after = store.patch(&Precondition::Any, &patch).expect("taken");
    assert_eq!(after.revision, before.revision + 1);
}

#[test]
fn clouds_go_on_from_where_they_are_when_the_wind_turns() {
    let folder = folder();
    let store = open(&folder);
    let patch = |value| {
        store
            .patch(&Precondition::Any, &value)
            .expect("a good patch")
    };
    patch(json!({"time": {"epoch": "2020-01-01T00:00:00Z"}, "drift": null}));
    let far = |snapshot: &SceneSnapshot| snapshot.scene.at(crate::clock::now()).carried_m(0);
    let before = far(&store.snapshot());
    assert!(before.x > 1e8, "years of wind: {before}");
    let after = patch(json!({"wind": {"towards_deg": 0, "speed_m_per_s": 20}}));
    assert!(
        far(&after).distance(before) < 2000.0,
        "{before} to {}",
        far(&after)
    );
    assert!(after.scene.to_document().drift.is_some());
    // Who says where clouds are is believed.
    let without = patch(json!({"drift": null}));
    assert!(far(&without).distance(before) > 1e8);
}

fn numbers(store: &SceneStore) -> Vec<u64> {
    let revisions = store.revisions();
    revisions.iter().map(|revision| revision.revision).collect()
}

fn exposure(store: &SceneStore, exposure_ev: f64) -> SceneSnapshot {
    let patch = json!({"exposure_ev": exposure_ev});
    store
        .patch(&Precondition::Any, &patch)
        .expect("a good patch")
}

fn undo(store: &SceneStore) -> Result<SceneSnapshot, ScenePatchError> {
    store.revert(&Precondition::Any, None, 0.0)
}

#[test]
fn revisions_tell_when_by_what_and_what_they_changed_and_survive_a_restart() {
    let folder = folder();
    let store = open(&folder);
    let begun = clock::now();
    exposure(&store, 1.0);
    store
        .set_preset(&Precondition::Any, preset("storm").expect("a preset"), 0.0)
        .expect("taken");
    store
        .change_time(
            &Precondition::Any,
            &TimeChange {
                rate: Some(2.0),
                ..TimeChange::default()
            },
            None,
        )
        .expect("taken");
    let told = store.revisions();
    let kinds: Vec<ChangeKind> = told.iter().map(|revision| revision.kind).collect();
    assert_eq!(
        kinds,
        [
            ChangeKind::Start,
            ChangeKind::Patch,
            ChangeKind::Preset,
            ChangeKind::Time
        ]
    );
    assert_eq!(told[1].changed, ["/exposure_ev"]);
    assert!((begun..=clock::now()).contains(&told[1].time));
    assert_eq!(told[2].about.as_deref(), Some("storm"));
    drop(store);
    assert_eq!(open(&folder).revisions(), told);
}

#[test]
fn only_the_last_revisions_are_kept_and_the_journal_does_not_grow() {
    let folder = folder();
    let store = open(&folder);
    for number in 0..250 {
        exposure(&store, 0.01 * f64::from(number % 7 + 1));
    }
    let newest = store.snapshot().revision;
    assert_eq!(newest, 251);
    let kept: Vec<u64> = (newest - 99..=newest).collect();
    assert_eq!(numbers(&store), kept);
    let text = fs::read_to_string(folder.path().join("revisions.log")).expect("a journal");
    assert!(text.lines().count() <= 2 * REVISIONS_MAX);
    drop(store);
    assert_eq!(numbers(&open(&folder)), kept);
}

#[test]
fn undo_goes_back_step_by_step_and_a_number_brings_any_kept_revision_back() {
    let folder = folder();
    let store = open(&folder);
    let exposures = [0.0, 1.0, 2.0];
    exposures[1..].iter().for_each(|value| {
        exposure(&store, *value);
    });
    let shown = |result: Result<SceneSnapshot, ScenePatchError>| {
        let snapshot = result.expect("reverted");
        (snapshot.revision, snapshot.scene.exposure_ev())
    };
    assert_eq!(shown(undo(&store)), (4, 1.0));
    assert_eq!(shown(undo(&store)), (5, 0.0));
    match undo(&store) {
        Err(ScenePatchError::NothingToUndo { oldest: 1 }) => {}
        other => panic!("undone: {other:?}"),
    }
    assert_eq!(
        shown(store.revert(&Precondition::OneOf(vec![5]), Some(3), 0.0)),
        (6, 2.0)
    );
    match store.revert(&Precondition::Any, Some(77), 0.0) {
        Err(ScenePatchError::Invalid(error)) => {
            assert_eq!(
                error.to_string(),
                "/revision is 77; allowed: a kept one, 1 to 6"
            );
        }
        other => panic!("reverted: {other:?}"),
    }
    match store.revert(&Precondition::OneOf(vec![5]), Some(1), 0.0) {
        Err(ScenePatchError::Stale { current: 6 }) => {}
        other => panic!("not stale: {other:?}"),
    }
    let last = store.revisions().pop().expect("a revision");
    assert_eq!((last.kind, last.of), (ChangeKind::Revert, Some(3)));
}

#[test]
fn what_is_brought_back_is_the_document_and_clouds_stay_where_they_are() {
    let folder = folder();
    let store = open(&folder);
    let patch = |value| {
        store
            .patch(&Precondition::Any, &value)
            .expect("a good patch")
    };
    let far = |snapshot: &SceneSnapshot| snapshot.scene.at(clock::now()).carried_m(0);
    let calm = patch(json!({"time": {"epoch": "2020-01-01T00:00:00Z"}, "drift": null}));
    let before = far(&calm);
    patch(json!({"wind": {"towards_deg": 0, "speed_m_per_s": 20}, "exposure_ev": 1}));
    let back = undo(&store).expect("undone");
    assert!(far(&back).distance(before) < 2000.0);
    let without_drift = |snapshot: &SceneSnapshot| SceneDocument {
        drift: None,
        ..snapshot.scene.to_document()
    };
    assert_eq!(without_drift(&back), without_drift(&calm));
    patch(json!({"exposure_ev": 1}));
    let on_the_way = store
        .revert(&Precondition::Any, None, 30.0)
        .expect("undone");
    assert!(on_the_way.scene.transition().is_some());
}

/// Every state that a stop can leave while revision 3 follows revision 2: the journal's line cut short anywhere or followed
/// by garbage, the new scene beside the old one, complete or not, or in its place.
#[test]
fn a_stop_at_any_point_of_a_change_leaves_the_scene_before_or_after_and_never_less() {
    let folder = folder();
    let store = open(&folder);
    exposure(&store, 1.0);
    let read = |name: &str| fs::read(folder.path().join(name)).expect("there");
    let (log_before, json_before) = (read("revisions.log"), read("scene.json"));
    exposure(&store, 2.0);
    let (log_after, json_after) = (read("revisions.log"), read("scene.json"));
    drop(store);
    assert!(log_after.starts_with(&log_before));
    let put = |log: &[u8], scene: &[u8], new: Option<&[u8]>| {
        fs::write(folder.path().join("revisions.log"), log).expect("written");
        fs::write(folder.path().join("scene.json"), scene).expect("written");
        if let Some(new) = new {
            fs::write(folder.path().join("scene.json.new"), new).expect("written");
        }
    };
    let check = |what: &str, wanted: u64| {
        let store = open(&folder);
        let snapshot = store.snapshot();
        let found = (snapshot.revision, snapshot.scene.exposure_ev());
        assert_eq!(found, (wanted, (wanted - 1) as f64), "{what}");
        let all: Vec<u64> = (1..=wanted).collect();
        assert_eq!(numbers(&store), all, "{what}");
        // And it goes on from there.
        assert_eq!(exposure(&store, 5.0).revision, wanted + 1, "{what}");
        drop(store);
        assert_eq!(open(&folder).snapshot().revision, wanted + 1, "{what}");
    };
    let line = log_before.len()..log_after.len();
    let cuts = line.clone().step_by(97).chain([line.end - 1]);
    for cut in cuts {
        put(&log_after[..cut], &json_before, None);
        check(&format!("cut at {cut}"), 2);
    }
    let mut zeros = log_before.clone();
    zeros.resize(log_after.len(), 0);
    put(&zeros, &json_before, None);
    check("the length before the content", 2);
    put(&log_after, &json_before, Some(&json_after[..40]));
    check("the journal whole, the scene begun", 3);
    put(&log_after, &json_before, Some(&json_after));
    check("the scene not renamed", 3);
    put(&log_after, &json_after, None);
    check("all done", 3);
    put(&log_before, &json_after, None);
    check("the journal's end lost after all", 3);
}

#[test]
fn a_damaged_line_costs_that_revision_alone() {
    let folder = folder();
    let store = open(&folder);
    for value in [1.0, 2.0, 3.0] {
        exposure(&store, value);
    }
    drop(store);
    let path = folder.path().join("revisions.log");
    let text = fs::read_to_string(&path).expect("a journal");
    let damaged = text.replacen("\"exposure_ev\":1.0", "\"exposure_ev\":1.5", 1);
    assert_ne!(damaged, text);
    fs::write(&path, damaged).expect("written");
    let store = open(&folder);
    assert_eq!(numbers(&store), [1, 3, 4]);
    assert_eq!(store.snapshot().scene.exposure_ev(), 3.0);
}

#[test]
fn a_scene_file_changed_by_hand_is_a_new_revision_and_one_moved_away_comes_back() {
    let folder = folder();
    let store = open(&folder);
    exposure(&store, 1.0);
    drop(store);
    let path = folder.path().join("scene.json");
    let text = fs::read_to_string(&path).expect("there");
    fs::write(
        &path,
        text.replace("\"exposure_ev\": 1.0", "\"exposure_ev\": 4.0"),
    )
    .expect("written");
    let store = open(&folder);
    let last = store.revisions().pop().expect("a revision");
    assert_eq!(
        (last.revision, last.kind, last.changed.clone()),
        (3, ChangeKind::File, vec!["/exposure_ev".to_owned()])
    );
    assert_eq!(store.snapshot().scene.exposure_ev(), 4.0);
    drop(store);
    fs::remove_file(&path).expect("removed");
    assert_eq!(open(&folder).snapshot().revision, 3);
    assert!(path.exists());
}

#[test]
fn wherever_the_last_line_of_the_journal_is_cut_what_comes_after_it_is_kept() {
    let folder = folder();
    let store = open(&folder);
    exposure(&store, 1.0);
    exposure(&store, 2.0);
    drop(store);
    let journal = folder.path().join("revisions.log");
    let whole = fs::read(&journal).expect("a journal");
    let scene = fs::read(folder.path().join("scene.json")).expect("a scene");
    let last_line = whole.len()
        - whole
            .split_inclusive(|byte| *byte == b'\n')
            .next_back()
            .map_or(0, <[u8]>::len);
    assert!(last_line > 0);
    // From the whole line without its end of line to nothing of it.
    for length in [
        whole.len() - 1,
        whole.len() - 2,
        last_line + 20,
        last_line + 16,
        last_line + 1,
        last_line,
    ] {
        fs::write(&journal, &whole[..length]).expect("cut");
        fs::write(folder.path().join("scene.json"), &scene).expect("written");
        let store = open(&folder);
        assert_eq!(store.snapshot().scene.exposure_ev(), 2.0, "{length}");
        let after = exposure(&store, 3.0);
        let kept = numbers(&store);
        drop(store);
        let store = open(&folder);
        assert_eq!(store.snapshot(), after, "{length}");
        assert_eq!(numbers(&store), kept, "{length}");
    }
}

#[test]
fn a_change_is_in_the_files_before_anybody_is_told_of_it() {
    let folder = folder();
    let store = open(&folder);
    let mut changes = store.subscribe();
    let path = folder.path().to_owned();
    let last = 21;
    // Looks all the time, so that it reads the files in the moment in which it is told.
    let watching = std::thread::spawn(move || {
        let mut seen = 1;
        while seen < last {
            if !changes.has_changed().expect("the store lives") {
                std::hint::spin_loop();
                continue;
            }
            // First, since another change may follow while files are read.
            seen = changes.borrow_and_update().revision;
            let journal = fs::read_to_string(path.join("revisions.log")).expect("a journal");
            let scene = fs::read_to_string(path.join("scene.json")).expect("a scene");
            let is_kept =
                [',', '}'].map(|next| journal.contains(&format!("\"revision\":{seen}{next}")));
            assert!(is_kept.contains(&true), "{seen}: {journal}");
            let scene: serde_json::Value = serde_json::from_str(&scene).expect("JSON");
            assert!(scene["revision"].as_u64() >= Some(seen), "{seen}: {scene}");
        }
        seen
    });
    for number in 1..last {
        exposure(&store, 0.1 * number as f64);
    }
    assert_eq!(watching.join().expect("what is told is kept"), last);
}

#[cfg(unix)]
#[test]
fn a_revision_whose_scene_cannot_be_written_is_taken_back_from_the_journal() {
    let folder = folder();
    let store = open(&folder);
    let blocked = folder.path().join("scene.json.new");
    fs::create_dir(&blocked).expect("made");
    assert!(
        store
            .patch(&Precondition::Any, &json!({"exposure_ev": 1}))
            .is_err()
    );
    assert_eq!(numbers(&store), [1]);
    fs::remove_dir(&blocked).expect("removed");
    assert_eq!(exposure(&store, 2.0).revision, 2);
    drop(store);
    let store = open(&folder);
    assert_eq!(numbers(&store), [1, 2]);
    assert_eq!(store.snapshot().scene.exposure_ev(), 2.0);
}

#[test]
fn maps_stay_as_long_as_a_kept_revision_names_them() {
    let folder = folder();
    let store = open(&folder);
    let choice = MapChoice {
        kind: skycell_protocol::scene::MapKind::Coverage,
        layer: None,
    };
    let picture = |level: u8| {
        let mut png = std::io::Cursor::new(Vec::new());
        let grey = image::GrayImage::from_pixel(4, 4, image::Luma([level]));
        grey.write_to(&mut png, image::ImageFormat::Png)
            .expect("a picture");
        png.into_inner()
    };
    let put = |level: u8| {
        store
            .put_map(&Precondition::Any, &choice, Some(0.0), &picture(level))
            .expect("taken")
            .revision
    };
    let files = || {
        fs::read_dir(folder.path().join("maps"))
            .expect("a folder")
            .count()
    };
    // More than files without a name may stay.
    let first = put(0);
    (1..60).for_each(|level| {
        put(level);
    });
    assert_eq!(files(), 60);
    let back = store
        .revert(&Precondition::Any, Some(first), 0.0)
        .expect("brought back");
    assert_eq!(
        maps::named_files(&back.scene),
        maps::named_files(&store.revision(first).expect("kept").scene)
    );
    assert_eq!(store.map(&choice).expect("a map").0, back);
    // When no kept revision names them any more, they go.
    for number in 0..REVISIONS_MAX {
        exposure(&store, 0.01 * (number % 7 + 1) as f64);
    }
    assert!(files() <= 33, "{} files", files());
    assert_eq!(
        store.map(&choice).expect("the map in use stays").0,
        store.snapshot()
    );
}
