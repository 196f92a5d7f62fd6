//! Families of clouds: what a layer is like where the document does not say otherwise.
//!
//! Altitudes are those of temperate latitudes in the International Cloud Atlas (WMO-No. 407, 2017). Everything else is tuned
//! by eye against photographs (`skycell-server render --scene`), extinctions among it: real water clouds of these kinds have
//! 0.01 to 0.1 per metre.

use schemars::{JsonSchema, Schema};
use serde::Serialize;
use serde_json::{Value, json};

use super::document::{
    CirrusDocument, DensityDocument, LayerDocument, PhaseDocument, WeatherDocument,
};
use crate::ValueError;
use crate::read_json::{ReadJson, read_name};

/// A family of clouds, by its name in the International Cloud Atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Family {
    /// A low, featureless sheet.
    Stratus,
    /// Low rolls and patches.
    Stratocumulus,
    /// Heaps with flat bases.
    Cumulus,
    /// Towers with anvils.
    Cumulonimbus,
    /// Ripples and cells at middle heights.
    Altocumulus,
    /// A veil at middle heights through which the sun is dim.
    Altostratus,
    /// Fibres of ice.
    Cirrus,
    /// A veil of ice.
    Cirrostratus,
}

impl Family {
    /// Every family.
    pub const ALL: [Self; 8] = [
        Self::Stratus,
        Self::Stratocumulus,
        Self::Cumulus,
        Self::Cumulonimbus,
        Self::Altocumulus,
        Self::Altostratus,
        Self::Cirrus,
        Self::Cirrostratus,
    ];

    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stratus => "stratus",
            Self::Stratocumulus => "stratocumulus",
            Self::Cumulus => "cumulus",
            Self::Cumulonimbus => "cumulonimbus",
            Self::Altocumulus => "altocumulus",
            Self::Altostratus => "altostratus",
            Self::Cirrus => "cirrus",
            Self::Cirrostratus => "cirrostratus",
        }
    }

    /// The schema of a layer: where the family is one of ice, a density that says nothing of its model would be a sheet of
    /// ice, and the schema of a density takes one without a model for weather. So there it has to be told; the reader takes it
    /// either way.
    pub(super) fn model_of_density_is_told(layer: &mut Schema) {
        let of_ice = Self::ALL
            .into_iter()
            .filter(|family| !matches!(family.layer().density, DensityDocument::Weather(_)))
            .map(Self::name)
            .collect::<Vec<_>>();
        layer.insert(
            "if".into(),
            json!({"properties": {"family": {"enum": of_ice}}, "required": ["family"]}),
        );
        layer.insert(
            "then".into(),
            json!({"properties": {"density": {"required": ["model"]}}}),
        );
    }

    /// A layer of the family: what stands for the keys that a layer of this family leaves out. The name is the family's.
    #[must_use]
    pub fn layer(self) -> LayerDocument {
        let plain = WeatherDocument::default;
        let (altitudes_m, extinction_per_m, density) = match self {
            Self::Stratus => (
                [300.0, 1_800.0],
                0.03,
                DensityDocument::Weather(WeatherDocument {
                    pattern: WeatherPattern::Veils,
                    coverage: 0.97,
                    cloud_type: 0.0,
                    detail_strength: 0.1,
                    ..plain()
                }),
            ),
            Self::Stratocumulus => (
                [1_200.0, 2_000.0],
                0.04,
                DensityDocument::Weather(WeatherDocument {
                    pattern: WeatherPattern::Rolls,
                    coverage: 0.72,
                    cloud_type: 0.333,
                    map_span_m: 28_000.0,
                    shape_period_m: 2_400.0,
                    detail_strength: 0.3,
                    ..plain()
                }),
            ),
            Self::Cumulus => (
                [1_200.0, 3_700.0],
                0.05,
                DensityDocument::Weather(WeatherDocument {
                    cloud_type: 0.5,
                    shape_period_m: 2_600.0,
                    ..plain()
                }),
            ),
            Self::Cumulonimbus => (
                [800.0, 11_000.0],
                0.05,
                DensityDocument::Weather(WeatherDocument {
                    coverage: 0.3,
                    cloud_type: 1.0,
                    map_span_m: 200_000.0,
                    shape_period_m: 14_000.0,
                    detail_period_m: 1_500.0,
                    detail_strength: 0.2,
                    ..plain()
                }),
            ),
            Self::Altocumulus => (
                [4_200.0, 4_800.0],
                0.02,
                DensityDocument::Weather(WeatherDocument {
                    profile: WeatherProfile::High,
                    pattern: WeatherPattern::Ripples,
                    coverage: 0.45,
                    cloud_type: 1.0,
                    map_span_m: 30_000.0,
                    shape_period_m: 2_600.0,
                    detail_period_m: 300.0,
                    detail_strength: 0.4,
                    ..plain()
                }),
            ),
            Self::Altostratus => (
                [4_000.0, 5_800.0],
                0.006,
                DensityDocument::Weather(WeatherDocument {
                    profile: WeatherProfile::High,
                    pattern: WeatherPattern::Veils,
                    coverage: 0.97,
                    cloud_type: 0.0,
                    map_span_m: 60_000.0,
                    detail_strength: 0.1,
                    ..plain()
                }),
            ),
            Self::Cirrus => (
                [9_000.0, 9_300.0],
                0.0,
                DensityDocument::Cirrus(CirrusDocument::default()),
            ),
            Self::Cirrostratus => (
                [8_500.0, 9_300.0],
                0.0,
                DensityDocument::Cirrus(CirrusDocument {
                    coverage: 0.95,
                    cloud_type: 0.1,
                    optical_depth: 0.25,
                    ..CirrusDocument::default()
                }),
            ),
        };
        let is_ice = matches!(self, Self::Cirrus | Self::Cirrostratus);
        let plain = LayerDocument::default();
        LayerDocument {
            family: Some(self),
            name: self.name().to_owned(),
            base_altitude_m: altitudes_m[0],
            top_altitude_m: altitudes_m[1],
            extinction_per_m: if is_ice {
                plain.extinction_per_m
            } else {
                extinction_per_m
            },
            density,
            phase: is_ice.then_some(PhaseDocument::Ice),
            ..plain
        }
    }
}

