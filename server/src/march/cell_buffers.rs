//! A cell on the device: its scene, where its rays start, where its tiles are found.

use super::atlas::Atlas;
use super::proxies::PROXIES_MAX;
use super::sun_columns::{SunBinding, SunVolumeTexture};
use super::texels::write;
use crate::cache::{LEVELS, NO_TILE, PageTables, TileKey};
use crate::gpu::{Gpu, Pipelines};
use glam::DVec3;
use skycell_shaders::{Features, layout};

/// Entries of a row of the page tables, as in `composite/cached.wgsl`.
const TABLE_WIDTH: u32 = 1024;

/// Buffers and bind groups of one cell.
#[derive(Debug)]
pub struct CellBuffers {
    scene: wgpu::Buffer,
    pub(super) reference: wgpu::Buffer,
    /// Group 0 of every kernel.
    pub scene_group: wgpu::BindGroup,
    field_group: wgpu::BindGroup,
    tables: wgpu::Texture,
    offsets: [Vec<u32>; PROXIES_MAX],
    cached_group: Option<(u64, wgpu::BindGroup)>,
    sampler: wgpu::Sampler,
    last_scene: Option<layout::Scene>,
    /// The sun volume that the cell's rays read; the cone without.
    pub(crate) sun: Option<SunBinding>,
}

fn buffer(gpu: &Gpu, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: bytes,
        usage: usage | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// Page tables as rows of entries; tables of all levels for all proxies have at most 2 800 rows.
fn table_texture(gpu: &Gpu, rows: u32) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("page tables"),
        size: wgpu::Extent3d {
            width: TABLE_WIDTH,
            height: rows,
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::R32Uint,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })
}

