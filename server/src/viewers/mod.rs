//! The connected viewers: who they are, what they want, what they were sent.

mod figures;
mod pixels;
mod registry;
mod slot;
mod viewer;

pub use figures::{FrameAge, ViewerFigures};
pub use pixels::{PixelBudget, PixelShare, TooManyPixels};
pub use registry::{JoinError, TooManyViewers, ViewerMembership, ViewerRegistry};
pub use slot::LatestSlot;
pub use viewer::{EncodedFrame, Viewer};
