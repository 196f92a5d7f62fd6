//! Compute pipelines, made once per specialisation and never in a frame.

use super::{Gpu, GpuError};
use crate::march::blue_noise_words;
use skycell_shaders::{Features, Kernel, SourceEdit, compose, compose_edited};
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::sync::mpsc::{self, Receiver, Sender};

/// Which pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PipelineKey {
    /// The program.
    pub kernel: Kernel,
    /// What it is specialised to.
    pub features: Features,
}

/// Layouts of the bind groups, shared by all specialisations of a kernel.
#[derive(Debug)]
pub struct Pipelines {
    /// Group 0 of all kernels: the scene.
    pub scene_layout: wgpu::BindGroupLayout,
    /// Group 0 of the marching kernels that read the sun volume: the scene, and the volume.
    pub sun_scene_layout: wgpu::BindGroupLayout,
    /// Group 2 of the pass that makes columns of the sun volume.
    pub sun_columns_layout: wgpu::BindGroupLayout,
    /// Group 1 of the marching kernels: the cloud field.
    pub field_layout: wgpu::BindGroupLayout,
    /// Group 2 of the cache's march: work, reference, old and new texels.
    pub texels_layout: wgpu::BindGroupLayout,
    /// Group 2 of the audit: work, reference, texels, and where they are written beside fresh ones.
    pub audit_layout: wgpu::BindGroupLayout,
    /// Group 2 of the composite: page tables and atlas.
    pub cached_layout: wgpu::BindGroupLayout,
    /// The same for viewers in a layer: and the marched pixels of its near part.
    pub inside_layout: wgpu::BindGroupLayout,
    /// Group 2 of the screen-space march: marched pixels, to write.
    pub pixels_layout: wgpu::BindGroupLayout,
    /// Group 2 of the screen-space composite: marched pixels, to read.
    pub marched_layout: wgpu::BindGroupLayout,
    /// Group 3 of the composite: view and picture.
    pub picture_layout: wgpu::BindGroupLayout,
    /// Group 3 of the screen-space march: view.
    pub view_layout: wgpu::BindGroupLayout,
    /// Group 3 of the temporal window's march and sum: view, blue noise, window.
    pub window_layout: wgpu::BindGroupLayout,
    /// Group 2 of the field's probe: points and values.
    pub points_layout: wgpu::BindGroupLayout,
    /// Group 3 of the field's probe: what is asked.
    pub question_layout: wgpu::BindGroupLayout,
    /// Group 0 of the pass that blends maps.
    pub blend_layout: wgpu::BindGroupLayout,
    /// Group 0 of the passes that make the air's tables: medium, base tables.
    pub air_base_layout: wgpu::BindGroupLayout,
    /// Group 1 of the pass that makes the sky's table.
    pub air_view_layout: wgpu::BindGroupLayout,
    /// Group 1 of the pass that makes the haze's table.
    pub air_haze_layout: wgpu::BindGroupLayout,
    /// Group 1 of the composite where the air is read from tables.
    pub air_layout: wgpu::BindGroupLayout,
    /// Group 1 of the composite where that air has light shafts: the same and their table.
    pub shafts_layout: wgpu::BindGroupLayout,
    /// Group 2 of the pass that makes a layer's shadow in the air.
    pub shadows_layout: wgpu::BindGroupLayout,
    /// Group 1 of the pass that makes the table of light shafts.
    pub make_shafts_layout: wgpu::BindGroupLayout,
    /// Group 0 of the pass that fills tiles from others: addresses, work, working page to write.
    pub resample_layout: wgpu::BindGroupLayout,
    /// Group 0 of the pass that mixes two pictures: share, old and new picture.
    pub fade_layout: wgpu::BindGroupLayout,
    empty_layout: wgpu::BindGroupLayout,
    /// Stands where a kernel has no group.
    pub empty_group: wgpu::BindGroup,
    /// Texture reads of the kernels that count them, low and high word, and density evaluations likewise.
    pub read_counter: wgpu::Buffer,
    /// What moves the samples of a temporal window.
    pub blue_noise: wgpu::Buffer,
    /// Stands where a picture has no list of rays.
    pub no_rays: wgpu::Buffer,
    made: HashMap<PipelineKey, wgpu::ComputePipeline>,
    /// What other threads make.
    coming: HashSet<PipelineKey>,
    finished: (Sender<Finished>, Receiver<Finished>),
    edit: Option<SourceEdit>,
}

/// What another thread has made of a key.
type Finished = (PipelineKey, Result<wgpu::ComputePipeline, GpuError>);

