//! When things happen: whose frame is due, how much is marched between frames, when to rest.

use super::device_loss::{self, LoopPlan};
use super::interface::{
    DeviceLossStats, FrameLoopHandle, FrameSink, Refinement, RenderCommand, RenderStats, StatsCell,
    ViewRequest, render_command_channel,
};
use super::refining::Refining;
use super::renderer::SkyRenderer;
use super::screen_space::ScreenSpaceJob;
use super::viewers_on_device::ActiveViewer;
use crate::clock;
use crate::config::{PlacedCell, RenderConfig};
use crate::gpu::{BlendStep, GpuError, TimedPass};
use skycell_protocol::{RendererKind, Scene, Show, ViewerId};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often the loop looks whether the device has finished something. Short against a frame, long against a poll.
const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// How long the loop sleeps when there is nothing to do; commands wake it.
const IDLE_INTERVAL: Duration = Duration::from_secs(1);
/// Time for marching that may be saved up, s: a burst no longer than a frame.
const MARCH_CREDIT_MAX_S: f64 = 0.03;
/// Device time of one batch while nobody waits for a frame, and the longest that one may delay a frame that becomes due.
const RESTING_BATCH: Duration = Duration::from_millis(60);
/// A resting view that only gets sharper is sent this often at most.
const REFINE_INTERVAL: Duration = Duration::from_millis(200);
/// Share of the device's time for views that only get sharper: with many viewers they are sent less often, or the frames
/// that show the marching would take the time from it.
const REFINE_SHARE: f64 = 0.2;
/// A viewer that has moved within this time is moving.
const MOVING_FOR: Duration = Duration::from_millis(500);
/// The sky must have moved this share of a pixel before a resting view is composited again.
const MOTION_PIXELS: f64 = 0.25;
/// Maps that are on their way to others take a step this often at most: steps of a slow change are not seen.
const BLEND_INTERVAL: Duration = Duration::from_millis(250);
/// They take one after this long though some tile still shows the step before: time goes on for those who look.
const BLEND_WAIT_MAX: Duration = Duration::from_secs(2);
/// Figures are published this often.
const STATS_INTERVAL: Duration = Duration::from_millis(100);
/// A resting view of the age of texels is made anew this often.
const AGES_INTERVAL: Duration = Duration::from_secs(1);
/// Time of a tile's march before any was measured.
const FIRST_TILE_NS: f64 = 10.0e6;
/// Device submissions that may be under way before more is marched.
const SUBMISSIONS_MAX: u32 = 2;

/// Texels of an audit while frames are wanted, and how often. 64 texels are 0.5 of a tile's samples, four times as fine.
const HURRIED_AUDIT: (usize, Duration) = (64, Duration::from_secs(1));
/// The same when all is marched and nothing moves, so that the sky comes to rest in a second.
const RESTING_AUDIT: (usize, Duration) = (256, Duration::from_millis(50));

/// Why a viewer's picture is out of date.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Change {
    /// It is up to date.
    None,
    /// The same view became sharper.
    Sharper,
    /// Something else is seen.
    Seen,
}

/// A viewer's timing.
#[derive(Debug)]
struct Pace {
    due: Instant,
    moved: Instant,
    composited: Option<Instant>,
    change: Change,
    /// How far a video has come to the picture that it shows.
    refining: Refining,
}

/// The render thread.
pub struct FrameLoop {
    pub(super) renderer: SkyRenderer,
    /// What it takes to open another renderer.
    pub(super) plan: LoopPlan,
    pub(super) sink: Arc<dyn FrameSink>,
    pub(super) stats: Arc<StatsCell>,
    paces: BTreeMap<ViewerId, Pace>,
    pub(super) started: Instant,
    pub(super) device_loss: DeviceLossStats,
    /// After the device is lost, how long no other one opens; for tests.
    pub(super) closed_for: Duration,
    time: Instant,
    stats_due: Instant,
    ns_per_tile: f64,
    cache_time_seen: (u64, u64),
    was_pending: bool,
    /// When texels are audited next, if any are left.
    audit_due: Instant,
    /// When maps took their last step on their way to others.
    blended: Instant,
    /// Device time that may be marched before frames come first again, s. Negative after a batch that was longer.
    march_credit_s: f64,
}

/// Pixels of pictures that are composited in one submission, unless one has more: those of four viewers at 640x360.
const SUBMISSION_PIXELS: u32 = 4 * 640 * 360;

