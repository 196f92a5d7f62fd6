//! Reading JSON values into wire types with errors that name pointer, value and what is allowed.
//!
//! serde's own errors cannot: inside a tagged enum the path is lost, and what was expected is
//! prose about Rust types.

use serde_json::{Map, Value};

use crate::ValueError;
use crate::value_error::child_pointer;

/// How similar (Jaro-Winkler, 0 to 1) a known name must be to be suggested. Tuned: `covrage`,
/// `cover` and `radius` find `coverage` and `radius_m`; `foo` finds nothing.
const SUGGESTION_MIN_SIMILARITY: f64 = 0.8;

/// The known name that a reader most likely meant by `unknown`.
pub fn nearest_name<'a>(unknown: &str, known: &[&'a str]) -> Option<&'a str> {
    known
        .iter()
        .map(|name| (strsim::jaro_winkler(unknown, name), *name))
        .filter(|(similarity, _)| *similarity >= SUGGESTION_MIN_SIMILARITY)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, name)| name)
}

/// What to say where the name `unknown` stands and only `known` ones may.
pub fn unknown_name_advice(unknown: &str, known: &[&str]) -> String {
    let list = known.join(", ");
    match nearest_name(unknown, known) {
        Some(name) => format!("one of the keys {list}; did you mean \"{name}\"?"),
        None => format!("one of the keys {list}"),
    }
}

/// A type that can be read from a JSON value.
pub trait ReadJson: Sized {
    /// Reads the value that stands at `pointer`.
    ///
    /// # Errors
    /// Names the pointer, the value and what is allowed.
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError>;
}

/// A JSON object whose members are read by name.
pub struct ObjectReader<'a> {
    members: &'a Map<String, Value>,
    pointer: &'a str,
}

impl<'a> ObjectReader<'a> {
    /// The members of `value`, which stands at `pointer`.
    ///
    /// # Errors
    /// If the value is no object.
    pub fn new(value: &'a Value, pointer: &'a str) -> Result<Self, ValueError> {
        match value {
            Value::Object(members) => Ok(Self { members, pointer }),
            other => Err(ValueError::new(pointer, other, "an object")),
        }
    }

    /// Refuses every key that is not one of `known`.
    ///
    /// # Errors
    /// Names the first unknown key and the known one that was most likely meant.
    pub fn only(&self, known: &[&str]) -> Result<(), ValueError> {
        match self
            .members
            .iter()
            .find(|(key, _)| !known.contains(&key.as_str()))
        {
            Some((key, value)) => Err(ValueError::new(
                child_pointer(self.pointer, key),
                value,
                unknown_name_advice(key, known),
            )),
            None => Ok(()),
        }
    }

    /// The member `key`, if there is one.
    ///
    /// # Errors
    /// If it is not of the type.
    pub fn optional<T: ReadJson>(&self, key: &str) -> Result<Option<T>, ValueError> {
        self.members
            .get(key)
            .map(|value| T::read_json(value, &child_pointer(self.pointer, key)))
            .transpose()
    }

    /// The member `key`, or the default where there is none.
    ///
    /// # Errors
    /// If it is not of the type.
    pub fn member_or<T: ReadJson>(&self, key: &str, default: T) -> Result<T, ValueError> {
        Ok(self.optional(key)?.unwrap_or(default))
    }

    /// The member `key`, which has to be there. `allowed` tells what, if it is not.
    ///
    /// # Errors
    /// If it is not there or not of the type.
    pub fn required<T: ReadJson>(&self, key: &str, allowed: &str) -> Result<T, ValueError> {
        self.optional(key)?
            .ok_or_else(|| ValueError::missing(child_pointer(self.pointer, key), allowed))
    }

    /// The pointer of the member `key`.
    pub fn pointer_of(&self, key: &str) -> String {
        child_pointer(self.pointer, key)
    }
}

/// One of several names that stand for values, such as `"jpeg"` for a codec.
///
/// # Errors
/// Lists the names, if the value is none of them.
pub fn read_name<T: Copy>(
    value: &Value,
    pointer: &str,
    names: &[(&str, T)],
) -> Result<T, ValueError> {
    value
        .as_str()
        .and_then(|text| names.iter().find(|(name, _)| *name == text))
        .map(|(_, meaning)| *meaning)
        .ok_or_else(|| {
            let list: Vec<String> = names
                .iter()
                .map(|(name, _)| format!("\"{name}\""))
                .collect();
            ValueError::new(pointer, value, list.join(" or "))
        })
}

impl ReadJson for Value {
    fn read_json(value: &Value, _pointer: &str) -> Result<Self, ValueError> {
        Ok(value.clone())
    }
}

impl ReadJson for bool {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        value
            .as_bool()
            .ok_or_else(|| ValueError::new(pointer, value, "true or false"))
    }
}

impl ReadJson for f64 {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        value
            .as_f64()
            .ok_or_else(|| ValueError::new(pointer, value, "a number"))
    }
}

