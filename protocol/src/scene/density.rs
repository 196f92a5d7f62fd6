//! How a layer's density comes about: what stands in the place of a cloud.

use glam::DVec3;
use serde_json::Value;

use super::document::{
    BoxDocument, CirrusDocument, DensityDocument, GridDocument, HomogeneousDocument, ShapeDocument,
    SphereDocument, WeatherDocument,
};
use super::family::{CloudForm, WeatherPattern, WeatherProfile};
use super::maps::{MapFiles, checked_file_name};
use super::ranges;
use crate::ValueError;
use crate::number_range::NumberRange;

/// How a layer's density comes about. Places are x (east), altitude, z (south) at sky time 0, in metres.
#[derive(Clone, Debug, PartialEq)]
pub enum DensityModel {
    /// Weather maps and noise.
    Weather(WeatherDensity),
    /// Density 1 everywhere in a shape.
    Homogeneous(Shape),
    /// Voxels.
    Grid(GridDensity),
    /// A thin sheet of ice.
    Cirrus(CirrusDensity),
}

impl DensityModel {
    /// The box outside which density is 0, where the model has one.
    pub fn bounds_m(&self) -> Option<[DVec3; 2]> {
        match self {
            Self::Weather(_) | Self::Cirrus(_) | Self::Homogeneous(Shape::Layer) => None,
            Self::Homogeneous(Shape::Box { center_m, size_m }) => {
                Some([*center_m - 0.5 * *size_m, *center_m + 0.5 * *size_m])
            }
            Self::Homogeneous(Shape::Sphere { center_m, radius_m }) => {
                Some([*center_m - *radius_m, *center_m + *radius_m])
            }
            Self::Grid(grid) => Some([grid.bounds_min_m, grid.bounds_max_m]),
        }
    }
}

/// What a homogeneous layer fills between its altitudes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// All of it.
    Layer,
    /// A box along the axes.
    Box {
        /// Its middle.
        center_m: DVec3,
        /// Its edges.
        size_m: DVec3,
    },
    /// A ball.
    Sphere {
        /// Its middle.
        center_m: DVec3,
        /// Its radius.
        radius_m: f64,
    },
}

/// Density from voxels. Voxel (i, j, k) stands at index i + dimensions.x * (j + dimensions.y * k) of the file and holds at
/// its middle, bounds_min + (i + 1/2, j + 1/2, k + 1/2) * size / dimensions. Between middles density is interpolated
/// linearly, nearer to the bounds it is the outermost voxel's, and outside them it is 0.
#[derive(Clone, Debug, PartialEq)]
pub struct GridDensity {
    file: String,
    dimensions: [u32; 3],
    bounds_min_m: DVec3,
    bounds_max_m: DVec3,
}

impl GridDensity {
    /// Name of the file of 32-bit floats, without folders.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Voxels along x, altitude and z.
    pub fn dimensions(&self) -> [u32; 3] {
        self.dimensions
    }

    /// How many voxels.
    pub fn voxels(&self) -> u64 {
        self.dimensions.iter().map(|n| u64::from(*n)).product()
    }

    /// Lower corner.
    pub fn bounds_min_m(&self) -> DVec3 {
        self.bounds_min_m
    }

    /// Upper corner.
    pub fn bounds_max_m(&self) -> DVec3 {
        self.bounds_max_m
    }
}

/// Density from weather maps and noise.
#[derive(Clone, Debug, PartialEq)]
pub struct WeatherDensity {
    profile: WeatherProfile,
    pattern: WeatherPattern,
    coverage: f64,
    cloud_type: f64,
    map_span_m: f64,
    shape_period_m: f64,
    detail_period_m: f64,
    detail_strength: f64,
    seed: u32,
    evolution_m_per_s: f64,
    maps: MapFiles,
}

impl WeatherDensity {
    /// Which vertical profiles the type walks through.
    pub fn profile(&self) -> WeatherProfile {
        self.profile
    }

    /// What the coverage map looks like.
    pub fn pattern(&self) -> WeatherPattern {
        self.pattern
    }

    /// How noise carves the clouds.
    pub fn form(&self) -> CloudForm {
        CloudForm::of(self.profile, self.cloud_type)
    }

    /// Share of the sky that clouds cover, 0 to 1.
    pub fn coverage(&self) -> f64 {
        self.coverage
    }

    /// Place among the profile's types, 0 to 1.
    pub fn cloud_type(&self) -> f64 {
        self.cloud_type
    }

    /// Length after which the maps repeat.
    pub fn map_span_m(&self) -> f64 {
        self.map_span_m
    }

    /// Length after which the noise that shapes clouds repeats.
    pub fn shape_period_m(&self) -> f64 {
        self.shape_period_m
    }

    /// Length after which the noise that frays their edges repeats.
    pub fn detail_period_m(&self) -> f64 {
        self.detail_period_m
    }

    /// How much the edges are frayed, 0 to 1.
    pub fn detail_strength(&self) -> f64 {
        self.detail_strength
    }

    /// Another number, another sky.
    pub fn seed(&self) -> u32 {
        self.seed
    }

