//! The device and what touches it: adapter, pipelines, textures of the field, readback, timing. Only modules in here and
//! the render thread record commands.

mod device;
mod field_textures;
mod inventory;
mod map_textures;
mod pipelines;
mod readback;
mod timing;

pub use device::{AdapterReport, Gpu, GpuError};
pub use field_textures::FieldTextures;
pub use inventory::{DeviceInventory, ResourceStats, reads_of};
pub(crate) use map_textures::blend_key;
pub use map_textures::{BlendStep, MapsChange, PlacedSheet, PlacedWeather};
pub use pipelines::{PipelineKey, Pipelines};
pub use readback::{MappedPixels, ReadbackRing, read_buffer_blocking};
pub use timing::{DeviceTime, TimedPass, TimingRing, TimingSums};
