//! What passes between the service edge (sockets, HTTP, encoders) and the thread that owns the
//! GPU. Plain values in both directions: commands go in through a bounded channel, frames come
//! out through a [`FrameSink`], figures are read from a [`StatsCell`].
//!
//! Who owns what: the frame loop owns pacing (a viewer's fps) and the acknowledgement window (at
//! most [`FRAMES_IN_FLIGHT_MAX`] frames of a viewer composited and not acknowledged). The edge owns
//! encoding, the latest-wins slot and the socket.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, SyncSender, TrySendError};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, Instant};

use crate::audit::AuditStats;
use crate::composite::PictureFormat;
use crate::gpu::DeviceInventory;
use crate::quality::QualitySettings;
use schemars::JsonSchema;
use serde::Serialize;
use skycell_protocol::clouds::CloudsHeader;
use skycell_protocol::{
    Camera, CellId, Codec, FrameSequence, FrameSize, FrameStages, InputSequence, QualityChoice,
    RendererKind, Scene, Show, Stereo, ViewerId,
};
use thiserror::Error;
use tokio::sync::watch;

/// How many frames of a viewer may be composited and not yet acknowledged. An acknowledgement is
/// cumulative, so a frame that was overwritten in the slot and never sent is covered by that of a
/// later one.
pub const FRAMES_IN_FLIGHT_MAX: u32 = 2;

/// How many commands may wait for the frame loop. The edge sends at most about 250 a second for a
/// viewer, so a loop this far behind is stuck.
pub const RENDER_COMMANDS_MAX: usize = 16_384;

/// What a viewer wants to be rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewRequest {
    /// Width and height of frames, or of each eye's part of them.
    pub size: FrameSize,
    /// The most frames a second that the viewer wants, 1 to 120.
    pub fps: f64,
    /// How frames are compressed.
    pub codec: Codec,
    /// Quality of JPEG frames, 1 to 100.
    pub jpeg_quality: u8,
    /// Where the viewer stands and looks.
    pub camera: Camera,
    /// Which renderer makes the frames.
    pub renderer: RendererKind,
    /// How good pictures are to be; none for what the scene or the server says.
    pub quality: Option<QualityChoice>,
    /// What frames show.
    pub show: Show,
    /// Two eyes around the camera instead of one at its place.
    pub stereo: Option<Stereo>,
    /// Colour of clouds alone includes the haze in front of them.
    pub haze: bool,
    /// Frames hold linear radiance, whatever the codec says: for snapshots. They show one cell and one renderer at a time.
    pub linear: bool,
}

impl ViewRequest {
    /// Cameras of its eyes: its own, or the left and the right one.
    #[must_use]
    pub fn eyes(&self) -> Vec<Camera> {
        self.eyes_about(&self.camera)
    }

    /// Cameras of its eyes if it were elsewhere.
    #[must_use]
    pub fn eyes_about(&self, camera: &Camera) -> Vec<Camera> {
        match self.stereo {
            None => vec![*camera],
            Some(stereo) => stereo.eyes(camera).to_vec(),
        }
    }

    /// What a pixel of its frames is.
    #[must_use]
    pub fn picture_format(&self) -> PictureFormat {
        if self.linear {
            PictureFormat::Linear
        } else {
            PictureFormat::of(self.codec)
        }
    }

    /// Size of its frames: two eyes are side by side.
    #[must_use]
    pub fn picture_size(&self) -> FrameSize {
        match self.stereo {
            None => self.size,
            Some(_) => self.size.pair(),
        }
    }
}

