//! The server's HTTP API, as far as clients use it.

use std::time::Duration;

use reqwest::{Method, Response, StatusCode, header};
use serde::Deserialize;
use serde_json::{Value, json};
use skycell_protocol::scene::MapKind;
use thiserror::Error;

use crate::{ServerAddress, ServerStats};

const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// A change of the scene may wait for maps that have to be made first.
const CHANGE_TIMEOUT: Duration = Duration::from_secs(70);
/// A scene has a few kB, the counters of a full server some hundred.
const BODY_MAX_BYTES: usize = 8 << 20;
/// A map of 8192 x 8192 floats, and what is around it.
const MAP_MAX_BYTES: usize = 300 << 20;
/// Maps are long, and the server reads one at a time.
const MAP_TIMEOUT: Duration = Duration::from_secs(130);
/// A snapshot waits for its turn and for caches.
const SNAPSHOT_TIMEOUT: Duration = Duration::from_secs(45);
/// EXR of 1920 x 1080 pixels of noise, and what is around it.
const SNAPSHOT_MAX_BYTES: usize = 32 << 20;
const MERGE_PATCH: &str = "application/merge-patch+json";
/// How often a patch without an own precondition is tried when others patch at the same time.
const PATCH_TRIES: u32 = 5;

/// A scene document and the revision it is.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneRevision {
    /// The entity tag as the server wrote it, quotes included.
    pub etag: String,
    /// The document.
    pub document: Value,
}

impl SceneRevision {
    /// The revision's number, if the tag is one.
    pub fn revision(&self) -> Option<u64> {
        self.etag.trim_matches('"').parse().ok()
    }
}

/// Which map of which layer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapChoice {
    /// Which map.
    pub kind: MapKind,
    /// Name of the layer; not needed where only one has maps.
    pub layer: Option<String>,
}

/// What a server says about a request that it does not grant (RFC 9457).
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct Problem {
    /// What kind of problem, in a few words.
    pub title: String,
    /// What is wrong with this request.
    pub detail: String,
    /// JSON pointer of the value that is not allowed.
    pub pointer: Option<String>,
    /// That value.
    pub value: Option<Value>,
    /// What is allowed there.
    pub allowed: Option<String>,
}

/// Why a request brought nothing.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum HttpApiError {
    /// Nobody there, or it took too long.
    #[error("{method} {url}: {}", innermost(.cause))]
    Request {
        /// The method.
        method: Method,
        /// Where.
        url: String,
        /// Why not. No `source`: its text, of which this error tells the useful part, would repeat.
        cause: reqwest::Error,
    },
    /// The server did not grant it.
    #[error("{method} {url}: {status}{}", problem_text(.problem))]
    Refused {
        /// The method.
        method: Method,
        /// Where.
        url: String,
        /// The status.
        status: StatusCode,
        /// What the server says.
        problem: Box<Problem>,
    },
    /// The answer does not follow the API.
    #[error("{url}: {reason}")]
    BadAnswer {
        /// Where.
        url: String,
        /// What is wrong with it.
        reason: String,
    },
}

/// reqwest's own text repeats the URL and hides the reason in its sources.
fn innermost(error: &reqwest::Error) -> String {
    let mut reason: &dyn std::error::Error = error;
    while let Some(source) = reason.source() {
        reason = source;
    }
    if error.is_timeout() {
        "no answer in time".to_owned()
    } else {
        reason.to_string()
    }
}

fn problem_text(problem: &Problem) -> String {
    let mut text = String::new();
    if !problem.detail.is_empty() {
        text = format!(": {}", problem.detail);
    } else if !problem.title.is_empty() {
        text = format!(": {}", problem.title);
    }
    for (name, part) in [
        ("at", problem.pointer.clone()),
        ("value", problem.value.as_ref().map(Value::to_string)),
        ("allowed", problem.allowed.clone()),
    ] {
        if let Some(part) = part.filter(|part| !text.contains(part.as_str())) {
            text.push_str(&format!("; {name} {part}"));
        }
    }
    text
}

fn json_of(url: &reqwest::Url, body: &[u8]) -> Result<Value, HttpApiError> {
    serde_json::from_slice(body).map_err(|error| HttpApiError::BadAnswer {
        url: url.to_string(),
        reason: format!("the answer is not JSON: {error}"),
    })
}

