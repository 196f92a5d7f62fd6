//! `skycell-server measure`: what each setting costs in time and in error.

pub mod front;
pub mod metrics;
pub mod plan;
pub mod progress;
pub mod quality;
pub mod reference;
pub mod report;
pub mod settings;
pub mod store;
pub mod sweep;
pub mod tone;
