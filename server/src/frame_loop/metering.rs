//! Exposure by the light of the shared sky: a small picture of the whole sky above a cell's reference point is composited
//! from its cache, read back without waiting, and its mean logarithm of luminance sets what exposure goes towards.
//!
//! What a single viewer looks at does not matter, so nobody's turning changes anybody's picture, and a sky that rests has
//! one exposure: nothing is metered, nothing changes and no frame is sent.

use super::cells_on_device::ActiveCell;
use super::renderer::SkyRenderer;
use crate::composite::{
    CompositeInputs, Picture, composite_key, ground_key, view_frustum, view_uniform, with_above,
};
use crate::config::FrameFilter;
use crate::gpu::{Gpu, GpuError, PipelineKey, Pipelines, ReadbackRing};
use crate::march::{EXPOSURE_AT_ZERO_EV, Side};
use skycell_protocol::scene::AutoExposure;
use skycell_protocol::{Camera, CellId, FrameSize, RendererKind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Edge of the metered picture, pixels.
const EDGE: u32 = 24;
/// Its field of view: down to 20 degrees above the horizon in the middles of the edges, 11 in the corners.
const FOV_DEG: f64 = 140.0;
/// The sky is metered this often at most.
const INTERVAL: Duration = Duration::from_millis(250);
/// Geometric mean of exposed luminance that calls for no change. Tuned: the default scene has it.
const MIDDLE: f64 = 0.22;
/// Exposure does not follow a smaller change, stops: noise of the meter and a passing cloud do not move it.
const DEAD_BAND_EV: f64 = 0.15;
/// And ends when it is this close.
const ARRIVED_EV: f64 = 0.01;
/// Fastest change, stops per second: a fifth of a second for the sun going behind a cloud would be a flash.
const RATE_MAX_EV_PER_S: f64 = 2.0;
/// A meter has read nothing yet.
const NOTHING: u32 = u32::MAX;

/// Luminance of linear sRGB (IEC 61966-2-1).
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Where exposure is, where it goes, and how. Plain arithmetic.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Adaptation {
    /// Exposure that pictures have, stops; none before the first reading.
    present_ev: Option<f64>,
    target_ev: f64,
    moves: bool,
}

impl Adaptation {
    /// Exposure of pictures, stops.
    pub(super) fn ev(&self) -> f64 {
        self.present_ev.unwrap_or(0.0)
    }

    /// Takes a reading of the meter: mean of the logarithm to the base 2 of luminance at 0 EV. The first one counts at once.
    pub(super) fn read(&mut self, mean_log2: f64, limits: &AutoExposure) {
        if !mean_log2.is_finite() {
            return;
        }
        let wanted = (MIDDLE.log2() - mean_log2).clamp(limits.min_ev(), limits.max_ev());
        match self.present_ev {
            None => {
                self.present_ev = Some(wanted);
                self.target_ev = wanted;
            }
            Some(present) if self.moves || (wanted - present).abs() > DEAD_BAND_EV => {
                self.target_ev = wanted;
                self.moves = true;
            }
            Some(_) => {}
        }
    }

    /// Lets time pass; true when exposure has changed.
    pub(super) fn advance(&mut self, seconds: f64, limits: &AutoExposure) -> bool {
        let Some(present) = self.present_ev else {
            return false;
        };
        if !self.moves {
            return false;
        }
        let share = if limits.adaptation_s() > 0.0 {
            1.0 - (-seconds / limits.adaptation_s()).exp()
        } else {
            1.0
        };
        let most = if limits.adaptation_s() > 0.0 {
            RATE_MAX_EV_PER_S * seconds
        } else {
            f64::INFINITY
        };
        let step = ((self.target_ev - present) * share).clamp(-most, most);
        let mut next = present + step;
        if (self.target_ev - next).abs() <= ARRIVED_EV {
            next = self.target_ev;
            self.moves = false;
        }
        self.present_ev = Some(next);
        next != present
    }
}

/// A cell's meter on the device.
#[derive(Debug)]
pub(super) struct Meter {
    picture: Picture,
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
    /// The composite that meters: linear, of the cache, above some layer or not.
    fn meter_key(&self, above: bool) -> PipelineKey {
        let blend = self.blend();
        let key = composite_key(&self.scene, FrameFilter::Bilinear, blend, false, true);
        if above { with_above(key) } else { key }
    }

    /// Whether a cell can be metered; what it takes above layers is made when a cell is first there.
    fn can_be_metered(&mut self, cell: &ActiveCell) -> bool {
        let key = self.meter_key(self.looks_down(cell.reference_m.y));
        let is_there = self.pipelines.get(key).is_some();
        if !is_there {
            let keys = vec![key, ground_key(key)];
            self.pipelines.prepare_later(&self.gpu, keys);
        }
        is_there
    }

    /// Makes what metering needs, where the scene asks for it.
    pub(super) fn prepare_meters(&mut self) -> Result<(), GpuError> {
        let wanted = self.scene.tone().auto_exposure().is_some();
        if wanted {
            let some_above =
                (self.active_cells.values()).any(|cell| self.looks_down(cell.reference_m.y));
            for above in [Some(false), some_above.then_some(true)]
                .into_iter()
                .flatten()
            {
                let key = self.meter_key(above);
                self.pipelines.prepare(&self.gpu, key)?;
                self.pipelines.prepare(&self.gpu, ground_key(key))?;
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
                .any(|viewer| viewer.cell == id && viewer.kind == RendererKind::Cached);
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
                // In a layer most of what is seen is near, and not in the cache: eyes stay used to the light.
                let is_around = self.near_layers_of(&cell) != 0;
                let is_wanted = reads_cache && !is_around && is_time && (meter.due || windy);
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
        let tables = view.tables.iter_mut().take(self.proxies.len());
        for (layer, table) in tables.enumerate() {
            *table = cell.buffers.table(layer, 0);
        }
        let layers = cell
            .buffers
            .cached_group(&self.gpu, &self.pipelines, &self.atlas)
            .clone();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("meter"),
            });
        let key = self.meter_key(sides.contains(&Side::Above));
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use skycell_protocol::Scene;

    fn limits(min_ev: f64, max_ev: f64) -> AutoExposure {
        let document = json!({"version": 1, "tone": {"auto_exposure":
            {"min_ev": min_ev, "max_ev": max_ev, "adaptation_s": 1.0}}});
        let scene = Scene::from_json(&document).expect("valid");
        scene.tone().auto_exposure().expect("automatic")
    }

    fn log2_of(ev: f64) -> f64 {
        MIDDLE.log2() - ev
    }

    #[test]
    fn a_step_in_brightness_is_followed_without_overshoot_within_the_rate_and_then_rests() {
        let limits = limits(-4.0, 8.0);
        let mut adaptation = Adaptation::default();
        adaptation.read(log2_of(0.0), &limits);
        assert_eq!(adaptation.ev(), 0.0);
        let (mut last, mut frames) = (0.0, 0);
        loop {
            adaptation.read(log2_of(3.0), &limits);
            if !adaptation.advance(0.05, &limits) {
                break;
            }
            let ev = adaptation.ev();
            assert!(ev > last && ev <= 3.0 && ev - last <= RATE_MAX_EV_PER_S * 0.05 + 1e-12);
            (last, frames) = (ev, frames + 1);
            assert!(frames < 1000, "it never rests");
        }
        assert!((last - 3.0).abs() <= ARRIVED_EV, "{last}");
        // Rest: the same reading, and the noise of a meter, change nothing ever after.
        for noise in [0.0, 0.1, -0.1, 0.14] {
            adaptation.read(log2_of(3.0 + noise), &limits);
            assert!(!adaptation.advance(0.05, &limits));
        }
    }

    #[test]
    fn exposure_stays_within_its_bounds_whatever_is_read() {
        let limits = limits(-1.0, 2.0);
        let mut adaptation = Adaptation::default();
        for reading in [
            f64::NEG_INFINITY,
            -200.0,
            200.0,
            f64::NAN,
            0.0,
            f64::INFINITY,
            -50.0,
        ] {
            adaptation.read(reading, &limits);
            for _ in 0..200 {
                adaptation.advance(0.1, &limits);
                assert!((-1.0..=2.0).contains(&adaptation.ev()), "{reading}");
            }
        }
    }

    #[test]
    fn the_mean_is_geometric_and_weighs_solid_angles() {
        let even = [0.2f32, 0.2, 0.2, 1.0].repeat((EDGE * EDGE) as usize);
        let exact = (0.2 * EXPOSURE_AT_ZERO_EV).log2();
        assert!((mean_log2(&even) - exact).abs() < 1e-6);
        // Half of the sky sixteen times as bright: half of four stops.
        let halves: Vec<f32> = (0..EDGE * EDGE)
            .flat_map(|i| {
                let value = if i % EDGE < EDGE / 2 { 0.05 } else { 0.8 };
                [value, value, value, 1.0]
            })
            .collect();
        assert!((mean_log2(&halves) - exact).abs() < 1e-6);
    }
}
