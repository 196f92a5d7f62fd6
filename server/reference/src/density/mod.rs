//! How dense cloud is at a place.

pub mod grid;
pub mod profile;
pub mod shape;
pub mod sheet;
pub mod weather;
