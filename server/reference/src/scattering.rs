//! Light that clouds scatter many times, by the constants that are fitted to the path tracer.
//!
//! In a slab that absorbs nothing the mean radiance of diffusing light is linear in optical depth (Eddington): with t the
//! optical depth times 1 − g, and boundaries that let light out, (k t_far + 1) / (k (t_near + t_far) + 2).

use skycell_protocol::scene::FittedScattering;

/// Optical depths from a place in a cloud outwards.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Surroundings {
    /// Away from the sun.
    pub behind: f64,
    /// Straight up.
    pub above: f64,
    /// Straight down.
    pub below: f64,
    /// Both horizontal ways across the sun's direction together.
    pub beside: f64,
}

/// Samples of each way.
pub const SURROUNDINGS_SAMPLES: u32 = 4;
/// How far they reach upright, m; sideways twice as far.
pub const SURROUNDINGS_REACH_M: f64 = 1500.0;
/// What a ray sees of a cloud within so much of where it first meets it is lit as one place, m; what lies farther back, as
/// another. One mean place for both could stand in the clear air between two clouds.
pub const FRONT_LENGTH_M: f64 = 1000.0;

/// Diffuse sunlight at a place, in units of the phase, under an optical depth towards the sun, whose elevation has the sine
/// `sun_rising`. `transport_share` is 1 − g.
///
/// A slab takes less light from a low sun, by the cosine of its incidence: the quotient of the cloud's thicknesses upright
/// and along the sun's way, and the sine itself where cloud is wider than high.
#[must_use]
pub fn diffuse_share(
    fitted: &FittedScattering,
    transport_share: f64,
    sun_depth: f64,
    sun_rising: f64,
    around: &Surroundings,
) -> f64 {
    let [near, far, above, below, across] = [
        sun_depth,
        around.behind,
        around.above,
        around.below,
        around.beside,
    ]
    .map(|t| t * transport_share);
    let along = near + far;
    let upright = above + below;
    let least = along.min(upright);
    let incidence = (upright / along.max(1e-6)).min(1.0);
    let flatness = (1.0 - upright / across.max(1e-6)).clamp(0.0, 1.0);
    let taken = incidence * (1.0 - flatness) + incidence.min(sun_rising.max(0.0)) * flatness;
    let fall = (fitted.diffuse_slope * far + 1.0) / (fitted.diffuse_slope * along + 2.0);
    let kept = (-fitted.diffuse_leak * near / (across + fitted.diffuse_width)).exp();
    fitted.diffuse_strength * fall * kept * taken * least / (least + fitted.diffuse_thickness)
}

/// Share of an even sky above a black ground that a place in a cloud scatters into a ray whose elevation has the sine
/// `rising`. An even light from all around scatters 1.
#[must_use]
pub fn sky_share(
    fitted: &FittedScattering,
    transport_share: f64,
    around: &Surroundings,
    rising: f64,
) -> f64 {
    let [above, below] = [around.above, around.below].map(|t| t * transport_share);
    let even = (fitted.sky_slope * below + 1.0) / (fitted.sky_slope * (above + below) + 2.0);
    let ahead = 0.5 * (1.0 + fitted.sky_forward * (2.5 * rising).clamp(-1.0, 1.0));
    let thin = (-fitted.sky_thinness * (above + below)).exp();
    even * (1.0 - thin) + ahead * thin
}
