//! Skycell's render service: shared sky caches, one composited frame per viewer.
//!
//! The modules stand in the order in which data passes them.

pub mod cache;
pub mod cells;
pub mod clock;
pub mod composite;
pub mod field;
pub mod frame_loop;
pub mod gpu;
pub mod march;
pub mod render_command;
