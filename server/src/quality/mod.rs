//! Quality as a choice: what is asked for (a preset, an error, a time) becomes settings of the march and of frames, by a
//! table of points of the trade between speed and accuracy. Pure decisions; `frame_loop` carries them out.

mod budget;
mod settings;
mod table;

pub use budget::{BudgetGovernor, FrameCost};
pub use settings::{QualityOverrides, QualitySettings};
pub use table::{Pick, PointCost, PointError, QualityPoint, QualityTable, QualityTableError};
