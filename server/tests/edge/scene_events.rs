//! `/api/v1/scene/events` over real connections.

use reqwest::{Method, Response};
use serde_json::{Value, json};

use crate::world::{World, start};

/// A stream of events, as a client reads it.
struct Events {
    response: Response,
    text: String,
}

/// An event: its name, its id and its data.
#[derive(Debug)]
struct Event {
    name: String,
    id: Option<u64>,
    data: Value,
}

impl Events {
    async fn open(world: &World, last_event_id: Option<&str>) -> Self {
        let mut request = world.request(Method::GET, "/api/v1/scene/events");
        if let Some(id) = last_event_id {
            request = request.header("last-event-id", id);
        }
        let response = request.send().await.expect("an answer");
        assert_eq!(response.status(), 200);
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        Self {
            response,
            text: String::new(),
        }
    }

    async fn next(&mut self) -> Event {
        loop {
            if let Some((block, rest)) = self.text.split_once("\n\n") {
                let field = |name: &str| {
                    block
                        .lines()
                        .find_map(|line| line.strip_prefix(name)?.strip_prefix(": "))
                };
                let event = Event {
                    name: field("event").unwrap_or_default().to_owned(),
                    id: field("id").map(|id| id.parse().expect("a number")),
                    data: serde_json::from_str(field("data").unwrap_or("null")).expect("JSON"),
                };
                self.text = rest.to_owned();
                if !event.name.is_empty() {
                    return event;
                }
                continue;
            }
            let patience = std::time::Duration::from_secs(10);
            let chunk = tokio::time::timeout(patience, self.response.chunk()).await;
            let chunk = chunk.expect("in time").expect("a stream").expect("no end");
            self.text
                .push_str(std::str::from_utf8(&chunk).expect("text"));
        }
    }

    /// The next event is that of a revision.
    async fn hears_of(&mut self, revision: u64) -> Event {
        let event = self.next().await;
        assert_eq!(
            (event.name.as_str(), event.id),
            ("scene", Some(revision)),
            "{event:?}"
        );
        assert_eq!(event.data["revision"], revision);
        assert_eq!(event.data["change"]["revision"], revision);
        event
    }
}

async fn expose(world: &World, exposure_ev: f64, query: &str) {
    let response = world
        .request(Method::PATCH, &format!("/api/v1/scene{query}"))
        .header("content-type", "application/merge-patch+json")
        .header("if-match", "*")
        .body(json!({"exposure_ev": exposure_ev}).to_string())
        .send()
        .await
        .expect("an answer");
    assert_eq!(response.status(), 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn who_comes_back_hears_of_each_revision_that_was_missed_and_then_of_new_ones() {
    let world = start().await;
    let mut first = Events::open(&world, None).await;
    let event = first.hears_of(1).await;
    assert_eq!(event.data["change"]["kind"], "start");
    drop(first);
    for exposure_ev in [1.0, 2.0, 3.0] {
        expose(&world, exposure_ev, "").await;
    }
    let mut back = Events::open(&world, Some("1")).await;
    for revision in 2..=4 {
        let event = back.hears_of(revision).await;
        assert_eq!(event.data["change"]["changed"], json!(["/exposure_ev"]));
        assert!(event.data["sky_s"].is_number());
    }
    expose(&world, 4.0, "").await;
    back.hears_of(5).await;
    // Who knows the newest hears of the next one alone; who says nothing of the newest alone.
    let mut knows = Events::open(&world, Some("5")).await;
    let mut new = Events::open(&world, None).await;
    new.hears_of(5).await;
    expose(&world, 5.0, "").await;
    knows.hears_of(6).await;
    new.hears_of(6).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_listens_misses_no_change_however_fast_they_come() {
    let world = start().await;
    let mut events = Events::open(&world, None).await;
    events.hears_of(1).await;
    for step in 1..=40 {
        expose(&world, f64::from(step) / 10.0, "").await;
    }
    for revision in 2..=41 {
        events.hears_of(revision).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn changes_that_are_not_kept_any_more_are_a_gap_and_then_the_newest_is_told() {
    let world = start().await;
    for step in 1..=101 {
        expose(&world, f64::from(step) / 100.0, "").await;
    }
    // 102 revisions were made and the last hundred are kept: 3 to 102.
    let mut all_kept = Events::open(&world, Some("2")).await;
    for revision in 3..=102 {
        all_kept.hears_of(revision).await;
    }
    for heard in [1, 103] {
        let mut behind = Events::open(&world, Some(&heard.to_string())).await;
        let gap = behind.next().await;
        assert_eq!((gap.name.as_str(), gap.id), ("gap", None), "{gap:?}");
        let told = json!({"heard": heard, "oldest_kept": 3, "revision": 102});
        assert_eq!(gap.data, told);
        behind.hears_of(102).await;
    }
    // What is no number says nothing.
    let mut odd = Events::open(&world, Some("x")).await;
    odd.hears_of(102).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_a_group_of_changes_who_comes_back_hears_the_last_and_no_gap() {
    let world = start().await;
    expose(&world, 1.0, "").await;
    for step in 2..=6 {
        expose(&world, f64::from(step), "?group=drag-1").await;
    }
    let mut before = Events::open(&world, Some("2")).await;
    let mut within = Events::open(&world, Some("4")).await;
    for listener in [&mut before, &mut within] {
        let event = listener.hears_of(7).await;
        assert_eq!(event.data["change"]["first"], 3);
    }
    expose(&world, 0.5, "").await;
    before.hears_of(8).await;
    within.hears_of(8).await;
}