/// Composes a kernel and compiles it.
fn make(
    gpu: &Gpu,
    key: PipelineKey,
    groups: &[wgpu::BindGroupLayout; 4],
    edit: Option<SourceEdit>,
) -> Result<wgpu::ComputePipeline, GpuError> {
    let module = match edit {
        Some(edit) => compose_edited(key.kernel, key.features, edit)?,
        None => compose(key.kernel, key.features)?,
    };
    let shader = own_shader_module(gpu, key.kernel, module);
    let groups = groups.each_ref().map(Some);
    let pipeline_layout = gpu
        .device
        .create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(key.kernel.entry_point()),
            bind_group_layouts: &groups,
            immediate_size: 0,
        });
    Ok(gpu
        .device
        .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(key.kernel.entry_point()),
            layout: Some(&pipeline_layout),
            module: &shader,
            entry_point: Some(key.kernel.entry_point()),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        }))
}

fn uniform() -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Uniform,
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

fn storage(read_only: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only },
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

fn sampled(dimension: wgpu::TextureViewDimension, filterable: bool) -> wgpu::BindingType {
    wgpu::BindingType::Texture {
        sample_type: wgpu::TextureSampleType::Float { filterable },
        view_dimension: dimension,
        multisampled: false,
    }
}

fn stored(format: wgpu::TextureFormat) -> wgpu::BindingType {
    stored_as(format, wgpu::TextureViewDimension::D2Array)
}

fn stored_as(
    format: wgpu::TextureFormat,
    view_dimension: wgpu::TextureViewDimension,
) -> wgpu::BindingType {
    wgpu::BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format,
        view_dimension,
    }
}

const SAMPLER: wgpu::BindingType = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);

fn layout(gpu: &Gpu, label: &str, types: &[wgpu::BindingType]) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = (0..)
        .zip(types)
        .map(|(binding, ty)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: *ty,
            count: None,
        })
        .collect();
    gpu.device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(label),
            entries: &entries,
        })
}

/// A module without the checks that wgpu adds to shaders of strangers: clamps around every access and a counter in every
/// loop. They cost about half of a composite on a software driver.
#[allow(unsafe_code)]
fn own_shader_module(gpu: &Gpu, kernel: Kernel, module: naga::Module) -> wgpu::ShaderModule {
    let descriptor = wgpu::ShaderModuleDescriptor {
        label: Some(kernel.entry_point()),
        source: wgpu::ShaderSource::Naga(Cow::Owned(module)),
    };
    // SAFETY: the module is one of this workspace's own, validated by naga when it was composed. It indexes buffers by
    // invocations that it compares with the picture's size, uniform arrays by constants or by layer and octave counts
    // that the scene document bounds, page tables by coordinates in 0…1, and the atlas by slots that the pool has
    // handed out. Its loops end: march steps and probes are counted against fixed limits.
    unsafe {
        gpu.device
            .create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked())
    }
}

