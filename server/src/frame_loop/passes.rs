//! What is submitted to the device: batches of texels, strips of pixels, frames and their way back.

use super::clouds::of_format;
use super::eyes::EyesPicture;
use super::interface::{FinishedFrame, FrameSink};
use super::renderer::{SkyRenderer, frame_key};
use super::transitions::Stage;
use super::viewers_on_device::ActiveViewer;
use crate::cache::{SphereId, TileRequest, TileUpdate};
use crate::clock::{saturating_us, unix_now_us};
use crate::composite::{Mix, Picture, PictureFade, dither_shift, shown_key};
use crate::gpu::{GpuError, PipelineKey, TimedPass};
use crate::march::{
    ActiveLayer, BATCH_TILES_MAX, MarchedPixels, PixelStrip, TexelGroup, layer_features,
};
use glam::DVec3;
use skycell_protocol::clouds::CloudsHeader;
use skycell_protocol::{CellId, Codec, FrameSequence, FrameStages, RendererKind, Scene, ViewerId};
use skycell_shaders::{Features, Shown, layout};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Radius of the ground, where there is one and no cloud can stand in front of it.
pub(super) fn ground_radius_m(
    scene: &Scene,
    active: &[ActiveLayer],
    view: &layout::View,
) -> Option<f64> {
    let is_below = |layer: &ActiveLayer| {
        f64::from(view.altitude_m) < scene.layers()[layer.scene_index].base_altitude_m()
    };
    (!scene.planet().is_flat() && active.iter().all(is_below)).then(|| scene.planet().radius_m())
}

