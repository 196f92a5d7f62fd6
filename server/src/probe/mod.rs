//! The shaders' functions at given points: what tests hold against their f64 twins and what the probe command prints.

pub mod command;
mod field;
mod functions;

pub use field::{FieldPoint, FieldProbe, FieldQuestion, FieldValue};
pub use functions::{FunctionPoint, FunctionProbe, FunctionQuestion};

use crate::gpu::{Gpu, GpuError, read_buffer_blocking};
use bytemuck::Pod;

/// Buffers of one round of questions.
struct Round {
    points: wgpu::Buffer,
    values: wgpu::Buffer,
    question: wgpu::Buffer,
    groups: u32,
}

impl Round {
    /// Uploads points; `value_bytes` is the size of an answer.
    fn new<P: Pod>(gpu: &Gpu, points: &[P], value_bytes: u64, question: [u32; 4]) -> Self {
        use wgpu::BufferUsages as Usage;
        let buffer = |label, size: u64, usage| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: size.max(64),
                usage,
                mapped_at_creation: false,
            })
        };
        let bytes: &[u8] = bytemuck::cast_slice(points);
        let round = Self {
            points: buffer(
                "probe points",
                bytes.len() as u64,
                Usage::STORAGE | Usage::COPY_DST,
            ),
            values: buffer(
                "probe values",
                points.len() as u64 * value_bytes,
                Usage::STORAGE | Usage::COPY_SRC,
            ),
            question: buffer("probe question", 16, Usage::UNIFORM | Usage::COPY_DST),
            groups: (points.len() as u32).div_ceil(64),
        };
        gpu.queue.write_buffer(&round.points, 0, bytes);
        gpu.queue
            .write_buffer(&round.question, 0, bytemuck::cast_slice(&question));
        round
    }

    fn read<V: Pod>(&self, gpu: &Gpu, count: usize) -> Result<Vec<V>, GpuError> {
        let bytes = read_buffer_blocking(gpu, &self.values)?;
        let mut values: Vec<V> = bytemuck::pod_collect_to_vec(&bytes);
        values.truncate(count);
        Ok(values)
    }
}

fn group(gpu: &Gpu, layout: &wgpu::BindGroupLayout, buffers: &[&wgpu::Buffer]) -> wgpu::BindGroup {
    gpu.buffer_group("probe", layout, buffers)
}