/// A message to the frame loop.
#[derive(Clone, Debug)]
pub enum RenderCommand {
    /// A viewer has connected and wants frames.
    Join {
        /// Who.
        viewer: ViewerId,
        /// What it wants. Its camera counts as input 0.
        view: ViewRequest,
    },
    /// A viewer has moved or turned.
    SetCamera {
        /// Who.
        viewer: ViewerId,
        /// The client's number of the input; frames that show it carry it.
        input: InputSequence,
        /// Where it stands and looks now.
        camera: Camera,
        /// When the input came.
        arrived: Instant,
    },
    /// A viewer has changed its wishes. The camera in `view` is the last one that was sent.
    SetView {
        /// Who.
        viewer: ViewerId,
        /// All that it wants now.
        view: ViewRequest,
    },
    /// A viewer has received a frame and with it every earlier one.
    Acknowledge {
        /// Who.
        viewer: ViewerId,
        /// The frame.
        sequence: FrameSequence,
        /// How many frames may be under way from now on; no more than [`FRAMES_IN_FLIGHT_MAX`] count.
        frames_in_flight_max: u32,
    },
    /// A viewer's link has been quiet since a frame that was less good than the viewer wishes. It gets the picture again,
    /// unless something else is to be seen by then.
    Refine {
        /// Who.
        viewer: ViewerId,
    },
    /// A viewer is gone. No frame needs to be delivered for it any more.
    Leave {
        /// Who.
        viewer: ViewerId,
    },
    /// The scene has changed.
    SetScene {
        /// The scene.
        scene: Arc<Scene>,
        /// Its revision.
        revision: u64,
    },
    /// Lose the device, as a driver that fails does; for tests.
    #[doc(hidden)]
    LoseDevice {
        /// How long no other one opens.
        closed_for: Duration,
    },
    /// End the frame loop; nothing follows.
    Shutdown,
}

/// Pixels of a finished frame, usually mapped GPU memory. Dropping them gives the buffer back to
/// the ring that it came from.
pub trait FramePixels: Send {
    /// Red, green, blue, alpha; 8 bits each, sRGB; rows from top to bottom without padding. Of clouds alone what
    /// [`skycell_protocol::clouds::append`] takes; of linear radiance red, green, blue and 1 as f32 each.
    fn rgba(&self) -> &[u8];
}

/// What a frame is to those who saw the one before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refinement {
    /// It shows something new.
    #[default]
    None,
    /// It shows the same, so that a video can come closer to it.
    Finer,
    /// It shows the same for the last time: the view rests.
    Last,
}

/// A frame that has been read back and waits to be encoded.
pub struct FinishedFrame {
    /// Whose frame it is.
    pub viewer: ViewerId,
    /// Its number in the viewer's stream, from 1 upwards.
    pub sequence: FrameSequence,
    /// The last camera input that it shows.
    pub input: InputSequence,
    /// Revision of the scene that it shows.
    pub scene_revision: u64,
    /// The view cell that it was composited from.
    pub cell: CellId,
    /// Its size, of both eyes together where there are two.
    pub size: FrameSize,
    /// It holds the pictures of two eyes side by side.
    pub stereo: bool,
    /// How it is to be compressed.
    pub codec: Codec,
    /// Quality, if it is to be a JPEG, 1 to 100.
    pub jpeg_quality: u8,
    /// What clouds alone say of themselves.
    pub clouds: Option<CloudsHeader>,
    /// Its pixels are linear radiance: it becomes an EXR file.
    pub linear: bool,
    /// Some visible part of the sky is not yet at the resolution that was asked for.
    pub coarse: bool,
    /// Nothing finer comes while the view rests.
    pub exact: bool,
    /// It shows what the one before showed, which was less good than the viewer wishes.
    pub refines: bool,
    /// Whether it shows the same as the one before.
    pub refinement: Refinement,
    /// How long it took until `read_back`; what comes later is still 0.
    pub stages: FrameStages,
    /// Wall clock when the composite was submitted to the GPU ([`crate::clock::unix_now_us`]).
    pub submitted_unix_us: u64,
    /// When its pixels had arrived.
    pub read_back: Instant,
    /// `size.pixels() * 4` bytes, three times as many of clouds alone, four times of linear radiance.
    pub pixels: Box<dyn FramePixels>,
}

/// Where finished frames go.
pub trait FrameSink: Send + Sync {
    /// Takes a frame. Never blocks: when the viewer's previous frame still waits, the newer one
    /// replaces it, and the drop is counted. A frame of a viewer that is gone is dropped.
    fn deliver(&self, frame: FinishedFrame);
}

