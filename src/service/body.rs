//! Reading request bodies, bounded in size and time.

use std::time::Duration;

use axum::body::Body;
use axum::http::{HeaderMap, header};
use bytes::{Bytes, BytesMut};
use futures::StreamExt;

use super::ApiError;
use super::negotiation::expect_json;

/// How long a body may take to arrive.
const PATIENCE: Duration = Duration::from_secs(60);
/// How much of a body that is too large is read and thrown away, so that a client that writes first
/// and reads later sees the answer instead of a broken connection.
const DISCARDED: usize = 128 << 20;

/// Reads a JSON body of at most `limit` bytes.
///
/// # Errors
/// When it says that it is something else, is larger, too slow, or breaks off.
pub async fn read_json(headers: &HeaderMap, body: Body, limit: usize) -> Result<Bytes, ApiError> {
    expect_json(headers)?;
    read(headers, body, limit).await
}

/// Reads the body of a bundle, whose kind has been checked, of at most `limit` bytes.
///
/// # Errors
/// When it is larger, too slow, or breaks off.
pub async fn read_bundle(headers: &HeaderMap, body: Body, limit: usize) -> Result<Bytes, ApiError> {
    read(headers, body, limit).await
}

async fn read(headers: &HeaderMap, body: Body, limit: usize) -> Result<Bytes, ApiError> {
    let announced =
        headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<usize>().ok());
    let too_large = announced.is_some_and(|length| length > limit);
    if too_large
        && (headers.contains_key(header::EXPECT) || announced.is_some_and(|length| length > DISCARDED))
    {
        // The client waits for our word before it sends, or sends more than we care to read.
        return Err(ApiError::TooLarge { limit });
    }
    tokio::time::timeout(PATIENCE, collect(body, limit, announced.unwrap_or(0)))
        .await
        .map_err(|_| ApiError::BodyTimeout { seconds: PATIENCE.as_secs() })?
}

async fn collect(body: Body, limit: usize, announced: usize) -> Result<Bytes, ApiError> {
    let mut chunks = body.into_data_stream();
    let mut collected = BytesMut::with_capacity(announced.min(limit).min(1 << 20));
    let mut read = 0_usize;
    while let Some(chunk) = chunks.next().await {
        let chunk = chunk.map_err(|_| ApiError::BodyBroken)?;
        read += chunk.len();
        if read > DISCARDED {
            break;
        }
        if read > limit {
            collected = BytesMut::new();
        } else {
            collected.extend_from_slice(&chunk);
        }
    }
    if read > limit { Err(ApiError::TooLarge { limit }) } else { Ok(collected.freeze()) }
}
