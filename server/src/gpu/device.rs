//! Finding an adapter and opening it.

use std::sync::{Arc, OnceLock};

use crate::frame_loop::interface::AdapterStats;

/// Why there is no device.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter at all.
    #[error(
        "no graphics adapter was found ({0}). On Debian or Ubuntu `apt-get install libvulkan1 mesa-vulkan-drivers` brings \
         a software one; `skycell-server doctor` tells more"
    )]
    NoAdapter(String),
    /// The adapter lacks what rendering needs.
    #[error("the adapter {adapter} cannot render: {missing}")]
    Missing {
        /// Name of the adapter.
        adapter: String,
        /// What it lacks.
        missing: String,
    },
    /// The adapter did not give a device.
    #[error("the adapter {adapter} gave no device: {reason}")]
    NoDevice {
        /// Name of the adapter.
        adapter: String,
        /// What it said.
        reason: String,
    },
    /// A shader does not compose.
    #[error(transparent)]
    Shader(#[from] skycell_shaders::ShaderError),
    /// A view of the cache was asked for where there is none.
    #[error(
        "{0} shows the cache, and this picture is not made from it: its renderer is screen-space, or the camera is not below \
         the clouds"
    )]
    NotShown(&'static str),
    /// Proxies that there are none of.
    #[error(transparent)]
    Proxies(#[from] crate::march::SlabsWithDomes),
    /// The device stopped working.
    #[error("the device was lost or ran into an error: {0}")]
    Device(String),
    /// The render thread could not be started.
    #[error("the render thread did not start: {0}")]
    Thread(#[from] std::io::Error),
}

/// An open device.
#[derive(Clone, Debug)]
pub struct Gpu {
    /// The device.
    pub device: wgpu::Device,
    /// Its only queue.
    pub queue: wgpu::Queue,
    /// Who renders.
    pub info: wgpu::AdapterInfo,
    /// Whether passes can be timed on the device.
    pub timestamps: bool,
    /// Why the device is lost, when it is.
    lost: Arc<OnceLock<String>>,
}

/// What `doctor` tells about one adapter.
#[derive(Clone, Debug, serde::Serialize)]
pub struct AdapterReport {
    /// Name.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Vulkan, Metal or DX12.
    pub backend: String,
    /// Discrete, integrated, virtual or CPU.
    pub device_type: String,
    /// Passes can be timed.
    pub timestamps: bool,
    /// Longest edge of a texture, texels.
    pub texture_edge_max: u32,
    /// Most layers of a texture array (a page of the cache each).
    pub texture_layers_max: u32,
    /// Largest storage buffer, bytes.
    pub storage_buffer_max_bytes: u64,
    /// What rendering needs and the adapter lacks; empty when it can render.
    pub missing: Vec<String>,
}

fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    // Validation layers are a developer's tool; where they are installed they cost more than the rendering.
    descriptor.flags = wgpu::InstanceFlags::empty();
    wgpu::Instance::new(descriptor)
}

/// Distances are interpolated in full floats.
const REQUIRED_FEATURES: wgpu::Features = wgpu::Features::FLOAT32_FILTERABLE;

/// What rendering needs and an adapter lacks.
fn missing(adapter: &wgpu::Adapter) -> Vec<String> {
    let limits = adapter.limits();
    let needed = [
        ("texture edge", limits.max_texture_dimension_2d, 8192),
        ("volume edge", limits.max_texture_dimension_3d, 128),
        ("texture layers", limits.max_texture_array_layers, 16),
        ("bind groups", limits.max_bind_groups, 4),
        (
            "storage textures in a stage",
            limits.max_storage_textures_per_shader_stage,
            2,
        ),
        (
            "storage buffers in a stage",
            limits.max_storage_buffers_per_shader_stage,
            4,
        ),
        (
            "invocations of a workgroup",
            limits.max_compute_invocations_per_workgroup,
            128,
        ),
    ];
    let lacks = needed
        .iter()
        .filter(|(_, has, needs)| has < needs)
        .map(|(what, has, needs)| format!("{what}: {has}, needed {needs}"));
    let features = REQUIRED_FEATURES - adapter.features();
    lacks
        .chain(
            features
                .iter_names()
                .map(|(name, _)| format!("feature {name}")),
        )
        .collect()
}

impl AdapterReport {
    fn new(adapter: &wgpu::Adapter) -> Self {
        let info = adapter.get_info();
        let limits = adapter.limits();
        Self {
            name: info.name,
            driver: format!("{} {}", info.driver, info.driver_info),
            backend: info.backend.to_string(),
            device_type: format!("{:?}", info.device_type),
            timestamps: adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY),
            texture_edge_max: limits.max_texture_dimension_2d,
            texture_layers_max: limits.max_texture_array_layers,
            storage_buffer_max_bytes: limits.max_storage_buffer_binding_size,
            missing: missing(adapter),
        }
    }

    /// Every adapter of this machine.
    pub async fn all() -> Vec<Self> {
        let adapters = instance().enumerate_adapters(wgpu::Backends::all()).await;
        adapters.iter().map(Self::new).collect()
    }
}