    /// Speed at which the noise rises through the clouds.
    pub fn evolution_m_per_s(&self) -> f64 {
        self.evolution_m_per_s
    }

    /// Maps from files.
    pub fn maps(&self) -> &MapFiles {
        &self.maps
    }

    /// Whether both read the same maps.
    pub fn same_maps(&self, other: &Self) -> bool {
        self.seed == other.seed
            && self.pattern == other.pattern
            && self.profile == other.profile
            && self.maps.same_files(&other.maps)
    }

    /// The same layer with another's maps.
    #[must_use]
    pub fn with_maps_of(&self, other: &Self) -> Self {
        Self {
            seed: other.seed,
            pattern: other.pattern,
            profile: other.profile,
            maps: other.maps.clone(),
            ..self.clone()
        }
    }
}

/// Density of a thin sheet of ice: a texture of fibres and veils, the same at all of the layer's altitudes.
#[derive(Clone, Debug, PartialEq)]
pub struct CirrusDensity {
    coverage: f64,
    cloud_type: f64,
    optical_depth: f64,
    map_span_m: f64,
    fibre_period_m: f64,
    fibres_towards_deg: f64,
    seed: u32,
}

impl CirrusDensity {
    /// Share of the sky that the sheet covers, 0 to 1.
    pub fn coverage(&self) -> f64 {
        self.coverage
    }

    /// 0 an even veil to 1 fibres.
    pub fn cloud_type(&self) -> f64 {
        self.cloud_type
    }

    /// Optical depth straight through where density is 1.
    pub fn optical_depth(&self) -> f64 {
        self.optical_depth
    }

    /// Length after which patches repeat.
    pub fn map_span_m(&self) -> f64 {
        self.map_span_m
    }

    /// Length after which fibres repeat.
    pub fn fibre_period_m(&self) -> f64 {
        self.fibre_period_m
    }

    /// Unit vector along the fibres: x (east) and z (south).
    pub fn fibre_axis(&self) -> [f64; 2] {
        let (sin, cos) = self.fibres_towards_deg.to_radians().sin_cos();
        [sin, -cos]
    }

    /// Another number, another sky.
    pub fn seed(&self) -> u32 {
        self.seed
    }
}

impl TryFrom<CirrusDocument> for CirrusDensity {
    type Error = ValueError;

    fn try_from(document: CirrusDocument) -> Result<Self, ValueError> {
        Ok(Self {
            coverage: ranges::COVERAGE.check("/coverage", document.coverage)?,
            cloud_type: ranges::CLOUD_TYPE.check("/type", document.cloud_type)?,
            optical_depth: ranges::SHEET_OPTICAL_DEPTH
                .check("/optical_depth", document.optical_depth)?,
            map_span_m: ranges::MAP_SPAN_M.check("/map_span_m", document.map_span_m)?,
            fibre_period_m: ranges::FIBRE_PERIOD_M
                .check("/fibre_period_m", document.fibre_period_m)?,
            fibres_towards_deg: ranges::AZIMUTH_DEG
                .check("/fibres_towards_deg", document.fibres_towards_deg)?,
            seed: document.seed,
        })
    }
}

impl From<&CirrusDensity> for CirrusDocument {
    fn from(cirrus: &CirrusDensity) -> Self {
        Self {
            coverage: cirrus.coverage,
            cloud_type: cirrus.cloud_type,
            optical_depth: cirrus.optical_depth,
            map_span_m: cirrus.map_span_m,
            fibre_period_m: cirrus.fibre_period_m,
            fibres_towards_deg: cirrus.fibres_towards_deg,
            seed: cirrus.seed,
        }
    }
}

/// A place: x, altitude, z.
fn place(pointer: &str, values: [f64; 3]) -> Result<DVec3, ValueError> {
    ranges::SHAPE_HORIZONTAL_M.check(&format!("{pointer}/0"), values[0])?;
    ranges::SHAPE_ALTITUDE_M.check(&format!("{pointer}/1"), values[1])?;
    ranges::SHAPE_HORIZONTAL_M.check(&format!("{pointer}/2"), values[2])?;
    Ok(DVec3::from_array(values))
}

impl TryFrom<ShapeDocument> for Shape {
    type Error = ValueError;

    fn try_from(document: ShapeDocument) -> Result<Self, ValueError> {
        Ok(match document {
            ShapeDocument::Layer => Self::Layer,
            ShapeDocument::Box(document) => Self::Box {
                center_m: place("/center_m", document.center_m)?,
                size_m: DVec3::from_array(
                    ranges::SHAPE_SIZE_M.check_each("/size_m", document.size_m)?,
                ),
            },
            ShapeDocument::Sphere(document) => Self::Sphere {
                center_m: place("/center_m", document.center_m)?,
                radius_m: ranges::SHAPE_SIZE_M.check("/radius_m", document.radius_m)?,
            },
        })
    }
}

