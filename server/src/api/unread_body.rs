//! Requests that are answered before their body has been read: refused for its length, for a token that is
//! lacking, for too many of them.
//!
//! Where a body was left unread nobody knows where the next request begins, so the connection ends. A client that
//! was not told loses the request that it sends next, and, where the end overtakes the answer (a socket that is
//! closed over unread bytes is reset), the answer, too. So what is left of a body is read first, within limits, and
//! beyond them the answer says that the connection ends (RFC 9112, sections 9.3 and 9.6).

use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, BodyDataStream, Bytes, HttpBody};
use axum::extract::Request;
use axum::http::Version;
use axum::http::header::{CONNECTION, HeaderValue};
use axum::middleware::Next;
use axum::response::Response;
use futures_util::{Stream, StreamExt, stream};

/// The most bytes of a body that are read for nothing: a few times the longest that is taken, a map's aside.
const REST_MAX_BYTES: u64 = 4 * super::BODY_MAX_BYTES as u64;

/// How long they may take.
const REST_TIMEOUT: Duration = Duration::from_secs(2);

/// A body of which the handler reads what it wants, and this module the rest.
type Shared = Arc<Mutex<BodyDataStream>>;

/// Reads what the handler left of the body, or lets the answer say that the connection ends.
pub(super) async fn read_or_close(request: Request, next: Next) -> Response {
    // Above HTTP/1.1 each request is a stream of its own.
    if request.body().is_end_stream() || request.version() > Version::HTTP_11 {
        return next.run(request).await;
    }
    let (head, body) = request.into_parts();
    let announced_bytes = body.size_hint().lower();
    let shared = Arc::new(Mutex::new(body.into_data_stream()));
    let lent = Body::from_stream(chunks(Arc::clone(&shared)));
    let mut response = next.run(Request::from_parts(head, lent)).await;
    let is_read = has_ended(&shared)
        || (announced_bytes <= REST_MAX_BYTES
            && tokio::time::timeout(REST_TIMEOUT, read_rest(shared))
                .await
                .unwrap_or(false));
    if !is_read {
        let close = HeaderValue::from_static("close");
        response.headers_mut().insert(CONNECTION, close);
    }
    response
}

fn chunks(shared: Shared) -> impl Stream<Item = Result<Bytes, axum::Error>> {
    stream::poll_fn(move |context| poll_chunk(&shared, context))
}

fn poll_chunk(
    shared: &Shared,
    context: &mut Context<'_>,
) -> Poll<Option<Result<Bytes, axum::Error>>> {
    let mut body = shared.lock().unwrap_or_else(PoisonError::into_inner);
    Pin::new(&mut *body).poll_next(context)
}

fn has_ended(shared: &Shared) -> bool {
    let body = shared.lock().unwrap_or_else(PoisonError::into_inner);
    HttpBody::is_end_stream(&*body)
}

/// Whether the end came within `REST_MAX_BYTES`.
async fn read_rest(shared: Shared) -> bool {
    let mut chunks = chunks(shared);
    let mut left_bytes = REST_MAX_BYTES;
    while let Some(chunk) = chunks.next().await {
        let Some(left) = chunk
            .ok()
            .and_then(|bytes| left_bytes.checked_sub(bytes.len() as u64))
        else {
            return false;
        };
        left_bytes = left;
    }
    true
}