/// Viewers in the order in which their pictures are composited, in groups that are submitted together.
fn submissions(due: &[ViewerId], pixels: impl Fn(&ViewerId) -> u32) -> Vec<Vec<ViewerId>> {
    let mut due: Vec<(u32, ViewerId)> = due.iter().map(|id| (pixels(id), *id)).collect();
    due.sort_unstable();
    let mut groups: Vec<Vec<ViewerId>> = Vec::new();
    let mut room = 0;
    for (pixels, id) in due {
        match groups.last_mut() {
            Some(group) if pixels <= room => {
                group.push(id);
                room -= pixels;
            }
            _ => {
                groups.push(vec![id]);
                room = SUBMISSION_PIXELS.saturating_sub(pixels);
            }
        }
    }
    groups
}

/// What became of the marching in a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Marching {
    /// All is marched.
    Done,
    /// There may be more to do at once.
    More,
    /// There is more to do when frames leave time for it.
    Held,
}

impl FrameLoop {
    /// Opens the device, makes or loads the noise, warms the pipelines up and starts the thread. Ready when it returns.
    ///
    /// # Errors
    /// When there is no device that can render.
    pub fn start(
        config: RenderConfig,
        scene: Arc<Scene>,
        revision: u64,
        sink: Arc<dyn FrameSink>,
        cells: &[PlacedCell],
    ) -> Result<(FrameLoopHandle, JoinHandle<()>), GpuError> {
        let plan = LoopPlan {
            config,
            cells: cells.to_vec(),
            document: scene,
            revision,
        };
        let renderer = plan.open()?;
        let (sender, commands) = render_command_channel();
        let stats = StatsCell::new();
        stats.publish(renderer.stats(0.0));
        let handle = FrameLoopHandle::new(sender, stats.clone());
        let frame_loop = Self::of(renderer, plan, sink, stats);
        let ready = frame_loop.stats.ready();
        let thread = std::thread::Builder::new()
            .name("render".into())
            .spawn(move || device_loss::run(frame_loop, ready, &commands))?;
        Ok((handle, thread))
    }

    /// The loop of an open renderer.
    pub(super) fn of(
        renderer: SkyRenderer,
        plan: LoopPlan,
        sink: Arc<dyn FrameSink>,
        stats: Arc<StatsCell>,
    ) -> Self {
        let now = Instant::now();
        Self {
            plan,
            sink,
            stats,
            paces: BTreeMap::new(),
            started: now,
            time: now,
            stats_due: now,
            ns_per_tile: FIRST_TILE_NS,
            cache_time_seen: renderer.gpu_time(TimedPass::Cache),
            was_pending: false,
            audit_due: now,
            blended: now,
            march_credit_s: 0.0,
            device_loss: DeviceLossStats::default(),
            closed_for: Duration::ZERO,
            renderer,
        }
    }

