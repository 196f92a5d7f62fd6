//! A frame loop without a GPU: keeps the acknowledgement window and the pace as the real one does,
//! and delivers small generated frames.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use skycell_protocol::{CellId, FrameSequence, FrameStages, InputSequence, ViewerId};
use skycell_server::clock::unix_now_us;
use skycell_server::frame_loop::interface::{
    AdapterStats, CellStats, FRAMES_IN_FLIGHT_MAX, FinishedFrame, FrameLoopHandle, FramePixels,
    FrameSink, Refinement, RenderCommand, RenderStats, RenderTotals, StatsCell, ViewRequest,
    ViewerRenderStats, render_command_channel,
};
use skycell_server::scene::SceneSnapshot;

/// How the stand-in behaves.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Behaviour {
    /// Delivers frames to viewers that acknowledge nothing.
    pub(crate) ignores_window: bool,
    /// Delivers frames with too few pixels.
    pub(crate) breaks_frames: bool,
    /// Never becomes ready.
    pub(crate) never_ready: bool,
    /// Delivers one frame for each change and then none.
    pub(crate) rests: bool,
}

/// What the stand-in was told and has done.
#[derive(Default)]
pub(crate) struct Witness {
    pub(crate) cameras_heard: AtomicU64,
    pub(crate) left: Mutex<Vec<ViewerId>>,
    pub(crate) pixels_alive: Arc<AtomicUsize>,
    pub(crate) pixels_alive_most: AtomicUsize,
}

pub(crate) struct StandIn {
    pub(crate) handle: FrameLoopHandle,
    pub(crate) witness: Arc<Witness>,
    thread: Option<JoinHandle<()>>,
}

impl StandIn {
    pub(crate) fn start(
        scene: SceneSnapshot,
        sink: Arc<dyn FrameSink>,
        behaviour: Behaviour,
    ) -> Self {
        let (sender, commands) = render_command_channel();
        let stats = StatsCell::new();
        let witness = Arc::new(Witness::default());
        let mut state = State {
            sink,
            behaviour,
            witness: Arc::clone(&witness),
            revision: scene.revision,
            viewers: BTreeMap::new(),
            totals: RenderTotals::default(),
        };
        // As the real one, which knows its adapter before it starts its thread.
        stats.publish(state.stats());
        let handle = FrameLoopHandle::new(sender, Arc::clone(&stats));
        let thread = std::thread::spawn(move || {
            let _ready = (!behaviour.never_ready).then(|| stats.ready());
            state.run(&commands, &stats);
        });
        Self {
            handle,
            witness,
            thread: Some(thread),
        }
    }
}

