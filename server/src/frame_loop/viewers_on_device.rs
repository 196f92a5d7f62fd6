//! Viewers on the device: who joins, moves, changes its wishes and leaves.

use super::cells_on_device::parallax_steps;
use super::interface::{FRAMES_IN_FLIGHT_MAX, Refinement, ViewRequest};
use super::qualities::ViewerQuality;
use super::renderer::SkyRenderer;
use super::renderer_fade::RendererFade;
use super::screen_space::ScreenSpaceJob;
use super::transitions::Transition;
use crate::cache::{LEVELS, TEXELS_PER_TILE, TileRequest};
use crate::clock::saturating_us;
use crate::composite::{Picture, dither_shift, view_frustum, view_uniform};
use crate::gpu::{Gpu, Pipelines, ReadbackRing};
use crate::march::Side;
use skycell_protocol::{
    Camera, CellId, Codec, FrameSequence, FrameStages, InputSequence, RendererKind, ViewerId,
};
use skycell_shaders::layout;
use std::time::{Duration, Instant};

/// Pictures of a viewer that may be on their way back from the device or wait to be encoded.
const READBACKS_PER_VIEWER: usize = 3;

/// A viewer reads a cache that is still coarse after this time.
const APPROACH_MAX: Duration = Duration::from_secs(3);

/// A viewer on the device.
pub(super) struct ActiveViewer {
    pub(super) view: ViewRequest,
    pub(super) input: InputSequence,
    /// The cell that it is in or on its way to.
    pub(super) cell: CellId,
    /// Its way there from another one.
    pub(super) transition: Option<Transition>,
    /// The camera of its last frame.
    pub(super) shown_camera: Camera,
    /// Which renderer makes its frames: the one that it asks for, or rays of its own where the cache does not reach.
    pub(super) kind: RendererKind,
    /// Since when the cache is being made for it, while rays of its own still make its frames.
    pub(super) approaches: Option<Instant>,
    /// Its way from rays to the cache or back.
    pub(super) renderer_fade: Option<RendererFade>,
    pub(super) quality: ViewerQuality,
    pub(super) requests: Vec<Vec<TileRequest>>,
    pub(super) picture: Picture,
    pub(super) ring: ReadbackRing,
    pub(super) screen_space: Option<ScreenSpaceJob>,
    pub(super) sequence: u32,
    pub(super) acknowledged: u32,
    /// How many frames may be under way, as its link takes them.
    pub(super) frames_in_flight_max: u32,
    pub(super) frames_composited: u64,
    /// What its next frame is.
    pub(super) refinement: Refinement,
    /// When the last input came, until a frame shows it.
    pub(super) input_arrived: Option<Instant>,
    /// Since when its next frame waits for marching.
    pub(super) waits_since: Option<Instant>,
    /// Its next frame is to be the same picture once more, as good as it wishes.
    pub(super) refines: bool,
}

impl ActiveViewer {
    /// Texels that the viewer requests.
    pub(super) fn texels_requested(&self) -> u64 {
        self.requests.iter().map(|r| r.len() as u64).sum::<u64>() * TEXELS_PER_TILE
    }

    /// Whether the cache is to hold what it sees.
    pub(super) fn reads_cache(&self) -> bool {
        self.kind == RendererKind::Cached || self.approaches.is_some()
    }

    /// Whether the cache of its cell shows what it sees, or will at the end of its way there.
    pub(super) fn fills_cache(&self) -> bool {
        self.kind == RendererKind::Cached || self.shows_rays_on_its_way()
    }

    /// Why its frames are not made by the renderer that it asked for.
    pub(super) fn renderer_note(&self) -> Option<&'static str> {
        if self.kind == self.view.renderer {
            None
        } else if self.shows_rays_on_its_way() {
            Some(
                "the viewer is on its way from one view cell to another; rays of its own make its frames until then",
            )
        } else if self.approaches.is_some() {
            Some(
                "the cache is being made for this viewer; rays of its own make its frames until then",
            )
        } else {
            Some(
                "the camera is in a layer of clouds, where the cache does not hold; rays of its own make its frames",
            )
        }
    }

    /// How its next frame is compressed as far as dither goes: the last one of a view that rests is likely an exact one.
    fn codec_of_frame(&self) -> Codec {
        if self.refinement == Refinement::Last {
            Codec::Png
        } else {
            self.view.codec
        }
    }

    /// Frames composited and not acknowledged.
    pub(super) fn frames_in_flight(&self) -> u32 {
        self.sequence.wrapping_sub(self.acknowledged)
    }

    /// Whether another frame may be composited before one is acknowledged.
    pub(super) fn has_room(&self) -> bool {
        self.frames_in_flight() < self.frames_in_flight_max
    }

    /// Acknowledges a frame and every earlier one, if it was made and is not acknowledged yet.
    pub(super) fn acknowledge(&mut self, sequence: FrameSequence, frames_in_flight_max: u32) {
        if self.sequence.wrapping_sub(sequence.0) < self.frames_in_flight() {
            self.acknowledged = sequence.0;
        }
        self.frames_in_flight_max = frames_in_flight_max.clamp(1, FRAMES_IN_FLIGHT_MAX);
    }

    /// How long its next frame has taken so far, when it is submitted: since the input that it is the first to show, and of
    /// that waiting for marching.
    pub(super) fn take_waits(&mut self, submitted: Instant) -> FrameStages {
        let since = |start: Instant| saturating_us(submitted.saturating_duration_since(start));
        let waits_since = self.waits_since.take();
        let Some(arrived) = self.input_arrived.take() else {
            return FrameStages::default();
        };
        FrameStages {
            // 0 would say that there was no input.
            input_to_render_us: since(arrived).max(1),
            march_wait_us: waits_since.map_or(0, |start| since(start.max(arrived))),
            ..FrameStages::default()
        }
    }
}

