//! Coverage, type, skip and profile of up to four layers on the device, and their way from old maps to new ones.
//!
//! While maps change, a pass mixes both into the texture that every march reads: a change costs a march nothing.

use super::field_textures::{texture, upload};
use super::pipelines::{PipelineKey, Pipelines};
use super::{Gpu, GpuError};
use crate::field::{FieldStore, LayerMaps, MAP_SIZE, MapFormat, PROFILE_SIZE, skip_coverage};
use skycell_protocol::scene::WeatherDensity;
use skycell_shaders::{Features, Kernel};
use std::path::Path;
use wgpu::util::DeviceExt;

/// Layers of the textures.
const PLACES: usize = 4;
/// Texels of a map.
const TEXELS: usize = (MAP_SIZE * MAP_SIZE) as usize;
/// Threads of a workgroup of the pass that blends.
const BLEND_GROUP: u32 = 64;

/// A weather layer and where its maps stand.
#[derive(Clone, Copy, Debug)]
pub struct PlacedWeather<'a> {
    /// Layer of the textures.
    pub place: u32,
    /// The layer's name: a layer that keeps its name keeps its sky while new maps come.
    pub name: &'a str,
    /// What it reads.
    pub weather: &'a WeatherDensity,
}

/// A thin sheet of ice and where its map stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlacedSheet {
    /// Layer of the textures.
    pub place: u32,
    /// The seed that its map is made from.
    pub seed: u32,
}

/// What a new scene's maps have brought about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MapsChange {
    /// The textures are others: bind groups must be made anew.
    pub textures: bool,
    /// What marches read has changed at once.
    pub content: bool,
}

/// How far maps have changed since this was last asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlendStep {
    /// Nothing is on its way, or nothing has moved.
    None,
    /// Marches read a little of the new maps more.
    Moved,
    /// Marches read the new maps alone.
    Ended,
}

/// Old maps on their way to new ones.
#[derive(Debug)]
struct Blend {
    from: LayerMaps,
    /// What keeps all their digits.
    from_format: MapFormat,
    elapsed_s: f64,
    duration_s: f64,
    /// Share of the new maps that marches read.
    shown: f64,
    buffers: Option<BlendBuffers>,
}

#[derive(Debug)]
struct BlendBuffers {
    group: wgpu::BindGroup,
    settings: wgpu::Buffer,
    mixed: wgpu::Buffer,
}

impl Blend {
    fn share(&self) -> f64 {
        (self.elapsed_s / self.duration_s).clamp(0.0, 1.0)
    }
}

/// Whose maps stand in a place.
#[derive(Debug)]
struct Held {
    name: String,
    weather: WeatherDensity,
    /// The maps that are shown, or will be.
    maps: LayerMaps,
    /// What keeps all their digits.
    format: MapFormat,
    blend: Option<Blend>,
}

impl Held {
    /// The maps as marches read them now.
    fn shown(&self) -> LayerMaps {
        match &self.blend {
            Some(blend) => blend.from.blended(&self.maps, blend.shown),
            None => self.maps.clone(),
        }
    }
}

/// Maps and profiles of all layers.
#[derive(Debug)]
pub(super) struct MapTextures {
    maps: wgpu::Texture,
    profile: wgpu::Texture,
    format: MapFormat,
    /// Layers of both textures: up to the last place that is wanted.
    layers: u32,
    held: [Option<Held>; PLACES],
    /// Seeds of the sheets whose maps stand in the places.
    sheets: [Option<u32>; PLACES],
}

/// Of no layers, a texel that stands where bind groups want something.
fn maps_extent(layers: u32) -> wgpu::Extent3d {
    if layers == 0 {
        return wgpu::Extent3d::default();
    }
    wgpu::Extent3d {
        width: MAP_SIZE,
        height: MAP_SIZE,
        depth_or_array_layers: layers,
    }
}

fn profile_extent(layers: u32) -> wgpu::Extent3d {
    if layers == 0 {
        return wgpu::Extent3d::default();
    }
    wgpu::Extent3d {
        width: PROFILE_SIZE[0],
        height: PROFILE_SIZE[1],
        depth_or_array_layers: layers,
    }
}

fn bytes_per_texel(format: MapFormat) -> u32 {
    match format {
        MapFormat::Bytes => 4,
        MapFormat::Halves => 8,
    }
}

fn half_bits(value: f32) -> [u8; 2] {
    half::f16::from_f32(value).to_bits().to_le_bytes()
}

