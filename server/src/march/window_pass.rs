//! The passes of the temporal window: a frame is marched into a ring of slices, and the ring is summed up for a camera.

use super::cell_buffers::CellBuffers;
use super::window::WindowPlan;
use crate::gpu::{Gpu, PipelineKey, Pipelines, TimedPass, TimingRing};
use skycell_protocol::FrameSize;
use skycell_shaders::{Features, Kernel, layout};

/// Bytes of a marched pixel in a slice.
const BYTES_PER_PIXEL: u64 = 16;
/// Most bytes of a ring. Beyond that a window has fewer frames.
const RING_BYTES_MAX: u64 = 512 << 20;

/// What the march into a window is specialised to for a layer.
#[must_use]
pub fn window_key(layer: Features) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::MarchPixels,
        features: Features {
            layers: 1,
            catmull_rom: false,
            linear_output: false,
            screen_space: true,
            window: true,
            ..layer
        },
    }
}

/// The pass that sums a window up.
#[must_use]
pub fn resolve_key(frames: u32, at_rest: bool) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::ResolveWindow,
        features: Features {
            window_frames: if at_rest { 1 } else { frames },
            window_at_rest: at_rest,
            ..Features::default()
        },
    }
}

/// Size of the marched picture.
fn marched_size(picture: FrameSize, divisor: u32) -> [u32; 2] {
    [picture.width(), picture.height()].map(|side| side.div_ceil(divisor.max(1)))
}

/// Bytes of the ring that a picture gets for a plan, as far as a device can hold it.
#[must_use]
pub fn ring_bytes(gpu: &Gpu, picture: FrameSize, layers: usize, plan: WindowPlan) -> u64 {
    bytes_of(picture, layers, fitting_window(gpu, picture, layers, plan))
}

fn bytes_of(picture: FrameSize, layers: usize, plan: WindowPlan) -> u64 {
    let [width, height] = marched_size(picture, plan.divisor).map(u64::from);
    width * height * layers.max(1) as u64 * u64::from(plan.frames) * BYTES_PER_PIXEL
}

/// How many frames a window can have that is asked for `frames`: halves of it, where the device cannot hold more.
pub fn possible_frames(frames: u32) -> impl Iterator<Item = u32> {
    std::iter::successors(Some(frames.max(1)), |frames| {
        (*frames > 1).then_some(frames / 2)
    })
}

/// A plan whose ring a device can hold: with fewer frames, where it must be.
#[must_use]
pub fn fitting_window(
    gpu: &Gpu,
    picture: FrameSize,
    layers: usize,
    plan: WindowPlan,
) -> WindowPlan {
    let limits = gpu.device.limits();
    let most = limits
        .max_storage_buffer_binding_size
        .min(limits.max_buffer_size)
        .min(RING_BYTES_MAX);
    let mut plan = plan.bounded();
    for frames in possible_frames(plan.frames) {
        plan.frames = frames;
        if bytes_of(picture, layers, plan) <= most {
            break;
        }
    }
    plan
}

/// Rows of a frame of one layer.
#[derive(Clone, Copy, Debug)]
pub struct WindowStrip<'a> {
    /// The viewer's cell on the device.
    pub cell: &'a CellBuffers,
    /// What the layer's pipeline is specialised to.
    pub features: Features,
    /// The camera, the first row and the layer.
    pub view: &'a layout::View,
    /// Where the frame has its samples.
    pub window: &'a layout::Window,
    /// How many rows.
    pub rows: u32,
}

/// The ring of one viewer.
#[derive(Debug)]
pub struct WindowRing {
    view: wgpu::Buffer,
    window: wgpu::Buffer,
    march_group: wgpu::BindGroup,
    resolve_group: wgpu::BindGroup,
    window_group: wgpu::BindGroup,
    picture: FrameSize,
    marched: [u32; 2],
    layers: u32,
    bytes: u64,
}

