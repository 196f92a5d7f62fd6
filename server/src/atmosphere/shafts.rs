//! Light shafts on the device: around a place the shadow that clouds throw into the air, and of the air's light along a ray
//! the share that it leaves. Both are made in strips of half-planes about the line towards the sun, the second beside the
//! one that is read.

use crate::gpu::{
    Gpu, GpuError, PipelineKey, Pipelines, TimedPass, TimingRing, read_buffer_blocking,
};
use glam::DVec3;
use half::f16;
use skycell_protocol::scene::ranges::LAYERS_MAX;
use skycell_shaders::{Features, Kernel, layout};

/// Size of the table of shares, as in `sky/shafts.wgsl`: half-planes, angles from the sun, distances.
const SHARE_SIZE: [u32; 3] = [384, 128, 24];
/// Size of a layer's shadow: half-planes, sunbeams, altitudes.
const SHADOW_SIZE: [u32; 3] = [384, 256, 16];
/// Steps of a direction, as in `sky/light_shafts.wgsl`.
const SHARE_STEPS: u32 = 6 * SHARE_SIZE[2];
/// Samples of density along a sunbeam stand no farther apart than this, m, as far as their number allows. Tuned:
/// `light_shafts::shares_are_those_of_the_f64_integral`.
const SHADOW_STEP_M: f64 = 50.0;
/// Most samples between two altitudes.
const SUBSTEPS_MAX: u32 = 12;
/// Distance by which half of the slices are used up, m, for eyes near the ground. Those far above look that far at least.
const DISTANCE_SCALE_M: f64 = 8_000.0;
/// Half-planes along a workgroup's side.
const GROUP: u32 = 8;

/// A layer that throws shadow.
#[derive(Clone, Copy, Debug)]
pub struct ShaftLayer {
    /// Base, m above the ground.
    pub base_altitude_m: f64,
    /// Top, m above the ground.
    pub top_altitude_m: f64,
    /// What its pass is specialised to.
    pub features: Features,
}

/// Around which place, and under which light, a table is made.
#[derive(Clone, Debug)]
pub struct ShaftInputs {
    /// Unit vector towards the sun.
    pub sun: DVec3,
    /// The place in the cell's frame, m.
    pub origin: DVec3,
    /// Its altitude, m.
    pub altitude_m: f64,
    /// The zenith there.
    pub zenith: DVec3,
    /// Altitude above which there is no air, m.
    pub air_top_m: f64,
    /// The shown layers.
    pub layers: Vec<ShaftLayer>,
}

impl ShaftInputs {
    fn frame(&self) -> layout::ShaftFrame {
        let f32s = |v: DVec3| v.as_vec3().to_array();
        let right = self.sun.any_orthonormal_vector();
        layout::ShaftFrame {
            sun: f32s(self.sun),
            altitude_m: self.altitude_m as f32,
            right: f32s(right),
            distance_scale_m: self.altitude_m.min(self.air_top_m).max(DISTANCE_SCALE_M) as f32,
            up: f32s(self.sun.cross(right)),
            is_known: 1.0,
            origin: f32s(self.origin),
            pad_origin: 0.0,
        }
    }

    /// What it is made with.
    pub fn pipelines(&self) -> impl Iterator<Item = PipelineKey> {
        let shadows = self
            .layers
            .iter()
            .map(|layer| cloud_shadows_key(layer.features));
        shadows.chain([make_shafts_key()])
    }

    /// Samples between two altitudes of a layer's shadow: a low sun's light has a longer way.
    fn substeps(&self, layer: &ShaftLayer) -> u32 {
        let slice_m =
            (layer.top_altitude_m - layer.base_altitude_m) / f64::from(SHADOW_SIZE[2] - 1);
        let along_m = slice_m / self.sun.dot(self.zenith).abs().max(1e-3);
        (along_m / SHADOW_STEP_M)
            .ceil()
            .clamp(1.0, f64::from(SUBSTEPS_MAX)) as u32
    }
}