impl Drop for StandIn {
    fn drop(&mut self) {
        let _ = self.handle.send(RenderCommand::Shutdown);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct ViewerState {
    view: ViewRequest,
    input: InputSequence,
    composited: u32,
    acknowledged: u32,
    next_at: Instant,
    is_changed: bool,
}

struct State {
    sink: Arc<dyn FrameSink>,
    behaviour: Behaviour,
    witness: Arc<Witness>,
    revision: u64,
    viewers: BTreeMap<ViewerId, ViewerState>,
    totals: RenderTotals,
}

impl State {
    fn run(&mut self, commands: &Receiver<RenderCommand>, stats: &StatsCell) {
        loop {
            match commands.recv_timeout(Duration::from_millis(2)) {
                Ok(RenderCommand::Shutdown) | Err(RecvTimeoutError::Disconnected) => return,
                Ok(command) => self.obey(command),
                Err(RecvTimeoutError::Timeout) => {}
            }
            while let Ok(command) = commands.try_recv() {
                if matches!(command, RenderCommand::Shutdown) {
                    return;
                }
                self.obey(command);
            }
            self.deliver_due();
            self.totals.ticks += 1;
            stats.publish(self.stats());
        }
    }

    fn obey(&mut self, command: RenderCommand) {
        match command {
            RenderCommand::Join { viewer, view } => {
                let state = ViewerState {
                    view,
                    input: InputSequence(0),
                    composited: 0,
                    acknowledged: 0,
                    next_at: Instant::now(),
                    is_changed: true,
                };
                assert!(self.viewers.insert(viewer, state).is_none());
            }
            RenderCommand::SetCamera {
                viewer,
                input,
                camera,
                ..
            } => {
                self.witness.cameras_heard.fetch_add(1, Ordering::SeqCst);
                let state = self.known(viewer);
                state.view.camera = camera;
                state.input = input;
                state.is_changed = true;
            }
            RenderCommand::SetView { viewer, view } => {
                let state = self.known(viewer);
                state.view = view;
                state.is_changed = true;
            }
            RenderCommand::Acknowledge {
                viewer, sequence, ..
            } => {
                let state = self.known(viewer);
                assert!(sequence.0 <= state.composited);
                state.acknowledged = state.acknowledged.max(sequence.0);
            }
            RenderCommand::Refine { viewer } => self.known(viewer).is_changed = true,
            RenderCommand::Leave { viewer } => {
                assert!(self.viewers.remove(&viewer).is_some());
                self.witness.left.lock().expect("not poisoned").push(viewer);
            }
            RenderCommand::SetScene { revision, .. } => {
                assert!(revision > self.revision);
                self.revision = revision;
                for state in self.viewers.values_mut() {
                    state.is_changed = true;
                }
            }
            RenderCommand::LoseDevice { .. } | RenderCommand::Shutdown => {}
        }
    }

    fn known(&mut self, viewer: ViewerId) -> &mut ViewerState {
        self.viewers.get_mut(&viewer).expect("a viewer that joined")
    }

    fn deliver_due(&mut self) {
        let now = Instant::now();
        for (id, state) in &mut self.viewers {
            let in_flight = state.composited - state.acknowledged;
            let has_room = self.behaviour.ignores_window || in_flight < FRAMES_IN_FLIGHT_MAX;
            let has_news = state.is_changed || !self.behaviour.rests;
            if !has_room || !has_news || now < state.next_at {
                continue;
            }
            state.is_changed = false;
            state.next_at = now + Duration::from_secs_f64(1.0 / state.view.fps);
            state.composited += 1;
            self.totals.frames_composited += 1;
            let alive = self.witness.pixels_alive.fetch_add(1, Ordering::SeqCst) + 1;
            self.witness
                .pixels_alive_most
                .fetch_max(alive, Ordering::SeqCst);
            let mut rgba = noise(
                state.view.picture_size().pixels() as usize * bytes_of_pixel(&state.view),
                state.composited,
            );
            // Whose frame it is, for those who look.
            rgba[..4].copy_from_slice(&id.0.to_le_bytes());
            rgba[3] = u8::MAX;
            if state.view.codec.is_stream() {
                // A video of nothing but noise has no encoder.
                rgba.iter_mut().for_each(|value| *value = *value / 4 + 90);
            }
            if self.behaviour.breaks_frames {
                rgba.pop();
            }
            self.sink.deliver(FinishedFrame {
                viewer: *id,
                sequence: FrameSequence(state.composited),
                input: state.input,
                scene_revision: self.revision,
                cell: CellId(0),
                size: state.view.picture_size(),
                stereo: state.view.stereo.is_some(),
                codec: state.view.codec,
                jpeg_quality: state.view.jpeg_quality,
                clouds: None,
                linear: state.view.linear,
                coarse: state.composited == 1,
                exact: state.composited > 1,
                refines: false,
                refinement: Refinement::None,
                stages: FrameStages::default(),
                submitted_unix_us: unix_now_us(),
                read_back: now,
                pixels: Box::new(Pixels {
                    rgba,
                    alive: Arc::clone(&self.witness.pixels_alive),
                }),
            });
        }
    }

    fn stats(&self) -> RenderStats {
        let ids: Vec<ViewerId> = self.viewers.keys().copied().collect();
        RenderStats {
            adapter: AdapterStats {
                name: "stand-in".to_owned(),
                ..AdapterStats::default()
            },
            tick: self.totals.ticks,
            scene_revision: self.revision,
            totals: self.totals.clone(),
            cells: vec![CellStats {
                name: "everywhere".to_owned(),
                overlap: if ids.len() > 1 { 1.0 } else { 0.0 },
                viewers: ids,
                converged: true,
                ..CellStats::default()
            }],
            viewers: self
                .viewers
                .iter()
                .map(|(id, state)| ViewerRenderStats {
                    id: *id,
                    texels_requested: 1234,
                    frames_composited: u64::from(state.composited),
                    frames_in_flight: state.composited - state.acknowledged,
                    renderer: state.view.renderer,
                    ..ViewerRenderStats::default()
                })
                .collect(),
            ..RenderStats::default()
        }
    }
}

/// Bytes of a pixel; of linear radiance any bits are numbers, if odd ones.
fn bytes_of_pixel(view: &ViewRequest) -> usize {
    if view.linear { 16 } else { 4 }
}

/// Whose frame a picture is, by its first pixel: the lower 24 bits of the viewer's number.
pub(crate) fn viewer_of_picture(picture: &image::RgbImage) -> u32 {
    let [low, middle, high] = picture.get_pixel(0, 0).0;
    u32::from_le_bytes([low, middle, high, 0])
}

/// Pixels that no codec makes small, another for every seed.
fn noise(length: usize, seed: u32) -> Vec<u8> {
    let mut state = u64::from(seed) | 1 << 40;
    (0..length)
        .map(|_| {
            // xorshift64: Marsaglia 2003.
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 32) as u8
        })
        .collect()
}

struct Pixels {
    rgba: Vec<u8>,
    alive: Arc<AtomicUsize>,
}

impl FramePixels for Pixels {
    fn rgba(&self) -> &[u8] {
        &self.rgba
    }
}

impl Drop for Pixels {
    fn drop(&mut self) {
        self.alive.fetch_sub(1, Ordering::SeqCst);
    }
}
