//! How good pictures are to be: a named quality, the largest error, or the time that a frame may take.

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::ValueError;
use crate::number_range::NumberRange;
use crate::read_json::{ObjectReader, ReadJson, read_name};

/// `max_error`: mean FLIP against the converged picture.
pub const MAX_ERROR_FLIP: NumberRange = NumberRange::new(0.001, 1.0);
/// `budget_ms`: device time of one frame of one viewer.
pub const BUDGET_MS: NumberRange = NumberRange::new(0.1, 1000.0);

const KEYS: &[&str] = &["preset", "max_error", "budget_ms"];
const ALLOWED: &str = "an object with exactly one of the keys preset, max_error and budget_ms (a merge patch \
                       takes the other away with null), the name of a preset, or null";

/// A named point between speed and accuracy, from the fastest to the most accurate.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum QualityPreset {
    /// Soon there.
    Draft,
    /// For software drivers and small GPUs.
    Balanced,
    /// For GPUs.
    High,
    /// Whatever it takes.
    Reference,
}

impl QualityPreset {
    /// Every preset with its name, from the fastest to the most accurate.
    pub const ALL: [(&'static str, Self); 4] = [
        ("draft", Self::Draft),
        ("balanced", Self::Balanced),
        ("high", Self::High),
        ("reference", Self::Reference),
    ];

    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Balanced => "balanced",
            Self::High => "high",
            Self::Reference => "reference",
        }
    }
}

impl ReadJson for QualityPreset {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &Self::ALL)
    }
}

/// What is asked for. One that was read from JSON is in range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum QualityChoice {
    /// A named quality.
    Preset(QualityPreset),
    /// The fastest whose mean FLIP is no larger, [`MAX_ERROR_FLIP`].
    MaxError(f64),
    /// The best whose frames take no more of the device's time, ms, [`BUDGET_MS`].
    BudgetMs(f64),
}

impl QualityChoice {
    /// The choice, if its number is in range.
    ///
    /// # Errors
    /// Names the number under `pointer` and the range.
    pub fn checked(self, pointer: &str) -> Result<Self, ValueError> {
        match self {
            Self::Preset(_) => {}
            Self::MaxError(flip) => {
                MAX_ERROR_FLIP.check(&format!("{pointer}/max_error"), flip)?;
            }
            Self::BudgetMs(ms) => {
                BUDGET_MS.check(&format!("{pointer}/budget_ms"), ms)?;
            }
        }
        Ok(self)
    }
}

impl JsonSchema for QualityChoice {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "QualityChoice".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let preset = generator.subschema_for::<QualityPreset>();
        let choice = |key: &str, value: Schema| {
            json_schema!({
                "type": "object",
                "properties": {key: value},
                "required": [key],
                "additionalProperties": false,
            })
        };
        let number = |range: NumberRange, description: &str| {
            json_schema!({
                "type": "number",
                "minimum": range.min,
                "maximum": range.max,
                "description": description,
            })
        };
        let mut choices = vec![
            choice("preset", preset.clone()),
            choice(
                "max_error",
                number(
                    MAX_ERROR_FLIP,
                    "The largest mean FLIP against the converged picture.",
                ),
            ),
            choice(
                "budget_ms",
                number(
                    BUDGET_MS,
                    "Device time that a frame of one viewer may take.",
                ),
            ),
        ];
        if generator.contract().is_deserialize() {
            choices.push(preset);
        }
        json_schema!({
            "description": "How good pictures are to be: a named quality (also by its name alone), the largest error, or \
                            the time that a frame may take.",
            "oneOf": choices,
        })
    }
}

impl ReadJson for QualityChoice {
    /// Also takes the name of a preset, which a merge patch can put in the place of anything.
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        if value.is_string() {
            return QualityPreset::read_json(value, pointer).map(Self::Preset);
        }
        let wrong = || ValueError::new(pointer, value, ALLOWED);
        let members = ObjectReader::new(value, pointer).map_err(|_| wrong())?;
        members.only(KEYS)?;
        let choices = [
            members.optional("preset")?.map(Self::Preset),
            members.optional("max_error")?.map(Self::MaxError),
            members.optional("budget_ms")?.map(Self::BudgetMs),
        ];
        let mut named = choices.into_iter().flatten();
        match (named.next(), named.next()) {
            (Some(choice), None) => choice.checked(pointer),
            _ => Err(wrong()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn each_choice_survives_json_and_a_preset_may_be_its_name() {
        for (choice, text) in [
            (
                QualityChoice::Preset(QualityPreset::High),
                json!({"preset": "high"}),
            ),
            (QualityChoice::MaxError(0.01), json!({"max_error": 0.01})),
            (QualityChoice::BudgetMs(4.5), json!({"budget_ms": 4.5})),
        ] {
            assert_eq!(serde_json::to_value(choice).ok(), Some(text.clone()));
            assert_eq!(QualityChoice::read_json(&text, ""), Ok(choice));
        }
        for (name, preset) in QualityPreset::ALL {
            let read = QualityChoice::read_json(&json!(name), "");
            assert_eq!(read, Ok(QualityChoice::Preset(preset)));
            assert_eq!(preset.name(), name);
        }
    }

    #[test]
    fn a_bad_choice_is_named_by_pointer_value_and_what_is_allowed() {
        for (value, pointer, allowed) in [
            (
                json!({"preset": "best"}),
                "/quality/preset",
                "\"draft\" or \"balanced\"",
            ),
            (json!("best"), "/quality", "\"draft\" or \"balanced\""),
            (json!({"max_error": 0}), "/quality/max_error", "0.001 to 1"),
            (json!({"max_error": 2}), "/quality/max_error", "0.001 to 1"),
            (
                json!({"budget_ms": 0.01}),
                "/quality/budget_ms",
                "0.1 to 1000",
            ),
            (json!({"budget_ms": "5"}), "/quality/budget_ms", "a number"),
            (
                json!({"budget": 5}),
                "/quality/budget",
                "did you mean \"budget_ms\"?",
            ),
            (json!({}), "/quality", "exactly one"),
            (
                json!({"preset": "high", "budget_ms": 5}),
                "/quality",
                "exactly one",
            ),
            (json!(5), "/quality", "exactly one"),
        ] {
            let error = QualityChoice::read_json(&value, "/quality").expect_err("bad");
            assert_eq!(error.pointer, pointer, "{value}");
            assert!(error.allowed.contains(allowed), "{error}");
        }
    }
}
