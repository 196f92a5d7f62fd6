//! Numbers of the document that change with sky time.

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use crate::ValueError;
use crate::read_json::{ReadJson, document, read_name};
use crate::scene::ranges;
use crate::schema;

document! {
    /// One number of the document that changes with sky time.
    #[schemars(transform = schema::must_have(&["path", "keyframes"]))]
    pub struct AnimationDocument {
        /// JSON pointer of the number, such as `/layers/0/density/coverage`.
        "path" => path: String = String::new(),
        /// What it is when, in the order of time. Before the first it is the first's value, after the last the last's.
        #[schemars(length(min = 1, max = ranges::KEYFRAMES_MAX))]
        "keyframes" => keyframes: Vec<KeyframeDocument> = Vec::new(),
        /// What follows the last keyframe.
        "repeat" => repeat: Repeat = Repeat::None,
    }
}

document! {
    /// The value of a number at a sky time.
    pub struct KeyframeDocument {
        /// Sky time, s.
        "at_s" => at_s: f64 = 0.0; ranges::SKY_TIME_S,
        /// The number's value then.
        "value" => value: f64 = 0.0,
        /// How it goes from here to the next keyframe.
        "ease" => ease: Ease = Ease::Linear,
    }
}

/// What follows the last keyframe of an animation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Repeat {
    /// The number stays.
    #[default]
    None,
    /// The first keyframe, which has the same value. It was so before the first keyframe, too.
    Loop,
    /// The same keyframes backwards, and so on.
    PingPong,
}

impl ReadJson for Repeat {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let names = [
            ("none", Self::None),
            ("loop", Self::Loop),
            ("ping-pong", Self::PingPong),
        ];
        read_name(value, pointer, &names)
    }
}

/// How a number goes from one value to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Ease {
    /// Evenly.
    #[default]
    Linear,
    /// Slowly at both ends: 3 x² − 2 x³.
    Smooth,
}

impl Ease {
    /// Share of the way after a share of the time, both 0 to 1.
    pub fn of(self, share: f64) -> f64 {
        let x = share.clamp(0.0, 1.0);
        match self {
            Self::Linear => x,
            Self::Smooth => x * x * (3.0 - 2.0 * x),
        }
    }
}

impl ReadJson for Ease {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let names = [("linear", Self::Linear), ("smooth", Self::Smooth)];
        read_name(value, pointer, &names)
    }
}

/// A coverage, an extinction per metre or an optical depth of which nothing is seen.
const UNSEEN: f64 = 1e-9;

#[derive(Clone, Copy, Debug, PartialEq)]
struct Keyframe {
    at_s: f64,
    value: f64,
    ease: Ease,
}

/// A number that changes with sky time. Which number, and whether it may, only the whole document can tell.
#[derive(Clone, Debug, PartialEq)]
pub struct Animation {
    path: String,
    /// At least one, each later than the one before.
    keyframes: Vec<Keyframe>,
    repeat: Repeat,
}

impl Animation {
    /// JSON pointer of the number.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Values of the keyframes, in order.
    pub(super) fn values(&self) -> impl Iterator<Item = f64> {
        self.keyframes.iter().map(|keyframe| keyframe.value)
    }

    /// The number at a sky time. Continuous in time.
    pub fn value_at(&self, sky_s: f64) -> f64 {
        let (first, last) = (self.keyframes[0], self.keyframes[self.keyframes.len() - 1]);
        let span_s = last.at_s - first.at_s;
        let since_s = sky_s - first.at_s;
        let at_s = match self.repeat {
            _ if span_s <= 0.0 => first.at_s,
            Repeat::None => sky_s,
            Repeat::Loop => first.at_s + since_s.rem_euclid(span_s),
            Repeat::PingPong => {
                first.at_s + (span_s - (since_s.rem_euclid(2.0 * span_s) - span_s).abs())
            }
        };
        // The first keyframe that is later.
        let next = self
            .keyframes
            .partition_point(|keyframe| keyframe.at_s <= at_s);
        match (next.checked_sub(1), self.keyframes.get(next)) {
            (None, _) => first.value,
            (Some(_), None) => last.value,
            (Some(before), Some(after)) => {
                let before = self.keyframes[before];
                let share = (at_s - before.at_s) / (after.at_s - before.at_s);
                before.value + (after.value - before.value) * before.ease.of(share)
            }
        }
    }

    /// The number to show: a layer whose cover comes or goes keeps its place among the layers while it is at nothing, with
    /// so little of it that nobody sees it.
    pub(super) fn shown_at(&self, sky_s: f64, rate: f64) -> f64 {
        let value = self.value_at(sky_s);
        let is_cover = ["/coverage", "/extinction_per_m", "/optical_depth"]
            .iter()
            .any(|end| self.path.ends_with(end));
        if value == 0.0 && is_cover && self.moves_after(sky_s, rate) {
            UNSEEN
        } else {
            value
        }
    }

    /// Whether the number can differ from what it is at a sky time while time goes on in the direction of `rate`.
    pub(super) fn moves_after(&self, sky_s: f64, rate: f64) -> bool {
        let (first, last) = (self.keyframes[0], self.keyframes[self.keyframes.len() - 1]);
        let ahead = match self.repeat {
            Repeat::None if rate > 0.0 => sky_s < last.at_s,
            Repeat::None => sky_s > first.at_s,
            Repeat::Loop | Repeat::PingPong => true,
        };
        ahead && self.values().any(|value| value != first.value)
    }
}

impl TryFrom<AnimationDocument> for Animation {
    type Error = ValueError;

    fn try_from(document: AnimationDocument) -> Result<Self, ValueError> {
        let count = document.keyframes.len();
        if count == 0 || count > ranges::KEYFRAMES_MAX {
            return Err(ValueError::new(
                "/keyframes",
                &Value::from(format!("{count} keyframes")),
                format!("1 to {} keyframes", ranges::KEYFRAMES_MAX),
            ));
        }
        let mut keyframes: Vec<Keyframe> = Vec::with_capacity(count);
        for (index, keyframe) in document.keyframes.iter().enumerate() {
            let pointer = format!("/keyframes/{index}/at_s");
            let at_s = ranges::SKY_TIME_S.check(&pointer, keyframe.at_s)?;
            if let Some(before) = keyframes.last()
                && at_s <= before.at_s
            {
                return Err(ValueError::of_number(
                    pointer,
                    at_s,
                    format!("more than {}, the time of the keyframe before", before.at_s),
                ));
            }
            keyframes.push(Keyframe {
                at_s,
                value: keyframe.value,
                ease: keyframe.ease,
            });
        }
        let (first, last) = (keyframes[0].value, keyframes[count - 1].value);
        if document.repeat == Repeat::Loop && first != last {
            return Err(ValueError::of_number(
                format!("/keyframes/{}/value", count - 1),
                last,
                format!(
                    "{first}, the first keyframe's value, or \"repeat\": \"ping-pong\": a loop does not jump"
                ),
            ));
        }
        Ok(Self {
            path: document.path,
            keyframes,
            repeat: document.repeat,
        })
    }
}

impl From<&Animation> for AnimationDocument {
    fn from(animation: &Animation) -> Self {
        Self {
            path: animation.path.clone(),
            keyframes: animation
                .keyframes
                .iter()
                .map(|keyframe| KeyframeDocument {
                    at_s: keyframe.at_s,
                    value: keyframe.value,
                    ease: keyframe.ease,
                })
                .collect(),
            repeat: animation.repeat,
        }
    }
}