/// Why a command was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum FrameLoopGone {
    /// The loop's thread has ended.
    #[error("the renderer has ended")]
    Ended,
    /// [`RENDER_COMMANDS_MAX`] commands wait already; it may be worth trying again.
    #[error("the renderer does not keep up: {RENDER_COMMANDS_MAX} commands wait")]
    Behind,
}

/// The channel of commands. The loop keeps the receiver, the handle the sender.
pub fn render_command_channel() -> (SyncSender<RenderCommand>, Receiver<RenderCommand>) {
    mpsc::sync_channel(RENDER_COMMANDS_MAX)
}

/// What the edge holds of the frame loop.
#[derive(Clone)]
pub struct FrameLoopHandle {
    sender: SyncSender<RenderCommand>,
    stats: Arc<StatsCell>,
}

impl FrameLoopHandle {
    /// A handle from its parts: the sender of [`render_command_channel`] and the cell that the
    /// loop publishes to. The adapter should stand there before the service starts: viewers are
    /// told its name when they connect.
    pub fn new(sender: SyncSender<RenderCommand>, stats: Arc<StatsCell>) -> Self {
        Self { sender, stats }
    }

    /// Sends a command. Never blocks.
    ///
    /// # Errors
    /// If the loop has ended or is too far behind; the command is then lost.
    pub fn send(&self, command: RenderCommand) -> Result<(), FrameLoopGone> {
        self.sender.try_send(command).map_err(|error| match error {
            TrySendError::Full(_) => FrameLoopGone::Behind,
            TrySendError::Disconnected(_) => FrameLoopGone::Ended,
        })
    }

    /// The figures that the loop published last.
    pub fn stats(&self) -> Arc<RenderStats> {
        self.stats.latest()
    }

    /// Whether the loop has warmed up and runs.
    pub fn is_ready(&self) -> bool {
        self.stats.is_ready()
    }

    /// Whether there is a device; changes are told at once. Before it tells of one, [`Self::stats`] says so, too.
    pub fn device_state(&self) -> watch::Receiver<DeviceState> {
        self.stats.device_state.subscribe()
    }
}

/// Where the frame loop leaves its figures for everyone to read.
#[derive(Default)]
pub struct StatsCell {
    latest: RwLock<Arc<RenderStats>>,
    device_state: watch::Sender<DeviceState>,
    ready: AtomicBool,
}

/// Whether there is a device to render with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceState {
    /// How often it was lost since the start.
    pub losses: u64,
    /// It is lost now.
    pub is_lost: bool,
}

impl StatsCell {
    /// An empty cell of a loop that is not ready.
    pub fn new() -> Arc<Self> {
        Arc::default()
    }

    /// Replaces the figures.
    pub fn publish(&self, stats: RenderStats) {
        let device_state = stats.device_loss.state();
        // A poisoned lock holds whole figures all the same: replacing an Arc cannot be cut short.
        *self.latest.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(stats);
        self.device_state.send_if_modified(|state| {
            let is_new = *state != device_state;
            *state = device_state;
            is_new
        });
    }

    /// The figures that were published last.
    pub fn latest(&self) -> Arc<RenderStats> {
        let latest = self.latest.read().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(&latest)
    }

    /// Says that the loop is ready, until the guard is dropped: also when its thread panics.
    #[must_use = "the loop is ready only as long as the guard lives"]
    pub fn ready(self: &Arc<Self>) -> ReadyGuard {
        self.ready.store(true, Ordering::Release);
        ReadyGuard(Arc::clone(self))
    }

    /// Whether the loop is ready.
    pub fn is_ready(&self) -> bool {
        self.ready.load(Ordering::Acquire)
    }
}

/// As long as it lives, the frame loop is ready.
pub struct ReadyGuard(Arc<StatsCell>);

impl Drop for ReadyGuard {
    fn drop(&mut self) {
        self.0.ready.store(false, Ordering::Release);
    }
}

