//! A viewer who looks to and fro, decodes what comes, and counts.

use std::collections::VecDeque;
use std::time::Duration;

use anyhow::Context;
use skycell_client::unix_time::unix_us_now;
use skycell_client::{Connection, ConnectionLimits, Event, ServerAddress, picture};
use skycell_protocol::message::{Acknowledgement, Hello};
use skycell_protocol::{FrameHeader, FrameSize, InputSequence};
use skycell_tests::viewer::camera;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{Instant, MissedTickBehavior, interval};

/// To each side.
const SWING_DEG: f64 = 12.0;
/// To and fro.
const SWING_S: f64 = 3.0;

/// A frame as its viewer saw it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shown {
    pub(crate) header: FrameHeader,
    pub(crate) message_bytes: usize,
    pub(crate) received_unix_us: u64,
    /// From sending the input that it is the first to show until it was decoded.
    pub(crate) motion_us: Option<u64>,
}

impl Shown {
    pub(crate) fn age_ms(&self) -> f64 {
        let age_us = self
            .received_unix_us
            .saturating_sub(self.header.render_unix_us);
        age_us as f64 * 1e-3
    }
}

/// What a viewer is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Doing {
    Turns,
    Rests,
    Leaves,
}

/// A viewer in the background.
pub(crate) struct Turning {
    doing: watch::Sender<Doing>,
    shown: watch::Receiver<Vec<Shown>>,
    task: JoinHandle<anyhow::Result<()>>,
}

impl Turning {
    pub(crate) async fn join(
        address: &ServerAddress,
        size: (u32, u32),
        fps: f64,
    ) -> anyhow::Result<Self> {
        let hello = Hello::new(
            FrameSize::new(size.0, size.1)?,
            fps,
            camera([0.0, 2.0, 0.0], 0.0, 20.0)?,
        );
        let connection = Connection::open(address, hello, ConnectionLimits::default()).await?;
        let (doing, orders) = watch::channel(Doing::Turns);
        let (sees, shown) = watch::channel(Vec::new());
        let task = tokio::spawn(run(connection, fps, orders, sees));
        Ok(Self { doing, shown, task })
    }

    pub(crate) fn now(&self, doing: Doing) {
        self.doing.send_replace(doing);
    }

    /// All frames so far.
    pub(crate) fn shown(&self) -> Vec<Shown> {
        self.shown.borrow().clone()
    }

    /// Frames that come in a time.
    pub(crate) async fn watch(&self, time: Duration) -> Vec<Shown> {
        let before = self.shown.borrow().len();
        tokio::time::sleep(time).await;
        self.shown.borrow()[before..].to_vec()
    }

    /// Waits for a frame after those so far.
    pub(crate) async fn wait_for(
        &self,
        what: &str,
        wanted: impl Fn(&Shown) -> bool,
    ) -> anyhow::Result<Shown> {
        let mut shown = self.shown.clone();
        let before = shown.borrow().len();
        let found = tokio::time::timeout(
            skycell_tests::PATIENCE,
            shown.wait_for(|all| all.iter().skip(before).any(&wanted)),
        )
        .await
        .with_context(|| format!("no {what}"))??;
        let found = found.iter().skip(before).find(|frame| wanted(frame));
        found.copied().context("a frame")
    }

    pub(crate) async fn leave(self) -> anyhow::Result<()> {
        self.now(Doing::Leaves);
        self.task.await?
    }
}

async fn run(
    mut connection: Connection,
    fps: f64,
    mut orders: watch::Receiver<Doing>,
    sees: watch::Sender<Vec<Shown>>,
) -> anyhow::Result<()> {
    let begun = Instant::now();
    let mut inputs = interval(Duration::from_secs_f64(1.0 / fps));
    inputs.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut sent: VecDeque<(InputSequence, Instant)> = VecDeque::new();
    loop {
        let doing = *orders.borrow_and_update();
        if doing == Doing::Leaves {
            connection.close().await;
            return Ok(());
        }
        tokio::select! {
            _ = orders.changed() => {}
            _ = inputs.tick(), if doing == Doing::Turns => {
                let phase = begun.elapsed().as_secs_f64() / SWING_S * std::f64::consts::TAU;
                let yaw_deg = SWING_DEG * phase.sin();
                // The server may have it before this task is told that it was sent.
                let at = Instant::now();
                let input = connection.send_camera(camera([0.0, 2.0, 0.0], yaw_deg, 20.0)?).await?;
                sent.push_back((input, at));
            }
            event = connection.next_event() => {
                let Event::Frame(frame) = event? else { continue };
                let mut motion_since = None;
                while let Some((input, at)) = sent.front().copied() && input <= frame.header.input {
                    motion_since = Some(at);
                    sent.pop_front();
                }
                let decoding = Instant::now();
                picture::decode(&frame.header, frame.payload())?;
                let decode_us = decoding.elapsed().as_micros() as u32;
                let motion_us = motion_since.map(|at| at.elapsed().as_micros() as u64);
                sees.send_modify(|all| all.push(Shown {
                    header: frame.header,
                    message_bytes: frame.message_bytes(),
                    received_unix_us: frame.received_unix_us,
                    motion_us,
                }));
                connection.acknowledge(Acknowledgement {
                    decode_us: Some(decode_us),
                    received_us: Some(frame.received_unix_us),
                    present_us: Some(unix_us_now()),
                    motion_to_photon_us: motion_us.map(|us| us as u32),
                    ..Acknowledgement::of(frame.header.sequence)
                }).await?;
            }
        }
    }
}

/// What 95 of 100 do not exceed.
pub(crate) fn p95(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    let rank = (values.len() * 95).div_ceil(100).max(1);
    values.get(rank - 1).copied().unwrap_or(f64::NAN)
}
