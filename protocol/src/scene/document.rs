//! The scene as it stands in JSON. Every key but `version` may be left out and then has the
//! default that is written here; what numbers are allowed stands in [`super::ranges`].

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

use super::family::{Family, WeatherPattern, WeatherProfile};
use super::light::SunDepth;
use super::maps::{FILE_NAME_PATTERN, MapsDocument};
use super::ranges;
use super::timeline::{
    AnimationDocument, Drift, PlaceAndTimeDocument, TimeDocument, TransitionDocument,
};
use super::tone::ToneDocument;
use crate::ValueError;
use crate::quality::QualityChoice;
use crate::read_json::{ObjectReader, ReadJson, document, document_members, read_name};
use crate::schema;

use super::scattering::Scattering;

/// The version of the scene document that this crate reads and writes.
pub const SCENE_VERSION: u32 = 1;

document! {
    /// Everything that defines the sky, as JSON.
    #[schemars(transform = schema::with_version)]
    pub struct SceneDocument {
        /// Version of this format; must be there.
        "version" => version: u32 = SCENE_VERSION,
        /// The ground sphere; null (or "flat", which a merge patch can say) for a flat world without ground.
        "planet" => planet: PlanetChoice = PlanetChoice::default(),
        /// Direction and strength of the sun.
        "sun" => sun: SunDocument = SunDocument::default(),
        /// The moon; null for none.
        "moon" => moon: Option<MoonDocument> = None,
        /// The stars; null for none.
        "stars" => stars: Option<StarsDocument> = None,
        /// The clear sky.
        "atmosphere" => atmosphere: AtmosphereDocument = AtmosphereDocument::default(),
        /// Shells that hold clouds, 0 to 4.
        #[schemars(length(max = ranges::LAYERS_MAX))]
        "layers" => layers: Vec<LayerDocument> = vec![LayerDocument::default()],
        /// How light travels in clouds.
        "light" => light: LightDocument = LightDocument::default(),
        /// The wind of every layer that has none of its own.
        "wind" => wind: WindDocument = WindDocument::default(),
        /// Brightness of the picture in stops; +1 doubles it.
        "exposure_ev" => exposure_ev: f64 = 0.0; ranges::EXPOSURE_EV,
        /// How radiance becomes a picture.
        "tone" => tone: ToneDocument = ToneDocument::default(),
        /// How good pictures are to be for viewers who do not say; null for what the server is configured to.
        "quality" => quality: Option<QualityChoice> = None,
        /// The sky's clock.
        "time" => time: TimeDocument = TimeDocument::default(),
        /// Numbers that change with sky time, at most 32.
        #[schemars(length(max = ranges::ANIMATIONS_MAX))]
        "animation" => animation: Vec<AnimationDocument> = Vec::new(),
        /// The sky that this one comes from, for a while; null when it is there.
        "transition" => transition: Option<TransitionDocument> = None,
        /// Where the wind had carried the clouds when wind or clock were last changed, which servers write; null for sky
        /// time × wind.
        "drift" => drift: Option<Drift> = None,
    }
}

/// A ground sphere, or a flat world without ground: altitudes are heights above a plane, and nothing lies below.
#[derive(Clone, Debug, PartialEq)]
pub enum PlanetChoice {
    /// A ground sphere.
    Sphere(PlanetDocument),
    /// Neither curvature nor ground; `null` in JSON.
    Flat,
}

impl Default for PlanetChoice {
    fn default() -> Self {
        Self::Sphere(PlanetDocument::default())
    }
}

impl Serialize for PlanetChoice {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Sphere(planet) => planet.serialize(serializer),
            Self::Flat => serializer.serialize_unit(),
        }
    }
}

impl JsonSchema for PlanetChoice {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "PlanetChoice".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A ground sphere; null or \"flat\" for a flat world without ground.",
            "anyOf": [
                generator.subschema_for::<PlanetDocument>(),
                {"type": "null"},
                {"const": "flat"},
            ],
        })
    }
}

