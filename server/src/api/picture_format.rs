//! Which picture format a request asks for: by `?format=`, else by `Accept`, else PNG.

use axum::http::header::ACCEPT;
use axum::http::{HeaderMap, StatusCode};
use serde_json::Value;
use skycell_protocol::ValueError;

use super::Problem;
use crate::field::MapFileFormat;

const FORMATS: [MapFileFormat; 2] = [MapFileFormat::Png, MapFileFormat::Exr];

/// The format that is asked for. `what` says what there is, for who accepts none of it.
pub(super) fn picture_format(
    asked: Option<&str>,
    headers: &HeaderMap,
    what: &str,
) -> Result<MapFileFormat, Problem> {
    if let Some(asked) = asked {
        return FORMATS
            .into_iter()
            .find(|format| format.extension() == asked)
            .ok_or_else(|| {
                Problem::bad_value(ValueError::new("/format", &Value::from(asked), "png, exr"))
            });
    }
    let accepted = accepted(headers);
    let is_named = |format: &MapFileFormat| {
        accepted
            .iter()
            .any(|kind| kind.eq_ignore_ascii_case(format.media_type()))
    };
    if let Some(named) = FORMATS.into_iter().find(is_named) {
        return Ok(named);
    }
    let takes_any = accepted.is_empty()
        || accepted.iter().any(|kind| {
            ["*/*", "image/*"]
                .iter()
                .any(|any| kind.eq_ignore_ascii_case(any))
        });
    if takes_any {
        return Ok(MapFileFormat::Png);
    }
    Err(Problem::new(StatusCode::NOT_ACCEPTABLE, what))
}

/// The media types of the Accept header, without their parameters.
fn accepted(headers: &HeaderMap) -> Vec<&str> {
    headers
        .get_all(ACCEPT)
        .iter()
        .filter_map(|header| header.to_str().ok())
        .flat_map(|list| list.split(','))
        .filter_map(|item| item.split(';').next())
        .map(str::trim)
        .filter(|kind| !kind.is_empty())
        .collect()
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    fn format(asked: Option<&str>, accept: Option<&'static str>) -> Option<MapFileFormat> {
        let mut headers = HeaderMap::new();
        if let Some(accept) = accept {
            headers.insert(ACCEPT, HeaderValue::from_static(accept));
        }
        picture_format(asked, &headers, "").ok()
    }

    #[test]
    fn the_query_goes_before_accept_and_png_is_what_is_given_unasked() {
        let (png, exr) = (Some(MapFileFormat::Png), Some(MapFileFormat::Exr));
        for (asked, accept, expected) in [
            (None, None, png),
            (None, Some("*/*"), png),
            (None, Some("text/html, image/*;q=0.8"), png),
            (None, Some("image/X-EXR"), exr),
            (None, Some("image/x-exr, */*;q=0.1"), exr),
            (None, Some("image/png, image/x-exr"), png),
            (None, Some("text/html"), None),
            (Some("exr"), Some("image/png"), exr),
            (Some("png"), Some("text/html"), png),
            (Some("tiff"), None, None),
            (Some("EXR"), None, None),
        ] {
            assert_eq!(format(asked, accept), expected, "{asked:?} {accept:?}");
        }
    }
}
