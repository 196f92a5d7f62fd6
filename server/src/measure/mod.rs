//! `skycell-server measure`: what each setting costs in time and in error.
//!
//! `plan` says which points, `settings` what a point is, `reference` what they are compared with; `sweep` renders and
//! compares them by `metrics`, `store` keeps them; `front` finds what nothing beats; `report` and `quality` write it down.

mod ageing;
mod animation;
mod arguments;
pub mod codec;
pub mod distance;
pub mod front;
mod gallery;
pub mod living;
pub mod metrics;
pub mod octaves;
pub mod plan;
pub mod progress;
mod proxies;
pub mod quality;
pub mod reference;
pub mod report;
pub mod scaling;
pub mod settings;
mod sheet;
pub mod store;
pub mod sweep;
mod trade;
pub mod walk;

pub use arguments::{
    GalleryArguments, MeasureArguments, Measurement, ReferenceKind, TradeArguments,
};

/// Measures.
///
/// # Errors
/// For a folder that cannot be written, an unreadable scene, an impossible camera, a missing device.
pub fn run(arguments: &MeasureArguments) -> anyhow::Result<()> {
    match &arguments.what {
        Measurement::Trade(trade) => trade::run(trade),
        Measurement::Gallery(gallery) => gallery::run(gallery),
        Measurement::Distance(arguments) => distance::run(arguments),
        Measurement::Walk(arguments) => walk::run(arguments),
        Measurement::Scaling(arguments) => scaling::run(arguments),
        Measurement::Proxies(arguments) => proxies::run(arguments),
        Measurement::Ageing(arguments) => ageing::run(arguments),
        Measurement::Living(arguments) => living::run(arguments),
        Measurement::Octaves(arguments) => octaves::run(arguments),
        Measurement::Codec(arguments) => codec::run(arguments),
    }
}
