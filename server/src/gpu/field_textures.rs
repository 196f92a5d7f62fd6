//! The cloud field on the device.

use super::Gpu;
use crate::field::{
    FieldStore, MAP_SIZE, PROFILE_SIZE, VolumeKind, profile_texels, skip_distances,
};
use skycell_protocol::scene::WeatherDensity;
use std::collections::HashMap;

/// Seed of the noise volumes: the same for every scene, the scene's seeds are those of its maps.
const VOLUME_SEED: u32 = 1;
/// Layers of the map array.
const MAPS: u32 = 4;

/// Noise volumes, profile and the maps of up to four layers.
#[derive(Debug)]
pub struct FieldTextures {
    /// Group 1 of the marching kernels.
    pub bind_group: wgpu::BindGroup,
    maps: wgpu::Texture,
    /// What each map holds: seed and coverage of the layer whose map it is.
    held: [Option<(u32, f64)>; MAPS as usize],
    coverage_and_type: HashMap<u32, crate::field::WeatherMaps>,
    store: FieldStore,
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
        let resources = [
            wgpu::BindingResource::TextureView(&maps_view),
            wgpu::BindingResource::TextureView(&view(&profile)),
            wgpu::BindingResource::TextureView(&view(&shape)),
            wgpu::BindingResource::TextureView(&view(&detail)),
            wgpu::BindingResource::Sampler(&sampler(wgpu::AddressMode::Repeat)),
            wgpu::BindingResource::Sampler(&sampler(wgpu::AddressMode::ClampToEdge)),
        ];
        let entries: Vec<_> = (0..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        let bind_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("field"),
            layout,
            entries: &entries,
        });
        Self {
            bind_group,
            maps,
            held: [None; MAPS as usize],
            coverage_and_type: HashMap::new(),
            store,
        }
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