/// The frame loop's figures, published about once a tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct RenderStats {
    /// What renders.
    pub adapter: AdapterStats,
    /// Number of the tick after which these figures were taken.
    pub tick: u64,
    /// Revision of the scene that the loop renders.
    pub scene_revision: u64,
    /// Since the loop has been ready.
    pub uptime_s: f64,
    /// The sky's clock when these figures were taken.
    pub sky_time: SkyTimeStats,
    /// Sums since the start.
    pub totals: RenderTotals,
    /// Buffers, textures, pipelines and passes of the device.
    pub device: DeviceInventory,
    /// How far cached texels are from texels marched anew at high quality.
    pub audit: AuditStats,
    /// What is picked for viewers who ask for no quality.
    pub quality: QualityStats,
    /// Viewers on their way from one view cell to another.
    pub transitions: TransitionStats,
    /// What is given up because memory or time do not suffice.
    pub losses: LossStats,
    /// How often the device was lost.
    pub device_loss: DeviceLossStats,
    /// The view cells that exist.
    pub cells: Vec<CellStats>,
    /// The viewers that the loop knows.
    pub viewers: Vec<ViewerRenderStats>,
}

/// Losses of the device. Viewers stay; they see their last picture until another device is open.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct DeviceLossStats {
    /// How often it was lost since the start.
    pub losses: u64,
    /// How often it could not be opened again at once.
    pub failed_openings: u64,
    /// It is lost now.
    pub is_lost: bool,
    /// Why it was lost last.
    pub reason: Option<String>,
}

impl DeviceLossStats {
    fn state(&self) -> DeviceState {
        DeviceState {
            losses: self.losses,
            is_lost: self.is_lost,
        }
    }
}

/// The sky's clock, and what it costs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct SkyTimeStats {
    /// Sky time.
    pub sky_s: f64,
    /// Date and time at the sun's place, UTC; null where the sun stands by hand.
    pub date: Option<String>,
    /// Seconds of sky time in a second while it runs.
    pub rate: f64,
    /// Whether sky time goes on.
    pub running: bool,
    /// Whether something but clouds in the wind moves.
    pub moves: bool,
    /// How often the scene of the moment was worked out since the start.
    pub evaluations: u64,
    /// How often it was different enough to be taken over.
    pub taken: u64,
}

/// The graphics adapter.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct AdapterStats {
    /// What it calls itself.
    pub name: String,
    /// Its driver and the driver's version.
    pub driver: String,
    /// Vulkan, Metal or DX12.
    pub backend: String,
    /// Discrete, integrated or virtual GPU, or CPU.
    pub device_type: String,
}

/// Sums since the frame loop's start; `cache_bytes`, `sun_volume_bytes` and `light_shaft_bytes` are what is allocated now.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct RenderTotals {
    /// Turns of the loop.
    pub ticks: u64,
    /// Command buffers submitted to the GPU's queue.
    pub submissions: u64,
    /// Compute dispatches and draws.
    pub dispatches: u64,
    /// Cache texels marched.
    pub texels_updated: u64,
    /// Cache tiles marched.
    pub tiles_updated: u64,
    /// Cache tiles filled from others when a cell got new anchors.
    pub tiles_resampled: u64,
    /// Cache tiles given up.
    pub tiles_evicted: u64,
    /// Cache texels marched again to see how wrong the cache is.
    pub texels_audited: u64,
    /// Frames composited.
    pub frames_composited: u64,
    /// First frames of viewers that waited for the coarse level, half a second at most.
    pub first_frames_held: u64,
    /// Further frames that waited for any tile.
    pub frames_held: u64,
    /// Frames read back.
    pub frames_read_back: u64,
    /// GPU time of cache updates.
    pub gpu_cache_ns: u64,
    /// GPU time of the passes that fill tiles from others.
    pub gpu_resample_ns: u64,
    /// GPU time of mixes of two view cells' pictures.
    pub gpu_fade_ns: u64,
    /// GPU time of audits.
    pub gpu_audit_ns: u64,
    /// GPU time of composites.
    pub gpu_composite_ns: u64,
    /// GPU time of the screen-space renderer.
    pub gpu_screen_space_ns: u64,
    /// Rays marched by the screen-space renderer.
    pub screen_space_marches: u64,
    /// GPU memory of caches, now.
    pub cache_bytes: u64,
    /// Look-ups of density for columns of sun volumes.
    pub sun_volume_evaluations: u64,
    /// Columns of sun volumes made.
    pub sun_volume_columns: u64,
    /// GPU memory of sun volumes, now.
    pub sun_volume_bytes: u64,
    /// GPU time of sun volumes.
    pub gpu_sun_volume_ns: u64,
    /// Look-ups of density and steps through the air for light shafts.
    pub light_shaft_evaluations: u64,
    /// Tables of light shafts made.
    pub light_shaft_tables: u64,
    /// GPU memory of light shafts, now.
    pub light_shaft_bytes: u64,
    /// GPU time of light shafts.
    pub gpu_light_shaft_ns: u64,
}

