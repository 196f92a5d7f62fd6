//! `skycell-server measure`: what each setting costs in time and in error.

pub mod front;
pub mod metrics;
pub mod plan;
pub mod settings;
pub mod store;
pub mod tone;
