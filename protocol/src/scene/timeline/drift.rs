//! Where the wind has carried the clouds: what a document remembers of it when winds or the clock are changed.

use std::collections::BTreeMap;

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
