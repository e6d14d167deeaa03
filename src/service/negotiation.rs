//! Media types: what a client sends and what it wants back.

use axum::http::{HeaderMap, header};

use super::ApiError;

/// How a stream of events is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamFormat {
    /// One JSON object per line.
    Ndjson,
    /// Server-sent events.
    Sse,
}

impl StreamFormat {
    const OFFERED: [StreamFormat; 2] = [StreamFormat::Ndjson, StreamFormat::Sse];

    /// The media type.
    pub fn media_type(self) -> &'static str {
        match self {
            StreamFormat::Ndjson => "application/x-ndjson",
            StreamFormat::Sse => "text/event-stream",
        }
    }

    /// The format that the client likes best; NDJSON when it has no preference.
    ///
    /// # Errors
    /// [`ApiError::NotAcceptable`] when it takes neither.
    pub fn negotiate(headers: &HeaderMap) -> Result<Self, ApiError> {
        let mut accepted =
            headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok()).peekable();
        if accepted.peek().is_none() {
            return Ok(StreamFormat::Ndjson);
        }
        let ranges: Vec<(String, u32)> =
            accepted.flat_map(|value| value.split(',')).filter_map(range).collect();
        let weight = |format: StreamFormat| {
            let media_type = format.media_type();
            let family = media_type.split_once('/').map_or("", |(family, _)| family);
            // The most specific range that matches decides (RFC 9110, 12.5.1).
            let exact = ranges.iter().find(|(range, _)| range == media_type);
            let wide = || ranges.iter().find(|(range, _)| *range == format!("{family}/*"));
            let any = || ranges.iter().find(|(range, _)| range == "*/*");
            exact.or_else(wide).or_else(any).map_or(0, |(_, weight)| *weight)
        };
        let mut best = None;
        for format in Self::OFFERED {
            let weight = weight(format);
            if weight > best.map_or(0, |(_, best)| best) {
                best = Some((format, weight));
            }
        }
        best.map(|(format, _)| format)
            .ok_or(ApiError::NotAcceptable("application/x-ndjson or text/event-stream"))
    }
}

/// A media range and its weight in thousandths.
fn range(text: &str) -> Option<(String, u32)> {
    let mut parts = text.split(';');
    let range = parts.next()?.trim().to_ascii_lowercase();
    let mut weight = 1000;
    for parameter in parts {
        if let Some(("q" | "Q", value)) = parameter.trim().split_once('=') {
            let quality: f64 = value.trim().parse().ok().filter(|q| (0.0..=1.0).contains(q))?;
            weight = (quality * 1000.0).round() as u32;
        }
    }
    (!range.is_empty()).then_some((range, weight))
}

/// How a workcell is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BundleFormat {
    /// The document alone.
    Json,
    /// A zip archive.
    Zip,
    /// A gzipped tar archive.
    TarGz,
}

/// How the headers say that a workcell is sent; JSON when they say nothing, as [`expect_json`] has it.
///
/// # Errors
/// [`ApiError::UnsupportedMediaType`] when they say something else.
pub fn expect_bundle(headers: &HeaderMap) -> Result<BundleFormat, ApiError> {
    let expected = "application/json, application/zip or application/gzip";
    let format = match media_type(headers).as_deref() {
        Some("application/zip" | "application/x-zip-compressed") => BundleFormat::Zip,
        Some("application/gzip" | "application/x-gzip" | "application/x-tar+gzip" | "application/x-gtar") => {
            BundleFormat::TarGz
        }
        other if is_json(headers, other) => BundleFormat::Json,
        other => return Err(unsupported(expected, other)),
    };
    expect_plain(headers, expected)?;
    Ok(format)
}

/// Checks that a body is plain JSON as far as its headers say. One without a type counts as JSON, unless
/// it comes from a web page.
///
/// Browsers let any page send forms, plain text and bodies without a type to any address; for JSON they
/// ask first. So no page makes a job here unasked.
///
/// # Errors
/// [`ApiError::UnsupportedMediaType`] when they say something else.
pub fn expect_json(headers: &HeaderMap) -> Result<(), ApiError> {
    let expected = "application/json";
    let media_type = media_type(headers);
    if !is_json(headers, media_type.as_deref()) {
        return Err(unsupported(expected, media_type.as_deref()));
    }
    expect_plain(headers, expected)
}

/// Checks that a body is a gRPC message as far as its headers say; tonic itself takes any type.
///
/// # Errors
/// [`ApiError::UnsupportedMediaType`] when they say something else, or nothing.
pub fn expect_grpc(headers: &HeaderMap) -> Result<(), ApiError> {
    let media_type = media_type(headers);
    match media_type.as_deref() {
        Some(own) if own == "application/grpc" || own.starts_with("application/grpc+") => Ok(()),
        other => Err(unsupported("application/grpc", other)),
    }
}

