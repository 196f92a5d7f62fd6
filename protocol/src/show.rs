//! What frames show: the picture, or one quantity of it for whoever wants to know why it looks as it does.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::read_json::{ReadJson, read_name};
use crate::{Codec, ValueError};

/// What a viewer's frames show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Show {
    /// The sky.
    #[default]
    Picture,
    /// Light that clouds have scattered once, over black.
    Single,
    /// Light that clouds have scattered more than once (octaves from the second on), over black.
    Multiple,
    /// Light of sky and ground that clouds have scattered, over black.
    Ambient,
    /// The sky with an isotropic phase for what is scattered once.
    PhaseOff,
    /// How much of what is behind them the clouds let through.
    Transmittance,
    /// Mean distance of the cloud that is seen.
    Distance,
    /// Halvings of the cache's resolution below the finest level of the picture.
    CacheMip,
    /// Time since the cache was marched here.
    CacheAge,
    /// Samples that a ray of the screen-space renderer takes in all layers.
    Steps,
    /// Coverage, the largest along the ray.
    Coverage,
    /// Type where the dimensional profile is largest along the ray.
    Type,
    /// Dimensional profile, the largest along the ray.
    Profile,
    /// Density, the largest along the ray.
    Density,
    /// Coverage seen from above: a map about the eye, north up.
    CoverageAbove,
    /// Type seen from above.
    TypeAbove,
    /// Dimensional profile seen from above: the largest of each column.
    ProfileAbove,
    /// Density seen from above: the largest of each column.
    DensityAbove,
    /// Dimensional profile in a vertical section ahead of the eye.
    ProfileSection,
    /// Density in a vertical section ahead of the eye.
    DensitySection,
}

/// How a view's values become colours, for a legend.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Scale {
    /// The value of the darkest colour.
    pub low: f64,
    /// The value of the lightest colour.
    pub high: f64,
    /// Unit of both; empty for shares and counts.
    pub unit: &'static str,
    /// Colours stand for equal ratios instead of equal differences.
    pub logarithmic: bool,
}

/// A view as a person is told of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct ShowReport {
    /// Name in messages and on the command line.
    pub name: &'static str,
    /// What it shows.
    pub label: &'static str,
    /// Its colours; null where colours are those of light.
    pub scale: Option<Scale>,
    /// It shows the cache and says nothing of frames that are made by rays of their own.
    pub cached_only: bool,
}

const fn linear(low: f64, high: f64, unit: &'static str) -> Option<Scale> {
    Some(Scale {
        low,
        high,
        unit,
        logarithmic: false,
    })
}

const fn logarithmic(low: f64, high: f64, unit: &'static str) -> Option<Scale> {
    Some(Scale {
        low,
        high,
        unit,
        logarithmic: true,
    })
}

/// Distance of the near end of the colours of [`Show::Distance`], m.
pub const DISTANCE_LOW_M: f64 = 500.0;
/// And of the far end.
pub const DISTANCE_HIGH_M: f64 = 200_000.0;
/// Age of the young end of the colours of [`Show::CacheAge`], s.
pub const AGE_LOW_S: f64 = 0.1;
/// And of the old end.
pub const AGE_HIGH_S: f64 = 3600.0;
/// Samples at the light end of the colours of [`Show::Steps`].
pub const STEPS_HIGH: f64 = 256.0;
/// Levels of the cache are shown up to this one.
pub const MIP_HIGH: f64 = 6.0;
/// Height of the ground that a view from above shows, and length of a section, m.
pub const MAP_EXTENT_M: f64 = 40_000.0;

impl Show {
    /// Every view with its name.
    pub const ALL: [(&'static str, Self); 20] = [
        ("picture", Self::Picture),
        ("single", Self::Single),
        ("multiple", Self::Multiple),
        ("ambient", Self::Ambient),
        ("phase-off", Self::PhaseOff),
        ("transmittance", Self::Transmittance),
        ("distance", Self::Distance),
        ("cache-mip", Self::CacheMip),
        ("cache-age", Self::CacheAge),
        ("steps", Self::Steps),
        ("coverage", Self::Coverage),
        ("type", Self::Type),
        ("profile", Self::Profile),
        ("density", Self::Density),
        ("coverage-above", Self::CoverageAbove),
        ("type-above", Self::TypeAbove),
        ("profile-above", Self::ProfileAbove),
        ("density-above", Self::DensityAbove),
        ("profile-section", Self::ProfileSection),
        ("density-section", Self::DensitySection),
    ];

    /// Its name in messages.
    pub fn name(self) -> &'static str {
        Self::ALL
            .iter()
            .find(|(_, show)| *show == self)
            .map_or("picture", |(name, _)| name)
    }

