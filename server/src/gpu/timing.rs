//! GPU time of passes by timestamps, read back without waiting.

use super::Gpu;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// What a timed pass did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimedPass {
    /// Updated cache texels.
    Cache,
    /// Filled tiles from others.
    Resample,
    /// Marched texels again to see how wrong the cache is.
    Audit,
    /// Made columns of the sun volume.
    SunVolume,
    /// Made shadows of clouds in the air, and the table of light shafts.
    LightShafts,
    /// Composited a picture.
    Composite,
    /// Mixed the pictures of two view cells.
    Fade,
    /// Made a picture of a quantity of the cloud field.
    Inspection,
    /// Marched pixels of the screen-space renderer.
    ScreenSpace,
}

impl TimedPass {
    /// Every kind.
    pub const ALL: [Self; 9] = [
        Self::Cache,
        Self::Resample,
        Self::Audit,
        Self::SunVolume,
        Self::LightShafts,
        Self::Composite,
        Self::Fade,
        Self::Inspection,
        Self::ScreenSpace,
    ];

    /// As figures call it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cache => "cache",
            Self::Resample => "resample",
            Self::Audit => "audit",
            Self::SunVolume => "sun-volume",
            Self::LightShafts => "light-shafts",
            Self::Composite => "composite",
            Self::Fade => "fade",
            Self::Inspection => "inspection",
            Self::ScreenSpace => "screen-space",
        }
    }
}

/// Passes that one submission can time.
const PASSES_MAX: u32 = 64;
/// Submissions that can be under way; a further one goes untimed.
const SLOTS: usize = 8;

#[derive(Debug)]
struct Slot {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    readable: wgpu::Buffer,
    busy: Arc<AtomicBool>,
    passes: Vec<(TimedPass, u64)>,
    watched: Vec<(Range<usize>, DeviceTime)>,
}

/// Device time of some passes of a submission, known once the device has finished them.
#[derive(Clone, Debug, Default)]
pub struct DeviceTime(Arc<AtomicU64>);

impl DeviceTime {
    /// Nanoseconds; 0 as long as nothing is known, and for good where the device tells no times.
    #[must_use]
    pub fn ns(&self) -> u64 {
        self.0.load(Ordering::Acquire)
    }
}

/// Sums of GPU time, filled as submissions finish.
#[derive(Debug, Default)]
struct Sums {
    cache: Sum,
    resample: Sum,
    audit: Sum,
    sun_volume: Sum,
    light_shafts: Sum,
    composite: Sum,
    fade: Sum,
    inspection: Sum,
    screen_space: Sum,
}

#[derive(Debug, Default)]
struct Sum {
    passes: AtomicU64,
    ns: AtomicU64,
    units: AtomicU64,
}

/// Sums of a ring.
#[derive(Debug)]
pub struct TimingSums(Arc<Sums>);

/// Timestamps for a handful of submissions under way. Without device timestamps it times nothing.
#[derive(Debug)]
pub struct TimingRing {
    slots: Vec<Slot>,
    current: Option<usize>,
    sums: Arc<Sums>,
    period_ns: f64,
}