impl Pipelines {
    /// The layouts; pipelines follow with [`Self::prepare`].
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        use wgpu::TextureViewDimension::{D2, D2Array, D3};
        let empty_layout = layout(gpu, "empty", &[]);
        let empty_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("empty"),
            layout: &empty_layout,
            entries: &[],
        });
        let buffer = |label, size| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: wgpu::BufferUsages::STORAGE
                    | wgpu::BufferUsages::COPY_DST
                    | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })
        };
        let air = [
            uniform(),
            sampled(D2, true),
            sampled(D2, true),
            sampled(D3, true),
            sampled(D2, true),
            SAMPLER,
        ];
        let cached = [
            wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Uint,
                view_dimension: D2,
                multisampled: false,
            },
            sampled(D2Array, true),
            sampled(D2Array, true),
            SAMPLER,
            sampled(D2, false),
        ];
        let [tables, radiance, distance, sampler, origins] = cached;
        let near_and_far = [tables, radiance, distance, sampler, origins, storage(true)];
        let words = blue_noise_words();
        let blue_noise = buffer("blue noise", size_of_val(words.as_slice()) as u64);
        gpu.queue
            .write_buffer(&blue_noise, 0, bytemuck::cast_slice(&words));
        Self {
            read_counter: buffer("read counter", 16),
            blue_noise,
            no_rays: buffer("no rays", 32),
            scene_layout: layout(gpu, "scene", &[uniform()]),
            sun_scene_layout: layout(
                gpu,
                "scene and sun volume",
                &[uniform(), sampled(D3, true), SAMPLER, uniform()],
            ),
            sun_columns_layout: layout(
                gpu,
                "sun columns",
                &[
                    uniform(),
                    wgpu::BindingType::StorageTexture {
                        access: wgpu::StorageTextureAccess::WriteOnly,
                        format: wgpu::TextureFormat::R32Float,
                        view_dimension: D3,
                    },
                    storage(false),
                ],
            ),
            field_layout: layout(
                gpu,
                "field",
                &[
                    sampled(D2Array, true),
                    sampled(D2Array, true),
                    sampled(D3, true),
                    sampled(D3, true),
                    SAMPLER,
                    SAMPLER,
                    sampled(D3, true),
                ],
            ),
            texels_layout: layout(
                gpu,
                "texels",
                &[
                    storage(true),
                    sampled(D2, true),
                    sampled(D2, false),
                    stored(wgpu::TextureFormat::Rgba16Float),
                    stored(wgpu::TextureFormat::R32Float),
                    storage(false),
                ],
            ),
            audit_layout: layout(
                gpu,
                "audit",
                &[
                    storage(true),
                    uniform(),
                    sampled(D2Array, true),
                    sampled(D2Array, true),
                    storage(false),
                ],
            ),
            cached_layout: layout(gpu, "cached", &cached),
            inside_layout: layout(gpu, "cached and marched", &near_and_far),
            pixels_layout: layout(gpu, "pixels", &[storage(false), storage(false)]),
            marched_layout: layout(gpu, "marched", &[storage(true)]),
            picture_layout: layout(gpu, "picture", &[uniform(), storage(false), storage(true)]),
            points_layout: layout(gpu, "points", &[storage(true), storage(false)]),
            question_layout: layout(gpu, "question", &[uniform()]),
            blend_layout: layout(
                gpu,
                "blend maps",
                &[uniform(), storage(true), storage(true), storage(false)],
            ),
            resample_layout: layout(
                gpu,
                "resample",
                &[
                    uniform(),
                    storage(true),
                    stored_as(wgpu::TextureFormat::Rgba16Float, D2),
                    stored_as(wgpu::TextureFormat::R32Float, D2),
                ],
            ),
            fade_layout: layout(gpu, "fade", &[uniform(), storage(true), storage(false)]),
            view_layout: layout(gpu, "view", &[uniform(), storage(true)]),
            window_layout: layout(gpu, "window", &[uniform(), storage(true), uniform()]),
            air_base_layout: layout(
                gpu,
                "air base",
                &[
                    uniform(),
                    sampled(D2, true),
                    sampled(D2, true),
                    sampled(D2, true),
                    SAMPLER,
                ],
            ),
            air_view_layout: layout(
                gpu,
                "air view",
                &[
                    stored_as(wgpu::TextureFormat::Rgba32Float, D2),
                    stored_as(wgpu::TextureFormat::Rgba32Float, D2),
                ],
            ),
            air_haze_layout: layout(
                gpu,
                "air haze",
                &[
                    stored_as(wgpu::TextureFormat::Rgba32Float, D3),
                    stored_as(wgpu::TextureFormat::Rgba32Float, D2),
                ],
            ),
            shafts_layout: layout(
                gpu,
                "air and light shafts",
                &[air.as_slice(), &[uniform(), sampled(D3, true), SAMPLER]].concat(),
            ),
            air_layout: layout(gpu, "air", &air),
            shadows_layout: layout(
                gpu,
                "cloud shadows",
                &[
                    uniform(),
                    stored_as(wgpu::TextureFormat::R32Float, D3),
                    storage(false),
                ],
            ),
            make_shafts_layout: layout(
                gpu,
                "light shafts",
                &[
                    uniform(),
                    sampled(D3, true),
                    SAMPLER,
                    stored_as(wgpu::TextureFormat::Rgba16Float, D3),
                ],
            ),
            empty_layout,
            empty_group,
            made: HashMap::new(),
            coming: HashSet::new(),
            finished: mpsc::channel(),
            edit: None,
        }
    }

    fn groups(&self, key: PipelineKey) -> [&wgpu::BindGroupLayout; 4] {
        let march_scene = if key.features.sun_layers > 0 {
            &self.sun_scene_layout
        } else {
            &self.scene_layout
        };
        match key.kernel {
            Kernel::SunColumns => [
                &self.scene_layout,
                &self.field_layout,
                &self.sun_columns_layout,
                &self.empty_layout,
            ],
            Kernel::MarchTexels => [
                march_scene,
                &self.field_layout,
                &self.texels_layout,
                &self.empty_layout,
            ],
            Kernel::AuditTexels => [
                march_scene,
                &self.field_layout,
                &self.audit_layout,
                &self.empty_layout,
            ],
            Kernel::MarchPixels => [
                march_scene,
                &self.field_layout,
                &self.pixels_layout,
                if key.features.window {
                    &self.window_layout
                } else {
                    &self.view_layout
                },
            ],
            Kernel::ResolveWindow => [
                &self.empty_layout,
                &self.empty_layout,
                &self.pixels_layout,
                &self.window_layout,
            ],
            Kernel::Inspect => [
                &self.scene_layout,
                &self.field_layout,
                &self.question_layout,
                &self.picture_layout,
            ],
            Kernel::ProbeField => [
                march_scene,
                &self.field_layout,
                &self.points_layout,
                &self.question_layout,
            ],
            Kernel::BlendMaps => [
                &self.blend_layout,
                &self.empty_layout,
                &self.empty_layout,
                &self.empty_layout,
            ],
            Kernel::ResampleTiles => [
                &self.resample_layout,
                &self.empty_layout,
                &self.cached_layout,
                &self.empty_layout,
            ],
            Kernel::FadePictures => [
                &self.fade_layout,
                &self.empty_layout,
                &self.empty_layout,
                &self.empty_layout,
            ],
            Kernel::CloudShadows => [
                &self.scene_layout,
                &self.field_layout,
                &self.shadows_layout,
                &self.empty_layout,
            ],
            Kernel::MakeLightShafts => [
                &self.air_base_layout,
                &self.make_shafts_layout,
                &self.empty_layout,
                &self.empty_layout,
            ],
            Kernel::MakeAirView | Kernel::MakeAirHaze => [
                &self.air_base_layout,
                if key.kernel == Kernel::MakeAirView {
                    &self.air_view_layout
                } else {
                    &self.air_haze_layout
                },
                &self.empty_layout,
                &self.empty_layout,
            ],
            Kernel::Composite | Kernel::Probe => [
                &self.scene_layout,
                if key.features.physical_sky && key.features.light_shafts {
                    &self.shafts_layout
                } else if key.features.physical_sky {
                    &self.air_layout
                } else {
                    &self.empty_layout
                },
                if key.features.screen_space {
                    &self.marched_layout
                } else if key.features.inside {
                    &self.inside_layout
                } else {
                    &self.cached_layout
                },
                &self.picture_layout,
            ],
        }
    }

    /// Makes a pipeline when it is not there yet.
    ///
    /// # Errors
    /// When its WGSL does not compose.
    pub fn prepare(&mut self, gpu: &Gpu, key: PipelineKey) -> Result<(), GpuError> {
        if self.made.contains_key(&key) {
            return Ok(());
        }
        let groups = self.groups(key).map(Clone::clone);
        let pipeline = make(gpu, key, &groups, self.edit)?;
        self.made.insert(key, pipeline);
        Ok(())
    }

    /// Has pipelines made on another thread, those that are neither there nor under way: for what may come a moment late.
    /// [`Self::take_finished`] brings them.
    pub fn prepare_later(&mut self, gpu: &Gpu, keys: Vec<PipelineKey>) {
        let edit = self.edit;
        let missing: Vec<PipelineKey> = keys
            .into_iter()
            .filter(|key| !self.made.contains_key(key) && self.coming.insert(*key))
            .collect();
        let work: Vec<_> = missing
            .into_iter()
            .map(|key| (key, self.groups(key).map(Clone::clone)))
            .collect();
        if work.is_empty() {
            return;
        }
        let keys: Vec<PipelineKey> = work.iter().map(|(key, _)| *key).collect();
        let (gpu, finished) = (gpu.clone(), self.finished.0.clone());
        let thread = std::thread::Builder::new().name("pipelines".into());
        let spawned = thread.spawn(move || {
            for (key, groups) in work {
                // Nobody waits any more once the renderer is gone.
                if finished
                    .send((key, make(&gpu, key, &groups, edit)))
                    .is_err()
                {
                    return;
                }
            }
        });
        if let Err(error) = spawned {
            tracing::error!(%error, "pipelines cannot be made beside frames");
            for key in keys {
                self.coming.remove(&key);
            }
        }
    }

    /// Whether another thread makes a pipeline.
    #[must_use]
    pub fn is_coming(&self, key: &PipelineKey) -> bool {
        self.coming.contains(key)
    }

    /// Takes over what other threads have made; true when there was something.
    pub fn take_finished(&mut self) -> bool {
        let mut some = false;
        for (key, made) in self.finished.1.try_iter() {
            self.coming.remove(&key);
            match made {
                Ok(pipeline) => {
                    self.made.insert(key, pipeline);
                    some = true;
                }
                Err(error) => tracing::error!(%error, "a pipeline could not be made"),
            }
        }
        some
    }

    /// For tests: pipelines are made anew, of edited sources; `None` brings the true ones back.
    pub fn plant(&mut self, edit: Option<SourceEdit>) {
        self.edit = edit;
        self.made.clear();
        self.coming.clear();
        self.finished = mpsc::channel();
    }

    /// What has been made.
    pub fn keys(&self) -> impl Iterator<Item = &PipelineKey> {
        self.made.keys()
    }

    /// A pipeline that [`Self::prepare`] has made.
    #[must_use]
    pub fn get(&self, key: PipelineKey) -> Option<&wgpu::ComputePipeline> {
        self.made.get(&key)
    }
}
