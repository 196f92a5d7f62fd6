//! The token in a hello.

use std::fmt;

use serde::Serialize;
use serde_json::Value;

use crate::ValueError;
use crate::read_json::ReadJson;

/// How long a token may be.
pub const ACCESS_TOKEN_MAX_BYTES: usize = 512;

/// What lets a client in. Written in messages, never by `Debug` or in errors.
#[derive(Clone, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct AccessToken(String);

impl AccessToken {
    /// A token of 1 to 512 visible ASCII characters, so that it fits the header `Authorization` too.
    ///
    /// # Errors
    /// If it is none; the error does not repeat it.
    pub fn new(text: impl Into<String>) -> Result<Self, ValueError> {
        Self::at(text.into(), "/token")
    }

    fn at(text: String, pointer: &str) -> Result<Self, ValueError> {
        let is_token = (1..=ACCESS_TOKEN_MAX_BYTES).contains(&text.len())
            && text.bytes().all(|byte| byte.is_ascii_graphic());
        if is_token {
            Ok(Self(text))
        } else {
            Err(not_shown(pointer))
        }
    }

    /// The token itself.
    pub fn text(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for AccessToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("AccessToken(…)")
    }
}

impl ReadJson for AccessToken {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        match value {
            Value::String(text) => Self::at(text.clone(), pointer),
            _ => Err(not_shown(pointer)),
        }
    }
}

fn not_shown(pointer: &str) -> ValueError {
    ValueError::new(
        pointer,
        &Value::from("…"),
        format!("1 to {ACCESS_TOKEN_MAX_BYTES} visible ASCII characters"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_that_is_none_is_not_repeated() {
        for text in ["", "secret with spaces", "sécret", &"s".repeat(513)] {
            let error = AccessToken::new(text).expect_err("none").to_string();
            assert!(text.is_empty() || !error.contains(text), "{error}");
        }
        let token = AccessToken::new("secret").expect("a token");
        assert_eq!(token.text(), "secret");
        assert!(!format!("{token:?}").contains("secret"));
        let error = AccessToken::read_json(&Value::from(123_456), "/token").expect_err("none");
        assert!(!error.to_string().contains("123456"), "{error}");
    }
}
