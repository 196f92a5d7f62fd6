//! `/api/v1/scene`: the scene document, its revision as ETag, changes as merge patches and JSON patches.

use std::sync::Arc;

use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{Extension, Query, State};
use axum::http::header::{
    ACCEPT, CONTENT_TYPE, ETAG, HeaderName, HeaderValue, IF_MATCH, IF_NONE_MATCH,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::Value;

use super::{Problem, maps};
use crate::access::Peer;
use crate::scene::{
    ChangeGroup, Precondition, SceneJsonPatch, ScenePatchError, SceneSnapshot, SceneStore,
};
use crate::stream::StreamContext;

pub(super) const MERGE_PATCH: &str = "application/merge-patch+json";
pub(super) const JSON_PATCH: &str = "application/json-patch+json";
/// What `PATCH` takes, as the header `Accept-Patch` tells it.
const PATCHES: &str = "application/merge-patch+json, application/json-patch+json";
const JSON: &str = "application/json";
const ACCEPT_PATCH: HeaderName = HeaderName::from_static("accept-patch");

/// The whole document.
pub(super) async fn get(State(context): State<Arc<StreamContext>>, headers: HeaderMap) -> Response {
    let snapshot = context.scene.snapshot();
    let tag = tag_of(snapshot.revision);
    if is_known(&headers, &tag) {
        return not_modified(tag);
    }
    document(&snapshot)
}

/// Whether the client says that it has what the tag stands for.
pub(super) fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    headers
        .get_all(IF_NONE_MATCH)
        .iter()
        .filter_map(|header| header.to_str().ok())
        .flat_map(|list| list.split(','))
        .map(|item| item.trim().trim_start_matches("W/"))
        .any(|item| item == "*" || item == tag)
}

pub(super) fn not_modified(tag: String) -> Response {
    (StatusCode::NOT_MODIFIED, [(ETAG, tag)]).into_response()
}

/// What may stand behind the question mark of a change.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ChangeQuery {
    /// The changes to which it belongs: together they are one revision to whoever looks back.
    group: Option<String>,
}

impl ChangeQuery {
    /// The group that is asked for, of who asks.
    pub(super) fn group_of(&self, peer: Peer) -> Result<Option<ChangeGroup>, Problem> {
        let group = self.group.as_deref();
        group
            .map(|name| ChangeGroup::new(peer.key.to_string(), name))
            .transpose()
            .map_err(Problem::bad_value)
    }
}