/// The pipeline that makes a layer's shadow.
#[must_use]
pub fn cloud_shadows_key(layer: Features) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::CloudShadows,
        features: Features {
            octave_vectors: 1,
            layers: 1,
            catmull_rom: false,
            sun_layers: 0,
            ..layer
        },
    }
}

/// The pipeline that makes the table of shares.
#[must_use]
pub fn make_shafts_key() -> PipelineKey {
    PipelineKey {
        kernel: Kernel::MakeLightShafts,
        features: Features::default(),
    }
}

/// What a composite reads of a table.
#[derive(Clone, Debug)]
pub struct ShaftReader {
    frame: wgpu::Buffer,
    shares: wgpu::TextureView,
    sampler: wgpu::Sampler,
}

impl ShaftReader {
    /// In the order of the bindings.
    #[must_use]
    pub fn resources(&self) -> [wgpu::BindingResource<'_>; 3] {
        use wgpu::BindingResource::{Sampler, TextureView};
        [
            self.frame.as_entire_binding(),
            TextureView(&self.shares),
            Sampler(&self.sampler),
        ]
    }
}

/// Stands where no shadow is known yet: air that is lit everywhere.
#[must_use]
pub fn blank_shafts(gpu: &Gpu) -> ShaftReader {
    ShaftReader {
        // A frame of zeros says that nothing is known.
        frame: gpu.uniform_buffer("light shafts", size_of::<layout::ShaftFrame>()),
        shares: shares_texture(gpu, [1; 3]).create_view(&wgpu::TextureViewDescriptor::default()),
        sampler: sampler(gpu),
    }
}

fn sampler(gpu: &Gpu) -> wgpu::Sampler {
    gpu.device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("light shafts"),
        // Half-planes stand on a circle.
        address_mode_u: wgpu::AddressMode::Repeat,
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        ..Default::default()
    })
}

fn texture(
    gpu: &Gpu,
    label: &str,
    [width, height, depth_or_array_layers]: [u32; 3],
    format: wgpu::TextureFormat,
) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D3,
        format,
        usage: wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::STORAGE_BINDING
            | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}

/// Shares lie in 0…1, where half floats are right to 1/4000.
fn shares_texture(gpu: &Gpu, size: [u32; 3]) -> wgpu::Texture {
    texture(gpu, "light shafts", size, wgpu::TextureFormat::Rgba16Float)
}

#[derive(Debug)]
struct Table {
    texture: wgpu::Texture,
    /// Of what it is.
    made: layout::ShaftFrame,
    reader: ShaftReader,
}

/// How far a table is that is being made.
#[derive(Clone, Debug)]
struct Build {
    inputs: ShaftInputs,
    frame: layout::ShaftFrame,
    /// Whose shadow comes next; as many as there are layers: shares come next.
    layer: usize,
    azimuth: u32,
}

/// What a strip reads beside what the shafts hold themselves.
pub struct ShaftsRead<'a> {
    /// The scene in the cell's frame.
    pub scene: &'a wgpu::BindGroup,
    /// The cloud field.
    pub field: &'a wgpu::BindGroup,
    /// The air's tables, with [`LightShafts::air`] filled.
    pub air: &'a wgpu::BindGroup,
}

/// A table of shares on the processor.
#[derive(Clone, Debug)]
pub struct ShaftShares {
    frame: layout::ShaftFrame,
    /// Half-plane by half-plane, then by angle, then by distance.
    shares: Vec<[f32; 3]>,
}

impl ShaftShares {
    /// All of them: red, green and blue.
    #[must_use]
    pub fn all(&self) -> &[[f32; 3]] {
        &self.shares
    }

