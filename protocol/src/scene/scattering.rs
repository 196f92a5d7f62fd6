//! Constants of light that clouds scatter more than once, fitted to a path tracer.

use schemars::JsonSchema;

/// How clouds scatter sunlight more than once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema)]
#[schemars(rename_all = "kebab-case")]
pub enum Scattering {
    /// A broadened octave and diffuse light that knows how thick the cloud is, with the constants of [`FITTED`].
    #[default]
    Fitted,
    /// Wrenninge's octaves with the document's factors.
    Octaves,
}

impl Scattering {
    /// What documents may say.
    pub const NAMES: [(&'static str, Self); 2] =
        [("fitted", Self::Fitted), ("octaves", Self::Octaves)];

    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fitted => "fitted",
            Self::Octaves => "octaves",
        }
    }
}

/// Constants of the fitted model. Optical depths enter it times 1 − g, with g the mean cosine of the phase function: for
/// light that was scattered often, a cloud of sharply peaked droplets is as thick as one of isotropic scatterers with so
/// much less extinction (H. van de Hulst's similarity).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FittedScattering {
    /// Attenuation of the forward octave per optical depth towards the sun and per 1 − g; at most 1 of the former.
    pub forward_attenuation: f64,
    /// Its strength.
    pub forward_strength: f64,
    /// Factor of the phase's eccentricity in it.
    pub forward_eccentricity: f64,
    /// Strength of diffuse light.
    pub diffuse_strength: f64,
    /// Factor of the phase's eccentricity in it.
    pub diffuse_eccentricity: f64,
    /// How fast diffuse light falls from the lit to the dark side.
    pub diffuse_slope: f64,
    /// Optical depth of a cloud whose diffuse light is half of a thick one's.
    pub diffuse_thickness: f64,
    /// How fast it leaks out of the sides.
    pub diffuse_leak: f64,
    /// What is added to a cloud's width before that: light leaks out of no cloud at once.
    pub diffuse_width: f64,
    /// How fast the sky's light falls from top to base.
    pub sky_slope: f64,
    /// How fast a cloud stops passing the sky's light onwards.
    pub sky_thinness: f64,
    /// How much of what a thin cloud passes on comes from where the ray goes.
    pub sky_forward: f64,
}

/// Fitted by `skycell-server measure octaves --fit`.
pub const FITTED: FittedScattering = FittedScattering {
    forward_attenuation: 1.314,
    forward_strength: 0.207,
    forward_eccentricity: 0.884,
    diffuse_strength: 5.789,
    diffuse_eccentricity: 0.267,
    diffuse_slope: 0.372,
    diffuse_thickness: 1.545,
    diffuse_leak: 7.35,
    diffuse_width: 17.26,
    sky_slope: 0.641,
    sky_thinness: 1.218,
    sky_forward: 0.945,
};
