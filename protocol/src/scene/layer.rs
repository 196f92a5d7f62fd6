//! Cloud layers: shells of the atmosphere and how their density comes about.

use serde_json::Value;

use super::document::{DensityDocument, LayerDocument, WeatherDocument};
use super::ranges;
use super::sky::Wind;
use crate::ValueError;
use crate::number_range::NumberRange;

/// A shell of the atmosphere that holds one family of clouds.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudLayer {
    name: String,
    base_altitude_m: f64,
    top_altitude_m: f64,
    density: DensityModel,
    extinction_per_m: f64,
    single_scattering_albedo: f64,
    wind: Option<Wind>,
}

impl CloudLayer {
    /// What people call it; no other layer of the scene has the same name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where clouds begin.
    pub fn base_altitude_m(&self) -> f64 {
        self.base_altitude_m
    }

    /// Where clouds end; not below the base, but the layer may have no thickness.
    pub fn top_altitude_m(&self) -> f64 {
        self.top_altitude_m
    }

    /// How density comes about.
    pub fn density(&self) -> &DensityModel {
        &self.density
    }

    /// Extinction where density is 1.
    pub fn extinction_per_m(&self) -> f64 {
        self.extinction_per_m
    }

    /// Share of extinction that is scattering, 0 to 1.
    pub fn single_scattering_albedo(&self) -> f64 {
        self.single_scattering_albedo
    }

    /// The layer's own wind, if it has one. What moves it: [`super::Scene::layer_wind`].
    pub fn own_wind(&self) -> Option<Wind> {
        self.wind
    }
}

/// How a layer's density comes about.
#[derive(Clone, Debug, PartialEq)]
pub enum DensityModel {
    /// Weather maps and noise.
    Weather(WeatherDensity),
    /// Density 1 everywhere in the layer.
    Homogeneous,
}

/// Density from weather maps and noise.
#[derive(Clone, Debug, PartialEq)]
pub struct WeatherDensity {
    coverage: f64,
    cloud_type: f64,
    map_span_m: f64,
    shape_period_m: f64,
    detail_period_m: f64,
    detail_strength: f64,
    seed: u32,
}

impl WeatherDensity {
    /// Share of the sky that clouds cover, 0 to 1.
    pub fn coverage(&self) -> f64 {
        self.coverage
    }

    /// 0 stratus to 1 cumulus.
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
}

impl TryFrom<LayerDocument> for CloudLayer {
    type Error = ValueError;

    fn try_from(document: LayerDocument) -> Result<Self, ValueError> {
        let name_chars = document.name.chars().count();
        if name_chars == 0 || name_chars > ranges::LAYER_NAME_MAX_CHARS {
            return Err(ValueError::new(
                "/name",
                &Value::from(document.name),
                format!("1 to {} characters", ranges::LAYER_NAME_MAX_CHARS),
            ));
        }
        let base_altitude_m =
            ranges::LAYER_ALTITUDE_M.check("/base_altitude_m", document.base_altitude_m)?;
        let above_base = NumberRange::new(base_altitude_m, ranges::LAYER_ALTITUDE_M.max);
        let wind = document.wind.map(Wind::try_from).transpose();
        Ok(Self {
            name: document.name,
            base_altitude_m,
            top_altitude_m: above_base
                .check("/top_altitude_m", document.top_altitude_m)
                .map_err(|mut error| {
                    error.allowed.push_str(" (not below base_altitude_m)");
                    error
                })?,
            density: DensityModel::try_from(document.density).map_err(|e| e.under("/density"))?,
            extinction_per_m: ranges::EXTINCTION_PER_M
                .check("/extinction_per_m", document.extinction_per_m)?,
            single_scattering_albedo: ranges::SINGLE_SCATTERING_ALBEDO.check(
                "/single_scattering_albedo",
                document.single_scattering_albedo,
            )?,
            wind: wind.map_err(|e| e.under("/wind"))?,
        })
    }
}

impl From<&CloudLayer> for LayerDocument {
    fn from(layer: &CloudLayer) -> Self {
        Self {
            name: layer.name.clone(),
            base_altitude_m: layer.base_altitude_m,
            top_altitude_m: layer.top_altitude_m,
            density: (&layer.density).into(),
            extinction_per_m: layer.extinction_per_m,
            single_scattering_albedo: layer.single_scattering_albedo,
            wind: layer.wind.as_ref().map(Into::into),
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
            DensityDocument::Homogeneous => Ok(Self::Homogeneous),
        }
    }
}

impl From<&DensityModel> for DensityDocument {
    fn from(density: &DensityModel) -> Self {
        match density {
            DensityModel::Weather(weather) => Self::Weather(weather.into()),
            DensityModel::Homogeneous => Self::Homogeneous,
        }
    }
}

impl TryFrom<WeatherDocument> for WeatherDensity {
    type Error = ValueError;

    fn try_from(document: WeatherDocument) -> Result<Self, ValueError> {
        Ok(Self {
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
        })
    }
}

impl From<&WeatherDensity> for WeatherDocument {
    fn from(weather: &WeatherDensity) -> Self {
        Self {
            coverage: weather.coverage,
            cloud_type: weather.cloud_type,
            map_span_m: weather.map_span_m,
            shape_period_m: weather.shape_period_m,
            detail_period_m: weather.detail_period_m,
            detail_strength: weather.detail_strength,
            seed: weather.seed,
        }
    }
}
