//! What was measured, as data (`results.json`, `results.csv`) and as a page (`report.html`).

mod data;
mod page;
mod plots;
mod table;

pub use data::{CostUnit, PresetChoice, Report, ReportPoint, RunFacts, Rung, Summary};
pub use page::page;
pub use table::csv;
pub(crate) use table::name_of;
