//! Who is let in: connections are counted in all and per address, and one over which no request comes is closed.

use std::collections::BTreeMap;
use std::io::{Error, ErrorKind, IoSlice, Result};
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::serve::Listener;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;

use super::ApiError;
use super::figures::Figures;

/// How long the first request's head may take on a new connection unless told otherwise. Longer than clients
/// keep connections in stock, so that none is closed in the moment in which it is used first.
const SILENCE: Duration = Duration::from_secs(120);

/// A listener that lets only so many in.
pub struct Door {
    listener: TcpListener,
    inside: Arc<Inside>,
    figures: Arc<Figures>,
    /// Most connections in all.
    limit: usize,
    /// Most connections from one address.
    own: usize,
    /// How long the first head may take.
    silence: Duration,
    /// Ends the wait for first heads.
    shutdown: CancellationToken,
}

/// Who is inside.
#[derive(Debug, Default)]
struct Inside {
    open: Mutex<BTreeMap<IpAddr, usize>>,
}

impl Inside {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<IpAddr, usize>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets one more in from `address`; else says which limit is reached.
    fn enter(
        self: &Arc<Self>,
        address: IpAddr,
        limit: usize,
        own: usize,
    ) -> std::result::Result<Place, usize> {
        let mut open = self.lock();
        let held = open.get(&address).copied().unwrap_or(0);
        if held >= own {
            return Err(own);
        }
        if open.values().sum::<usize>() >= limit {
            return Err(limit);
        }
        open.insert(address, held + 1);
        Ok(Place { inside: Arc::clone(self), address })
    }
}

/// The right to be inside.
#[derive(Debug)]
struct Place {
    inside: Arc<Inside>,
    address: IpAddr,
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut open = self.inside.lock();
        if let Some(count) = open.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                open.remove(&self.address);
            }
        }
    }
}

impl Door {
    /// Lets `limit` connections in at `listener`, and `own` from each address. Once `shutdown` is raised,
    /// nobody's first head is waited for.
    pub fn new(
        listener: TcpListener,
        limit: usize,
        own: usize,
        figures: Arc<Figures>,
        shutdown: CancellationToken,
    ) -> Self {
        Self { listener, inside: Arc::default(), figures, limit, own, silence: SILENCE, shutdown }
    }
}

impl Listener for Door {
    type Io = Guest;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Guest, SocketAddr) {
        loop {
            let (stream, address) = Listener::accept(&mut self.listener).await;
            match self.inside.enter(address.ip(), self.limit, self.own) {
                Ok(place) => {
                    // Events are small and must not wait for company.
                    if let Err(error) = stream.set_nodelay(true) {
                        tracing::debug!(%error, "no TCP_NODELAY");
                    }
                    let (silence, shutdown) = (self.silence, self.shutdown.clone());
                    let patience: Patience = Box::pin(async move {
                        tokio::select! {
                            () = tokio::time::sleep(silence) => {}
                            () = shutdown.cancelled() => {}
                        }
                    });
                    let waiting = Some((FirstHead::default(), patience));
                    return (Guest { stream, waiting, _place: place }, address);
                }
                Err(limit) => {
                    let refusal = ApiError::TooManyConnections { limit };
                    self.figures.refused(refusal.code());
                    tracing::debug!(%address, limit, "a connection is turned away");
                    // Fits into an empty buffer, or goes nowhere.
                    let _ = stream.try_write(refusal.http_text().as_bytes());
                }
            }
        }
    }

    fn local_addr(&self) -> Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// How much has come of the first request's head, which an empty line ends; HTTP/2 begins with such a one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum FirstHead {
    /// Nothing, or line ends, which may stand before it.
    #[default]
    Nothing,
    /// Part of a line.
    InLine,
    /// Whole lines.
    Lines,
    /// All of it.
    Whole,
}

impl FirstHead {
    /// What has come after `bytes` more.
    fn after(self, bytes: &[u8]) -> Self {
        bytes.iter().fold(self, |head, byte| match (head, byte) {
            (Self::Whole, _) | (Self::Lines, b'\n') => Self::Whole,
            (Self::InLine, b'\n') => Self::Lines,
            (Self::Nothing | Self::Lines, b'\r') | (Self::Nothing, b'\n') => head,
            _ => Self::InLine,
        })
    }
}

/// Ends when a head is no longer waited for.
type Patience = Pin<Box<dyn Future<Output = ()> + Send + Sync>>;

