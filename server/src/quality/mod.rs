//! Quality as a choice: what is asked for (a preset, an error, a time) becomes settings of the march and of frames, by a
//! table of points of the trade between speed and accuracy. Pure decisions; `frame_loop` carries them out.

mod budget;
mod error;
mod settings;
mod table;

pub use budget::{BudgetGovernor, FrameCost};
pub use error::{AuditedError, BEYOND_MAX, ErrorGovernor, MarchedAs, Pace};
pub use settings::{
    FEW_TILES_MIP_BIAS, PARALLAX_STEPS_MAX, QualityOverrides, QualitySettings,
    default_parallax_steps,
};
pub use table::{Pick, PointCost, PointError, QualityPoint, QualityTable, QualityTableError};
