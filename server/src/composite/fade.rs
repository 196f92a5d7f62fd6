//! The pass that mixes the pictures of two view cells for a viewer who goes from one to the other.

use super::{Picture, PictureFormat, clouds_key};
use crate::gpu::{Gpu, PipelineKey, Pipelines, TimedPass, TimingRing};
use skycell_protocol::FrameSize;
use skycell_shaders::{Features, Kernel, layout};

/// Pixels along a workgroup's part of a picture.
const GROUP_WIDTH: u32 = 16;
/// Rows of a workgroup's part of a picture.
const GROUP_ROWS: u32 = 8;

/// The pass that mixes two pictures.
#[must_use]
pub fn fade_key() -> PipelineKey {
    fade_key_of(PictureFormat::Display)
}

/// The pass that mixes two pictures of a format.
#[must_use]
pub fn fade_key_of(format: PictureFormat) -> PipelineKey {
    let key = PipelineKey {
        kernel: Kernel::FadePictures,
        features: Features::default(),
    };
    match format {
        PictureFormat::Clouds => clouds_key(key, true),
        PictureFormat::Display | PictureFormat::Linear => key,
    }
}

/// How two pictures are mixed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mix {
    /// Share of the new picture.
    pub share: f64,
    /// Squares of 2^`dither_shift` pixels are rounded alike.
    pub dither_shift: u32,
    /// Pre-exposure of the new picture in that of the old one, where they show clouds alone.
    pub old_scale: f32,
}

/// A second picture of a viewer, that of the cell that it leaves, and its way into the first.
#[derive(Debug)]
pub struct PictureFade {
    old: Picture,
    uniform: wgpu::Buffer,
    group: wgpu::BindGroup,
}

impl PictureFade {
    /// A second picture beside `picture`, which is to hold the new cell's and then the mix.
    #[must_use]
    pub fn new(gpu: &Gpu, pipelines: &Pipelines, picture: &Picture) -> Self {
        let (eye_size, eyes) = picture.eyes();
        let old = Picture::of_format(gpu, pipelines, eye_size, eyes, picture.format(), None);
        let uniform = gpu.uniform_buffer("fade", size_of::<layout::Fade>());
        let buffers = [&uniform, old.pixels(), picture.pixels()];
        Self {
            group: gpu.buffer_group("fade", &pipelines.fade_layout, &buffers),
            old,
            uniform,
        }
    }

    /// Bytes on the device of a picture of a size and format.
    #[must_use]
    pub fn bytes_of(size: FrameSize, format: PictureFormat) -> u64 {
        u64::from(size.pixels()) * format.pixel_bytes()
    }

    /// Where the old cell's picture is to be composited.
    #[must_use]
    pub fn old(&self) -> &Picture {
        &self.old
    }

    /// Records the mix into the new picture, after both were composited.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        mix: Mix,
    ) {
        let Some(pipeline) = pipelines.get(fade_key_of(self.old.format())) else {
            return;
        };
        let (eye_size, eyes) = self.old.eyes();
        let (width, height) = (eye_size.width() * eyes as u32, eye_size.height());
        let fade = layout::Fade {
            share: mix.share.clamp(0.0, 1.0) as f32,
            width,
            height,
            dither_shift: mix.dither_shift,
            eye_width: eye_size.width(),
            old_scale: mix.old_scale,
        };
        gpu.queue
            .write_buffer(&self.uniform, 0, bytemuck::bytes_of(&fade));
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("fade"),
            timestamp_writes: timing.pass(TimedPass::Fade, 1),
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &self.group, &[]);
        for group in 1..4 {
            pass.set_bind_group(group, &pipelines.empty_group, &[]);
        }
        pass.dispatch_workgroups(width.div_ceil(GROUP_WIDTH), height.div_ceil(GROUP_ROWS), 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::read_buffer_blocking;
    use half::f16;

    /// Pixels as the shaders write them.
    fn bytes(pixels: &[[f32; 5]]) -> Vec<u8> {
        let halves = pixels.iter().flat_map(|pixel| pixel.iter().chain([&0.0]));
        halves
            .flat_map(|value| f16::from_f32(*value).to_le_bytes())
            .collect()
    }

    #[test]
    fn clouds_alone_are_mixed_by_light_transmittance_and_where_more_is_hidden() {
        let gpu = Gpu::open_blocking().expect("a device");
        let mut pipelines = Pipelines::new(&gpu);
        let format = PictureFormat::Clouds;
        let key = fade_key_of(format);
        pipelines.prepare(&gpu, key).expect("a pipeline");
        let size = FrameSize::new(3, 1).expect("a size");
        let picture = Picture::of_format(&gpu, &pipelines, size, 1, format, None);
        let fade = PictureFade::new(&gpu, &pipelines, &picture);
        // Colour, transmittance, distance: two clouds; one that was clear sky before; clear sky throughout.
        let old = [
            [1.0, 2.0, 4.0, 0.5, 4.0],
            [0.0, 0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0, 0.0],
        ];
        let new = [
            [8.0, 0.0, 4.0, 0.0, 10.0],
            [4.0, 4.0, 4.0, 0.25, 6.0],
            [0.0, 0.0, 0.0, 1.0, 0.0],
        ];
        gpu.queue.write_buffer(fade.old().pixels(), 0, &bytes(&old));
        gpu.queue.write_buffer(picture.pixels(), 0, &bytes(&new));
        let mut timing = TimingRing::new(&gpu);
        timing.begin();
        let label = wgpu::CommandEncoderDescriptor { label: None };
        let mut encoder = gpu.device.create_command_encoder(&label);
        // What the old picture tells is twice as much where the new one's pre-exposure is twice as high.
        let mix = Mix {
            share: 0.25,
            dither_shift: 0,
            old_scale: 2.0,
        };
        fade.record(&gpu, &mut encoder, &mut timing, &pipelines, mix);
        gpu.queue.submit([encoder.finish()]);
        let mixed = read_buffer_blocking(&gpu, picture.pixels()).expect("pixels");
        // Opacities 0.75 · 0.5 at 4 km and 0.25 · 1 at 10 km: (1.5 + 2.5) / 0.625 km.
        let expected = [
            [3.5, 3.0, 7.0, 0.375, 6.4],
            [1.0, 1.0, 1.0, 0.8125, 6.0],
            [0.0, 0.0, 0.0, 1.0, 0.0],
        ];
        assert_eq!(mixed, bytes(&expected));
    }
}