/// Viewers on their way from one view cell to another, or from a cell's old anchors to its new ones, and what that takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct TransitionStats {
    /// Viewers on their way now.
    pub viewers: u64,
    /// Those of them whose frames are a mix of both cells' pictures; the others are shown the old one.
    pub fading: u64,
    /// Those of them whose frames are made by rays of their own.
    pub own_rays: u64,
    /// Cells without members whose caches are kept for them.
    pub cells_kept: u64,
    /// GPU memory of their second pictures.
    pub picture_bytes: u64,
    /// GPU memory of the last frames of their rays.
    pub ring_bytes: u64,
    /// Changes of cells that were shown by such a way, since the start.
    pub begun: u64,
    /// Changes of cells that were shown at once, because there was no room for both cells or the new one was not there in
    /// time, since the start.
    pub swapped: u64,
}

/// What is given up because memory or the time for marching do not suffice. All is 0, and factors 1, where nothing is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct LossStats {
    /// Tiles that all caches may hold.
    pub tiles_max: u64,
    /// Tiles that the caches of a cell may hold.
    pub cell_tiles_max: u64,
    /// Tiles that all cells would hold if nothing were given up; an upper bound while that is less than half of what fits.
    pub tiles_wished: u64,
    /// Tiles that they are to hold.
    pub tiles_granted: u64,
    /// How often a tile found no room because not even the coarse levels fit, since the start.
    pub tiles_refused: u64,
    /// Halvings of resolution, of the cell that has lost most.
    pub levels_lost_most: u8,
    /// How often losses for want of memory have changed, since the start.
    pub memory_changes: u64,
    /// How much is given up for want of time: 0 nothing, 1 turns, 2 and 3 samples, from 4 on resolution.
    pub rate_step: u32,
    /// Texels that age wait so many times as long for their turn.
    pub age_factor: f64,
    /// By this, samples of a texel are divided.
    pub samples_divisor: u32,
    /// Halvings of resolution of all cells.
    pub levels_lost_to_time: u8,
    /// How often that has changed, since the start.
    pub rate_changes: u64,
    /// How long the marches that wait take, at their share of the time.
    pub backlog_s: f64,
}

