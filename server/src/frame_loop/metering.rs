//! Exposure by the light of the shared sky: a small picture of the whole sky above a cell's reference point is composited
//! from its cache, read back without waiting, and its mean logarithm of luminance sets what exposure goes towards. In a layer the near
//! part is marched for it: as many rays as that picture has pixels.
//!
//! What a single viewer looks at does not matter, so nobody's turning changes anybody's picture, and a sky that rests has
//! one exposure: nothing is metered, nothing changes and no frame is sent.

mod adaptation;
#[cfg(test)]
mod tests;

use super::cells_on_device::ActiveCell;
use super::renderer::SkyRenderer;
use crate::composite::{
    CompositeInputs, Picture, composite_key, ground_key, view_frustum, view_uniform, with_above,
    with_inside,
};
use crate::config::FrameFilter;
use crate::gpu::{Gpu, GpuError, PipelineKey, Pipelines, ReadbackRing};
use crate::march::{
    EXPOSURE_AT_ZERO_EV, MarchedPixels, PixelStrip, Side, layer_features, pixels_key,
};
use adaptation::Adaptation;
use skycell_protocol::{Camera, CellId, FrameSize};
use skycell_shaders::{Features, layout};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Edge of the metered picture, pixels.
const EDGE: u32 = 24;
/// Its field of view: down to 20 degrees above the horizon in the middles of the edges, 11 in the corners.
const FOV_DEG: f64 = 140.0;
/// The sky is metered this often at most.
const INTERVAL: Duration = Duration::from_millis(250);
/// A meter has read nothing yet.
const NOTHING: u32 = u32::MAX;

/// Luminance of linear sRGB (IEC 61966-2-1).
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// A cell's meter on the device.
#[derive(Debug)]
pub(super) struct Meter {
    picture: Picture,
    /// Of the layers that the reference is in, and how many these are.
    near: Option<(usize, MarchedPixels)>,
    ring: ReadbackRing,
    found: Arc<AtomicU32>,
    pub(super) adaptation: Adaptation,
    /// The sky has changed since it was metered.
    pub(super) due: bool,
    metered: Option<Instant>,
}

impl Meter {
    fn new(gpu: &Gpu, pipelines: &Pipelines) -> Option<Self> {
        let size = FrameSize::new(EDGE, EDGE).ok()?;
        Some(Self {
            picture: Picture::new(gpu, pipelines, size, true),
            near: None,
            ring: ReadbackRing::new(u64::from(size.pixels()) * 16, 2),
            found: Arc::new(AtomicU32::new(NOTHING)),
            adaptation: Adaptation::default(),
            due: true,
            metered: None,
        })
    }
}

/// Mean of log2 of luminance at 0 EV over a picture of rgba floats, each pixel by its solid angle.
fn mean_log2(texels: &[f32]) -> f64 {
    let half = f64::from(EDGE) / 2.0;
    let scale = (FOV_DEG.to_radians() / 2.0).tan() / half;
    let (mut sum, mut weights) = (0.0, 0.0);
    for (index, pixel) in (0..).zip(texels.chunks_exact(4)) {
        let x = (f64::from(index % EDGE) + 0.5 - half) * scale;
        let y = (f64::from(index / EDGE) + 0.5 - half) * scale;
        let weight = (1.0 + x * x + y * y).powf(-1.5);
        let luminance: f64 = (0..3).map(|c| LUMINANCE[c] * f64::from(pixel[c])).sum();
        // Black is as dark as a moonless night.
        sum += weight * (luminance * EXPOSURE_AT_ZERO_EV).max(1e-9).log2();
        weights += weight;
    }
    sum / weights
}

impl SkyRenderer {
    /// The composite that meters a cell: linear, of the cache, from above some layer, in one, or neither.
    fn meter_key(&self, cell: &ActiveCell) -> PipelineKey {
        let blend = self.blend();
        let key = composite_key(&self.scene, FrameFilter::Bilinear, blend, false, true);
        if self.near_layers_of(cell) != 0 {
            with_inside(key)
        } else if self.looks_down(cell.reference_m.y) {
            with_above(key)
        } else {
            key
        }
    }

    /// What metering a cell takes.
    fn meter_keys(&self, cell: &ActiveCell) -> Vec<PipelineKey> {
        let key = self.meter_key(cell);
        let near = self.near_parts_of(cell);
        let near = near
            .iter()
            .map(|(_, features)| pixels_key(*features, false));
        [key, ground_key(key)].into_iter().chain(near).collect()
    }

