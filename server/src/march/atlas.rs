//! The textures that hold every tile of every cell.

use crate::cache::{BYTES_PER_TEXEL, Slot, TEXELS_PER_TILE, TILE_STRIDE};
use crate::gpu::Gpu;
use glam::DVec3;

/// Tiles of a page, one layer of the texture array: 6 MiB. They stand in one column, so that a tile's rows follow each
/// other in memory where textures are stored row by row: with tiles side by side, rows would be apart by powers of two
/// and evict each other from a CPU's caches.
pub const TILES_PER_PAGE: u32 = 128;
/// Width and height of a page; no more than what every device takes.
const PAGE_WIDTH: u32 = TILE_STRIDE;
const PAGE_HEIGHT: u32 = TILES_PER_PAGE * TILE_STRIDE;

/// Radiance and transmittance in half floats, which bilinear hardware reads, and distance in a float beside it.
///
/// A texel holds scalars: single scattering without its phase, the higher octaves, ambient light, transmittance, mean
/// distance. Cloud droplets are grey, so colour is a factor outside; the sun's colour and the viewer's own phase are
/// multiplied in by the compositor, and changing either marches nothing.
#[derive(Debug)]
pub struct Atlas {
    radiance: wgpu::Texture,
    distance: wgpu::Texture,
    previous_radiance: wgpu::Texture,
    previous_distance: wgpu::Texture,
    origins: wgpu::Texture,
    pages: u32,
    version: u64,
}

/// Pages of an atlas; of none, a texel that stands where bind groups want something.
fn texture(gpu: &Gpu, label: &str, pages: u32, format: wgpu::TextureFormat) -> wgpu::Texture {
    let size = if pages == 0 {
        wgpu::Extent3d::default()
    } else {
        wgpu::Extent3d {
            width: PAGE_WIDTH,
            height: PAGE_HEIGHT,
            depth_or_array_layers: pages,
        }
    };
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::STORAGE_BINDING
            | wgpu::TextureUsages::COPY_SRC
            | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })
}

const RADIANCE: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
const DISTANCE: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;
/// Slots of a row of origins, as in `composite/cached.wgsl`.
const ORIGINS_WIDTH: u32 = 256;

/// Where the rays of slots' texels started, a texel a slot.
fn origins(gpu: &Gpu, pages: u32) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("slot origins"),
        size: wgpu::Extent3d {
            width: ORIGINS_WIDTH,
            height: (pages * TILES_PER_PAGE).div_ceil(ORIGINS_WIDTH).max(1),
            depth_or_array_layers: 1,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba32Float,
        usage: wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::COPY_SRC
            | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })
}

/// A tile's texels.
const TILE: wgpu::Extent3d = wgpu::Extent3d {
    width: TILE_STRIDE,
    height: TILE_STRIDE,
    depth_or_array_layers: 1,
};

/// Where a tile of a page begins.
fn row_of_tile(index: u32, page: u32) -> wgpu::Origin3d {
    wgpu::Origin3d {
        x: 0,
        y: index * TILE_STRIDE,
        z: page,
    }
}

/// Where a slot's tile begins.
fn origin_of(slot: Slot) -> wgpu::Origin3d {
    row_of_tile(slot.0 % TILES_PER_PAGE, slot.0 / TILES_PER_PAGE)
}

/// Which texel tells where a slot's rays started.
fn place_of_origin(slot: Slot) -> wgpu::Origin3d {
    wgpu::Origin3d {
        x: slot.0 % ORIGINS_WIDTH,
        y: slot.0 / ORIGINS_WIDTH,
        z: 0,
    }
}

fn at(texture: &wgpu::Texture, origin: wgpu::Origin3d) -> wgpu::TexelCopyTextureInfo<'_> {
    wgpu::TexelCopyTextureInfo {
        texture,
        mip_level: 0,
        origin,
        aspect: wgpu::TextureAspect::All,
    }
}

