//! The connected viewers: who they are, what they want, what they were sent.

mod figures;
mod latency;
mod pixels;
mod rate;
mod registry;
mod slot;
mod viewer;

pub use figures::{Acknowledged, SentFrame, ViewerFigures};
pub use latency::{Latencies, LatencyReport, Percentiles, RecentTimes, Stage};
pub use pixels::{PixelBudget, PixelShare, TooManyPixels};
pub use rate::{Delivery, JpegLadder, RateControl};
pub use registry::{JoinError, TooManyViewers, ViewerMembership, ViewerRegistry};
pub use slot::LatestSlot;
pub use viewer::{EncodedFrame, Viewer};