/// Texels of coverage, type and skip as a texture of the format holds them.
fn packed(maps: &LayerMaps, skips: &[u8], format: MapFormat) -> Vec<u8> {
    let texels = maps.coverage.iter().zip(&maps.cloud_type).zip(skips);
    match format {
        MapFormat::Bytes => texels
            .flat_map(|((coverage, cloud_type), skip)| {
                let byte = |texel: u16| (format.value(texel) * 255.0).round() as u8;
                [byte(*coverage), byte(*cloud_type), *skip, 0]
            })
            .collect(),
        MapFormat::Halves => texels
            .flat_map(|((coverage, cloud_type), skip)| {
                let [c, t, s] = [
                    format.value(*coverage),
                    format.value(*cloud_type),
                    format.skip(*skip),
                ]
                .map(half_bits);
                [c[0], c[1], t[0], t[1], s[0], s[1], 0, 0]
            })
            .collect(),
    }
}

impl MapTextures {
    pub(super) fn new(gpu: &Gpu) -> Self {
        let (maps, profile) = textures(gpu, MapFormat::Bytes, 0);
        Self {
            maps,
            profile,
            format: MapFormat::Bytes,
            layers: 0,
            held: Default::default(),
            sheets: [None; PLACES],
        }
    }

    /// Views of maps and profiles, for a bind group.
    pub(super) fn views(&self) -> [wgpu::TextureView; 2] {
        [&self.maps, &self.profile].map(|texture| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2Array),
                ..Default::default()
            })
        })
    }

    /// Puts the maps of a scene's weather layers where they are wanted, at once or, for a layer that keeps its name and
    /// has a transition, on their way.
    pub(super) fn set(
        &mut self,
        gpu: &Gpu,
        store: &FieldStore,
        folder: &Path,
        wanted: &[PlacedWeather<'_>],
        sheets: &[PlacedSheet],
    ) -> MapsChange {
        let mut change = MapsChange::default();
        let mut stale = [false; PLACES];
        let mut before: Vec<(u32, Held)> = (0..)
            .zip(&mut self.held)
            .filter_map(|(place, held)| Some((place, held.take()?)))
            .collect();
        for ((place, held), stale) in (0..).zip(&mut self.held).zip(&mut stale) {
            if let Some(asked) = wanted.iter().find(|asked| asked.place == place) {
                // A layer goes on wherever it stands now.
                let known = before.iter().position(|(_, old)| old.name == asked.name);
                let old = known.map(|index| before.swap_remove(index));
                let has_moved = old
                    .as_ref()
                    .is_none_or(|(old_place, _)| *old_place != place);
                let (new, is_stale) = hold(old.map(|(_, old)| old), asked, store, folder);
                // What has begun a blend has not changed anything yet.
                change.content |= has_moved || (is_stale && new.blend.is_none());
                *stale = is_stale || has_moved;
                *held = Some(new);
            }
        }
        let format = self
            .held
            .iter()
            .flatten()
            .flat_map(|held| {
                [
                    Some(held.format),
                    held.blend.as_ref().map(|b| b.from_format),
                ]
            })
            .flatten()
            .fold(MapFormat::Bytes, MapFormat::with_digits_of);
        let places = wanted.iter().map(|asked| asked.place);
        let places = places.chain(sheets.iter().map(|sheet| sheet.place));
        let layers = places.max().map_or(0, |last| last + 1).min(PLACES as u32);
        if format != self.format || layers != self.layers {
            (self.maps, self.profile) = textures(gpu, format, layers);
            (self.format, self.layers) = (format, layers);
            stale = [true; PLACES];
            change.textures = true;
            for blend in self
                .held
                .iter_mut()
                .flatten()
                .filter_map(|held| held.blend.as_mut())
            {
                blend.buffers = None;
            }
        }
        for (place, _) in (0..).zip(stale).filter(|(_, stale)| *stale) {
            self.upload(gpu, place);
        }
        change
    }

    /// Puts the maps of sheets where they are wanted, after those of weather layers; true when marches read others.
    pub(super) fn set_sheets(
        &mut self,
        gpu: &Gpu,
        store: &FieldStore,
        wanted: &[PlacedSheet],
        change: MapsChange,
    ) -> bool {
        let before = std::mem::take(&mut self.sheets);
        let mut changed = false;
        for PlacedSheet { place, seed } in wanted.iter().copied() {
            let index = place as usize;
            let Some(held) = self.sheets.get_mut(index) else {
                continue;
            };
            *held = Some(seed);
            if before[index] != Some(seed) || change.textures {
                changed = true;
                let maps = store.sheet_maps(seed);
                let wide = |bytes: &[u8]| bytes.iter().map(|b| u16::from(*b) * 257).collect();
                // The third channel, a weather layer's skips, is the veil.
                let texels = packed(
                    &LayerMaps {
                        coverage: wide(&maps.patches),
                        cloud_type: wide(&maps.fibres),
                        profile: Vec::new(),
                    },
                    &maps.veil,
                    self.format,
                );
                let bytes = bytes_per_texel(self.format);
                upload(gpu, &self.maps, place, maps_extent(1), &texels, bytes);
            }
        }
        changed
    }

    /// Puts what a place shows now onto the device.
    fn upload(&mut self, gpu: &Gpu, place: u32) {
        let Some(held) = self.held.get(place as usize).and_then(Option::as_ref) else {
            return;
        };
        let shown = held.shown();
        let coverage = held.weather.coverage();
        let mut skips = shown.skips(self.format, coverage);
        if held.blend.is_some() {
            let to = held.maps.skips(self.format, coverage);
            for (skip, to) in skips.iter_mut().zip(to) {
                *skip = (*skip).min(to);
            }
        }
        let texels = packed(&shown, &skips, self.format);
        let bytes = bytes_per_texel(self.format);
        upload(gpu, &self.maps, place, maps_extent(1), &texels, bytes);
        self.upload_profile(gpu, place, &shown);
    }

    fn upload_profile(&self, gpu: &Gpu, place: u32, maps: &LayerMaps) {
        let values = maps.profile.iter().map(|texel| self.format.value(*texel));
        let texels: Vec<u8> = match self.format {
            MapFormat::Bytes => values.map(|v| (v * 255.0).round() as u8).collect(),
            MapFormat::Halves => values.flat_map(half_bits).collect(),
        };
        let bytes = bytes_per_texel(self.format) / 4;
        upload(gpu, &self.profile, place, profile_extent(1), &texels, bytes);
    }

    /// Sky time passes.
    pub(super) fn advance(&mut self, seconds: f64) {
        for blend in self
            .held
            .iter_mut()
            .flatten()
            .filter_map(|held| held.blend.as_mut())
        {
            blend.elapsed_s += seconds;
        }
    }

    /// Whether maps are on their way.
    pub(super) fn is_blending(&self) -> bool {
        self.held.iter().flatten().any(|held| held.blend.is_some())
    }

    /// Lets marches read maps as far on their way as sky time is.
    pub(super) fn show(&mut self, gpu: &Gpu, pipelines: &Pipelines) -> Result<BlendStep, GpuError> {
        let mut step = BlendStep::None;
        for place in 0..PLACES as u32 {
            let Some(held) = self.held[place as usize].as_mut() else {
                continue;
            };
            let Some(blend) = held.blend.as_mut() else {
                continue;
            };
            let share = blend.share();
            if share >= 1.0 {
                held.blend = None;
                self.upload(gpu, place);
                step = BlendStep::Ended;
                continue;
            }
            if share == blend.shown {
                continue;
            }
            blend.shown = share;
            self.mix(gpu, pipelines, place)?;
            if step == BlendStep::None {
                step = BlendStep::Moved;
            }
        }
        Ok(step)
    }

    /// The pass that mixes a place's old and new maps.
    fn mix(&mut self, gpu: &Gpu, pipelines: &Pipelines, place: u32) -> Result<(), GpuError> {
        let (format, bytes) = (self.format, bytes_per_texel(self.format));
        let Some(held) = self.held[place as usize].as_mut() else {
            return Ok(());
        };
        let coverage = held.weather.coverage();
        let Some(blend) = held.blend.as_mut() else {
            return Ok(());
        };
        let pipeline = pipelines
            .get(blend_key())
            .ok_or_else(|| GpuError::Device("the pass that blends maps was not made".into()))?;
        let buffers = blend.buffers.get_or_insert_with(|| {
            let both = [&blend.from, &held.maps]
                .map(|maps| blend_input(maps, &maps.skips(format, coverage)));
            blend_buffers(gpu, pipelines, &both, bytes)
        });
        let halves = u32::from(format == MapFormat::Halves);
        let settings = [(blend.shown as f32).to_bits(), halves, TEXELS as u32, 0];
        gpu.queue
            .write_buffer(&buffers.settings, 0, bytemuck::cast_slice(&settings));
        let mut encoder = gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("blend maps"),
            });
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &buffers.group, &[]);
            pass.dispatch_workgroups((TEXELS as u32).div_ceil(BLEND_GROUP), 1, 1);
        }
        encoder.copy_buffer_to_texture(
            wgpu::TexelCopyBufferInfo {
                buffer: &buffers.mixed,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(MAP_SIZE * bytes),
                    rows_per_image: Some(MAP_SIZE),
                },
            },
            wgpu::TexelCopyTextureInfo {
                texture: &self.maps,
                mip_level: 0,
                origin: wgpu::Origin3d {
                    x: 0,
                    y: 0,
                    z: place,
                },
                aspect: wgpu::TextureAspect::All,
            },
            maps_extent(1),
        );
        gpu.queue.submit([encoder.finish()]);
        if blend.from.profile != held.maps.profile {
            let shown = held.shown();
            self.upload_profile(gpu, place, &shown);
        }
        Ok(())
    }
}

