//! A soak: real viewers migrate over kilometres for minutes while cells merge, split and move, and the server's memory, its
//! heartbeats, its pictures and the error of its caches are watched.

mod migration;
pub mod report;
mod watch;

use super::LoadError;
use crate::{HttpApi, ServerAddress, ServerStats};
use indicatif::ProgressBar;
use report::{SoakReport, SoakSample};
use skycell_protocol::message::Hello;
use skycell_protocol::{FrameSize, QualityChoice};
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior, interval};
use watch::Watched;

/// Version of the report's format.
const REPORT_FORMAT: u32 = 1;
/// Samples that a report holds at most: a day's.
const SAMPLES_MAX: usize = 86_400;

/// What to soak with.
#[derive(Clone, Copy, Debug)]
pub struct SoakOptions {
    /// In the crowd.
    pub viewers: usize,
    /// How long.
    pub duration: Duration,
    /// Of every viewer's frames.
    pub size: FrameSize,
    /// Frames a second that every viewer wishes.
    pub fps: f64,
    /// Error that every viewer asks for, FLIP.
    pub max_error: f64,
    /// Seconds of the crowd in one of the clock.
    pub pace: f64,
}

type ViewerTask = JoinHandle<Result<(), crate::ConnectionError>>;

/// A crowd on its way. Dropping it cuts its connections.
struct Crowd {
    tasks: Vec<ViewerTask>,
    watched: Vec<Arc<Mutex<Watched>>>,
    stop: tokio::sync::watch::Sender<bool>,
}

impl Crowd {
    fn set_out(address: &ServerAddress, options: &SoakOptions) -> Result<Self, LoadError> {
        let (stop, stops) = tokio::sync::watch::channel(false);
        let begun = Instant::now();
        let mut crowd = Self {
            tasks: Vec::new(),
            watched: Vec::new(),
            stop,
        };
        for viewer in 0..options.viewers {
            let lost = |error: &dyn std::fmt::Display| LoadError::ViewerLost {
                number: viewer,
                reason: error.to_string(),
            };
            let camera = migration::camera(viewer, 0.0).map_err(|error| lost(&error))?;
            let hello = Hello {
                quality: Some(QualityChoice::MaxError(options.max_error)),
                ..Hello::new(options.size, options.fps, camera)
            };
            let watched = Arc::new(Mutex::new(Watched::default()));
            crowd.tasks.push(tokio::spawn(watch::run(
                address.clone(),
                hello,
                viewer,
                (begun, options.pace),
                watched.clone(),
                stops.clone(),
            )));
            crowd.watched.push(watched);
        }
        Ok(crowd)
    }

    fn watched(&self) -> Vec<Watched> {
        let of = |watched: &Arc<Mutex<Watched>>| {
            let watched = watched.lock().unwrap_or_else(PoisonError::into_inner);
            watched.clone()
        };
        self.watched.iter().map(of).collect()
    }

    async fn check(&mut self) -> Result<(), LoadError> {
        match self.tasks.iter().position(ViewerTask::is_finished) {
            Some(number) => {
                let task = self.tasks.swap_remove(number);
                let reason = match task.await {
                    Ok(Ok(())) => "it left by itself".to_owned(),
                    Ok(Err(error)) => error.to_string(),
                    Err(error) => error.to_string(),
                };
                Err(LoadError::ViewerLost { number, reason })
            }
            None => Ok(()),
        }
    }

    async fn leave(mut self) -> Vec<Watched> {
        let _ = self.stop.send(true);
        for task in std::mem::take(&mut self.tasks) {
            let _ = task.await;
        }
        self.watched()
    }
}

impl Drop for Crowd {
    fn drop(&mut self) {
        for task in &self.tasks {
            task.abort();
        }
    }
}

/// Lets a crowd migrate for as long as asked, or until `stop` is ready.
///
/// # Errors
/// If the server or a viewer fails, or somebody else is connected.
pub async fn soak(
    address: &ServerAddress,
    options: &SoakOptions,
    progress: &ProgressBar,
    stop: impl Future<Output = ()>,
) -> Result<SoakReport, LoadError> {
    let api = HttpApi::new(address.clone())?;
    tokio::select! {
        result = migrate(address, &api, options, progress) => result,
        () = stop => Err(LoadError::Interrupted),
    }
}

async fn migrate(
    address: &ServerAddress,
    api: &HttpApi,
    options: &SoakOptions,
    progress: &ProgressBar,
) -> Result<SoakReport, LoadError> {
    let before = super::wait::wait_until_empty(api).await?.stats;
    let mut crowd = Crowd::set_out(address, options)?;
    let begun = Instant::now();
    let mut samples = Vec::new();
    let mut seconds = interval(Duration::from_secs(1));
    seconds.set_missed_tick_behavior(MissedTickBehavior::Skip);
    progress.set_length(options.duration.as_secs());
    let mut last = before.clone();
    while begun.elapsed() < options.duration && samples.len() < SAMPLES_MAX {
        seconds.tick().await;
        crowd.check().await?;
        last = api.stats().await?;
        let frames = crowd.watched().iter().map(|watched| watched.frames).sum();
        samples.push(sample_of(&last, begun.elapsed(), frames));
        progress.set_position(begun.elapsed().as_secs());
        progress.set_message(format!("{} cells, {frames} frames", last.cells.len()));
    }
    let took = begun.elapsed();
    let watched = crowd.leave().await;
    let sum = |of: fn(&Watched) -> u64| watched.iter().map(of).sum();
    let longest = watched.iter().map(|w| w.longest_gap).max();
    let cpu_s = last.service.cpu_s.zip(before.service.cpu_s);
    Ok(SoakReport {
        format: REPORT_FORMAT,
        url: address.to_string(),
        adapter: last.adapter.name.clone(),
        viewers: options.viewers,
        width: options.size.width(),
        height: options.size.height(),
        fps: options.fps,
        max_error: options.max_error,
        seconds: took.as_secs_f64(),
        frames: sum(|w| w.frames),
        coarse_frames: sum(|w| w.coarse_frames),
        missed_heartbeats: sum(|w| w.gaps),
        longest_gap_ms: longest.unwrap_or_default().as_secs_f64() * 1e3,
        bad_pictures: sum(|w| w.bad_pictures),
        cell_changes: sum(|w| w.cell_changes),
        tiles_refused: last
            .losses
            .tiles_refused
            .saturating_sub(before.losses.tiles_refused),
        cpu_s: cpu_s.map(|(last, before)| last - before),
        samples,
    })
}

fn sample_of(stats: &ServerStats, at: Duration, frames: u64) -> SoakSample {
    SoakSample {
        at_s: at.as_secs_f64(),
        memory_bytes: stats.service.memory_bytes,
        cache_bytes: stats.totals.cache_bytes,
        cells: stats.cells.iter().filter(|c| !c.viewers.is_empty()).count(),
        audit_p95_percent: stats.audit.p95_percent,
        levels_lost: stats.losses.levels_lost_most,
        rate_step: stats.losses.rate_step,
        frames,
    }
}
