//! A storm: all viewers connect at once, and once more after all were cut off. Whoever loses its connection otherwise, to
//! a server that is started anew, comes back by itself, each after a wait of its own.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use hdrhistogram::Histogram;
use serde::Serialize;
use skycell_protocol::message::{Acknowledgement, Hello};
use skycell_protocol::{Camera, FrameSize};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep, timeout};

use super::LoadError;
use super::viewer::{TimesMs, times_histogram};
use crate::retry::RetryDelays;
use crate::unix_time::unix_us_now;
use crate::{Connection, ConnectionError, ConnectionLimits, Event, ServerAddress};

/// Version of the report's format.
const REPORT_FORMAT: u32 = 1;
/// Every viewer has to have a picture within this time.
const SERVED_WITHIN: Duration = Duration::from_secs(5);
/// How long is waited at most.
const PATIENCE: Duration = Duration::from_secs(60);
/// How often viewers are asked how they are.
const LOOK_INTERVAL: Duration = Duration::from_millis(20);
/// How long viewers watch before they are cut off.
const WATCH: Duration = Duration::from_secs(1);
/// How long a try to connect may take.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);

/// Who takes part.
#[derive(Clone, Copy, Debug)]
pub struct StormOptions {
    /// How many.
    pub viewers: u32,
    /// Of every viewer's frames.
    pub size: FrameSize,
    /// Frames a second that every viewer wishes.
    pub fps: f64,
}

/// A storm's figures; the file that `--json` names.
#[derive(Clone, Debug, Serialize)]
pub struct StormReport {
    /// Version of this format.
    pub format: u32,
    /// How many viewers.
    pub viewers: u32,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The first time, and after all were cut off.
    pub rounds: Vec<StormRound>,
}

/// All viewers connect at once.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct StormRound {
    /// Viewers who got a picture.
    pub served: u32,
    /// From the start until the first picture, by viewer.
    pub first_frame_ms: TimesMs,
    /// Tries that were refused or failed.
    pub failed_tries: u64,
}

impl StormReport {
    /// Whether every viewer had a picture within 5 s, each time.
    pub fn is_kept(&self) -> bool {
        let limit_ms = SERVED_WITHIN.as_secs_f64() * 1e3;
        let is_kept = |round: &StormRound| {
            round.served == self.viewers && round.first_frame_ms.max <= limit_ms
        };
        self.rounds.iter().all(is_kept)
    }

    /// For people.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{} viewers of {}x{} connect at once\n",
            self.viewers, self.width, self.height
        );
        for (round, name) in self
            .rounds
            .iter()
            .zip(["at first", "after all were cut off"])
        {
            let times = round.first_frame_ms;
            text.push_str(&format!(
                "{name}: {} served; first picture after p50 {:.0}, p95 {:.0}, at most {:.0} ms; {} tries failed\n",
                round.served, times.p50, times.p95, times.max, round.failed_tries
            ));
        }
        text
    }
}

/// Both rounds.
///
/// # Errors
/// When no viewer can be made.
pub async fn run(
    address: &ServerAddress,
    options: &StormOptions,
) -> Result<StormReport, LoadError> {
    let mut storm = Storm::begin(address, options)?;
    let mut rounds = vec![storm.served(PATIENCE).await];
    sleep(WATCH).await;
    storm.cut();
    rounds.push(storm.served(PATIENCE).await);
    storm.leave().await;
    Ok(StormReport {
        format: REPORT_FORMAT,
        viewers: options.viewers,
        width: options.size.width(),
        height: options.size.height(),
        rounds,
    })
}

/// What viewers are to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    /// Watch; whoever still watches since an earlier round cuts its connection and connects again at once.
    Watch(u32),
    /// Say goodbye.
    Leave,
}

/// What a viewer knows of itself.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    /// Sessions in which a picture came.
    sessions: u64,
    /// When the first one of the last such session came.
    first_frame: Option<Instant>,
    failed_tries: u64,
}

/// Viewers who come back whenever their connection is lost. Dropping it cuts them off.
pub struct Storm {
    orders: watch::Sender<Order>,
    round: u32,
    begun: Instant,
    viewers: Vec<(Arc<Mutex<State>>, JoinHandle<()>)>,
    /// Of each viewer, when the round began.
    before: Vec<State>,
}

impl Storm {
    /// Lets all viewers connect at once.
    ///
    /// # Errors
    /// When no camera can be made.
    pub fn begin(address: &ServerAddress, options: &StormOptions) -> Result<Self, LoadError> {
        let (orders, heard) = watch::channel(Order::Watch(0));
        let mut viewers = Vec::new();
        for number in 0..options.viewers {
            // All around, so that they do not all see the same.
            let yaw_deg = 360.0 * f64::from(number) / f64::from(options.viewers);
            let camera = Camera::new([0.0, 2.0, 0.0], yaw_deg, 20.0, 60.0).map_err(|error| {
                LoadError::ViewerLost {
                    number: number as usize,
                    reason: error.to_string(),
                }
            })?;
            let hello = Hello::new(options.size, options.fps, camera);
            let state = Arc::new(Mutex::new(State::default()));
            let task = tokio::spawn(stay(
                address.clone(),
                hello,
                heard.clone(),
                Arc::clone(&state),
            ));
            viewers.push((state, task));
        }
        Ok(Self {
            orders,
            round: 0,
            begun: Instant::now(),
            before: vec![State::default(); viewers.len()],
            viewers,
        })
    }

