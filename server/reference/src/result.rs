//! What a ray sees.

use glam::DVec3;
use serde::Serialize;

/// What one ray gathers in one layer by marching, per unit of the light that comes in: colours and the phase of single
/// scattering are multiplied in afterwards.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LayerGathered {
    /// Index of the layer in the scene.
    pub scene_index: usize,
    /// Single scattering without its phase, ∫ T σ_s e^(−τ_sun) dt.
    pub single: f64,
    /// Octaves from the second on, with their phases for this ray, 1/sr.
    pub octaves: f64,
    /// Ambient light that is scattered in, as a share of the sky's mean radiance.
    pub ambient: f64,
    /// Share of the light behind that comes through.
    pub transmittance: f64,
    /// Opacity-weighted distance from the ray's origin, m, with the layer itself at a weight of
    /// [`crate::march::CLEAR_OPACITY`].
    pub opacity_distance_m: f64,
    /// ∫ σ_t dt as far as the ray was followed.
    pub optical_depth: f64,
}

impl LayerGathered {
    /// Mean distance of what is seen, m.
    #[must_use]
    pub fn distance_seen_m(&self) -> f64 {
        self.opacity_distance_m / (1.0 - self.transmittance + crate::march::CLEAR_OPACITY)
    }
}

/// Standard errors of a result's members; 0 where nothing is random.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StandardErrors {
    /// Of the radiance.
    pub radiance: DVec3,
    /// Of the singly scattered radiance.
    pub single_scattered: DVec3,
    /// Of the transmittance.
    pub transmittance: f64,
    /// Of the optical depth.
    pub optical_depth: f64,
}

/// What a ray sees. Radiance is spectral, W/(m² sr nm), at the scene's three wavelengths.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RayResult {
    /// Everything.
    pub radiance: DVec3,
    /// The part of it that was scattered exactly once, from the sun, in cloud.
    pub single_scattered: DVec3,
    /// Share of what lies behind all clouds that comes through.
    pub transmittance: f64,
    /// Of all clouds.
    pub optical_depth: f64,
    /// Evaluations of density.
    pub steps: u64,
    /// How far chance may have moved the above.
    pub standard_error: StandardErrors,
    /// What each layer gave, lowest first; empty for the path tracer, which does not part them.
    pub layers: Vec<LayerGathered>,
}
