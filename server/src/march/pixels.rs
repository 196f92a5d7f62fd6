//! The screen-space renderer's pass: one ray per pixel and layer, in strips, so that a slow device can do other work
//! between them.

use super::cell_buffers::CellBuffers;
use crate::gpu::{Gpu, PipelineKey, Pipelines, TimedPass, TimingRing};
use skycell_protocol::FrameSize;
use skycell_shaders::{Features, Kernel, layout};

/// Values that a pixel keeps per layer.
const VALUES: u64 = 5;
/// And that a listed ray keeps: steps and optical depth more.
pub const LISTED_VALUES: usize = 7;

/// What the pass is specialised to for a layer.
#[must_use]
pub fn pixels_key(layer: Features, ray_list: bool) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::MarchPixels,
        features: Features {
            layers: 1,
            catmull_rom: false,
            linear_output: false,
            screen_space: true,
            ray_list,
            ..layer
        },
    }
}

/// Rows that take one sample of one layer.
#[derive(Clone, Copy, Debug)]
pub struct PixelStrip<'a> {
    /// The viewer's cell on the device.
    pub cell: &'a CellBuffers,
    /// What the layer's pipeline is specialised to.
    pub features: Features,
    /// The camera, the first row, the layer and the sample.
    pub view: &'a layout::View,
    /// How many rows.
    pub rows: u32,
}

/// One viewer's marched pixels.
#[derive(Debug)]
pub struct MarchedPixels {
    view: wgpu::Buffer,
    view_group: wgpu::BindGroup,
    write_group: wgpu::BindGroup,
    read_group: wgpu::BindGroup,
    values: wgpu::Buffer,
    rays: Option<wgpu::Buffer>,
    size: FrameSize,
    bytes: u64,
}

impl MarchedPixels {
    /// Makes the buffers for a picture of `size` and a number of layers. With a list of rays, one for each pixel, these
    /// are marched instead of a pinhole camera's.
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        pipelines: &Pipelines,
        size: FrameSize,
        layers: usize,
        listed: Option<&[layout::ListedRay]>,
    ) -> Self {
        let values_of_a_pixel = listed.map_or(VALUES, |_| LISTED_VALUES as u64);
        let bytes = u64::from(size.pixels()) * layers.max(1) as u64 * values_of_a_pixel * 4;
        let values = gpu.buffer(
            "marched pixels",
            bytes,
            wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
        );
        let rays = listed.map(|listed| {
            let rays = gpu.buffer(
                "listed rays",
                size_of_val(listed).max(size_of::<layout::ListedRay>()) as u64,
                wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            );
            gpu.queue
                .write_buffer(&rays, 0, bytemuck::cast_slice(listed));
            rays
        });
        let view = gpu.uniform_buffer("marched view", size_of::<layout::View>());
        let group =
            |layout, buffers: &[&wgpu::Buffer]| gpu.buffer_group("marched pixels", layout, buffers);
        let rays_or_none = rays.as_ref().unwrap_or(&pipelines.no_rays);
        Self {
            view_group: group(&pipelines.view_layout, &[&view, rays_or_none]),
            write_group: group(
                &pipelines.pixels_layout,
                &[&values, &pipelines.read_counter],
            ),
            read_group: group(&pipelines.marched_layout, &[&values]),
            view,
            values,
            rays,
            size,
            bytes,
        }
    }

    /// Whether a device can hold the marched pixels of such a picture.
    #[must_use]
    pub fn fits(gpu: &Gpu, size: FrameSize, layers: usize) -> bool {
        let bytes = u64::from(size.pixels()) * layers.max(1) as u64 * VALUES * 4;
        bytes <= gpu.device.limits().max_storage_buffer_binding_size
    }

    /// Size of the picture.
    #[must_use]
    pub fn size(&self) -> FrameSize {
        self.size
    }

    /// Bytes on the device.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The marched values.
    #[must_use]
    pub fn values(&self) -> &wgpu::Buffer {
        &self.values
    }

    /// The listed rays, where the picture is made of such.
    #[must_use]
    pub fn rays(&self) -> Option<&wgpu::Buffer> {
        self.rays.as_ref()
    }

    /// Group 2 of the screen-space composite.
    #[must_use]
    pub fn read_group(&self) -> &wgpu::BindGroup {
        &self.read_group
    }

    /// Submits one sample of one layer for rows from `view.first_row` on.
    pub fn submit_strip(
        &self,
        gpu: &Gpu,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        strip: &PixelStrip<'_>,
    ) {
        let PixelStrip {
            cell,
            features,
            view,
            rows,
        } = *strip;
        let key = pixels_key(features, self.rays.is_some());
        let Some(pipeline) = pipelines.get(key) else {
            return;
        };
        gpu.queue
            .write_buffer(&self.view, 0, bytemuck::bytes_of(view));
        let pixels = u64::from(rows) * u64::from(self.size.width());
        timing.submit_pass(
            gpu,
            "march pixels",
            TimedPass::ScreenSpace,
            pixels,
            |pass| {
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, cell.march_group(features), &[]);
                pass.set_bind_group(1, cell.field_group(), &[]);
                pass.set_bind_group(2, &self.write_group, &[]);
                pass.set_bind_group(3, &self.view_group, &[]);
                pass.dispatch_workgroups(self.size.width().div_ceil(8), rows.div_ceil(8), 1);
            },
        );
    }
}