impl ReadJson for PlanetChoice {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        match value {
            Value::Null => Ok(Self::Flat),
            // A merge patch takes null for "remove", which brings the default back.
            Value::String(text) if text == "flat" => Ok(Self::Flat),
            Value::Object(_) => PlanetDocument::read_json(value, pointer).map(Self::Sphere),
            other => Err(ValueError::new(
                pointer,
                other,
                "an object, null or \"flat\"",
            )),
        }
    }
}

document! {
    /// The ground sphere.
    pub struct PlanetDocument {
        /// Radius of the ground.
        "radius_m" => radius_m: f64 = 6_360_000.0; ranges::PLANET_RADIUS_M,
        /// Share of light that the ground reflects.
        "ground_albedo" => ground_albedo: f64 = 0.1; ranges::GROUND_ALBEDO,
    }
}

document! {
    /// Direction and strength of the sun.
    pub struct SunDocument {
        /// Clockwise from north, towards the sun.
        "azimuth_deg" => azimuth_deg: f64 = 150.0; ranges::AZIMUTH_DEG,
        /// Above the horizon, towards the sun.
        "elevation_deg" => elevation_deg: f64 = 40.0; ranges::ELEVATION_DEG,
        /// A place and a date that say where the sun stands instead of the two angles; null for the angles.
        "place_and_time" => place_and_time: Option<PlaceAndTimeDocument> = None,
        /// Red (680 nm), green (550 nm) and blue (440 nm) above the atmosphere. The default is the
        /// sun's: Bruneton 2017, precomputed_atmospheric_scattering, demo.cc `kSolarIrradiance`.
        "irradiance_w_per_m2_nm" => irradiance_w_per_m2_nm: [f64; 3] = [1.474, 1.8504, 1.91198]; ranges::IRRADIANCE_W_PER_M2_NM,
    }
}

document! {
    /// The moon. It lights clouds and air instead of the sun where it gives more light than what is left of the sun's.
    pub struct MoonDocument {
        /// Clockwise from north, towards the moon.
        "azimuth_deg" => azimuth_deg: f64 = 200.0; ranges::AZIMUTH_DEG,
        /// Above the horizon, towards the moon.
        "elevation_deg" => elevation_deg: f64 = 35.0; ranges::ELEVATION_DEG,
        /// The angle between sun and viewer as seen from the moon: 0 full, 90 half, 180 new.
        "phase_angle_deg" => phase_angle_deg: f64 = 0.0; ranges::PHASE_ANGLE_DEG,
        /// Whether place and date of `/sun/place_and_time`, where there are such, say where the moon stands and its phase,
        /// in the place of the three angles.
        "of_place_and_time" => of_place_and_time: bool = false,
    }
}

document! {
    /// A made-up field of as many stars as the naked eye sees. They turn about the celestial pole, which stands in the
    /// north as high as the latitude.
    pub struct StarsDocument {
        /// Factor of their light.
        "brightness" => brightness: f64 = 1.0; ranges::STAR_BRIGHTNESS,
        /// Where on the planet one stands; negative in the south.
        "latitude_deg" => latitude_deg: f64 = 50.0; ranges::LATITUDE_DEG,
        /// How far the sky has turned.
        "turn_deg" => turn_deg: f64 = 0.0; ranges::TURN_DEG,
    }
}

/// The clear sky, by `model`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "model", rename_all = "kebab-case")]
#[schemars(deny_unknown_fields, transform = schema::optional_tag("model", "analytic"))]
pub enum AtmosphereDocument {
    /// A closed formula.
    Analytic(AnalyticAtmosphereDocument),
    /// Rayleigh, aerosol and ozone, scattered more than once.
    Physical(PhysicalAtmosphereDocument),
    /// No air; the same light from everywhere.
    Uniform(UniformAtmosphereDocument),
}

