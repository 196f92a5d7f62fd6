//! `skycell-server serve`: from the configuration to the end of the process.

use std::io::IsTerminal;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;
use skycell_server::access;
use skycell_server::config::Config;
use skycell_server::frame_loop::FrameLoop;
use skycell_server::frame_loop::interface::{FrameLoopHandle, RenderCommand};
use skycell_server::service::ServiceParts;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// How long the renderer may take to end.
const RENDERER_END_TIMEOUT: Duration = Duration::from_secs(5);

/// Serves until SIGTERM or ctrl-c.
pub(crate) fn run(config: Config) -> anyhow::Result<()> {
    start_log(&config.log)?;
    config.log();
    let parts = ServiceParts::prepare(config)?;
    let (frame_loop, renderer) = start_renderer(&parts)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("cannot start the async runtime")?;
    let handle = frame_loop.clone();
    let served = runtime.block_on(async move {
        let service = parts.start(handle).await?;
        println!("listening on {}", service.url());
        wait_for_signal().await?;
        tracing::info!("shutting down");
        service.shutdown().await;
        anyhow::Ok(())
    });
    end_renderer(&frame_loop, renderer);
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

fn start_log(filter: &str) -> anyhow::Result<()> {
    let filter: EnvFilter = filter
        .parse()
        .with_context(|| format!("log = \"{filter}\" is no filter, such as info"))?;
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    tracing_subscriber::registry()
        .with(filter)
        .with(filter_fn(access::holds_no_secret))
        .with(lines)
        .init();
    Ok(())
}

async fn wait_for_signal() -> anyhow::Result<()> {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let mut terminate = signal(SignalKind::terminate()).context("cannot hear of SIGTERM")?;
        tokio::select! {
            result = tokio::signal::ctrl_c() => result.context("cannot hear of ctrl-c"),
            _ = terminate.recv() => Ok(()),
        }
    }
    #[cfg(not(unix))]
    tokio::signal::ctrl_c()
        .await
        .context("cannot hear of ctrl-c")
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
