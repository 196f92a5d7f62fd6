//! Connections: accepted up to a limit, set up for frames that must not wait in buffers, ended in
//! good order.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_rustls::server::TlsStream;
use tokio_util::either::Either;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

use super::linger::{Lingerers, Lingering};
use super::tls::Tls;
use crate::access::{Gate, Peer, PeerKey, PeerPermit, Peers, Refusal, TrustedProxies};
use crate::config::Config;

/// How many connections may speak HTTP at once. One that has become a WebSocket counts there.
const CONNECTIONS_MAX: usize = 512;

/// How long a client may take to send a request's head, idle time between requests included.
const HEAD_TIMEOUT: Duration = Duration::from_secs(30);

/// How long a client may take to begin TLS.
const TLS_TIMEOUT: Duration = Duration::from_secs(10);

/// How many headers a request may have. Browsers send twenty, proxies add some.
const HEADERS_MAX: usize = 64;

/// A request's head that has not ended after so many bytes is refused. It is looked at after each read, of as many bytes
/// again, so one of 32 KiB never passes. Also what is read of a body at once.
const HEAD_BUFFER_BYTES: usize = 16 * 1024;

/// After a failed accept (no file descriptors left, mostly) the next try waits.
const ACCEPT_RETRY_INTERVAL: Duration = Duration::from_millis(200);

/// How much the kernel may take of a socket that it has not sent yet. More would only let frames
/// grow old there, behind the latest-wins slot. Tuned: 16 KiB keeps a link of 100 Mbit/s busy
/// for 1 ms, which is enough to be woken.
#[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
const NOT_SENT_MAX_BYTES: u32 = 16 * 1024;

/// What connections are held to.
#[derive(Clone)]
pub struct ConnectionSettings {
    /// Speaks TLS; without it plain HTTP.
    pub tls: Option<Arc<Tls>>,
    /// Connections that one peer may have. Requests on more are refused.
    pub per_peer_max: u32,
    /// Proxies that are believed where requests come from.
    pub proxies: Arc<TrustedProxies>,
    /// Hears of what is refused before there is a request.
    pub gate: Option<Arc<Gate>>,
}

impl ConnectionSettings {
    pub(super) fn new(config: &Config, tls: Option<Arc<Tls>>, gate: Arc<Gate>) -> Self {
        let limits = config.limits.resolved(config.serves_this_machine_alone());
        Self {
            tls,
            per_peer_max: limits.connections_per_peer_max,
            proxies: Arc::new(config.proxies()),
            gate: Some(gate),
        }
    }

    fn count(&self, refusal: Refusal) {
        if let Some(gate) = &self.gate {
            gate.count(refusal);
        }
    }
}

/// Serves until `shutdown`, then until the requests that run have ended.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    settings: ConnectionSettings,
    shutdown: CancellationToken,
) {
    let connections = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    let peers = Arc::new(Peers::default());
    let lingerers = Lingerers::default();
    let running = TaskTracker::new();
    loop {
        let accepted = tokio::select! {
            accepted = accept(&listener, &connections) => accepted,
            () = shutdown.cancelled() => break,
        };
        let (stream, address, permit) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(%error, "accepting a connection failed");
                tokio::time::sleep(ACCEPT_RETRY_INTERVAL).await;
                continue;
            }
        };
        set_up(&stream);
        let mut peer = Peer::at(address.ip());
        // A proxy's connections are those of all its clients.
        let is_proxy = settings.proxies.trusts(address.ip());
        let of_peer = if is_proxy {
            None
        } else {
            peers.try_add(peer.key, settings.per_peer_max)
        };
        peer.has_too_many_connections = !is_proxy && of_peer.is_none();
        let connection = Connection {
            router: router.clone(),
            settings: settings.clone(),
            peer,
            address: address.ip(),
            shutdown: shutdown.clone(),
            _permits: (permit, of_peer),
        };
        running.spawn(connection.run(lingerers.guard(stream)));
    }
    drop(listener);
    running.close();
    running.wait().await;
}

/// A connection that was accepted.
struct Connection {
    router: Router,
    settings: ConnectionSettings,
    peer: Peer,
    address: IpAddr,
    shutdown: CancellationToken,
    _permits: (OwnedSemaphorePermit, Option<PeerPermit>),
}

impl Connection {
    async fn run(self, stream: Lingering) {
        let Some(tls) = &self.settings.tls else {
            return self.speak(Either::Left(stream)).await;
        };
        let handshake = tokio::time::timeout(TLS_TIMEOUT, tls.acceptor().accept(stream));
        let result = tokio::select! {
            result = handshake => result,
            () = self.shutdown.cancelled() => return,
        };
        match result {
            Ok(Ok(stream)) => self.speak(Either::Right(stream)).await,
            Ok(Err(error)) => {
                self.settings.count(Refusal::Tls);
                tracing::debug!(%error, "a connection does not speak TLS");
            }
            Err(_) => {
                self.settings.count(Refusal::Tls);
                tracing::debug!("a connection does not begin TLS");
            }
        }
    }

    /// Speaks HTTP until the connection has ended or become a WebSocket.
    async fn speak(self, stream: Either<Lingering, TlsStream<Lingering>>) {
        let (peer, address) = (self.peer, self.address);
        let proxies = Arc::clone(&self.settings.proxies);
        let service = self.router.map_request(move |request: Request<Incoming>| {
            let mut request = request.map(Body::new);
            let client = proxies.client_of(address, request.headers());
            request.extensions_mut().insert(Peer {
                key: PeerKey::of(client),
                ..peer
            });
            request
        });
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_TIMEOUT)
            .max_headers(HEADERS_MAX)
            .max_buf_size(HEAD_BUFFER_BYTES)
            .serve_connection(TokioIo::new(stream), TowerToHyperService::new(service))
            .with_upgrades();
        let mut connection = std::pin::pin!(connection);
        let result = tokio::select! {
            result = connection.as_mut() => result,
            () = self.shutdown.cancelled() => {
                connection.as_mut().graceful_shutdown();
                connection.await
            }
        };
        if let Err(error) = result {
            if error.is_parse_too_large() {
                self.settings.count(Refusal::Head);
            }
            tracing::debug!(%error, "a connection failed");
        }
    }
}

async fn accept(
    listener: &TcpListener,
    connections: &Arc<Semaphore>,
) -> std::io::Result<(TcpStream, SocketAddr, OwnedSemaphorePermit)> {
    let permit = Arc::clone(connections)
        .acquire_owned()
        .await
        .map_err(std::io::Error::other)?;
    let (stream, address) = listener.accept().await?;
    Ok((stream, address, permit))
}

/// Both settings only make frames younger, so a system that refuses them is no error.
fn set_up(stream: &TcpStream) {
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "TCP_NODELAY was refused");
    }
    #[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
    if let Err(error) = socket2::SockRef::from(stream).set_tcp_notsent_lowat(NOT_SENT_MAX_BYTES) {
        tracing::debug!(%error, "TCP_NOTSENT_LOWAT was refused");
    }
}
