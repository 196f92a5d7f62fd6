//! Sky and haze on the device. The air looks the same to every viewer at an altitude, wherever he stands and whichever way
//! he looks: the tables are made for altitudes, and viewers of all cells share them.

use super::{BaseTables, Medium, ShaftReader};
use crate::gpu::{Gpu, PipelineKey, Pipelines};
use skycell_shaders::{Features, Kernel, layout};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Size of the sky's table, as in `sky/air.wgsl`.
const VIEW_SIZE: [u32; 2] = [192, 256];
/// Size of the haze's table: azimuths, elevations, distances.
const HAZE_SIZE: [u32; 3] = [32, 56, 31];
/// Distances of the haze's extinction.
const HAZE_EXTINCTION_SLICES: u32 = 61;
/// Altitudes whose tables are kept.
const VIEWS_MAX: usize = 64;

/// The sun's way up or down for which tables are made anew, 0.01°: at dusk the sky's radiance changes by 1 % over it.
const SUN_STEP_RAD: f64 = 1.75e-4;

/// Step of altitude relative to it, low above the ground: the distance to the horizon changes by half of that.
const LOW_STEP: f64 = 0.02;
/// Altitude up to which that holds, m; the step there is that of the density of haze.
const LOW_M: f64 = 250.0;
/// Step of altitude relative to it and a kilometre, higher up.
const HIGH_STEP: f64 = 0.001;
/// Altitude from which steps are finer, m: rays at the limb then pass the last of the air, some 100 m of it at 100 km.
const THIN_M: f64 = 30_000.0;
/// Step of altitude relative to it and a kilometre, from there.
const THIN_STEP: f64 = 0.0002;

/// Steps of altitude from the ground to where the next part of the scale begins.
fn steps_below_high() -> f64 {
    LOW_M.ln_1p() / LOW_STEP
}

fn steps_below_thin() -> f64 {
    steps_below_high() + ((THIN_M + 1_000.0) / (LOW_M + 1_000.0)).ln() / HIGH_STEP
}

/// Altitudes with one key share their tables: steps of 2 % near the ground, of 1.3 m at 250 m, of 11 m at 10 km, of 20 m at
/// 100 km.
#[must_use]
pub fn key_of_altitude(altitude_m: f64) -> i32 {
    let above = |from_m: f64| ((altitude_m + 1_000.0) / (from_m + 1_000.0)).ln();
    let steps = if altitude_m < 0.0 {
        altitude_m / 5.0
    } else if altitude_m < LOW_M {
        altitude_m.ln_1p() / LOW_STEP
    } else if altitude_m < THIN_M {
        steps_below_high() + above(LOW_M) / HIGH_STEP
    } else {
        steps_below_thin() + above(THIN_M) / THIN_STEP
    };
    steps.round() as i32
}

/// Altitude in the middle of those with a key.
fn altitude_of_key(key: i32) -> f64 {
    let steps = f64::from(key);
    let (high, thin) = (steps_below_high(), steps_below_thin());
    let above = |from_m: f64, folds: f64| (from_m + 1_000.0) * folds.exp() - 1_000.0;
    if steps < 0.0 {
        steps * 5.0
    } else if steps < high {
        (steps * LOW_STEP).exp_m1()
    } else if steps < thin {
        above(LOW_M, (steps - high) * HIGH_STEP)
    } else {
        above(THIN_M, (steps - thin) * THIN_STEP)
    }
}

/// The pipelines that make tables.
#[must_use]
pub fn table_keys() -> [PipelineKey; 2] {
    [Kernel::MakeAirView, Kernel::MakeAirHaze].map(|kernel| PipelineKey {
        kernel,
        features: Features::default(),
    })
}

/// The tables of one altitude.
#[derive(Debug)]
struct View {
    /// Generation of the light that they show.
    made: Option<u64>,
    /// When they were last read.
    used: u64,
    altitude_m: f64,
    air: wgpu::Buffer,
    base_group: wgpu::BindGroup,
    out_groups: [wgpu::BindGroup; 2],
    read_group: wgpu::BindGroup,
    /// Sky, aerosol, haze and its extinction.
    read: [wgpu::TextureView; 4],
}