document! {
    /// Air that scatters (Rayleigh), aerosol that scatters and absorbs (Mie), and ozone that absorbs, around a sphere. A
    /// flat world has no such air; there the closed formula with the same aerosol stands for it.
    pub struct PhysicalAtmosphereDocument {
        /// Vertical optical depth of aerosol at 550 nm: 0.005 the clearest air, 0.1 clean, 0.4 hazy.
        "aerosol_optical_depth" => aerosol_optical_depth: f64 = 0.06; ranges::AEROSOL_OPTICAL_DEPTH,
        /// How much more aerosol takes out of blue light than of red: its optical depth goes with the wavelength to the
        /// power of minus this (Angstrom 1929).
        "aerosol_angstrom_exponent" => aerosol_angstrom_exponent: f64 = 0.0; ranges::AEROSOL_ANGSTROM_EXPONENT,
        /// Share of the aerosol's extinction that is scattering. Bruneton 2017, demo.cc `kMieSingleScatteringAlbedo`.
        "aerosol_single_scattering_albedo" => aerosol_single_scattering_albedo: f64 = 0.9; ranges::AEROSOL_SINGLE_SCATTERING_ALBEDO,
        /// Mean cosine of the aerosol's Henyey-Greenstein phase. Bruneton 2017, demo.cc `kMiePhaseFunctionG`.
        "aerosol_asymmetry" => aerosol_asymmetry: f64 = 0.8; ranges::AEROSOL_ASYMMETRY,
        /// Height over which aerosol falls to 1/e.
        "aerosol_scale_height_m" => aerosol_scale_height_m: f64 = 1200.0; ranges::SCALE_HEIGHT_M,
        /// Height over which air falls to 1/e.
        "rayleigh_scale_height_m" => rayleigh_scale_height_m: f64 = 8000.0; ranges::SCALE_HEIGHT_M,
        /// How much air there is, in that of the Earth.
        "rayleigh_density" => rayleigh_density: f64 = 1.0; ranges::RAYLEIGH_DENSITY,
        /// Ozone in Dobson units; the Earth has about 300.
        "ozone_dobson" => ozone_dobson: f64 = 300.0; ranges::OZONE_DOBSON,
        /// Whether clouds throw their shadow into the air: beams of light between them.
        "light_shafts" => light_shafts: bool = false,
    }
}

document! {
    /// No air, and an environment of one radiance in every direction: a plain background, or a furnace.
    pub struct UniformAtmosphereDocument {
        /// Red, green and blue; 0 is a black background.
        "radiance_w_per_m2_nm_sr" => radiance_w_per_m2_nm_sr: [f64; 3] = [0.0; 3]; ranges::ENVIRONMENT_RADIANCE,
    }
}

document! {
    /// A clear sky by a closed formula.
    pub struct AnalyticAtmosphereDocument {
        /// Vertical optical depth of haze.
        "aerosol_optical_depth" => aerosol_optical_depth: f64 = 0.08; ranges::AEROSOL_OPTICAL_DEPTH,
    }
}

impl Default for AtmosphereDocument {
    fn default() -> Self {
        Self::Analytic(AnalyticAtmosphereDocument::default())
    }
}

document_members! {
    /// A shell of the atmosphere that holds one family of clouds.
    #[schemars(transform = Family::model_of_density_is_told)]
    pub struct LayerDocument {
        /// The family whose values stand for the keys that are left out; null for the plain defaults.
        "family" => family: Option<Family> = None,
        /// What people call it; no two layers have the same name.
        #[schemars(length(min = 1, max = ranges::LAYER_NAME_MAX_CHARS))]
        "name" => name: String = "low".to_owned(),
        /// Where clouds begin.
        "base_altitude_m" => base_altitude_m: f64 = 1500.0; ranges::LAYER_ALTITUDE_M,
        /// Where clouds end.
        "top_altitude_m" => top_altitude_m: f64 = 4000.0; ranges::LAYER_ALTITUDE_M,
        /// How density comes about.
        "density" => density: DensityDocument = DensityDocument::default(),
        /// Extinction where density is 1.
        "extinction_per_m" => extinction_per_m: f64 = 0.05; ranges::EXTINCTION_PER_M,
        /// Share of extinction that is scattering.
        "single_scattering_albedo" => single_scattering_albedo: f64 = 0.9999; ranges::SINGLE_SCATTERING_ALBEDO,
        /// Where this layer's droplets or crystals scatter light to; null for the scene's `light.phase`.
        "phase" => phase: Option<PhaseDocument> = None,
        /// The layer's own wind; null for the scene's.
        "wind" => wind: Option<WindDocument> = None,
    }
}