    /// What is left of the light of the air along a direction of the cell's frame as far as a distance, interpolated as the
    /// composite does; with a distance without end, of all the air.
    #[must_use]
    pub fn at(&self, direction: DVec3, distance_m: f64) -> DVec3 {
        let v = |v: [f32; 3]| glam::Vec3::from_array(v).as_dvec3();
        let (sun, right, up) = (v(self.frame.sun), v(self.frame.right), v(self.frame.up));
        let turn = direction.dot(up).atan2(direction.dot(right)) / std::f64::consts::TAU;
        let angle = direction.cross(sun).length().atan2(direction.dot(sun));
        let scale_m = f64::from(self.frame.distance_scale_m);
        let slice = if distance_m.is_finite() {
            distance_m / (distance_m + scale_m)
        } else {
            1.0
        };
        let [azimuths, angles, slices] = SHARE_SIZE.map(|n| n as usize);
        let azimuth = (turn * azimuths as f64).rem_euclid(azimuths as f64);
        let angle = angle / std::f64::consts::PI * (angles - 1) as f64;
        let slice = slice * (slices - 1) as f64;
        let mut sum = DVec3::ZERO;
        for corner in 0..8usize {
            let part = |at: f64, bit: usize| {
                let upper = corner >> bit & 1 == 1;
                let share = at - at.floor();
                (
                    at.floor() as usize + usize::from(upper),
                    if upper { share } else { 1.0 - share },
                )
            };
            let [(i, a), (j, b), (k, c)] = [part(azimuth, 0), part(angle, 1), part(slice, 2)];
            let (i, j, k) = (i % azimuths, j.min(angles - 1), k.min(slices - 1));
            sum += a * b * c * v(self.shares[(k * angles + j) * azimuths + i]);
        }
        sum
    }
}

/// The light shafts around a place.
#[derive(Debug)]
pub struct LightShafts {
    shadows: wgpu::Texture,
    tables: [Table; 2],
    /// The table that is read.
    front: Option<usize>,
    build: Option<Build>,
    layers: usize,
    shadow_work: wgpu::Buffer,
    shadow_group: wgpu::BindGroup,
    share_work: wgpu::Buffer,
    share_groups: [wgpu::BindGroup; 2],
    air: wgpu::Buffer,
}

impl LightShafts {
    /// Room for the shadows of a number of layers.
    #[must_use]
    pub fn new(gpu: &Gpu, pipelines: &Pipelines, layers: usize) -> Self {
        use wgpu::BindingResource::{Sampler, TextureView};
        let layers = layers.clamp(1, LAYERS_MAX);
        let [width, height, slices] = SHADOW_SIZE;
        let size = [width, height, slices * layers as u32];
        let shadows = texture(gpu, "cloud shadows", size, wgpu::TextureFormat::R32Float);
        let view = shadows.create_view(&wgpu::TextureViewDescriptor::default());
        let sampler = sampler(gpu);
        let tables = [(); 2].map(|()| {
            let texture = shares_texture(gpu, SHARE_SIZE);
            Table {
                reader: ShaftReader {
                    frame: gpu.uniform_buffer("light shafts", size_of::<layout::ShaftFrame>()),
                    shares: texture.create_view(&wgpu::TextureViewDescriptor::default()),
                    sampler: sampler.clone(),
                },
                texture,
                made: layout::ShaftFrame::default(),
            }
        });
        let shadow_work = gpu.uniform_buffer("cloud shadows", size_of::<layout::ShadowWork>());
        let share_work = gpu.uniform_buffer("light shafts", size_of::<layout::ShaftWork>());
        let share_group = |table: &Table| {
            let resources = [
                share_work.as_entire_binding(),
                TextureView(&view),
                Sampler(&sampler),
                TextureView(&table.reader.shares),
            ];
            gpu.bind_group("light shafts", &pipelines.make_shafts_layout, &resources)
        };
        Self {
            shadow_group: gpu.bind_group(
                "cloud shadows",
                &pipelines.shadows_layout,
                &[
                    shadow_work.as_entire_binding(),
                    TextureView(&view),
                    pipelines.read_counter.as_entire_binding(),
                ],
            ),
            share_groups: tables.each_ref().map(share_group),
            air: gpu.uniform_buffer("light shafts' air", size_of::<layout::Air>()),
            shadows,
            tables,
            front: None,
            build: None,
            layers,
            shadow_work,
            share_work,
        }
    }