    /// Takes what is said, waiting for it no longer than `wait`, and makes a turn; returns how long the next one may wait,
    /// or nothing when the loop is to end.
    pub(super) fn turn(
        &mut self,
        commands: &Receiver<RenderCommand>,
        wait: Duration,
    ) -> Option<Duration> {
        match commands.recv_timeout(wait) {
            Ok(command) => {
                let mut next = Some(command);
                while let Some(command) = next {
                    if matches!(command, RenderCommand::Shutdown) {
                        return None;
                    }
                    self.apply(command);
                    next = commands.try_recv().ok();
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return None,
        }
        if self.renderer.gpu.loss().is_some() {
            return Some(Duration::ZERO);
        }
        if let Err(error) = self.renderer.gpu.device.poll(wgpu::PollType::Poll) {
            self.renderer.gpu.give_up(error.to_string());
            return Some(Duration::ZERO);
        }
        Some(self.tick())
    }

    fn apply(&mut self, command: RenderCommand) {
        let now = Instant::now();
        match command {
            RenderCommand::Join { viewer, view } => self.join(viewer, view),
            RenderCommand::SetCamera {
                viewer,
                input,
                camera,
                arrived,
            } => {
                self.renderer.set_camera(viewer, input, camera);
                if let Some(viewer) = self.renderer.viewers.get_mut(&viewer) {
                    viewer.input_arrived = Some(arrived);
                }
                self.moved(viewer, now);
            }
            RenderCommand::SetView { viewer, view } => {
                self.renderer.set_view(viewer, view);
                self.moved(viewer, now);
            }
            RenderCommand::Acknowledge {
                viewer,
                sequence,
                frames_in_flight_max,
            } => {
                if let Some(viewer) = self.renderer.viewers.get_mut(&viewer) {
                    viewer.acknowledge(sequence, frames_in_flight_max);
                }
            }
            RenderCommand::Refine { viewer } => self.refine(viewer, now),
            RenderCommand::Leave { viewer } => {
                self.renderer.leave(viewer);
                self.paces.remove(&viewer);
            }
            RenderCommand::SetScene { scene, revision } => {
                (self.plan.document, self.plan.revision) = (scene.clone(), revision);
                self.renderer.await_scene(scene, revision);
            }
            RenderCommand::LoseDevice { closed_for } => {
                self.closed_for = closed_for;
                self.renderer.gpu.device.destroy();
                // As wgpu's callback does when a driver fails.
                self.renderer.gpu.give_up("told to lose it".to_owned());
            }
            // The loop ends before it comes here.
            RenderCommand::Shutdown => {}
        }
    }

    pub(super) fn join(&mut self, viewer: ViewerId, view: ViewRequest) {
        let now = Instant::now();
        self.renderer.join(viewer, view);
        let pace = Pace {
            due: now,
            moved: now,
            composited: None,
            change: Change::Seen,
            refining: Refining::default(),
        };
        self.paces.insert(viewer, pace);
    }

    fn moved(&mut self, viewer: ViewerId, now: Instant) {
        if let Some(pace) = self.paces.get_mut(&viewer) {
            pace.moved = now;
            pace.change = Change::Seen;
        }
        if let Some(viewer) = self.renderer.viewers.get_mut(&viewer) {
            viewer.refines = false;
        }
    }

    /// A viewer gets its last picture once more, unless another is due.
    fn refine(&mut self, id: ViewerId, now: Instant) {
        let of_own = self.renderer.viewers.get(&id);
        let has_own_rays = of_own.is_some_and(|viewer| self.renderer.shows_pixels(viewer));
        let is_marching = has_own_rays && self.renderer.screen_space_pending(id);
        let (Some(pace), Some(viewer)) =
            (self.paces.get_mut(&id), self.renderer.viewers.get_mut(&id))
        else {
            return;
        };
        // What is on its way anyway may be refined in its turn.
        if pace.change != Change::None || is_marching {
            return;
        }
        viewer.refines = true;
        if !has_own_rays {
            pace.change = Change::Seen;
        } else if viewer.has_room() {
            // What is marched is still there.
            self.composite(&[id], now);
        }
    }

    /// Composites frames of viewers, small pictures before large ones, and not in one submission with those: what is
    /// submitted together comes back together.
    fn composite(&mut self, due: &[ViewerId], now: Instant) {
        let pixels = |id: &ViewerId| {
            let viewer = self.renderer.viewers.get(id);
            viewer.map_or(0, |viewer| viewer.view.picture_size().pixels())
        };
        for group in submissions(due, pixels) {
            for viewer in self.renderer.composite(&group, &self.sink) {
                self.composited(viewer, now);
            }
        }
    }

    /// One turn; returns how long the loop may sleep.
    fn tick(&mut self) -> Duration {
        let now = Instant::now();
        self.renderer.counters.ticks += 1;
        let passed = now.duration_since(self.time);
        self.time = now;
        self.march_credit_s = (self.march_credit_s + self.march_share() * passed.as_secs_f64())
            .min(MARCH_CREDIT_MAX_S);
        let shown = self.renderer.take_views();
        self.take_awaited_scene();
        self.follow_time(passed);
        let is_hurried = self.hurried_fps(now) > 0.0;
        let is_fine_again = (self.renderer).consider_rate(now, self.ns_per_tile * 1e-9, is_hurried);
        if self.paces.is_empty() {
            self.publish(now, true);
            return if self.renderer.in_flight() > 0 {
                POLL_INTERVAL
            } else {
                IDLE_INTERVAL
            };
        }
        if self.renderer.follow_air() {
            for pace in self.paces.values_mut() {
                pace.change = Change::Seen;
            }
        }
        for viewer in shown {
            if let Some(pace) = self.paces.get_mut(&viewer) {
                pace.change = Change::Seen;
            }
        }
        if is_fine_again {
            self.show_fine_again();
        }
        self.note_ages(now);
        self.renderer.consider_budgets(now);
        self.renderer.forget_unseen(now);
        self.note_wind(now);
        self.step_maps(now);
        let cells = self.renderer.adapt_exposures(now, passed.as_secs_f64());
        for (id, pace) in &mut self.paces {
            let viewer = self.renderer.viewers.get(id);
            let is_shown = |v: &ActiveViewer| cells.iter().any(|cell| v.looks_at(*cell));
            if viewer.is_some_and(is_shown) {
                pace.change = Change::Seen;
            }
        }
        for viewer in self.renderer.regroup(passed.as_secs_f64()) {
            if let Some(pace) = self.paces.get_mut(&viewer) {
                pace.change = Change::Seen;
            }
        }
        let faded = self.renderer.pass_renderer_fades(passed.as_secs_f64());
        let changed = self.renderer.pass_transitions(passed.as_secs_f64());
        for viewer in faded.into_iter().chain(changed) {
            if let Some(pace) = self.paces.get_mut(&viewer) {
                pace.change = Change::Seen;
            }
        }
        self.renderer.refresh_cells();
        // By what they ask for now: whoever moves all the time arrives, too.
        for viewer in self.renderer.finish_approaches(now) {
            if let Some(pace) = self.paces.get_mut(&viewer) {
                pace.change = Change::Seen;
            }
        }
        self.note_held(now);
        let due = self.due_viewers(now);
        self.composite(&due, now);
        self.refine_videos(now);
        self.audit(now);
        let marched = self.march(now);
        self.publish(now, false);
        self.next_wait(now, marched)
    }

    /// Pictures of the cache are no coarser any more than was wished, and may be exact: a frame says so even where nothing
    /// is left to be marched.
    fn show_fine_again(&mut self) {
        for (id, pace) in &mut self.paces {
            let viewer = self.renderer.viewers.get(id);
            if viewer.is_some_and(|viewer| viewer.kind == RendererKind::Cached) {
                pace.change = pace.change.max(Change::Sharper);
            }
        }
    }

    /// Maps go on to others, when everything has been marched since their last step.
    fn step_maps(&mut self, now: Instant) {
        if !self.renderer.field.maps_are_blending() {
            return;
        }
        let waited = now.duration_since(self.blended);
        if waited < BLEND_INTERVAL
            || (waited < BLEND_WAIT_MAX && !self.renderer.caches.is_refreshed())
        {
            return;
        }
        self.blended = now;
        if self.renderer.step_maps() != BlendStep::None {
            for pace in self.paces.values_mut() {
                pace.change = Change::Seen;
            }
        }
    }

    /// Who looks at the age of texels sees them age.
    fn note_ages(&mut self, now: Instant) {
        for (id, pace) in &mut self.paces {
            let shows_ages = self.renderer.viewers.get(id).is_some_and(|viewer| {
                viewer.view.show == Show::CacheAge && viewer.kind == RendererKind::Cached
            });
            let is_old = pace
                .composited
                .is_some_and(|last| now.duration_since(last) >= AGES_INTERVAL);
            if shows_ages && is_old {
                pace.change = Change::Seen;
            }
        }
    }

    /// Shows the scene that was announced, when all that it takes is there.
    fn take_awaited_scene(&mut self) {
        match self.renderer.take_awaited_scene() {
            Ok(false) => {}
            Ok(true) => {
                for pace in self.paces.values_mut() {
                    pace.change = Change::Seen;
                }
            }
            Err(error) => tracing::error!(%error, "the scene could not be taken over"),
        }
    }

    /// Brings the sky to the present moment.
    fn follow_time(&mut self, passed: Duration) {
        self.renderer.advance_maps(passed.as_secs_f64());
        match self
            .renderer
            .follow_time(clock::now(), !self.paces.is_empty())
        {
            Ok(false) => {}
            Ok(true) => {
                for pace in self.paces.values_mut() {
                    pace.change = Change::Seen;
                }
            }
            Err(error) => {
                tracing::error!(%error, "the scene of the moment could not be taken over");
            }
        }
    }

    /// Wind moves what resting viewers see.
    fn note_wind(&mut self, now: Instant) {
        let wind_m_per_s = self.renderer.wind_speed_max_m_per_s();
        // Texels that are marched anew show it to those who read the cache.
        let evolution_m_per_s = self.renderer.evolution_max_m_per_s();
        if wind_m_per_s + evolution_m_per_s == 0.0 {
            return;
        }
        let nearest_m = self
            .renderer
            .active
            .iter()
            .map(|layer| layer.proxy_altitude_m)
            .fold(f64::INFINITY, f64::min);
        for (id, pace) in &mut self.paces {
            let (Some(last), Some(viewer)) = (pace.composited, self.renderer.viewers.get(id))
            else {
                continue;
            };
            let camera = &viewer.view.camera;
            let pixel_rad = (camera.vertical_fov_deg().to_radians() / 2.0).tan() * 2.0
                / f64::from(viewer.view.size.height());
            let height_m = (nearest_m - camera.position_m()[1]).abs().max(100.0);
            let speed_m_per_s = match viewer.kind {
                RendererKind::ScreenSpace => wind_m_per_s + evolution_m_per_s,
                RendererKind::Cached => wind_m_per_s,
            };
            let moved_rad = speed_m_per_s * now.duration_since(last).as_secs_f64() / height_m;
            if moved_rad > MOTION_PIXELS * pixel_rad {
                pace.change = Change::Seen;
            }
        }
    }

    fn due_viewers(&self, now: Instant) -> Vec<ViewerId> {
        self.paces
            .iter()
            .filter(|(id, pace)| {
                self.renderer.viewers.get(id).is_some_and(|viewer| {
                    self.is_on_schedule(**id, viewer, pace)
                        && self.has_room(viewer)
                        && self.due_at(pace).is_some_and(|due| due <= now)
                        && !self.renderer.waits_for_tiles(viewer)
                })
            })
            .map(|(id, _)| *id)
            .collect()
    }

    /// Whether a viewer's frames come at their time. What is marched for it alone is composited when a sample is complete; then
    /// only what it shares, or a mix of two pictures, can be new.
    fn is_on_schedule(&self, id: ViewerId, viewer: &ActiveViewer, pace: &Pace) -> bool {
        if !self.renderer.shows_pixels(viewer) {
            return true;
        }
        let shares = viewer.kind == RendererKind::Cached && pace.change == Change::Sharper;
        (viewer.fades() || shares)
            && !self.renderer.screen_space_pending(id)
            && (viewer.screen_space.as_ref()).is_some_and(|job| job.shown_from().is_some())
    }

    /// Counts the frames that are due and wait for tiles.
    fn note_held(&mut self, now: Instant) {
        let mut held = Vec::new();
        for (id, pace) in &self.paces {
            let is_due = self.due_at(pace).is_some_and(|due| due <= now);
            let viewer = self.renderer.viewers.get(id);
            let waits = |viewer: &&ActiveViewer| {
                viewer.kind == RendererKind::Cached && self.renderer.waits_for_tiles(viewer)
            };
            if is_due
                && let Some(viewer) = viewer.filter(waits)
                && viewer.waits_since.is_none()
            {
                held.push((*id, viewer.frames_composited == 0));
            }
        }
        for (id, is_first) in held {
            if let Some(viewer) = self.renderer.viewers.get_mut(&id) {
                viewer.waits_since = Some(now);
            }
            let counters = &mut self.renderer.counters;
            counters.first_frames_held += u64::from(is_first);
            counters.frames_held += u64::from(!is_first);
        }
    }

    /// Share of the time in which the device marches while viewers move or the wind blows and frames wait for it: the rest
    /// is for composites, encoders and sockets.
    fn march_share(&self) -> f64 {
        f64::from(self.renderer.config.march_share)
    }

    fn due_at(&self, pace: &Pace) -> Option<Instant> {
        match pace.change {
            Change::None => None,
            Change::Seen => Some(pace.due),
            Change::Sharper => Some(
                pace.composited
                    .map_or(pace.due, |last| pace.due.max(last + self.refine_interval())),
            ),
        }
    }

    /// How long a resting view that gets sharper waits for its next frame.
    fn refine_interval(&self) -> Duration {
        let (ns, frames) = self.renderer.gpu_time(TimedPass::Composite);
        if frames == 0 {
            return REFINE_INTERVAL;
        }
        let all_viewers_ns = ns as f64 / frames as f64 * self.paces.len() as f64;
        REFINE_INTERVAL.max(Duration::from_secs_f64(
            all_viewers_ns * 1e-9 / REFINE_SHARE,
        ))
    }

    fn composited(&mut self, id: ViewerId, now: Instant) {
        let Some(viewer) = self.renderer.viewers.get(&id) else {
            return;
        };
        if let Some(pace) = self.paces.get_mut(&id) {
            let interval = Duration::from_secs_f64(1.0 / viewer.view.fps);
            // On schedule while it keeps up; a late frame starts a new schedule instead of a burst.
            pace.due = if pace.due + interval > now {
                pace.due + interval
            } else {
                now + interval
            };
            pace.composited = Some(now);
            pace.refining.made(Refinement::None);
            // Two cells that are mixed are another picture in every frame.
            pace.change = if viewer.fades() || viewer.shows_rays_on_its_way() {
                Change::Seen
            } else {
                Change::None
            };
        }
    }

    /// The next picture of each video that comes closer to what it shows, and when it is due: of views that rest.
    fn refinements(&self) -> Vec<(ViewerId, Instant, Refinement)> {
        let interval = self.refine_interval();
        let mut next = Vec::new();
        for (id, pace) in &self.paces {
            let (Some(newest), Change::None) = (pace.composited, pace.change) else {
                continue;
            };
            if let Some((due, refinement)) = pace.refining.next(newest, interval)
                && let Some(viewer) = self.renderer.viewers.get(id)
                && self.renderer.may_be_refined(*id, viewer)
            {
                next.push((*id, due, refinement));
            }
        }
        next
    }

    /// Makes the pictures that let videos come closer to what they show.
    fn refine_videos(&mut self, now: Instant) {
        for (id, due, refinement) in self.refinements() {
            if due > now {
                continue;
            }
            if let Some(viewer) = self.renderer.viewers.get_mut(&id) {
                viewer.refinement = refinement;
            }
            let made = self.renderer.composite(&[id], &self.sink);
            if let Some(viewer) = self.renderer.viewers.get_mut(&id) {
                viewer.refinement = Refinement::None;
            }
            if let (Some(pace), false) = (self.paces.get_mut(&id), made.is_empty()) {
                pace.composited = Some(now);
                pace.refining.made(refinement);
            }
        }
    }

    /// Marches a batch when the device has room for one.
    fn march(&mut self, now: Instant) -> Marching {
        if self.renderer.in_flight() >= SUBMISSIONS_MAX {
            return Marching::More;
        }
        let (ns, tiles) = self.renderer.gpu_time(TimedPass::Cache);
        let (seen_ns, seen_tiles) = self.cache_time_seen;
        if tiles > seen_tiles {
            let measured = (ns - seen_ns) as f64 / (tiles - seen_tiles) as f64;
            self.ns_per_tile += 0.3 * (measured - self.ns_per_tile);
            self.cache_time_seen = (ns, tiles);
        }
        let hurried_fps = self.hurried_fps(now);
        let budget = if hurried_fps > 0.0 {
            RESTING_BATCH.min(Duration::from_secs_f64(self.march_share() / hurried_fps))
        } else {
            RESTING_BATCH
        };
        if hurried_fps > 0.0 && self.march_credit_s <= 0.0 && !self.device_rests(now) {
            // Who sees rays on the way between cells has no other frames.
            return if self.march_screen_space(budget, ActiveViewer::shows_rays_on_its_way) {
                Marching::More
            } else {
                Marching::Held
            };
        }
        let tiles_max = (budget.as_nanos() as f64 / self.ns_per_tile).max(1.0) as usize;
        if self.renderer.update_sun_volumes(tiles_max) {
            // What is marched before the volume is there would have to be marched again.
            return Marching::More;
        }
        let shafts = self.update_light_shafts(tiles_max);
        let screen_space = self.march_screen_space(budget, |_| true);
        let updates = self.renderer.march(tiles_max);
        self.march_credit_s -= updates.len() as f64 * self.ns_per_tile * 1e-9;
        for update in &updates {
            for (id, pace) in &mut self.paces {
                let here = self
                    .renderer
                    .viewers
                    .get(id)
                    .is_some_and(|viewer| viewer.looks_at(update.sphere.cell));
                if here {
                    pace.change = pace.change.max(Change::Sharper);
                }
            }
        }
        // The last batch of a burst leaves a picture that is due at once.
        let pending = !updates.is_empty();
        if self.was_pending && !pending {
            for pace in self
                .paces
                .values_mut()
                .filter(|p| p.change == Change::Sharper)
            {
                pace.change = Change::Seen;
            }
        }
        self.was_pending = pending;
        if pending || screen_space || shafts {
            Marching::More
        } else {
            Marching::Done
        }
    }

    /// Makes parts of light shafts; true while there is more to make. Who sees air that is lit otherwise gets a frame.
    fn update_light_shafts(&mut self, tiles_max: usize) -> bool {
        let progress = self.renderer.update_light_shafts(tiles_max);
        self.march_credit_s -= self.renderer.shafts_time_s(progress.evaluations);
        for (id, pace) in &mut self.paces {
            let viewer = self.renderer.viewers.get(id);
            let is_shown = |v: &ActiveViewer| progress.changed.iter().any(|c| v.looks_at(*c));
            if viewer.is_some_and(is_shown) {
                pace.change = Change::Seen;
            }
        }
        progress.is_pending
    }

    /// Marches some texels again, after frames: none while one is due, and at rest only when all is marched.
    fn audit(&mut self, now: Instant) {
        self.renderer.collect_audit(now);
        let hurried = self.hurried_fps(now) > 0.0;
        let (texels, interval) = if hurried {
            HURRIED_AUDIT
        } else {
            RESTING_AUDIT
        };
        let has_room = if hurried {
            self.renderer.in_flight() < SUBMISSIONS_MAX
        } else {
            self.renderer.in_flight() == 0 && !self.was_pending
        };
        let frame_is_due = self.next_due().is_some_and(|due| due <= now);
        if now < self.audit_due || !has_room || frame_is_due || !self.renderer.audit.is_pending() {
            return;
        }
        self.renderer.audit(texels);
        self.audit_due = now + interval;
    }

    /// Whether the device has nothing to do for longer than a tile takes.
    fn device_rests(&self, now: Instant) -> bool {
        let tile = Duration::from_nanos(self.ns_per_tile as u64);
        self.renderer.in_flight() == 0 && self.next_due().is_none_or(|due| due > now + tile)
    }

    /// The most frames a second that a viewer wants who moves or sees the sky move; 0 when all rests.
    fn hurried_fps(&self, now: Instant) -> f64 {
        let changing = self.renderer.sky_is_changing();
        self.paces
            .iter()
            .filter_map(|(id, pace)| Some((self.renderer.viewers.get(id)?, pace)))
            .filter(|(viewer, pace)| {
                let mixes = viewer.fades() || viewer.shows_rays_on_its_way();
                changing || mixes || now.duration_since(pace.moved) < MOVING_FOR
            })
            .map(|(viewer, _)| viewer.view.fps)
            .fold(0.0, f64::max)
    }

    /// One strip for one of some viewers with rays of their own that lacks samples; a complete sample becomes a frame.
    fn march_screen_space(&mut self, budget: Duration, of: impl Fn(&ActiveViewer) -> bool) -> bool {
        let now = Instant::now();
        let mut ids: Vec<ViewerId> = self
            .renderer
            .viewers
            .iter()
            .filter(|(_, viewer)| self.renderer.marches_pixels(viewer) && of(viewer))
            .map(|(id, _)| *id)
            .collect();
        // Whoever has waited longest: one that moves all the time has always something to march.
        // Rays that are not shown yet come first: their window is full after some frames, and who waits for that has others.
        let is_shown = |id: &ViewerId| {
            let viewer = self.renderer.viewers.get(id);
            viewer.is_some_and(|viewer| self.renderer.shows_pixels(viewer))
        };
        ids.sort_by_key(|id| {
            let composited = self.paces.get(id).and_then(|pace| pace.composited);
            (is_shown(id), composited)
        });
        for id in ids {
            let of_id = self.renderer.viewers.get(&id);
            let is_on_its_way = of_id.is_some_and(ActiveViewer::marches_on_its_way);
            let shows_rays = of_id.is_some_and(|viewer| self.renderer.shows_pixels(viewer));
            // What is not sent needs no room.
            let room = of_id.is_some_and(|viewer| !shows_rays || self.has_room(viewer));
            let seen = self
                .paces
                .get(&id)
                .is_some_and(|pace| pace.change == Change::Seen);
            if is_on_its_way && shows_rays && self.waits_for_its_time(id, now) {
                continue;
            }
            if seen && room && !is_on_its_way && self.renderer.screen_space_is_shown(id) {
                // Moved since: the picture under way has been shown, the next one starts from the new view.
                self.renderer.restart_screen_space(id);
                if let Some(pace) = self.paces.get_mut(&id) {
                    pace.change = Change::None;
                }
            }
            if room && self.renderer.screen_space_pending(id) {
                let viewer = self.renderer.viewers.get_mut(&id);
                if let Some(viewer) = viewer.filter(|_| shows_rays) {
                    viewer.waits_since.get_or_insert_with(Instant::now);
                }
                if self
                    .renderer
                    .march_screen_space(id, budget.as_nanos() as u64)
                    && shows_rays
                {
                    let now = Instant::now();
                    for viewer in self.renderer.composite(&[id], &self.sink) {
                        if is_on_its_way {
                            self.composited(viewer, now);
                        } else if let Some(pace) = self.paces.get_mut(&viewer) {
                            pace.composited = Some(now);
                            pace.refining.made(Refinement::None);
                        }
                    }
                }
                return true;
            }
        }
        false
    }

    /// Whether a viewer's next frame of rays is not to be begun yet: on the way to another cell each is another picture.
    fn waits_for_its_time(&self, id: ViewerId, now: Instant) -> bool {
        let viewer = self.renderer.viewers.get(&id);
        let job = viewer.and_then(|viewer| viewer.screen_space.as_ref());
        let is_due = self.paces.get(&id).is_none_or(|pace| pace.due <= now);
        job.is_some_and(ScreenSpaceJob::begins) && !is_due
    }

    fn publish(&mut self, now: Instant, idle: bool) {
        if now >= self.stats_due || idle {
            self.stats_due = now + STATS_INTERVAL;
            let uptime_s = now.duration_since(self.started).as_secs_f64();
            self.stats.publish(RenderStats {
                device_loss: self.device_loss.clone(),
                ..self.renderer.stats(uptime_s)
            });
        }
    }

    /// Whether a viewer can be sent another frame.
    fn has_room(&self, viewer: &ActiveViewer) -> bool {
        viewer.has_room() && !self.renderer.waits_for_format(viewer)
    }

    /// When the next frame is due of those whose viewers have room for one.
    fn next_due(&self) -> Option<Instant> {
        self.paces
            .iter()
            .filter(|(id, _)| {
                self.renderer
                    .viewers
                    .get(id)
                    .is_some_and(|viewer| self.has_room(viewer))
            })
            .filter_map(|(_, pace)| self.due_at(pace))
            .min()
    }

    fn next_wait(&self, now: Instant, marching: Marching) -> Duration {
        if self.renderer.in_flight() > 0 || marching == Marching::Held {
            return POLL_INTERVAL;
        }
        if marching == Marching::More {
            return Duration::ZERO;
        }
        let refined = self.refinements().into_iter().map(|(_, due, _)| due).min();
        let next = self.next_due().into_iter().chain(refined).min();
        let rest = if self.renderer.sky_is_changing() || self.renderer.air.is_moving() {
            Duration::from_millis(20)
        } else {
            IDLE_INTERVAL
        };
        let stats = self
            .stats_due
            .saturating_duration_since(now)
            .max(POLL_INTERVAL);
        let rest = if self.stats_are_behind() {
            rest.min(stats)
        } else {
            rest
        };
        let rest = if self.renderer.audit.is_pending() {
            let audit = self.audit_due.saturating_duration_since(now);
            rest.min(audit.max(POLL_INTERVAL))
        } else {
            rest
        };
        next.map_or(rest, |due| {
            due.saturating_duration_since(now)
                .clamp(POLL_INTERVAL, rest)
        })
    }

    /// Whether something has happened since the figures were published.
    fn stats_are_behind(&self) -> bool {
        let published = self.stats.latest();
        published.totals.submissions != self.renderer.counters.submissions
            || published.viewers.len() != self.renderer.viewers.len()
            || published.totals.gpu_composite_ns != self.renderer.gpu_time(TimedPass::Composite).0
            || published.totals.gpu_cache_ns != self.renderer.gpu_time(TimedPass::Cache).0
            || published.audit.rests == self.renderer.audit.is_pending()
            || published.audit.texels != self.renderer.audit.stats(Instant::now()).texels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_pictures_come_back_before_a_large_one_and_without_waiting_for_it() {
        let sizes = [1920 * 1080, 64 * 36, 640 * 360, 640 * 360, 3840 * 2160];
        let due: Vec<ViewerId> = (0..5).map(ViewerId).collect();
        let groups = submissions(&due, |id| sizes[id.0 as usize]);
        let of = |ids: &[u32]| ids.iter().copied().map(ViewerId).collect::<Vec<_>>();
        assert_eq!(groups, [of(&[1, 2, 3]), of(&[0]), of(&[4])]);
        assert!(submissions(&[], |_| 1).is_empty());
        // As many equal ones as fit go together, and nobody is left out.
        let crowd: Vec<ViewerId> = (0..200).map(ViewerId).collect();
        let groups = submissions(&crowd, |_| 320 * 180);
        assert!(groups.iter().all(|group| group.len() <= 16));
        assert_eq!(groups.concat(), crowd);
    }
}
