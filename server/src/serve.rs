//! `skycell-server serve`: from the configuration to the end of the process.

use std::io::IsTerminal;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;
use skycell_server::access;
use skycell_server::config::{Config, LogFormat};
use skycell_server::frame_loop::FrameLoop;
use skycell_server::frame_loop::interface::{FrameLoopHandle, RenderCommand};
use skycell_server::service::{Service, ServiceParts};
use tracing_subscriber::filter::{FilterExt, filter_fn};
use tracing_subscriber::layer::{Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Registry};

/// How long the renderer may take to end.
const RENDERER_END_TIMEOUT: Duration = Duration::from_secs(5);

/// How often is looked whether the renderer still runs.
const RENDERER_CHECK_INTERVAL: Duration = Duration::from_millis(200);

/// Serves until SIGTERM or ctrl-c, or until the renderer ends.
pub(crate) fn run(config: Config) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("cannot start the async runtime")?;
    let traces = start_log(&config, &runtime)?;
    let drain = Duration::from_secs_f64(config.drain_s);
    config.log();
    let parts = ServiceParts::prepare(config)?;
    let (frame_loop, renderer) = start_renderer(&parts)?;
    let handle = frame_loop.clone();
    let served = runtime.block_on(async {
        let mut signals = Signals::new()?;
        let service = parts.start(handle).await?;
        println!("listening on {}", service.url());
        let signal = tokio::select! {
            signal = signals.next() => Some(signal),
            () = ended(&renderer) => None,
        };
        let ending = end_service(service, signal, drain);
        tokio::select! {
            () = ending => {}
            _ = signals.next() => {
                // Whoever asks twice does not want to wait. Every acknowledged change is on disk.
                tracing::warn!("told again to end: leaving at once");
                std::process::exit(1);
            }
        }
        anyhow::ensure!(signal.is_some(), "the renderer has ended");
        Ok(())
    });
    end_renderer(&frame_loop, renderer);
    end_traces(traces);
    // What has not ended by now is cut.
    runtime.shutdown_timeout(Duration::from_millis(100));
    served
}

/// Starts the thread that owns the GPU and says who renders.
fn start_renderer(parts: &ServiceParts) -> anyhow::Result<(FrameLoopHandle, JoinHandle<()>)> {
    let scene = parts.scene();
    let (handle, thread) = FrameLoop::start(
        parts.config().render.clone(),
        scene.scene,
        scene.revision,
        parts.frame_sink(),
        &parts.config().cells,
    )?;
    let adapter = &handle.stats().adapter;
    println!(
        "rendering on {} ({}, {}, {})",
        adapter.name, adapter.driver, adapter.backend, adapter.device_type
    );
    Ok((handle, thread))
}

/// What exports traces; nothing in a build without them.
#[cfg(feature = "otlp")]
type TracesHandle = skycell_server::traces::Traces;
#[cfg(not(feature = "otlp"))]
type TracesHandle = ();

type BoxedLayer = Box<dyn Layer<Registry> + Send + Sync>;

/// Starts the log, and the export of traces where the configuration asks for it.
fn start_log(
    config: &Config,
    runtime: &tokio::runtime::Runtime,
) -> anyhow::Result<Option<TracesHandle>> {
    let filter: EnvFilter = config
        .log
        .parse()
        .with_context(|| format!("log = \"{}\" is no filter, such as info", config.log))?;
    let filter = filter.and(filter_fn(access::holds_no_secret));
    let log = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    let log: BoxedLayer = match config.log_format {
        LogFormat::Text => log
            .with_ansi(std::io::stderr().is_terminal())
            .with_filter(filter)
            .boxed(),
        LogFormat::Json => log.json().flatten_event(true).with_filter(filter).boxed(),
    };
    let (traces, traces_layer) = start_traces(config, runtime)?;
    let layers: Vec<BoxedLayer> = std::iter::once(log).chain(traces_layer).collect();
    tracing_subscriber::registry().with(layers).init();
    Ok(traces)
}

