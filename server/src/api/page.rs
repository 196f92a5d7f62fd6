//! The page and its modules, embedded in the binary.

use axum::http::header::{CONTENT_TYPE, ETAG, HeaderMap, HeaderValue, IF_NONE_MATCH};
use axum::http::{Method, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use include_dir::{Dir, File, include_dir};
use xxhash_rust::xxh3::xxh3_64;

use super::Problem;

static WEB: Dir<'static> = include_dir!("$CARGO_MANIFEST_DIR/../client/web");

/// The page's own tests lie beside it and are not part of it.
const TESTS: &str = "tests/";

/// A file of the page, or 404 for every path that nothing else serves.
pub(super) async fn serve(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let Some((file, kind)) = file_at(uri.path()) else {
        return Problem::new(
            StatusCode::NOT_FOUND,
            format!("there is nothing at {}", uri.path()),
        )
        .into_response();
    };
    if method != Method::GET && method != Method::HEAD {
        return super::method_not_allowed().await.into_response();
    }
    let tag = format!("\"{:016x}\"", xxh3_64(file.contents()));
    let is_known = headers
        .get(IF_NONE_MATCH)
        .is_some_and(|known| known.as_bytes() == tag.as_bytes());
    if is_known {
        return (StatusCode::NOT_MODIFIED, [(ETAG, tag)]).into_response();
    }
    let mut response = file.contents().into_response();
    response
        .headers_mut()
        .insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    if let Ok(tag) = HeaderValue::from_str(&tag) {
        response.headers_mut().insert(ETAG, tag);
    }
    response
}

/// Whether a file of the page is at this path. Anyone may load it.
pub(crate) fn is_page_path(path: &str) -> bool {
    file_at(path).is_some()
}

fn file_at(path: &str) -> Option<(&'static File<'static>, &'static str)> {
    let path = match path {
        "/" => "index.html",
        path => path.trim_start_matches('/'),
    };
    let kind = content_type(path).filter(|_| !path.starts_with(TESTS))?;
    Some((WEB.get_file(path)?, kind))
}

/// The kinds of files that a page has; others (notes, tests' configurations) are not served.
fn content_type(path: &str) -> Option<&'static str> {
    let (_, extension) = path.rsplit_once('.')?;
    Some(match extension {
        "html" => "text/html; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" => "application/json",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "jpg" => "image/jpeg",
        "ico" => "image/x-icon",
        "webmanifest" => "application/manifest+json",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn get(path: &'static str) -> Response {
        serve(Method::GET, Uri::from_static(path), HeaderMap::new()).await
    }

    #[tokio::test]
    async fn the_page_is_html_and_knows_its_tag() {
        let page = get("/").await;
        assert_eq!(page.status(), StatusCode::OK);
        assert_eq!(page.headers()[CONTENT_TYPE], "text/html; charset=utf-8");
        let mut headers = HeaderMap::new();
        headers.insert(IF_NONE_MATCH, page.headers()[ETAG].clone());
        let again = serve(Method::GET, Uri::from_static("/"), headers).await;
        assert_eq!(again.status(), StatusCode::NOT_MODIFIED);
    }

    #[tokio::test]
    async fn no_path_leads_out_of_the_page() {
        for path in [
            "/../Cargo.toml",
            "/..%2fCargo.toml",
            "//index.html/..",
            "/nothing",
            "/tests/look.test.js",
        ] {
            assert_eq!(get(path).await.status(), StatusCode::NOT_FOUND, "{path}");
        }
    }

    #[test]
    fn every_file_of_the_page_has_a_content_type() {
        for file in WEB.files() {
            let path = file.path().to_str().expect("UTF-8");
            if path.ends_with(".md") {
                continue;
            }
            assert!(content_type(path).is_some(), "{path}");
        }
    }
}