/// The maps of a layer for what is asked now, and `old` is what it had; true when the device has others.
fn hold(
    old: Option<Held>,
    asked: &PlacedWeather<'_>,
    store: &FieldStore,
    folder: &Path,
) -> (Held, bool) {
    let weather = asked.weather.clone();
    let name = asked.name.to_owned();
    if let Some(mut old) = old {
        if old.weather.same_maps(&weather) {
            let stale = skip_coverage(old.weather.coverage()) != skip_coverage(weather.coverage());
            old.weather = weather;
            if stale && let Some(blend) = &mut old.blend {
                blend.buffers = None;
            }
            return (old, stale);
        }
        let duration_s = weather.maps().transition_s();
        if duration_s > 0.0 {
            let from = old.shown();
            let maps = load(store, &weather, folder);
            // What is shown stays until the first step, but skips must suit both.
            let stale = from != maps;
            let from_format = match &old.blend {
                Some(blend) => blend.from_format.with_digits_of(old.format),
                None => old.format,
            };
            let blend = stale.then_some(Blend {
                from,
                from_format,
                elapsed_s: 0.0,
                duration_s,
                shown: 0.0,
                buffers: None,
            });
            let held = Held {
                name,
                weather,
                format: MapFormat::of([&maps]),
                maps,
                blend,
            };
            return (held, stale);
        }
    }
    let maps = load(store, &weather, folder);
    let held = Held {
        name,
        weather,
        format: MapFormat::of([&maps]),
        maps,
        blend: None,
    };
    (held, true)
}

