//! Functions that need no scene.

use super::{Round, group};
use crate::gpu::{Gpu, GpuError};
use skycell_shaders::{Features, Kernel};

/// What `probe/probe.wgsl` can be asked; what a point holds stands there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FunctionQuestion {
    /// Altitude of a place.
    Altitude = 0,
    /// A ray and a shell.
    ShellRoots = 1,
    /// A direction to the octahedral square and back.
    OctahedralRoundTrip = 2,
    /// A place of the octahedral square.
    DirectionFromOctahedral = 3,
    /// Henyey-Greenstein and Draine.
    Phase = 4,
    /// (1 − e^−x)/x.
    OneMinusExpOver = 5,
    /// The transfer function of sRGB.
    Srgb = 6,
    /// A ray and a dome.
    DomeDistance = 7,
    /// A ray from above and the surface of a proxy.
    ProxyFromAbove = 8,
    /// Weights of a read of the cache.
    CubicWeights = 9,
}

/// Two vectors.
pub type FunctionPoint = [[f32; 4]; 2];

/// The device and its pipeline.
#[derive(Debug)]
pub struct FunctionProbe {
    gpu: Gpu,
    pipeline: wgpu::ComputePipeline,
}

impl FunctionProbe {
    /// Opens a device.
    ///
    /// # Errors
    /// When there is none.
    pub fn open() -> Result<Self, GpuError> {
        let gpu = Gpu::open_blocking()?;
        let module = skycell_shaders::compose(Kernel::Probe, Features::default())?;
        let shader = gpu
            .device
            .create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("probe"),
                source: wgpu::ShaderSource::Naga(std::borrow::Cow::Owned(module)),
            });
        let pipeline = gpu
            .device
            .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some("probe"),
                layout: None,
                module: &shader,
                entry_point: Some(Kernel::Probe.entry_point()),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            });
        Ok(Self { gpu, pipeline })
    }

    /// The values at the points.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn ask(
        &self,
        question: FunctionQuestion,
        points: &[FunctionPoint],
    ) -> Result<Vec<[f32; 4]>, GpuError> {
        let asked = [question as u32, points.len() as u32, 0, 0];
        let round = Round::new(&self.gpu, points, 16, asked);
        let bound = group(
            &self.gpu,
            &self.pipeline.get_bind_group_layout(0),
            &[&round.points, &round.values, &round.question],
        );
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &bound, &[]);
            pass.dispatch_workgroups(round.groups, 1, 1);
        }
        self.gpu.queue.submit([encoder.finish()]);
        round.read(&self.gpu, points.len())
    }
}