impl Atlas {
    /// An atlas without pages.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            radiance: texture(gpu, "atlas radiance", 0, RADIANCE),
            distance: texture(gpu, "atlas distance", 0, DISTANCE),
            previous_radiance: texture(gpu, "previous radiance", 0, RADIANCE),
            previous_distance: texture(gpu, "previous distance", 0, DISTANCE),
            origins: origins(gpu, 0),
            pages: 0,
            version: 0,
        }
    }

    /// Most tiles that a device can hold.
    #[must_use]
    pub fn tiles_max(gpu: &Gpu) -> u32 {
        // Entries of page tables have 16 bits for a slot.
        (gpu.device.limits().max_texture_array_layers * TILES_PER_PAGE).min(0xffff)
    }

    /// Makes room for slots below `slots`, or gives all pages back when there are none. Contents stay.
    pub fn fit(&mut self, gpu: &Gpu, slots: u32) {
        let wanted = slots.div_ceil(TILES_PER_PAGE);
        if wanted > self.pages || (wanted == 0 && self.pages > 0) {
            self.resize(gpu, wanted, &[]);
        }
    }

    /// Whether tiles would fit into half of the pages.
    #[must_use]
    pub fn is_half_empty(&self, tiles: u32) -> bool {
        2 * tiles.div_ceil(TILES_PER_PAGE) <= self.pages && self.pages > 1
    }

    /// Gives the pages from `slots` on back. Tiles that were moved for that come from where they were.
    pub fn shrink(&mut self, gpu: &Gpu, slots: u32, moved: &[(Slot, Slot)]) {
        self.resize(gpu, slots.div_ceil(TILES_PER_PAGE), moved);
    }

    /// Other textures, with what is in the pages of both, and tiles that were moved.
    fn resize(&mut self, gpu: &Gpu, wanted: u32, moved: &[(Slot, Slot)]) {
        let radiance = texture(gpu, "atlas radiance", wanted, RADIANCE);
        let distance = texture(gpu, "atlas distance", wanted, DISTANCE);
        let kept = self.pages.min(wanted);
        let slot_origins = origins(gpu, wanted);
        if kept > 0 {
            let mut encoder = gpu
                .device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                    label: Some("resize atlas"),
                });
            let extent = wgpu::Extent3d {
                width: PAGE_WIDTH,
                height: PAGE_HEIGHT,
                depth_or_array_layers: kept,
            };
            for (old, new) in [(&self.radiance, &radiance), (&self.distance, &distance)] {
                encoder.copy_texture_to_texture(old.as_image_copy(), new.as_image_copy(), extent);
                for (from, to) in moved {
                    encoder.copy_texture_to_texture(
                        at(old, origin_of(*from)),
                        at(new, origin_of(*to)),
                        TILE,
                    );
                }
            }
            let rows = self.origins.height().min(slot_origins.height());
            encoder.copy_texture_to_texture(
                self.origins.as_image_copy(),
                slot_origins.as_image_copy(),
                wgpu::Extent3d {
                    width: ORIGINS_WIDTH,
                    height: rows,
                    depth_or_array_layers: 1,
                },
            );
            for (from, to) in moved {
                encoder.copy_texture_to_texture(
                    at(&self.origins, place_of_origin(*from)),
                    at(&slot_origins, place_of_origin(*to)),
                    wgpu::Extent3d::default(),
                );
            }
            gpu.queue.submit([encoder.finish()]);
        } else {
            let working = wanted.min(1);
            self.previous_radiance = texture(gpu, "previous radiance", working, RADIANCE);
            self.previous_distance = texture(gpu, "previous distance", working, DISTANCE);
        }
        self.radiance = radiance;
        self.distance = distance;
        self.origins = slot_origins;
        self.pages = wanted;
        self.version += 1;
    }

    /// Changes whenever views of the atlas are out of date.
    #[must_use]
    pub fn version(&self) -> u64 {
        self.version
    }

    /// Bytes on the device, the working page included.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let working = self.pages.min(1);
        u64::from((self.pages + working) * TILES_PER_PAGE) * TEXELS_PER_TILE * BYTES_PER_TEXEL
    }

    /// Radiance and distance of all pages.
    #[must_use]
    pub fn views(&self) -> [wgpu::TextureView; 2] {
        [&self.radiance, &self.distance].map(|texture| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..Default::default()
            })
        })
    }

    /// Where the rays of slots' texels started.
    #[must_use]
    pub fn origins_view(&self) -> wgpu::TextureView {
        self.origins
            .create_view(&wgpu::TextureViewDescriptor::default())
    }

    /// Says where the rays of a slot's texels started, as seen from the anchor, m.
    pub fn set_origin(&self, gpu: &Gpu, slot: Slot, from_anchor: DVec3) {
        let [x, y, z] = from_anchor.as_vec3().to_array();
        gpu.queue.write_texture(
            at(&self.origins, place_of_origin(slot)),
            bytemuck::cast_slice(&[x, y, z, 0.0]),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: None,
                rows_per_image: None,
            },
            wgpu::Extent3d::default(),
        );
    }

    /// Radiance and distance as they were before an update, at the update's place in its batch.
    #[must_use]
    pub fn previous_views(&self) -> [wgpu::TextureView; 2] {
        [&self.previous_radiance, &self.previous_distance]
            .map(|texture| texture.create_view(&wgpu::TextureViewDescriptor::default()))
    }

    /// Copies a tile to where the update with this place in its batch reads what was there before.
    pub fn keep_previous(&self, encoder: &mut wgpu::CommandEncoder, slot: Slot, place: u32) {
        self.copy(encoder, slot, place, false);
    }

    /// Copies a place of the working page to where a tile is stored.
    pub fn store(&self, encoder: &mut wgpu::CommandEncoder, place: u32, slot: Slot) {
        self.copy(encoder, slot, place, true);
    }

    /// Copies a tile between its slot and a place of the working page.
    fn copy(&self, encoder: &mut wgpu::CommandEncoder, slot: Slot, place: u32, stores: bool) {
        for (pages, working) in [
            (&self.radiance, &self.previous_radiance),
            (&self.distance, &self.previous_distance),
        ] {
            let stored = at(pages, origin_of(slot));
            let worked = at(working, row_of_tile(place, 0));
            let (from, to) = if stores {
                (worked, stored)
            } else {
                (stored, worked)
            };
            encoder.copy_texture_to_texture(from, to, TILE);
        }
    }
}
