//! Everything that defines the sky: the wire document and the domain types it becomes.

mod density;
mod document;
mod family;
mod layer;
mod light;
mod maps;
mod night;
pub mod ranges;
mod scattering;
mod sky;
#[cfg(test)]
mod tests;
mod timeline;
mod tone;

use serde_json::Value;

pub use density::{CirrusDensity, DensityModel, GridDensity, Shape, WeatherDensity};
pub use document::{
    AnalyticAtmosphereDocument, AtmosphereDocument, BoxDocument, CirrusDocument, DensityDocument,
    DraineDocument, GridDocument, HgDocument, HgDraineDocument, HomogeneousDocument, LayerDocument,
    LightDocument, MoonDocument, PhaseDocument, PhysicalAtmosphereDocument, PlanetChoice,
    PlanetDocument, SCENE_VERSION, SceneDocument, ShapeDocument, SphereDocument, StarsDocument,
    SunDocument, UniformAtmosphereDocument, WeatherDocument, WindDocument,
};
pub use family::{CloudForm, Family, WeatherPattern, WeatherProfile};
pub use layer::CloudLayer;
pub use light::{Light, PhaseFunction, SunDepth};
pub use maps::{MapFiles, MapKind, MapsDocument};
pub use night::{Moon, Stars};
pub use scattering::{FITTED, FittedScattering, Scattering};
pub use sky::{
    AnalyticAtmosphere, Atmosphere, FLAT_RADIUS_M, PhysicalAtmosphere, Planet, Sun,
    UniformAtmosphere, Wind,
};
use timeline::Timeline;
pub use timeline::{
    Animation, AnimationDocument, Drift, Ease, KeyframeDocument, PlaceAndTime,
    PlaceAndTimeDocument, Repeat, SkyClock, StillSceneDocument, TimeChange, TimeDocument,
    Transition, TransitionDocument,
};

pub use tone::{AutoExposure, AutoExposureDocument, ToneCurve, ToneDocument, ToneMapping};

use crate::ValueError;
use crate::quality::QualityChoice;
use ranges::{EXPOSURE_EV, LAYERS_MAX};

/// Why a document is no scene: pointer, value and what is allowed.
pub type SceneError = ValueError;

/// A sky that cannot be wrong: every number is in the range that [`ranges`] tells.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    planet: Planet,
    sun: Sun,
    moon: Option<Moon>,
    stars: Option<Stars>,
    atmosphere: Atmosphere,
    layers: Vec<CloudLayer>,
    light: Light,
    wind: Wind,
    exposure_ev: f64,
    tone: ToneMapping,
    quality: Option<QualityChoice>,
    timeline: Timeline,
}

impl Scene {
    /// Reads a scene from a full document; keys that are missing get their defaults.
    ///
    /// # Errors
    /// Names an unknown key or the first value that is not allowed.
    pub fn from_json(value: &Value) -> Result<Self, SceneError> {
        Self::try_from(SceneDocument::from_json(value)?)
    }

    /// The scene as a document with every key.
    pub fn to_document(&self) -> SceneDocument {
        let mut document = SceneDocument {
            version: SCENE_VERSION,
            planet: (&self.planet).into(),
            sun: (&self.sun).into(),
            moon: self.moon.as_ref().map(Into::into),
            stars: self.stars.as_ref().map(Into::into),
            atmosphere: (&self.atmosphere).into(),
            layers: self.layers.iter().map(Into::into).collect(),
            light: (&self.light).into(),
            wind: (&self.wind).into(),
            exposure_ev: self.exposure_ev,
            tone: (&self.tone).into(),
            quality: self.quality,
            ..SceneDocument::default()
        };
        self.timeline.write_to(&mut document);
        document
    }

    /// The ground sphere.
    pub fn planet(&self) -> &Planet {
        &self.planet
    }

    /// Direction and strength of the sun.
    pub fn sun(&self) -> &Sun {
        &self.sun
    }

    /// The moon, if there is one.
    pub fn moon(&self) -> Option<&Moon> {
        self.moon.as_ref()
    }

    /// The stars, if there are any.
    pub fn stars(&self) -> Option<&Stars> {
        self.stars.as_ref()
    }

    /// The clear sky.
    pub fn atmosphere(&self) -> &Atmosphere {
        &self.atmosphere
    }

    /// The air of scenes that have it computed: none in a flat world, around which no air can lie.
    pub fn physical_air(&self) -> Option<&PhysicalAtmosphere> {
        match &self.atmosphere {
            Atmosphere::Physical(air) if !self.planet.is_flat() => Some(air),
            _ => None,
        }
    }

    /// Whether clouds throw their shadow into the air.
    pub fn light_shafts(&self) -> bool {
        self.physical_air()
            .is_some_and(PhysicalAtmosphere::light_shafts)
    }

