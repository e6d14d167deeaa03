//! Who is asking, and how many streams each client holds open.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::extract::ConnectInfo;
use axum::http::{Extensions, HeaderMap, HeaderName};

use super::ApiError;

/// Longest name that a proxy gives a client (bytes).
const LONGEST_NAME: usize = 128;
/// When a client that has too many streams may try again (s).
const RETRY_AFTER_S: u64 = 5;

/// Who is asking, as far as limits tell clients apart: the address, or what a trusted proxy says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Client(pub Arc<str>);

impl Client {
    /// Who sent a request with these headers and extensions.
    pub fn of(headers: &HeaderMap, extensions: &Extensions, trusted: Option<&HeaderName>) -> Self {
        let named = trusted.and_then(|name| headers.get(name)?.to_str().ok()).map(str::trim);
        if let Some(name) = named.filter(|name| !name.is_empty() && name.len() <= LONGEST_NAME) {
            return Self(name.into());
        }
        let address = extensions.get::<ConnectInfo<SocketAddr>>().map(|info| info.0.ip().to_string());
        Self(address.unwrap_or_default().into())
    }

    /// The client that the layer in front has put into the extensions.
    pub fn known(extensions: &Extensions) -> Self {
        extensions.get::<Self>().cloned().unwrap_or_else(|| Self("".into()))
    }
}

/// Counts open streams.
#[derive(Debug, Default)]
pub struct Streams {
    open: Mutex<BTreeMap<Arc<str>, usize>>,
}

/// The right to hold one stream open.
#[derive(Debug)]
pub struct StreamPermit {
    streams: Arc<Streams>,
    client: Arc<str>,
}

impl Streams {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<Arc<str>, usize>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How many are open.
    pub fn count(&self) -> usize {
        self.lock().values().sum()
    }

    /// Opens one more for `client`, if all have fewer than `total` and the client fewer than `own`.
    ///
    /// # Errors
    /// [`ApiError::TooManyStreams`].
    pub fn open(
        self: &Arc<Self>,
        client: &Client,
        total: usize,
        own: usize,
    ) -> Result<StreamPermit, ApiError> {
        let mut open = self.lock();
        let held = open.get(&client.0).copied().unwrap_or(0);
        for (limit, reached) in [(own, held >= own), (total, open.values().sum::<usize>() >= total)] {
            if reached {
                return Err(ApiError::TooManyStreams { limit, retry_after_s: RETRY_AFTER_S });
            }
        }
        open.insert(Arc::clone(&client.0), held + 1);
        Ok(StreamPermit { streams: Arc::clone(self), client: Arc::clone(&client.0) })
    }
}

impl Drop for StreamPermit {
    fn drop(&mut self) {
        let mut open = self.streams.lock();
        if let Some(count) = open.get_mut(&self.client) {
            *count -= 1;
            if *count == 0 {
                open.remove(&self.client);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_counted_by_client_and_in_all() {
        let streams = Arc::new(Streams::default());
        let [a, b] = ["a", "b"].map(|name| Client(name.into()));
        let first = streams.open(&a, 3, 2).unwrap();
        let _second = streams.open(&a, 3, 2).unwrap();
        assert!(matches!(streams.open(&a, 3, 2), Err(ApiError::TooManyStreams { limit: 2, .. })));
        let _third = streams.open(&b, 3, 2).unwrap();
        assert!(matches!(streams.open(&b, 3, 2), Err(ApiError::TooManyStreams { limit: 3, .. })));
        drop(first);
        assert_eq!(streams.count(), 2);
        streams.open(&b, 3, 2).unwrap();
    }

    #[test]
    fn a_trusted_header_names_the_client() {
        let name = HeaderName::from_static("x-client");
        let mut headers = HeaderMap::new();
        let mut extensions = Extensions::new();
        extensions.insert(ConnectInfo(SocketAddr::from(([10, 0, 0, 7], 1234))));
        assert_eq!(&*Client::of(&headers, &extensions, Some(&name)).0, "10.0.0.7");
        headers.insert(&name, "line 7".parse().unwrap());
        assert_eq!(&*Client::of(&headers, &extensions, Some(&name)).0, "line 7");
        assert_eq!(&*Client::of(&headers, &extensions, None).0, "10.0.0.7");
    }
}