/// Base tables on the device.
#[derive(Debug)]
struct Base {
    tables: Arc<BaseTables>,
    views: [wgpu::TextureView; 3],
}

/// Sky and haze for the altitudes of all viewers.
#[derive(Debug)]
pub struct AirViews {
    base: Option<Base>,
    views: BTreeMap<i32, View>,
    sampler: wgpu::Sampler,
    mu_sun: f64,
    /// Counts changes of air or sun.
    generation: u64,
    clock: u64,
    made: u64,
}

impl AirViews {
    /// Without air.
    #[must_use]
    pub fn new(gpu: &Gpu) -> Self {
        Self {
            base: None,
            views: BTreeMap::new(),
            sampler: gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some("air"),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            }),
            mu_sun: 0.0,
            generation: 0,
            clock: 0,
            made: 0,
        }
    }

    /// Takes over the air and the sun's height; without air all memory is given back.
    pub fn set(&mut self, gpu: &Gpu, tables: Option<&Arc<BaseTables>>, mu_sun: f64) {
        let Some(tables) = tables else {
            self.base = None;
            self.views.clear();
            return;
        };
        let known = self
            .base
            .as_ref()
            .is_some_and(|base| Arc::ptr_eq(&base.tables, tables));
        if !known {
            // Bind groups hold the old tables.
            self.views.clear();
            let upload = |table: &super::base::Table| {
                let [width, height] = table.size.map(|n| n as u32);
                let texture = texture(
                    gpu,
                    "air base",
                    [width, height, 1],
                    wgpu::TextureUsages::COPY_DST,
                );
                gpu.queue.write_texture(
                    texture.as_image_copy(),
                    bytemuck::cast_slice(&table.texels()),
                    wgpu::TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(16 * width),
                        rows_per_image: None,
                    },
                    texture.size(),
                );
                texture.create_view(&wgpu::TextureViewDescriptor::default())
            };
            self.base = Some(Base {
                views: [&tables.depth, &tables.orders, &tables.ground].map(upload),
                tables: tables.clone(),
            });
        }
        // While the sun moves, tables follow in steps.
        let moved_rad =
            (self.mu_sun.clamp(-1.0, 1.0).asin() - mu_sun.clamp(-1.0, 1.0).asin()).abs();
        if !known || moved_rad > SUN_STEP_RAD {
            self.mu_sun = mu_sun;
            self.generation += 1;
        }
    }

    /// How many tables were made so far.
    #[must_use]
    pub fn made(&self) -> u64 {
        self.made
    }

    /// Bytes on the device.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let texels = 2 * VIEW_SIZE[0] * VIEW_SIZE[1]
            + HAZE_SIZE[0] * HAZE_SIZE[1] * HAZE_SIZE[2]
            + HAZE_SIZE[1] * HAZE_EXTINCTION_SLICES;
        let base = self.base.as_ref().map_or(0, |base| {
            [&base.tables.depth, &base.tables.orders, &base.tables.ground]
                .iter()
                .map(|table| 16 * (table.size[0] * table.size[1]) as u64)
                .sum()
        });
        base + 16 * u64::from(texels) * self.views.len() as u64
    }

    /// What a composite reads for an eye at an altitude; the passes that make it are recorded before, should it not be
    /// there. None without air.
    pub fn group(
        &mut self,
        gpu: &Gpu,
        pipelines: &Pipelines,
        encoder: &mut wgpu::CommandEncoder,
        altitude_m: f64,
        shafts: Option<&ShaftReader>,
    ) -> Option<wgpu::BindGroup> {
        let base = self.base.as_ref()?;
        self.clock += 1;
        let key = key_of_altitude(altitude_m);
        if !self.views.contains_key(&key) {
            if self.views.len() >= VIEWS_MAX
                && let Some(oldest) = self
                    .views
                    .iter()
                    .min_by_key(|(_, view)| view.used)
                    .map(|(key, _)| *key)
            {
                self.views.remove(&oldest);
            }
            let view = View::new(gpu, pipelines, base, &self.sampler, altitude_of_key(key));
            self.views.insert(key, view);
        }
        let view = self.views.get_mut(&key)?;
        view.used = self.clock;
        if view.made != Some(self.generation) {
            view.made = Some(self.generation);
            self.made += 1;
            let air = air_uniform(&base.tables, view.altitude_m, self.mu_sun);
            gpu.queue
                .write_buffer(&view.air, 0, bytemuck::bytes_of(&air));
            view.record(pipelines, encoder);
        }
        Some(match shafts {
            None => view.read_group.clone(),
            Some(shafts) => {
                let resources = [view.read(&self.sampler).as_slice(), &shafts.resources()].concat();
                gpu.bind_group("air", &pipelines.shafts_layout, &resources)
            }
        })
    }

    /// Group 0 of a pass that marches through the air from a place of its own; `air` is filled for it. None without air.
    #[must_use]
    pub fn base_group(
        &self,
        gpu: &Gpu,
        pipelines: &Pipelines,
        air: &wgpu::Buffer,
        altitude_m: f64,
        mu_sun: f64,
    ) -> Option<wgpu::BindGroup> {
        let base = self.base.as_ref()?;
        let uniform = air_uniform(&base.tables, altitude_m, mu_sun);
        gpu.queue.write_buffer(air, 0, bytemuck::bytes_of(&uniform));
        Some(base_group(gpu, pipelines, base, air, &self.sampler))
    }
}