    /// The layers, among the active ones, that the rays of a cell start in, and how their near parts are marched.
    fn near_parts_of(&self, cell: &ActiveCell) -> Vec<(u32, Features)> {
        let near = self.near_layers_of(cell);
        let layers = (0..).zip(&self.active);
        layers
            .filter(|(place, _)| (near >> place) & 1 == 1)
            .map(|(place, layer)| {
                let features = layer_features(&self.scene, layer.scene_index, &cell.settings);
                (place, cell.buffers.march_features(features))
            })
            .collect()
    }

    /// Whether a cell can be metered; what it takes above layers, or in one, is made when a cell is first there.
    fn can_be_metered(&mut self, cell: &ActiveCell) -> bool {
        let mut keys = self.meter_keys(cell);
        keys.retain(|key| self.pipelines.get(*key).is_none());
        let is_there = keys.is_empty();
        if !is_there {
            self.pipelines.prepare_later(&self.gpu, keys);
        }
        is_there
    }

    /// Makes what metering needs, where the scene asks for it.
    pub(super) fn prepare_meters(&mut self) -> Result<(), GpuError> {
        let wanted = self.scene.tone().auto_exposure().is_some();
        if wanted {
            let key = composite_key(
                &self.scene,
                FrameFilter::Bilinear,
                self.blend(),
                false,
                true,
            );
            let mut keys = vec![key, ground_key(key)];
            keys.extend(
                self.active_cells
                    .values()
                    .flat_map(|cell| self.meter_keys(cell)),
            );
            for key in keys {
                self.pipelines.prepare(&self.gpu, key)?;
            }
        }
        for cell in self.active_cells.values_mut() {
            match &mut cell.meter {
                Some(meter) if wanted => meter.due = true,
                meter => *meter = None,
            }
        }
        Ok(())
    }

    /// Takes what meters have read, lets exposures follow and meters skies that have changed. Returns the cells whose
    /// exposure has changed.
    pub(super) fn adapt_exposures(&mut self, now: Instant, seconds: f64) -> Vec<CellId> {
        let Some(limits) = self.scene.tone().auto_exposure() else {
            return Vec::new();
        };
        let windy = self.wind_speed_max_m_per_s() > 0.0;
        let metered = self
            .active_cells
            .iter()
            .filter(|(_, cell)| cell.stands_for.is_none());
        let ids: Vec<CellId> = metered.map(|(id, _)| *id).collect();
        let mut changed = Vec::new();
        for id in ids {
            let reads_cache = self
                .viewers
                .values()
                .any(|viewer| viewer.cell == id && viewer.fills_cache());
            let Some(mut cell) = self.active_cells.remove(&id) else {
                continue;
            };
            if cell.meter.is_none() {
                cell.meter = Meter::new(&self.gpu, &self.pipelines);
            }
            if let Some(mut meter) = cell.meter.take() {
                let before = meter.adaptation.ev();
                let found = meter.found.swap(NOTHING, Ordering::AcqRel);
                if found != NOTHING {
                    let found = f64::from(f32::from_bits(found));
                    meter.adaptation.read(found, &limits);
                }
                meter.adaptation.advance(seconds, &limits);
                if meter.adaptation.ev() != before {
                    changed.push(id);
                }
                let is_time = meter
                    .metered
                    .is_none_or(|last| now.duration_since(last) >= INTERVAL);
                let is_wanted = reads_cache && is_time && (meter.due || windy);
                if is_wanted && self.can_be_metered(&cell) {
                    self.meter(id, &mut cell, &mut meter);
                    meter.metered = Some(now);
                    meter.due = false;
                }
                cell.meter = Some(meter);
            }
            self.active_cells.insert(id, cell);
        }
        changed
    }

