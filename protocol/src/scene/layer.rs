//! Cloud layers: shells of the atmosphere that hold clouds.

use serde_json::Value;

use super::density::DensityModel;
use super::document::LayerDocument;
use super::family::Family;
use super::light::PhaseFunction;
use super::ranges;
use super::sky::Wind;
use crate::ValueError;
use crate::number_range::NumberRange;

/// Least thickness of a sheet of ice that its optical depth is spread over.
const SHEET_THICKNESS_MIN_M: f64 = 1.0;

/// A shell of the atmosphere that holds one family of clouds.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudLayer {
    family: Option<Family>,
    name: String,
    base_altitude_m: f64,
    top_altitude_m: f64,
    density: DensityModel,
    extinction_per_m: f64,
    single_scattering_albedo: f64,
    phase: Option<PhaseFunction>,
    wind: Option<Wind>,
}

impl CloudLayer {
    /// The family whose values stood for what the document left out, if it named one.
    pub fn family(&self) -> Option<Family> {
        self.family
    }

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

    /// Extinction where density is 1: the document's, or for a sheet of ice its optical depth over its thickness.
    pub fn extinction_per_m(&self) -> f64 {
        match &self.density {
            // A sheet without thickness shows nothing, whatever stands here.
            DensityModel::Cirrus(cirrus) => {
                let thickness_m = self.top_altitude_m - self.base_altitude_m;
                cirrus.optical_depth() / thickness_m.max(SHEET_THICKNESS_MIN_M)
            }
            _ => self.extinction_per_m,
        }
    }

    /// Share of extinction that is scattering, 0 to 1.
    pub fn single_scattering_albedo(&self) -> f64 {
        self.single_scattering_albedo
    }

    /// Where its droplets or crystals scatter light to, if not where the scene's do. What holds:
    /// [`super::Scene::layer_phase`].
    pub fn own_phase(&self) -> Option<&PhaseFunction> {
        self.phase.as_ref()
    }

    /// The layer's own wind, if it has one. What moves it: [`super::Scene::layer_wind`].
    pub fn own_wind(&self) -> Option<Wind> {
        self.wind
    }

    /// Whether both are the same but for the maps that they read.
    pub fn is_same_but_for_maps(&self, other: &Self) -> bool {
        match (&self.density, &other.density) {
            (DensityModel::Weather(ours), DensityModel::Weather(theirs)) => {
                let alike = Self {
                    density: DensityModel::Weather(ours.with_maps_of(theirs)),
                    ..self.clone()
                };
                alike == *other
            }
            _ => self == other,
        }
    }

    pub(super) fn set_wind(&mut self, wind: Wind) {
        self.wind = Some(wind);
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
        let phase = document.phase.map(PhaseFunction::try_from).transpose();
        Ok(Self {
            family: document.family,
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
            phase: phase.map_err(|e| e.under("/phase"))?,
            wind: wind.map_err(|e| e.under("/wind"))?,
        })
    }
}

impl From<&CloudLayer> for LayerDocument {
    fn from(layer: &CloudLayer) -> Self {
        Self {
            family: layer.family,
            name: layer.name.clone(),
            base_altitude_m: layer.base_altitude_m,
            top_altitude_m: layer.top_altitude_m,
            density: (&layer.density).into(),
            extinction_per_m: layer.extinction_per_m,
            single_scattering_albedo: layer.single_scattering_albedo,
            phase: layer.phase.as_ref().map(Into::into),
            wind: layer.wind.as_ref().map(Into::into),
        }
    }
}
