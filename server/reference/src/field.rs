//! The data that densities read, as plain values.

use crate::{ByteMap, ByteVolume};

/// What weather layers share: the noise that carves clouds and the vertical profile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Noise {
    /// Bodies of clouds; channels billowy and wispy.
    pub shape: ByteVolume,
    /// What frays their edges; channels billowy and wispy.
    pub detail: ByteVolume,
    /// How much of its coverage a cloud keeps: height along a row, types down the rows.
    pub profile: ByteMap,
}

/// Maps of one weather layer; they repeat after the layer's map span.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WeatherMaps {
    /// Coverage before the layer's own setting.
    pub coverage: ByteMap,
    /// Type before the layer's own setting.
    pub cloud_type: ByteMap,
    /// Distance to the nearest possible cloud; 1 is a quarter of the span. Zero everywhere is always right.
    pub skip: ByteMap,
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
