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

/// How the headers say that a workcell is sent; JSON when they say nothing.
///
/// # Errors
/// [`ApiError::UnsupportedMediaType`] when they say something else.
pub fn expect_bundle(headers: &HeaderMap) -> Result<BundleFormat, ApiError> {
    let value = headers.get(header::CONTENT_TYPE).map(|value| value.to_str().unwrap_or_default());
    let media_type =
        value.unwrap_or_default().split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    let expected = "application/json, application/zip or application/gzip";
    let found = |text: &str| text.chars().take(100).collect::<String>();
    let format = match media_type.as_str() {
        "application/zip" | "application/x-zip-compressed" => BundleFormat::Zip,
        "application/gzip" | "application/x-gzip" | "application/x-tar+gzip" | "application/x-gtar" => {
            BundleFormat::TarGz
        }
        _ if expect_json(headers).is_ok() => BundleFormat::Json,
        other => return Err(ApiError::UnsupportedMediaType { expected, found: found(other) }),
    };
    match headers.get(header::CONTENT_ENCODING) {
        Some(value) if !value.as_bytes().eq_ignore_ascii_case(b"identity") => {
            Err(ApiError::UnsupportedMediaType { expected, found: "compressed".to_owned() })
        }
        _ => Ok(format),
    }
}

/// Checks that a body is plain JSON as far as its headers say.
///
/// # Errors
/// [`ApiError::UnsupportedMediaType`] when they say something else.
pub fn expect_json(headers: &HeaderMap) -> Result<(), ApiError> {
    if let Some(value) = headers.get(header::CONTENT_TYPE) {
        let text = value.to_str().unwrap_or("something unreadable");
        let media_type = text.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
        // What curl says of any --data when it is told nothing.
        let untold = media_type == "application/x-www-form-urlencoded";
        let json = media_type == "application/json"
            || (media_type.starts_with("application/") && media_type.ends_with("+json"));
        if !json && !untold {
            let found = text.chars().take(100).collect();
            return Err(ApiError::UnsupportedMediaType { expected: "application/json", found });
        }
    }
    match headers.get(header::CONTENT_ENCODING) {
        Some(value) if !value.as_bytes().eq_ignore_ascii_case(b"identity") => {
            let found = "compressed".to_owned();
            Err(ApiError::UnsupportedMediaType { expected: "application/json", found })
        }
        _ => Ok(()),
    }
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
        let said = |name: header::HeaderName, value: &'static str| {
            let headers = HeaderMap::from_iter([(name, HeaderValue::from_static(value))]);
            expect_json(&headers).is_ok()
        };
        assert!(expect_json(&HeaderMap::new()).is_ok());
        assert!(said(header::CONTENT_TYPE, "application/json; charset=utf-8"));
        assert!(said(header::CONTENT_TYPE, "application/vnd.quadrille+json"));
        assert!(!said(header::CONTENT_TYPE, "text/plain"));
        assert!(!said(header::CONTENT_TYPE, "application/zip"));
        assert!(said(header::CONTENT_ENCODING, "identity"));
        assert!(!said(header::CONTENT_ENCODING, "gzip"));
    }
}