impl ReadJson for LayerDocument {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, pointer)?;
        members.only(Self::KEYS)?;
        let family: Option<Family> = members.member_or("family", None)?;
        let default = family.map_or_else(Self::default, Family::layer);
        let density = match members.optional::<Value>("density")? {
            Some(value) => DensityDocument::read_json_or(
                &value,
                &members.pointer_of("density"),
                &default.density,
            )?,
            None => default.density.clone(),
        };
        // Without its density, whose keys have other defaults in a family.
        let mut others = value.clone();
        if let Value::Object(others) = &mut others {
            others.remove("density");
        }
        let layer = Self::read_members_or(&ObjectReader::new(&others, pointer)?, default)?;
        Ok(Self { density, ..layer })
    }
}

/// How a layer's density comes about, by `model`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "model", rename_all = "kebab-case")]
#[schemars(deny_unknown_fields, transform = schema::optional_tag("model", "weather"))]
pub enum DensityDocument {
    /// Weather maps and noise.
    Weather(WeatherDocument),
    /// Density 1 everywhere in a shape.
    Homogeneous(HomogeneousDocument),
    /// Voxels.
    Grid(GridDocument),
    /// A thin sheet of ice.
    Cirrus(CirrusDocument),
}

impl Default for DensityDocument {
    fn default() -> Self {
        Self::Weather(WeatherDocument::default())
    }
}

document! {
    /// Density 1 inside a shape, 0 outside. Places are x (east), altitude, z (south) at sky time 0; the shape drifts with
    /// the layer's wind and bends with the planet, as every cloud does.
    pub struct HomogeneousDocument {
        /// What is filled.
        "shape" => shape: ShapeDocument = ShapeDocument::Layer,
    }
}

/// What a homogeneous layer fills, by `form`. Only what lies between the layer's altitudes is filled.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "form", rename_all = "kebab-case")]
#[schemars(deny_unknown_fields, transform = schema::optional_tag("form", "layer"))]
pub enum ShapeDocument {
    /// The whole layer.
    Layer,
    /// A box along the axes.
    Box(BoxDocument),
    /// A ball.
    Sphere(SphereDocument),
}

document! {
    /// A box along the axes.
    pub struct BoxDocument {
        /// Its middle: x, altitude, z.
        #[schemars(transform = schema::place)]
        "center_m" => center_m: [f64; 3] = [0.0, 2000.0, 0.0],
        /// Its edges.
        "size_m" => size_m: [f64; 3] = [1000.0; 3]; ranges::SHAPE_SIZE_M,
    }
}

document! {
    /// A ball.
    pub struct SphereDocument {
        /// Its middle: x, altitude, z.
        #[schemars(transform = schema::place)]
        "center_m" => center_m: [f64; 3] = [0.0, 2000.0, 0.0],
        /// Its radius.
        "radius_m" => radius_m: f64 = 500.0; ranges::SHAPE_SIZE_M,
    }
}