/// A view cell.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct CellStats {
    /// Its number.
    pub id: CellId,
    /// What people call it.
    pub name: String,
    /// Where its rays start: x, altitude, z.
    pub reference_m: [f64; 3],
    /// How far from there its viewers may be, sideways.
    pub radius_m: f64,
    /// Placed by the operator; others form by themselves.
    pub placed: bool,
    /// How far its anchor has drifted with the wind: x, altitude, z.
    pub anchor_drift_m: [f64; 3],
    /// Who belongs to it.
    pub viewers: Vec<ViewerId>,
    /// Texels that its viewers request, summed over the viewers.
    pub texels_requested: u64,
    /// The same, each texel counted once.
    pub texels_unique: u64,
    /// Share of requested texels that another viewer requests too, 0 to 1.
    pub overlap: f64,
    /// Texels of the coarse level that no viewer requests and that are kept so that there are no holes.
    pub texels_coarse: u64,
    /// Texels that wait for an update.
    pub texels_pending: u64,
    /// Tiles that are allocated.
    pub tiles_resident: u64,
    /// Tiles that it would hold if nothing were given up; an upper bound where that is far from any limit.
    pub tiles_wished: u64,
    /// Halvings of resolution that it has lost because memory or time do not suffice.
    pub levels_lost: u8,
    /// Why; null where nothing is lost.
    pub loss_note: Option<String>,
    /// GPU memory of its caches.
    pub bytes: u64,
    /// Nothing waits for an update.
    pub converged: bool,
    /// Steps through a layer's thickness of its rays.
    pub march_steps: u32,
    /// Jittered samples that its texels average.
    pub samples: u32,
    /// Exposure by the light of the sky, stops; 0 where the scene has none.
    pub auto_exposure_ev: f64,
}

/// A viewer as the frame loop sees it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct ViewerRenderStats {
    /// Its number.
    pub id: ViewerId,
    /// The view cell that it belongs to.
    pub cell: CellId,
    /// The one that it leaves, while it is on its way from there: the same one where that has got new anchors.
    pub leaves: Option<CellId>,
    /// Where it is: x, altitude, z.
    pub position_m: [f64; 3],
    /// Where it looks, clockwise from north.
    pub yaw_deg: f64,
    /// Texels that it requests.
    pub texels_requested: u64,
    /// Frames composited for it.
    pub frames_composited: u64,
    /// Frames composited and not acknowledged.
    pub frames_in_flight: u32,
    /// Which renderer makes its frames.
    pub renderer: RendererKind,
    /// Why it is not the one that was asked for.
    pub renderer_note: Option<&'static str>,
    /// What its frames are to show.
    pub show: Show,
    /// Why they do not show it.
    pub show_note: Option<&'static str>,
    /// What is asked for, picked and achieved.
    pub quality: QualityStats,
}

/// Who asked for a quality.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AskedBy {
    /// The viewer itself.
    Viewer,
    /// The scene document.
    Scene,
    /// The server's configuration, or its default for the adapter.
    #[default]
    Server,
}

/// A quality: what is asked for, what is picked, what it achieves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct QualityStats {
    /// What is asked for.
    pub asked: Option<QualityChoice>,
    /// By whom.
    pub asked_by: AskedBy,
    /// The preset of the picked point, or `custom`.
    pub picked: &'static str,
    /// What it sets, after what the configuration fixes. The march's are those of the cell, when others there ask for finer.
    pub settings: QualitySettings,
    /// Mean FLIP of the picked point against the converged picture.
    pub flip: f64,
    /// That FLIP was measured with these settings; otherwise it is an estimate.
    pub measured: bool,
    /// Something is picked that is as good, or as fast, as was asked for.
    pub is_met: bool,
    /// Device time of a frame: its composite, and the march of its view spread over eight seconds of frames; null while
    /// nothing was measured.
    pub device_ms_per_frame: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_to_an_ended_loop_is_refused_and_a_full_channel_does_not_block() {
        let (sender, receiver) = render_command_channel();
        let handle = FrameLoopHandle::new(sender, StatsCell::new());
        for _ in 0..RENDER_COMMANDS_MAX {
            assert_eq!(handle.send(RenderCommand::Shutdown), Ok(()));
        }
        assert_eq!(
            handle.send(RenderCommand::Shutdown),
            Err(FrameLoopGone::Behind)
        );
        drop(receiver);
        assert_eq!(
            handle.send(RenderCommand::Shutdown),
            Err(FrameLoopGone::Ended)
        );
    }

    #[test]
    fn a_loop_that_panics_is_not_ready_any_more() {
        let stats = StatsCell::new();
        let guard = stats.ready();
        assert!(stats.is_ready());
        let thread = std::thread::spawn(move || {
            let _guard = guard;
            panic!("on purpose");
        });
        assert!(thread.join().is_err());
        assert!(!stats.is_ready());
    }
}
