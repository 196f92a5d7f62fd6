//! The cloud field on the device.

use super::Gpu;
use crate::field::{
    FieldStore, MAP_SIZE, PROFILE_SIZE, VolumeKind, VoxelGrid, load_grid, profile_texels,
    skip_distances,
};
use skycell_protocol::Scene;
use skycell_protocol::scene::{DensityModel, GridDensity, WeatherDensity};
use std::collections::HashMap;
use std::path::Path;

/// Seed of the noise volumes: the same for every scene, the scene's seeds are those of its maps.
const VOLUME_SEED: u32 = 1;
/// Layers of the map array.
const MAPS: u32 = 4;

/// Noise volumes, profile and the maps of up to four layers.
#[derive(Debug)]
pub struct FieldTextures {
    /// Group 1 of the marching kernels.
    pub bind_group: wgpu::BindGroup,
    fixed: FixedTextures,
    /// The grids whose voxels are on the device.
    held_grids: Vec<GridDensity>,
    maps: wgpu::Texture,
    /// What each map holds: seed and coverage of the layer whose map it is.
    held: [Option<(u32, f64)>; MAPS as usize],
    coverage_and_type: HashMap<u32, crate::field::WeatherMaps>,
    store: FieldStore,
}

/// What stays for as long as the device does.
#[derive(Debug)]
struct FixedTextures {
    maps: wgpu::TextureView,
    profile: wgpu::TextureView,
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
        grids: &wgpu::Texture,
    ) -> wgpu::BindGroup {
        let resources = [
            wgpu::BindingResource::TextureView(&self.maps),
            wgpu::BindingResource::TextureView(&self.profile),
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

fn view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

impl FieldTextures {
    /// Makes or loads the noise and uploads it. Takes seconds when nothing is kept on disk yet.
    #[must_use]
    pub fn new(gpu: &Gpu, layout: &wgpu::BindGroupLayout, store: FieldStore) -> Self {
        let volume = |kind: VolumeKind| {
            let noise = store.volume(kind, VOLUME_SEED);
            let extent = wgpu::Extent3d {
                width: noise.size,
                height: noise.size,
                depth_or_array_layers: noise.size,
            };
            let texture = texture(
                gpu,
                kind.name(),
                extent,
                wgpu::TextureDimension::D3,
                wgpu::TextureFormat::Rg8Unorm,
            );
            upload(gpu, &texture, 0, extent, &noise.texels, 2);
            texture
        };
        let shape = volume(VolumeKind::Shape);
        let detail = volume(VolumeKind::Detail);
        let profile_extent = wgpu::Extent3d {
            width: PROFILE_SIZE[0],
            height: PROFILE_SIZE[1],
            depth_or_array_layers: 1,
        };
        let profile = texture(
            gpu,
            "profile",
            profile_extent,
            wgpu::TextureDimension::D2,
            wgpu::TextureFormat::R8Unorm,
        );
        upload(gpu, &profile, 0, profile_extent, &profile_texels(), 1);
        let maps_extent = wgpu::Extent3d {
            width: MAP_SIZE,
            height: MAP_SIZE,
            depth_or_array_layers: MAPS,
        };
        let maps = texture(
            gpu,
            "maps",
            maps_extent,
            wgpu::TextureDimension::D2,
            wgpu::TextureFormat::Rgba8Unorm,
        );
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
        let maps_view = maps.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        });
        let fixed = FixedTextures {
            maps: maps_view,
            profile: view(&profile),
            shape: view(&shape),
            detail: view(&detail),
            repeat: sampler(wgpu::AddressMode::Repeat),
            clamp: sampler(wgpu::AddressMode::ClampToEdge),
        };
        Self {
            bind_group: fixed.bind_group(gpu, layout, &grids_texture(gpu, &[])),
            fixed,
            held_grids: Vec::new(),
            maps,
            held: [None; MAPS as usize],
            coverage_and_type: HashMap::new(),
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
        self.bind_group = self
            .fixed
            .bind_group(gpu, layout, &grids_texture(gpu, &voxels));
        self.held_grids = wanted;
        true
    }

    /// Where noise and maps are kept.
    #[must_use]
    pub fn store(&self) -> &FieldStore {
        &self.store
    }

    /// Puts the maps of a weather layer into one of the four places, when they are not there yet.
    pub fn set_map(&mut self, gpu: &Gpu, place: u32, weather: &WeatherDensity) {
        let wanted = Some((weather.seed(), weather.coverage()));
        let Some(held) = self.held.get_mut(place as usize) else {
            return;
        };
        if *held == wanted {
            return;
        }
        *held = wanted;
        let used: Vec<u32> = self.held.iter().flatten().map(|(seed, _)| *seed).collect();
        self.coverage_and_type.retain(|seed, _| used.contains(seed));
        let maps = self
            .coverage_and_type
            .entry(weather.seed())
            .or_insert_with(|| self.store.weather_maps(weather.seed()));
        let skips = skip_distances(&maps.coverage, weather.coverage());
        let texels: Vec<u8> = maps
            .coverage
            .iter()
            .zip(&maps.cloud_type)
            .zip(&skips)
            .flat_map(|((coverage, cloud_type), skip)| [*coverage, *cloud_type, *skip, 0])
            .collect();
        let extent = wgpu::Extent3d {
            width: MAP_SIZE,
            height: MAP_SIZE,
            depth_or_array_layers: 1,
        };
        upload(gpu, &self.maps, place, extent, &texels, 4);
    }
}

fn texture(
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

fn upload(
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