/// The media type of the body without its parameters; `None` when the headers do not tell.
fn media_type(headers: &HeaderMap) -> Option<String> {
    let text = headers.get(header::CONTENT_TYPE)?.to_str().unwrap_or("something unreadable");
    Some(text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase())
}

/// Whether a body of that type counts as JSON.
fn is_json(headers: &HeaderMap, media_type: Option<&str>) -> bool {
    match media_type {
        Some("application/json") => true,
        Some(other) => other.starts_with("application/") && other.ends_with("+json"),
        None => !headers.contains_key(header::ORIGIN),
    }
}

/// Checks that a body is not encoded further.
fn expect_plain(headers: &HeaderMap, expected: &'static str) -> Result<(), ApiError> {
    match headers.get(header::CONTENT_ENCODING) {
        Some(value) if !value.as_bytes().eq_ignore_ascii_case(b"identity") => {
            Err(unsupported(expected, Some("compressed")))
        }
        _ => Ok(()),
    }
}

fn unsupported(expected: &'static str, found: Option<&str>) -> ApiError {
    let found = found.unwrap_or("without a media type").chars().take(100).collect();
    ApiError::UnsupportedMediaType { expected, found }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn negotiated(accept: &[&str]) -> Option<StreamFormat> {
        let mut headers = HeaderMap::new();
        for value in accept {
            headers.append(header::ACCEPT, HeaderValue::from_str(value).unwrap());
        }
        StreamFormat::negotiate(&headers).ok()
    }

    #[test]
    fn clients_get_what_they_like_best() {
        use StreamFormat::{Ndjson, Sse};
        for (accept, expected) in [
            (&[][..], Some(Ndjson)),
            (&["*/*"], Some(Ndjson)),
            (&["text/event-stream"], Some(Sse)),
            (&["text/*"], Some(Sse)),
            (&["Application/X-NDJSON"], Some(Ndjson)),
            (&["application/x-ndjson;q=0.5, text/event-stream"], Some(Sse)),
            (&["application/x-ndjson;q=0.5", "text/event-stream;q=0.4"], Some(Ndjson)),
            (&["*/*;q=0.1, application/x-ndjson;q=0"], Some(Sse)),
            (&["text/html, */*;q=0.8"], Some(Ndjson)),
            (&["application/json"], None),
            (&["text/html"], None),
            (&["text/event-stream;q=0"], None),
            (&["text/event-stream;q=7"], None),
        ] {
            assert_eq!(negotiated(accept), expected, "{accept:?}");
        }
    }

    #[test]
    fn bodies_are_json_or_say_nothing() {
        let alone = |name: header::HeaderName, value: &'static str| {
            HeaderMap::from_iter([(name, HeaderValue::from_static(value))])
        };
        let said = |name, value| expect_json(&alone(name, value)).is_ok();
        assert!(expect_json(&HeaderMap::new()).is_ok());
        assert!(said(header::CONTENT_TYPE, "application/json; charset=utf-8"));
        assert!(said(header::CONTENT_TYPE, "application/vnd.quadrille+json"));
        for other in [
            "text/plain",
            "text/plain; charset=application/json",
            "application/x-www-form-urlencoded",
            "multipart/form-data; boundary=x",
            "application/zip",
            "",
        ] {
            assert!(!said(header::CONTENT_TYPE, other), "{other}");
        }
        assert!(said(header::CONTENT_ENCODING, "identity"));
        assert!(!said(header::CONTENT_ENCODING, "gzip"));
        // Web pages must say what they send.
        let mut page = alone(header::ORIGIN, "null");
        assert!(expect_json(&page).is_err() && expect_bundle(&page).is_err());
        page.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
        assert!(expect_json(&page).is_ok() && expect_bundle(&page).is_ok());
    }

    #[test]
    fn messages_are_grpc() {
        let headers = |value| HeaderMap::from_iter([(header::CONTENT_TYPE, HeaderValue::from_static(value))]);
        for good in ["application/grpc", "application/grpc+proto", "Application/GRPC; x=y"] {
            assert!(expect_grpc(&headers(good)).is_ok(), "{good}");
        }
        for bad in ["text/plain", "application/json", "application/grpc-web", ""] {
            assert!(expect_grpc(&headers(bad)).is_err(), "{bad}");
        }
        assert!(expect_grpc(&HeaderMap::new()).is_err());
    }
}