/// The token as a header of every request, marked so that nothing prints it.
fn authorization(address: &ServerAddress) -> header::HeaderMap {
    let mut headers = header::HeaderMap::new();
    let token = address.access().token();
    if let Some(mut value) = token
        .and_then(|token| header::HeaderValue::try_from(format!("Bearer {}", token.text())).ok())
    {
        value.set_sensitive(true);
        headers.insert(header::AUTHORIZATION, value);
    }
    headers
}

/// A client of a server's HTTP API. Cheap to clone.
#[derive(Clone, Debug)]
pub struct HttpApi {
    client: reqwest::Client,
    address: ServerAddress,
}

impl HttpApi {
    /// A client of the server at `address`; asks nothing yet.
    ///
    /// # Errors
    /// If this machine lacks what an HTTP client needs.
    pub fn new(address: ServerAddress) -> Result<Self, HttpApiError> {
        let tls = address.access().tls_config(address.is_tls());
        let tls = rustls::ClientConfig::clone(&tls);
        let client = reqwest::Client::builder()
            .timeout(REQUEST_TIMEOUT)
            // It only talks to the address it was given: not to a proxy, not to where a redirect points.
            .no_proxy()
            .redirect(reqwest::redirect::Policy::none())
            .default_headers(authorization(&address))
            .tls_backend_preconfigured(tls)
            .build()
            .map_err(|cause| HttpApiError::Request {
                method: Method::GET,
                url: address.http_url("").to_string(),
                cause,
            })?;
        Ok(Self { client, address })
    }

    /// The scene and its revision.
    ///
    /// # Errors
    /// If the server is not there or its answer is not a scene.
    pub async fn scene(&self) -> Result<SceneRevision, HttpApiError> {
        self.scene_request(Method::GET, None).await
    }

    /// Changes the scene by a merge patch (RFC 7396), if it still is the revision `etag`.
    ///
    /// # Errors
    /// [`HttpApiError::Refused`] with 412 if the scene has changed, 422 if a value is not allowed.
    pub async fn patch_scene(
        &self,
        patch: &Value,
        etag: &str,
    ) -> Result<SceneRevision, HttpApiError> {
        self.scene_request(Method::PATCH, Some((patch, etag))).await
    }

    /// Changes whatever the scene is now; tries again if somebody else was faster.
    ///
    /// # Errors
    /// As [`Self::patch_scene`]; with 412 only after several tries.
    pub async fn patch_current_scene(&self, patch: &Value) -> Result<SceneRevision, HttpApiError> {
        let mut tries_left = PATCH_TRIES;
        loop {
            let etag = self.scene().await?.etag;
            tries_left -= 1;
            match self.patch_scene(patch, &etag).await {
                Err(HttpApiError::Refused { status, .. })
                    if status == StatusCode::PRECONDITION_FAILED && tries_left > 0 => {}
                answer => return answer,
            }
        }
    }

    /// A layer's map as a file: `png` (16 bits of grey) or `exr` (floats).
    ///
    /// # Errors
    /// If the server is not there or has no such map.
    pub async fn map(&self, choice: &MapChoice, format: &str) -> Result<Vec<u8>, HttpApiError> {
        let mut url = self.map_url(choice, None);
        url.query_pairs_mut().append_pair("format", format);
        let request = self.client.get(url.clone()).timeout(MAP_TIMEOUT);
        let (_, body) = self
            .answer_up_to(MAP_MAX_BYTES, request, Method::GET, &url)
            .await?;
        Ok(body)
    }

    /// A picture of the sky as it is now, as PNG, or as EXR with the parameter `format` `exr`. `view` are the parameters of the query, such as `yaw_deg` and `90`; what is
    /// left out is the server's choice.
    ///
    /// # Errors
    /// [`HttpApiError::Refused`] with 422 if a value is not allowed, 429 or 503 if the server has no time for it.
    pub async fn snapshot(&self, view: &[(&str, String)]) -> Result<Vec<u8>, HttpApiError> {
        let mut url = self.address.http_url("api/v1/snapshot");
        url.query_pairs_mut().extend_pairs(view);
        let request = self.client.get(url.clone()).timeout(SNAPSHOT_TIMEOUT);
        let (_, body) = self
            .answer_up_to(SNAPSHOT_MAX_BYTES, request, Method::GET, &url)
            .await?;
        Ok(body)
    }

