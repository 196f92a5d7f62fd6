//! The thread that owns the GPU: takes commands, updates caches, composites frames, reads them
//! back.

mod auditing;
mod awaited_scene;
mod cells_on_device;
mod domes_on_device;
#[cfg(test)]
mod driven;
mod eyes;
pub mod interface;
mod light_shafts;
mod metering;
mod pacing;
mod passes;
mod qualities;
mod reanchoring;
mod renderer;
mod screen_space;
mod sky_steps;
mod sky_time;
mod stats;

mod still;
mod still_followed;
mod still_settings;
mod still_shared;
mod sun_volumes;
mod transitions;
mod viewers_on_device;
mod views;

pub use pacing::FrameLoop;
pub use still::StillRenderer;
pub use still_settings::{
    LayerFigures, RayFigures, RayPicture, StillFigures, StillPicture, StillRay, StillSettings,
};
pub use still_shared::SharedFigures;
