//! One sky that becomes another.

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde_json::Value;

use super::animation::Ease;
use crate::ValueError;
use crate::moment::Moment;
use crate::read_json::{ObjectReader, ReadJson, document};
use crate::scene::{Scene, SceneDocument, ranges};
use crate::schema;

document! {
    /// The sky comes from another one. By the clock on the wall, so that it goes on while sky time stands still.
    pub struct TransitionDocument {
        /// When it began.
        "began" => began: Moment = Moment::UNIX_EPOCH,
        /// How long it takes.
        "duration_s" => duration_s: f64 = 0.0; ranges::TRANSITION_S,
        /// The sky that it begins with: a scene without clock, animation and transition.
        "from" => from: Box<StillSceneDocument> = Box::default(),
    }
}

impl<T: ReadJson> ReadJson for Box<T> {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        T::read_json(value, pointer).map(Self::new)
    }
}

/// Keys of a scene that have to do with time.
pub(in crate::scene) const TIMELINE_KEYS: [&str; 4] = ["time", "animation", "transition", "drift"];

/// A scene that stands still.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StillSceneDocument(pub SceneDocument);

impl serde::Serialize for StillSceneDocument {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        still_value(&self.0).serialize(serializer)
    }
}

impl JsonSchema for StillSceneDocument {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "StillScene".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let mut schema = SceneDocument::json_schema(generator);
        schema.insert("description".into(), "A scene that stands still.".into());
        schema::remove_properties(&mut schema, &TIMELINE_KEYS);
        schema
    }
}

impl ReadJson for StillSceneDocument {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, pointer)?;
        for key in TIMELINE_KEYS {
            if let Some(value) = members.optional::<Value>(key)? {
                let allowed = "nothing: what a transition comes from stands still";
                return Err(ValueError::new(members.pointer_of(key), &value, allowed));
            }
        }
        SceneDocument::from_json(value)
            .map(Self)
            .map_err(|error| error.under(pointer))
    }
}

/// A document as JSON without what has to do with time.
pub(super) fn still_value(document: &SceneDocument) -> Value {
    // Documents are plain data with string keys, which always can be written.
    let mut value = serde_json::to_value(document).unwrap_or_default();
    if let Value::Object(members) = &mut value {
        for key in TIMELINE_KEYS {
            members.remove(key);
        }
    }
    value
}

/// One sky that becomes another.
#[derive(Clone, Debug, PartialEq)]
pub struct Transition {
    began: Moment,
    duration_s: f64,
    from: Box<Scene>,
}

impl Transition {
    /// The sky that it begins with.
    pub(super) fn from(&self) -> &Scene {
        &self.from
    }

    /// When the other sky is there.
    pub fn ends(&self) -> Moment {
        self.began.plus_s(self.duration_s)
    }

    /// Share of the other sky at a moment, 0 to 1: slow at both ends.
    pub fn share(&self, now: Moment) -> f64 {
        if now >= self.ends() {
            return 1.0;
        }
        Ease::Smooth.of(now.seconds_since(self.began) / self.duration_s)
    }

    /// Seconds of the other sky's wind, of those from the beginning until a moment: the integral of [`Self::share`].
    pub(super) fn share_s(&self, until: Moment) -> f64 {
        let since_s = until.seconds_since(self.began);
        if since_s <= 0.0 {
            return 0.0;
        }
        if since_s >= self.duration_s {
            return since_s - 0.5 * self.duration_s;
        }
        let x = since_s / self.duration_s;
        self.duration_s * x * x * x * (1.0 - 0.5 * x)
    }
}

impl TryFrom<TransitionDocument> for Transition {
    type Error = ValueError;

    fn try_from(document: TransitionDocument) -> Result<Self, ValueError> {
        Ok(Self {
            began: document.began,
            duration_s: ranges::TRANSITION_S.check("/duration_s", document.duration_s)?,
            from: Box::new(Scene::try_from(document.from.0).map_err(|e| e.under("/from"))?),
        })
    }
}

impl From<&Transition> for TransitionDocument {
    fn from(transition: &Transition) -> Self {
        Self {
            began: transition.began,
            duration_s: transition.duration_s,
            from: Box::new(StillSceneDocument(transition.from.to_document())),
        }
    }
}