#[cfg(feature = "otlp")]
fn start_traces(
    config: &Config,
    runtime: &tokio::runtime::Runtime,
) -> anyhow::Result<(Option<TracesHandle>, Option<BoxedLayer>)> {
    let Some(endpoint) = &config.otlp_endpoint else {
        return Ok((None, None));
    };
    let traces = TracesHandle::start(endpoint, config.otlp_frame_share, runtime.handle().clone())?;
    let layer = traces.layer::<Registry>().boxed();
    Ok((Some(traces), Some(layer)))
}

#[cfg(not(feature = "otlp"))]
fn start_traces(
    config: &Config,
    _runtime: &tokio::runtime::Runtime,
) -> anyhow::Result<(Option<TracesHandle>, Option<BoxedLayer>)> {
    anyhow::ensure!(
        config.otlp_endpoint.is_none(),
        "otlp_endpoint is set, and this server was built without the feature otlp"
    );
    Ok((None, None))
}

/// Sends the traces that wait.
fn end_traces(traces: Option<TracesHandle>) {
    #[cfg(feature = "otlp")]
    if let Some(traces) = traces {
        traces.end();
    }
    #[cfg(not(feature = "otlp"))]
    let _ = traces;
}

/// Why the process is to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Signal {
    /// Whoever runs it wants it gone: SIGTERM.
    Terminate,
    /// Somebody at the keyboard: SIGINT.
    Interrupt,
}

/// Waits for signals, from its making on.
struct Signals {
    #[cfg(unix)]
    terminate: tokio::signal::unix::Signal,
    #[cfg(unix)]
    interrupt: tokio::signal::unix::Signal,
}

impl Signals {
    #[cfg(unix)]
    fn new() -> anyhow::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            terminate: signal(SignalKind::terminate()).context("cannot hear of SIGTERM")?,
            interrupt: signal(SignalKind::interrupt()).context("cannot hear of SIGINT")?,
        })
    }

    #[cfg(unix)]
    async fn next(&mut self) -> Signal {
        tokio::select! {
            _ = self.terminate.recv() => Signal::Terminate,
            _ = self.interrupt.recv() => Signal::Interrupt,
        }
    }

    #[cfg(not(unix))]
    fn new() -> anyhow::Result<Self> {
        Ok(Self {})
    }

    #[cfg(not(unix))]
    async fn next(&mut self) -> Signal {
        match tokio::signal::ctrl_c().await {
            Ok(()) => Signal::Interrupt,
            Err(error) => {
                tracing::error!(%error, "cannot hear of ctrl-c");
                std::future::pending().await
            }
        }
    }
}

/// Returns when the renderer's thread has ended, which only a device that does not come back makes it do.
async fn ended(renderer: &JoinHandle<()>) {
    while !renderer.is_finished() {
        tokio::time::sleep(RENDERER_CHECK_INTERVAL).await;
    }
}

/// Drains where there is somebody to look elsewhere meanwhile, then closes the sessions.
async fn end_service(service: Service, signal: Option<Signal>, drain: Duration) {
    if signal == Some(Signal::Terminate) && !drain.is_zero() {
        tracing::info!(
            seconds = drain.as_secs_f64(),
            "draining: no viewer is taken any more"
        );
        service.drain();
        tokio::time::sleep(drain).await;
    }
    tracing::info!("shutting down");
    service.shutdown().await;
}

/// Ends the renderer's thread; a driver that hangs must not keep the process.
fn end_renderer(frame_loop: &FrameLoopHandle, renderer: JoinHandle<()>) {
    if let Err(error) = frame_loop.send(RenderCommand::Shutdown) {
        tracing::warn!(%error, "the renderer was not asked to end");
    }
    let until = Instant::now() + RENDERER_END_TIMEOUT;
    while !renderer.is_finished() && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(10));
    }
    if !renderer.is_finished() {
        tracing::error!("the renderer does not end; leaving without it");
    } else if renderer.join().is_err() {
        tracing::error!("the renderer panicked");
    }
}
