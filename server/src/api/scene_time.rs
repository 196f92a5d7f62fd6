//! `/api/v1/scene/time` and `/now`: the sky's clock and the scene of the moment.

use std::sync::Arc;

use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{Extension, Query, State};
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use skycell_protocol::read_json::{ObjectReader, ReadJson};
use skycell_protocol::scene::{SceneDocument, TimeChange};
use skycell_protocol::{Moment, SceneError, ValueError};

use super::Problem;
use super::scene::{ChangeQuery, change, etag, read_json_body, read_precondition};
use crate::access::Peer;
use crate::clock;
use crate::scene::SceneSnapshot;
use crate::stream::StreamContext;

/// The sky's clock at a moment.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct TimeReport {
    /// Of the document.
    revision: u64,
    /// The moment that the rest is about.
    now: Moment,
    /// Sky time.
    sky_s: f64,
    /// Date and time at the sun's place; null where the sun stands by hand.
    date: Option<Moment>,
    /// The sun's place, degrees east; null where the sun stands by hand.
    longitude_deg: Option<f64>,
    /// Seconds of sky time in a second while it runs.
    rate: f64,
    /// Seconds of wind in a second while it runs.
    wind_rate: f64,
    /// Whether sky time stands still.
    paused: bool,
    /// Where the sun stands.
    sun: SunReport,
    /// How far a transition is, 0 to 1; null when there is none.
    transition: Option<f64>,
}

#[derive(Debug, Serialize, JsonSchema)]
struct SunReport {
    azimuth_deg: f64,
    elevation_deg: f64,
}

impl TimeReport {
    pub(super) fn of(snapshot: &SceneSnapshot, now: Moment) -> Self {
        let scene = &snapshot.scene;
        let sky_s = scene.clock().sky_s(now);
        let place = scene.sun().place_and_time();
        let shown = scene.at(now);
        Self {
            revision: snapshot.revision,
            now,
            sky_s,
            date: place.map(|place| place.date_at(sky_s)),
            longitude_deg: place.map(|place| place.longitude_deg()),
            rate: scene.clock().rate(),
            wind_rate: scene.clock().wind_rate(),
            paused: scene
                .clock()
                .paused_at()
                .is_some_and(|paused| paused <= now),
            sun: SunReport {
                azimuth_deg: shown.sun().azimuth_deg(),
                elevation_deg: shown.sun().elevation_deg(),
            },
            transition: scene
                .transition()
                .map(|transition| transition.share(now))
                .filter(|share| *share < 1.0),
        }
    }
}

/// The clock now.
pub(super) async fn get(State(context): State<Arc<StreamContext>>) -> Response {
    report(&context.scene.snapshot(), clock::now())
}

fn report(snapshot: &SceneSnapshot, now: Moment) -> Response {
    (etag(snapshot), Json(TimeReport::of(snapshot, now))).into_response()
}

/// Stops the clock, lets it go on, sets it, or gives it another rate: what is not given stays as it is.
pub(super) async fn put(
    State(context): State<Arc<StreamContext>>,
    Extension(peer): Extension<Peer>,
    Query(query): Query<ChangeQuery>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Response, Problem> {
    let precondition = read_precondition(&headers)?;
    let group = query.group_of(peer)?;
    let body = read_json_body(&headers, body)?;
    let wanted = read_change(&body, &context.scene.snapshot()).map_err(Problem::bad_value)?;
    let snapshot = change(&context, move |scene| {
        scene.change_time(&precondition, &wanted, group)
    })
    .await?;
    Ok(report(&snapshot, clock::now()))
}

fn read_change(body: &Value, snapshot: &SceneSnapshot) -> Result<TimeChange, ValueError> {
    let members = ObjectReader::new(body, "")?;
    members.only(&["sky_s", "date", "rate", "wind_rate", "paused"])?;
    let mut wanted = TimeChange {
        sky_s: members.optional("sky_s")?,
        rate: members.optional("rate")?,
        paused: members
            .optional::<Value>("paused")?
            .map(|value| {
                value
                    .as_bool()
                    .ok_or_else(|| ValueError::new("/paused", &value, "true or false"))
            })
            .transpose()?,
        wind_rate: members
            .optional::<Value>("wind_rate")?
            .map(|value| Option::<f64>::read_json(&value, "/wind_rate"))
            .transpose()?,
    };
    if let Some(date) = members.optional::<Moment>("date")? {
        let refused =
            |allowed: &str| ValueError::new("/date", &Value::from(date.to_string()), allowed);
        if wanted.sky_s.is_some() {
            return Err(refused(
                "nothing beside sky_s: one of the two sets the clock",
            ));
        }
        let Some(place) = snapshot.scene.sun().place_and_time() else {
            return Err(refused(
                "nothing while the sun stands by hand: set /sun/place_and_time, or set sky_s",
            ));
        };
        wanted.sky_s = Some(date.seconds_since(place.date_at(0.0)));
    }
    Ok(wanted)
}

/// Which moment is asked for.
#[derive(Debug, Deserialize)]
pub(super) struct MomentQuery {
    at: Option<String>,
}

/// The scene of a moment: what every server with this document shows then.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct SceneNow {
    #[serde(flatten)]
    time: TimeReport,
    /// East, up and south, m, where the wind has carried each layer.
    carried_m: Vec<[f64; 3]>,
    /// What is shown: a still scene.
    scene: SceneDocument,
}

pub(super) async fn now(
    State(context): State<Arc<StreamContext>>,
    Query(query): Query<MomentQuery>,
) -> Result<Response, Problem> {
    let at = match query.at.as_deref() {
        None => clock::now(),
        Some(text) => read_moment(text).map_err(Problem::bad_value)?,
    };
    let snapshot = context.scene.snapshot();
    let shown = snapshot.scene.at(at);
    let carried_m = (0..shown.layers().len())
        .map(|index| shown.carried_m(index))
        .map(|carried| carried.to_array())
        .collect();
    let report = SceneNow {
        time: TimeReport::of(&snapshot, at),
        carried_m,
        scene: shown.to_document(),
    };
    Ok((etag(&snapshot), Json(report)).into_response())
}

/// A moment of an address: a date, or seconds.
fn read_moment(text: &str) -> Result<Moment, SceneError> {
    let value = text
        .parse::<f64>()
        .map_or_else(|_| Value::from(text), Value::from);
    Moment::read_json(&value, "/at")
}
