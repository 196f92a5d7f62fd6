//! Skycell's render service: shared sky caches, one composited frame per viewer.
//!
//! The modules stand in the order in which data passes them.

pub mod clock;
pub mod config;
pub mod metrics;
pub mod scene;
pub mod viewers;

pub mod frame_loop;

pub mod encode;
