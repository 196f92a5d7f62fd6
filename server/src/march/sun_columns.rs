//! The pass that fills columns of the sun volume, and a volume on the device.

use super::texels::write;
use crate::gpu::{Gpu, PipelineKey, Pipelines, TimedPass, TimingRing};
use crate::sun_volume::{Generation, Strip, strip_work};
use skycell_shaders::{Features, Kernel, layout};

/// Texels of a workgroup's side, as in `march/sun_columns.wgsl`.
const GROUP: u32 = 8;

/// What the pass is specialised to for a layer.
#[must_use]
pub fn sun_columns_key(layer: Features) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::SunColumns,
        features: Features {
            octave_vectors: 1,
            layers: 1,
            catmull_rom: false,
            sun_layers: 0,
            ..layer
        },
    }
}

/// The volume of a place's layers on the device.
#[derive(Debug)]
pub struct SunVolumeTexture {
    texture: wgpu::Texture,
    sampler: wgpu::Sampler,
    /// The scene in the frame in which each layer's columns are made.
    scenes: Vec<wgpu::BindGroup>,
}

impl SunVolumeTexture {
    /// Room for a volume. `scenes` are the scene in the frames of [`Generation::origin_m`], where no wind has blown.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        pipelines: &Pipelines,
        volume: &Generation,
        scenes: &[layout::Scene],
    ) -> Self {
        let size = volume.size();
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("sun volume"),
            size: wgpu::Extent3d {
                width: size.columns,
                height: size.columns,
                depth_or_array_layers: size.depth(volume.layers()).max(1),
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D3,
            format: wgpu::TextureFormat::R32Float,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::STORAGE_BINDING,
            view_formats: &[],
        });
        let scenes = scenes
            .iter()
            .map(|scene| {
                let buffer = gpu.uniform_buffer("sun columns' scene", size_of_val(scene));
                write(gpu, &buffer, scene);
                gpu.buffer_group("sun volume", &pipelines.scene_layout, &[&buffer])
            })
            .collect();
        Self {
            texture,
            sampler: gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("sun volume"),
                // Columns stand on a torus.
                address_mode_u: wgpu::AddressMode::Repeat,
                address_mode_v: wgpu::AddressMode::Repeat,
                address_mode_w: wgpu::AddressMode::ClampToEdge,
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
            scenes,
        }
    }

    /// Bytes on the device.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let size = self.texture.size();
        4 * u64::from(size.width) * u64::from(size.height) * u64::from(size.depth_or_array_layers)
    }

    /// The texture as it is read and written.
    #[must_use]
    pub fn view(&self) -> wgpu::TextureView {
        self.texture
            .create_view(&wgpu::TextureViewDescriptor::default())
    }

    /// How it is read.
    #[must_use]
    pub fn sampler(&self) -> &wgpu::Sampler {
        &self.sampler
    }

    /// Records strips; `features` has what each layer's pipeline is specialised to. Returns how many dispatches it takes.
    #[allow(clippy::too_many_arguments)]
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        field: &wgpu::BindGroup,
        volume: &Generation,
        strips: &[Strip],
        features: &[Features],
    ) -> u64 {
        let view = self.view();
        let groups: Vec<_> = strips
            .iter()
            .map(|strip| {
                let work = strip_work(volume, strip);
                let buffer = gpu.uniform_buffer("sun columns", size_of_val(&work));
                write(gpu, &buffer, &work);
                let resources = [
                    buffer.as_entire_binding(),
                    wgpu::BindingResource::TextureView(&view),
                    pipelines.read_counter.as_entire_binding(),
                ];
                let group = gpu.bind_group("sun volume", &pipelines.sun_columns_layout, &resources);
                (strip, work, group)
            })
            .collect();
        let columns: u64 = strips.iter().map(|strip| strip.columns.count()).sum();
        let mut dispatches = 0;
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("sun columns"),
            timestamp_writes: timing.pass(TimedPass::SunVolume, columns),
        });
        for (strip, work, group) in &groups {
            let (Some(scene), Some(features)) =
                (self.scenes.get(strip.layer), features.get(strip.layer))
            else {
                continue;
            };
            let Some(pipeline) = pipelines.get(sun_columns_key(*features)) else {
                continue;
            };
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, scene, &[]);
            pass.set_bind_group(1, field, &[]);
            pass.set_bind_group(2, group, &[]);
            pass.set_bind_group(3, &pipelines.empty_group, &[]);
            let [x, z] = work.columns.map(|n| n.div_ceil(GROUP));
            pass.dispatch_workgroups(x, z, 1);
            dispatches += 1;
        }
        dispatches
    }
}