    /// Replaces a layer's map by a file; without one the map that is made from the seed comes back. `transition_s` is
    /// the sky time that the change takes, `etag` the scene that is meant, `*` for whatever it is.
    ///
    /// # Errors
    /// [`HttpApiError::Refused`] with 412 if the scene has changed, 413, 415 or 422 if the file is no map.
    pub async fn set_map(
        &self,
        choice: &MapChoice,
        file: Option<Vec<u8>>,
        transition_s: Option<f64>,
        etag: &str,
    ) -> Result<SceneRevision, HttpApiError> {
        let url = self.map_url(choice, transition_s);
        let method = if file.is_some() {
            Method::PUT
        } else {
            Method::DELETE
        };
        let request = self
            .client
            .request(method.clone(), url.clone())
            .timeout(MAP_TIMEOUT)
            .header(header::IF_MATCH, etag)
            .body(file.unwrap_or_default());
        self.scene_of(request, method, &url).await
    }

    fn map_url(&self, choice: &MapChoice, transition_s: Option<f64>) -> reqwest::Url {
        let path = format!("api/v1/scene/maps/{}", choice.kind);
        let mut url = self.address.http_url(&path);
        if let Some(layer) = &choice.layer {
            url.query_pairs_mut().append_pair("layer", layer);
        }
        if let Some(seconds) = transition_s {
            let seconds = seconds.to_string();
            url.query_pairs_mut().append_pair("transition_s", &seconds);
        }
        url
    }

    /// What stands at a path of the API, such as `api/v1/presets` or `api/v1/scene/revisions?limit=5`.
    ///
    /// # Errors
    /// If the server is not there or its answer is not JSON.
    pub async fn get_json(&self, path: &str) -> Result<Value, HttpApiError> {
        let (path, query) = path
            .split_once('?')
            .map_or((path, None), |(path, query)| (path, Some(query)));
        let mut url = self.address.http_url(path);
        url.set_query(query);
        let request = self.client.get(url.clone());
        let (_, body) = self.answer(request, Method::GET, &url).await?;
        json_of(&url, &body)
    }

    /// Changes the sky's clock, whatever it shows now: an object with `sky_s`, `date`, `rate`, `wind_rate` or `paused`.
    ///
    /// # Errors
    /// [`HttpApiError::Refused`] with 422 if a value is not allowed.
    pub async fn change_time(&self, change: &Value) -> Result<Value, HttpApiError> {
        self.send_json(Method::PUT, "api/v1/scene/time", change)
            .await
    }

    /// Makes the sky a preset's, on the way there for `transition_s`; answers the document.
    ///
    /// # Errors
    /// [`HttpApiError::Refused`] with 422 if there is no such preset or the time is out of range.
    pub async fn set_preset(&self, name: &str, transition_s: f64) -> Result<Value, HttpApiError> {
        let choice = json!({"name": name, "transition_s": transition_s});
        self.send_json(Method::POST, "api/v1/scene/preset", &choice)
            .await
    }

    /// Brings an earlier revision back, or undoes the last change, on the way there for `transition_s`. `etag` is the scene
    /// that is meant, `*` for whatever it is.
    ///
    /// # Errors
    /// [`HttpApiError::Refused`] with 409 if nothing is left to undo, 412 if the scene has changed, 422 if the revision is
    /// not kept.
    pub async fn revert(
        &self,
        revision: Option<u64>,
        transition_s: f64,
        etag: &str,
    ) -> Result<SceneRevision, HttpApiError> {
        let url = self.address.http_url("api/v1/scene/revert");
        let body = json!({"revision": revision, "transition_s": transition_s});
        let request = self
            .client
            .post(url.clone())
            .timeout(CHANGE_TIMEOUT)
            .header(header::CONTENT_TYPE, "application/json")
            .header(header::IF_MATCH, etag)
            .body(body.to_string());
        self.scene_of(request, Method::POST, &url).await
    }

    async fn send_json(
        &self,
        method: Method,
        path: &str,
        value: &Value,
    ) -> Result<Value, HttpApiError> {
        let url = self.address.http_url(path);
        let request = self
            .client
            .request(method.clone(), url.clone())
            .timeout(CHANGE_TIMEOUT)
            .header(header::CONTENT_TYPE, "application/json")
            .header(header::IF_MATCH, "*")
            .body(value.to_string());
        let (_, body) = self.answer(request, method, &url).await?;
        json_of(&url, &body)
    }

    /// The server's counters.
    ///
    /// # Errors
    /// If the server is not there or its answer lacks a counter.
    pub async fn stats(&self) -> Result<ServerStats, HttpApiError> {
        let url = self.address.http_url("api/v1/stats");
        let (_, body) = self
            .answer(self.client.get(url.clone()), Method::GET, &url)
            .await?;
        serde_json::from_slice(&body).map_err(|error| HttpApiError::BadAnswer {
            url: url.to_string(),
            reason: format!("not the counters of a server that this client knows: {error}"),
        })
    }