impl ReadJson for Family {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(
            value,
            pointer,
            &Self::ALL.map(|family| (family.name(), family)),
        )
    }
}

/// Which vertical profiles a weather layer's `type` walks through.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum WeatherProfile {
    /// 0 stratus, 1/3 stratocumulus, 1/2 small cumulus, 2/3 cumulus, 1 cumulonimbus.
    Low,
    /// 0 altostratus, 1 altocumulus.
    High,
}

impl ReadJson for WeatherProfile {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &[("low", Self::Low), ("high", Self::High)])
    }
}

/// What a weather layer's coverage map looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum WeatherPattern {
    /// Heaps of several sizes, gathered.
    Puffs,
    /// Broad rolls that break into patches.
    Rolls,
    /// Small cells in rows, in fields with gaps between.
    Ripples,
    /// Broad and smooth.
    Veils,
}

impl WeatherPattern {
    /// Its name in documents and file names.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Puffs => "puffs",
            Self::Rolls => "rolls",
            Self::Ripples => "ripples",
            Self::Veils => "veils",
        }
    }
}

impl ReadJson for WeatherPattern {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let names = [Self::Puffs, Self::Rolls, Self::Ripples, Self::Veils];
        read_name(
            value,
            pointer,
            &names.map(|pattern| (pattern.name(), pattern)),
        )
    }
}

/// How noise carves a weather layer's clouds: the numbers of `carved_density` that differ between families.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudForm {
    /// Shape noise is squeezed into floor … floor + range: less range, smoother clouds.
    pub shape_floor: f64,
    /// See `shape_floor`.
    pub shape_range: f64,
    /// How steeply density rises from a cloud's surface inwards.
    pub steepness: f64,
    /// How much of the local type hangs on the local coverage: heaps are flat at their rims and tall in their middles. Above 1
    /// rims taper to the flattest type before the coverage ends.
    pub dome: f64,
    /// Share of wispy noise above the base, 0…1.
    pub wispiness: f64,
    /// Share of the type map in the local type, 0…1: how much neighbours differ in height.
    pub type_spread: f64,
}

impl CloudForm {
    /// The form of a type of a profile. Tuned by eye against photographs of each family.
    #[must_use]
    pub fn of(profile: WeatherProfile, cloud_type: f64) -> Self {
        let knots: &[(f64, [f64; 6])] = match profile {
            WeatherProfile::Low => &LOW_FORMS,
            WeatherProfile::High => &HIGH_FORMS,
        };
        let last = knots.len() - 1;
        let above = knots
            .iter()
            .position(|(at, _)| cloud_type < *at)
            .unwrap_or(last)
            .max(1);
        let ((from, low), (to, high)) = (knots[above - 1], knots[above]);
        let share = ((cloud_type - from) / (to - from)).clamp(0.0, 1.0);
        let [
            shape_range,
            steepness,
            dome,
            wispiness,
            type_spread,
            threshold,
        ] = std::array::from_fn(|k| low[k] + share * (high[k] - low[k]));
        Self {
            shape_floor: 1.0 - threshold - 0.5 * shape_range,
            shape_range,
            steepness,
            dome,
            wispiness,
            type_spread,
        }
    }
}

/// Forms of profile `low` at some types: range, steepness, dome, wispiness, spread of the type, and the mean threshold that
/// shape noise sets, in dimensional profile.
///
/// Small heaps are all outline: much noise, and rims that taper to nothing. Towers with anvils have a low threshold, so that
/// their anvil, which keeps its whole coverage, reaches far beyond the column, which keeps less than half.
const LOW_FORMS: [(f64, [f64; 6]); 6] = [
    (0.0, [0.25, 3.0, 0.0, 0.8, 0.45, 0.36]),
    (1.0 / 3.0, [0.5, 5.0, 0.6, 0.3, 0.45, 0.36]),
    (0.5, [0.7, 4.0, 1.2, 0.0, 0.45, 0.42]),
    (2.0 / 3.0, [0.5, 9.0, 1.2, 0.0, 0.45, 0.39]),
    (0.8, [0.42, 8.5, 0.8, 0.0, 0.45, 0.37]),
    (1.0, [0.22, 8.0, 0.15, 0.0, 0.05, 0.17]),
];

/// As [`LOW_FORMS`], of profile `high`.
const HIGH_FORMS: [(f64, [f64; 6]); 2] = [
    (0.0, [0.3, 2.0, 0.0, 1.0, 0.45, 0.36]),
    (1.0, [0.5, 4.0, 0.5, 0.3, 0.45, 0.36]),
];