/// The picture of a viewer.
fn picture_of(gpu: &Gpu, pipelines: &Pipelines, view: &ViewRequest) -> Picture {
    let format = view.picture_format();
    Picture::of_format(gpu, pipelines, view.size, view.eyes().len(), format, None)
}

/// Where it is read back.
fn new_ring(view: &ViewRequest) -> ReadbackRing {
    let pixel_bytes = view.picture_format().pixel_bytes();
    let bytes = u64::from(view.picture_size().pixels()) * pixel_bytes;
    ReadbackRing::new(bytes, READBACKS_PER_VIEWER)
}

impl SkyRenderer {
    pub(super) fn join(&mut self, id: ViewerId, view: ViewRequest) {
        let cell = self.place(id, &view.camera);
        let kind = self.kind_of(&view, None);
        // In a layer rays show something at once.
        let is_within = self
            .sides_at(view.camera.position_m()[1])
            .contains(&Side::Within);
        let waits = kind == RendererKind::Cached && (is_within || !self.can_be_shown(&view));
        self.prepare_sides(&view);
        let viewer = ActiveViewer {
            kind: if waits {
                RendererKind::ScreenSpace
            } else {
                kind
            },
            approaches: waits.then(Instant::now),
            renderer_fade: None,
            quality: self.quality_of(&view, None),
            shown_camera: view.camera,
            view,
            input: InputSequence(0),
            cell,
            transition: None,
            requests: Vec::new(),
            picture: picture_of(&self.gpu, &self.pipelines, &view),
            ring: new_ring(&view),
            screen_space: None,
            sequence: 0,
            acknowledged: 0,
            frames_in_flight_max: FRAMES_IN_FLIGHT_MAX,
            frames_composited: 0,
            refinement: Refinement::None,
            input_arrived: Some(Instant::now()),
            waits_since: None,
            refines: false,
        };
        self.viewers.insert(id, viewer);
        self.prepare_views();
        self.change_requests(cell);
    }

    pub(super) fn choose_renderer(&mut self, id: ViewerId, view: &ViewRequest) {
        let before = self.viewers.get(&id).map(|viewer| viewer.kind);
        let kind = self.kind_of(view, before);
        self.prepare_sides(view);
        let cell = self.viewers.get(&id).map(|viewer| viewer.cell);
        let eye_m = view.camera.position_m();
        let is_shown =
            cell.is_some_and(|cell| self.is_reached(cell, eye_m)) && self.can_be_shown(view);
        let goes_to_rays = before == Some(RendererKind::Cached)
            && (kind == RendererKind::ScreenSpace || !is_shown);
        let fade = cell
            .filter(|_| goes_to_rays)
            .and_then(|cell| self.renderer_fade(id, cell));
        let Some(viewer) = self.viewers.get_mut(&id) else {
            return;
        };
        match (viewer.kind, kind) {
            (RendererKind::ScreenSpace, RendererKind::Cached) => {
                // Rays go on until the cache has something to show: no cloudless sky in between.
                viewer.approaches.get_or_insert_with(Instant::now);
            }
            (RendererKind::Cached, RendererKind::ScreenSpace) => {
                viewer.kind = kind;
                viewer.screen_space = None;
                viewer.forget_requests();
                viewer.approaches = None;
                viewer.renderer_fade = fade;
            }
            (RendererKind::Cached, RendererKind::Cached) if !is_shown => {
                // It has come into a layer, out of one or through one.
                viewer.kind = RendererKind::ScreenSpace;
                viewer.screen_space = None;
                viewer.forget_requests();
                viewer.approaches = Some(Instant::now());
                viewer.renderer_fade = fade;
            }
            _ => viewer.approaches = None,
        }
    }

