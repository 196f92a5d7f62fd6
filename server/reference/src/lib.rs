//! The truth that the renderer's shaders and approximations are measured against, on the CPU in f64.
//!
//! Two renderers read the same scene and the same cloud field:
//! - [`march`]: the renderer's own model. [`march::march_ray`] takes the same samples as the shaders do, to find what f32
//!   costs; [`march::converged_ray`] halves its steps until nothing changes, to find what steps cost.
//! - [`path`]: unbiased Monte-Carlo transport through the same density, to find what the model's octaves, ambient term and
//!   short sun march cost.
//!
//! Everything is written from the equations, not from the shaders, so that it does not share their mistakes. Nothing here
//! knows a GPU.
//!
//! Rays are in a local frame: metres, y up, origin on the ground at a world position, the planet's centre at
//! (0, −R, 0). See [`World`].

pub mod air;
pub mod density;
mod error;
mod field;
pub mod march;
pub mod path;
pub mod phase;
pub mod picture;
mod ray;
mod result;
pub mod scattering;
pub mod shell;
pub mod sky;
mod texture;
pub mod transport;
pub mod window;
mod world;

pub use error::ReferenceError;
pub use field::{Field, LayerField, Noise, SheetMaps, WeatherMaps};
pub use ray::Ray;
pub use result::{LayerGathered, RayResult, StandardErrors};
pub use texture::{ByteVolume, TexelMap};
pub use world::{Approximations, Medium, World, WorldLayer, WorldSettings};