impl From<Shape> for ShapeDocument {
    fn from(shape: Shape) -> Self {
        match shape {
            Shape::Layer => Self::Layer,
            Shape::Box { center_m, size_m } => Self::Box(BoxDocument {
                center_m: center_m.to_array(),
                size_m: size_m.to_array(),
            }),
            Shape::Sphere { center_m, radius_m } => Self::Sphere(SphereDocument {
                center_m: center_m.to_array(),
                radius_m,
            }),
        }
    }
}

impl TryFrom<GridDocument> for GridDensity {
    type Error = ValueError;

    fn try_from(document: GridDocument) -> Result<Self, ValueError> {
        let file = checked_file_name("/file", document.file)?;
        for (axis, dimension) in document.dimensions.iter().enumerate() {
            ranges::GRID_DIMENSION.check_u32(&format!("/dimensions/{axis}"), *dimension)?;
        }
        let bounds_min_m = place("/bounds_min_m", document.bounds_min_m)?;
        let bounds_max_m = place("/bounds_max_m", document.bounds_max_m)?;
        for axis in 0..3 {
            NumberRange::new(
                bounds_min_m[axis] + ranges::SHAPE_SIZE_M.min,
                ranges::SHAPE_SIZE_M.max,
            )
            .check(&format!("/bounds_max_m/{axis}"), bounds_max_m[axis])
            .map_err(|mut error| {
                error.allowed.push_str(" (above bounds_min_m)");
                error
            })?;
        }
        let grid = Self {
            file,
            dimensions: document.dimensions,
            bounds_min_m,
            bounds_max_m,
        };
        if grid.voxels() > ranges::GRID_VOXELS_MAX {
            return Err(ValueError::new(
                "/dimensions",
                &Value::from(grid.dimensions.to_vec()),
                format!("at most {} voxels", ranges::GRID_VOXELS_MAX),
            ));
        }
        Ok(grid)
    }
}

impl From<&GridDensity> for GridDocument {
    fn from(grid: &GridDensity) -> Self {
        Self {
            file: grid.file.clone(),
            dimensions: grid.dimensions,
            bounds_min_m: grid.bounds_min_m.to_array(),
            bounds_max_m: grid.bounds_max_m.to_array(),
        }
    }
}

impl TryFrom<DensityDocument> for DensityModel {
    type Error = ValueError;

    fn try_from(document: DensityDocument) -> Result<Self, ValueError> {
        match document {
            DensityDocument::Weather(weather) => {
                WeatherDensity::try_from(weather).map(Self::Weather)
            }
            DensityDocument::Homogeneous(document) => Shape::try_from(document.shape)
                .map(Self::Homogeneous)
                .map_err(|error| error.under("/shape")),
            DensityDocument::Grid(grid) => GridDensity::try_from(grid).map(Self::Grid),
            DensityDocument::Cirrus(cirrus) => CirrusDensity::try_from(cirrus).map(Self::Cirrus),
        }
    }
}

impl From<&DensityModel> for DensityDocument {
    fn from(density: &DensityModel) -> Self {
        match density {
            DensityModel::Weather(weather) => Self::Weather(weather.into()),
            DensityModel::Homogeneous(shape) => Self::Homogeneous(HomogeneousDocument {
                shape: (*shape).into(),
            }),
            DensityModel::Grid(grid) => Self::Grid(grid.into()),
            DensityModel::Cirrus(cirrus) => Self::Cirrus(cirrus.into()),
        }
    }
}

impl TryFrom<WeatherDocument> for WeatherDensity {
    type Error = ValueError;

    fn try_from(document: WeatherDocument) -> Result<Self, ValueError> {
        Ok(Self {
            profile: document.profile,
            pattern: document.pattern,
            coverage: ranges::COVERAGE.check("/coverage", document.coverage)?,
            cloud_type: ranges::CLOUD_TYPE.check("/type", document.cloud_type)?,
            map_span_m: ranges::MAP_SPAN_M.check("/map_span_m", document.map_span_m)?,
            shape_period_m: ranges::SHAPE_PERIOD_M
                .check("/shape_period_m", document.shape_period_m)?,
            detail_period_m: ranges::DETAIL_PERIOD_M
                .check("/detail_period_m", document.detail_period_m)?,
            detail_strength: ranges::DETAIL_STRENGTH
                .check("/detail_strength", document.detail_strength)?,
            seed: document.seed,
            evolution_m_per_s: ranges::EVOLUTION_M_PER_S
                .check("/evolution_m_per_s", document.evolution_m_per_s)?,
            maps: MapFiles::try_from(document.maps).map_err(|error| error.under("/maps"))?,
        })
    }
}

impl From<&WeatherDensity> for WeatherDocument {
    fn from(weather: &WeatherDensity) -> Self {
        Self {
            profile: weather.profile,
            pattern: weather.pattern,
            coverage: weather.coverage,
            cloud_type: weather.cloud_type,
            map_span_m: weather.map_span_m,
            shape_period_m: weather.shape_period_m,
            detail_period_m: weather.detail_period_m,
            detail_strength: weather.detail_strength,
            seed: weather.seed,
            evolution_m_per_s: weather.evolution_m_per_s,
            maps: (&weather.maps).into(),
        }
    }
}