    /// Lets those viewers read the cache who come from where it does not reach and for whom it is made by now; returns them.
    pub(super) fn finish_approaches(&mut self, now: Instant) -> Vec<ViewerId> {
        let arrived: Vec<ViewerId> = self
            .viewers
            .iter()
            .filter(|(_, viewer)| {
                viewer.approaches.is_some_and(|since| {
                    let has_requests = viewer.requests.len() == self.proxies.len();
                    let is_late = now.duration_since(since) > APPROACH_MAX;
                    let transition = viewer.transition.as_ref();
                    has_requests
                        && transition.is_none_or(Transition::has_arrived)
                        && self.is_reached(viewer.cell, viewer.view.camera.position_m())
                        && self.is_there_to_stay(viewer, since, now)
                        && self.can_be_shown(&viewer.view)
                        && self.coarse_is_ready(viewer.cell)
                        && (is_late || !self.is_coarse(viewer.cell, &viewer.requests))
                })
            })
            .map(|(id, _)| *id)
            .collect();
        for id in &arrived {
            let cell = self.viewers.get(id).map(|viewer| viewer.cell);
            let fade = cell.and_then(|cell| self.renderer_fade(*id, cell));
            if let Some(viewer) = self.viewers.get_mut(id) {
                viewer.kind = RendererKind::Cached;
                viewer.approaches = None;
                viewer.transition = None;
                viewer.screen_space = None;
                viewer.renderer_fade = fade;
            }
        }
        arrived
    }

    pub(super) fn set_camera(&mut self, id: ViewerId, input: InputSequence, camera: Camera) {
        let Some(before) = self.viewers.get(&id).map(|viewer| viewer.view.camera) else {
            return;
        };
        let [was_m, is_m] = [before, camera].map(|camera| camera.position_m()[1]);
        let changes_sides = self.sides_at(was_m) != self.sides_at(is_m);
        let Some(viewer) = self.viewers.get_mut(&id) else {
            return;
        };
        if changes_sides && viewer.approaches.is_some() {
            viewer.approaches = Some(Instant::now());
        }
        viewer.view.camera = camera;
        viewer.input = input;
        viewer.forget_requests();
        let view = viewer.view;
        self.choose_renderer(id, &view);
        self.place(id, &camera);
        self.change_requests_of(id);
    }

    pub(super) fn set_view(&mut self, id: ViewerId, view: ViewRequest) {
        let Some(viewer) = self.viewers.get_mut(&id) else {
            return;
        };
        let before = viewer.view;
        if before.size != view.size
            || before.stereo.is_some() != view.stereo.is_some()
            || before.picture_format() != view.picture_format()
        {
            viewer.picture = picture_of(&self.gpu, &self.pipelines, &view);
            viewer.ring = new_ring(&view);
            viewer.renderer_fade = None;
            if let Some(transition) = &mut viewer.transition {
                transition.resize(&self.gpu, &self.pipelines, &viewer.picture);
            }
        }
        viewer.screen_space = None;
        let input = viewer.input;
        viewer.view = view;
        self.refresh_quality(id);
        self.set_camera(id, input, view.camera);
        self.prepare_views();
    }

    pub(super) fn leave(&mut self, id: ViewerId) {
        self.viewers.remove(&id);
        let cell = self.cells.cell_of(id);
        self.cells.remove(id);
        if let Some(cell) = cell {
            self.change_requests(cell);
        }
        self.end_empty_cells();
    }

    /// The views of a viewer's eyes as the shaders read them, with the tables of its cell.
    pub(super) fn views_of(&self, viewer: &ActiveViewer) -> Option<Vec<layout::View>> {
        self.views_in(viewer, viewer.cell, &viewer.requests)
    }

    /// The views of a viewer's eyes with the tables of a cell of which it requests something.
    pub(super) fn views_in(
        &self,
        viewer: &ActiveViewer,
        cell: CellId,
        requests: &[Vec<TileRequest>],
    ) -> Option<Vec<layout::View>> {
        let eyes = viewer.eyes_in(cell);
        eyes.iter()
            .map(|eye| self.view_in(viewer, eye, cell, requests))
            .collect()
    }

    fn view_in(
        &self,
        viewer: &ActiveViewer,
        eye: &Camera,
        cell: CellId,
        requests: &[Vec<TileRequest>],
    ) -> Option<layout::View> {
        let is_left = viewer.has_jumped_from(cell);
        let cell = self.active_cells.get(&cell)?;
        let frustum = view_frustum(eye, viewer.view.size, &cell.frame);
        let mut view = view_uniform(&frustum, &cell.frame, viewer.view.size);
        view.dither_shift = dither_shift(viewer.codec_of_frame());
        if let Some(start_m) = self.rays_start_m(viewer) {
            view.start = cell.frame.from_world(start_m).as_vec3().to_array();
        }
        let domes = self.kept_on.has_domes();
        if viewer.kind == RendererKind::Cached {
            self.set_near(&mut view, cell);
        }
        view.parallax_steps = parallax_steps(&self.scene, &self.active, domes, viewer, eye, cell);
        for (proxy, requests) in requests.iter().enumerate().take(view.tables.len()) {
            let finest = requests.iter().map(|r| r.key.level).max().unwrap_or(0);
            let finest = if is_left {
                // Nothing is asked for any more; what is there is shown.
                LEVELS - 1
            } else {
                finest.saturating_sub(cell.lost)
            };
            view.tables[proxy] = cell.buffers.table(proxy, finest);
        }
        Some(view)
    }
}