    async fn scene_request(
        &self,
        method: Method,
        patch: Option<(&Value, &str)>,
    ) -> Result<SceneRevision, HttpApiError> {
        let url = self.address.http_url("api/v1/scene");
        let mut request = self.client.request(method.clone(), url.clone());
        if let Some((patch, etag)) = patch {
            request = request
                .timeout(CHANGE_TIMEOUT)
                .header(header::CONTENT_TYPE, MERGE_PATCH)
                .header(header::IF_MATCH, etag)
                .body(patch.to_string());
        }
        self.scene_of(request, method, &url).await
    }

    /// The scene that a request is answered with.
    async fn scene_of(
        &self,
        request: reqwest::RequestBuilder,
        method: Method,
        url: &reqwest::Url,
    ) -> Result<SceneRevision, HttpApiError> {
        let (headers, body) = self.answer(request, method, url).await?;
        let bad = |reason: String| HttpApiError::BadAnswer {
            url: url.to_string(),
            reason,
        };
        let etag = headers
            .get(header::ETAG)
            .and_then(|etag| etag.to_str().ok())
            .ok_or_else(|| bad("the answer has no ETag".to_owned()))?;
        Ok(SceneRevision {
            etag: etag.to_owned(),
            document: serde_json::from_slice(&body)
                .map_err(|error| bad(format!("the answer is not JSON: {error}")))?,
        })
    }

    async fn answer(
        &self,
        request: reqwest::RequestBuilder,
        method: Method,
        url: &reqwest::Url,
    ) -> Result<(header::HeaderMap, Vec<u8>), HttpApiError> {
        self.answer_up_to(BODY_MAX_BYTES, request, method, url)
            .await
    }

    async fn answer_up_to(
        &self,
        body_max_bytes: usize,
        request: reqwest::RequestBuilder,
        method: Method,
        url: &reqwest::Url,
    ) -> Result<(header::HeaderMap, Vec<u8>), HttpApiError> {
        let failed = |cause| HttpApiError::Request {
            method: method.clone(),
            url: url.to_string(),
            cause,
        };
        let response = request.send().await.map_err(failed)?;
        let status = response.status();
        let headers = response.headers().clone();
        let body = bounded_body(response, body_max_bytes)
            .await
            .map_err(failed)?;
        let Some(body) = body else {
            return Err(HttpApiError::BadAnswer {
                url: url.to_string(),
                reason: format!("the answer is longer than {body_max_bytes} bytes"),
            });
        };
        if status.is_success() {
            return Ok((headers, body));
        }
        Err(HttpApiError::Refused {
            method,
            url: url.to_string(),
            status,
            // A proxy in between may answer in HTML; then the status says it all.
            problem: serde_json::from_slice(&body).unwrap_or_default(),
        })
    }
}

/// None if it is too long.
async fn bounded_body(
    mut response: Response,
    body_max_bytes: usize,
) -> Result<Option<Vec<u8>>, reqwest::Error> {
    let mut body = Vec::new();
    while let Some(chunk) = response.chunk().await? {
        if body.len() + chunk.len() > body_max_bytes {
            return Ok(None);
        }
        body.extend_from_slice(&chunk);
    }
    Ok(Some(body))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_problem_is_told_with_place_value_and_what_is_allowed() {
        let problem: Problem = serde_json::from_value(json!({
            "type": "about:blank", "title": "Unprocessable", "status": 422, "detail": "the scene is not allowed",
            "pointer": "/wind/speed_m_per_s", "value": 300, "allowed": "0 to 200"
        }))
        .expect("a problem");
        assert_eq!(
            problem_text(&problem),
            ": the scene is not allowed; at /wind/speed_m_per_s; value 300; allowed 0 to 200"
        );
    }

    #[test]
    fn a_detail_that_says_it_all_is_not_repeated() {
        let problem = Problem {
            detail: "/wind is 3; allowed: an object".to_owned(),
            pointer: Some("/wind".to_owned()),
            value: Some(json!(3)),
            ..Problem::default()
        };
        assert_eq!(problem_text(&problem), ": /wind is 3; allowed: an object");
    }

    #[test]
    fn a_revision_is_the_number_in_its_tag() {
        let scene = |etag: &str| SceneRevision {
            etag: etag.to_owned(),
            document: Value::Null,
        };
        assert_eq!(scene("\"12\"").revision(), Some(12));
        assert_eq!(scene("W/\"x\"").revision(), None);
    }
}