    /// Layers that there is room for.
    #[must_use]
    pub fn layers(&self) -> usize {
        self.layers
    }

    /// Where the air of the place is told to the pass that makes shares.
    #[must_use]
    pub fn air(&self) -> &wgpu::Buffer {
        &self.air
    }

    /// What is read; none before the first table is whole.
    #[must_use]
    pub fn reader(&self) -> Option<&ShaftReader> {
        self.front.map(|front| &self.tables[front].reader)
    }

    /// What is read, brought to the processor: for tests. Waits for the device.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn shares_blocking(&self, gpu: &Gpu) -> Result<Option<ShaftShares>, GpuError> {
        let Some(table) = self.front.map(|front| &self.tables[front]) else {
            return Ok(None);
        };
        let [width, height, depth] = SHARE_SIZE;
        let usage = wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        let bytes = 8 * u64::from(width) * u64::from(height) * u64::from(depth);
        let buffer = gpu.buffer("light shafts' copy", bytes, usage);
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: None });
        encoder.copy_texture_to_buffer(
            table.texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(8 * width),
                    rows_per_image: Some(height),
                },
            },
            table.texture.size(),
        );
        gpu.queue.submit([encoder.finish()]);
        let words: Vec<u16> = bytemuck::pod_collect_to_vec(&read_buffer_blocking(gpu, &buffer)?);
        let shares = words
            .chunks_exact(4)
            .map(|half| [0, 1, 2].map(|channel| f16::from_bits(half[channel]).to_f32()))
            .collect();
        Ok(Some(ShaftShares {
            shares,
            frame: table.made,
        }))
    }

    /// What the table is made for that is being made.
    #[must_use]
    pub fn building(&self) -> Option<&ShaftInputs> {
        self.build.as_ref().map(|build| &build.inputs)
    }

    /// Drops what is being made.
    pub fn drop_build(&mut self) {
        self.build = None;
    }

    /// Lets nobody read the table any more.
    pub fn drop_table(&mut self) {
        self.front = None;
    }

    /// Whether a table is being made.
    #[must_use]
    pub fn is_building(&self) -> bool {
        self.build.is_some()
    }

    /// Bytes on the device.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let texels = |texture: &wgpu::Texture| {
            let size = texture.size();
            u64::from(size.width) * u64::from(size.height) * u64::from(size.depth_or_array_layers)
        };
        4 * texels(&self.shadows) + 8 * texels(&self.tables[0].texture) * 2
    }

    /// Begins a table beside the one that is read. What was begun before is dropped.
    pub fn begin(&mut self, inputs: ShaftInputs) {
        self.build = Some(Build {
            frame: inputs.frame(),
            inputs,
            layer: 0,
            azimuth: 0,
        });
    }

    /// Evaluations that a half-plane takes next, and how many half-planes are left of what is made next.
    fn next_work(&self) -> Option<(u64, u32)> {
        let build = self.build.as_ref()?;
        let per_azimuth = match build.inputs.layers.get(build.layer) {
            Some(layer) => {
                let samples = build.inputs.substeps(layer) * (SHADOW_SIZE[2] - 1);
                SHADOW_SIZE[1] * samples
            }
            None => SHARE_SIZE[1] * SHARE_STEPS,
        };
        Some((u64::from(per_azimuth), SHARE_SIZE[0] - build.azimuth))
    }

    /// Evaluations that the next strip takes at least.
    #[must_use]
    pub fn least_evaluations(&self) -> u64 {
        self.next_work().map_or(0, |(per_azimuth, left)| {
            per_azimuth * u64::from(left.min(GROUP))
        })
    }

    /// Records the next strip, which takes about so many evaluations at most. Returns how many it takes, and whether the
    /// table is whole then and is read from now on.
    pub fn advance(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        read: &ShaftsRead<'_>,
        evaluations_max: u64,
    ) -> (u64, bool) {
        let Some((per_azimuth, left)) = self.next_work() else {
            return (0, false);
        };
        let Some(mut build) = self.build.take() else {
            return (0, false);
        };
        let fitting = u64::from(GROUP).max(evaluations_max / per_azimuth);
        let azimuths =
            u32::try_from(fitting).map_or(left, |fitting| (fitting / GROUP * GROUP).min(left));
        let evaluations = per_azimuth * u64::from(azimuths);
        let back = self.front.map_or(0, |front| 1 - front);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("light shafts"),
            timestamp_writes: timing.pass(TimedPass::LightShafts, evaluations),
        });
        let recorded = if build.layer < build.inputs.layers.len() {
            self.record_shadow(gpu, &mut pass, pipelines, read, &build, azimuths)
        } else {
            self.record_shares(gpu, &mut pass, pipelines, read, &build, azimuths, back)
        };
        drop(pass);
        if recorded.is_none() {
            // Without its pipeline nothing is made; what is there stays.
            return (0, false);
        }
        build.azimuth += azimuths;
        if build.azimuth >= SHARE_SIZE[0] {
            build.azimuth = 0;
            build.layer += 1;
        }
        let whole = build.layer > build.inputs.layers.len();
        if whole {
            let frame = &self.tables[back].reader.frame;
            gpu.queue
                .write_buffer(frame, 0, bytemuck::bytes_of(&build.frame));
            self.tables[back].made = build.frame;
            self.front = Some(back);
        } else {
            self.build = Some(build);
        }
        (evaluations, whole)
    }

    fn record_shadow(
        &self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        pipelines: &Pipelines,
        read: &ShaftsRead<'_>,
        build: &Build,
        azimuths: u32,
    ) -> Option<()> {
        let layer = &build.inputs.layers[build.layer];
        let pipeline = pipelines.get(cloud_shadows_key(layer.features))?;
        let work = layout::ShadowWork {
            frame: build.frame,
            first_azimuth: build.azimuth,
            azimuths,
            layer: build.layer as u32,
            substeps: build.inputs.substeps(layer),
        };
        gpu.queue
            .write_buffer(&self.shadow_work, 0, bytemuck::bytes_of(&work));
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, read.scene, &[]);
        pass.set_bind_group(1, read.field, &[]);
        pass.set_bind_group(2, &self.shadow_group, &[]);
        pass.set_bind_group(3, &pipelines.empty_group, &[]);
        pass.dispatch_workgroups(azimuths.div_ceil(GROUP), SHADOW_SIZE[1] / GROUP, 1);
        Some(())
    }

    #[allow(clippy::too_many_arguments)]
    fn record_shares(
        &self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        pipelines: &Pipelines,
        read: &ShaftsRead<'_>,
        build: &Build,
        azimuths: u32,
        table: usize,
    ) -> Option<()> {
        let pipeline = pipelines.get(make_shafts_key())?;
        let mut work = layout::ShaftWork {
            frame: build.frame,
            layer_count: build.inputs.layers.len() as u32,
            first_azimuth: build.azimuth,
            azimuths,
            ..Default::default()
        };
        for (to, layer) in work.layers.iter_mut().zip(&build.inputs.layers) {
            to[0] = layer.base_altitude_m as f32;
            to[1] = layer.top_altitude_m as f32;
        }
        gpu.queue
            .write_buffer(&self.share_work, 0, bytemuck::bytes_of(&work));
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, read.air, &[]);
        pass.set_bind_group(1, &self.share_groups[table], &[]);
        pass.set_bind_group(2, &pipelines.empty_group, &[]);
        pass.set_bind_group(3, &pipelines.empty_group, &[]);
        pass.dispatch_workgroups(azimuths.div_ceil(GROUP), SHARE_SIZE[1] / GROUP, 1);
        Some(())
    }
}
