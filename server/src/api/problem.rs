//! Errors as `application/problem+json` (RFC 9457), whoever makes them.

use axum::body::to_bytes;
use axum::http::header::{CONTENT_LENGTH, CONTENT_TYPE, HeaderValue};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use schemars::JsonSchema;
use serde::Serialize;
use skycell_protocol::ValueError;

use crate::access::Role;

const PROBLEM_JSON: &str = "application/problem+json";

/// How much of an error's plain text is taken over.
const DETAIL_MAX_BYTES: usize = 4096;

/// An error of the HTTP interface.
#[derive(Debug, Serialize, JsonSchema)]
pub struct Problem {
    /// Names the kind of problem; `about:blank` is that of the status.
    #[serde(rename = "type")]
    kind: &'static str,
    /// The status in words.
    title: &'static str,
    /// The HTTP status.
    status: u16,
    /// What is wrong with this request.
    detail: String,
    #[serde(flatten)]
    value: Option<Box<BadValue>>,
    /// The role that the request needs, if its token has another.
    #[serde(skip_serializing_if = "Option::is_none")]
    role_needed: Option<&'static str>,
    #[serde(skip)]
    headers: Box<HeaderMap>,
}

/// Which value of the request is not allowed.
#[derive(Debug, Serialize, JsonSchema)]
struct BadValue {
    /// JSON pointer of the value.
    pointer: String,
    /// The value as JSON text, cut after 80 characters; `missing` where there is none.
    value: String,
    /// What may stand there, in words.
    allowed: String,
}

impl Problem {
    /// A problem of an HTTP status, with what is to be done about it.
    pub fn new(status: StatusCode, detail: impl Into<String>) -> Self {
        Self {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or("Error"),
            status: status.as_u16(),
            detail: detail.into(),
            value: None,
            role_needed: None,
            headers: Box::default(),
        }
    }

    /// A value of the document is not allowed: members `pointer`, `value` and `allowed` tell.
    pub fn bad_value(error: ValueError) -> Self {
        let mut problem = Self::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string());
        problem.value = Some(Box::new(BadValue {
            pointer: error.pointer,
            value: error.value,
            allowed: error.allowed,
        }));
        problem
    }

    /// The problem with another status.
    #[must_use]
    pub fn with_status(mut self, status: StatusCode) -> Self {
        self.status = status.as_u16();
        self.title = status.canonical_reason().unwrap_or("Error");
        self
    }

    /// The problem with the role that the request needs.
    #[must_use]
    pub fn with_role_needed(mut self, role: Role) -> Self {
        self.role_needed = Some(role.name());
        self
    }

    /// The problem with a header for whoever tries again.
    #[must_use]
    pub fn with_header(mut self, name: axum::http::HeaderName, value: HeaderValue) -> Self {
        self.headers.insert(name, value);
        self
    }
}

impl IntoResponse for Problem {
    fn into_response(mut self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        // Strings and numbers only, so that writing them cannot fail; an empty body would still
        // leave the status.
        let body = serde_json::to_vec(&self).unwrap_or_default();
        let mut headers = *std::mem::take(&mut self.headers);
        headers.insert(CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        (status, headers, body).into_response()
    }
}

/// Makes a problem of every error that is none yet: those of axum, tower-http and hyper are plain
/// text.
pub(super) async fn unify(response: Response) -> Response {
    let status = response.status();
    let is_error = status.is_client_error() || status.is_server_error();
    let is_problem = response
        .headers()
        .get(CONTENT_TYPE)
        .is_some_and(|kind| kind.as_bytes() == PROBLEM_JSON.as_bytes());
    if !is_error || is_problem {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    let text = to_bytes(body, DETAIL_MAX_BYTES).await.unwrap_or_default();
    let detail = String::from_utf8_lossy(&text).trim().to_owned();
    parts.headers.remove(CONTENT_TYPE);
    parts.headers.remove(CONTENT_LENGTH);
    let mut problem = Problem::new(status, detail);
    *problem.headers = parts.headers;
    problem.into_response()
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    #[tokio::test]
    async fn a_plain_error_becomes_a_problem_and_keeps_its_headers() {
        let plain = Response::builder()
            .status(StatusCode::METHOD_NOT_ALLOWED)
            .header("allow", "GET")
            .header(CONTENT_TYPE, "text/plain")
            .body(Body::from("no such method"))
            .expect("a response");
        let response = unify(plain).await;
        assert_eq!(response.headers()["allow"], "GET");
        assert_eq!(response.headers()[CONTENT_TYPE], PROBLEM_JSON);
        let body = to_bytes(response.into_body(), 1000).await.expect("a body");
        let value: serde_json::Value = serde_json::from_slice(&body).expect("JSON");
        assert_eq!(
            value,
            serde_json::json!({
                "type": "about:blank", "title": "Method Not Allowed", "status": 405,
                "detail": "no such method"
            })
        );
    }
}
