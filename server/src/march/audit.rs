//! The pass that marches texels again: finer, and beside what the cache holds.

use super::atlas::Atlas;
use super::cell_buffers::CellBuffers;
use super::proxies::PROXIES_MAX;
use super::sun_columns::without_own;
use super::texels::write;
use crate::frame_loop::interface::FramePixels;
use crate::gpu::{Gpu, PipelineKey, Pipelines, ReadbackRing, TimedPass, TimingRing};
use skycell_shaders::layout::{self, AuditSample, AuditWork};
use skycell_shaders::{Features, Kernel};

/// Most texels of one pass.
pub const AUDIT_TEXELS_MAX: usize = 256;
/// Places of a texel that are marched, as in `march/audit.wgsl`.
pub const AUDIT_PLACES: usize = 8;
/// Texels of a workgroup.
const GROUP_TEXELS: usize = 8;
/// How many times the cache's steps an audit takes, up to [`STEPS_MAX`].
const STEPS_FACTOR: f32 = 4.0;
/// Beyond this many steps through a layer's thickness rays at the horizon would run into the march's own limit.
const STEPS_MAX: f32 = 1024.0;
/// Passes that may be on their way back.
const READBACKS: usize = 2;

/// What the pass is specialised to for a layer.
#[must_use]
pub fn audit_key(layer: Features) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::AuditTexels,
        features: Features {
            layers: 1,
            catmull_rom: false,
            linear_output: false,
            screen_space: false,
            above: true,
            inside: true,
            count_reads: false,
            ..layer
        },
    }
}

/// The scene of a cell with finer steps, through the layers and towards the sun (`sun_steps`, when those are more).
#[must_use]
pub fn finer(scene: &layout::Scene, sun_steps: u32) -> layout::Scene {
    let mut finer = *scene;
    finer.light.sun_steps = finer.light.sun_steps.max(sun_steps);
    for layer in &mut finer.layers {
        let thickness_m = layer.top_altitude_m - layer.base_altitude_m;
        let steps = thickness_m / layer.step_min_m.max(1e-6);
        let factor = (STEPS_MAX / steps.max(1.0)).clamp(1.0, STEPS_FACTOR);
        layer.step_min_m /= factor;
        layer.step_per_distance /= factor;
        layer.steps_max = (layer.steps_max as f32 * factor) as u32;
    }
    finer
}

/// Texels of one layer of one cell that are to be audited.
pub struct AuditGroup<'a> {
    /// The cell on the device.
    pub cell: &'a CellBuffers,
    /// What the layer's pipeline is specialised to.
    pub features: Features,
    /// The cell's scene with finer steps.
    pub scene: &'a layout::Scene,
    /// The texels, [`AUDIT_TEXELS_MAX`] at most; further ones are left out.
    pub work: &'a [AuditWork],
}

/// The buffers of one audit at a time.
#[derive(Debug)]
pub struct AuditMarch {
    scene: wgpu::Buffer,
    scene_group: wgpu::BindGroup,
    /// Made where a cell reads a sun volume.
    sun_volume: Option<wgpu::Buffer>,
    work: wgpu::Buffer,
    samples: wgpu::Buffer,
    ring: ReadbackRing,
}

impl AuditMarch {
    /// Makes the buffers.
    #[must_use]
    pub fn new(gpu: &Gpu, pipelines: &Pipelines) -> Self {
        let buffer = |label, bytes: usize, usage| gpu.buffer(label, bytes as u64, usage);
        let scene = gpu.uniform_buffer("audit scene", size_of::<layout::Scene>());
        let samples_bytes = AUDIT_TEXELS_MAX * AUDIT_PLACES * size_of::<AuditSample>();
        Self {
            scene_group: gpu.buffer_group("audit scene", &pipelines.scene_layout, &[&scene]),
            scene,
            sun_volume: None,
            work: buffer(
                "audit work",
                AUDIT_TEXELS_MAX * size_of::<AuditWork>(),
                wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            ),
            samples: buffer(
                "audit samples",
                samples_bytes,
                wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
            ),
            ring: ReadbackRing::new(samples_bytes as u64, READBACKS),
        }
    }