fn base_group(
    gpu: &Gpu,
    pipelines: &Pipelines,
    base: &Base,
    air: &wgpu::Buffer,
    sampler: &wgpu::Sampler,
) -> wgpu::BindGroup {
    use wgpu::BindingResource::{Sampler, TextureView};
    let [depth, orders, ground] = &base.views;
    gpu.bind_group(
        "air",
        &pipelines.air_base_layout,
        &[
            air.as_entire_binding(),
            TextureView(depth),
            TextureView(orders),
            TextureView(ground),
            Sampler(sampler),
        ],
    )
}

fn air_uniform(tables: &BaseTables, altitude_m: f64, mu_sun: f64) -> layout::Air {
    let f32s = |v: glam::DVec3| v.as_vec3().to_array();
    let medium: &Medium = &tables.medium;
    layout::Air {
        rayleigh_per_m: f32s(medium.rayleigh_per_m),
        rayleigh_scale_m: medium.rayleigh_scale_m as f32,
        mie_scattering_per_m: f32s(medium.mie_scattering_per_m),
        mie_scale_m: medium.mie_scale_m as f32,
        mie_extinction_per_m: f32s(medium.mie_extinction_per_m),
        mie_asymmetry: medium.mie_asymmetry as f32,
        ozone_per_m: f32s(medium.ozone_per_m),
        top_m: medium.top_m as f32,
        radius_m: medium.radius_m as f32,
        altitude_m: altitude_m as f32,
        mu_sun: mu_sun as f32,
        mu_sun_lowest: tables.mu_sun_lowest as f32,
        sun_angular_radius_rad: tables.sun_radius_rad as f32,
        haze_mie_weight: medium.haze_mie_weight() as f32,
        row_scale_m: medium.row_scale_m() as f32,
        ..Default::default()
    }
}

fn texture(
    gpu: &Gpu,
    label: &str,
    [width, height, depth]: [u32; 3],
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d {
            width,
            height,
            depth_or_array_layers: depth,
        },
        mip_level_count: 1,
        sample_count: 1,
        dimension: if depth > 1 {
            wgpu::TextureDimension::D3
        } else {
            wgpu::TextureDimension::D2
        },
        // Radiances from noon to deep dusk need more than half floats hold.
        format: wgpu::TextureFormat::Rgba32Float,
        usage: usage | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    })
}

