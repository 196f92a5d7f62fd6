//! The truth for the model's approximations: unbiased Monte-Carlo transport through the same density.
//!
//! A camera path is found by delta tracking (E. Woodcock et al. 1965) against upper bounds of density per coarse cell; at
//! every scattering the sun is looked for directly, through a transmittance that ratio tracking estimates (J. Novák et al.
//! 2014), exactly where the medium is homogeneous. Paths end by Russian roulette, by leaving, on the ground or at the
//! orders asked for; nothing else cuts them, and a safety limit counts what it cuts.
//!
//! The sun's irradiance at a place is the model's at the clouds, so that the clouds' transport alone differs from the
//! march.

pub mod majorant;
mod moments;
mod random;
mod trace;
mod tracking;

pub use moments::{Mean, Moments};
pub use random::Random;
pub use trace::{Orders, PathSettings, SunShape, trace_ray};
pub use tracking::{Collision, Tracker};
