//! The service edge as a whole: how it is put together, started and ended.
//!
//! In this order, because the renderer needs a sink and the edge needs the renderer:
//! [`ServiceParts::prepare`], then start the frame loop with [`ServiceParts::frame_sink`] and
//! [`ServiceParts::scene`], then [`ServiceParts::start`] with its handle, then, when it is time,
//! [`Service::shutdown`] and [`crate::frame_loop::interface::RenderCommand::Shutdown`].

mod http;
mod linger;
mod tls;

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::access::{self, ExposureError, Gate, TokenListError, Tokens};
use crate::api;
use crate::config::Config;
use crate::encode::EncoderPool;
use crate::field::FieldStore;
use crate::frame_loop::interface::{FrameLoopGone, FrameLoopHandle, FrameSink, RenderCommand};
use crate::metrics::Metrics;
use crate::scene::{SceneFileError, SceneSnapshot, SceneStore};
use crate::stream::{StreamContext, connection_limit};
use crate::viewers::ViewerRegistry;

pub use http::{ConnectionSettings, serve as serve_connections};
pub use tls::{Tls, TlsError};

/// How long sessions and requests may take to end.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(5);

/// How often recorded durations are folded into their buckets.
const METRICS_FOLD_INTERVAL: Duration = Duration::from_secs(5);

/// How often a scene is offered again to a renderer whose channel is full.
const SCENE_RETRY_INTERVAL: Duration = Duration::from_millis(50);