impl ReadJson for u64 {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        /// Above this, not every whole number is an f64, so `1e300` is not taken for one.
        const EXACT_MAX: f64 = 9_007_199_254_740_992.0;
        value
            .as_u64()
            // Some clients write whole numbers as 4.0.
            .or_else(|| {
                value
                    .as_f64()
                    .filter(|number| number.fract() == 0.0 && (0.0..=EXACT_MAX).contains(number))
                    .map(|number| number as u64)
            })
            .ok_or_else(|| ValueError::new(pointer, value, "a whole number from 0"))
    }
}

impl ReadJson for u32 {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        u64::read_json(value, pointer)
            .ok()
            .and_then(|number| u32::try_from(number).ok())
            .ok_or_else(|| {
                ValueError::new(pointer, value, format!("a whole number, 0 to {}", u32::MAX))
            })
    }
}

impl ReadJson for String {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        match value {
            Value::String(text) => Ok(text.clone()),
            other => Err(ValueError::new(pointer, other, "a string")),
        }
    }
}

impl<T: ReadJson> ReadJson for [T; 3] {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        match value.as_array().map(Vec::as_slice) {
            Some([a, b, c]) => Ok([
                T::read_json(a, &format!("{pointer}/0"))?,
                T::read_json(b, &format!("{pointer}/1"))?,
                T::read_json(c, &format!("{pointer}/2"))?,
            ]),
            _ => Err(ValueError::new(pointer, value, "an array of 3 numbers")),
        }
    }
}

impl<T: ReadJson> ReadJson for Option<T> {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        match value {
            Value::Null => Ok(None),
            other => T::read_json(other, pointer).map(Some),
        }
    }
}

impl<T: ReadJson> ReadJson for Vec<T> {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        match value {
            Value::Array(items) => items
                .iter()
                .enumerate()
                .map(|(index, item)| T::read_json(item, &format!("{pointer}/{index}")))
                .collect(),
            other => Err(ValueError::new(pointer, other, "an array")),
        }
    }
}

/// Declares a wire type whose keys are all optional: the struct, its defaults, how it is written (serde) and its schema
/// (schemars). Behind a default, after a semicolon, stands the range of a number or of each number of an array: the schema
/// tells it, and the domain type that is made of the document checks it. How the type is read is the declarer's: see
/// `document!`.
macro_rules! document_members {
    (
        $(#[$meta:meta])*
        pub struct $name:ident {
            $( $(#[$field_meta:meta])* $key:literal => $field:ident: $type:ty = $default:expr $(; $range:expr)?, )*
        }
    ) => {
        #[derive(Clone, Debug, PartialEq, serde::Serialize, schemars::JsonSchema)]
        $(#[$meta])*
        #[schemars(default, deny_unknown_fields, extend("x-order" = Self::KEYS))]
        pub struct $name {
            $(
                $(#[$field_meta])*
                #[serde(rename = $key)]
                $(#[schemars(
                    range(min = $range.min, max = $range.max),
                    inner(range(min = $range.min, max = $range.max))
                )])?
                pub $field: $type,
            )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $field: $default, )* }
            }
        }

        impl $name {
            /// Every key that the document knows.
            pub const KEYS: &'static [&'static str] = &[ $( $key, )* ];

            /// Reads the members without refusing others: a tagged document has its tag beside them. Keys that are
            /// missing keep what `default` has.
            fn read_members_or(
                members: &crate::read_json::ObjectReader<'_>,
                default: Self,
            ) -> Result<Self, crate::ValueError> {
                Ok(Self { $( $field: members.member_or($key, default.$field)?, )* })
            }
        }
    };
}
pub(crate) use document_members;

/// Declares a wire type whose keys are all optional: the struct, its defaults, how it is written
/// (serde), its schema, and how it is read (`ReadJson`, which refuses unknown keys).
macro_rules! document {
    (
        $(#[$meta:meta])*
        pub struct $name:ident { $($members:tt)* }
    ) => {
        crate::read_json::document_members! {
            $(#[$meta])*
            pub struct $name { $($members)* }
        }

        impl crate::read_json::ReadJson for $name {
            fn read_json(
                value: &serde_json::Value,
                pointer: &str,
            ) -> Result<Self, crate::ValueError> {
                let members = crate::read_json::ObjectReader::new(value, pointer)?;
                members.only(Self::KEYS)?;
                Self::read_members_or(&members, Self::default())
            }
        }
    };
}
pub(crate) use document;

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_misspelt_name_finds_the_known_one_and_nonsense_finds_none() {
        let known = ["radius_m", "ground_albedo", "coverage"];
        assert_eq!(nearest_name("covrage", &known), Some("coverage"));
        assert_eq!(nearest_name("radius", &known), Some("radius_m"));
        assert_eq!(nearest_name("foo", &known), None);
    }

    #[test]
    fn whole_numbers_may_be_written_as_floats_but_fractions_may_not() {
        assert_eq!(u32::read_json(&json!(4.0), ""), Ok(4));
        for bad in [
            json!(4.5),
            json!(-1),
            json!(4294967296u64),
            json!("4"),
            json!(1e300),
        ] {
            assert!(u32::read_json(&bad, "").is_err(), "{bad}");
        }
    }

    #[test]
    fn a_wrong_item_of_an_array_is_named_by_its_index() {
        let error = <[f64; 3]>::read_json(&json!([1, "x", 3]), "/p").expect_err("a string");
        assert_eq!(error.pointer, "/p/1");
    }
}