/// A sun volume as one cell reads it: group 0 of the marching kernels, with the scene.
#[derive(Debug)]
pub struct SunBinding {
    uniform: wgpu::Buffer,
    seen: layout::SunVolume,
    view: wgpu::TextureView,
    sampler: wgpu::Sampler,
    /// Group 0.
    pub group: wgpu::BindGroup,
    /// Which texture it reads.
    pub texture: u64,
    /// Layers whose volumes are read.
    pub layers: u32,
}

impl SunBinding {
    /// Binds a volume beside a cell's scene. `texture` tells textures apart.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        pipelines: &Pipelines,
        scene: &wgpu::Buffer,
        volume: &SunVolumeTexture,
        texture: u64,
        layers: u32,
    ) -> Self {
        let seen = layout::SunVolume::default();
        let uniform = gpu.uniform_buffer("sun volume", size_of_val(&seen));
        write(gpu, &uniform, &seen);
        let (view, sampler) = (volume.view(), volume.sampler().clone());
        Self {
            group: sun_scene_group(gpu, pipelines, scene, &view, &sampler, &uniform),
            uniform,
            seen,
            view,
            sampler,
            texture,
            layers,
        }
    }

    /// Group 0 with another scene, and with the volume as it is seen otherwise.
    #[must_use]
    pub fn group_of(
        &self,
        gpu: &Gpu,
        pipelines: &Pipelines,
        scene: &wgpu::Buffer,
        uniform: &wgpu::Buffer,
    ) -> wgpu::BindGroup {
        sun_scene_group(gpu, pipelines, scene, &self.view, &self.sampler, uniform)
    }

    /// What the cell sees of the volume.
    #[must_use]
    pub fn seen(&self) -> &layout::SunVolume {
        &self.seen
    }

    /// Writes what the cell sees of it, when that differs from what is there.
    pub fn set(&mut self, gpu: &Gpu, seen: &layout::SunVolume) {
        if self.seen != *seen {
            write(gpu, &self.uniform, seen);
            self.seen = *seen;
        }
    }
}

/// The volume as seen by rays of one layer that march to the sun themselves: only what other layers hold is read.
#[must_use]
pub fn without_own(seen: &layout::SunVolume, layer: u32) -> layout::SunVolume {
    let mut others = *seen;
    if let Some(own) = others.layers.get_mut(layer as usize) {
        for level in &mut own.levels {
            // Knows no foot.
            (level.feet_min_m, level.feet_max_m) = ([1.0; 2], [-1.0; 2]);
        }
    }
    others
}

fn sun_scene_group(
    gpu: &Gpu,
    pipelines: &Pipelines,
    scene: &wgpu::Buffer,
    view: &wgpu::TextureView,
    sampler: &wgpu::Sampler,
    uniform: &wgpu::Buffer,
) -> wgpu::BindGroup {
    let resources = [
        scene.as_entire_binding(),
        wgpu::BindingResource::TextureView(view),
        wgpu::BindingResource::Sampler(sampler),
        uniform.as_entire_binding(),
    ];
    gpu.bind_group("sun volume", &pipelines.sun_scene_layout, &resources)
}
