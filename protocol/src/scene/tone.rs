//! How radiance becomes a picture: the curve, and exposure by the light that is there.

use schemars::JsonSchema;
use serde::{Serialize, Serializer};
use serde_json::Value;

use super::ranges;
use crate::ValueError;
use crate::read_json::{ReadJson, document, read_name};

/// From radiance to what a screen shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, JsonSchema)]
#[schemars(rename_all = "kebab-case")]
pub enum ToneCurve {
    /// K. Narkowicz's fit of the ACES reference transform, 2015, channel by channel.
    #[default]
    Aces,
    /// T. Sobotka's AgX, 2022, by B. Wrensch's fit, 2023, with its Punchy look: what is bright goes towards white and keeps its hue.
    Agx,
    /// Khronos PBR Neutral, 2024: colours as they are up to the shoulder, then towards white.
    Neutral,
}

impl ToneCurve {
    /// Every curve with its name.
    pub const ALL: [(&'static str, Self); 3] = [
        ("aces", Self::Aces),
        ("agx", Self::Agx),
        ("neutral", Self::Neutral),
    ];

    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Aces => "aces",
            Self::Agx => "agx",
            Self::Neutral => "neutral",
        }
    }
}

impl Serialize for ToneCurve {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl ReadJson for ToneCurve {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &Self::ALL)
    }
}

document! {
    /// How radiance becomes a picture.
    pub struct ToneDocument {
        /// The curve: "aces", "agx" or "neutral".
        "curve" => curve: ToneCurve = ToneCurve::Aces,
        /// Exposure by the light of the sky, on top of `exposure_ev`; null: by hand alone.
        "auto_exposure" => auto_exposure: Option<AutoExposureDocument> = None,
    }
}

document! {
    /// Exposure by the light of the sky.
    pub struct AutoExposureDocument {
        /// Least exposure, in stops beside that of the default noon.
        "min_ev" => min_ev: f64 = -4.0; ranges::EXPOSURE_EV,
        /// Most exposure.
        "max_ev" => max_ev: f64 = 8.0; ranges::EXPOSURE_EV,
        /// Time in which two thirds of a change are followed.
        "adaptation_s" => adaptation_s: f64 = 1.0; ranges::ADAPTATION_S,
    }
}

/// How radiance becomes a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToneMapping {
    curve: ToneCurve,
    auto_exposure: Option<AutoExposure>,
}

/// Exposure by the light of the sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AutoExposure {
    min_ev: f64,
    max_ev: f64,
    adaptation_s: f64,
}

impl ToneMapping {
    /// The curve.
    pub fn curve(&self) -> ToneCurve {
        self.curve
    }

    /// Exposure by the light of the sky; none: by hand alone.
    pub fn auto_exposure(&self) -> Option<AutoExposure> {
        self.auto_exposure
    }
}

impl AutoExposure {
    /// Least exposure, stops.
    pub fn min_ev(&self) -> f64 {
        self.min_ev
    }

    /// Most exposure, stops; not less than the least.
    pub fn max_ev(&self) -> f64 {
        self.max_ev
    }

    /// Time in which two thirds of a change are followed.
    pub fn adaptation_s(&self) -> f64 {
        self.adaptation_s
    }
}

impl TryFrom<ToneDocument> for ToneMapping {
    type Error = ValueError;

    fn try_from(document: ToneDocument) -> Result<Self, ValueError> {
        let auto_exposure = document.auto_exposure.map(AutoExposure::try_from);
        Ok(Self {
            curve: document.curve,
            auto_exposure: auto_exposure
                .transpose()
                .map_err(|error| error.under("/auto_exposure"))?,
        })
    }
}

impl TryFrom<AutoExposureDocument> for AutoExposure {
    type Error = ValueError;

    fn try_from(document: AutoExposureDocument) -> Result<Self, ValueError> {
        let min_ev = ranges::EXPOSURE_EV.check("/min_ev", document.min_ev)?;
        let max_ev = ranges::EXPOSURE_EV.check("/max_ev", document.max_ev)?;
        if max_ev < min_ev {
            return Err(ValueError::new(
                "/max_ev",
                &Value::from(max_ev),
                format!("{min_ev} (min_ev) or more"),
            ));
        }
        Ok(Self {
            min_ev,
            max_ev,
            adaptation_s: ranges::ADAPTATION_S.check("/adaptation_s", document.adaptation_s)?,
        })
    }
}

impl From<&ToneMapping> for ToneDocument {
    fn from(tone: &ToneMapping) -> Self {
        Self {
            curve: tone.curve,
            auto_exposure: tone.auto_exposure.map(|auto| AutoExposureDocument {
                min_ev: auto.min_ev,
                max_ev: auto.max_ev,
                adaptation_s: auto.adaptation_s,
            }),
        }
    }
}
