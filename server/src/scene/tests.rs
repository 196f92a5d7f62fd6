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
