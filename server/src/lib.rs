//! Skycell's render service.
//!
//! Modules stand in the order in which a camera becomes a frame.

pub mod field;
