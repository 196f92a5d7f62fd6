//! Changes of the scene by JSON patches (RFC 6902).

use json_patch::{Patch, PatchErrorKind, PatchOperation};
use serde_json::Value;
use skycell_protocol::ValueError;
use skycell_protocol::read_json::{ObjectReader, ReadJson};

use super::ScenePatchError;

/// How many operations a patch may have.
pub const OPERATIONS_MAX: usize = 256;

/// How long a document may become on the way, as JSON text: `copy` could double it with every operation. The longest scene,
/// with 32 animations of 64 keyframes, has 130 kB.
const DOCUMENT_MAX_BYTES: usize = 256 * 1024;

/// A JSON patch of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneJsonPatch {
    operations: Vec<PatchOperation>,
}

impl SceneJsonPatch {
    /// Reads a patch.
    ///
    /// # Errors
    /// Names the operation that is none, or how many there are.
    pub fn from_json(patch: &Value) -> Result<Self, ValueError> {
        let items: Vec<Value> = Vec::read_json(patch, "")?;
        if items.len() > OPERATIONS_MAX {
            return Err(ValueError::new(
                "",
                &Value::from(format!("{} operations", items.len())),
                format!("0 to {OPERATIONS_MAX} operations"),
            ));
        }
        let operations = items
            .iter()
            .enumerate()
            .map(|(index, item)| read_operation(item, &format!("/{index}")))
            .collect::<Result<_, _>>()?;
        Ok(Self { operations })
    }

    /// Whether it says itself where clouds are.
    pub(super) fn says_where_clouds_are(&self) -> bool {
        self.operations.iter().any(|operation| match operation {
            PatchOperation::Add(add) if add.path.is_root() => add.value.get("drift").is_some(),
            PatchOperation::Replace(replace) if replace.path.is_root() => {
                replace.value.get("drift").is_some()
            }
            PatchOperation::Test(_) => false,
            other => other.path().as_str().starts_with("/drift"),
        })
    }

    /// Makes the changes, each after the one before.
    ///
    /// # Errors
    /// If an operation does not fit the document that those before it have made; the document is then of no use.
    pub fn apply_to(&self, document: &mut Value) -> Result<(), ScenePatchError> {
        let mut bytes = length_of(document);
        for (index, operation) in self.operations.iter().enumerate() {
            bytes += match operation {
                PatchOperation::Copy(copy) => {
                    document.pointer(copy.from.as_str()).map_or(0, length_of)
                }
                PatchOperation::Add(add) => length_of(&add.value),
                PatchOperation::Replace(replace) => length_of(&replace.value),
                _ => 0,
            };
            if bytes > DOCUMENT_MAX_BYTES {
                return Err(ScenePatchError::Invalid(ValueError::new(
                    format!("/{index}"),
                    &Value::from(format!("{bytes} bytes")),
                    format!("a document of at most {DOCUMENT_MAX_BYTES} bytes"),
                )));
            }
            json_patch::patch(document, std::slice::from_ref(operation))
                .map_err(|error| conflict(index, operation, &error.kind, document))?;
        }
        Ok(())
    }
}

/// One operation: the library's own errors would not name it.
fn read_operation(item: &Value, pointer: &str) -> Result<PatchOperation, ValueError> {
    ObjectReader::new(item, pointer)?;
    let patch = serde_json::from_value::<Patch>(Value::Array(vec![item.clone()]));
    patch
        .ok()
        .and_then(|Patch(mut operations)| operations.pop())
        .ok_or_else(|| {
            ValueError::new(
                pointer,
                item,
                "an operation of RFC 6902: op (add, remove, replace, move, copy or test), path, and value or from as the \
                 operation needs it; path and from are JSON pointers",
            )
        })
}

fn length_of(value: &Value) -> usize {
    // Values without cycles and with string keys can be written.
    serde_json::to_vec(value).map_or(usize::MAX / 4, |text| text.len())
}

