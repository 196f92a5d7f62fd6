//! Changes that belong together: a slider that is dragged is one change to whoever looks back.
//!
//! Each change of a group is a revision like any other, with its own number, written and synced before it is acknowledged. But
//! while the group goes on, the newest one takes the place of the one before it in the history.

use std::time::{Duration, Instant};

use serde_json::Value;
use skycell_protocol::ValueError;

use super::revision::{Cause, ChangeKind};

/// A group that rests for longer is at its end: what follows begins another.
pub const GROUP_PAUSE_MAX: Duration = Duration::from_secs(10);

/// How long the name of a group may be.
pub const GROUP_MAX_CHARS: usize = 64;

/// What names of groups look like, as a regular expression.
pub const GROUP_PATTERN: &str = "^[A-Za-z0-9_-]{1,64}$";

/// The changes to which one belongs, by who makes them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChangeGroup {
    writer: String,
    name: String,
}

impl ChangeGroup {
    /// A group of a writer's, by a name that the writer has made up.
    ///
    /// # Errors
    /// If the name is empty, longer than 64 characters, or has others than letters, digits, - and _.
    pub fn new(writer: String, name: &str) -> Result<Self, ValueError> {
        let is_allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"-_".contains(&byte);
        if (1..=GROUP_MAX_CHARS).contains(&name.len()) && name.bytes().all(is_allowed) {
            Ok(Self {
                writer,
                name: name.to_owned(),
            })
        } else {
            Err(ValueError::new(
                "/group",
                &Value::from(name),
                format!("1 to {GROUP_MAX_CHARS} letters, digits, - or _"),
            ))
        }
    }
}

/// A group that may go on.
#[derive(Debug)]
pub(super) struct OpenGroup {
    group: ChangeGroup,
    kind: ChangeKind,
    /// The newest revision of it.
    revision: u64,
    changed: Instant,
}

impl OpenGroup {
    /// The group that a revision belongs to, if it does to one.
    pub(super) fn of(cause: &Cause, revision: u64, now: Instant) -> Option<Self> {
        Some(Self {
            group: cause.group.clone()?,
            kind: cause.kind,
            revision,
            changed: now,
        })
    }

    /// Whether a change of the newest revision goes on with it.
    pub(super) fn is_continued_by(&self, cause: &Cause, newest: u64, now: Instant) -> bool {
        cause.group.as_ref() == Some(&self.group)
            && cause.kind == self.kind
            && newest == self.revision
            && now.saturating_duration_since(self.changed) <= GROUP_PAUSE_MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cause(kind: ChangeKind, writer: &str, name: &str) -> Cause {
        Cause {
            group: Some(ChangeGroup::new(writer.to_owned(), name).expect("a group")),
            ..Cause::of_kind(kind)
        }
    }

    #[test]
    fn a_group_goes_on_for_its_writer_while_nothing_comes_between_and_it_does_not_rest() {
        let drag = cause(ChangeKind::Patch, "a", "drag-1");
        let began = Instant::now();
        let open = OpenGroup::of(&drag, 7, began).expect("a group");
        let goes_on = |cause: &Cause, newest, later| {
            open.is_continued_by(cause, newest, began + Duration::from_secs(later))
        };
        assert!(goes_on(&drag, 7, 0) && goes_on(&drag, 7, 10));
        assert!(!goes_on(&drag, 7, 11));
        assert!(!goes_on(&drag, 8, 0));
        assert!(!goes_on(&cause(ChangeKind::Patch, "b", "drag-1"), 7, 0));
        assert!(!goes_on(&cause(ChangeKind::Patch, "a", "drag-2"), 7, 0));
        assert!(!goes_on(&cause(ChangeKind::Time, "a", "drag-1"), 7, 0));
        let alone = Cause::of_kind(ChangeKind::Patch);
        assert!(!goes_on(&alone, 7, 0) && OpenGroup::of(&alone, 7, began).is_none());
    }

    #[test]
    fn names_of_groups_are_short_and_plain() {
        for (name, is_one) in [
            ("a", true),
            ("0c5e-41_Z", true),
            (&"x".repeat(64), true),
            (&"x".repeat(65), false),
            ("", false),
            ("a b", false),
            ("\u{e4}", false),
        ] {
            let group = ChangeGroup::new("w".to_owned(), name);
            assert_eq!(group.is_ok(), is_one, "{name}");
            if let Err(error) = group {
                assert_eq!(error.pointer, "/group");
            }
        }
    }
}
