//! What was measured, as data (`results.json`, `results.csv`) and as a page (`report.html`).

mod data;
mod lines;
mod page;
mod plots;
mod table;

pub use data::{CostUnit, PresetChoice, Report, ReportPoint, RunFacts, Rung, Summary};
pub(crate) use lines::{Curve, LinePlot};
pub use page::page;
pub(crate) use page::whole_page;
pub(crate) use plots::short;
pub use table::csv;
pub(crate) use table::name_of;
