//! A revision that is kept: what the scene was, when and how it came about, and what it changed.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use skycell_protocol::read_json::{ObjectReader, ReadJson, read_name};
use skycell_protocol::value_error::child_pointer;
use skycell_protocol::{Moment, Scene, SceneError};

use super::group::ChangeGroup;

/// How many changed places of a document are named; of further ones only their number.
const CHANGED_MAX: usize = 16;

/// By what kind of request a revision came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ChangeKind {
    /// The first start.
    Start,
    /// The file `scene.json`, put there or changed by hand.
    File,
    /// A patch of the document.
    Patch,
    /// The sky's clock.
    Time,
    /// A preset.
    Preset,
    /// A map put or brought back.
    Maps,
    /// An earlier revision brought back.
    Revert,
}

impl ChangeKind {
    const NAMES: [(&'static str, Self); 7] = [
        ("start", Self::Start),
        ("file", Self::File),
        ("patch", Self::Patch),
        ("time", Self::Time),
        ("preset", Self::Preset),
        ("maps", Self::Maps),
        ("revert", Self::Revert),
    ];
}

impl ReadJson for ChangeKind {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, SceneError> {
        read_name(value, pointer, &Self::NAMES)
    }
}

/// What makes a revision.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Cause {
    pub(super) kind: ChangeKind,
    pub(super) about: Option<String>,
    pub(super) of: Option<u64>,
    /// The changes that it belongs to, if its writer says so.
    pub(super) group: Option<ChangeGroup>,
}

impl Cause {
    pub(super) fn of_kind(kind: ChangeKind) -> Self {
        Self {
            kind,
            about: None,
            of: None,
            group: None,
        }
    }
}

/// A revision of the scene and where it comes from.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Revision {
    /// Its number, which is its ETag too.
    pub revision: u64,
    /// The first revision that it stands for: of a group of changes, which is one revision to whoever looks back. Its own number
    /// where it stands for itself alone.
    pub first: u64,
    /// When it was made.
    pub time: Moment,
    /// By what kind of request.
    pub kind: ChangeKind,
    /// Which preset, or which map of which layer.
    pub about: Option<String>,
    /// Which revision was brought back.
    pub of: Option<u64>,
    /// JSON pointers of what differs from the revision before, 16 at most.
    pub changed: Vec<String>,
    /// How many more differ.
    pub changed_more: u64,
    /// The scene.
    #[serde(skip)]
    pub scene: Arc<Scene>,
}

impl Revision {
    /// A revision that follows another one, if there is one before it; it stands for all from `first` on.
    pub(super) fn new(
        revision: u64,
        first: u64,
        time: Moment,
        cause: &Cause,
        before: Option<&Scene>,
        scene: Arc<Scene>,
    ) -> Result<Self, serde_json::Error> {
        let (mut changed, mut changed_more) = (Vec::new(), 0);
        if let Some(before) = before {
            let before = serde_json::to_value(before.to_document())?;
            let after = serde_json::to_value(scene.to_document())?;
            note_changes(&before, &after, "", &mut changed, &mut changed_more);
        }
        Ok(Self {
            revision,
            first,
            time,
            kind: cause.kind,
            about: cause.about.clone(),
            of: cause.of,
            changed,
            changed_more,
            scene,
        })
    }

    /// As it is kept: with its document.
    pub(super) fn to_record(&self) -> Result<Value, serde_json::Error> {
        let mut record = serde_json::to_value(self)?;
        record["scene"] = serde_json::to_value(self.scene.to_document())?;
        Ok(record)
    }

    /// Reads what [`Self::to_record`] has written.
    pub(super) fn from_record(value: &Value) -> Result<Self, SceneError> {
        let members = ObjectReader::new(value, "")?;
        members.only(&[
            "revision",
            "first",
            "time",
            "kind",
            "about",
            "of",
            "changed",
            "changed_more",
            "scene",
        ])?;
        let document: Value = members.required("scene", "a scene")?;
        let revision = members.required("revision", "a whole number from 1")?;
        let first = members.member_or("first", revision)?;
        if first > revision {
            return Err(SceneError::new(
                "/first",
                &Value::from(first),
                "the revision, or one before it",
            ));
        }
        Ok(Self {
            revision,
            first,
            time: members.required("time", "a date and time")?,
            kind: members.required("kind", "the kind of a change")?,
            about: members.member_or("about", None)?,
            of: members.member_or("of", None)?,
            changed: members.member_or("changed", Vec::new())?,
            changed_more: members.member_or("changed_more", 0)?,
            scene: Arc::new(Scene::from_json(&document).map_err(|error| error.under("/scene"))?),
        })
    }
}

/// Names the places in which two documents differ.
fn note_changes(
    before: &Value,
    after: &Value,
    pointer: &str,
    changed: &mut Vec<String>,
    more: &mut u64,
) {
    match (before, after) {
        (Value::Object(before), Value::Object(after)) => {
            let gone = before.keys().filter(|key| !after.contains_key(*key));
            for key in after.keys().chain(gone) {
                let at = child_pointer(pointer, key);
                let (old, new) = (before.get(key), after.get(key));
                let null = Value::Null;
                note_changes(
                    old.unwrap_or(&null),
                    new.unwrap_or(&null),
                    &at,
                    changed,
                    more,
                );
            }
        }
        (Value::Array(before), Value::Array(after)) if before.len() == after.len() => {
            for (index, (old, new)) in before.iter().zip(after).enumerate() {
                note_changes(old, new, &format!("{pointer}/{index}"), changed, more);
            }
        }
        _ if before == after => {}
        _ if changed.len() < CHANGED_MAX => changed.push(pointer.to_owned()),
        _ => *more += 1,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn changes(before: &Value, after: &Value) -> (Vec<String>, u64) {
        let (mut changed, mut more) = (Vec::new(), 0);
        note_changes(before, after, "", &mut changed, &mut more);
        (changed, more)
    }

    #[test]
    fn changes_are_named_by_pointers_and_many_are_counted() {
        let before = json!({"a": 1, "b": {"c": [1, 2], "d/e": 3}, "gone": 1});
        let after = json!({"a": 1, "b": {"c": [1, 5], "d/e": 4}, "new": [1]});
        assert_eq!(
            changes(&before, &after),
            (
                ["/b/c/1", "/b/d~1e", "/new", "/gone"]
                    .map(str::to_owned)
                    .to_vec(),
                0
            )
        );
        assert_eq!(
            changes(&json!({"l": [1]}), &json!({"l": [1, 2]})).0,
            ["/l".to_owned()]
        );
        let many: Vec<u32> = (0..40).collect();
        let (named, more) = changes(&json!(vec![99; 40]), &json!(many));
        assert_eq!((named.len(), more), (16, 24));
    }

    #[test]
    fn every_kind_of_change_has_its_name() {
        for (name, kind) in ChangeKind::NAMES {
            assert_eq!(serde_json::to_value(kind).expect("JSON"), json!(name));
        }
    }
}