document! {
    /// Density from voxels: raw 32-bit floats, little-endian, x fastest, then altitude, then z. The value of a voxel holds
    /// at its middle, between middles it is interpolated linearly, within half a voxel of the bounds it is the outermost
    /// voxel's, and outside the bounds it is 0.
    #[schemars(transform = schema::must_have(&["file"]))]
    pub struct GridDocument {
        /// Name of the file, without folders: beside the scene file, or in the folder `grids` of the server's state.
        #[schemars(pattern(FILE_NAME_PATTERN))]
        "file" => file: String = String::new(),
        /// Voxels along x, altitude and z.
        "dimensions" => dimensions: [u32; 3] = [1; 3]; ranges::GRID_DIMENSION,
        /// Lower corner: x, altitude, z.
        #[schemars(transform = schema::place)]
        "bounds_min_m" => bounds_min_m: [f64; 3] = [-500.0, 1500.0, -500.0],
        /// Upper corner.
        #[schemars(transform = schema::place)]
        "bounds_max_m" => bounds_max_m: [f64; 3] = [500.0, 2500.0, 500.0],
    }
}

document! {
    /// Density of a thin sheet of ice: a texture of fibres and veils between the layer's altitudes, the same at each of
    /// them. Its extinction comes from `optical_depth`, not from the layer's `extinction_per_m`.
    pub struct CirrusDocument {
        /// Share of the sky that the sheet covers.
        "coverage" => coverage: f64 = 0.5; ranges::COVERAGE,
        /// 0 cirrostratus, an even veil, to 1 cirrus, fibres.
        "type" => cloud_type: f64 = 1.0; ranges::CLOUD_TYPE,
        /// Optical depth straight through where the sheet is densest.
        "optical_depth" => optical_depth: f64 = 0.5; ranges::SHEET_OPTICAL_DEPTH,
        /// Length after which the patches of the sheet repeat.
        "map_span_m" => map_span_m: f64 = 83_000.0; ranges::MAP_SPAN_M,
        /// Length after which the fibres repeat.
        "fibre_period_m" => fibre_period_m: f64 = 21_000.0; ranges::FIBRE_PERIOD_M,
        /// Clockwise from north, the direction along which wind shear has drawn the fibres.
        "fibres_towards_deg" => fibres_towards_deg: f64 = 60.0; ranges::AZIMUTH_DEG,
        /// Another number, another sky.
        "seed" => seed: u32 = 1,
    }
}

document! {
    /// Density from weather maps and noise.
    pub struct WeatherDocument {
        /// Which vertical profiles `type` walks through.
        "profile" => profile: WeatherProfile = WeatherProfile::Low,
        /// What the coverage map looks like.
        "pattern" => pattern: WeatherPattern = WeatherPattern::Puffs,
        /// Share of the sky that clouds cover.
        "coverage" => coverage: f64 = 0.45; ranges::COVERAGE,
        /// Profile `low`: 0 stratus, 1/3 stratocumulus, 1/2 small cumulus, 2/3 cumulus, 1 cumulonimbus. `high`: 0 altostratus, 1 altocumulus.
        "type" => cloud_type: f64 = 0.7; ranges::CLOUD_TYPE,
        /// Length after which the maps repeat.
        "map_span_m" => map_span_m: f64 = 40_000.0; ranges::MAP_SPAN_M,
        /// Length after which the noise that shapes clouds repeats.
        "shape_period_m" => shape_period_m: f64 = 5000.0; ranges::SHAPE_PERIOD_M,
        /// Length after which the noise that frays their edges repeats.
        "detail_period_m" => detail_period_m: f64 = 420.0; ranges::DETAIL_PERIOD_M,
        /// How much the edges are frayed.
        "detail_strength" => detail_strength: f64 = 0.22; ranges::DETAIL_STRENGTH,
        /// Another number, another sky.
        "seed" => seed: u32 = 1,
        /// Speed at which the noise rises through the clouds, apart from the wind: they change their shapes.
        "evolution_m_per_s" => evolution_m_per_s: f64 = 0.0; ranges::EVOLUTION_M_PER_S,
        /// Maps from files.
        "maps" => maps: MapsDocument = MapsDocument::default(),
    }
}