/// A file that cannot be read any more, though it could when the scene was taken, counts as none.
fn load(store: &FieldStore, weather: &WeatherDensity, folder: &Path) -> LayerMaps {
    store.layer_maps(weather, folder).unwrap_or_else(|error| {
        tracing::error!(%error, "a layer has the maps of its seed");
        store.generated_maps(weather)
    })
}

fn textures(gpu: &Gpu, format: MapFormat, layers: u32) -> (wgpu::Texture, wgpu::Texture) {
    let (maps, profile) = match format {
        MapFormat::Bytes => (
            wgpu::TextureFormat::Rgba8Unorm,
            wgpu::TextureFormat::R8Unorm,
        ),
        MapFormat::Halves => (
            wgpu::TextureFormat::Rgba16Float,
            wgpu::TextureFormat::R16Float,
        ),
    };
    let flat = wgpu::TextureDimension::D2;
    (
        texture(gpu, "maps", maps_extent(layers), flat, maps),
        texture(gpu, "profile", profile_extent(layers), flat, profile),
    )
}

/// The pass that mixes old and new maps.
pub(crate) fn blend_key() -> PipelineKey {
    PipelineKey {
        kernel: Kernel::BlendMaps,
        features: Features::default(),
    }
}

/// Maps as the pass reads them: coverage and type in 65 535ths, skips in levels.
fn blend_input(maps: &LayerMaps, skips: &[u8]) -> Vec<[u32; 2]> {
    maps.coverage
        .iter()
        .zip(&maps.cloud_type)
        .zip(skips)
        .map(|((coverage, cloud_type), skip)| {
            [
                u32::from(*coverage) | u32::from(*cloud_type) << 16,
                u32::from(*skip),
            ]
        })
        .collect()
}

fn blend_buffers(
    gpu: &Gpu,
    pipelines: &Pipelines,
    [from, to]: &[Vec<[u32; 2]>; 2],
    bytes_per_texel: u32,
) -> BlendBuffers {
    let input = |label, content: &[[u32; 2]]| {
        gpu.device
            .create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents: bytemuck::cast_slice(content),
                usage: wgpu::BufferUsages::STORAGE,
            })
    };
    let buffer = |label, size, usage| {
        gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    };
    let settings = buffer(
        "blend",
        16,
        wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
    );
    let mixed = buffer(
        "mixed maps",
        TEXELS as u64 * u64::from(bytes_per_texel),
        wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
    );
    let (from, to) = (input("old maps", from), input("new maps", to));
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("blend maps"),
        layout: &pipelines.blend_layout,
        entries: &[
            wgpu::BindGroupEntry {
                binding: 0,
                resource: settings.as_entire_binding(),
            },
            wgpu::BindGroupEntry {
                binding: 1,
                resource: from.as_entire_binding(),
            },
            wgpu::BindGroupEntry {
                binding: 2,
                resource: to.as_entire_binding(),
            },
            wgpu::BindGroupEntry {
                binding: 3,
                resource: mixed.as_entire_binding(),
            },
        ],
    });
    BlendBuffers {
        group,
        settings,
        mixed,
    }
}
