//! A device that is lost is opened again while its viewers stay.
//!
//! Drivers fail, GPUs are reset, virtual ones are taken away. Everything on the device is then gone, and nothing else: who
//! looks from where at which scene is known here. While another thread opens a device, this one takes what viewers say,
//! so that nobody is dropped for a full channel; then they all join the new renderer, with the numbers of frames and
//! inputs that they had.

use super::interface::{
    DeviceLossStats, FrameSink, ReadyGuard, RenderCommand, RenderStats, StatsCell, ViewRequest,
    ViewerRenderStats,
};
use super::pacing::FrameLoop;
use super::renderer::{Counters, SkyRenderer};
use super::screen_space::WindowChoice;
use super::sun_volumes::SunVolumeCounters;
use crate::config::{PlacedCell, RenderConfig};
use crate::gpu::{Gpu, GpuError, TimingSums};
use skycell_protocol::{InputSequence, Scene, ViewerId};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long to wait before each try to open a device; after the last one the renderer ends.
const OPENING_WAITS: [Duration; 6] = [
    Duration::ZERO,
    Duration::from_secs(1),
    Duration::from_secs(2),
    Duration::from_secs(4),
    Duration::from_secs(8),
    Duration::from_secs(16),
];
/// A device that is lost sooner after it was opened counts as one that could not be opened.
const STABLE_AFTER: Duration = Duration::from_secs(60);
/// How often is looked whether the device is open.
const LOOK_INTERVAL: Duration = Duration::from_millis(20);
/// Figures are published this often meanwhile.
const STATS_INTERVAL: Duration = Duration::from_millis(200);

/// What viewers are told meanwhile.
const NOTE: &str = "the graphics device was lost and is being opened again; the last picture stays";

/// What a renderer is opened from.
#[derive(Clone)]
pub(super) struct LoopPlan {
    pub(super) config: RenderConfig,
    pub(super) cells: Vec<PlacedCell>,
    pub(super) document: Arc<Scene>,
    pub(super) revision: u64,
}

impl LoopPlan {
    /// Opens a device and makes all that viewers need.
    pub(super) fn open(&self) -> Result<SkyRenderer, GpuError> {
        let gpu = Gpu::open_blocking()?;
        let document = self.document.clone();
        let mut renderer = SkyRenderer::new(
            gpu,
            self.config.clone(),
            document.clone(),
            self.revision,
            &self.cells,
        )?;
        renderer.window_choice = WindowChoice::ByQuality;
        renderer.let_qualities_be_chosen()?;
        renderer.let_time_pass(document, self.revision)?;
        renderer.warm_up()?;
        match renderer.gpu.loss() {
            Some(reason) => Err(GpuError::Device(reason.to_owned())),
            None => Ok(renderer),
        }
    }
}

/// Sums that outlive a device.
struct Sums {
    counters: Counters,
    timing: TimingSums,
    sun: SunVolumeCounters,
    shafts: (u64, u64),
    evicted: u64,
    refused: u64,
}

impl Sums {
    fn of(renderer: &mut SkyRenderer) -> Self {
        Self {
            counters: std::mem::take(&mut renderer.counters),
            timing: renderer.timing.sums(),
            sun: renderer.sun.counters,
            shafts: (renderer.shafts.evaluations, renderer.shafts.tables),
            evicted: renderer.caches.evicted(),
            refused: renderer.caches.refused(),
        }
    }

    fn go_on_in(self, renderer: &mut SkyRenderer) {
        renderer.counters = self.counters;
        renderer.timing.continue_sums(self.timing);
        renderer.sun.counters = self.sun;
        (renderer.shafts.evaluations, renderer.shafts.tables) = self.shafts;
        renderer.caches.count_on_from(self.evicted, self.refused);
    }
}

/// A viewer without a device.
struct Waiting {
    view: ViewRequest,
    input: InputSequence,
    sequence: u32,
    frames_composited: u64,
}

/// What is left of a loop whose device is lost.
struct Remains {
    plan: LoopPlan,
    viewers: BTreeMap<ViewerId, Waiting>,
    sums: Sums,
    sink: Arc<dyn FrameSink>,
    stats: Arc<StatsCell>,
    started: Instant,
    loss: DeviceLossStats,
    stats_due: Instant,
}