/// The scene is not as the operation expects it.
fn conflict(
    index: usize,
    operation: &PatchOperation,
    kind: &PatchErrorKind,
    document: &Value,
) -> ScenePatchError {
    let path = operation.path().as_str();
    let there = document.pointer(path);
    let error = match kind {
        PatchErrorKind::TestFailed => ValueError::new(
            path,
            there.unwrap_or(&Value::Null),
            match operation {
                PatchOperation::Test(test) => {
                    format!("{}, which operation {index} tests for", test.value)
                }
                _ => format!("what operation {index} tests for"),
            },
        ),
        PatchErrorKind::InvalidFromPointer => {
            let from = match operation {
                PatchOperation::Copy(copy) => copy.from.as_str(),
                PatchOperation::Move(moved) => moved.from.as_str(),
                _ => path,
            };
            ValueError::missing(from, format!("a value for operation {index}"))
        }
        PatchErrorKind::CannotMoveInsideItself => ValueError::new(
            path,
            &Value::from(path),
            format!("a path that does not lie in what operation {index} moves"),
        ),
        _ => ValueError::missing(
            path,
            format!(
                "a place that operation {index} can change: its parent has to be there, and an index in range"
            ),
        ),
    };
    ScenePatchError::Conflict(error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn applied(patch: Value, document: Value) -> Result<Value, ScenePatchError> {
        let mut document = document;
        SceneJsonPatch::from_json(&patch)?.apply_to(&mut document)?;
        Ok(document)
    }

    #[test]
    fn operations_follow_each_other() {
        let patch = json!([
            {"op": "test", "path": "/a", "value": 1},
            {"op": "replace", "path": "/a", "value": 2},
            {"op": "add", "path": "/b/-", "value": 3},
            {"op": "copy", "from": "/a", "path": "/c"},
        ]);
        assert_eq!(
            applied(patch, json!({"a": 1, "b": []})).ok(),
            Some(json!({"a": 2, "b": [3], "c": 2}))
        );
    }

    #[test]
    fn a_test_that_fails_and_a_path_that_leads_nowhere_are_conflicts_with_their_pointer() {
        for (patch, pointer) in [
            (json!([{"op": "test", "path": "/a", "value": 2}]), "/a"),
            (json!([{"op": "remove", "path": "/x"}]), "/x"),
            (
                json!([{"op": "replace", "path": "/x/y", "value": 1}]),
                "/x/y",
            ),
            (json!([{"op": "copy", "from": "/x", "path": "/a"}]), "/x"),
            (json!([{"op": "add", "path": "/b/7", "value": 1}]), "/b/7"),
        ] {
            match applied(patch.clone(), json!({"a": 1, "b": []})) {
                Err(ScenePatchError::Conflict(error)) => {
                    assert_eq!(error.pointer, pointer, "{error}")
                }
                other => panic!("{patch}: {other:?}"),
            }
        }
    }

    #[test]
    fn what_is_no_operation_is_named() {
        for (patch, pointer) in [
            (json!({}), ""),
            (json!([1]), "/0"),
            (
                json!([{"op": "test", "path": "/a", "value": 1}, {"op": "grow", "path": "/a"}]),
                "/1",
            ),
            (json!([{"op": "add", "path": "/a"}]), "/0"),
            (json!([{"op": "add", "path": "a", "value": 1}]), "/0"),
            (
                json!(vec![
                    json!({"op": "remove", "path": "/a"});
                    OPERATIONS_MAX + 1
                ]),
                "",
            ),
        ] {
            let error = SceneJsonPatch::from_json(&patch).expect_err("no patch");
            assert_eq!(error.pointer, pointer, "{error}");
        }
    }

    #[test]
    fn a_document_that_doubles_with_every_operation_is_stopped() {
        let double: Vec<Value> = (0..64)
            .map(|index| json!({"op": "copy", "from": "", "path": format!("/{index}")}))
            .collect();
        match applied(double.into(), json!({"a": "b".repeat(1000)})) {
            Err(ScenePatchError::Invalid(error)) => {
                assert!(error.allowed.contains("bytes"), "{error}")
            }
            other => panic!("{other:?}"),
        }
    }
}