/// What nobody waited for went wrong. A device that is out of memory, or fails inside, is taken for lost; whatever is said of
/// one that is lost already is its echo. All else is a mistake of this program.
fn uncaptured(lost: &OnceLock<String>, error: &wgpu::Error) {
    if lost.get().is_some() {
        tracing::debug!(%error, "a lost device");
        return;
    }
    match error {
        wgpu::Error::OutOfMemory { .. } | wgpu::Error::Internal { .. } => {
            let _ = lost.set(error.to_string());
        }
        wgpu::Error::Validation { .. } => panic!("the device refuses what it was told: {error}"),
    }
}

impl Gpu {
    /// Opens the best adapter: a real GPU before a software one.
    ///
    /// # Errors
    /// When there is none, or none that can render.
    pub async fn open() -> Result<Self, GpuError> {
        let adapter = instance()
            .request_adapter(&wgpu::RequestAdapterOptions {
                power_preference: wgpu::PowerPreference::HighPerformance,
                ..Default::default()
            })
            .await
            .map_err(|error| GpuError::NoAdapter(error.to_string()))?;
        let info = adapter.get_info();
        let missing = missing(&adapter);
        if !missing.is_empty() {
            return Err(GpuError::Missing {
                adapter: info.name,
                missing: missing.join("; "),
            });
        }
        let timestamps = adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        let mut required_features = REQUIRED_FEATURES;
        required_features.set(wgpu::Features::TIMESTAMP_QUERY, timestamps);
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                label: Some("skycell"),
                required_features,
                required_limits: adapter.limits(),
                ..Default::default()
            })
            .await
            .map_err(|error| GpuError::NoDevice {
                adapter: info.name.clone(),
                reason: error.to_string(),
            })?;
        let lost = Arc::<OnceLock<String>>::default();
        let told = Arc::clone(&lost);
        device.set_device_lost_callback(move |reason, message| {
            let _ = told.set(format!("{reason:?}, {message}"));
        });
        let told = Arc::clone(&lost);
        device.on_uncaptured_error(Arc::new(move |error| uncaptured(&told, &error)));
        Ok(Self {
            device,
            queue,
            info,
            timestamps,
            lost,
        })
    }

    /// Why the device is lost; none as long as it works. A lost device answers nothing any more: it has to be opened anew,
    /// and must not be polled, for that would free mapped memory that others still read.
    #[must_use]
    pub fn loss(&self) -> Option<&str> {
        self.lost.get().map(String::as_str)
    }

    /// Takes the device for lost.
    pub fn give_up(&self, reason: String) {
        let _ = self.lost.set(reason);
    }

    /// As [`Self::open`], for threads without a runtime.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_blocking() -> Result<Self, GpuError> {
        // wgpu's native futures are ready at once: there is nothing to wait for.
        futures_util::FutureExt::now_or_never(Self::open())
            .unwrap_or_else(|| Err(GpuError::NoAdapter("the adapter did not answer".into())))
    }

    /// A buffer of `bytes`, which hold nothing yet. The label says what it is for: the inventory goes by it.
    #[must_use]
    pub fn buffer(&self, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes,
            usage,
            mapped_at_creation: false,
        })
    }

    /// A buffer for a uniform of `bytes`.
    #[must_use]
    pub fn uniform_buffer(&self, label: &str, bytes: usize) -> wgpu::Buffer {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        self.buffer(label, bytes as u64, usage)
    }

    /// A bind group whose bindings are numbered from 0 on, in the order of the resources.
    #[must_use]
    pub fn bind_group(
        &self,
        label: &str,
        layout: &wgpu::BindGroupLayout,
        resources: &[wgpu::BindingResource<'_>],
    ) -> wgpu::BindGroup {
        let entries: Vec<_> = (0..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry {
                binding,
                resource: resource.clone(),
            })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(label),
            layout,
            entries: &entries,
        })
    }

    /// The same of whole buffers.
    #[must_use]
    pub fn buffer_group(
        &self,
        label: &str,
        layout: &wgpu::BindGroupLayout,
        buffers: &[&wgpu::Buffer],
    ) -> wgpu::BindGroup {
        let resources: Vec<_> = buffers.iter().map(|b| b.as_entire_binding()).collect();
        self.bind_group(label, layout, &resources)
    }

    /// Whether a software driver renders.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// The adapter as figures carry it.
    #[must_use]
    pub fn adapter_stats(&self) -> AdapterStats {
        AdapterStats {
            name: self.info.name.clone(),
            driver: format!("{} {}", self.info.driver, self.info.driver_info),
            backend: self.info.backend.to_string(),
            device_type: format!("{:?}", self.info.device_type),
        }
    }

    /// Waits until everything that was submitted is done.
    ///
    /// # Errors
    /// When the device is lost.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map(|_| ())
            .map_err(|error| GpuError::Device(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_is_destroyed_is_known_to_be_lost() {
        let gpu = Gpu::open_blocking().expect("a device");
        assert_eq!(gpu.loss(), None);
        gpu.device.destroy();
        // Nothing is mapped, so it may be polled.
        let _ = gpu.device.poll(wgpu::PollType::Poll);
        assert!(
            gpu.loss()
                .is_some_and(|reason| reason.contains("Destroyed"))
        );
        // What is made on it is no panic.
        let buffer = gpu.uniform_buffer("of a lost device", 16);
        gpu.queue.write_buffer(&buffer, 0, &[0; 16]);
        gpu.queue.submit([]);
    }
}
