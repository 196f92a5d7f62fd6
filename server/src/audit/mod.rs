//! How wrong the caches are: texels that are marched again at high quality are compared with what the cache holds of them.
//! Pure arithmetic; the pass is in `march`, who is audited and when in `frame_loop`.

mod deviation;
mod window;

pub use deviation::{DEVIATION_MAX_PERCENT, ShownLight, Texel};
pub use window::{AUDITED_AFTER_CHANGE, AuditStats, AuditWindow, WINDOW_TEXELS};