impl SkyRenderer {
    /// Marches at most `tiles_max` tiles and returns what was marched. The tiles are shown from the next refresh on.
    pub(super) fn march(&mut self, tiles_max: usize) -> Vec<TileUpdate> {
        let references: BTreeMap<SphereId, DVec3> = self
            .active_cells
            .keys()
            .flat_map(|cell| {
                (0..self.proxies.len() as u32).map(|proxy| SphereId { cell: *cell, proxy })
            })
            .filter_map(|sphere| Some((sphere, self.drifting_reference(sphere)?)))
            .collect();
        let updates = self.caches.plan(tiles_max.min(BATCH_TILES_MAX), |sphere| {
            references.get(&sphere).copied()
        });
        if updates.is_empty() {
            return updates;
        }
        self.atlas.fit(&self.gpu, self.caches.slots_needed());
        for update in &updates {
            if let Some(anchor_m) = self.drifting_anchor(update.sphere) {
                let from_anchor_m = update.from - anchor_m;
                self.atlas.set_origin(&self.gpu, update.slot, from_anchor_m);
            }
        }
        let mut by_sphere: BTreeMap<SphereId, Vec<TileUpdate>> = BTreeMap::new();
        for update in &updates {
            by_sphere.entry(update.sphere).or_default().push(*update);
        }
        let groups: Vec<TexelGroup<'_>> =
            by_sphere
                .into_iter()
                .filter_map(|(sphere, updates)| {
                    let scene_index = self.proxies.get(sphere.proxy as usize)?.scene_index;
                    let cell = self.active_cells.get(&sphere.cell)?;
                    Some(TexelGroup {
                        cell: &cell.buffers,
                        features: self.kept_on.features(cell.buffers.march_features(
                            layer_features(&self.scene, scene_index, &cell.settings),
                        )),
                        proxy: sphere.proxy,
                        frame: cell.frame,
                        drift_m: self.drifts[scene_index].with_y(0.0),
                        updates,
                    })
                })
                .collect();
        self.timing.begin();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("march texels"),
            });
        self.counters.dispatches += self.texel_march.record(
            &self.gpu,
            &mut encoder,
            &mut self.timing,
            &self.pipelines,
            &self.atlas,
            &groups,
        );
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
        self.counters.tiles_updated += updates.len() as u64;
        for update in &updates {
            let cell = self.active_cells.get_mut(&update.sphere.cell);
            if let Some(meter) = cell.and_then(|cell| cell.meter.as_mut()) {
                meter.due = true;
            }
        }
        self.audit.tiles_changed();
        updates
    }

    pub(super) fn submit(&mut self, encoder: wgpu::CommandEncoder) {
        self.counters.submissions += 1;
        self.gpu.queue.submit([encoder.finish()]);
        self.watch_submission();
    }

    /// Counts what was just submitted as under way until the device is done with it.
    pub(super) fn watch_submission(&self) {
        self.in_flight.fetch_add(1, Ordering::AcqRel);
        let in_flight = self.in_flight.clone();
        self.gpu.queue.on_submitted_work_done(move || {
            in_flight.fetch_sub(1, Ordering::AcqRel);
        });
    }

    /// Submissions that the device has not finished.
    pub(super) fn in_flight(&self) -> u32 {
        self.in_flight.load(Ordering::Acquire)
    }

    /// Submits rows of a viewer's marched pixels; false when its cell is gone.
    pub(super) fn submit_pixels(
        &mut self,
        cell: CellId,
        marched: &MarchedPixels,
        features: Features,
        view: &layout::View,
        rows: u32,
    ) -> bool {
        let Some(cell) = self.active_cells.get(&cell) else {
            return false;
        };
        marched.submit_strip(
            &self.gpu,
            &mut self.timing,
            &self.pipelines,
            &PixelStrip {
                cell: &cell.buffers,
                features: cell.buffers.march_features(features),
                view,
                rows,
            },
        );
        true
    }

    /// Composites a frame for each of the viewers that has a buffer free, in one submission, and has it read back into
    /// the sink. Returns whose frames are under way.
    pub(super) fn composite(
        &mut self,
        ids: &[ViewerId],
        sink: &Arc<dyn FrameSink>,
    ) -> Vec<ViewerId> {
        self.timing.begin();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("composite"),
            });
        let mut under_way = Vec::new();
        for id in ids {
            let Some(mut viewer) = self.viewers.remove(id) else {
                continue;
            };
            // With rays of its own a viewer is shown what it saw when they were marched.
            let asked = viewer.view.camera;
            let marched_from = (self.shows_pixels(&viewer))
                .then(|| viewer.screen_space.as_ref()?.shown_from())
                .flatten();
            viewer.view.camera = marched_from.unwrap_or(asked);
            let shown = viewer.view.camera;
            let first_pass = self.timing.recorded();
            if let Some(buffer) = viewer.ring.take(&self.gpu)
                && let Some(pre_exposure) = self.record_frame(&mut encoder, &viewer, &buffer)
            {
                let device_time = self.timing.watch_since(first_pass);
                under_way.push((*id, buffer, pre_exposure, shown, device_time));
            }
            viewer.view.camera = asked;
            self.viewers.insert(*id, viewer);
        }
        if under_way.is_empty() {
            return Vec::new();
        }
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
        let (submitted_unix_us, submitted) = (unix_now_us(), Instant::now());
        let mut pending_cells = BTreeMap::new();
        let mut shown_cells = Vec::new();
        let mut done = Vec::new();
        for (id, buffer, pre_exposure, camera, device_time) in under_way {
            let shown = self.viewers.get(&id);
            let coarse = shown.is_some_and(|v| self.shows_coarse(v));
            let exact = !coarse && shown.is_some_and(|v| self.is_exact(id, v, &mut pending_cells));
            let Some(viewer) = self.viewers.get_mut(&id) else {
                continue;
            };
            viewer.shown_camera = camera;
            viewer.sequence = viewer.sequence.wrapping_add(1);
            viewer.frames_composited += 1;
            self.counters.frames_composited += 1;
            let refinement = viewer.refinement;
            let (view, input, cell) = (viewer.view, viewer.input, viewer.cell);
            let refines = std::mem::take(&mut viewer.refines);
            let waits = viewer.take_waits(submitted);
            let (sequence, scene_revision) = (FrameSequence(viewer.sequence), self.scene_revision);
            let (sink, read_back) = (sink.clone(), self.counters.frames_read_back.clone());
            viewer.ring.map(buffer, move |pixels| {
                // A lost device is reported where it is polled.
                let Some(pixels) = pixels else { return };
                read_back.fetch_add(1, Ordering::Relaxed);
                let now = Instant::now();
                let until_read_back = now.saturating_duration_since(submitted);
                let composite = Duration::from_nanos(device_time.ns()).min(until_read_back);
                let stages = FrameStages {
                    composite_us: saturating_us(composite),
                    readback_us: saturating_us(until_read_back - composite),
                    ..waits
                };
                sink.deliver(FinishedFrame {
                    viewer: id,
                    sequence,
                    input,
                    scene_revision,
                    cell,
                    size: view.picture_size(),
                    stereo: view.stereo.is_some(),
                    codec: view.codec,
                    jpeg_quality: view.jpeg_quality,
                    clouds: (view.codec == Codec::Clouds).then_some(CloudsHeader {
                        width: view.picture_size().width(),
                        height: view.picture_size().height(),
                        pre_exposure,
                        haze: view.haze,
                    }),
                    linear: view.linear,
                    coarse,
                    exact,
                    refinement,
                    refines,
                    stages,
                    submitted_unix_us,
                    read_back: now,
                    pixels: Box::new(pixels),
                });
            });
            let leaves = viewer.transition.as_ref().map(|t| t.from);
            for cell in [Some(cell), leaves].into_iter().flatten() {
                if !shown_cells.contains(&cell) {
                    shown_cells.push(cell);
                }
            }
            done.push(id);
        }
        for cell in shown_cells {
            self.caches.frame_shown(cell);
        }
        done
    }

    /// Whether some tile of what a viewer is shown does not show the present sky yet.
    pub(super) fn shows_coarse(&self, viewer: &ActiveViewer) -> bool {
        let is_coarse = |cell, requests: &[Vec<TileRequest>]| {
            viewer.looks_at(cell) && self.is_coarse(cell, requests)
        };
        viewer.is_shown_elsewhere()
            || is_coarse(viewer.cell, &viewer.requests)
            || viewer
                .transition
                .as_ref()
                .is_some_and(|left| is_coarse(left.from, &left.requests))
    }

    /// Whether the video of a viewer may come closer to the picture that it has: nothing of that changes any more.
    pub(super) fn may_be_refined(&self, id: ViewerId, viewer: &ActiveViewer) -> bool {
        viewer.view.codec.is_stream()
            && viewer.frames_in_flight() == 0
            && viewer.frames_composited > 0
            && !self.sky_is_changing()
            && !self.shows_coarse(viewer)
            && self.is_exact(id, viewer, &mut BTreeMap::new())
    }

    /// Whether a viewer's picture gets no finer while it rests. What it finds out about cells is kept in `pending`. What is given
    /// up for want of time comes back when all has rested for a while.
    fn is_exact(
        &self,
        id: ViewerId,
        viewer: &ActiveViewer,
        pending: &mut BTreeMap<CellId, bool>,
    ) -> bool {
        if viewer.transition.is_some()
            || viewer.approaches.is_some()
            || viewer.renderer_fade.is_some()
            || self.screen_space_pending(id)
        {
            return false;
        }
        match viewer.kind {
            RendererKind::ScreenSpace => true,
            RendererKind::Cached => {
                !self.losses.rate().coarsens()
                    && !*pending
                        .entry(viewer.cell)
                        .or_insert_with(|| self.lacks_samples(viewer.cell))
            }
        }
    }

    /// Whether anything is to be marched of what a cell's viewers see.
    fn lacks_samples(&self, cell: CellId) -> bool {
        let spheres = &mut self.caches.spheres_of(cell).map(|(_, sphere)| sphere);
        spheres.any(|sphere| sphere.pending_samples(self.caches.samples_of(sphere)) > 0)
    }

    /// Records a viewer's picture: that of its cell, that of the cell which it leaves, or a mix. Returns its pre-exposure, if
    /// it shows clouds alone.
    fn record_frame(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        viewer: &ActiveViewer,
        target: &wgpu::Buffer,
    ) -> Option<f32> {
        let (shown, _) = self.shown_to(viewer);
        // What says something of the field or the cache itself has no way between two cells.
        let left = viewer
            .transition
            .as_ref()
            .filter(|_| !shown.is_inspection() && !shown.is_of_cache())
            .filter(|left| !left.shows_rays());
        let old = left.and_then(|left| {
            let picture = left.fade.as_ref().map_or(&viewer.picture, PictureFade::old);
            let (cell, requests) = (left.from, left.requests.as_slice());
            self.record_picture(encoder, viewer, (cell, requests), picture, shown)
        });
        let waits = left.is_some_and(|left| left.way.stage() == Stage::Waits);
        if old.is_none() || !waits {
            let cell = (viewer.cell, viewer.requests.as_slice());
            self.record_picture(encoder, viewer, cell, &viewer.picture, shown)?;
        }
        if let (Some(()), Some(left)) = (old, left)
            && let Some(fade) = &left.fade
        {
            let (gpu, pipelines) = (&self.gpu, &self.pipelines);
            let mix = Mix {
                share: left.way.share(),
                dither_shift: dither_shift(viewer.view.codec),
                old_scale: self.pre_exposure_in(viewer.cell) / self.pre_exposure_in(left.from),
            };
            fade.record(gpu, encoder, &mut self.timing, pipelines, mix);
            self.counters.dispatches += 1;
        }
        self.record_renderer_fade(encoder, viewer);
        encoder.copy_buffer_to_buffer(viewer.picture.pixels(), 0, target, 0, target.size());
        let shows_old = left.filter(|_| old.is_some() && waits);
        let shown_in = shows_old.map_or(viewer.cell, |left| left.from);
        Some(self.pre_exposure_in(shown_in))
    }

    /// Records what a viewer sees with the cache of a cell, of which it requests something, or with rays of its own.
    fn record_picture(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        viewer: &ActiveViewer,
        (id, requests): (CellId, &[Vec<TileRequest>]),
        picture: &Picture,
        shown: Shown,
    ) -> Option<()> {
        let screen_space = viewer.kind == RendererKind::ScreenSpace;
        let filter = viewer.quality.settings.frame_filter;
        let blend = self.blend();
        let plain = frame_key(&self.gpu, &self.scene, filter, blend, screen_space);
        let plain = of_format(plain, viewer.view.picture_format(), viewer.view.haze);
        let keys: Vec<PipelineKey> = self
            .keys_for(viewer, id, plain)
            .into_iter()
            .map(|key| shown_key(key, shown))
            .collect();
        let asked = EyesPicture {
            viewer,
            cell: id,
            requests,
            keys: &keys,
            inspected: shown.is_inspection().then_some(shown),
        };
        self.record_eyes(encoder, picture, &asked)?;
        self.counters.dispatches += 1;
        Some(())
    }

    /// Composites one viewer's view into a picture of its own, each eye by its key.
    pub(super) fn composite_still(
        &mut self,
        id: ViewerId,
        picture: &Picture,
        keys: &[PipelineKey],
        inspected: Option<Shown>,
    ) -> Result<(), GpuError> {
        let gone = || GpuError::Device("the viewer of the picture is gone".into());
        let viewer = self.viewers.remove(&id).ok_or_else(gone)?;
        self.timing.begin();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("still"),
            });
        let asked = EyesPicture {
            viewer: &viewer,
            cell: viewer.cell,
            requests: &viewer.requests,
            keys,
            inspected,
        };
        let recorded = self.record_eyes(&mut encoder, picture, &asked);
        self.viewers.insert(id, viewer);
        recorded.ok_or_else(gone)?;
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
        Ok(())
    }

    /// GPU time and units of a kind of pass.
    pub(super) fn gpu_time(&self, pass: TimedPass) -> (u64, u64) {
        self.timing.total(pass)
    }

    pub(super) fn frames_read_back(&self) -> u64 {
        self.counters.frames_read_back.load(Ordering::Relaxed)
    }
}