    /// The view of a name.
    ///
    /// # Errors
    /// Names what is allowed.
    pub fn from_name(name: &str) -> Result<Self, ValueError> {
        read_name(&Value::from(name), "/show", &Self::ALL)
    }

    /// What a person is told of it.
    pub fn report(self) -> ShowReport {
        let (label, scale) = match self {
            Self::Picture => ("the sky", None),
            Self::Single => ("light scattered once", None),
            Self::Multiple => ("light scattered more than once", None),
            Self::Ambient => ("light of sky and ground, scattered", None),
            Self::PhaseOff => ("the sky with an isotropic phase", None),
            Self::Transmittance => ("transmittance of the clouds", linear(0.0, 1.0, "")),
            Self::Distance => (
                "mean distance of cloud",
                logarithmic(DISTANCE_LOW_M * 1e-3, DISTANCE_HIGH_M * 1e-3, "km"),
            ),
            Self::CacheMip => (
                "level of the cache (each step up: twice as fine)",
                linear(0.0, MIP_HIGH, ""),
            ),
            Self::CacheAge => (
                "time since marched",
                logarithmic(AGE_LOW_S, AGE_HIGH_S, "s"),
            ),
            Self::Steps => ("samples of a ray", linear(0.0, STEPS_HIGH, "")),
            Self::Coverage => ("coverage, largest along the ray", linear(0.0, 1.0, "")),
            Self::Type => (
                "type, 0 stratus to 1 cumulus, along the ray",
                linear(0.0, 1.0, ""),
            ),
            Self::Profile => (
                "dimensional profile, largest along the ray",
                linear(0.0, 1.0, ""),
            ),
            Self::Density => ("density, largest along the ray", linear(0.0, 1.0, "")),
            Self::CoverageAbove => (
                "coverage from above, 40 km high, north up",
                linear(0.0, 1.0, ""),
            ),
            Self::TypeAbove => (
                "type from above, 40 km high, north up",
                linear(0.0, 1.0, ""),
            ),
            Self::ProfileAbove => (
                "dimensional profile from above, 40 km high, north up",
                linear(0.0, 1.0, ""),
            ),
            Self::DensityAbove => (
                "density from above, 40 km high, north up",
                linear(0.0, 1.0, ""),
            ),
            Self::ProfileSection => (
                "dimensional profile in a section of 40 km ahead, ground to the highest top",
                linear(0.0, 1.0, ""),
            ),
            Self::DensitySection => (
                "density in a section of 40 km ahead, ground to the highest top",
                linear(0.0, 1.0, ""),
            ),
        };
        ShowReport {
            name: self.name(),
            label,
            scale,
            cached_only: self.is_of_cache(),
        }
    }

    /// It, if frames of a codec can show it.
    ///
    /// # Errors
    /// Clouds alone are no picture of anything else.
    pub fn for_codec(self, codec: Codec) -> Result<Self, ValueError> {
        if codec == Codec::Clouds && self != Self::Picture {
            let allowed = "\"picture\" where codec is \"clouds\"";
            return Err(ValueError::new("/show", &Value::from(self.name()), allowed));
        }
        Ok(self)
    }

    /// Whether it shows the cache, and says nothing of frames that are made by rays of their own.
    pub fn is_of_cache(self) -> bool {
        matches!(self, Self::CacheMip | Self::CacheAge)
    }
}

impl ReadJson for Show {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &Self::ALL)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_view_is_read_by_its_name_and_another_name_is_refused_with_all_of_them() {
        for (name, show) in Show::ALL {
            assert_eq!(Show::from_name(name), Ok(show));
            assert_eq!(show.name(), name);
            assert_eq!(serde_json::to_value(show).ok(), Some(Value::from(name)));
        }
        let refused = Show::from_name("densty").expect_err("no view").to_string();
        assert!(
            refused.contains("\"density\"") && refused.contains("cache-mip"),
            "{refused}"
        );
    }
}
