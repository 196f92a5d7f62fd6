//! `/api/v1/scene/revisions` and `/revert`: what the scene was, and the way back.

use std::sync::Arc;

use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use skycell_protocol::ValueError;
use skycell_protocol::number_range::NumberRange;
use skycell_protocol::read_json::ObjectReader;
use skycell_protocol::scene::ranges;

use super::Problem;
use super::scene::{change, document, is_known, not_modified, read_json_body, read_precondition};
use crate::scene::{REVISIONS_MAX, Revision, SceneSnapshot};
use crate::stream::StreamContext;

/// How many revisions a page of the list may have.
pub(super) const LIMIT: NumberRange = NumberRange::new(1.0, REVISIONS_MAX as f64);
/// How many it has when nobody says.
pub(super) const LIMIT_DEFAULT: u32 = 20;

/// What may stand behind the question mark.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PageQuery {
    /// How many.
    limit: Option<u32>,
    /// Only older ones than this.
    before: Option<u64>,
}

/// A page of the list, newest first.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(rename = "RevisionPage")]
pub(super) struct Page<'a> {
    /// The present scene's.
    revision: u64,
    revisions: Vec<&'a Revision>,
    /// What to ask for as `before` to see the next page; null on the last one.
    next_before: Option<u64>,
}

/// What is kept, without the documents.
pub(super) async fn list(
    State(context): State<Arc<StreamContext>>,
    Query(query): Query<PageQuery>,
) -> Result<Response, Problem> {
    let limit = LIMIT
        .check_u32("/limit", query.limit.unwrap_or(LIMIT_DEFAULT))
        .map_err(Problem::bad_value)? as usize;
    let kept = context.scene.revisions();
    let revision = kept.last().map_or(0, |newest| newest.revision);
    let mut asked = kept
        .iter()
        .map(Arc::as_ref)
        .rev()
        .filter(|kept: &&Revision| query.before.is_none_or(|before| kept.revision < before));
    let revisions: Vec<&Revision> = asked.by_ref().take(limit).collect();
    let next_before = asked
        .next()
        .and(revisions.last())
        .map(|oldest| oldest.revision);
    let page = Page {
        revision,
        revisions,
        next_before,
    };
    Ok(Json(page).into_response())
}

/// The document of a revision.
pub(super) async fn get(
    State(context): State<Arc<StreamContext>>,
    Path(revision): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let found = revision
        .parse()
        .ok()
        .and_then(|number| context.scene.revision(number));
    let Some(found) = found else {
        return Err(Problem::new(
            StatusCode::NOT_FOUND,
            format!(
                "no such revision is kept: the last {REVISIONS_MAX} are; /api/v1/scene/revisions lists them"
            ),
        ));
    };
    let tag = super::scene::tag_of(found.revision);
    if is_known(&headers, &tag) {
        return Ok(not_modified(tag));
    }
    Ok(document(&SceneSnapshot {
        scene: Arc::clone(&found.scene),
        revision: found.revision,
    }))
}

/// Brings a revision back: `{"revision": 12, "transition_s": 5}`; without a revision, or a body, the last change is undone.
pub(super) async fn revert(
    State(context): State<Arc<StreamContext>>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Response, Problem> {
    let precondition = read_precondition(&headers)?;
    let body = match body {
        Ok(bytes) if bytes.is_empty() => json!({}),
        body => read_json_body(&headers, body)?,
    };
    let (revision, transition_s) = read_choice(&body).map_err(Problem::bad_value)?;
    let snapshot = change(&context, move |scene| {
        scene.revert(&precondition, revision, transition_s)
    })
    .await?;
    Ok(document(&snapshot))
}

fn read_choice(body: &Value) -> Result<(Option<u64>, f64), ValueError> {
    let members = ObjectReader::new(body, "")?;
    members.only(&["revision", "transition_s"])?;
    let revision = members.member_or("revision", None)?;
    let transition_s = members.member_or("transition_s", 0.0)?;
    Ok((
        revision,
        ranges::TRANSITION_S.check("/transition_s", transition_s)?,
    ))
}
