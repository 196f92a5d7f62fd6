//! Sockets that stay open for a moment after they were let go of, so that the peer hears what was said last.
//!
//! A socket that is closed while something of the peer's is unread is reset, and a reset overtakes or undoes what the peer
//! has not taken yet (RFC 1122, section 4.2.2.13; RFC 9112, section 9.6). That is the case wherever a request or a message is
//! refused before its end: too large, not WebSocket. So the sending side is ended, and what still comes is thrown
//! away until the peer closes too, for a bounded time and a bounded number of bytes.

use std::io::{IoSlice, Result};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// For how long what a peer still says is read.
const LINGER_TIMEOUT: Duration = Duration::from_secs(2);

/// How much of it is read. More than that is no message that was on its way, it is a flood.
const LINGER_MAX_BYTES: u64 = 1024 * 1024;

/// How many sockets may stay open for it at once. Beyond that they are closed as they are.
const LINGERING_MAX: usize = 256;

/// Room for sockets that stay open for a moment.
#[derive(Clone)]
pub(super) struct Lingerers(Arc<Semaphore>);

impl Default for Lingerers {
    fn default() -> Self {
        Self(Arc::new(Semaphore::new(LINGERING_MAX)))
    }
}

impl Lingerers {
    /// The socket, which lingers when it is dropped.
    pub(super) fn guard(&self, stream: TcpStream) -> Lingering {
        Lingering {
            stream: Some(stream),
            lingerers: self.clone(),
            is_over: false,
        }
    }

    fn try_take(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.0).try_acquire_owned().ok()
    }
}

/// A socket that lingers when it is dropped, unless its peer has ended already.
pub(super) struct Lingering {
    /// Taken when it is dropped, and only then.
    stream: Option<TcpStream>,
    lingerers: Lingerers,
    /// The peer has ended, or the connection has failed: nothing of the peer's is unread.
    is_over: bool,
}

impl Lingering {
    fn stream(&mut self) -> Result<Pin<&mut TcpStream>> {
        match &mut self.stream {
            Some(stream) => Ok(Pin::new(stream)),
            None => Err(std::io::ErrorKind::NotConnected.into()),
        }
    }
}

impl Drop for Lingering {
    fn drop(&mut self) {
        let Some(stream) = self.stream.take() else {
            return;
        };
        // Outside a runtime everything ends anyway.
        if self.is_over || tokio::runtime::Handle::try_current().is_err() {
            return;
        }
        let Some(permit) = self.lingerers.try_take() else {
            tracing::debug!("too many sockets linger, so one is closed at once");
            return;
        };
        tokio::spawn(async move {
            // Whether it ends by the peer, the time or the bytes: then it is closed.
            let _ = tokio::time::timeout(LINGER_TIMEOUT, linger(stream)).await;
            drop(permit);
        });
    }
}

/// Ends the sending side and reads until the peer ends too.
async fn linger(mut stream: TcpStream) -> Result<()> {
    stream.shutdown().await?;
    let mut rest = stream.take(LINGER_MAX_BYTES);
    tokio::io::copy(&mut rest, &mut tokio::io::sink()).await?;
    Ok(())
}

impl AsyncRead for Lingering {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<Result<()>> {
        let filled = buf.filled().len();
        let has_room = buf.remaining() > 0;
        let result = self.stream()?.poll_read(cx, buf);
        match &result {
            Poll::Ready(Ok(())) => self.is_over |= has_room && buf.filled().len() == filled,
            Poll::Ready(Err(_)) => self.is_over = true,
            Poll::Pending => {}
        }
        result
    }
}

impl AsyncWrite for Lingering {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &[u8],
    ) -> Poll<Result<usize>> {
        self.stream()?.poll_write(cx, buf)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Result<()>> {
        self.stream()?.poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Result<()>> {
        self.stream()?.poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        self.stream()?.poll_write_vectored(cx, bufs)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream
            .as_ref()
            .is_some_and(TcpStream::is_write_vectored)
    }
}
