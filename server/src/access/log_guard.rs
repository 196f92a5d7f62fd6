//! What no log may hold, however much it is told to log.

use tracing::{Level, Metadata};

/// Libraries that log whole messages at a finer level than this one, a hello with its token among them.
const MESSAGES_LOGGED_BY: [&str; 2] = ["tungstenite", "tokio_tungstenite"];

/// Whether an event may be logged: a filter that stands behind the configured one, which cannot lift it.
pub fn holds_no_secret(metadata: &Metadata<'_>) -> bool {
    let root = metadata.target().split("::").next().unwrap_or_default();
    *metadata.level() <= Level::INFO || !MESSAGES_LOGGED_BY.contains(&root)
}