    /// Shells that hold clouds, at most [`LAYERS_MAX`].
    pub fn layers(&self) -> &[CloudLayer] {
        &self.layers
    }

    /// How light travels in clouds.
    pub fn light(&self) -> &Light {
        &self.light
    }

    /// The wind of every layer that has none of its own.
    pub fn wind(&self) -> &Wind {
        &self.wind
    }

    /// The wind that moves layer `index`: its own or the scene's. The scene's, too, for a layer
    /// that does not exist.
    pub fn layer_wind(&self, index: usize) -> Wind {
        self.layers
            .get(index)
            .and_then(CloudLayer::own_wind)
            .unwrap_or(self.wind)
    }

    /// Where layer `index` scatters light to: its own phase function or the scene's. The scene's, too, for a layer that
    /// does not exist.
    pub fn layer_phase(&self, index: usize) -> &PhaseFunction {
        self.layers
            .get(index)
            .and_then(CloudLayer::own_phase)
            .unwrap_or(self.light.phase())
    }

    /// Brightness of the picture in stops.
    pub fn exposure_ev(&self) -> f64 {
        self.exposure_ev
    }

    /// How radiance becomes a picture.
    pub fn tone(&self) -> &ToneMapping {
        &self.tone
    }

    /// How good pictures are to be for viewers who do not say; none for what the server is configured to.
    pub fn quality(&self) -> Option<QualityChoice> {
        self.quality
    }
}

impl TryFrom<SceneDocument> for Scene {
    type Error = SceneError;

    fn try_from(document: SceneDocument) -> Result<Self, SceneError> {
        if document.version != SCENE_VERSION {
            return Err(ValueError::new(
                "/version",
                &Value::from(document.version),
                SCENE_VERSION.to_string(),
            ));
        }
        let timeline = Timeline::of(&document)?;
        check_light_shafts(&document)?;
        Ok(Self {
            planet: Planet::try_from(document.planet).map_err(|e| e.under("/planet"))?,
            sun: Sun::try_from(document.sun).map_err(|e| e.under("/sun"))?,
            moon: document
                .moon
                .map(|moon| Moon::try_from(moon).map_err(|e| e.under("/moon")))
                .transpose()?,
            stars: document
                .stars
                .map(|stars| Stars::try_from(stars).map_err(|e| e.under("/stars")))
                .transpose()?,
            atmosphere: Atmosphere::try_from(document.atmosphere)
                .map_err(|e| e.under("/atmosphere"))?,
            layers: layers_from(document.layers).map_err(|e| e.under("/layers"))?,
            light: Light::try_from(document.light).map_err(|e| e.under("/light"))?,
            wind: Wind::try_from(document.wind).map_err(|e| e.under("/wind"))?,
            exposure_ev: EXPOSURE_EV.check("/exposure_ev", document.exposure_ev)?,
            tone: ToneMapping::try_from(document.tone).map_err(|e| e.under("/tone"))?,
            quality: document
                .quality
                .map(|quality| quality.checked("/quality"))
                .transpose()?,
            timeline,
        })
    }
}

/// Light shafts are shadows in air, and around a flat world there is none.
fn check_light_shafts(document: &SceneDocument) -> Result<(), SceneError> {
    match &document.atmosphere {
        AtmosphereDocument::Physical(air)
            if air.light_shafts && document.planet == PlanetChoice::Flat =>
        {
            Err(ValueError::new(
                "/atmosphere/light_shafts",
                &Value::from(true),
                "false on a flat planet, which has no air around it",
            ))
        }
        _ => Ok(()),
    }
}

fn layers_from(documents: Vec<LayerDocument>) -> Result<Vec<CloudLayer>, SceneError> {
    if documents.len() > LAYERS_MAX {
        return Err(ValueError::new(
            "",
            &Value::from(format!("{} layers", documents.len())),
            format!("0 to {LAYERS_MAX} layers"),
        ));
    }
    let mut layers: Vec<CloudLayer> = Vec::with_capacity(documents.len());
    for (index, document) in documents.into_iter().enumerate() {
        let layer =
            CloudLayer::try_from(document).map_err(|error| error.under(&format!("/{index}")))?;
        if layers.iter().any(|other| other.name() == layer.name()) {
            return Err(ValueError::new(
                format!("/{index}/name"),
                &Value::from(layer.name()),
                "a name that no other layer has",
            ));
        }
        layers.push(layer);
    }
    Ok(layers)
}

impl Default for Scene {
    fn default() -> Self {
        let document = SceneDocument::default();
        match Self::try_from(document) {
            Ok(scene) => scene,
            // The defaults are constants; `the_default_document_is_a_scene` holds them in range.
            Err(error) => unreachable!("the default scene is wrong: {error}"),
        }
    }
}