document! {
    /// How light travels in clouds.
    pub struct LightDocument {
        /// Where droplets scatter light to.
        "phase" => phase: PhaseDocument = PhaseDocument::default(),
        /// What becomes of light that is scattered more than once: "fitted" to a path tracer, or "octaves" with the
        /// factors below.
        "scattering" => scattering: Scattering = Scattering::Fitted,
        /// Terms of the multiple-scattering sum; 1 is single scattering (Wrenninge 2013), with either model.
        "octaves" => octaves: u32 = 4; ranges::OCTAVES,
        /// Factor of the sun's optical depth from one octave to the next (Wrenninge's a).
        "octave_attenuation" => octave_attenuation: f64 = 0.5; ranges::OCTAVE_FACTOR,
        /// Factor of the scattered light from one octave to the next (Wrenninge's b).
        "octave_contribution" => octave_contribution: f64 = 0.5; ranges::OCTAVE_FACTOR,
        /// Factor of the phase's eccentricity from one octave to the next (Wrenninge's c).
        "octave_eccentricity" => octave_eccentricity: f64 = 0.5; ranges::OCTAVE_FACTOR,
        /// Steps of the march towards the sun.
        "sun_steps" => sun_steps: u32 = 6; ranges::SUN_STEPS,
        /// How optical depth towards the sun comes about: by a march from every step ("cone"), or by reading the sun volume
        /// ("volume"), with the march where the volume does not reach.
        "sun_depth" => sun_depth: SunDepth = SunDepth::Cone,
        /// Length of the march towards the sun.
        "sun_march_distance_m" => sun_march_distance_m: f64 = 1500.0; ranges::SUN_MARCH_DISTANCE_M,
        /// Factor of the light from sky and ground.
        "ambient" => ambient: f64 = 1.0; ranges::AMBIENT,
    }
}

/// Where droplets scatter light to, by `model`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "model", rename_all = "kebab-case")]
#[schemars(deny_unknown_fields, transform = schema::optional_tag("model", "hg-draine"))]
pub enum PhaseDocument {
    /// Rough ice crystals: two Henyey-Greenstein lobes.
    Ice,
    /// Henyey-Greenstein and Draine mixed by droplet size (Jendersie & d'Eon 2023).
    HgDraine(HgDraineDocument),
    /// Henyey-Greenstein.
    Hg(HgDocument),
    /// Draine.
    Draine(DraineDocument),
    /// The same in every direction.
    Isotropic,
}

impl Default for PhaseDocument {
    fn default() -> Self {
        Self::HgDraine(HgDraineDocument::default())
    }
}

document! {
    /// Henyey-Greenstein and Draine mixed by droplet size.
    pub struct HgDraineDocument {
        /// Diameter of the droplets.
        "droplet_diameter_um" => droplet_diameter_um: f64 = 20.0; ranges::DROPLET_DIAMETER_UM,
    }
}

document! {
    /// Henyey-Greenstein.
    pub struct HgDocument {
        /// Mean cosine: -1 backwards, 1 forwards.
        "g" => g: f64 = 0.85; ranges::PHASE_G,
    }
}

document! {
    /// Draine.
    pub struct DraineDocument {
        /// Eccentricity: -1 backwards, 1 forwards.
        "g" => g: f64 = 0.85; ranges::PHASE_G,
        /// 0 is Henyey-Greenstein, 1 Cornette-Shanks.
        "alpha" => alpha: f64 = 1.0; ranges::DRAINE_ALPHA,
    }
}

document! {
    /// Where the clouds drift.
    pub struct WindDocument {
        /// Clockwise from north, the direction that the wind blows to.
        "towards_deg" => towards_deg: f64 = 90.0; ranges::AZIMUTH_DEG,
        /// Speed of the clouds.
        "speed_m_per_s" => speed_m_per_s: f64 = 5.0; ranges::WIND_SPEED_M_PER_S,
    }
}