impl TimingRing {
    /// A ring; empty when the device has no timestamps.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        let bytes = u64::from(2 * PASSES_MAX) * 8;
        let buffer = |usage| gpu.buffer("timestamps", bytes, usage);
        let slots = if gpu.timestamps { SLOTS } else { 0 };
        Self {
            slots: (0..slots)
                .map(|_| Slot {
                    queries: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                        label: Some("timestamps"),
                        ty: wgpu::QueryType::Timestamp,
                        count: 2 * PASSES_MAX,
                    }),
                    resolved: buffer(
                        wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                    ),
                    readable: buffer(wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
                    busy: Arc::default(),
                    passes: Vec::new(),
                    watched: Vec::new(),
                })
                .collect(),
            current: None,
            sums: Arc::default(),
            period_ns: f64::from(gpu.queue.get_timestamp_period()),
        }
    }

    /// Goes on with the sums of another ring, whose device is gone.
    pub fn continue_sums(&mut self, sums: TimingSums) {
        self.sums = sums.0;
    }

    /// The sums so far, to go on with on another device.
    #[must_use]
    pub fn sums(&self) -> TimingSums {
        TimingSums(Arc::clone(&self.sums))
    }

    /// Submits one pass by itself, timed as `what` over `units` of work.
    pub fn submit_pass(
        &mut self,
        gpu: &Gpu,
        label: &str,
        what: TimedPass,
        units: u64,
        record: impl FnOnce(&mut wgpu::ComputePass<'_>),
    ) {
        self.begin();
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) });
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(label),
            timestamp_writes: self.pass(what, units),
        });
        record(&mut pass);
        drop(pass);
        self.resolve(&mut encoder);
        gpu.queue.submit([encoder.finish()]);
        self.submitted();
    }

    /// Starts a submission.
    pub fn begin(&mut self) {
        self.current = self
            .slots
            .iter()
            .position(|slot| !slot.busy.load(Ordering::Acquire));
        if let Some(index) = self.current {
            self.slots[index].passes.clear();
            self.slots[index].watched.clear();
        }
    }

    /// Timestamps for the next pass of the submission, when there is room; `units` of work (tiles, pixels) are counted
    /// with its time.
    pub fn pass(
        &mut self,
        what: TimedPass,
        units: u64,
    ) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        self.sums.of(what).passes.fetch_add(1, Ordering::Relaxed);
        let slot = &mut self.slots[self.current?];
        let index = slot.passes.len() as u32;
        if index == PASSES_MAX {
            return None;
        }
        slot.passes.push((what, units));
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &slot.queries,
            beginning_of_pass_write_index: Some(2 * index),
            end_of_pass_write_index: Some(2 * index + 1),
        })
    }

    /// How many passes of the submission are timed so far.
    #[must_use]
    pub fn recorded(&self) -> usize {
        let slot = self.current.and_then(|index| self.slots.get(index));
        slot.map_or(0, |slot| slot.passes.len())
    }

    /// The time of all passes since [`Self::recorded`] was `first`. Known before any buffer is mapped that was asked for
    /// after [`Self::submitted`].
    pub fn watch_since(&mut self, first: usize) -> DeviceTime {
        let time = DeviceTime::default();
        if let Some(slot) = self.current.and_then(|index| self.slots.get_mut(index)) {
            slot.watched.push((first..slot.passes.len(), time.clone()));
        }
        time
    }

    /// Ends the recording: call before the encoder is finished.
    pub fn resolve(&mut self, encoder: &mut wgpu::CommandEncoder) {
        let Some(slot) = self.current.map(|index| &self.slots[index]) else {
            return;
        };
        let count = 2 * slot.passes.len() as u32;
        if count == 0 {
            self.current = None;
            return;
        }
        encoder.resolve_query_set(&slot.queries, 0..count, &slot.resolved, 0);
        encoder.copy_buffer_to_buffer(&slot.resolved, 0, &slot.readable, 0, u64::from(count) * 8);
    }

    /// Asks for the figures: call after the submission.
    pub fn submitted(&mut self) {
        let Some(index) = self.current.take() else {
            return;
        };
        let slot = &mut self.slots[index];
        let watched = std::mem::take(&mut slot.watched);
        slot.busy.store(true, Ordering::Release);
        let (busy, sums, period_ns) = (slot.busy.clone(), self.sums.clone(), self.period_ns);
        let (buffer, passes) = (slot.readable.clone(), slot.passes.clone());
        slot.readable
            .map_async(wgpu::MapMode::Read, .., move |result| {
                if result.is_ok() {
                    if let Ok(view) = buffer.get_mapped_range(..) {
                        let ticks: Vec<u64> = view
                            .chunks_exact(8)
                            .map(|b| u64::from_le_bytes(std::array::from_fn(|i| b[i])))
                            .collect();
                        let times_ns: Vec<u64> = ticks
                            .chunks_exact(2)
                            .map(|pair| (pair[1].saturating_sub(pair[0]) as f64 * period_ns) as u64)
                            .collect();
                        for ((pass, units), ns) in passes.iter().zip(&times_ns) {
                            let sum = sums.of(*pass);
                            sum.ns.fetch_add(*ns, Ordering::Relaxed);
                            sum.units.fetch_add(*units, Ordering::Relaxed);
                        }
                        for (range, time) in watched {
                            let ns = times_ns.get(range).map_or(0, |times| times.iter().sum());
                            time.0.store(ns, Ordering::Release);
                        }
                    }
                    buffer.unmap();
                }
                busy.store(false, Ordering::Release);
            });
    }

    /// GPU time of a kind of pass since the start, ns, and the units of work that were done in it.
    #[must_use]
    pub fn total(&self, pass: TimedPass) -> (u64, u64) {
        let sum = self.sums.of(pass);
        (
            sum.ns.load(Ordering::Relaxed),
            sum.units.load(Ordering::Relaxed),
        )
    }
}

impl TimingRing {
    /// How many passes of a kind were recorded since the start, timed or not.
    #[must_use]
    pub fn passes(&self, pass: TimedPass) -> u64 {
        self.sums.of(pass).passes.load(Ordering::Relaxed)
    }
}

impl Sums {
    fn of(&self, pass: TimedPass) -> &Sum {
        match pass {
            TimedPass::Cache => &self.cache,
            TimedPass::Resample => &self.resample,
            TimedPass::Audit => &self.audit,
            TimedPass::SunVolume => &self.sun_volume,
            TimedPass::LightShafts => &self.light_shafts,
            TimedPass::Composite => &self.composite,
            TimedPass::Fade => &self.fade,
            TimedPass::Inspection => &self.inspection,
            TimedPass::ScreenSpace => &self.screen_space,
        }
    }
}