    /// Cuts all connections, without a goodbye, and lets all connect at once.
    pub fn cut(&mut self) {
        self.expect_anew();
        self.round += 1;
        self.orders.send_replace(Order::Watch(self.round));
    }

    /// From now on a viewer counts as served when it gets the first picture of another session.
    pub fn expect_anew(&mut self) {
        self.before = self.states();
        self.begun = Instant::now();
    }

    /// Waits until every viewer is served since the storm began, or since [`Self::cut`] or [`Self::expect_anew`], or until
    /// the time is over.
    pub async fn served(&self, limit: Duration) -> StormRound {
        let until = Instant::now() + limit;
        loop {
            let round = self.round_so_far();
            if round.served as usize == self.viewers.len() || Instant::now() >= until {
                return round;
            }
            sleep(LOOK_INTERVAL).await;
        }
    }

    /// When each viewer that is served had its picture, counted from the start.
    pub fn first_frames(&self) -> Vec<Duration> {
        let since = |state: &State| {
            let first = state.first_frame?;
            Some(first.saturating_duration_since(self.begun))
        };
        let states = self.states();
        let served = states.iter().zip(&self.before);
        served
            .filter(|(now, before)| now.sessions > before.sessions)
            .filter_map(|(now, _)| since(now))
            .collect()
    }

    /// Lets everybody say goodbye.
    pub async fn leave(mut self) {
        self.orders.send_replace(Order::Leave);
        for (_, task) in std::mem::take(&mut self.viewers) {
            let _ = task.await;
        }
    }

    fn round_so_far(&self) -> StormRound {
        let first_frames = self.first_frames();
        let mut times_us: Histogram<u64> = times_histogram();
        for time in &first_frames {
            let time_us = u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
            times_us.saturating_record(time_us);
        }
        let states = self.states();
        let failed = states.iter().zip(&self.before);
        StormRound {
            served: u32::try_from(first_frames.len()).unwrap_or(u32::MAX),
            first_frame_ms: TimesMs::of(&times_us),
            failed_tries: failed
                .map(|(now, before)| now.failed_tries - before.failed_tries)
                .sum(),
        }
    }

    fn states(&self) -> Vec<State> {
        let of = |(state, _): &(Arc<Mutex<State>>, JoinHandle<()>)| *lock(state);
        self.viewers.iter().map(of).collect()
    }
}

impl Drop for Storm {
    fn drop(&mut self) {
        for (_, task) in &self.viewers {
            task.abort();
        }
    }
}

/// A viewer who comes back until it is told to leave.
async fn stay(
    address: ServerAddress,
    hello: Hello,
    mut orders: watch::Receiver<Order>,
    state: Arc<Mutex<State>>,
) {
    let mut delays = RetryDelays::default();
    loop {
        let order = *orders.borrow_and_update();
        if order == Order::Leave {
            return;
        }
        let watching = tokio::select! {
            end = watch_sky(&address, &hello, &state, &mut delays) => Some(end),
            changed = orders.changed() => match changed {
                // The session is dropped with its socket.
                Ok(()) => None,
                Err(_) => return,
            },
        };
        if watching.is_none() {
            delays.held();
            continue;
        }
        lock(&state).failed_tries += 1;
        let delay = delays.after_failure(fastrand::f64());
        // Whatever is said ends the wait.
        let _ = timeout(delay, orders.changed()).await;
    }
}

/// A session; returns when it ends.
async fn watch_sky(
    address: &ServerAddress,
    hello: &Hello,
    state: &Mutex<State>,
    delays: &mut RetryDelays,
) -> Result<(), ConnectionError> {
    let limits = ConnectionLimits {
        connect_timeout: CONNECT_TIMEOUT,
        ..ConnectionLimits::default()
    };
    let mut connection = Connection::open(address, hello.clone(), limits).await?;
    let mut is_first = true;
    loop {
        match connection.next_event().await? {
            Event::Frame(frame) => {
                if std::mem::take(&mut is_first) {
                    delays.held();
                    let mut state = lock(state);
                    state.sessions += 1;
                    state.first_frame = Some(Instant::now());
                }
                let acknowledgement = Acknowledgement {
                    received_us: Some(frame.received_unix_us),
                    present_us: Some(unix_us_now()),
                    ..Acknowledgement::of(frame.header.sequence)
                };
                connection.acknowledge(acknowledgement).await?;
            }
            Event::Complaint(complaint) => return Err(ConnectionError::Refused(complaint)),
            _ => {}
        }
    }
}

/// Nothing here is left half changed, so a panic elsewhere spoils nothing.
fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}
