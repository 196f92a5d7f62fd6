//! The pass that makes one viewer's picture: intersect, read, colour, blend back to front, tone map, dither.

use crate::cache::ViewFrustum;
use crate::config::FrameFilter;
use crate::gpu::{Gpu, PipelineKey, Pipelines, TimedPass, TimingRing};
use crate::march::CellFrame;
use glam::DVec3;
use skycell_protocol::{Camera, FrameSize};
use skycell_shaders::{Features, Kernel, layout};

/// What a composite is specialised to.
#[must_use]
pub fn composite_key(
    filter: FrameFilter,
    layers: usize,
    screen_space: bool,
    linear_output: bool,
) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::Composite,
        features: Features {
            octave_vectors: 1,
            layers: layers as u32,
            weather: false,
            catmull_rom: !screen_space && filter == FrameFilter::CatmullRom,
            linear_output,
            screen_space,
        },
    }
}

/// A camera in the frame of a cell.
#[must_use]
pub fn view_frustum(camera: &Camera, size: FrameSize, frame: &CellFrame) -> ViewFrustum {
    let half_height = (camera.vertical_fov_deg().to_radians() / 2.0).tan();
    let (width, height) = (f64::from(size.width()), f64::from(size.height()));
    ViewFrustum {
        position: frame.from_world(DVec3::from_array(camera.position_m())),
        forward: camera.direction(),
        right: camera.right() * half_height * width / height,
        up: camera.up() * half_height,
        pixel_angle_rad: 2.0 * half_height / height,
    }
}

/// A view as the shaders read it; tables and strips are the caller's to fill in.
#[must_use]
pub fn view_uniform(frustum: &ViewFrustum, frame: &CellFrame, size: FrameSize) -> layout::View {
    let f32s = |v: DVec3| v.as_vec3().to_array();
    layout::View {
        position: f32s(frustum.position),
        width: size.width(),
        forward: f32s(frustum.forward),
        height: size.height(),
        right: f32s(frustum.right),
        up: f32s(frustum.up),
        pixel_angle_rad: frustum.pixel_angle_rad as f32,
        altitude_m: frame.altitude_m(frustum.position) as f32,
        ..Default::default()
    }
}

/// What a composite reads.
#[derive(Clone, Copy, Debug)]
pub struct CompositeInputs<'a> {
    /// Which specialisation.
    pub key: PipelineKey,
    /// Group 0: the scene in the frame of the viewer's cell.
    pub scene: &'a wgpu::BindGroup,
    /// Group 2: the cell's cache or the viewer's marched pixels.
    pub layers: &'a wgpu::BindGroup,
    /// The viewer's camera.
    pub view: &'a layout::View,
}

/// Where a viewer's picture is written.
#[derive(Debug)]
pub struct Picture {
    view: wgpu::Buffer,
    pixels: wgpu::Buffer,
    group: wgpu::BindGroup,
    size: FrameSize,
}

impl Picture {
    /// A picture of bytes, or of linear radiance (16 bytes a pixel).
    #[must_use]
    pub fn new(gpu: &Gpu, pipelines: &Pipelines, size: FrameSize, linear: bool) -> Self {
        let view = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("view"),
            size: size_of::<layout::View>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let bytes = u64::from(size.pixels()) * if linear { 16 } else { 4 };
        let pixels = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture"),
            size: bytes,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout: &pipelines.picture_layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: view.as_entire_binding(),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: pixels.as_entire_binding(),
                },
            ],
        });
        Self {
            view,
            pixels,
            group,
            size,
        }
    }

    /// Size of the picture.
    #[must_use]
    pub fn size(&self) -> FrameSize {
        self.size
    }

    /// The pixels on the device.
    #[must_use]
    pub fn pixels(&self) -> &wgpu::Buffer {
        &self.pixels
    }

    /// Records the composite.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        inputs: &CompositeInputs<'_>,
    ) {
        let Some(pipeline) = pipelines.get(inputs.key) else {
            return;
        };
        gpu.queue
            .write_buffer(&self.view, 0, bytemuck::bytes_of(inputs.view));
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("composite"),
            timestamp_writes: timing.pass(TimedPass::Composite, 1),
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, inputs.scene, &[]);
        pass.set_bind_group(1, &pipelines.empty_group, &[]);
        pass.set_bind_group(2, inputs.layers, &[]);
        pass.set_bind_group(3, &self.group, &[]);
        pass.dispatch_workgroups(
            self.size.width().div_ceil(16),
            self.size.height().div_ceil(16),
            1,
        );
    }
}
