//! A moment by the clock on the wall, as documents and requests write it.

use std::fmt;

use jiff::Timestamp;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Serialize, Serializer};
use serde_json::Value;

use crate::ValueError;
use crate::read_json::ReadJson;

const ALLOWED: &str = "a date and time such as \"2026-06-21T10:30:00Z\", or seconds since 1970-01-01T00:00:00Z, from 1900 \
                       to 2100";

/// A moment between the years 1900 and 2100, to the microsecond.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Moment {
    unix_us: i64,
}

impl Moment {
    /// 1900-01-01T00:00:00Z.
    pub const MIN: Self = Self {
        unix_us: -2_208_988_800_000_000,
    };
    /// 2101-01-01T00:00:00Z.
    pub const MAX: Self = Self {
        unix_us: 4_133_980_800_000_000,
    };
    /// 1970-01-01T00:00:00Z.
    pub const UNIX_EPOCH: Self = Self { unix_us: 0 };

    /// The moment that many microseconds after 1970-01-01T00:00:00Z; the nearest end of the range when it is outside.
    pub fn from_unix_us(unix_us: i64) -> Self {
        Self {
            unix_us: unix_us.clamp(Self::MIN.unix_us, Self::MAX.unix_us),
        }
    }

    /// The moment that many seconds after 1970-01-01T00:00:00Z; none outside the range.
    pub fn from_unix_s(unix_s: f64) -> Option<Self> {
        let us = unix_s * 1e6;
        // NaN is in no range.
        (Self::MIN.unix_us as f64..=Self::MAX.unix_us as f64)
            .contains(&us)
            .then(|| Self::from_unix_us(us.round() as i64))
    }

    /// Reads RFC 3339, with a time zone.
    ///
    /// # Errors
    /// Says under `pointer` what is allowed.
    pub fn parse(text: &str, pointer: &str) -> Result<Self, ValueError> {
        text.parse::<Timestamp>()
            .ok()
            .map(Timestamp::as_microsecond)
            .filter(|us| (Self::MIN.unix_us..=Self::MAX.unix_us).contains(us))
            .map(|unix_us| Self { unix_us })
            .ok_or_else(|| ValueError::new(pointer, &Value::from(text), ALLOWED))
    }

    /// Microseconds since 1970-01-01T00:00:00Z.
    pub fn unix_us(self) -> i64 {
        self.unix_us
    }

    /// Seconds since 1970-01-01T00:00:00Z.
    pub fn unix_s(self) -> f64 {
        self.unix_us as f64 * 1e-6
    }

    /// Seconds from another moment to this one, negative when this is the earlier one.
    pub fn seconds_since(self, other: Self) -> f64 {
        (self.unix_us - other.unix_us) as f64 * 1e-6
    }

    /// The moment that many seconds later; the nearest end of the range when that is outside.
    #[must_use]
    pub fn plus_s(self, seconds: f64) -> Self {
        // A cast saturates, so no number of seconds leads out of the range.
        Self::from_unix_us(self.unix_us.saturating_add((seconds * 1e6).round() as i64))
    }
}

impl fmt::Display for Moment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match Timestamp::from_microsecond(self.unix_us) {
            Ok(timestamp) => timestamp.fmt(f),
            // The library's range is wider than ours.
            Err(_) => write!(f, "{}", self.unix_s()),
        }
    }
}

impl Serialize for Moment {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl JsonSchema for Moment {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Moment".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let date = json_schema!({"type": "string", "format": "date-time"});
        if generator.contract().is_serialize() {
            return date;
        }
        json_schema!({
            "description": "A date and time, or seconds since 1970-01-01T00:00:00Z, from 1900 to 2100.",
            "oneOf": [
                date,
                {
                    "type": "number",
                    "minimum": Self::MIN.unix_s(),
                    "maximum": Self::MAX.unix_s(),
                    "x-unit": "s",
                },
            ],
        })
    }
}

impl ReadJson for Moment {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        match value {
            Value::String(text) => Self::parse(text, pointer),
            other => other
                .as_f64()
                .and_then(Self::from_unix_s)
                .ok_or_else(|| ValueError::new(pointer, value, ALLOWED)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(value: Value) -> Result<Moment, ValueError> {
        Moment::read_json(&value, "/at")
    }

    #[test]
    fn a_moment_is_read_from_a_date_or_a_number_and_written_as_a_date() {
        let noon = read(json!("2026-06-21T12:00:00+02:00")).expect("a date");
        assert_eq!(Ok(noon), read(json!(1_782_036_000)));
        assert_eq!(noon.to_string(), "2026-06-21T10:00:00Z");
        let precise = read(json!(1_782_036_000.123_456)).expect("a number");
        let written = serde_json::to_value(precise).expect("serialises");
        assert_eq!(written, json!("2026-06-21T10:00:00.123456Z"));
        assert_eq!(read(written), Ok(precise));
    }

    #[test]
    fn moments_before_1970_are_moments_and_those_outside_two_centuries_are_not() {
        assert_eq!(read(json!("1900-01-01T00:00:00Z")), Ok(Moment::MIN));
        for bad in [
            json!("1899-12-31T23:59:59Z"),
            json!("2101-01-02T00:00:00Z"),
            json!("2026-06-21"),
            json!("2026-06-21T10:00:00"),
            json!("noon"),
            json!(1e12),
            json!(-1e300),
            json!(null),
            json!([]),
        ] {
            assert_eq!(
                read(bad.clone()).expect_err("no moment").pointer,
                "/at",
                "{bad}"
            );
        }
        assert_eq!(Moment::MAX.plus_s(f64::INFINITY), Moment::MAX);
        assert_eq!(Moment::MIN.plus_s(-1e300), Moment::MIN);
    }
}
