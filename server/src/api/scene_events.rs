//! `/api/v1/scene/events`: word of every change of the scene, as server-sent events.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Extension, State};
use axum::http::header::RETRY_AFTER;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::sse::{Event, KeepAlive, Sse};
use futures_util::stream::{self, Stream};
use schemars::JsonSchema;
use serde::Serialize;
use tokio::sync::OwnedSemaphorePermit;

use super::Problem;
use super::scene_time::TimeReport;
use crate::access::Lease;
use crate::clock;
use crate::scene::{Revision, SceneSnapshot};
use crate::stream::StreamContext;

/// How many may listen at once. Each holds a connection and a few kB.
pub const SUBSCRIBERS_MAX: usize = 64;

/// After this long without an event comes a comment, so that nobody on the way takes the connection for dead.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(15);

/// When a client whose connection has ended is to try again.
const RETRY: Duration = Duration::from_secs(2);

const LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

/// A change of the scene, as event `scene`: the sky's clock of that revision, and what it changed.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct SceneEvent<'a> {
    #[serde(flatten)]
    time: TimeReport,
    /// What made the revision.
    change: &'a Revision,
}

/// Changes of which nothing is known any more, as event `gap`: the scene is to be read anew.
#[derive(Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub(super) struct GapEvent {
    /// The last revision that was heard of.
    heard: u64,
    /// The oldest revision that is kept.
    oldest_kept: u64,
    /// The present scene's.
    revision: u64,
}

/// One `scene` event now and one for every change of the document: its id is the revision. A client that comes back with
/// `Last-Event-ID` hears of every revision that it has missed, one by one; where some of them are not kept any more, a `gap`
/// comes first, and then the newest alone.
pub(super) async fn events(
    State(context): State<Arc<StreamContext>>,
    Extension(lease): Extension<Lease>,
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
    changes.mark_changed();
    let heard = headers
        .get(LAST_EVENT_ID)
        .and_then(|id| id.to_str().ok())
        .and_then(|id| id.trim().parse::<u64>().ok());
    let listener = Listener {
        changes,
        heard,
        untold: VecDeque::new(),
        lease,
        context,
        _permit: permit,
    };
    let events = stream::unfold(listener, |mut listener| async move {
        let event = listener.next().await?;
        Some((Ok(event), listener))
    });
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE_INTERVAL)))
}

/// Who hears of changes.
struct Listener {
    changes: tokio::sync::watch::Receiver<SceneSnapshot>,
    /// The newest revision that it knows of.
    heard: Option<u64>,
    /// What it is to be told; bounded by the revisions that are kept.
    untold: VecDeque<News>,
    lease: Lease,
    context: Arc<StreamContext>,
    _permit: OwnedSemaphorePermit,
}

impl Listener {
    /// The next event; none when it is to hear no more.
    async fn next(&mut self) -> Option<Event> {
        while self.untold.is_empty() {
            tokio::select! {
                () = self.context.shutdown.cancelled() => return None,
                _ = self.lease.ended() => return None,
                changed = self.changes.changed() => changed.ok()?,
            }
            self.changes.borrow_and_update();
            self.untold = news(&self.context.scene.revisions(), self.heard);
        }
        if self.lease.lost().is_some() {
            return None;
        }
        let event = match self.untold.pop_front()? {
            News::Gap(gap) => Event::default().event("gap").json_data(gap),
            News::Change(change) => {
                self.heard = Some(change.revision);
                let snapshot = SceneSnapshot {
                    scene: Arc::clone(&change.scene),
                    revision: change.revision,
                };
                let told = SceneEvent {
                    time: TimeReport::of(&snapshot, clock::now()),
                    change: &change,
                };
                Event::default()
                    .event("scene")
                    .id(change.revision.to_string())
                    .json_data(told)
            }
        };
        Some(event.ok()?.retry(RETRY))
    }
}

/// What there is to tell.
#[derive(Debug, PartialEq)]
enum News {
    Change(Arc<Revision>),
    Gap(GapEvent),
}

/// What somebody has missed who has heard of a revision: each kept one after it, or, where some between are not kept any more,
/// that there is a gap, and the newest. Who has heard of none is told the newest.
fn news(kept: &[Arc<Revision>], heard: Option<u64>) -> VecDeque<News> {
    let (Some(oldest), Some(newest)) = (kept.first(), kept.last()) else {
        return VecDeque::new();
    };
    let change = |revision: &Arc<Revision>| News::Change(Arc::clone(revision));
    let Some(heard) = heard else {
        return [change(newest)].into();
    };
    let missed = kept.iter().filter(|revision| revision.revision > heard);
    let mut known = heard;
    let has_gap = missed.clone().any(|revision| {
        let is_apart = revision.first > known.saturating_add(1);
        known = revision.revision;
        is_apart
    });
    // A number that was never given here is of another scene.
    if has_gap || heard > newest.revision {
        let gap = GapEvent {
            heard,
            oldest_kept: oldest.revision,
            revision: newest.revision,
        };
        return [News::Gap(gap), change(newest)].into();
    }
    missed.map(change).collect()
}

#[cfg(test)]
mod tests {
    use skycell_protocol::{Moment, Scene};

    use super::*;
    use crate::scene::ChangeKind;

    /// A revision that stands for those from `first` on.
    fn revision(first: u64, revision: u64) -> Arc<Revision> {
        Arc::new(Revision {
            revision,
            first,
            time: Moment::UNIX_EPOCH,
            kind: ChangeKind::Patch,
            about: None,
            of: None,
            changed: Vec::new(),
            changed_more: 0,
            scene: Arc::new(Scene::default()),
        })
    }

    /// Numbers of revisions; 0 is a gap.
    fn told(kept: &[(u64, u64)], heard: Option<u64>) -> Vec<u64> {
        let kept: Vec<_> = kept.iter().map(|(a, b)| revision(*a, *b)).collect();
        let numbers = news(&kept, heard).into_iter().map(|news| match news {
            News::Gap(_) => 0,
            News::Change(change) => change.revision,
        });
        numbers.collect()
    }

    #[test]
    fn what_was_missed_is_told_one_by_one_and_what_is_gone_as_a_gap() {
        let kept = [(5, 5), (6, 6), (7, 7)];
        assert_eq!(told(&kept, None), [7]);
        assert_eq!(told(&kept, Some(7)), [] as [u64; 0]);
        assert_eq!(told(&kept, Some(5)), [6, 7]);
        assert_eq!(told(&kept, Some(4)), [5, 6, 7]);
        assert_eq!(told(&kept, Some(3)), [0, 7]);
        // Lost on the way, and of another server.
        assert_eq!(told(&[(5, 5), (7, 7)], Some(5)), [0, 7]);
        assert_eq!(told(&kept, Some(8)), [0, 7]);
        assert_eq!(told(&kept, Some(u64::MAX)), [0, 7]);
        assert_eq!(told(&[], Some(1)), [] as [u64; 0]);
    }

    #[test]
    fn a_group_of_changes_is_told_as_its_last_one_and_is_no_gap() {
        let kept = [(4, 4), (5, 30), (31, 31)];
        assert_eq!(told(&kept, Some(4)), [30, 31]);
        assert_eq!(told(&kept, Some(17)), [30, 31]);
        assert_eq!(told(&kept, Some(30)), [31]);
        assert_eq!(told(&kept, Some(2)), [0, 31]);
    }
}