/// Why the service does not start.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ServiceError {
    /// The scene cannot be read or kept.
    #[error(transparent)]
    Scene(#[from] SceneFileError),
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {error}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why not.
        error: io::Error,
    },
    /// No threads for encoding.
    #[error("cannot start the encoder threads: {0}")]
    Encoders(#[from] rayon::ThreadPoolBuildError),
    /// The tokens cannot be read.
    #[error(transparent)]
    Tokens(#[from] TokenListError),
    /// It would be open to whoever reaches it.
    #[error(transparent)]
    Exposed(#[from] ExposureError),
    /// The certificate or its key cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The figures cannot be set up.
    #[error("cannot set up the metrics: {0}")]
    Metrics(#[from] metrics_exporter_prometheus::BuildError),
}

/// The parts of the service before it has a renderer.
pub struct ServiceParts {
    config: Config,
    scene: Arc<SceneStore>,
    viewers: Arc<ViewerRegistry>,
    metrics: Arc<Metrics>,
    encoders: Arc<EncoderPool>,
    tokens: Arc<Tokens>,
    tls: Option<Arc<Tls>>,
}

impl ServiceParts {
    /// Reads tokens and certificate, opens the scene and starts the encoders.
    ///
    /// # Errors
    /// If whoever reaches the server could change the sky, the scene's file is corrupt or the folder cannot be written,
    /// above all.
    pub fn prepare(config: Config) -> Result<Self, ServiceError> {
        let tokens = Tokens::open(config.tokens_file.clone(), config.tokens.0.clone())?;
        access::check_exposure(config.listen, &tokens)?;
        let tls = config.tls.as_ref().map(Tls::open).transpose()?;
        if tokens.is_empty() && !config.trusted_proxies.is_empty() {
            tracing::warn!(
                "trusted_proxies are set and no token is: whoever reaches the proxy may change the sky, unless it asks for more"
            );
        }
        if tls.is_none() && !config.listen.ip().to_canonical().is_loopback() {
            tracing::warn!(
                "tokens and pictures travel in the clear: set tls.certificate and tls.key, or put a proxy with TLS in front"
            );
        }
        let field = FieldStore::new(Some(config.render.noise_cache_dir.clone()));
        let scene = Arc::new(SceneStore::open_with(config.state_dir.clone(), field)?);
        let viewers = ViewerRegistry::with_pixels(
            config.viewers_max,
            config.limits.resolved(false).pixels_max,
        );
        let metrics = Arc::new(Metrics::new()?);
        let encoders = EncoderPool::new(
            config.encoder_threads,
            Arc::clone(&viewers),
            Arc::clone(&metrics),
        )?;
        Ok(Self {
            config,
            scene,
            viewers,
            metrics,
            encoders,
            tokens: Arc::new(tokens),
            tls: tls.map(Arc::new),
        })
    }

    /// The resolved configuration.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The scene that the renderer starts with.
    pub fn scene(&self) -> SceneSnapshot {
        self.scene.snapshot()
    }

    /// Where the renderer delivers frames.
    pub fn frame_sink(&self) -> Arc<dyn FrameSink> {
        Arc::clone(&self.encoders) as Arc<dyn FrameSink>
    }

    /// Listens and serves.
    ///
    /// # Errors
    /// If the address cannot be listened on.
    pub async fn start(self, frame_loop: FrameLoopHandle) -> Result<Service, ServiceError> {
        let listen_error = |error| ServiceError::Listen {
            address: self.config.listen,
            error,
        };
        let listener = TcpListener::bind(self.config.listen)
            .await
            .map_err(listen_error)?;
        let address = listener.local_addr().map_err(listen_error)?;
        let shutdown = CancellationToken::new();
        let draining = CancellationToken::new();
        let gate = Gate::new(
            &self.config,
            Arc::clone(&self.tokens),
            Arc::clone(&self.metrics),
        );
        let connections =
            ConnectionSettings::new(&self.config, self.tls.clone(), Arc::clone(&gate));
        let context = Arc::new(StreamContext {
            viewers: self.viewers,
            frame_loop: frame_loop.clone(),
            scene: Arc::clone(&self.scene),
            metrics: Arc::clone(&self.metrics),
            encoders: self.encoders,
            video_kbit_per_s: self.config.video_kbit_per_s,
            stall: Duration::from_secs_f64(self.config.viewer_stall_s),
            gate,
            allowed_origins: self.config.allowed_origins,
            draining: draining.clone(),
            shutdown: shutdown.clone(),
            sessions: TaskTracker::new(),
            connections: connection_limit(self.config.viewers_max),
            subscribers: Arc::new(Semaphore::new(api::SUBSCRIBERS_MAX)),
            snapshots: api::SnapshotQueue::default(),
        });
        let sessions = context.sessions.clone();
        let is_tls = self.tls.is_some();
        let background = [
            tokio::spawn(forward_scenes(self.scene, frame_loop)),
            tokio::spawn(fold_metrics(self.metrics)),
            tokio::spawn(read_again_on_hangup(self.tokens, self.tls)),
        ];
        let server = tokio::spawn(http::serve(
            listener,
            api::router(context),
            connections,
            shutdown.clone(),
        ));
        Ok(Service {
            address,
            draining,
            is_tls,
            shutdown,
            sessions,
            server,
            background,
        })
    }
}

/// The running service.
pub struct Service {
    address: SocketAddr,
    draining: CancellationToken,
    is_tls: bool,
    shutdown: CancellationToken,
    sessions: TaskTracker,
    server: JoinHandle<()>,
    background: [JoinHandle<()>; 3],
}

impl Service {
    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Takes no more viewers and is not ready any more, so that whoever spreads viewers over servers looks elsewhere.
    /// Everything else goes on.
    pub fn drain(&self) {
        self.draining.cancel();
    }

    /// Where a browser finds it.
    pub fn url(&self) -> String {
        let scheme = if self.is_tls { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }

    /// Takes no more connections, closes the sessions (code 1012, service restart) and waits for
    /// them and for requests that run, at most five seconds.
    pub async fn shutdown(self) {
        self.draining.cancel();
        self.shutdown.cancel();
        self.sessions.close();
        let ended = async {
            self.sessions.wait().await;
            if let Err(error) = self.server.await {
                tracing::error!(%error, "the HTTP server failed");
            }
        };
        if tokio::time::timeout(SHUTDOWN_TIMEOUT, ended).await.is_err() {
            tracing::warn!("some connections did not end in time and are cut");
        }
        for task in self.background {
            task.abort();
        }
    }
}

/// Tells the renderer of every new scene; of those that come while it is busy, the last.
async fn forward_scenes(store: Arc<SceneStore>, frame_loop: FrameLoopHandle) {
    let mut changes = store.subscribe();
    // The store keeps the sender, so this ends with the task.
    while changes.changed().await.is_ok() {
        loop {
            let snapshot = changes.borrow_and_update().clone();
            let command = RenderCommand::SetScene {
                scene: snapshot.scene,
                revision: snapshot.revision,
            };
            match frame_loop.send(command) {
                Ok(()) => break,
                Err(FrameLoopGone::Behind) => tokio::time::sleep(SCENE_RETRY_INTERVAL).await,
                Err(FrameLoopGone::Ended) => {
                    tracing::error!("the renderer has ended and hears of no new scene");
                    return;
                }
            }
        }
    }
}

async fn fold_metrics(metrics: Arc<Metrics>) {
    let mut ticks = tokio::time::interval(METRICS_FOLD_INTERVAL);
    loop {
        ticks.tick().await;
        metrics.fold();
    }
}

/// Reads tokens and certificate again at SIGHUP. What cannot be read stays as it was.
async fn read_again_on_hangup(tokens: Arc<Tokens>, tls: Option<Arc<Tls>>) {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let Ok(mut hangups) = signal(SignalKind::hangup()) else {
            return;
        };
        while hangups.recv().await.is_some() {
            match tokens.read_again() {
                Ok(count) => tracing::info!(count, "tokens were read again"),
                Err(error) => tracing::error!(%error, "the tokens stay as they were"),
            }
            if let Some(tls) = &tls {
                match tls.read_again() {
                    Ok(()) => tracing::info!("the certificate was read again"),
                    Err(error) => tracing::error!(%error, "the certificate stays as it was"),
                }
            }
        }
    }
    #[cfg(not(unix))]
    drop((tokens, tls));
}