/// Why there is no frame loop any more.
enum End {
    /// It was told to end.
    Told,
    /// No device can be opened.
    NoDevice,
}

/// Runs a loop, and those that follow it when its device is lost.
pub(super) fn run(
    mut frame_loop: FrameLoop,
    ready: ReadyGuard,
    commands: &Receiver<RenderCommand>,
) {
    let stats = Arc::clone(&frame_loop.stats);
    let mut ready = Some(ready);
    let mut tries = 0;
    loop {
        let opened = Instant::now();
        let Some(reason) = run_until_lost(&mut frame_loop, commands) else {
            return;
        };
        // Not ready: viewers who come now are better off elsewhere.
        drop(ready.take());
        if opened.elapsed() > STABLE_AFTER {
            tries = 0;
        }
        match reopen(frame_loop, reason, commands, &mut tries) {
            Ok(next) => frame_loop = next,
            Err(End::Told) => return,
            Err(End::NoDevice) => {
                tracing::error!("no graphics device can be opened any more; the renderer ends");
                return;
            }
        }
        ready = Some(stats.ready());
    }
}

/// Why the device was lost; nothing when the loop was told to end.
fn run_until_lost(
    frame_loop: &mut FrameLoop,
    commands: &Receiver<RenderCommand>,
) -> Option<String> {
    let mut wait = Duration::ZERO;
    loop {
        // wgpu panics where it is asked about a device that a driver has lost; the callback has told of the loss by then.
        let turn = catch_unwind(AssertUnwindSafe(|| frame_loop.turn(commands, wait)));
        let loss = frame_loop.renderer.gpu.loss();
        match (turn, loss) {
            (Ok(None), _) => return None,
            (_, Some(reason)) => return Some(reason.to_owned()),
            (Ok(Some(next)), None) => wait = next,
            (Err(panic), None) => resume_unwind(panic),
        }
    }
}

/// Opens another device. `tries` counts those that failed, or were lost soon.
fn reopen(
    frame_loop: FrameLoop,
    reason: String,
    commands: &Receiver<RenderCommand>,
    tries: &mut usize,
) -> Result<FrameLoop, End> {
    tracing::error!(reason, "the graphics device was lost; it is opened again");
    let mut closed_for = frame_loop.closed_for;
    let (mut remains, mut old) = Remains::of(frame_loop, reason);
    while let Some(wait) = OPENING_WAITS.get(*tries) {
        *tries += 1;
        let wait = (*wait).max(std::mem::take(&mut closed_for));
        let opening = remains.start_opening(old.take(), wait);
        while !opening.is_finished() {
            remains.hear(commands)?;
        }
        match opening.join() {
            Ok(Ok(renderer)) => {
                // What was said meanwhile is in the remains, the document too.
                tracing::warn!("the graphics device is open again");
                return Ok(remains.go_on(renderer));
            }
            Ok(Err(error)) => tracing::error!(%error, "the graphics device does not open"),
            Err(_) => tracing::error!("opening the graphics device panicked"),
        }
        remains.loss.failed_openings += 1;
    }
    Err(End::NoDevice)
}

impl Remains {
    /// Takes a loop apart; its renderer is to be dropped before another one is opened.
    fn of(mut frame_loop: FrameLoop, reason: String) -> (Self, Option<SkyRenderer>) {
        let viewers = frame_loop.renderer.viewers.iter();
        let viewers = viewers
            .map(|(id, viewer)| {
                let waiting = Waiting {
                    view: viewer.view,
                    input: viewer.input,
                    sequence: viewer.sequence,
                    frames_composited: viewer.frames_composited,
                };
                (*id, waiting)
            })
            .collect();
        let mut loss = frame_loop.device_loss;
        loss.losses += 1;
        loss.is_lost = true;
        loss.reason = Some(reason);
        let remains = Self {
            viewers,
            sums: Sums::of(&mut frame_loop.renderer),
            plan: frame_loop.plan,
            sink: frame_loop.sink,
            stats: frame_loop.stats,
            started: frame_loop.started,
            loss,
            stats_due: Instant::now(),
        };
        (remains, Some(frame_loop.renderer))
    }

