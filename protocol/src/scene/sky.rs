//! The parts of a scene outside its clouds: planet, sun, clear sky, wind.

use glam::DVec3;

use super::document::{
    AnalyticAtmosphereDocument, AtmosphereDocument, PhysicalAtmosphereDocument, PlanetChoice,
    PlanetDocument, SunDocument, UniformAtmosphereDocument, WindDocument,
};
use super::ranges;
use super::timeline::PlaceAndTime;
use crate::ValueError;
use crate::camera::direction_of_angles;

/// The radius that stands for a flat world where formulas need one: over 100 km of ground the sphere sinks by 5 mm, and
/// its square still fits into an f32.
pub const FLAT_RADIUS_M: f64 = 1.0e12;

/// The ground sphere, or a flat world without ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planet {
    sphere: Option<Sphere>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sphere {
    radius_m: f64,
    ground_albedo: f64,
}

impl Planet {
    /// Whether there is neither curvature nor ground.
    pub fn is_flat(&self) -> bool {
        self.sphere.is_none()
    }

    /// Radius of the ground; [`FLAT_RADIUS_M`] where there is none.
    pub fn radius_m(&self) -> f64 {
        self.sphere.map_or(FLAT_RADIUS_M, |sphere| sphere.radius_m)
    }

    /// Share of light that the ground reflects, 0 to 1.
    pub fn ground_albedo(&self) -> f64 {
        self.sphere.map_or(0.0, |sphere| sphere.ground_albedo)
    }
}

impl TryFrom<PlanetChoice> for Planet {
    type Error = ValueError;

    fn try_from(document: PlanetChoice) -> Result<Self, ValueError> {
        let sphere = match document {
            PlanetChoice::Flat => None,
            PlanetChoice::Sphere(document) => Some(Sphere {
                radius_m: ranges::PLANET_RADIUS_M.check("/radius_m", document.radius_m)?,
                ground_albedo: ranges::GROUND_ALBEDO
                    .check("/ground_albedo", document.ground_albedo)?,
            }),
        };
        Ok(Self { sphere })
    }
}

impl From<&Planet> for PlanetChoice {
    fn from(planet: &Planet) -> Self {
        match planet.sphere {
            None => Self::Flat,
            Some(sphere) => Self::Sphere(PlanetDocument {
                radius_m: sphere.radius_m,
                ground_albedo: sphere.ground_albedo,
            }),
        }
    }
}

/// Direction and strength of the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sun {
    azimuth_deg: f64,
    elevation_deg: f64,
    place_and_time: Option<PlaceAndTime>,
    irradiance_w_per_m2_nm: [f64; 3],
}

impl Sun {
    /// Clockwise from north, towards the sun.
    pub fn azimuth_deg(&self) -> f64 {
        self.azimuth_deg
    }

    /// Above the horizon, towards the sun.
    pub fn elevation_deg(&self) -> f64 {
        self.elevation_deg
    }

    /// The place and the date that move the sun, if any do: [`super::Scene::at`] sets the angles by them.
    pub fn place_and_time(&self) -> Option<&PlaceAndTime> {
        self.place_and_time.as_ref()
    }

    /// Leaves the sun where it stands at a sky time.
    pub(super) fn stand_at(&mut self, sky_s: f64) {
        if let Some(place) = self.place_and_time.take() {
            [self.azimuth_deg, self.elevation_deg] = place.sun_azimuth_elevation_deg(sky_s);
        }
    }

    /// Red, green and blue above the atmosphere.
    pub fn irradiance_w_per_m2_nm(&self) -> [f64; 3] {
        self.irradiance_w_per_m2_nm
    }

    /// The unit vector towards the sun.
    pub fn direction(&self) -> DVec3 {
        direction_of_angles(self.azimuth_deg, self.elevation_deg)
    }
}

impl TryFrom<SunDocument> for Sun {
    type Error = ValueError;

    fn try_from(document: SunDocument) -> Result<Self, ValueError> {
        Ok(Self {
            azimuth_deg: ranges::AZIMUTH_DEG.check("/azimuth_deg", document.azimuth_deg)?,
            elevation_deg: ranges::ELEVATION_DEG.check("/elevation_deg", document.elevation_deg)?,
            place_and_time: document
                .place_and_time
                .map(PlaceAndTime::try_from)
                .transpose()
                .map_err(|error| error.under("/place_and_time"))?,
            irradiance_w_per_m2_nm: ranges::IRRADIANCE_W_PER_M2_NM
                .check_each("/irradiance_w_per_m2_nm", document.irradiance_w_per_m2_nm)?,
        })
    }
}