    /// Records the audit of some texels; returns the buffer that they come back in, to be given to [`Self::read`] after
    /// the submission. None while all are under way or when the pipeline is not there.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        atlas: &Atlas,
        group: &AuditGroup<'_>,
    ) -> Option<wgpu::Buffer> {
        let work = &group.work[..group.work.len().min(AUDIT_TEXELS_MAX)];
        let pipeline = pipelines.get(audit_key(group.features))?;
        if work.is_empty() {
            return None;
        }
        let target = self.ring.take(gpu)?;
        write(gpu, &self.scene, group.scene);
        gpu.queue
            .write_buffer(&self.work, 0, bytemuck::cast_slice(work));
        let [radiance, distance] = atlas.views();
        let resources = [
            wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                buffer: &self.work,
                offset: 0,
                size: std::num::NonZeroU64::new(size_of_val(work) as u64),
            }),
            group.cell.reference.as_entire_binding(),
            wgpu::BindingResource::TextureView(&radiance),
            wgpu::BindingResource::TextureView(&distance),
            self.samples.as_entire_binding(),
        ];
        let bind_group = gpu.bind_group("audit", &pipelines.audit_layout, &resources);
        // Of its own layer an audited ray reads no volume: what is in there is audited too.
        let sun_group = group
            .cell
            .sun
            .as_ref()
            .filter(|_| group.features.sun_layers > 0)
            .map(|sun| {
                let own = group.scene.proxies[work[0].proxy as usize % PROXIES_MAX].layer;
                let others = without_own(sun.seen(), own);
                let uniform = self.sun_volume.get_or_insert_with(|| {
                    gpu.uniform_buffer("audit sun volume", size_of_val(&others))
                });
                write(gpu, uniform, &others);
                sun.group_of(gpu, pipelines, &self.scene, uniform)
            });
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("audit texels"),
            timestamp_writes: timing.pass(TimedPass::Audit, work.len() as u64),
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, sun_group.as_ref().unwrap_or(&self.scene_group), &[]);
        pass.set_bind_group(1, group.cell.field_group(), &[]);
        pass.set_bind_group(2, &bind_group, &[]);
        pass.set_bind_group(3, &pipelines.empty_group, &[]);
        pass.dispatch_workgroups(1, work.len().div_ceil(GROUP_TEXELS) as u32, 1);
        drop(pass);
        encoder.copy_buffer_to_buffer(&self.samples, 0, &target, 0, target.size());
        Some(target)
    }

    /// Asks for the samples of `texels` texels, [`AUDIT_PLACES`] each; `done` gets them when the device is polled after
    /// it has written them, or nothing when it is lost.
    pub fn read(
        &self,
        target: wgpu::Buffer,
        texels: usize,
        done: impl FnOnce(Vec<AuditSample>) + Send + 'static,
    ) {
        let bytes = texels.min(AUDIT_TEXELS_MAX) * AUDIT_PLACES * size_of::<AuditSample>();
        self.ring.map(target, move |mapped| {
            let samples = mapped
                .as_ref()
                .and_then(|mapped| mapped.rgba().get(..bytes))
                .map(bytemuck::pod_collect_to_vec)
                .unwrap_or_default();
            done(samples);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_audit_takes_four_times_the_steps_up_to_a_limit() {
        let steps_of = |steps: f32| {
            let mut scene = layout::Scene::default();
            scene.layers[0].top_altitude_m = 2500.0;
            scene.layers[0].step_min_m = 2500.0 / steps;
            scene.layers[0].steps_max = 4 * steps as u32;
            let layer = finer(&scene, 6).layers[0];
            ((2500.0 / layer.step_min_m).round(), layer.steps_max)
        };
        assert_eq!(steps_of(64.0), (256.0, 1024));
        assert_eq!(steps_of(512.0), (1024.0, 4096));
        assert_eq!(steps_of(4096.0), (4096.0, 16384));
    }
}
