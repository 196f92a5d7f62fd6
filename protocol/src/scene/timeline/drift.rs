//! Where the wind has carried the clouds: what a document remembers of it when winds or the clock are changed.

use std::collections::BTreeMap;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Serialize;
use serde_json::Value;

use crate::ValueError;
use crate::moment::Moment;
use crate::read_json::{ObjectReader, ReadJson};
use crate::scene::ranges;
use crate::value_error::child_pointer;

/// How far each layer's clouds had been carried at a moment. A server writes it when a change of the scene would otherwise
/// have moved clouds at once; from there on the wind carries them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Drift {
    pub(super) since: Moment,
    /// East, up and south, m, by the layer's name.
    pub(super) layers_m: BTreeMap<String, [f64; 3]>,
}

impl JsonSchema for Drift {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Drift".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "How far each layer's clouds had been carried at a moment. Servers write it.",
            "type": "object",
            "properties": {
                "since": generator.subschema_for::<Moment>(),
                "layers_m": {
                    "description": "East, up and south, by the layer's name.",
                    "type": "object",
                    "maxProperties": 2 * ranges::LAYERS_MAX,
                    "additionalProperties": {
                        "type": "array",
                        "items": {
                            "type": "number",
                            "minimum": ranges::DRIFT_M.min,
                            "maximum": ranges::DRIFT_M.max,
                            "x-unit": "m",
                        },
                        "minItems": 3,
                        "maxItems": 3,
                    },
                },
            },
            "required": ["since", "layers_m"],
            "additionalProperties": false,
            "x-order": ["since", "layers_m"],
        })
    }
}

impl ReadJson for Drift {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, pointer)?;
        members.only(&["since", "layers_m"])?;
        let since = members.required("since", "a date and time")?;
        let layers: Value = members.required("layers_m", "an object")?;
        let layers_pointer = members.pointer_of("layers_m");
        let Value::Object(layers) = layers else {
            return Err(ValueError::new(layers_pointer, &layers, "an object"));
        };
        if layers.len() > 2 * ranges::LAYERS_MAX {
            return Err(ValueError::new(
                layers_pointer,
                &Value::from(format!("{} layers", layers.len())),
                format!("0 to {} layers", 2 * ranges::LAYERS_MAX),
            ));
        }
        let mut layers_m = BTreeMap::new();
        for (name, offset) in &layers {
            let at = child_pointer(&layers_pointer, name);
            let offset = <[f64; 3]>::read_json(offset, &at)?;
            layers_m.insert(name.clone(), ranges::DRIFT_M.check_each(&at, offset)?);
        }
        Ok(Self { since, layers_m })
    }
}
