//! `/api/v1/openapi.json`: what the HTTP interface is, as an OpenAPI 3.1 document, and `/api/v1/docs`, the same for people.
//!
//! Schemas are made from the types that are read and written; paths stand in [`paths`]. The tests `edge` compare the
//! document with what the server answers.

mod operation;
mod page;
mod paths;
mod schemas;

use std::sync::LazyLock;

use axum::http::header::{CONTENT_TYPE, ETAG, HeaderMap, HeaderValue};
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};
use xxhash_rust::xxh3::xxh3_64;

use super::scene::{is_known, not_modified};

static DOCUMENT: LazyLock<Fixed> =
    LazyLock::new(|| Fixed::new("application/json", value().to_string()));

static PAGE: LazyLock<Fixed> =
    LazyLock::new(|| Fixed::new("text/html; charset=utf-8", page::of(&value())));

/// The document.
fn value() -> Value {
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Skycell",
            "version": env!("CARGO_PKG_VERSION"),
            "summary": "One sky, rendered once and shown to many.",
            "description": "The scene that a server shows, its clock, its maps, and what the service does in numbers. \
                Frames come over the WebSocket `/ws`. Every resource that is read with GET answers HEAD, too. Errors are \
                problem documents (RFC 9457). Numbers of a scene have `x-unit`, the unit that their key ends with.",
            "license": {"name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0"},
        },
        "jsonSchemaDialect": "https://json-schema.org/draft/2020-12/schema",
        "servers": [{"url": "/", "description": "This server."}],
        "tags": paths::tags(),
        "paths": paths::paths(),
        "components": {
            "schemas": schemas::all(),
            "securitySchemes": {(paths::TOKEN): {
                "type": "http",
                "scheme": "bearer",
                "description": "Where the server has tokens: one with the role that the operation names (view, steer, admin), or a \
                    higher one.",
            }},
        },
    })
}

pub(super) async fn document(headers: HeaderMap) -> Response {
    DOCUMENT.answer(&headers)
}

pub(super) async fn page(headers: HeaderMap) -> Response {
    PAGE.answer(&headers)
}

/// A text that stays the same as long as the server runs.
struct Fixed {
    kind: &'static str,
    text: String,
    tag: String,
}

impl Fixed {
    fn new(kind: &'static str, text: String) -> Self {
        let tag = format!("\"{:016x}\"", xxh3_64(text.as_bytes()));
        Self { kind, text, tag }
    }

    fn answer(&'static self, headers: &HeaderMap) -> Response {
        if is_known(headers, &self.tag) {
            return not_modified(self.tag.clone());
        }
        let mut response = self.text.as_str().into_response();
        let told = response.headers_mut();
        told.insert(CONTENT_TYPE, HeaderValue::from_static(self.kind));
        if let Ok(tag) = HeaderValue::from_str(&self.tag) {
            told.insert(ETAG, tag);
        }
        response
    }
}