impl CellBuffers {
    /// Makes the buffers; scene and reference must be written before use.
    #[must_use]
    pub fn new(gpu: &Gpu, pipelines: &Pipelines, field_group: &wgpu::BindGroup) -> Self {
        let scene = buffer(
            gpu,
            "scene",
            size_of::<layout::Scene>() as u64,
            wgpu::BufferUsages::UNIFORM,
        );
        let reference = buffer(
            gpu,
            "reference",
            size_of::<layout::Reference>() as u64,
            wgpu::BufferUsages::UNIFORM,
        );
        let scene_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("scene"),
            layout: &pipelines.scene_layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: scene.as_entire_binding(),
            }],
        });
        let mut cell = Self {
            scene,
            reference,
            scene_group,
            field_group: field_group.clone(),
            tables: table_texture(gpu, 1),
            offsets: Default::default(),
            cached_group: None,
            sampler: gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("atlas"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
            last_scene: None,
            sun: None,
        };
        cell.set_tables(gpu, &[]);
        cell
    }

    /// Other textures of the field.
    pub fn set_field_group(&mut self, field_group: &wgpu::BindGroup) {
        self.field_group = field_group.clone();
    }

    /// Group 1 of the marching kernels.
    #[must_use]
    pub fn field_group(&self) -> &wgpu::BindGroup {
        &self.field_group
    }

    /// Writes the scene, when it differs from what is there.
    pub fn set_scene(&mut self, gpu: &Gpu, scene: &layout::Scene) {
        if self.last_scene.as_ref() != Some(scene) {
            write(gpu, &self.scene, scene);
            self.last_scene = Some(*scene);
        }
    }

    /// The scene as it was last written.
    #[must_use]
    pub fn scene(&self) -> Option<&layout::Scene> {
        self.last_scene.as_ref()
    }

    /// Lets the cell read a sun volume, whose textures are told apart by a number, as it is seen from its frame.
    pub fn bind_sun(
        &mut self,
        gpu: &Gpu,
        pipelines: &Pipelines,
        volume: &SunVolumeTexture,
        number: u64,
        layers: u32,
        seen: &layout::SunVolume,
    ) {
        let held = self.sun.take().filter(|sun| sun.texture == number);
        let mut sun = held.unwrap_or_else(|| {
            SunBinding::new(gpu, pipelines, &self.scene, volume, number, layers)
        });
        sun.set(gpu, seen);
        self.sun = Some(sun);
    }

    /// What a marching kernel is specialised to in this cell.
    #[must_use]
    pub fn march_features(&self, layer: Features) -> Features {
        Features {
            sun_layers: self.sun.as_ref().map_or(0, |sun| sun.layers),
            ..layer
        }
    }

    /// Group 0 of a marching kernel with these features.
    #[must_use]
    pub fn march_group(&self, features: Features) -> &wgpu::BindGroup {
        match &self.sun {
            Some(sun) if features.sun_layers > 0 => &sun.group,
            _ => &self.scene_group,
        }
    }

    /// Writes where rays start, in the cell's frame.
    pub fn set_reference(&self, gpu: &Gpu, position: DVec3) {
        let value = layout::Reference {
            position: position.as_vec3().to_array(),
            ..Default::default()
        };
        write(gpu, &self.reference, &value);
    }

    /// Writes the page tables of the proxies.
    pub fn set_tables(&mut self, gpu: &Gpu, proxies: &[PageTables]) {
        let mut entries = Vec::new();
        self.offsets = Default::default();
        for (proxy, tables) in proxies.iter().enumerate().take(PROXIES_MAX) {
            let start = entries.len() as u32;
            self.offsets[proxy] = tables.level_offsets.iter().map(|o| o + start).collect();
            entries.extend_from_slice(&tables.entries);
        }
        entries.resize(entries.len().max(1), NO_TILE);
        entries.resize(
            entries.len().next_multiple_of(TABLE_WIDTH as usize),
            NO_TILE,
        );
        let rows = entries.len() as u32 / TABLE_WIDTH;
        if rows > self.tables.height() {
            self.tables = table_texture(gpu, rows);
            self.cached_group = None;
        }
        gpu.queue.write_texture(
            self.tables.as_image_copy(),
            bytemuck::cast_slice(&entries),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(4 * TABLE_WIDTH),
                rows_per_image: None,
            },
            wgpu::Extent3d {
                width: TABLE_WIDTH,
                height: rows,
                depth_or_array_layers: 1,
            },
        );
    }

    /// Where a proxy's table for a level is; beyond the levels that have tiles the finest one that has.
    #[must_use]
    pub fn table(&self, proxy: usize, level: u8) -> layout::PageTable {
        let offsets = self.offsets.get(proxy).map_or(&[][..], Vec::as_slice);
        let level = level
            .min(LEVELS - 1)
            .min(offsets.len().saturating_sub(1) as u8);
        match offsets.get(usize::from(level)) {
            Some(offset) => layout::PageTable {
                offset: *offset,
                tiles_per_side: TileKey::tiles_per_side(level),
                level: u32::from(level),
                pad_level: 0,
            },
            // A table of no tiles: clear sky.
            None => layout::PageTable::default(),
        }
    }

    /// Group 2 of the cached composite.
    pub fn cached_group(
        &mut self,
        gpu: &Gpu,
        pipelines: &Pipelines,
        atlas: &Atlas,
    ) -> &wgpu::BindGroup {
        let version = atlas.version();
        if self
            .cached_group
            .as_ref()
            .is_some_and(|(held, _)| *held != version)
        {
            self.cached_group = None;
        }
        let (tables, sampler) = (&self.tables, &self.sampler);
        let (_, group) = self.cached_group.get_or_insert_with(|| {
            let layout = &pipelines.cached_layout;
            (
                version,
                cached_group(gpu, layout, tables, sampler, atlas, None),
            )
        });
        group
    }

    /// The same for a viewer in a layer, whose near part is in `marched`.
    #[must_use]
    pub fn inside_group(
        &self,
        gpu: &Gpu,
        pipelines: &Pipelines,
        atlas: &Atlas,
        marched: &wgpu::Buffer,
    ) -> wgpu::BindGroup {
        let (tables, sampler) = (&self.tables, &self.sampler);
        let layout = &pipelines.inside_layout;
        cached_group(gpu, layout, tables, sampler, atlas, Some(marched))
    }
}

fn cached_group(
    gpu: &Gpu,
    layout: &wgpu::BindGroupLayout,
    tables: &wgpu::Texture,
    sampler: &wgpu::Sampler,
    atlas: &Atlas,
    marched: Option<&wgpu::Buffer>,
) -> wgpu::BindGroup {
    let [radiance, distance] = atlas.views();
    let tables = tables.create_view(&wgpu::TextureViewDescriptor::default());
    let origins = atlas.origins_view();
    let mut resources = vec![
        wgpu::BindingResource::TextureView(&tables),
        wgpu::BindingResource::TextureView(&radiance),
        wgpu::BindingResource::TextureView(&distance),
        wgpu::BindingResource::Sampler(sampler),
        wgpu::BindingResource::TextureView(&origins),
    ];
    resources.extend(marched.map(wgpu::Buffer::as_entire_binding));
    gpu.bind_group("cached", layout, &resources)
}
