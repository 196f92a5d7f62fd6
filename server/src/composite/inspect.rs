//! Pictures of one quantity instead of the sky: which kernel makes them, and the pass of those that are no composite.

use super::{CompositeInputs, Picture};
use crate::gpu::{Gpu, PipelineKey, Pipelines, TimedPass, TimingRing};
use skycell_protocol::Show;
use skycell_shaders::{Features, Kernel, Quantity, Seen, Shown, layout};
use wgpu::util::DeviceExt;

/// What the shaders call a view.
#[must_use]
pub fn shown_of(show: Show) -> Shown {
    use Quantity::{Coverage, Density, Profile, Type};
    match show {
        Show::Picture => Shown::Picture,
        Show::Single => Shown::Single,
        Show::Multiple => Shown::Multiple,
        Show::Ambient => Shown::Ambient,
        Show::PhaseOff => Shown::PhaseOff,
        Show::Transmittance => Shown::Transmittance,
        Show::Distance => Shown::Distance,
        Show::CacheMip => Shown::CacheMip,
        Show::CacheAge => Shown::CacheAge,
        Show::Steps => Shown::Steps,
        Show::Coverage => Shown::Field(Coverage, Seen::FromEye),
        Show::Type => Shown::Field(Type, Seen::FromEye),
        Show::Profile => Shown::Field(Profile, Seen::FromEye),
        Show::Density => Shown::Field(Density, Seen::FromEye),
        Show::CoverageAbove => Shown::Field(Coverage, Seen::FromAbove),
        Show::TypeAbove => Shown::Field(Type, Seen::FromAbove),
        Show::ProfileAbove => Shown::Field(Profile, Seen::FromAbove),
        Show::DensityAbove => Shown::Field(Density, Seen::FromAbove),
        Show::ProfileSection => Shown::Field(Profile, Seen::Section),
        Show::DensitySection => Shown::Field(Density, Seen::Section),
    }
}

/// A composite that shows something else. An inspection is no composite; its key is [`inspect_key`].
#[must_use]
pub fn shown_key(key: PipelineKey, shown: Shown) -> PipelineKey {
    PipelineKey {
        features: Features {
            shown,
            ..key.features
        },
        ..key
    }
}

/// The inspection of a layer. `layer`: what its march is specialised to.
#[must_use]
pub fn inspect_key(layer: Features, shown: Shown) -> PipelineKey {
    let marches = shown == Shown::Steps;
    PipelineKey {
        kernel: Kernel::Inspect,
        features: Features {
            layers: 1,
            octave_vectors: if marches { layer.octave_vectors } else { 1 },
            catmull_rom: false,
            linear_output: false,
            screen_space: false,
            count_reads: false,
            // Brings the march's count of steps with it.
            ray_list: marches,
            shown,
            ..layer
        },
    }
}

/// What the passes of an inspection are told: one per layer, the same for all viewers.
#[derive(Debug)]
pub struct Inspections {
    groups: Vec<wgpu::BindGroup>,
}

impl Inspections {
    /// For a number of layers, the highest of which ends at `highest_top_m`.
    #[must_use]
    pub fn new(gpu: &Gpu, pipelines: &Pipelines, layers: usize, highest_top_m: f64) -> Self {
        let groups = (0..layers)
            .map(|layer| {
                let told = layout::Inspection {
                    layer: layer as u32,
                    is_first: u32::from(layer == 0),
                    is_last: u32::from(layer + 1 == layers),
                    highest_top_m: highest_top_m as f32,
                };
                let buffer = gpu
                    .device
                    .create_buffer_init(&wgpu::util::BufferInitDescriptor {
                        label: Some("inspection"),
                        contents: bytemuck::bytes_of(&told),
                        usage: wgpu::BufferUsages::UNIFORM,
                    });
                gpu.buffer_group("inspection", &pipelines.question_layout, &[&buffer])
            })
            .collect();
        Self { groups }
    }
}

/// What an inspection reads beside what a composite does.
#[derive(Clone, Copy, Debug)]
pub struct InspectionInputs<'a> {
    /// Group 1: the cloud field.
    pub field: &'a wgpu::BindGroup,
    /// What its passes are told.
    pub inspections: &'a Inspections,
    /// One pipeline per layer.
    pub keys: &'a [PipelineKey],
}

impl Picture {
    /// Records an inspection: one dispatch per layer and eye. The keys of `eyes` are not looked at.
    pub fn record_inspection(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        eyes: &[CompositeInputs<'_>],
        inspection: &InspectionInputs<'_>,
    ) {
        let groups = &inspection.inspections.groups;
        let keys = inspection.keys.iter();
        let made: Vec<&wgpu::ComputePipeline> =
            keys.filter_map(|key| pipelines.get(*key)).collect();
        if made.len() != groups.len() || made.is_empty() {
            let black = [0, 0, 0, u8::MAX].repeat(self.pixels.size() as usize / 4);
            gpu.queue.write_buffer(&self.pixels, 0, &black);
            return;
        }
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("inspect"),
            timestamp_writes: timing.pass(TimedPass::Inspection, 1),
        });
        pass.set_bind_group(1, inspection.field, &[]);
        for (eye, (parts, inputs)) in self.eyes.iter().zip(eyes).enumerate() {
            let view = layout::View {
                first_row: 0,
                ..self.placed(eye, inputs.view)
            };
            gpu.queue
                .write_buffer(&parts.sky.view, 0, bytemuck::bytes_of(&view));
            pass.set_bind_group(0, inputs.scene, &[]);
            pass.set_bind_group(3, &parts.sky.group, &[]);
            for (pipeline, group) in made.iter().zip(groups) {
                pass.set_pipeline(pipeline);
                pass.set_bind_group(2, group, &[]);
                pass.dispatch_workgroups(
                    self.eye_size.width().div_ceil(8),
                    self.eye_size.height().div_ceil(8),
                    1,
                );
            }
        }
    }
}
