//! Pictures on their way back from the device: a ring of buffers that are mapped when the device is done with them.

use super::{Gpu, GpuError};
use crate::frame_loop::interface::FramePixels;
use std::sync::mpsc::{self, Receiver, Sender};

/// Buffers of one size that go round: free, written by the device, mapped, read, free.
#[derive(Debug)]
pub struct ReadbackRing {
    bytes: u64,
    free: Vec<wgpu::Buffer>,
    made: usize,
    limit: usize,
    returned: Receiver<wgpu::Buffer>,
    give_back: Sender<wgpu::Buffer>,
}

impl ReadbackRing {
    /// A ring of at most `limit` buffers of `bytes`; none is made before it is needed.
    #[must_use]
    pub fn new(bytes: u64, limit: usize) -> Self {
        let (give_back, returned) = mpsc::channel();
        Self {
            bytes,
            free: Vec::new(),
            made: 0,
            limit,
            returned,
            give_back,
        }
    }

    /// Bytes of a buffer.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// A free buffer, or none while all are under way.
    pub fn take(&mut self, gpu: &Gpu) -> Option<wgpu::Buffer> {
        self.free.extend(self.returned.try_iter());
        if let Some(buffer) = self.free.pop() {
            return Some(buffer);
        }
        if self.made == self.limit {
            return None;
        }
        self.made += 1;
        Some(gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("readback"),
            size: self.bytes,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        }))
    }

    /// Asks for a buffer to be mapped once the device has written it; `done` gets its pixels, on whatever thread polls
    /// the device, or nothing when the device is lost.
    pub fn map(
        &self,
        buffer: wgpu::Buffer,
        done: impl FnOnce(Option<MappedPixels>) + Send + 'static,
    ) {
        let give_back = self.give_back.clone();
        let mapped = buffer.clone();
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            let pixels = result.ok().and_then(|()| {
                let view = mapped.get_mapped_range(..).ok()?;
                Some(MappedPixels {
                    view: Some(view),
                    buffer: mapped,
                    give_back,
                })
            });
            done(pixels);
        });
    }
}

/// The mapped bytes of a picture; dropping them returns the buffer to its ring.
#[derive(Debug)]
pub struct MappedPixels {
    view: Option<wgpu::BufferView>,
    buffer: wgpu::Buffer,
    give_back: Sender<wgpu::Buffer>,
}

impl FramePixels for MappedPixels {
    fn rgba(&self) -> &[u8] {
        self.view.as_deref().unwrap_or_default()
    }
}

impl Drop for MappedPixels {
    fn drop(&mut self) {
        // The view must go before the buffer may be unmapped.
        self.view = None;
        self.buffer.unmap();
        // A ring that is gone needs no buffer back.
        let _ = self.give_back.send(self.buffer.clone());
    }
}

/// Copies a buffer to the CPU and waits for it. For single pictures and tests, never for frames.
///
/// # Errors
/// When the device is lost.
pub fn read_buffer_blocking(gpu: &Gpu, source: &wgpu::Buffer) -> Result<Vec<u8>, GpuError> {
    let mut ring = ReadbackRing::new(source.size(), 1);
    let target = ring
        .take(gpu)
        .ok_or_else(|| GpuError::Device("no buffer".into()))?;
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: None });
    encoder.copy_buffer_to_buffer(source, 0, &target, 0, source.size());
    gpu.queue.submit([encoder.finish()]);
    let (sender, receiver) = mpsc::channel();
    ring.map(target, move |pixels| {
        let _ = sender.send(pixels.map(|p| p.rgba().to_vec()));
    });
    gpu.wait()?;
    receiver
        .try_recv()
        .ok()
        .flatten()
        .ok_or_else(|| GpuError::Device("a buffer was not mapped".into()))
}
