//! The one error for a value that is not allowed: where it stands, what it is, what may stand there.

use std::fmt;

use serde_json::Value;

/// How much of an offending value an error repeats.
const VALUE_TEXT_MAX_CHARS: usize = 80;

/// A value of a document or message that is not allowed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct ValueError {
    /// JSON pointer (RFC 6901) of the value, empty for the whole document.
    pub pointer: String,
    /// The value as JSON text, cut after 80 characters; `missing` where there is none.
    pub value: String,
    /// What may stand there, in words, such as `0 to 1`.
    pub allowed: String,
}

impl ValueError {
    /// An error at `pointer` about a JSON value.
    pub fn new(pointer: impl Into<String>, value: &Value, allowed: impl Into<String>) -> Self {
        Self::with_text(pointer, &value.to_string(), allowed)
    }

    /// An error at `pointer` about a number, which may be one that JSON cannot write (NaN).
    pub fn of_number(pointer: impl Into<String>, value: f64, allowed: impl Into<String>) -> Self {
        Self::with_text(pointer, &value.to_string(), allowed)
    }

    /// An error about a key that has to be there and is not.
    pub fn missing(pointer: impl Into<String>, allowed: impl Into<String>) -> Self {
        Self::with_text(pointer, "missing", allowed)
    }

    fn with_text(pointer: impl Into<String>, text: &str, allowed: impl Into<String>) -> Self {
        let value = if text.chars().nth(VALUE_TEXT_MAX_CHARS).is_some() {
            let mut cut: String = text.chars().take(VALUE_TEXT_MAX_CHARS - 1).collect();
            cut.push('…');
            cut
        } else {
            text.to_owned()
        };
        Self {
            pointer: pointer.into(),
            value,
            allowed: allowed.into(),
        }
    }

    /// The same error seen from one level further out: `/coverage` under `/density` becomes
    /// `/density/coverage`.
    #[must_use]
    pub fn under(mut self, parent_pointer: &str) -> Self {
        self.pointer.insert_str(0, parent_pointer);
        self
    }
}

impl fmt::Display for ValueError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = if self.pointer.is_empty() {
            "the document"
        } else {
            &self.pointer
        };
        write!(f, "{place} is {}; allowed: {}", self.value, self.allowed)
    }
}

/// `parent` with one more step, escaped as RFC 6901 asks.
pub fn child_pointer(parent: &str, key: &str) -> String {
    format!("{parent}/{}", key.replace('~', "~0").replace('/', "~1"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_names_place_value_and_what_is_allowed() {
        let error = ValueError::new("/sun/elevation_deg", &Value::from(91), "-90 to 90");
        assert_eq!(
            error.to_string(),
            "/sun/elevation_deg is 91; allowed: -90 to 90"
        );
    }

    #[test]
    fn a_long_value_is_cut_to_eighty_characters() {
        let error = ValueError::new("", &Value::from("ä".repeat(5000)), "less");
        assert_eq!(error.value.chars().count(), 80);
        assert!(error.value.ends_with('…'));
    }

    #[test]
    fn pointer_steps_are_escaped() {
        assert_eq!(child_pointer("/a", "b/c~d"), "/a/b~1c~0d");
    }
}