impl SceneDocument {
    /// Reads a document; keys that are missing get their defaults.
    ///
    /// # Errors
    /// Names an unknown key, a value of a wrong type, or a version that is missing or unknown.
    pub fn from_json(value: &Value) -> Result<Self, ValueError> {
        let version: u32 =
            ObjectReader::new(value, "")?.required("version", &SCENE_VERSION.to_string())?;
        if version != SCENE_VERSION {
            return Err(ValueError::new(
                "/version",
                &Value::from(version),
                SCENE_VERSION.to_string(),
            ));
        }
        Self::read_json(value, "")
    }
}

impl<'de> Deserialize<'de> for SceneDocument {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::from_json(&Value::deserialize(deserializer)?).map_err(serde::de::Error::custom)
    }
}

/// The `model` of a tagged document, or the default one.
fn read_model<T: Copy>(
    members: &ObjectReader<'_>,
    default: T,
    names: &[(&str, T)],
) -> Result<T, ValueError> {
    match members.optional::<Value>("model")? {
        Some(value) => read_name(&value, &members.pointer_of("model"), names),
        None => Ok(default),
    }
}

/// Refuses keys that are not `model` or one of the model's own. A merge patch that changes the
/// model has to set the old model's keys to null, which the error tells.
fn only_model_keys(
    members: &ObjectReader<'_>,
    model: &str,
    keys: &[&str],
) -> Result<(), ValueError> {
    let mut known = vec!["model"];
    known.extend_from_slice(keys);
    members.only(&known).map_err(|mut error| {
        error.allowed = format!(
            "{} for model \"{model}\" (in a patch, null removes a key of another model)",
            error.allowed
        );
        error
    })
}

impl ReadJson for SunDepth {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(
            value,
            pointer,
            &[("cone", Self::Cone), ("volume", Self::Volume)],
        )
    }
}

impl ReadJson for AtmosphereDocument {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, pointer)?;
        #[derive(Clone, Copy)]
        enum Model {
            Analytic,
            Physical,
            Uniform,
        }
        let names = [
            ("analytic", Model::Analytic),
            ("physical", Model::Physical),
            ("uniform", Model::Uniform),
        ];
        match read_model(&members, Model::Analytic, &names)? {
            Model::Analytic => {
                only_model_keys(&members, "analytic", AnalyticAtmosphereDocument::KEYS)?;
                AnalyticAtmosphereDocument::read_members_or(
                    &members,
                    AnalyticAtmosphereDocument::default(),
                )
                .map(Self::Analytic)
            }
            Model::Physical => {
                only_model_keys(&members, "physical", PhysicalAtmosphereDocument::KEYS)?;
                PhysicalAtmosphereDocument::read_members_or(
                    &members,
                    PhysicalAtmosphereDocument::default(),
                )
                .map(Self::Physical)
            }
            Model::Uniform => {
                only_model_keys(&members, "uniform", UniformAtmosphereDocument::KEYS)?;
                UniformAtmosphereDocument::read_members_or(
                    &members,
                    UniformAtmosphereDocument::default(),
                )
                .map(Self::Uniform)
            }
        }
    }
}

impl ReadJson for DensityDocument {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        Self::read_json_or(value, pointer, &Self::default())
    }
}