impl From<&Sun> for SunDocument {
    fn from(sun: &Sun) -> Self {
        Self {
            azimuth_deg: sun.azimuth_deg,
            elevation_deg: sun.elevation_deg,
            place_and_time: sun.place_and_time.as_ref().map(Into::into),
            irradiance_w_per_m2_nm: sun.irradiance_w_per_m2_nm,
        }
    }
}

/// The clear sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Atmosphere {
    /// A closed formula.
    Analytic(AnalyticAtmosphere),
    /// Rayleigh, aerosol and ozone, scattered more than once.
    Physical(PhysicalAtmosphere),
    /// No air; the same light from everywhere.
    Uniform(UniformAtmosphere),
}

/// Air, aerosol and ozone around a sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhysicalAtmosphere {
    aerosol_optical_depth: f64,
    aerosol_angstrom_exponent: f64,
    aerosol_single_scattering_albedo: f64,
    aerosol_asymmetry: f64,
    aerosol_scale_height_m: f64,
    rayleigh_scale_height_m: f64,
    rayleigh_density: f64,
    ozone_dobson: f64,
    light_shafts: bool,
}

impl PhysicalAtmosphere {
    /// Vertical optical depth of aerosol at 550 nm.
    pub fn aerosol_optical_depth(&self) -> f64 {
        self.aerosol_optical_depth
    }

    /// Its optical depth goes with the wavelength to the power of minus this.
    pub fn aerosol_angstrom_exponent(&self) -> f64 {
        self.aerosol_angstrom_exponent
    }

    /// Share of the aerosol's extinction that is scattering.
    pub fn aerosol_single_scattering_albedo(&self) -> f64 {
        self.aerosol_single_scattering_albedo
    }

    /// Mean cosine of the aerosol's phase.
    pub fn aerosol_asymmetry(&self) -> f64 {
        self.aerosol_asymmetry
    }

    /// Height over which aerosol falls to 1/e.
    pub fn aerosol_scale_height_m(&self) -> f64 {
        self.aerosol_scale_height_m
    }

    /// Height over which air falls to 1/e.
    pub fn rayleigh_scale_height_m(&self) -> f64 {
        self.rayleigh_scale_height_m
    }

    /// How much air there is, in that of the Earth.
    pub fn rayleigh_density(&self) -> f64 {
        self.rayleigh_density
    }

    /// Ozone in Dobson units.
    pub fn ozone_dobson(&self) -> f64 {
        self.ozone_dobson
    }

    /// Whether clouds throw their shadow into the air.
    pub fn light_shafts(&self) -> bool {
        self.light_shafts
    }
}

impl TryFrom<PhysicalAtmosphereDocument> for PhysicalAtmosphere {
    type Error = ValueError;

    fn try_from(document: PhysicalAtmosphereDocument) -> Result<Self, ValueError> {
        Ok(Self {
            aerosol_optical_depth: ranges::AEROSOL_OPTICAL_DEPTH
                .check("/aerosol_optical_depth", document.aerosol_optical_depth)?,
            aerosol_angstrom_exponent: ranges::AEROSOL_ANGSTROM_EXPONENT.check(
                "/aerosol_angstrom_exponent",
                document.aerosol_angstrom_exponent,
            )?,
            aerosol_single_scattering_albedo: ranges::AEROSOL_SINGLE_SCATTERING_ALBEDO.check(
                "/aerosol_single_scattering_albedo",
                document.aerosol_single_scattering_albedo,
            )?,
            aerosol_asymmetry: ranges::AEROSOL_ASYMMETRY
                .check("/aerosol_asymmetry", document.aerosol_asymmetry)?,
            aerosol_scale_height_m: ranges::SCALE_HEIGHT_M
                .check("/aerosol_scale_height_m", document.aerosol_scale_height_m)?,
            rayleigh_scale_height_m: ranges::SCALE_HEIGHT_M
                .check("/rayleigh_scale_height_m", document.rayleigh_scale_height_m)?,
            rayleigh_density: ranges::RAYLEIGH_DENSITY
                .check("/rayleigh_density", document.rayleigh_density)?,
            ozone_dobson: ranges::OZONE_DOBSON.check("/ozone_dobson", document.ozone_dobson)?,
            light_shafts: document.light_shafts,
        })
    }
}

/// An environment of one radiance in every direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UniformAtmosphere {
    radiance_w_per_m2_nm_sr: [f64; 3],
}

