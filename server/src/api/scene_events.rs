//! `/api/v1/scene/events`: word of every change of the scene, as server-sent events.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::http::header::RETRY_AFTER;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::sse::{Event, KeepAlive, Sse};
use futures_util::stream::{self, Stream};
use tokio::sync::OwnedSemaphorePermit;

use super::Problem;
use super::scene_time::TimeReport;
use crate::clock;
use crate::scene::SceneSnapshot;
use crate::stream::StreamContext;

/// How many may listen at once. Each holds a connection and a few kB.
pub const SUBSCRIBERS_MAX: usize = 64;

/// After this long without an event comes a comment, so that nobody on the way takes the connection for dead.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(15);

/// When a client whose connection has ended is to try again.
const RETRY: Duration = Duration::from_secs(2);

const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

/// One `scene` event now and one whenever the document changes: its id is the revision, its data the revision and the sky's
/// clock. Of changes that follow each other faster than the client reads, it hears of the last. A client that comes back
/// with `Last-Event-ID` hears at once if there is another revision than the one that it has heard of, and nothing until
/// there is.
pub(super) async fn events(
    State(context): State<Arc<StreamContext>>,
    headers: HeaderMap,
) -> Result<Sse<impl Stream<Item = Result<Event, Infallible>>>, Problem> {
    if context.shutdown.is_cancelled() {
        return Err(Problem::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "the server is shutting down",
        ));
    }
    let permit = Arc::clone(&context.subscribers)
        .try_acquire_owned()
        .map_err(|_| {
            Problem::new(
                StatusCode::SERVICE_UNAVAILABLE,
                format!("{SUBSCRIBERS_MAX} clients listen, and no more may; try again later"),
            )
            .with_header(RETRY_AFTER, HeaderValue::from(RETRY.as_secs()))
        })?;
    let mut changes = context.scene.subscribe();
    let known = headers
        .get(LAST_EVENT_ID)
        .and_then(|id| id.to_str().ok())
        .and_then(|id| id.trim().parse::<u64>().ok());
    let is_up_to_date = known == Some(changes.borrow_and_update().revision);
    let listener = Listener {
        changes,
        has_news: !is_up_to_date,
        context,
        _permit: permit,
    };
    let events = stream::unfold(listener, |mut listener| async move {
        if !std::mem::take(&mut listener.has_news) {
            tokio::select! {
                () = listener.context.shutdown.cancelled() => return None,
                changed = listener.changes.changed() => changed.ok()?,
            }
        }
        let snapshot = listener.changes.borrow_and_update().clone();
        let event = Event::default()
            .event("scene")
            .id(snapshot.revision.to_string())
            .retry(RETRY)
            .json_data(TimeReport::of(&snapshot, clock::now()))
            .ok()?;
        Some((Ok(event), listener))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE_INTERVAL)))
}

/// Who hears of changes.
struct Listener {
    changes: tokio::sync::watch::Receiver<SceneSnapshot>,
    /// Whether there is something to tell before anything changes.
    has_news: bool,
    context: Arc<StreamContext>,
    _permit: OwnedSemaphorePermit,
}