impl WindowRing {
    /// A ring for a picture, whose sums go to `values`. The plan must fit: see [`fitting_window`].
    #[must_use]
    pub fn new(
        gpu: &Gpu,
        pipelines: &Pipelines,
        picture: FrameSize,
        layers: usize,
        plan: WindowPlan,
        values: &wgpu::Buffer,
    ) -> Self {
        let bytes = bytes_of(picture, layers, plan);
        let ring = gpu.buffer("window ring", bytes, wgpu::BufferUsages::STORAGE);
        let view = gpu.uniform_buffer("window view", size_of::<layout::View>());
        let window = gpu.uniform_buffer("window", size_of::<layout::Window>());
        let group = |layout, buffers: &[&wgpu::Buffer]| gpu.buffer_group("window", layout, buffers);
        Self {
            march_group: group(&pipelines.pixels_layout, &[&ring, &pipelines.read_counter]),
            resolve_group: group(&pipelines.pixels_layout, &[values, &ring]),
            window_group: group(
                &pipelines.window_layout,
                &[&view, &pipelines.blue_noise, &window],
            ),
            view,
            window,
            picture,
            marched: marched_size(picture, plan.divisor),
            layers: layers as u32,
            bytes,
        }
    }

    /// Columns and rows of the marched picture.
    #[must_use]
    pub fn marched(&self) -> [u32; 2] {
        self.marched
    }

    /// Bytes on the device.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Submits rows of a frame from `view.first_row` on.
    pub fn submit_strip(
        &self,
        gpu: &Gpu,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        strip: &WindowStrip<'_>,
    ) {
        let Some(pipeline) = pipelines.get(window_key(strip.features)) else {
            return;
        };
        let pixels = u64::from(strip.rows) * u64::from(self.marched[0]);
        self.tell(gpu, strip.view, strip.window);
        timing.submit_pass(gpu, "window", TimedPass::ScreenSpace, pixels, |pass| {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, strip.cell.march_group(strip.features), &[]);
            pass.set_bind_group(1, strip.cell.field_group(), &[]);
            pass.set_bind_group(2, &self.march_group, &[]);
            pass.set_bind_group(3, &self.window_group, &[]);
            pass.dispatch_workgroups(self.marched[0].div_ceil(8), strip.rows.div_ceil(8), 1);
        });
    }

    /// Submits the sum of the window for a camera, of so many rows.
    pub fn submit_resolve(
        &self,
        gpu: &Gpu,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        view: &layout::View,
        window: &layout::Window,
        rows: u32,
    ) {
        // Every pixel's slices are known where none is reprojected.
        let at_rest = window.slices_per_pixel > 0;
        let Some(pipeline) = pipelines.get(resolve_key(window.frames, at_rest)) else {
            return;
        };
        self.tell(gpu, view, window);
        // Its time counts to that of the rays, which it comes with.
        timing.submit_pass(gpu, "window", TimedPass::ScreenSpace, 0, |pass| {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &pipelines.empty_group, &[]);
            pass.set_bind_group(1, &pipelines.empty_group, &[]);
            pass.set_bind_group(2, &self.resolve_group, &[]);
            pass.set_bind_group(3, &self.window_group, &[]);
            pass.dispatch_workgroups(
                self.picture.width().div_ceil(8),
                rows.min(self.picture.height()).div_ceil(8),
                self.layers,
            );
        });
    }

    /// Writes what the next pass reads of the camera and the window.
    fn tell(&self, gpu: &Gpu, view: &layout::View, window: &layout::Window) {
        let view = layout::View {
            width: self.picture.width(),
            height: self.picture.height(),
            marched_width: self.marched[0],
            marched_height: self.marched[1],
            ..*view
        };
        gpu.queue
            .write_buffer(&self.view, 0, bytemuck::bytes_of(&view));
        gpu.queue
            .write_buffer(&self.window, 0, bytemuck::bytes_of(window));
    }
}
