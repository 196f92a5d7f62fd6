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

/// What one layer of the scene reads.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum LayerField {
    /// Nothing: a homogeneous layer.
    #[default]
    Nothing,
    /// Weather maps.
    Weather(WeatherMaps),
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
