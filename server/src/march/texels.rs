//! The pass that fills tiles: one ray per texel.

use super::atlas::{Atlas, TILES_PER_PAGE};
use super::cell_buffers::CellBuffers;
use super::frame::CellFrame;
use crate::cache::{TileKey, TileUpdate};
use crate::gpu::{Gpu, PipelineKey, Pipelines, TimedPass, TimingRing};
use bytemuck::bytes_of;
use glam::DVec3;
use skycell_shaders::layout::TileWork;
use skycell_shaders::{Features, Kernel};

/// Most tiles of one batch: the working page's.
pub const BATCH_TILES_MAX: usize = TILES_PER_PAGE as usize;
/// Items between the starts of two groups, so that each starts at an aligned offset.
const GROUP_ALIGNMENT: usize = 8;
/// Groups (a proxy of a cell each) that fit into a batch.
const GROUPS_MAX: usize = 64;

/// What the pass is specialised to for a layer.
#[must_use]
pub fn texels_key(layer: Features) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::MarchTexels,
        features: Features {
            layers: 1,
            catmull_rom: false,
            linear_output: false,
            screen_space: false,
            above: true,
            inside: true,
            ..layer
        },
    }
}

/// Updates of one proxy of one cell.
pub struct TexelGroup<'a> {
    /// The cell on the device.
    pub cell: &'a CellBuffers,
    /// What the layer's pipeline is specialised to.
    pub features: Features,
    /// Index among the scene's proxies.
    pub proxy: u32,
    /// The cell's frame.
    pub frame: CellFrame,
    /// Where the wind has carried the layer, level.
    pub drift_m: DVec3,
    /// The tiles.
    pub updates: Vec<TileUpdate>,
}

impl TexelGroup<'_> {
    /// A place of the frame that drifts with the layer, in the cell's.
    fn in_cell(&self, drifting_m: DVec3) -> [f32; 3] {
        let world_m = drifting_m + self.drift_m;
        self.frame.from_world(world_m).as_vec3().to_array()
    }
}

/// The buffer of work of one batch at a time.
#[derive(Debug)]
pub struct TexelMarch {
    work: wgpu::Buffer,
}

impl TexelMarch {
    /// Makes the buffer.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        let items = BATCH_TILES_MAX + GROUPS_MAX * GROUP_ALIGNMENT;
        Self {
            work: gpu.buffer(
                "tile work",
                (items * size_of::<TileWork>()) as u64,
                wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            ),
        }
    }

    /// Records one batch and returns how many dispatches it takes. Groups beyond [`BATCH_TILES_MAX`] tiles in all are
    /// the caller's mistake and are left out.
    pub fn record(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timing: &mut TimingRing,
        pipelines: &Pipelines,
        atlas: &Atlas,
        groups: &[TexelGroup<'_>],
    ) -> u64 {
        let mut items: Vec<TileWork> = Vec::new();
        let mut ranges = Vec::new();
        let mut place = 0u32;
        for group in groups.iter().take(GROUPS_MAX) {
            items.resize(
                items.len().next_multiple_of(GROUP_ALIGNMENT),
                TileWork::default(),
            );
            let start = items.len();
            let first_place = place;
            for update in &group.updates {
                if update.weight < 1.0 {
                    atlas.keep_previous(encoder, update.slot, place);
                }
                items.push(TileWork {
                    tile: [u32::from(update.key.x), u32::from(update.key.y)],
                    texels_per_side: TileKey::texels_per_side(update.key.level) as f32,
                    slot: update.slot.0,
                    origin: group.in_cell(update.from),
                    proxy: group.proxy,
                    old_origin: group.in_cell(update.old_from),
                    sample_index: update.sample_index,
                    weight: update.weight,
                    previous: place,
                    ..TileWork::default()
                });
                place += 1;
            }
            if (place as usize) <= BATCH_TILES_MAX {
                ranges.push((group, start, (place - first_place) as usize));
            }
        }
        gpu.queue
            .write_buffer(&self.work, 0, bytemuck::cast_slice(&items));
        let [radiance, distance] = atlas.views();
        let [previous_radiance, previous_distance] = atlas.previous_views();
        let bind_groups: Vec<wgpu::BindGroup> = ranges
            .iter()
            .map(|(_, start, count)| {
                let size = size_of::<TileWork>();
                let resources = [
                    wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                        buffer: &self.work,
                        offset: (start * size) as u64,
                        size: std::num::NonZeroU64::new((count * size) as u64),
                    }),
                    wgpu::BindingResource::TextureView(&previous_radiance),
                    wgpu::BindingResource::TextureView(&previous_distance),
                    wgpu::BindingResource::TextureView(&radiance),
                    wgpu::BindingResource::TextureView(&distance),
                    pipelines.read_counter.as_entire_binding(),
                ];
                gpu.bind_group("texels", &pipelines.texels_layout, &resources)
            })
            .collect();
        let mut dispatches = 0;
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("march texels"),
            timestamp_writes: timing.pass(TimedPass::Cache, u64::from(place)),
        });
        for ((group, _, count), bind_group) in ranges.iter().zip(&bind_groups) {
            let Some(pipeline) = pipelines.get(texels_key(group.features)) else {
                continue;
            };
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, group.cell.march_group(group.features), &[]);
            pass.set_bind_group(1, group.cell.field_group(), &[]);
            pass.set_bind_group(2, bind_group, &[]);
            pass.set_bind_group(3, &pipelines.empty_group, &[]);
            pass.dispatch_workgroups(8, 8, *count as u32);
            dispatches += 1;
        }
        dispatches
    }
}

/// A uniform's bytes into its buffer.
pub(super) fn write<T: bytemuck::Pod>(gpu: &Gpu, buffer: &wgpu::Buffer, value: &T) {
    gpu.queue.write_buffer(buffer, 0, bytes_of(value));
}
