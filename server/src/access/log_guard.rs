//! What no log may hold, however much it is told to log.

use tracing::{Level, Metadata};

/// Libraries that log whole messages at a finer level than this one, a hello with its token among them.
const MESSAGES_LOGGED_BY: [&str; 2] = ["tungstenite", "tokio_tungstenite"];

/// Whether an event may be logged: a filter that stands behind the configured one, which cannot lift it.
pub fn holds_no_secret(metadata: &Metadata<'_>) -> bool {
    let root = metadata.target().split("::").next().unwrap_or_default();
    *metadata.level() <= Level::INFO || !MESSAGES_LOGGED_BY.contains(&root)
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::{Arc, Mutex};

    use tracing_subscriber::filter::filter_fn;
    use tracing_subscriber::layer::SubscriberExt;

    use super::*;

    #[derive(Clone, Default)]
    struct Lines(Arc<Mutex<Vec<u8>>>);

    impl Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().expect("not poisoned").write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    /// What is logged at the finest level, with the guard or without.
    fn logged(is_guarded: bool) -> String {
        let lines = Lines::default();
        let writer = lines.clone();
        let subscriber = tracing_subscriber::registry()
            .with(filter_fn(move |metadata| {
                !is_guarded || holds_no_secret(metadata)
            }))
            .with(
                tracing_subscriber::fmt::layer()
                    .with_ansi(false)
                    .with_writer(move || writer.clone()),
            );
        tracing::subscriber::with_default(subscriber, || {
            tracing::trace!(target: "tungstenite::protocol", "Received message sky_secret");
            tracing::debug!(target: "tungstenite", "close sky_secret");
            tracing::trace!(target: "skycell_server::stream", "ours");
            tracing::warn!(target: "tungstenite::protocol", "a warning");
        });
        let bytes = lines.0.lock().expect("not poisoned").clone();
        String::from_utf8(bytes).expect("UTF-8")
    }

    #[test]
    fn messages_that_a_library_logs_are_cut_off_at_every_level_and_nothing_else_is() {
        let open = logged(false);
        assert_eq!(open.matches("sky_secret").count(), 2, "{open}");
        let guarded = logged(true);
        assert!(!guarded.contains("sky_secret"), "{guarded}");
        assert!(
            guarded.contains("ours") && guarded.contains("a warning"),
            "{guarded}"
        );
    }
}
