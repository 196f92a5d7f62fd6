//! Skycell's render service: shared sky caches, one composited frame per viewer.
//!
//! The modules stand in the order in which data passes them.

pub mod access;
pub mod clock;
pub mod config;
pub mod metrics;
pub mod traces;

pub mod quality;
pub mod scene;
pub mod viewers;

pub mod atmosphere;
pub mod audit;
pub mod cache;
pub mod cells;
pub mod composite;
pub mod field;
pub mod frame_loop;
pub mod gpu;
pub mod march;

pub mod probe;

pub mod encode;
pub mod stream;
pub mod sun_volume;

pub mod api;
pub mod doctor;
pub mod measure;
pub mod render_command;
pub mod service;
pub mod token_command;
pub mod truth;
