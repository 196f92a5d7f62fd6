//! Skycell's render service: shared sky caches, one composited frame per viewer.
//!
//! The modules stand in the order in which data passes them.

pub mod clock;
pub mod field;
pub mod frame_loop;
