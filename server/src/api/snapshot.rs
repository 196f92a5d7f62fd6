//! `/api/v1/snapshot`: a picture of the sky as it is now, from wherever one asks.
//!
//! A snapshot is a viewer for a moment: it joins, belongs to the view cell of where it stands, reads its caches and adds to
//! them what it needs, takes the first frame that has settled, and leaves. Others are served as beside any viewer.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::extract::{Query, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE, HeaderName, HeaderValue, RETRY_AFTER, VARY};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Deserialize;
use skycell_protocol::frame::FRAME_HEADER_BYTES;
use skycell_protocol::{Camera, Codec, FrameHeader, FrameSize, RendererKind, Show, ValueError};
use tokio::sync::Semaphore;

use super::Problem;
use super::picture_format::picture_format;
use crate::field::MapFileFormat;
use crate::frame_loop::interface::{FRAMES_IN_FLIGHT_MAX, RenderCommand, ViewRequest};
use crate::stream::{LeaveOnDrop, StreamContext};

/// How many may wait for their turn, beside the one that is made.
pub(super) const WAITING_MAX: usize = 4;

/// How long a snapshot may wait for its turn and for its frame.
pub(super) const TIMEOUT: Duration = Duration::from_secs(30);

/// A sky that moves is never at rest: a frame in which nothing is coarse any more is taken after this long.
const SETTLING: Duration = Duration::from_secs(2);

/// Frames that a snapshot looks at in a second.
const FRAMES_PER_SECOND: f64 = 10.0;

/// How many pixels a picture may have: those of 1920 x 1080.
pub(super) const PIXELS_MAX: u32 = 1920 * 1080;

/// The size where nobody says.
pub(super) const SIZE: [u32; 2] = [640, 360];

const ENDING: &str = "the server is shutting down";
const WHAT: &str =
    "a snapshot is image/png (as it is shown) or image/x-exr (linear radiance, 32-bit floats)";
const SCENE_REVISION: HeaderName = HeaderName::from_static("skycell-scene-revision");
const EXACT: HeaderName = HeaderName::from_static("skycell-exact");

/// Who may wait for a snapshot, and whose turn it is.
pub struct SnapshotQueue {
    places: Semaphore,
    turn: Semaphore,
}

impl Default for SnapshotQueue {
    fn default() -> Self {
        Self {
            places: Semaphore::new(1 + WAITING_MAX),
            turn: Semaphore::new(1),
        }
    }
}

/// What may stand behind the question mark: a camera, a size and a format; what is left out is as for a new viewer.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SnapshotQuery {
    x_m: Option<f64>,
    altitude_m: Option<f64>,
    z_m: Option<f64>,
    yaw_deg: Option<f64>,
    pitch_deg: Option<f64>,
    fov_deg: Option<f64>,
    width: Option<u32>,
    height: Option<u32>,
    format: Option<String>,
}

pub(super) fn routes() -> Router<Arc<StreamContext>> {
    Router::new().route("/api/v1/snapshot", get(snapshot))
}

async fn snapshot(
    State(context): State<Arc<StreamContext>>,
    Query(query): Query<SnapshotQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let format = picture_format(query.format.as_deref(), &headers, WHAT)?;
    let view = ViewRequest {
        linear: format == MapFileFormat::Exr,
        ..view_of(&query).map_err(Problem::bad_value)?
    };
    if context.draining.is_cancelled() {
        return Err(unavailable(ENDING));
    }
    let _place = context.snapshots.places.try_acquire().map_err(|_| {
        Problem::new(
            StatusCode::TOO_MANY_REQUESTS,
            format!("{WAITING_MAX} snapshots wait already; try again later"),
        )
        .with_header(RETRY_AFTER, HeaderValue::from(1))
    })?;
    let made = async {
        let _turn = context.snapshots.turn.acquire().await;
        picture(&context, view).await
    };
    let (header, file) = tokio::select! {
        made = tokio::time::timeout(TIMEOUT, made) => made.unwrap_or_else(|_| {
            Err(unavailable("no frame was ready in time; try again later"))
        })?,
        () = context.shutdown.cancelled() => {
            return Err(unavailable(ENDING));
        }
    };
    let mut response = axum::body::Body::from(file).into_response();
    let told = response.headers_mut();
    told.insert(CONTENT_TYPE, HeaderValue::from_static(format.media_type()));
    told.insert(VARY, HeaderValue::from_static("accept"));
    // The next one is another.
    told.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    told.insert(SCENE_REVISION, HeaderValue::from(header.scene_revision));
    told.insert(
        EXACT,
        HeaderValue::from_static(if header.exact { "true" } else { "false" }),
    );
    Ok(response)
}