    /// Submits the metering of a cell's sky.
    fn meter(&mut self, id: CellId, cell: &mut ActiveCell, meter: &mut Meter) {
        let shafts = self.shaft_reader(id);
        let [x, y, z] = cell.reference_m.to_array();
        // What is seen from above all clouds is below.
        let sides = self.sides_at(y);
        let is_above_all = !sides.is_empty() && sides.iter().all(|side| *side == Side::Above);
        let pitch_deg = if is_above_all { -90.0 } else { 90.0 };
        let Ok(camera) = Camera::new([x, y, z], 0.0, pitch_deg, FOV_DEG) else {
            return;
        };
        let Some(buffer) = meter.ring.take(&self.gpu) else {
            return;
        };
        let (size, _) = meter.picture.eyes();
        let frustum = view_frustum(&camera, size, &cell.frame);
        let mut view = view_uniform(&frustum, &cell.frame, size);
        self.set_near(&mut view, cell);
        let tables = view.tables.iter_mut().take(self.proxies.len());
        for (layer, table) in tables.enumerate() {
            *table = cell.buffers.table(layer, 0);
        }
        let layers = match self.march_near(cell, meter, &view) {
            Some(marched) => {
                let (gpu, pipelines) = (&self.gpu, &self.pipelines);
                (cell.buffers).inside_group(gpu, pipelines, &self.atlas, marched.values())
            }
            None => cell
                .buffers
                .cached_group(&self.gpu, &self.pipelines, &self.atlas)
                .clone(),
        };
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("meter"),
            });
        let key = self.meter_key(cell);
        let air = self.air_views.group(
            &self.gpu,
            &self.pipelines,
            &mut encoder,
            f64::from(view.altitude_m),
            shafts.as_ref(),
        );
        self.timing.begin();
        meter.picture.record(
            &self.gpu,
            &mut encoder,
            &mut self.timing,
            &self.pipelines,
            &[CompositeInputs {
                key,
                scene: &cell.buffers.scene_group,
                air: air.as_ref(),
                layers: &layers,
                view: &view,
                ground_radius_m: None,
            }],
        );
        encoder.copy_buffer_to_buffer(meter.picture.pixels(), 0, &buffer, 0, buffer.size());
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
        let found = meter.found.clone();
        meter.ring.map(buffer, move |pixels| {
            use super::interface::FramePixels;
            let Some(pixels) = pixels else { return };
            let texels: Vec<f32> = bytemuck::pod_collect_to_vec(pixels.rgba());
            let mean = mean_log2(&texels) as f32;
            found.store(mean.to_bits(), Ordering::Release);
        });
    }

    /// Marches the near part of the layers that a cell's rays start in, one ray a pixel of the meter's picture. None where they
    /// start in none.
    fn march_near<'a>(
        &mut self,
        cell: &ActiveCell,
        meter: &'a mut Meter,
        view: &layout::View,
    ) -> Option<&'a MarchedPixels> {
        let parts = self.near_parts_of(cell);
        let (size, _) = meter.picture.eyes();
        let (gpu, pipelines) = (&self.gpu, &self.pipelines);
        if meter.near.as_ref().map_or(0, |(count, _)| *count) != parts.len() {
            let marched = || MarchedPixels::new(gpu, pipelines, size, parts.len(), None);
            meter.near = (!parts.is_empty()).then(|| (parts.len(), marched()));
        }
        let (_, marched) = meter.near.as_ref()?;
        for (place, (layer, features)) in (0..).zip(parts) {
            let view = layout::View {
                layer,
                place,
                sample_is_first: 1,
                sample_weight: 1.0,
                ..*view
            };
            let strip = PixelStrip {
                cell: &cell.buffers,
                features,
                view: &view,
                rows: size.height(),
            };
            marched.submit_strip(&self.gpu, &mut self.timing, &self.pipelines, &strip);
            self.watch_submission();
            self.counters.submissions += 1;
            self.counters.dispatches += 1;
        }
        Some(marched)
    }

    /// Meters every cell and waits for it: exposure of a single picture.
    pub(super) fn meter_now(&mut self) -> Result<(), GpuError> {
        if self.scene.tone().auto_exposure().is_none() {
            return Ok(());
        }
        self.prepare_meters()?;
        self.adapt_exposures(Instant::now(), 0.0);
        self.gpu.wait()?;
        self.adapt_exposures(Instant::now(), 0.0);
        self.refresh_cells();
        Ok(())
    }
}

impl ActiveCell {
    /// Exposure by the light of the sky, stops.
    pub(super) fn auto_exposure_ev(&self) -> f64 {
        match (&self.meter, self.stands_for) {
            (_, Some((_, exposure_ev))) => exposure_ev,
            (Some(meter), None) => meter.adaptation.ev(),
            (None, None) => 0.0,
        }
    }
}