/// A connection that was let in.
pub struct Guest {
    stream: TcpStream,
    /// What has come of the first head, and how long the rest is waited for; nothing once it is there.
    waiting: Option<(FirstHead, Patience)>,
    _place: Place,
}

impl AsyncRead for Guest {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<Result<()>> {
        let guest = &mut *self;
        let before = into.filled().len();
        let read = Pin::new(&mut guest.stream).poll_read(context, into);
        let Some((head, patience)) = &mut guest.waiting else { return read };
        *head = head.after(into.filled().get(before..).unwrap_or_default());
        if *head == FirstHead::Whole {
            guest.waiting = None;
        } else if patience.as_mut().poll(context).is_ready() {
            // Too late for what has just come, too.
            return Poll::Ready(Err(Error::from(ErrorKind::TimedOut)));
        }
        read
    }
}

impl AsyncWrite for Guest {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        pieces: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        Pin::new(&mut self.stream).poll_write_vectored(context, pieces)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}

/// How many files the system lets this process open, where it says so.
pub fn files_allowed() -> Option<usize> {
    let limits = std::fs::read_to_string("/proc/self/limits").ok()?;
    let line = limits.lines().find_map(|line| line.strip_prefix("Max open files"))?;
    line.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_are_counted_by_address_and_in_all() {
        let inside = Arc::new(Inside::default());
        let [a, b, c] = [1, 2, 3].map(|last| IpAddr::from([10, 0, 0, last]));
        let first = inside.enter(a, 3, 2).unwrap();
        let _second = inside.enter(a, 3, 2).unwrap();
        assert_eq!(inside.enter(a, 3, 2).unwrap_err(), 2);
        let _third = inside.enter(b, 3, 2).unwrap();
        assert_eq!(inside.enter(c, 3, 2).unwrap_err(), 3);
        drop(first);
        inside.enter(a, 3, 2).unwrap();
        assert_eq!(inside.lock().len(), 2, "who is gone leaves nothing behind");
    }

    #[tokio::test]
    async fn who_says_nothing_is_shown_out() {
        use tokio::io::{AsyncReadExt, AsyncWriteExt};
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let shutdown = CancellationToken::new();
        let mut door = Door::new(listener, 9, 9, Arc::new(Figures::new().unwrap()), shutdown.clone());
        let (mut text, half) = (String::new(), "GET /livez HTT");
        door.silence = Duration::from_millis(20);
        for said in ["", half] {
            let mut talks = TcpStream::connect(address).await.unwrap();
            talks.write_all(said.as_bytes()).await.unwrap();
            let mut guest = door.accept().await.0;
            let end = guest.read_to_string(&mut text).await;
            assert_eq!(end.unwrap_err().kind(), ErrorKind::TimedOut, "{said}");
        }
        // Who has asked once may be silent.
        let mut talks = TcpStream::connect(address).await.unwrap();
        talks.write_all(b"GET / HTTP/1.1\r\n\r\n").await.unwrap();
        let mut guest = door.accept().await.0;
        assert_eq!(guest.read_exact(&mut [0; 18]).await.unwrap(), 18);
        let later = tokio::time::timeout(10 * door.silence, guest.read_u8()).await;
        assert!(later.is_err(), "{later:?}");
        // A shutdown waits for nobody's.
        door.silence = Duration::from_secs(600);
        let mut talks = TcpStream::connect(address).await.unwrap();
        talks.write_all(half.as_bytes()).await.unwrap();
        let mut guest = door.accept().await.0;
        shutdown.cancel();
        let end = guest.read_to_string(&mut text).await;
        assert_eq!(end.unwrap_err().kind(), ErrorKind::TimedOut);
    }

    #[test]
    fn a_head_ends_with_its_first_empty_line() {
        for whole in
            ["GET / HTTP/1.1\r\nhost: x\r\n\r\n", "\r\nGET / HTTP/1.1\n\n", "PRI * HTTP/2.0\r\n\r\nSM"]
        {
            assert_eq!(FirstHead::default().after(whole.as_bytes()), FirstHead::Whole, "{whole:?}");
            // In pieces it is the same.
            let pieces = whole.as_bytes().chunks(1);
            assert_eq!(pieces.fold(FirstHead::default(), FirstHead::after), FirstHead::Whole, "{whole:?}");
        }
        for part in ["", "\r\n\r\n\n", "GET / HTTP/1.1\r\nhost: x\r\n", "GET / HTTP/1.1\r\nhost: x\r\n\r"] {
            assert_ne!(FirstHead::default().after(part.as_bytes()), FirstHead::Whole, "{part:?}");
        }
    }
}
