//! The cloud field on the device.

use super::map_textures::{
    BlendStep, MapTextures, MapsChange, PlacedSheet, PlacedWeather, blend_key,
};
use super::pipelines::Pipelines;
use super::{Gpu, GpuError};
use crate::field::{FieldStore, VOLUME_SEED, VolumeKind, VoxelGrid, load_grid};
use skycell_protocol::Scene;
use skycell_protocol::scene::{DensityModel, GridDensity};
use std::path::Path;

/// Noise volumes, and the maps of up to four layers.
#[derive(Debug)]
pub struct FieldTextures {
    /// Group 1 of the marching kernels.
    pub bind_group: wgpu::BindGroup,
    fixed: FixedTextures,
    /// The grids whose voxels are on the device.
    held_grids: Vec<GridDensity>,
    grids: wgpu::Texture,
    maps: MapTextures,
    /// The noise volumes are on the device: some layer has weather.
    has_noise: bool,
    store: FieldStore,
}

/// Noise and samplers.
#[derive(Debug)]
struct FixedTextures {
    shape: wgpu::TextureView,
    detail: wgpu::TextureView,
    repeat: wgpu::Sampler,
    clamp: wgpu::Sampler,
}

impl FixedTextures {
    fn bind_group(
        &self,
        gpu: &Gpu,
        layout: &wgpu::BindGroupLayout,
        maps: &MapTextures,
        grids: &wgpu::Texture,
    ) -> wgpu::BindGroup {
        let [maps, profile] = maps.views();
        let resources = [
            wgpu::BindingResource::TextureView(&maps),
            wgpu::BindingResource::TextureView(&profile),
            wgpu::BindingResource::TextureView(&self.shape),
            wgpu::BindingResource::TextureView(&self.detail),
            wgpu::BindingResource::Sampler(&self.repeat),
            wgpu::BindingResource::Sampler(&self.clamp),
            wgpu::BindingResource::TextureView(&view(grids)),
        ];
        let entries: Vec<_> = (0..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("field"),
            layout,
            entries: &entries,
        })
    }
}

/// Voxels of all layers in one texture, one behind the other along z.
fn grids_texture(gpu: &Gpu, grids: &[VoxelGrid]) -> wgpu::Texture {
    let largest = |axis: usize| {
        let edges = grids.iter().map(|grid| grid.dimensions[axis]);
        edges.max().unwrap_or(1)
    };
    let slices: u32 = grids.iter().map(|grid| grid.dimensions[2]).sum();
    let texture = texture(
        gpu,
        "grids",
        wgpu::Extent3d {
            width: largest(0),
            height: largest(1),
            depth_or_array_layers: slices.max(1),
        },
        wgpu::TextureDimension::D3,
        wgpu::TextureFormat::R32Float,
    );
    let mut slice = 0;
    for grid in grids {
        let [width, height, depth] = grid.dimensions;
        let extent = wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: depth,
        };
        let bytes = bytemuck::cast_slice(&grid.values);
        upload(gpu, &texture, slice, extent, bytes, 4);
        slice += depth;
    }
    texture
}

/// Shape and detail noise; without a store, texels that stand where bind groups want something.
fn noise(gpu: &Gpu, store: Option<&FieldStore>) -> [wgpu::TextureView; 2] {
    [VolumeKind::Shape, VolumeKind::Detail].map(|kind| {
        let volume = store.map(|store| store.volume(kind, VOLUME_SEED));
        let edge = volume.as_ref().map_or(1, |volume| volume.size);
        let extent = wgpu::Extent3d {
            width: edge,
            height: edge,
            depth_or_array_layers: edge,
        };
        let texture = texture(
            gpu,
            kind.name(),
            extent,
            wgpu::TextureDimension::D3,
            wgpu::TextureFormat::Rg8Unorm,
        );
        if let Some(volume) = volume {
            upload(gpu, &texture, 0, extent, &volume.texels, 2);
        }
        view(&texture)
    })
}

fn view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

