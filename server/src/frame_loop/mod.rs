//! The thread that owns the GPU: takes commands, updates caches, composites frames, reads them
//! back.

mod cells_on_device;
pub mod interface;
mod pacing;
mod passes;
mod renderer;
mod screen_space;
mod stats;
mod still;
mod still_settings;
mod viewers_on_device;

pub use pacing::FrameLoop;
pub use still::{StillPixels, StillRenderer};
pub use still_settings::{
    MarchSettings as StillMarchSettings, StillFigures, StillPicture, StillSettings, unsupported,
};
