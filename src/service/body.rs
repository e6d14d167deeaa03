//! Reading request bodies, bounded in size and time, each and all together; HTTP and gRPC alike.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Body;
use axum::http::{Extensions, HeaderMap, header};
use bytes::{Bytes, BytesMut};
use futures::StreamExt;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::ApiError;
use super::negotiation::expect_json;

/// How long a body may take to arrive.
const PATIENCE: Duration = Duration::from_secs(60);
/// How much of a body that is too large is read and thrown away, so that a client that writes first
/// and reads later sees the answer instead of a broken connection.
const DISCARDED: usize = 128 << 20;

/// What memory for bodies is counted in (bytes).
const UNIT: usize = 16 << 10;
/// When a client that found no room for its body may come back (s).
const RETRY_AFTER_S: u64 = 2;

/// Memory for all bodies that are being received, or wait for their turn, or are worked on.
#[derive(Debug, Clone)]
pub struct BodyRoom(Arc<Semaphore>);

impl BodyRoom {
    /// Room for `bytes` in all, at least one unit.
    pub fn new(bytes: usize) -> Self {
        let units = (bytes / UNIT).clamp(1, Semaphore::MAX_PERMITS.min(u32::MAX as usize));
        Self(Arc::new(Semaphore::new(units)))
    }

    /// Room for `more` units, beside what `held` has.
    fn take(&self, more: usize, held: &mut Option<OwnedSemaphorePermit>) -> Result<(), ApiError> {
        let full = ApiError::TooManyBodies { retry_after_s: RETRY_AFTER_S };
        let Ok(units) = u32::try_from(more) else { return Err(full) };
        let permit = Arc::clone(&self.0).try_acquire_many_owned(units).map_err(|_| full)?;
        match held {
            Some(held) => held.merge(permit),
            None => *held = Some(permit),
        }
        Ok(())
    }
}

/// The room of one body: it is free again when the last clone is gone.
#[derive(Debug, Clone)]
pub struct Held {
    _room: Arc<Option<OwnedSemaphorePermit>>,
}

impl Held {
    /// The room that the layer in front has put into the extensions.
    pub fn known(extensions: &Extensions) -> Self {
        extensions.get::<Self>().cloned().unwrap_or_else(|| Self { _room: Arc::new(None) })
    }

    /// `content`, taken from the body whose room this is: the room is held for as long as any of it is.
    pub fn bytes(&self, content: impl AsRef<[u8]> + Send + 'static) -> Bytes {
        Bytes::from_owner(Kept { content, _room: self.clone() })
    }
}

/// Content with the room that it takes.
struct Kept<T> {
    content: T,
    _room: Held,
}

impl<T: AsRef<[u8]>> AsRef<[u8]> for Kept<T> {
    fn as_ref(&self) -> &[u8] {
        self.content.as_ref()
    }
}

/// Reads a JSON body of at most `limit` bytes.
///
/// # Errors
/// When it says that it is something else, is larger, too slow, finds no room, or breaks off.
pub async fn read_json(
    room: &BodyRoom,
    headers: &HeaderMap,
    body: Body,
    limit: usize,
) -> Result<Bytes, ApiError> {
    expect_json(headers)?;
    let (bytes, held) = read(room, headers, body, limit).await?;
    Ok(held.bytes(bytes))
}

/// Reads the body of a bundle, whose kind has been checked, of at most `limit` bytes.
///
/// # Errors
/// When it is larger, too slow, finds no room, or breaks off.
pub async fn read_bundle(
    room: &BodyRoom,
    headers: &HeaderMap,
    body: Body,
    limit: usize,
) -> Result<Bytes, ApiError> {
    let (bytes, held) = read(room, headers, body, limit).await?;
    Ok(held.bytes(bytes))
}

/// Reads a body of at most `limit` bytes, whatever it is; also gives the room that it takes.
///
/// # Errors
/// When it is larger, too slow, finds no room, or breaks off.
pub async fn read(
    room: &BodyRoom,
    headers: &HeaderMap,
    body: Body,
    limit: usize,
) -> Result<(BytesMut, Held), ApiError> {
    let announced =
        headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse::<usize>().ok());
    let too_large = announced.is_some_and(|length| length > limit);
    if too_large
        && (headers.contains_key(header::EXPECT) || announced.is_some_and(|length| length > DISCARDED))
    {
        // The client waits for our word before it sends, or sends more than we care to read.
        return Err(ApiError::TooLarge { limit });
    }
    tokio::time::timeout(PATIENCE, collect(room, body, limit))
        .await
        .map_err(|_| ApiError::BodyTimeout { seconds: PATIENCE.as_secs() })?
}

async fn collect(room: &BodyRoom, body: Body, limit: usize) -> Result<(BytesMut, Held), ApiError> {
    let mut chunks = body.into_data_stream();
    let (mut bytes, mut held, mut units) = (BytesMut::new(), None, 0);
    let mut read = 0_usize;
    while let Some(chunk) = chunks.next().await {
        let chunk = chunk.map_err(|_| ApiError::BodyBroken)?;
        read += chunk.len();
        if read > DISCARDED {
            break;
        }
        if read > limit {
            (bytes, held, units) = (BytesMut::new(), None, 0);
            continue;
        }
        let wanted = read.div_ceil(UNIT);
        if wanted > units {
            room.take(wanted - units, &mut held)?;
            units = wanted;
        }
        bytes.extend_from_slice(&chunk);
    }
    if read > limit {
        return Err(ApiError::TooLarge { limit });
    }
    Ok((bytes, Held { _room: Arc::new(held) }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn bodies_share_their_room_and_give_it_back() {
        let room = BodyRoom::new(4 * UNIT);
        let (headers, limit) = (HeaderMap::new(), 100 * UNIT);
        let receive =
            |units: usize| read_bundle(&room, &headers, Body::from(vec![b' '; units * UNIT]), limit);
        let first = receive(3).await.unwrap();
        assert_eq!(first.len(), 3 * UNIT);
        assert!(matches!(receive(2).await, Err(ApiError::TooManyBodies { .. })));
        let second = receive(1).await.unwrap();
        // What is cut out of a body keeps its room.
        let part = first.slice(..5);
        drop(first);
        assert!(matches!(receive(1).await, Err(ApiError::TooManyBodies { .. })));
        drop((part, second));
        assert!(receive(4).await.is_ok());
        assert!(matches!(receive(101).await, Err(ApiError::TooLarge { .. })));
        assert!(receive(4).await.is_ok(), "what was too large has left nothing behind");
    }
}
