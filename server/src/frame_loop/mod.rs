//! The thread that owns the GPU: takes commands, updates caches, composites frames, reads them
//! back.

mod asked_errors;
mod auditing;
mod awaited_scene;
mod budgets;
mod cells_on_device;
mod clouds;
mod device_loss;
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
mod refining;
mod renderer;
mod renderer_fade;
mod screen_space;
mod sides;
mod sky_steps;
mod sky_time;
mod stats;

mod still;
mod still_clouds;
mod still_followed;
mod still_frames;
mod still_living;
mod still_settings;
mod still_shared;
mod still_together;
mod sun_volumes;
mod transitions;
mod viewers_on_device;
mod views;

pub use auditing::AuditedTexel;
pub use pacing::FrameLoop;
pub use still::StillRenderer;
pub use still_clouds::StillClouds;
pub use still_frames::{FrameCosts, FrameFigures, StillFrame};
pub use still_living::LivingViewers;
pub use still_settings::{
    LayerFigures, RayFigures, RayPicture, StillFigures, StillPicture, StillRay, StillSettings,
};
pub use still_shared::SharedFigures;
