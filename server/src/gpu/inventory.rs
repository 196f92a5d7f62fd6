//! What stands on the device and what it has done, by purpose: shows that what a scene lacks has no buffer, no pass and
//! no read.

use super::pipelines::PipelineKey;
use super::timing::{TimedPass, TimingRing};
use super::{Gpu, GpuError, Pipelines};
use schemars::JsonSchema;
use serde::Serialize;
use skycell_shaders::{Kernel, compose, resources_of};
use std::collections::{BTreeMap, BTreeSet};

/// Buffers and textures of one purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct ResourceStats {
    /// How many there are.
    pub count: u64,
    /// Device memory that they take, as the allocator rounds it.
    pub bytes: u64,
}

/// The device's memory, pipelines and passes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct DeviceInventory {
    /// Buffers and textures by label, as the device's allocator holds them: not what was asked for, but what is there.
    /// Empty where the backend cannot tell.
    pub resources: BTreeMap<String, ResourceStats>,
    /// Pipelines by entry point.
    pub pipelines: BTreeMap<&'static str, u64>,
    /// Passes recorded since the start, by purpose.
    pub passes: BTreeMap<&'static str, u64>,
}

impl DeviceInventory {
    /// Takes stock.
    #[must_use]
    pub fn of(gpu: &Gpu, pipelines: &Pipelines, timing: &TimingRing) -> Self {
        let mut resources: BTreeMap<String, ResourceStats> = BTreeMap::new();
        if let Some(report) = gpu.device.generate_allocator_report() {
            for allocation in report.allocations {
                let stats = resources.entry(allocation.name).or_default();
                stats.count += 1;
                stats.bytes += allocation.size;
            }
        }
        let mut made = BTreeMap::new();
        for key in pipelines.keys() {
            *made.entry(key.kernel.entry_point()).or_default() += 1;
        }
        let passes = TimedPass::ALL
            .into_iter()
            .map(|pass| (pass.name(), timing.passes(pass)))
            .filter(|(_, count)| *count > 0)
            .collect();
        Self {
            resources,
            pipelines: made,
            passes,
        }
    }

    /// Whether a buffer or texture of this label is there.
    #[must_use]
    pub fn has(&self, label: &str) -> bool {
        self.resources.contains_key(label)
    }
}

/// What the made pipelines of a kernel can read or write: names of the bound resources in the WGSL that are reached from
/// the entry point. Composes the kernels anew; for reports and tests.
///
/// # Errors
/// When a kernel does not compose.
pub fn reads_of(
    pipelines: &Pipelines,
) -> Result<BTreeMap<&'static str, BTreeSet<String>>, GpuError> {
    let mut reads: BTreeMap<&'static str, BTreeSet<String>> = BTreeMap::new();
    let keys: Vec<PipelineKey> = pipelines
        .keys()
        .filter(|key| !matches!(key.kernel, Kernel::Probe | Kernel::ProbeField))
        .copied()
        .collect();
    for key in keys {
        let module = compose(key.kernel, key.features)?;
        reads
            .entry(key.kernel.entry_point())
            .or_default()
            .extend(resources_of(&module).map_err(GpuError::Device)?);
    }
    Ok(reads)
}
