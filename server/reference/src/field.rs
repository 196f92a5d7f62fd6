//! The data that densities read, as plain values.

use crate::{ByteVolume, TexelMap};

/// What weather layers share: the noise that carves clouds.
#[derive(Clone, Debug, PartialEq)]
pub struct Noise {
    /// Bodies of clouds; channels billowy and wispy.
    pub shape: ByteVolume,
    /// What frays their edges; channels billowy and wispy.
    pub detail: ByteVolume,
}

/// Maps of one weather layer; but for the profile they repeat after the layer's map span.
#[derive(Clone, Debug, PartialEq)]
pub struct WeatherMaps {
    /// Coverage before the layer's own setting.
    pub coverage: TexelMap,
    /// Type before the layer's own setting.
    pub cloud_type: TexelMap,
    /// Distance to the nearest possible cloud; 1 is a quarter of the span. Zero everywhere is always right.
    pub skip: TexelMap,
    /// How much of its coverage a cloud keeps: height along a row, types down the rows.
    pub profile: TexelMap,
}

impl WeatherMaps {
    /// These maps when `share` of the way to others of the same sizes is gone: values linearly; of the skips the shorter
    /// one, because a mix of two coverages can hold cloud only where one of both can.
    #[must_use]
    pub fn blended(&self, to: &Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| (1.0 - share) * a + share * b;
        Self {
            coverage: self.coverage.zipped(&to.coverage, mix),
            cloud_type: self.cloud_type.zipped(&to.cloud_type, mix),
            skip: self.skip.zipped(&to.skip, f64::min),
            profile: self.profile.zipped(&to.profile, mix),
        }
    }

    /// The same values as a texture of fewer digits holds them; skips are held exactly.
    #[must_use]
    pub fn stored(&self, stored: impl Fn(f64) -> f64) -> Self {
        let keep = |map: &TexelMap| map.zipped(map, |value, _| stored(value));
        Self {
            coverage: keep(&self.coverage),
            cloud_type: keep(&self.cloud_type),
            skip: self.skip.clone(),
            profile: keep(&self.profile),
        }
    }
}

/// Maps of one thin sheet.
#[derive(Clone, Debug, PartialEq)]
pub struct SheetMaps {
    /// Patches before the layer's coverage; repeat after its map span.
    pub patches: TexelMap,
    /// Fibres; repeat after the fibres' period.
    pub fibres: TexelMap,
    /// The veil; repeats as the fibres do.
    pub veil: TexelMap,
}

/// What one layer of the scene reads.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum LayerField {
    /// Nothing: a homogeneous layer.
    #[default]
    Nothing,
    /// Weather maps.
    Weather(WeatherMaps),
    /// Maps of a thin sheet.
    Sheet(SheetMaps),
    /// Voxels, x fastest, then altitude, then z.
    Grid(Vec<f32>),
}

/// All data of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Field {
    /// Needed if any layer's density is `weather`.
    pub noise: Option<Noise>,
    /// One for each layer of the scene, in its order; missing ones count as nothing.
    pub layers: Vec<LayerField>,
}
