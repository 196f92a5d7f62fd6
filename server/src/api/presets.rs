//! `/api/v1/presets` and `/api/v1/scene/preset`: skies by name.

use std::sync::Arc;

use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use skycell_protocol::read_json::ObjectReader;
use skycell_protocol::scene::{SceneDocument, ranges};
use skycell_protocol::{Camera, ValueError};

use super::Problem;
use super::scene::{change, document, read_json_body, read_precondition};
use crate::scene::{Preset, preset, presets};
use crate::stream::StreamContext;

/// How long a sky takes to become a preset when nobody says.
pub(super) const TRANSITION_S: f64 = 10.0;

/// Names, titles and cameras of all presets.
pub(super) async fn list() -> Json<&'static [Preset]> {
    Json(presets())
}

#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct WholePreset<'a> {
    name: &'a str,
    title: &'a str,
    about: &'a str,
    camera: &'a Camera,
    scene: SceneDocument,
}

/// One preset with its scene.
pub(super) async fn get(Path(name): Path<String>) -> Result<Response, Problem> {
    let Some(preset) = preset(&name) else {
        return Err(Problem::new(
            StatusCode::NOT_FOUND,
            "no preset has this name; /api/v1/presets lists them",
        ));
    };
    let whole = WholePreset {
        name: &preset.name,
        title: &preset.title,
        about: &preset.about,
        camera: &preset.camera,
        scene: preset.scene.to_document(),
    };
    Ok(Json(whole).into_response())
}

/// Makes the sky a preset's: `{"name": …, "transition_s": 10}`.
pub(super) async fn set(
    State(context): State<Arc<StreamContext>>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Response, Problem> {
    let precondition = read_precondition(&headers)?;
    let body = read_json_body(&headers, body)?;
    let (preset, transition_s) = read_choice(&body).map_err(Problem::bad_value)?;
    let snapshot = change(&context, move |scene| {
        scene.set_preset(&precondition, preset, transition_s)
    })
    .await?;
    Ok(document(&snapshot))
}

fn read_choice(body: &Value) -> Result<(&'static Preset, f64), ValueError> {
    let members = ObjectReader::new(body, "")?;
    members.only(&["name", "transition_s"])?;
    let preset = members.required("name", "the name of a preset")?;
    let transition_s = members.member_or("transition_s", TRANSITION_S)?;
    Ok((
        preset,
        ranges::TRANSITION_S.check("/transition_s", transition_s)?,
    ))
}