/// What a composite reads, in the order of its bindings.
fn read_resources<'a>(
    air: &'a wgpu::Buffer,
    [scattered, aerosol, source, extinction]: &'a [wgpu::TextureView; 4],
    sampler: &'a wgpu::Sampler,
) -> [wgpu::BindingResource<'a>; 6] {
    use wgpu::BindingResource::{Sampler, TextureView};
    [
        air.as_entire_binding(),
        TextureView(scattered),
        TextureView(aerosol),
        TextureView(source),
        TextureView(extinction),
        Sampler(sampler),
    ]
}

impl View {
    fn new(
        gpu: &Gpu,
        pipelines: &Pipelines,
        base: &Base,
        sampler: &wgpu::Sampler,
        altitude_m: f64,
    ) -> Self {
        use wgpu::BindingResource::TextureView;
        let air = gpu.uniform_buffer("air", size_of::<layout::Air>());
        let made = |label, size| {
            texture(gpu, label, size, wgpu::TextureUsages::STORAGE_BINDING)
                .create_view(&wgpu::TextureViewDescriptor::default())
        };
        let [columns, rows] = VIEW_SIZE;
        let scattered = made("sky", [columns, rows, 1]);
        let aerosol = made("aerosol", [columns, rows, 1]);
        let source = made("haze", HAZE_SIZE);
        let extinction = made("haze extinction", [HAZE_EXTINCTION_SLICES, HAZE_SIZE[1], 1]);
        let read = [&scattered, &aerosol, &source, &extinction].map(Clone::clone);
        let resources = read_resources(&air, &read, sampler);
        Self {
            made: None,
            used: 0,
            altitude_m,
            base_group: base_group(gpu, pipelines, base, &air, sampler),
            out_groups: [
                gpu.bind_group(
                    "air",
                    &pipelines.air_view_layout,
                    &[TextureView(&scattered), TextureView(&aerosol)],
                ),
                gpu.bind_group(
                    "air",
                    &pipelines.air_haze_layout,
                    &[TextureView(&source), TextureView(&extinction)],
                ),
            ],
            read_group: gpu.bind_group("air", &pipelines.air_layout, &resources),
            read,
            air,
        }
    }

    fn read<'a>(&'a self, sampler: &'a wgpu::Sampler) -> [wgpu::BindingResource<'a>; 6] {
        read_resources(&self.air, &self.read, sampler)
    }

    fn record(&self, pipelines: &Pipelines, encoder: &mut wgpu::CommandEncoder) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("air"),
            timestamp_writes: None,
        });
        let groups = [
            [VIEW_SIZE[0].div_ceil(16), VIEW_SIZE[1].div_ceil(4)],
            [HAZE_SIZE[0].div_ceil(16), HAZE_SIZE[1].div_ceil(4)],
        ];
        for ((key, out), [x, y]) in table_keys().into_iter().zip(&self.out_groups).zip(groups) {
            let Some(pipeline) = pipelines.get(key) else {
                continue;
            };
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &self.base_group, &[]);
            pass.set_bind_group(1, out, &[]);
            pass.set_bind_group(2, &pipelines.empty_group, &[]);
            pass.set_bind_group(3, &pipelines.empty_group, &[]);
            pass.dispatch_workgroups(x, y, 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn altitudes_with_one_key_lie_close_together() {
        let mut last = i32::MIN;
        let mut altitude_m = -100.0f64;
        while altitude_m < 400_000.0 {
            let key = key_of_altitude(altitude_m);
            assert!(key >= last, "{altitude_m}");
            last = key;
            let apart = (altitude_of_key(key) - altitude_m).abs();
            let allowed = if altitude_m < 0.0 {
                2.6
            } else if altitude_m < LOW_M + 4.0 {
                // Half a step of 2 %; the step across the seam lies in both parts.
                0.0101 * altitude_m + 0.0101
            } else {
                0.0006 * altitude_m + 0.6
            };
            assert!(apart <= allowed, "{altitude_m}: {apart} over {allowed}");
            altitude_m += (0.001 * altitude_m.abs()).max(0.05);
        }
    }
}
