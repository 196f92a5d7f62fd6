//! How light travels in clouds.

use super::document::{DraineDocument, HgDocument, HgDraineDocument, LightDocument, PhaseDocument};
use super::ranges;
use super::scattering::Scattering;
use crate::ValueError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How light travels in clouds.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    phase: PhaseFunction,
    scattering: Scattering,
    octaves: u32,
    octave_attenuation: f64,
    octave_contribution: f64,
    octave_eccentricity: f64,
    sun_steps: u32,
    sun_depth: SunDepth,
    sun_march_distance_m: f64,
    ambient: f64,
}

impl Light {
    /// Where droplets scatter light to.
    pub fn phase(&self) -> &PhaseFunction {
        &self.phase
    }

    /// What becomes of light that is scattered more than once.
    pub fn scattering(&self) -> Scattering {
        self.scattering
    }

    /// Terms of the multiple-scattering sum, 1 to 16; 1 is single scattering (Wrenninge 2013).
    pub fn octaves(&self) -> u32 {
        self.octaves
    }

    /// Factor of the sun's optical depth from one octave to the next (Wrenninge's a), 0 to 1.
    pub fn octave_attenuation(&self) -> f64 {
        self.octave_attenuation
    }

    /// Factor of the scattered light from one octave to the next (Wrenninge's b), 0 to 1.
    pub fn octave_contribution(&self) -> f64 {
        self.octave_contribution
    }

    /// Factor of the phase's eccentricity from one octave to the next (Wrenninge's c), 0 to 1.
    pub fn octave_eccentricity(&self) -> f64 {
        self.octave_eccentricity
    }

    /// Steps of the march towards the sun, 1 to 64.
    pub fn sun_steps(&self) -> u32 {
        self.sun_steps
    }

    /// How optical depth towards the sun comes about.
    pub fn sun_depth(&self) -> SunDepth {
        self.sun_depth
    }

    /// Length of the march towards the sun.
    pub fn sun_march_distance_m(&self) -> f64 {
        self.sun_march_distance_m
    }

    /// Factor of the light from sky and ground.
    pub fn ambient(&self) -> f64 {
        self.ambient
    }
}

/// How optical depth towards the sun comes about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SunDepth {
    /// A march towards the sun from every step, within the step's layer.
    #[default]
    Cone,
    /// One volume for all, of all layers; the march where it does not reach.
    Volume,
}

/// Where droplets scatter light to. The numbers of a function inside a [`Light`] are in range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PhaseFunction {
    /// Henyey-Greenstein and Draine mixed by droplet size (Jendersie & d'Eon 2023).
    HgDraine {
        /// Diameter of the droplets, 5 to 50.
        droplet_diameter_um: f64,
    },
    /// Henyey-Greenstein.
    Hg {
        /// Mean cosine, -0.999 to 0.999.
        g: f64,
    },
    /// Draine.
    Draine {
        /// Eccentricity, -0.999 to 0.999.
        g: f64,
        /// 0 is Henyey-Greenstein, 1 Cornette-Shanks; to 10000.
        alpha: f64,
    },
    /// Rough ice crystals: see [`PhaseFunction::ICE_LOBES`].
    Ice,
    /// The same in every direction.
    Isotropic,
}

impl PhaseFunction {
    /// Asymmetries of the narrow and of the broad lobe of [`Self::Ice`], and the share of the broad one.
    ///
    /// Crystals are far larger than a wavelength, so half of what they take out of a beam is diffracted into a narrow forward
    /// peak (van de Hulst 1957, 8.1) and half is refracted and reflected. Measured in clouds, the whole has a mean cosine of
    /// 0.75 and, because most crystals are rough, neither halo nor rainbow (Järvinen et al. 2018, ACP 18, 15767). Two
    /// Henyey-Greenstein lobes have that mean cosine, (0.97 + 0.53) / 2. The narrow one is wider than diffraction's, which
    /// stays within about a degree: tuned, it stands for forward scattering that comes together in the sun's aureole.
    pub const ICE_LOBES: [f64; 3] = [0.97, 0.53, 0.5];
}

impl TryFrom<PhaseDocument> for PhaseFunction {
    type Error = ValueError;

    fn try_from(document: PhaseDocument) -> Result<Self, ValueError> {
        Ok(match document {
            PhaseDocument::HgDraine(HgDraineDocument {
                droplet_diameter_um,
            }) => Self::HgDraine {
                droplet_diameter_um: ranges::DROPLET_DIAMETER_UM
                    .check("/droplet_diameter_um", droplet_diameter_um)?,
            },
            PhaseDocument::Hg(HgDocument { g }) => Self::Hg {
                g: ranges::PHASE_G.check("/g", g)?,
            },
            PhaseDocument::Draine(DraineDocument { g, alpha }) => Self::Draine {
                g: ranges::PHASE_G.check("/g", g)?,
                alpha: ranges::DRAINE_ALPHA.check("/alpha", alpha)?,
            },
            PhaseDocument::Ice => Self::Ice,
            PhaseDocument::Isotropic => Self::Isotropic,
        })
    }
}

impl From<&PhaseFunction> for PhaseDocument {
    fn from(phase: &PhaseFunction) -> Self {
        match *phase {
            PhaseFunction::HgDraine {
                droplet_diameter_um,
            } => Self::HgDraine(HgDraineDocument {
                droplet_diameter_um,
            }),
            PhaseFunction::Hg { g } => Self::Hg(HgDocument { g }),
            PhaseFunction::Draine { g, alpha } => Self::Draine(DraineDocument { g, alpha }),
            PhaseFunction::Ice => Self::Ice,
            PhaseFunction::Isotropic => Self::Isotropic,
        }
    }
}

impl TryFrom<LightDocument> for Light {
    type Error = ValueError;

    fn try_from(document: LightDocument) -> Result<Self, ValueError> {
        Ok(Self {
            phase: PhaseFunction::try_from(document.phase).map_err(|e| e.under("/phase"))?,
            scattering: document.scattering,
            octaves: ranges::OCTAVES.check_u32("/octaves", document.octaves)?,
            octave_attenuation: ranges::OCTAVE_FACTOR
                .check("/octave_attenuation", document.octave_attenuation)?,
            octave_contribution: ranges::OCTAVE_FACTOR
                .check("/octave_contribution", document.octave_contribution)?,
            octave_eccentricity: ranges::OCTAVE_FACTOR
                .check("/octave_eccentricity", document.octave_eccentricity)?,
            sun_steps: ranges::SUN_STEPS.check_u32("/sun_steps", document.sun_steps)?,
            sun_depth: document.sun_depth,
            sun_march_distance_m: ranges::SUN_MARCH_DISTANCE_M
                .check("/sun_march_distance_m", document.sun_march_distance_m)?,
            ambient: ranges::AMBIENT.check("/ambient", document.ambient)?,
        })
    }
}

impl From<&Light> for LightDocument {
    fn from(light: &Light) -> Self {
        Self {
            phase: (&light.phase).into(),
            scattering: light.scattering,
            octaves: light.octaves,
            octave_attenuation: light.octave_attenuation,
            octave_contribution: light.octave_contribution,
            octave_eccentricity: light.octave_eccentricity,
            sun_steps: light.sun_steps,
            sun_depth: light.sun_depth,
            sun_march_distance_m: light.sun_march_distance_m,
            ambient: light.ambient,
        }
    }
}