fn unavailable(why: impl Into<String>) -> Problem {
    Problem::new(StatusCode::SERVICE_UNAVAILABLE, why)
}

fn view_of(query: &SnapshotQuery) -> Result<ViewRequest, ValueError> {
    let usual = Camera::default();
    let [x_m, altitude_m, z_m] = usual.position_m();
    let camera = Camera::new(
        [
            query.x_m.unwrap_or(x_m),
            query.altitude_m.unwrap_or(altitude_m),
            query.z_m.unwrap_or(z_m),
        ],
        query.yaw_deg.unwrap_or(usual.yaw_deg()),
        query.pitch_deg.unwrap_or(usual.pitch_deg()),
        query.fov_deg.unwrap_or(usual.vertical_fov_deg()),
    )
    .map_err(named_as_in_the_query)?;
    let size = FrameSize::new(
        query.width.unwrap_or(SIZE[0]),
        query.height.unwrap_or(SIZE[1]),
    )?;
    if size.pixels() > PIXELS_MAX {
        return Err(ValueError::of_number(
            "/width",
            size.width().into(),
            format!("at most {PIXELS_MAX} pixels in all"),
        ));
    }
    Ok(ViewRequest {
        size,
        fps: FRAMES_PER_SECOND,
        codec: Codec::Png,
        jpeg_quality: 85,
        camera,
        renderer: RendererKind::Cached,
        quality: None,
        show: Show::Picture,
        stereo: None,
        haze: false,
        linear: false,
    })
}

/// A camera's own names are not those of the query.
fn named_as_in_the_query(error: ValueError) -> ValueError {
    let pointer = match error.pointer.as_str() {
        "/position_m/0" => "/x_m",
        "/position_m/1" => "/altitude_m",
        "/position_m/2" => "/z_m",
        "/vertical_fov_deg" => "/fov_deg",
        other => other,
    };
    ValueError {
        pointer: pointer.to_owned(),
        ..error
    }
}

/// The first frame that has settled, as PNG or EXR.
async fn picture(
    context: &StreamContext,
    view: ViewRequest,
) -> Result<(FrameHeader, bytes::Bytes), Problem> {
    let viewer = context
        .viewers
        .join(view)
        .map_err(|error| unavailable(error.to_string()))?;
    let gone = |error| unavailable(format!("the renderer takes no viewer: {error}"));
    let id = viewer.id();
    context
        .frame_loop
        .send(RenderCommand::Join { viewer: id, view })
        .map_err(gone)?;
    let _leave = LeaveOnDrop::new(context.frame_loop.clone(), id);
    let mut fine_since = None;
    loop {
        let frame = tokio::select! {
            frame = viewer.outbox().next() => frame,
            () = viewer.failure() => return Err(Problem::new(
                StatusCode::INTERNAL_SERVER_ERROR,
                "the frame could not be encoded; the server's log tells why",
            )),
        };
        let (header, message) = frame.into_message(Instant::now());
        if !header.coarse {
            let since = *fine_since.get_or_insert_with(Instant::now);
            if header.exact || since.elapsed() >= SETTLING {
                return Ok((header, message.slice(FRAME_HEADER_BYTES..)));
            }
        }
        context
            .frame_loop
            .send(RenderCommand::Acknowledge {
                viewer: id,
                sequence: header.sequence,
                frames_in_flight_max: FRAMES_IN_FLIGHT_MAX,
            })
            .map_err(gone)?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn query() -> SnapshotQuery {
        SnapshotQuery {
            x_m: None,
            altitude_m: None,
            z_m: None,
            yaw_deg: None,
            pitch_deg: None,
            fov_deg: None,
            width: None,
            height: None,
            format: None,
        }
    }

    #[test]
    fn what_is_left_out_is_as_for_a_new_viewer_and_errors_name_the_query() {
        let view = view_of(&query()).expect("a view");
        assert_eq!(view.camera, Camera::default());
        assert_eq!([view.size.width(), view.size.height()], SIZE);
        for (bad, pointer) in [
            (
                SnapshotQuery {
                    x_m: Some(f64::NAN),
                    ..query()
                },
                "/x_m",
            ),
            (
                SnapshotQuery {
                    altitude_m: Some(1e9),
                    ..query()
                },
                "/altitude_m",
            ),
            (
                SnapshotQuery {
                    fov_deg: Some(0.0),
                    ..query()
                },
                "/fov_deg",
            ),
            (
                SnapshotQuery {
                    height: Some(0),
                    ..query()
                },
                "/height",
            ),
            (
                SnapshotQuery {
                    width: Some(3840),
                    height: Some(2160),
                    ..query()
                },
                "/width",
            ),
        ] {
            assert_eq!(view_of(&bad).expect_err("bad").pointer, pointer);
        }
    }
}