impl UniformAtmosphere {
    /// Red, green and blue.
    pub fn radiance_w_per_m2_nm_sr(&self) -> [f64; 3] {
        self.radiance_w_per_m2_nm_sr
    }
}

/// A clear sky by a closed formula.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnalyticAtmosphere {
    aerosol_optical_depth: f64,
}

impl AnalyticAtmosphere {
    /// Vertical optical depth of haze.
    pub fn aerosol_optical_depth(&self) -> f64 {
        self.aerosol_optical_depth
    }
}

impl TryFrom<AtmosphereDocument> for Atmosphere {
    type Error = ValueError;

    fn try_from(document: AtmosphereDocument) -> Result<Self, ValueError> {
        match document {
            AtmosphereDocument::Analytic(document) => Ok(Self::Analytic(AnalyticAtmosphere {
                aerosol_optical_depth: ranges::AEROSOL_OPTICAL_DEPTH
                    .check("/aerosol_optical_depth", document.aerosol_optical_depth)?,
            })),
            AtmosphereDocument::Physical(document) => {
                PhysicalAtmosphere::try_from(document).map(Self::Physical)
            }
            AtmosphereDocument::Uniform(document) => Ok(Self::Uniform(UniformAtmosphere {
                radiance_w_per_m2_nm_sr: ranges::ENVIRONMENT_RADIANCE
                    .check_each("/radiance_w_per_m2_nm_sr", document.radiance_w_per_m2_nm_sr)?,
            })),
        }
    }
}

impl From<&Atmosphere> for AtmosphereDocument {
    fn from(atmosphere: &Atmosphere) -> Self {
        match atmosphere {
            Atmosphere::Analytic(sky) => Self::Analytic(AnalyticAtmosphereDocument {
                aerosol_optical_depth: sky.aerosol_optical_depth,
            }),
            Atmosphere::Physical(sky) => Self::Physical(PhysicalAtmosphereDocument {
                aerosol_optical_depth: sky.aerosol_optical_depth,
                aerosol_angstrom_exponent: sky.aerosol_angstrom_exponent,
                aerosol_single_scattering_albedo: sky.aerosol_single_scattering_albedo,
                aerosol_asymmetry: sky.aerosol_asymmetry,
                aerosol_scale_height_m: sky.aerosol_scale_height_m,
                rayleigh_scale_height_m: sky.rayleigh_scale_height_m,
                rayleigh_density: sky.rayleigh_density,
                ozone_dobson: sky.ozone_dobson,
                light_shafts: sky.light_shafts,
            }),
            Atmosphere::Uniform(sky) => Self::Uniform(UniformAtmosphereDocument {
                radiance_w_per_m2_nm_sr: sky.radiance_w_per_m2_nm_sr,
            }),
        }
    }
}

/// Where clouds drift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wind {
    towards_deg: f64,
    speed_m_per_s: f64,
}

impl Wind {
    /// Clockwise from north, the direction that the wind blows to.
    pub fn towards_deg(&self) -> f64 {
        self.towards_deg
    }

    /// Speed of the clouds.
    pub fn speed_m_per_s(&self) -> f64 {
        self.speed_m_per_s
    }

    /// Horizontal velocity of the clouds in world axes.
    pub fn velocity_m_per_s(&self) -> DVec3 {
        direction_of_angles(self.towards_deg, 0.0) * self.speed_m_per_s
    }
}

impl Wind {
    /// The wind at a share of the way to another one; between opposite winds it calms down.
    pub(super) fn towards(&self, other: &Self, share: f64) -> Self {
        let velocity = self.velocity_m_per_s() * (1.0 - share) + other.velocity_m_per_s() * share;
        Self {
            // North is -z, east is +x.
            towards_deg: velocity.x.atan2(-velocity.z).to_degrees(),
            speed_m_per_s: velocity.length(),
        }
    }
}

impl TryFrom<WindDocument> for Wind {
    type Error = ValueError;

    fn try_from(document: WindDocument) -> Result<Self, ValueError> {
        Ok(Self {
            towards_deg: ranges::AZIMUTH_DEG.check("/towards_deg", document.towards_deg)?,
            speed_m_per_s: ranges::WIND_SPEED_M_PER_S
                .check("/speed_m_per_s", document.speed_m_per_s)?,
        })
    }
}

impl From<&Wind> for WindDocument {
    fn from(wind: &Wind) -> Self {
        Self {
            towards_deg: wind.towards_deg,
            speed_m_per_s: wind.speed_m_per_s,
        }
    }
}
