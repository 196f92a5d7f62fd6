//! `/api/v1/scene/maps/{coverage,type,profile}`: the maps of a layer as pictures.

use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::{DefaultBodyLimit, Path, Query, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE, ETAG, HeaderValue, VARY};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::StreamExt;
use serde::Deserialize;
use skycell_protocol::scene::MapKind;
use tokio::sync::{Semaphore, SemaphorePermit};

use super::Problem;
use super::picture_format::picture_format;
use super::scene::{document, is_known, not_modified, problem_of, read_precondition, tag_of};
use crate::field::MAP_FILE_MAX_BYTES;
use crate::scene::{MapChoice, ScenePatchError, SceneSnapshot};
use crate::stream::StreamContext;

/// A map of 8192 x 8192 takes hundreds of MiB while it is read or written: one at a time.
static MAP_WORK: Semaphore = Semaphore::const_new(1);

/// How much of a file that is too long is read and dropped.
const DISCARDED_MAX_BYTES: u64 = 4 * MAP_FILE_MAX_BYTES;

/// What a map is, for who asks for something else.
const WHAT: &str = "a map is image/png (16 bits) or image/x-exr (32-bit floats)";

/// What may stand behind the question mark.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MapQuery {
    layer: Option<String>,
    transition_s: Option<f64>,
    format: Option<String>,
}

pub(super) fn routes() -> Router<Arc<StreamContext>> {
    Router::new()
        .route(
            "/api/v1/scene/maps/{kind}",
            get(read).put(replace).delete(reset),
        )
        // The handler bounds what it reads, by the length of a map.
        .layer(DefaultBodyLimit::disable())
}

fn choice(kind: &str, query: &MapQuery) -> Result<MapChoice, Problem> {
    let kind: MapKind = kind
        .parse()
        .map_err(|reason: String| Problem::new(StatusCode::NOT_FOUND, reason))?;
    Ok(MapChoice {
        kind,
        layer: query.layer.clone(),
    })
}

async fn turn() -> Result<SemaphorePermit<'static>, Problem> {
    // The semaphore is never closed.
    MAP_WORK
        .acquire()
        .await
        .map_err(|_| Problem::new(StatusCode::SERVICE_UNAVAILABLE, "the server is ending"))
}

/// Runs what waits for disk and decoders beside the async tasks.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    tokio::task::spawn_blocking(work)
        .await
        .unwrap_or_else(|error| {
            tracing::error!(%error, "work on a map failed");
            Err(Problem::new(
                StatusCode::INTERNAL_SERVER_ERROR,
                "the server failed; its log tells why",
            ))
        })
}

async fn read(
    State(context): State<Arc<StreamContext>>,
    Path(kind): Path<String>,
    Query(query): Query<MapQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let choice = choice(&kind, &query)?;
    let format = picture_format(query.format.as_deref(), &headers, WHAT)?;
    let tag = tag_of(context.scene.snapshot().revision);
    if is_known(&headers, &tag) {
        return Ok(not_modified(tag));
    }
    let _turn = turn().await?;
    let name = format!("{kind}.{}", format.extension());
    let (snapshot, file) = blocking(move || {
        let (snapshot, map) = context.scene.map(&choice).map_err(problem_of)?;
        let file = map
            .encode(format)
            .map_err(|error| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
        Ok((snapshot, file))
    })
    .await?;
    let mut response = Body::from(file).into_response();
    let told = response.headers_mut();
    told.insert(CONTENT_TYPE, HeaderValue::from_static(format.media_type()));
    told.insert(VARY, HeaderValue::from_static("accept"));
    for (header, value) in [
        (ETAG, tag_of(snapshot.revision)),
        (
            CONTENT_DISPOSITION,
            format!("attachment; filename=\"{name}\""),
        ),
    ] {
        if let Ok(value) = HeaderValue::from_str(&value) {
            told.insert(header, value);
        }
    }
    Ok(response)
}

async fn replace(
    State(context): State<Arc<StreamContext>>,
    Path(kind): Path<String>,
    Query(query): Query<MapQuery>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let choice = choice(&kind, &query)?;
    let precondition = read_precondition(&headers)?;
    let _turn = turn().await?;
    let bytes = read_file(body).await?;
    changed(
        "map replaced",
        blocking(move || {
            context
                .scene
                .put_map(&precondition, &choice, query.transition_s, &bytes)
                .map_err(problem_of)
        })
        .await,
    )
}

/// Reads a file. One that is too long is read to its end and dropped, within reason: a client that is cut off while it
/// sends never hears why.
async fn read_file(body: Body) -> Result<Vec<u8>, Problem> {
    let mut file = Vec::new();
    let mut length = 0;
    let mut parts = body.into_data_stream();
    while let Some(part) = parts.next().await {
        let part = part.map_err(|error| {
            Problem::new(
                StatusCode::BAD_REQUEST,
                format!("the file broke off after {length} bytes: {error}"),
            )
        })?;
        length += part.len() as u64;
        if length <= MAP_FILE_MAX_BYTES {
            file.extend_from_slice(&part);
        } else {
            file = Vec::new();
        }
        if length > DISCARDED_MAX_BYTES {
            break;
        }
    }
    if length > MAP_FILE_MAX_BYTES {
        return Err(Problem::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            format!("a file of {length} bytes; allowed: at most {MAP_FILE_MAX_BYTES} bytes"),
        ));
    }
    Ok(file)
}

async fn reset(
    State(context): State<Arc<StreamContext>>,
    Path(kind): Path<String>,
    Query(query): Query<MapQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let choice = choice(&kind, &query)?;
    let precondition = read_precondition(&headers)?;
    changed(
        "map reset",
        blocking(move || {
            context
                .scene
                .reset_map(&precondition, &choice, query.transition_s)
                .map_err(problem_of)
        })
        .await,
    )
}

/// The scene that names the new map.
fn changed(what: &str, result: Result<SceneSnapshot, Problem>) -> Result<Response, Problem> {
    let snapshot = result?;
    tracing::info!(revision = snapshot.revision, "{what}");
    Ok(document(&snapshot))
}

/// What is wrong with a file, as a problem.
pub(super) fn map_problem(pointer: String, error: &crate::field::MapFileError) -> Problem {
    use crate::field::MapFileError::{NoImage, TooLong};
    let status = match error {
        TooLong { .. } => StatusCode::PAYLOAD_TOO_LARGE,
        NoImage { .. } => StatusCode::UNSUPPORTED_MEDIA_TYPE,
        _ => StatusCode::UNPROCESSABLE_ENTITY,
    };
    Problem::bad_value(error.at(pointer)).with_status(status)
}

/// There is no room for a file.
pub(super) fn full_problem(error: &ScenePatchError) -> Problem {
    Problem::new(StatusCode::INSUFFICIENT_STORAGE, error.to_string())
}
