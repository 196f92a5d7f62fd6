//! The pass that fills tiles about a new anchor from those about the old one: nothing is marched.

use super::atlas::{Atlas, TILES_PER_PAGE};
use crate::cache::{Slot, TileKey};
use crate::gpu::{Gpu, PipelineKey, Pipelines, TimedPass, TimingRing};
use skycell_shaders::layout::{self, ResampleWork};
use skycell_shaders::{Features, Kernel};
use wgpu::util::DeviceExt;

/// The pass that fills tiles from others, on domes with a search for what they show or without. It reads sharply: what is
/// blurred here stays so until it is marched.
#[must_use]
pub fn resample_key(domes: bool, parallax: bool) -> PipelineKey {
    PipelineKey {
        kernel: Kernel::ResampleTiles,
        features: Features {
            catmull_rom: true,
            domes,
            above: true,
            inside: true,
            parallax: domes && parallax,
            ..Features::default()
        },
    }
}

/// A tile about the new anchor.
#[derive(Clone, Copy, Debug)]
pub struct ResampledTile {
    /// The tile.
    pub key: TileKey,
    /// Where it is to be stored.
    pub slot: Slot,
    /// Where the old tiles are found.
    pub table: layout::PageTable,
}

/// Tiles of one layer of one cell.
#[derive(Clone, Copy, Debug)]
pub struct ResampleGroup<'a> {
    /// Old tables and the atlas: group 2 of the cached composite.
    pub cached: &'a wgpu::BindGroup,
    /// Old and new addresses.
    pub addresses: layout::Resample,
    /// Whether they are domes.
    pub domes: bool,
    /// The tiles. Their slots are none that the old tables name.
    pub tiles: &'a [ResampledTile],
}

/// Records the filling of a layer's tiles: a working page of them at a time, which is then copied to their slots. Returns how
/// many dispatches that takes.
pub fn record_resample(
    gpu: &Gpu,
    encoder: &mut wgpu::CommandEncoder,
    timing: &mut TimingRing,
    pipelines: &Pipelines,
    atlas: &Atlas,
    group: &ResampleGroup<'_>,
) -> u64 {
    let key = resample_key(group.domes, group.addresses.parallax_steps > 0);
    let Some(pipeline) = pipelines.get(key) else {
        return 0;
    };
    let buffer = |label, contents: &[u8], usage| {
        let descriptor = wgpu::util::BufferInitDescriptor {
            label: Some(label),
            contents,
            usage,
        };
        gpu.device.create_buffer_init(&descriptor)
    };
    let addresses = buffer(
        "resample",
        bytemuck::bytes_of(&group.addresses),
        wgpu::BufferUsages::UNIFORM,
    );
    let [radiance, distance] = atlas.previous_views();
    let mut dispatches = 0;
    for tiles in group.tiles.chunks(TILES_PER_PAGE as usize) {
        let items: Vec<ResampleWork> = (0..)
            .zip(tiles)
            .map(|(place, tile)| ResampleWork {
                tile: [u32::from(tile.key.x), u32::from(tile.key.y)],
                texels_per_side: TileKey::texels_per_side(tile.key.level) as f32,
                place,
                table: tile.table,
            })
            .collect();
        let work = buffer(
            "resample work",
            bytemuck::cast_slice(&items),
            wgpu::BufferUsages::STORAGE,
        );
        let resources = [
            addresses.as_entire_binding(),
            work.as_entire_binding(),
            wgpu::BindingResource::TextureView(&radiance),
            wgpu::BindingResource::TextureView(&distance),
        ];
        let own = gpu.bind_group("resample", &pipelines.resample_layout, &resources);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("resample tiles"),
            timestamp_writes: timing.pass(TimedPass::Resample, tiles.len() as u64),
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &own, &[]);
        pass.set_bind_group(1, &pipelines.empty_group, &[]);
        pass.set_bind_group(2, group.cached, &[]);
        pass.set_bind_group(3, &pipelines.empty_group, &[]);
        pass.dispatch_workgroups(8, 8, tiles.len() as u32);
        drop(pass);
        dispatches += 1;
        for (place, tile) in (0..).zip(tiles) {
            atlas.store(encoder, place, tile.slot);
        }
    }
    dispatches
}
