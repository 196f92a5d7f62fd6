//! The air of scenes that have it computed: what does not depend on who looks is tabulated once.
//!
//! - [`Medium`]: what the air is made of, in f64.
//! - [`BaseTables`]: optical depths, higher orders of scattering and the lit ground; they depend on the air alone.
//! - [`AirKeeper`]: which of them are shown while the air changes.
//! - [`AirLight`]: the light of one position of the sun on clouds and ground.
//! - [`LightShafts`]: the shadow of clouds in the air around a place, and the share of its light that it leaves.
//! - [`AirViews`]: sky and haze on the device, for an altitude; all viewers there share them.

mod base;
mod keeper;
mod light;
mod medium;
mod shafts;
mod views;

pub use base::BaseTables;
pub use keeper::AirKeeper;
pub use light::AirLight;
pub use medium::Medium;
pub use shafts::{
    LightShafts, ShaftInputs, ShaftLayer, ShaftReader, ShaftShares, ShaftsRead, blank_shafts,
    cloud_shadows_key, make_shafts_key,
};
pub use views::{AirViews, key_of_altitude, table_keys};
