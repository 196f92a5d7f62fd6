//! The parts of a scene outside its clouds: planet, sun, clear sky, wind.

use glam::DVec3;

use super::document::{
    AnalyticAtmosphereDocument, AtmosphereDocument, PlanetDocument, SunDocument, WindDocument,
};
use super::ranges;
use crate::ValueError;
use crate::camera::direction_of_angles;

/// The ground sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planet {
    radius_m: f64,
    ground_albedo: f64,
}

impl Planet {
    /// Radius of the ground.
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// Share of light that the ground reflects, 0 to 1.
    pub fn ground_albedo(&self) -> f64 {
        self.ground_albedo
    }
}

impl TryFrom<PlanetDocument> for Planet {
    type Error = ValueError;

    fn try_from(document: PlanetDocument) -> Result<Self, ValueError> {
        Ok(Self {
            radius_m: ranges::PLANET_RADIUS_M.check("/radius_m", document.radius_m)?,
            ground_albedo: ranges::GROUND_ALBEDO.check("/ground_albedo", document.ground_albedo)?,
        })
    }
}

impl From<&Planet> for PlanetDocument {
    fn from(planet: &Planet) -> Self {
        Self {
            radius_m: planet.radius_m,
            ground_albedo: planet.ground_albedo,
        }
    }
}

/// Direction and strength of the sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sun {
    azimuth_deg: f64,
    elevation_deg: f64,
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
            irradiance_w_per_m2_nm: sun.irradiance_w_per_m2_nm,
        }
    }
}

/// The clear sky.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Atmosphere {
    /// A closed formula.
    Analytic(AnalyticAtmosphere),
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
        }
    }
}

impl From<&Atmosphere> for AtmosphereDocument {
    fn from(atmosphere: &Atmosphere) -> Self {
        match atmosphere {
            Atmosphere::Analytic(sky) => Self::Analytic(AnalyticAtmosphereDocument {
                aerosol_optical_depth: sky.aerosol_optical_depth,
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
