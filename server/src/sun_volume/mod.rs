//! Optical depth to the sun, once per world instead of once per step: which columns of cloud are known, and which are made
//! next. Pure decisions; the passes stand in `march`, the state on the device in `frame_loop`.
//!
//! For every shown layer a clipmap around the viewers holds, per column along the sun's direction, how much cloud stands
//! above each altitude. Each layer's volume drifts with its own wind, so wind invalidates nothing: windows move over the
//! columns, and only what enters them is made. Layers are put together where they are read: what stands above a place is
//! the sum over their volumes.

mod columns;
mod generation;
mod sites;
mod size;
mod uniform;

pub use columns::Columns;
pub use generation::{Generation, GenerationInputs, LayerShell, Strip};
pub use sites::{SITES_MAX, SiteId, Sites};
pub use size::{BYTES_MAX, LEVELS_MAX, SunVolumeSize};
pub use uniform::{strip_work, sun_volume_uniform};

/// Below this elevation of the sun the cone serves: at 10° a column through 2.5 km leans over 14 km, more than the finest
/// window is wide, so that what stands over the viewers would be known by coarse columns alone. Set by this geometry, not by
/// a measurement.
pub const ELEVATION_MIN_DEG: f64 = 10.0;

/// Whether columns can run along a direction towards the sun.
#[must_use]
pub fn serves(sun_direction: glam::DVec3) -> bool {
    sun_direction.y >= ELEVATION_MIN_DEG.to_radians().sin()
}