impl FieldTextures {
    /// Makes or loads the noise and uploads it. Takes seconds when nothing is kept on disk yet.
    #[must_use]
    pub fn new(gpu: &Gpu, layout: &wgpu::BindGroupLayout, store: FieldStore) -> Self {
        // Made now if it is not kept on disk yet: nobody is to wait for it when a scene first asks for it.
        for kind in [VolumeKind::Shape, VolumeKind::Detail] {
            drop(store.volume(kind, VOLUME_SEED));
        }
        let [shape, detail] = noise(gpu, None);
        let sampler = |mode: wgpu::AddressMode| {
            gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("field"),
                address_mode_u: mode,
                address_mode_v: mode,
                address_mode_w: mode,
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            })
        };
        let fixed = FixedTextures {
            shape,
            detail,
            repeat: sampler(wgpu::AddressMode::Repeat),
            clamp: sampler(wgpu::AddressMode::ClampToEdge),
        };
        let (maps, grids) = (MapTextures::new(gpu), grids_texture(gpu, &[]));
        Self {
            bind_group: fixed.bind_group(gpu, layout, &maps, &grids),
            fixed,
            held_grids: Vec::new(),
            grids,
            maps,
            has_noise: false,
            store,
        }
    }

    /// Puts the voxels of a scene's grids on the device, when others are there; true when the bind group is a new one.
    /// A file that cannot be read any more, though it could when the scene was taken, counts as empty.
    pub fn set_grids(
        &mut self,
        gpu: &Gpu,
        layout: &wgpu::BindGroupLayout,
        scene: &Scene,
        folder: &Path,
    ) -> bool {
        let wanted: Vec<GridDensity> = scene
            .layers()
            .iter()
            .filter_map(|layer| match layer.density() {
                DensityModel::Grid(grid) => Some(grid.clone()),
                _ => None,
            })
            .collect();
        if wanted == self.held_grids {
            return false;
        }
        let voxels: Vec<VoxelGrid> = wanted
            .iter()
            .map(|grid| {
                load_grid(folder, grid).unwrap_or_else(|error| {
                    tracing::error!(%error, "a layer of voxels is empty");
                    VoxelGrid {
                        dimensions: grid.dimensions(),
                        values: vec![0.0; grid.voxels() as usize],
                    }
                })
            })
            .collect();
        self.grids = grids_texture(gpu, &voxels);
        self.bind_group = self.fixed.bind_group(gpu, layout, &self.maps, &self.grids);
        self.held_grids = wanted;
        true
    }

    /// Where noise and maps are kept.
    #[must_use]
    pub fn store(&self) -> &FieldStore {
        &self.store
    }

    /// Puts the maps of weather layers and sheets where they are wanted; files are looked for in a folder. The bind group
    /// is a new one when the change says that the textures are.
    pub fn set_maps(
        &mut self,
        gpu: &Gpu,
        layout: &wgpu::BindGroupLayout,
        wanted: &[PlacedWeather<'_>],
        sheets: &[PlacedSheet],
        folder: &Path,
    ) -> MapsChange {
        let mut change = self.maps.set(gpu, &self.store, folder, wanted, sheets);
        change.content |= self.maps.set_sheets(gpu, &self.store, sheets, change);
        let needs_noise = !wanted.is_empty();
        if needs_noise != self.has_noise {
            let store = needs_noise.then_some(&self.store);
            [self.fixed.shape, self.fixed.detail] = noise(gpu, store);
            self.has_noise = needs_noise;
            change.textures = true;
        }
        if change.textures {
            self.bind_group = self.fixed.bind_group(gpu, layout, &self.maps, &self.grids);
        }
        change
    }

    /// Sky time passes for maps that are on their way to others.
    pub fn advance_maps(&mut self, seconds: f64) {
        self.maps.advance(seconds);
    }

    /// Whether maps are on their way to others.
    #[must_use]
    pub fn maps_are_blending(&self) -> bool {
        self.maps.is_blending()
    }

    /// Lets marches read maps as far on their way as sky time is.
    ///
    /// # Errors
    /// When the pass does not compose.
    pub fn show_maps(
        &mut self,
        gpu: &Gpu,
        pipelines: &mut Pipelines,
    ) -> Result<BlendStep, GpuError> {
        if !self.maps.is_blending() {
            return Ok(BlendStep::None);
        }
        pipelines.prepare(gpu, blend_key())?;
        self.maps.show(gpu, pipelines)
    }
}

pub(super) fn texture(
    gpu: &Gpu,
    label: &str,
    size: wgpu::Extent3d,
    dimension: wgpu::TextureDimension,
    format: wgpu::TextureFormat,
) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension,
        format,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })
}

pub(super) fn upload(
    gpu: &Gpu,
    texture: &wgpu::Texture,
    layer: u32,
    extent: wgpu::Extent3d,
    texels: &[u8],
    bytes_per_texel: u32,
) {
    gpu.queue.write_texture(
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: 0,
            origin: wgpu::Origin3d {
                x: 0,
                y: 0,
                z: layer,
            },
            aspect: wgpu::TextureAspect::All,
        },
        texels,
        wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(extent.width * bytes_per_texel),
            rows_per_image: Some(extent.height),
        },
        extent,
    );
}