impl DensityDocument {
    /// As `read_json`; a key that is left out has the value of `default` where that is of the same model.
    fn read_json_or(value: &Value, pointer: &str, default: &Self) -> Result<Self, ValueError> {
        #[derive(Clone, Copy)]
        enum Model {
            Weather,
            Homogeneous,
            Grid,
            Cirrus,
        }
        let members = ObjectReader::new(value, pointer)?;
        let model = read_model(
            &members,
            match default {
                Self::Weather(_) => Model::Weather,
                Self::Homogeneous(_) => Model::Homogeneous,
                Self::Grid(_) => Model::Grid,
                Self::Cirrus(_) => Model::Cirrus,
            },
            &[
                ("weather", Model::Weather),
                ("homogeneous", Model::Homogeneous),
                ("grid", Model::Grid),
                ("cirrus", Model::Cirrus),
            ],
        )?;
        match model {
            Model::Weather => {
                only_model_keys(&members, "weather", WeatherDocument::KEYS)?;
                let default = match default {
                    Self::Weather(weather) => weather.clone(),
                    _ => WeatherDocument::default(),
                };
                WeatherDocument::read_members_or(&members, default).map(Self::Weather)
            }
            Model::Homogeneous => {
                only_model_keys(&members, "homogeneous", HomogeneousDocument::KEYS)?;
                HomogeneousDocument::read_members_or(&members, HomogeneousDocument::default())
                    .map(Self::Homogeneous)
            }
            Model::Grid => {
                only_model_keys(&members, "grid", GridDocument::KEYS)?;
                GridDocument::read_members_or(&members, GridDocument::default()).map(Self::Grid)
            }
            Model::Cirrus => {
                only_model_keys(&members, "cirrus", CirrusDocument::KEYS)?;
                let default = match default {
                    Self::Cirrus(cirrus) => cirrus.clone(),
                    _ => CirrusDocument::default(),
                };
                CirrusDocument::read_members_or(&members, default).map(Self::Cirrus)
            }
        }
    }
}

impl ReadJson for ShapeDocument {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        #[derive(Clone, Copy)]
        enum Form {
            Layer,
            Box,
            Sphere,
        }
        let members = ObjectReader::new(value, pointer)?;
        let names = [
            ("layer", Form::Layer),
            ("box", Form::Box),
            ("sphere", Form::Sphere),
        ];
        let form = match members.optional::<Value>("form")? {
            Some(value) => read_name(&value, &members.pointer_of("form"), &names)?,
            None => Form::Layer,
        };
        let only = |keys: &[&str]| {
            let mut known = vec!["form"];
            known.extend_from_slice(keys);
            members.only(&known)
        };
        match form {
            Form::Layer => only(&[]).map(|()| Self::Layer),
            Form::Box => {
                only(BoxDocument::KEYS)?;
                BoxDocument::read_members_or(&members, BoxDocument::default()).map(Self::Box)
            }
            Form::Sphere => {
                only(SphereDocument::KEYS)?;
                SphereDocument::read_members_or(&members, SphereDocument::default())
                    .map(Self::Sphere)
            }
        }
    }
}

impl ReadJson for Scattering {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &Self::NAMES)
    }
}

impl Serialize for Scattering {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl ReadJson for PhaseDocument {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        #[derive(Clone, Copy)]
        enum Model {
            HgDraine,
            Hg,
            Draine,
            Ice,
            Isotropic,
        }
        let members = ObjectReader::new(value, pointer)?;
        let model = read_model(
            &members,
            Model::HgDraine,
            &[
                ("hg-draine", Model::HgDraine),
                ("hg", Model::Hg),
                ("draine", Model::Draine),
                ("ice", Model::Ice),
                ("isotropic", Model::Isotropic),
            ],
        )?;
        match model {
            Model::HgDraine => {
                only_model_keys(&members, "hg-draine", HgDraineDocument::KEYS)?;
                HgDraineDocument::read_members_or(&members, HgDraineDocument::default())
                    .map(Self::HgDraine)
            }
            Model::Hg => {
                only_model_keys(&members, "hg", HgDocument::KEYS)?;
                HgDocument::read_members_or(&members, HgDocument::default()).map(Self::Hg)
            }
            Model::Draine => {
                only_model_keys(&members, "draine", DraineDocument::KEYS)?;
                DraineDocument::read_members_or(&members, DraineDocument::default())
                    .map(Self::Draine)
            }
            Model::Ice => {
                only_model_keys(&members, "ice", &[])?;
                Ok(Self::Ice)
            }
            Model::Isotropic => {
                only_model_keys(&members, "isotropic", &[])?;
                Ok(Self::Isotropic)
            }
        }
    }
}
