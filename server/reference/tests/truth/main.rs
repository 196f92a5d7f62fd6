//! The reference against closed forms, independent solvers and itself.

mod closed_forms;
mod disort;
mod furnace;
mod overlap;
mod phases;
mod single_scattering;
mod support;
mod tracking;