    /// Opens a device on another thread, after dropping what is left of the one before.
    fn start_opening(
        &self,
        old: Option<SkyRenderer>,
        wait: Duration,
    ) -> JoinHandle<Result<SkyRenderer, GpuError>> {
        let plan = self.plan.clone();
        std::thread::spawn(move || {
            // A driver that has failed may fail here, too.
            if catch_unwind(AssertUnwindSafe(|| drop(old))).is_err() {
                tracing::warn!("what was left of the lost device could not be freed");
            }
            std::thread::sleep(wait);
            plan.open()
        })
    }

    /// Takes what is said.
    fn hear(&mut self, commands: &Receiver<RenderCommand>) -> Result<(), End> {
        let until = Instant::now() + LOOK_INTERVAL;
        loop {
            let wait = until.saturating_duration_since(Instant::now());
            match commands.recv_timeout(wait) {
                Ok(RenderCommand::Shutdown) | Err(RecvTimeoutError::Disconnected) => {
                    return Err(End::Told);
                }
                Ok(command) => self.obey(command),
                Err(RecvTimeoutError::Timeout) => break,
            }
        }
        if Instant::now() >= self.stats_due {
            self.stats_due = Instant::now() + STATS_INTERVAL;
            self.publish();
        }
        Ok(())
    }

    fn obey(&mut self, command: RenderCommand) {
        match command {
            RenderCommand::Join { viewer, view } => {
                let waiting = Waiting {
                    view,
                    input: InputSequence(0),
                    sequence: 0,
                    frames_composited: 0,
                };
                self.viewers.insert(viewer, waiting);
            }
            RenderCommand::SetCamera {
                viewer,
                input,
                camera,
                ..
            } => {
                if let Some(waiting) = self.viewers.get_mut(&viewer) {
                    waiting.view.camera = camera;
                    waiting.input = input;
                }
            }
            RenderCommand::SetView { viewer, view } => {
                if let Some(waiting) = self.viewers.get_mut(&viewer) {
                    waiting.view = view;
                }
            }
            RenderCommand::Leave { viewer } => {
                self.viewers.remove(&viewer);
            }
            RenderCommand::SetScene { scene, revision } => {
                (self.plan.document, self.plan.revision) = (scene, revision);
            }
            // Frames under way are gone; a device that is not there cannot be lost; the end was heard before.
            RenderCommand::Acknowledge { .. }
            | RenderCommand::Refine { .. }
            | RenderCommand::LoseDevice { .. }
            | RenderCommand::Shutdown => {}
        }
    }

    /// Tells that the device is lost.
    fn publish(&self) {
        let last = RenderStats::clone(&self.stats.latest());
        let viewers = self.viewers.iter().map(|(id, waiting)| {
            let known = last.viewers.iter().find(|viewer| viewer.id == *id);
            ViewerRenderStats {
                id: *id,
                renderer: waiting.view.renderer,
                frames_composited: waiting.frames_composited,
                frames_in_flight: 0,
                renderer_note: Some(NOTE),
                ..known.cloned().unwrap_or_default()
            }
        });
        let viewers = viewers.collect();
        self.stats.publish(RenderStats {
            viewers,
            device_loss: self.loss.clone(),
            uptime_s: self.started.elapsed().as_secs_f64(),
            ..last
        });
    }

    /// The loop goes on with another device: all who wait join it.
    fn go_on(mut self, mut renderer: SkyRenderer) -> FrameLoop {
        self.loss.is_lost = false;
        self.sums.go_on_in(&mut renderer);
        let is_of_before = renderer.scene_revision != self.plan.revision;
        let (document, revision) = (self.plan.document.clone(), self.plan.revision);
        let mut frame_loop = FrameLoop::of(renderer, self.plan, self.sink, self.stats);
        frame_loop.started = self.started;
        frame_loop.device_loss = self.loss;
        if is_of_before {
            frame_loop.renderer.await_scene(document, revision);
        }
        for (id, waiting) in self.viewers {
            frame_loop.join(id, waiting.view);
            if let Some(viewer) = frame_loop.renderer.viewers.get_mut(&id) {
                viewer.input = waiting.input;
                viewer.frames_composited = waiting.frames_composited;
                viewer.sequence = waiting.sequence;
                // What was under way is lost and will not be acknowledged.
                viewer.acknowledged = waiting.sequence;
            }
        }
        frame_loop
    }
}
