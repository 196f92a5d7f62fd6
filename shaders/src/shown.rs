//! What a composite or an inspection is specialised to show.

/// What a kernel shows instead of the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Shown {
    /// The picture itself.
    #[default]
    Picture,
    /// A part of the light, by the composite.
    Single,
    /// A part of the light, by the composite.
    Multiple,
    /// A part of the light, by the composite.
    Ambient,
    /// The picture with an isotropic phase, by the composite.
    PhaseOff,
    /// By the composite.
    Transmittance,
    /// By the composite.
    Distance,
    /// Level of the cache's tile, by the composite.
    CacheMip,
    /// Age code of the cache's tile, by the composite.
    CacheAge,
    /// Samples of a ray, by the inspection.
    Steps,
    /// A quantity of the field, by the inspection.
    Field(Quantity, Seen),
}

/// A quantity of the cloud field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Quantity {
    /// Coverage of the map.
    Coverage,
    /// Type of the map.
    Type,
    /// Dimensional profile.
    Profile,
    /// Density.
    Density,
}

/// From where the field is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Seen {
    /// Along the rays of the eye.
    FromEye,
    /// Column by column from above.
    FromAbove,
    /// In a vertical section.
    Section,
}

impl Shown {
    /// Every view.
    pub fn all() -> impl Iterator<Item = Self> {
        use Quantity::{Coverage, Density, Profile, Type};
        let fields = [Coverage, Type, Profile, Density]
            .into_iter()
            .flat_map(|q| {
                [Seen::FromEye, Seen::FromAbove, Seen::Section].map(|seen| Self::Field(q, seen))
            });
        [
            Self::Picture,
            Self::Single,
            Self::Multiple,
            Self::Ambient,
            Self::PhaseOff,
            Self::Transmittance,
            Self::Distance,
            Self::CacheMip,
            Self::CacheAge,
            Self::Steps,
        ]
        .into_iter()
        .chain(fields)
    }

    /// Whether the inspection shows it; everything else the composite.
    #[must_use]
    pub fn is_inspection(self) -> bool {
        matches!(self, Self::Steps | Self::Field(..))
    }

    /// Whether it shows the cache's tables.
    #[must_use]
    pub fn is_of_cache(self) -> bool {
        matches!(self, Self::CacheMip | Self::CacheAge)
    }

    /// Names that are defined for the preprocessor.
    pub(crate) fn definitions(self) -> Vec<&'static str> {
        match self {
            Self::Picture => vec![],
            Self::Single => vec!["SHOW_PART", "SHOW_SINGLE"],
            Self::Multiple => vec!["SHOW_PART", "SHOW_MULTIPLE"],
            Self::Ambient => vec!["SHOW_PART", "SHOW_AMBIENT"],
            Self::PhaseOff => vec!["SHOW_PHASE_OFF"],
            Self::Transmittance => vec!["SHOW_VALUES", "SHOW_TRANSMITTANCE"],
            Self::Distance => vec!["SHOW_VALUES", "SHOW_DISTANCE"],
            Self::CacheMip => vec!["SHOW_VALUES", "SHOW_CACHE"],
            Self::CacheAge => vec!["SHOW_VALUES", "SHOW_CACHE", "SHOW_CACHE_AGE"],
            Self::Steps => vec!["SHOW_STEPS"],
            Self::Field(quantity, seen) => {
                let mut names = vec![match quantity {
                    Quantity::Coverage => "SHOW_COVERAGE",
                    Quantity::Type => "SHOW_TYPE",
                    Quantity::Profile => "SHOW_PROFILE",
                    Quantity::Density => "SHOW_DENSITY",
                }];
                match seen {
                    Seen::FromEye => {}
                    Seen::FromAbove => names.push("FROM_ABOVE"),
                    Seen::Section => names.push("SECTION"),
                }
                names
            }
        }
    }
}