/// Changes the document, by a patch of the kind that the content type tells.
pub(super) async fn patch(
    State(context): State<Arc<StreamContext>>,
    Extension(peer): Extension<Peer>,
    Query(query): Query<ChangeQuery>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Response, Problem> {
    let kind = [MERGE_PATCH, JSON_PATCH]
        .into_iter()
        .find(|kind| essence_of(&headers).eq_ignore_ascii_case(kind))
        .ok_or_else(|| wrong_content_type(&headers, PATCHES))?;
    let precondition = read_precondition(&headers)?;
    let group = query.group_of(peer)?;
    let body = body.map_err(|rejection| Problem::new(rejection.status(), rejection.body_text()))?;
    let patch: Value = serde_json::from_slice(&body).map_err(|error| {
        Problem::new(
            StatusCode::BAD_REQUEST,
            format!("the patch is not JSON: {error}"),
        )
    })?;
    let snapshot = if kind == JSON_PATCH {
        let patch = SceneJsonPatch::from_json(&patch)
            .map_err(|error| Problem::bad_value(error).with_status(StatusCode::BAD_REQUEST))?;
        change(&context, move |scene| {
            scene.apply(&precondition, &patch, group)
        })
        .await?
    } else {
        change(&context, move |scene| {
            scene.patch_in(&precondition, &patch, group)
        })
        .await?
    };
    Ok(document(&snapshot))
}

/// Changes the scene where waiting for the disk, which may be slow, holds nobody up.
pub(super) async fn change(
    context: &StreamContext,
    change: impl FnOnce(&SceneStore) -> Result<SceneSnapshot, ScenePatchError> + Send + 'static,
) -> Result<SceneSnapshot, Problem> {
    let scene = Arc::clone(&context.scene);
    let span = tracing::trace_span!(
        target: crate::traces::TARGET,
        "scene change",
        skycell.revision = tracing::field::Empty,
    );
    let told = span.clone();
    match tokio::task::spawn_blocking(move || span.in_scope(|| change(&scene))).await {
        Ok(Ok(snapshot)) => {
            told.record("skycell.revision", snapshot.revision);
            tracing::info!(revision = snapshot.revision, "scene changed");
            Ok(snapshot)
        }
        Ok(Err(error)) => Err(problem_of(error)),
        Err(error) => {
            tracing::error!(%error, "changing the scene failed");
            Err(Problem::new(
                StatusCode::INTERNAL_SERVER_ERROR,
                "the server failed; its log tells why",
            ))
        }
    }
}

/// Reads a body of `application/json`.
pub(super) fn read_json_body(
    headers: &HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Value, Problem> {
    check_content_type(headers, JSON)?;
    let body = body.map_err(|rejection| Problem::new(rejection.status(), rejection.body_text()))?;
    serde_json::from_slice(&body).map_err(|error| {
        Problem::new(
            StatusCode::BAD_REQUEST,
            format!("the body is not JSON: {error}"),
        )
    })
}

/// The revision as a header.
pub(super) fn etag(snapshot: &SceneSnapshot) -> [(HeaderName, String); 1] {
    [(ETAG, tag_of(snapshot.revision))]
}

pub(super) fn document(snapshot: &SceneSnapshot) -> Response {
    (
        [
            (ETAG, tag_of(snapshot.revision)),
            (ACCEPT_PATCH, PATCHES.to_owned()),
        ],
        Json(snapshot.scene.to_document()),
    )
        .into_response()
}

pub(super) fn tag_of(revision: u64) -> String {
    format!("\"{revision}\"")
}

fn check_content_type(headers: &HeaderMap, wanted: &'static str) -> Result<(), Problem> {
    if essence_of(headers).eq_ignore_ascii_case(wanted) {
        Ok(())
    } else {
        Err(wrong_content_type(headers, wanted))
    }
}

/// The content type without its parameters; empty where there is none.
fn essence_of(headers: &HeaderMap) -> &str {
    headers
        .get(CONTENT_TYPE)
        .and_then(|header| header.to_str().ok())
        .and_then(|text| text.split(';').next())
        .unwrap_or_default()
        .trim()
}

fn wrong_content_type(headers: &HeaderMap, wanted: &'static str) -> Problem {
    let found = match essence_of(headers) {
        "" => "none",
        other => other,
    };
    let problem = Problem::new(
        StatusCode::UNSUPPORTED_MEDIA_TYPE,
        format!("Content-Type must be {wanted}; found: {found}"),
    )
    .with_header(ACCEPT, HeaderValue::from_static(wanted));
    if wanted == PATCHES {
        problem.with_header(ACCEPT_PATCH, HeaderValue::from_static(PATCHES))
    } else {
        problem
    }
}

pub(super) fn read_precondition(headers: &HeaderMap) -> Result<Precondition, Problem> {
    if !headers.contains_key(IF_MATCH) {
        return Err(Problem::new(
            StatusCode::PRECONDITION_REQUIRED,
            "send the ETag of the scene that you have seen as If-Match, or * to overwrite whatever \
             there is",
        ));
    }
    let mut revisions = Vec::new();
    for header in headers.get_all(IF_MATCH) {
        for item in header.to_str().unwrap_or_default().split(',') {
            let item = item.trim();
            if item == "*" {
                return Ok(Precondition::Any);
            }
            // A tag that is none of ours (weak, or of something else) matches nothing.
            if let Some(revision) = item
                .strip_prefix('"')
                .and_then(|rest| rest.strip_suffix('"'))
                .and_then(|number| number.parse().ok())
            {
                revisions.push(revision);
            }
        }
    }
    Ok(Precondition::OneOf(revisions))
}

pub(super) fn problem_of(error: ScenePatchError) -> Problem {
    match error {
        ScenePatchError::Stale { current } => {
            let problem = Problem::new(
                StatusCode::PRECONDITION_FAILED,
                format!("the scene has changed: its ETag is {}", tag_of(current)),
            );
            match HeaderValue::from_str(&tag_of(current)) {
                Ok(tag) => problem.with_header(ETAG, tag),
                Err(_) => problem,
            }
        }
        ScenePatchError::Invalid(error) => Problem::bad_value(error),
        ScenePatchError::NothingToUndo { .. } => {
            Problem::new(StatusCode::CONFLICT, error.to_string())
        }
        ScenePatchError::Conflict(error) => {
            Problem::bad_value(error).with_status(StatusCode::CONFLICT)
        }
        ScenePatchError::BadMap { pointer, error } => maps::map_problem(pointer, &error),
        ScenePatchError::MapsFull { .. } => maps::full_problem(&error),
        ScenePatchError::NotKept(error) => {
            tracing::error!(%error, "the scene cannot be kept");
            Problem::new(
                StatusCode::INTERNAL_SERVER_ERROR,
                "the scene cannot be written to disk, so it was not changed; the server's log \
                 tells why",
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn precondition(values: &[&'static str]) -> Option<Precondition> {
        let mut headers = HeaderMap::new();
        for value in values {
            headers.append(IF_MATCH, HeaderValue::from_static(value));
        }
        read_precondition(&headers).ok()
    }

    #[test]
    fn if_match_lists_revisions_and_weak_tags_match_nothing() {
        assert_eq!(precondition(&[]), None);
        assert_eq!(precondition(&["*"]), Some(Precondition::Any));
        assert_eq!(
            precondition(&["\"3\", \"5\"", "W/\"7\", \"x\", 9"]),
            Some(Precondition::OneOf(vec![3, 5]))
        );
    }
}
