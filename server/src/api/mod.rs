//! The HTTP interface: the scene, figures, health, the page, and the way to `/ws`.

mod figures;
mod maps;
mod openapi;
mod page;
mod picture_format;
mod presets;
mod problem;
mod revisions;
mod scene;
mod scene_events;
mod scene_time;
mod snapshot;
mod unread_body;

use std::any::Any;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::extract::{MatchedPath, Request, State};
use axum::http::header::{
    ACCEPT, AUTHORIZATION, CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, HeaderName,
    HeaderValue, IF_MATCH, IF_NONE_MATCH, REFERRER_POLICY, RETRY_AFTER, X_CONTENT_TYPE_OPTIONS,
    X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, Method, StatusCode};
use axum::middleware::{Next, from_fn, from_fn_with_state, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use tower::util::option_layer;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::cors::{AllowOrigin, CorsLayer};
use tower_http::limit::RequestBodyLimitLayer;
use tower_http::set_header::SetResponseHeaderLayer;
use tower_http::timeout::TimeoutLayer;
use tower_http::trace::TraceLayer;
use tracing::Instrument;

pub(crate) use page::is_page_path;
pub use problem::Problem;
pub use scene_events::SUBSCRIBERS_MAX;
pub use snapshot::SnapshotQueue;

use crate::access;
use crate::metrics::ServiceFigures;
use crate::stream::{self, StreamContext};
use crate::traces;

/// The largest body of a request. The default scene has 1 KB, one with four layers 2 KB.
pub const BODY_MAX_BYTES: usize = 64 * 1024;

/// How long a request may take, its body included.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);

/// The same for a change of the scene, which may wait for maps that have to be made first.
const CHANGE_TIMEOUT: Duration = Duration::from_secs(60);

/// The same for a map: up to 64 MiB, which wait for their turn to be read.
const MAP_TIMEOUT: Duration = Duration::from_secs(120);

/// How long a browser may rely on what it was told a page of another origin may do.
const PREFLIGHT_MAX_AGE: Duration = Duration::from_secs(600);
/// The same for a snapshot, which has a limit of its own that says more.
const SNAPSHOT_TIMEOUT: Duration = Duration::from_secs(40);

/// The page loads its own modules and pictures, and talks to its own server.
const CONTENT_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
     img-src 'self' blob: data:; connect-src 'self'; manifest-src 'self'; base-uri 'none'; \
     form-action 'none'; frame-ancestors 'none'";

/// Every route of the service, behind its gate.
pub fn router(context: Arc<StreamContext>) -> Router {
    let gate = Arc::clone(&context.gate);
    let cors = option_layer(cors(&context.allowed_origins));
    let timeout = |limit| TimeoutLayer::with_status_code(StatusCode::REQUEST_TIMEOUT, limit);
    let changes = Router::new()
        .route("/api/v1/scene", get(scene::get).patch(scene::patch))
        .route("/api/v1/scene/preset", post(presets::set))
        .route("/api/v1/scene/revert", post(revisions::revert))
        .method_not_allowed_fallback(method_not_allowed)
        .layer(RequestBodyLimitLayer::new(BODY_MAX_BYTES))
        .layer(timeout(CHANGE_TIMEOUT));
    let router = Router::new()
        .route("/ws", get(stream::upgrade))
        .route(
            "/api/v1/scene/time",
            get(scene_time::get).put(scene_time::put),
        )
        .route("/api/v1/scene/now", get(scene_time::now))
        .route("/api/v1/scene/revisions", get(revisions::list))
        .route("/api/v1/scene/revisions/{revision}", get(revisions::get))
        .route("/api/v1/scene/events", get(scene_events::events))
        .route("/api/v1/presets", get(presets::list))
        .route("/api/v1/presets/{name}", get(presets::get))
        .route("/api/v1/cells", get(figures::cells))
        .route("/api/v1/viewers", get(figures::viewers))
        .route("/api/v1/stats", get(figures::stats))
        .route("/api/v1/views", get(figures::views))
        .route("/api/v1/openapi.json", get(openapi::document))
        .route("/api/v1/docs", get(openapi::page))
        .route("/metrics", get(metrics))
        .route("/livez", get(live))
        .route("/readyz", get(ready))
        .fallback(page::serve)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(RequestBodyLimitLayer::new(BODY_MAX_BYTES))
        .layer(timeout(REQUEST_TIMEOUT))
        .merge(changes)
        .merge(
            maps::routes()
                .method_not_allowed_fallback(method_not_allowed)
                .layer(timeout(MAP_TIMEOUT)),
        )
        .merge(
            snapshot::routes()
                .method_not_allowed_fallback(method_not_allowed)
                .layer(RequestBodyLimitLayer::new(BODY_MAX_BYTES))
                .layer(timeout(SNAPSHOT_TIMEOUT)),
        )
        .with_state(Arc::clone(&context))
        .layer(from_fn_with_state(gate, access::pass))
        .layer(CatchPanicLayer::custom(after_panic))
        .layer(map_response(problem::unify))
        .layer(cors)
        .layer(from_fn(unread_body::read_or_close))
        .layer(from_fn_with_state(context, count));
    security_headers()
        .into_iter()
        .fold(router, |router, (name, value)| {
            router.layer(SetResponseHeaderLayer::if_not_present(name, value))
        })
        // Not the whole address: a query may hold what is no business of a log.
        .layer(
            TraceLayer::new_for_http().make_span_with(|request: &Request| {
                tracing::debug_span!(
                    "request",
                    method = %request.method(),
                    path = request.uri().path()
                )
            }),
        )
}

/// What pages of listed origins may read, beside opening `/ws`. Without any, browsers keep all answers from them.
fn cors(allowed_origins: &[String]) -> Option<CorsLayer> {
    if allowed_origins.is_empty() {
        return None;
    }
    let origins = allowed_origins
        .iter()
        .filter_map(|origin| HeaderValue::from_str(origin).ok());
    let cors = CorsLayer::new()
        .allow_origin(AllowOrigin::list(origins))
        .allow_methods([
            Method::GET,
            Method::PATCH,
            Method::PUT,
            Method::POST,
            Method::DELETE,
        ])
        .allow_headers([AUTHORIZATION, CONTENT_TYPE, IF_MATCH, IF_NONE_MATCH, ACCEPT])
        .expose_headers([ETAG, RETRY_AFTER])
        .max_age(PREFLIGHT_MAX_AGE);
    Some(cors)
}

fn security_headers() -> [(HeaderName, HeaderValue); 6] {
    [
        (X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
        (X_FRAME_OPTIONS, HeaderValue::from_static("DENY")),
        (REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
        (
            CONTENT_SECURITY_POLICY,
            HeaderValue::from_static(CONTENT_POLICY),
        ),
        (
            HeaderName::from_static("cross-origin-resource-policy"),
            HeaderValue::from_static("same-origin"),
        ),
        // Nothing here stays true for long; what may be kept says so itself, with an ETag.
        (CACHE_CONTROL, HeaderValue::from_static("no-cache")),
    ]
}

fn after_panic(panic: Box<dyn Any + Send + 'static>) -> Response {
    let reason = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("unknown");
    tracing::error!(reason, "a request handler panicked");
    Problem::new(
        StatusCode::INTERNAL_SERVER_ERROR,
        "the server failed; its log tells why",
    )
    .into_response()
}

async fn method_not_allowed() -> Problem {
    Problem::new(
        StatusCode::METHOD_NOT_ALLOWED,
        "the header Allow lists the methods of this resource",
    )
}

/// The process runs.
async fn live() -> &'static str {
    "ok\n"
}

/// The renderer has warmed up and runs, and the service is not shutting down.
async fn ready(State(context): State<Arc<StreamContext>>) -> Result<&'static str, Problem> {
    let unready = |why| Err(Problem::new(StatusCode::SERVICE_UNAVAILABLE, why));
    if context.draining.is_cancelled() {
        unready("the server is shutting down")
    } else if context.frame_loop.stats().device_loss.is_lost {
        unready("the graphics device was lost and is being opened again")
    } else if !context.frame_loop.is_ready() {
        unready("the renderer is not ready")
    } else {
        Ok("ok\n")
    }
}

/// Counts requests and the time that they take.
async fn count(
    State(context): State<Arc<StreamContext>>,
    request: Request,
    next: Next,
) -> Response {
    let begun = Instant::now();
    // Methods that nobody knows are one, so that strangers cannot make up labels; so are the page's files.
    let method = match request.method().as_str() {
        "GET" => "GET",
        "HEAD" => "HEAD",
        "PATCH" => "PATCH",
        "POST" => "POST",
        "PUT" => "PUT",
        "DELETE" => "DELETE",
        _ => "other",
    };
    let route = request.extensions().get::<MatchedPath>().cloned();
    let route = route.as_ref().map_or("page", MatchedPath::as_str);
    let span = tracing::trace_span!(
        target: traces::TARGET,
        "request",
        otel.kind = "server",
        http.request.method = method,
        http.route = route,
        http.response.status_code = tracing::field::Empty,
    );
    let response = next.run(request).instrument(span.clone()).await;
    let status = response.status().as_u16();
    span.record("http.response.status_code", status);
    context
        .metrics
        .answered(method, route, status, begun.elapsed());
    response
}

async fn metrics(State(context): State<Arc<StreamContext>>) -> impl IntoResponse {
    let stats = context.frame_loop.stats();
    let is_draining = context.draining.is_cancelled();
    let figures = ServiceFigures {
        is_ready: !is_draining && context.frame_loop.is_ready(),
        is_draining,
        scene_revision: context.scene.snapshot().revision,
        revisions_kept: context.scene.revisions().len(),
        cpu: cpu_time::ProcessTime::try_now()
            .ok()
            .map(|time| time.as_duration()),
        memory_bytes: figures::resident_bytes(),
    };
    context.metrics.set_service(&figures, &stats);
    let mut headers = HeaderMap::new();
    headers.insert(
        CONTENT_TYPE,
        HeaderValue::from_static("text/plain; version=0.0.4; charset=utf-8"),
    );
    (
        headers,
        context.metrics.render(context.viewers.count(), &stats),
    )
}
