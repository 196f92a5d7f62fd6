//! The scene as the shaders read it, in the frame of one cell.

use super::night::night_uniform;
use super::{CellFrame, MarchSettings, ProxySettings, SkyLight};
use crate::atmosphere::BaseTables;
use crate::field::{SKIP_RANGE_SHARE, mean_height_fraction};
use crate::gpu::{PlacedSheet, PlacedWeather};
use glam::DVec3;
use skycell_protocol::Scene;
use skycell_protocol::camera::POSITION_ALTITUDE_M;
use skycell_protocol::scene::{
    CloudLayer, DensityModel, FITTED, Light, PhaseFunction, Scattering, Shape,
};
use skycell_shaders::{Density, Features, layout};

/// Factor from radiance (per unit of the sun's spectral irradiance in W/(m² nm)) to the tone curve at 0 EV.
/// Tuned: puts a sunlit cumulus just under the shoulder, the noon sky at middle grey (`skycell-server render`).
pub const EXPOSURE_AT_ZERO_EV: f64 = 3.6;

/// A ray stops where less than this share of the light behind could still come through.
const TRANSMITTANCE_MIN: f32 = 0.001;
/// Most lit samples of a ray whose steps do not grow.
const STEPS_MAX: u32 = 4096;

/// A layer that can show something, with where it comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActiveLayer {
    /// Index in the scene's layers.
    pub scene_index: usize,
    /// Mean altitude of its clouds, where its proxy sphere stands as long as it is kept whole, m.
    pub proxy_altitude_m: f64,
}

/// The layers that need any work, sorted by the altitude of their proxy spheres: a layer without thickness, extinction
/// or coverage has no cache, no pass and no read.
#[must_use]
pub fn active_layers(scene: &Scene) -> Vec<ActiveLayer> {
    let mut active: Vec<ActiveLayer> = scene
        .layers()
        .iter()
        .enumerate()
        .filter(|(_, layer)| {
            let covers = match layer.density() {
                DensityModel::Weather(weather) => weather.coverage() > 0.0,
                DensityModel::Cirrus(cirrus) => cirrus.coverage() > 0.0,
                DensityModel::Homogeneous(_) | DensityModel::Grid(_) => true,
            };
            covers
                && layer.extinction_per_m() > 0.0
                // As shaders see it.
                && layer.top_altitude_m() as f32 > layer.base_altitude_m() as f32
        })
        .map(|(scene_index, layer)| {
            let height_fraction = match layer.density() {
                DensityModel::Weather(weather) => {
                    mean_height_fraction(weather.profile(), weather.cloud_type())
                }
                DensityModel::Homogeneous(_) | DensityModel::Grid(_) | DensityModel::Cirrus(_) => {
                    0.5
                }
            };
            let thickness_m = layer.top_altitude_m() - layer.base_altitude_m();
            ActiveLayer {
                scene_index,
                proxy_altitude_m: layer.base_altitude_m() + height_fraction * thickness_m,
            }
        })
        .collect();
    active.sort_by(|a, b| a.proxy_altitude_m.total_cmp(&b.proxy_altitude_m));
    active
}

/// The weather layers among the active ones, with where their maps stand.
#[must_use]
pub fn placed_weather<'a>(scene: &'a Scene, active: &[ActiveLayer]) -> Vec<PlacedWeather<'a>> {
    (0..)
        .zip(active)
        .filter_map(|(place, active)| {
            let layer = scene.layers().get(active.scene_index)?;
            match layer.density() {
                DensityModel::Weather(weather) => Some(PlacedWeather {
                    place,
                    name: layer.name(),
                    weather,
                }),
                _ => None,
            }
        })
        .collect()
}

/// The sheets of ice among the active layers, each where its map stands.
#[must_use]
pub fn placed_sheets(scene: &Scene, active: &[ActiveLayer]) -> Vec<PlacedSheet> {
    (0..)
        .zip(active)
        .filter_map(
            |(place, active)| match scene.layers().get(active.scene_index)?.density() {
                DensityModel::Cirrus(cirrus) => Some(PlacedSheet {
                    place,
                    seed: cirrus.seed(),
                }),
                _ => None,
            },
        )
        .collect()
}

/// What the marching kernels are specialised to for one layer of a scene.
#[must_use]
pub fn layer_features(scene: &Scene, scene_index: usize, settings: &MarchSettings) -> Features {
    let octaves = settings.octaves.unwrap_or(scene.light().octaves());
    let layer = scene.layers().get(scene_index);
    Features {
        // The fitted model has one octave beside single scattering.
        octave_vectors: match scene.light().scattering() {
            Scattering::Fitted => 1,
            Scattering::Octaves => octaves.div_ceil(4),
        },
        density: match layer.map(CloudLayer::density) {
            Some(DensityModel::Weather(_)) => Density::Weather,
            Some(DensityModel::Grid(_)) => Density::Grid,
            Some(DensityModel::Cirrus(_)) => Density::Cirrus,
            Some(DensityModel::Homogeneous(_)) | None => Density::Homogeneous,
        },
        exact_interpolation: settings.exact_interpolation,
        count_reads: settings.count_reads,
        ..Features::default()
    }
}

/// How far each layer's wind has carried its clouds by a time (x and z), and how far the noise has risen through them
/// (y), m. For the scene of a moment the time is what has passed since.
#[must_use]
pub fn wind_drifts(scene: &Scene, time_s: f64) -> Vec<DVec3> {
    (0..scene.layers().len())
        .map(|index| scene.carried_m(index) + drift_m_per_s(scene, index) * time_s)
        .collect()
}

/// Speed of a layer's drift: its wind, and upwards the evolution of its noise.
#[must_use]
pub fn drift_m_per_s(scene: &Scene, index: usize) -> DVec3 {
    let evolution_m_per_s = match scene.layers().get(index).map(CloudLayer::density) {
        Some(DensityModel::Weather(weather)) => weather.evolution_m_per_s(),
        _ => 0.0,
    };
    scene
        .layer_wind(index)
        .velocity_m_per_s()
        .with_y(evolution_m_per_s)
}

/// How the composite blends the layers of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LayerBlend {
    /// How many there are.
    pub layers: usize,
    /// Whether they scatter light in different ways.
    pub own_phases: bool,
    /// Whether two of them share altitudes.
    pub overlap: bool,
    /// Parts that each is kept in.
    pub proxies: u32,
    /// Whether those are kept on domes.
    pub domes: bool,
}

impl LayerBlend {
    /// What the active layers of a scene need that are kept in such a way.
    #[must_use]
    pub fn of(scene: &Scene, active: &[ActiveLayer], proxies: &ProxySettings) -> Self {
        let phase = |layer: &ActiveLayer| scene.layer_phase(layer.scene_index);
        let span_m = |layer: &ActiveLayer| {
            let layer = &scene.layers()[layer.scene_index];
            (layer.base_altitude_m(), layer.top_altitude_m())
        };
        let overlap = active.iter().enumerate().any(|(place, layer)| {
            let (base_m, top_m) = span_m(layer);
            active[place + 1..].iter().any(|other| {
                let (other_base_m, other_top_m) = span_m(other);
                base_m < other_top_m && other_base_m < top_m
            })
        });
        Self {
            layers: active.len(),
            own_phases: active.iter().any(|layer| phase(layer) != phase(&active[0])),
            overlap,
            proxies: proxies.parts(),
            domes: proxies.has_domes(),
        }
    }
}

/// Parameters of a phase function as shaders read it.
fn phase_uniform(phase: &PhaseFunction) -> layout::Phase {
    let [g_hg, g_draine, alpha, weight] = match *phase {
        PhaseFunction::Isotropic => [0.0; 4],
        PhaseFunction::Hg { g } => [g, 0.0, 0.0, 0.0],
        PhaseFunction::Draine { g, alpha } => [0.0, g, alpha, 1.0],
        PhaseFunction::HgDraine {
            droplet_diameter_um: d,
        } => hg_draine_parameters(d),
        PhaseFunction::Ice => {
            let [narrow, broad, share] = PhaseFunction::ICE_LOBES;
            [narrow, broad, 0.0, share]
        }
    };
    layout::Phase {
        g_hg: g_hg as f32,
        g_draine: g_draine as f32,
        alpha_draine: alpha as f32,
        draine_weight: weight as f32,
    }
}

/// g_HG, g_D, α and w of the blend for a droplet diameter (Jendersie & d'Eon 2023, eq. 4 to 7, 5 µm ≤ d ≤ 50 µm).
#[must_use]
pub fn hg_draine_parameters(diameter_um: f64) -> [f64; 4] {
    let d = diameter_um;
    [
        (-0.099_056_7 / (d - 1.671_54)).exp(),
        (-2.206_79 / (d + 3.910_29) - 0.428_934).exp(),
        (3.624_89 - 8.292_88 / (d + 5.525_82)).exp(),
        (-0.599_085 / (d - 0.641_583) - 0.665_888).exp(),
    ]
}

fn powers(base: f64, octaves: u32, beyond: f64) -> [[f32; 4]; 4] {
    let mut rows = [[0.0; 4]; 4];
    for i in 0..16u32 {
        let value = if i < octaves {
            base.powi(i as i32)
        } else {
            beyond
        };
        rows[(i / 4) as usize][(i % 4) as usize] = value as f32;
    }
    rows
}

/// Octaves as shaders read them: how many, and their factors a^i, b^i and c^i.
fn octave_tables(light: &Light, octaves: u32) -> (u32, [[[f32; 4]; 4]; 3]) {
    // A huge attenuation silences the unused components of the last vector.
    const SILENT: f64 = 1e6;
    let (octaves, [a, b, c]) = if light.scattering() == Scattering::Octaves || octaves == 1 {
        let factors = [
            light.octave_attenuation(),
            light.octave_contribution(),
            light.octave_eccentricity(),
        ];
        (octaves, factors)
    } else {
        // The attenuation is one per transport share of the layer, which the shader multiplies.
        let factors = [
            FITTED.forward_attenuation,
            FITTED.forward_strength,
            FITTED.forward_eccentricity,
        ];
        (2, factors)
    };
    let tables = [
        powers(a, octaves, SILENT),
        powers(b, octaves, 0.0),
        powers(c, octaves, 0.0),
    ];
    (octaves, tables)
}

/// Light that is scattered many times; nothing is measured for what the scene does not ask for.
fn diffusion(light: &Light, octaves: u32, ambient: f32) -> layout::Diffusion {
    let strength = if light.scattering() == Scattering::Fitted && octaves > 1 {
        FITTED.diffuse_strength as f32
    } else {
        0.0
    };
    let asked = strength > 0.0 || ambient > 0.0;
    layout::Diffusion {
        strength,
        eccentricity: FITTED.diffuse_eccentricity as f32,
        slope: FITTED.diffuse_slope as f32,
        thickness: FITTED.diffuse_thickness as f32,
        leak: FITTED.diffuse_leak as f32,
        width: FITTED.diffuse_width as f32,
        sky_slope: FITTED.sky_slope as f32,
        sky_thinness: FITTED.sky_thinness as f32,
        sky_forward: FITTED.sky_forward as f32,
        samples: if asked {
            skycell_reference::scattering::SURROUNDINGS_SAMPLES
        } else {
            0
        },
        ..Default::default()
    }
}

/// 1 − mean cosine of a phase: HG's is g, Draine's that of eq. 5 of B. Draine 2003.
fn transport_share(phase: &layout::Phase) -> f64 {
    let [g_hg, g, alpha, weight] = [
        phase.g_hg,
        phase.g_draine,
        phase.alpha_draine,
        phase.draine_weight,
    ]
    .map(f64::from);
    let draine =
        g * (1.0 + alpha * (3.0 + 2.0 * g * g) / 5.0) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0);
    1.0 - (1.0 - weight) * g_hg - weight * draine
}

fn f32s(v: DVec3) -> [f32; 3] {
    v.as_vec3().to_array()
}

/// Offset of a periodic field in periods, 0…1: reduced in f64, so that neither place nor time costs precision.
fn period_offset(origin_m: f64, drift_m: f64, period_m: f64) -> f32 {
    ((origin_m - drift_m) / period_m).rem_euclid(1.0) as f32
}

/// The scene in the frame of a cell, without what is kept of it. `drifts` are those of [`wind_drifts`].
#[must_use]
pub fn scene_uniform(
    scene: &Scene,
    active: &[ActiveLayer],
    light: &SkyLight,
    settings: MarchSettings,
    frame: &CellFrame,
    drifts: &[DVec3],
) -> layout::Scene {
    let octaves = settings.octaves.unwrap_or(scene.light().octaves());
    let ambient = if settings.ambient {
        scene.light().ambient() as f32
    } else {
        0.0
    };
    let diffusion = diffusion(scene.light(), octaves, ambient);
    let (octaves, [octave_attenuation, octave_contribution, octave_eccentricity]) =
        octave_tables(scene.light(), octaves);
    let mut uniform = layout::Scene {
        planet: layout::Planet {
            radius_m: scene.planet().radius_m() as f32,
            ground_albedo: scene.planet().ground_albedo() as f32,
            has_ground: f32::from(u8::from(!scene.planet().is_flat())),
            ..Default::default()
        },
        layer_count: active.len() as u32,
        exposure: (EXPOSURE_AT_ZERO_EV * scene.exposure_ev().exp2()) as f32,
        sun: layout::Sun {
            direction: f32s(light.sun_direction),
            angular_radius_rad: light.sun_angular_radius_rad as f32,
            irradiance: f32s(light.sun_irradiance),
            one_minus_mu_disc: (2.0 * (0.5 * light.sun_angular_radius_rad).sin().powi(2)) as f32,
            irradiance_at_clouds: f32s(light.irradiance_at_clouds),
            ground_irradiance_factor: light.sun_direction.y.max(0.0) as f32,
        },
        sky: layout::Sky {
            rayleigh_optical_depth: f32s(light.rayleigh_optical_depth),
            aerosol_optical_depth: light.aerosol_optical_depth as f32,
            mean_radiance: f32s(light.mean_radiance),
            aerosol_asymmetry: light.aerosol_asymmetry as f32,
            ground_radiance: f32s(light.ground_radiance),
            lit: light.lit as f32,
            sun_column: f32s(light.sun_column),
            sun_column_kept: f32s(light.sun_column_kept),
            diffuse_per_sr: f32s(light.diffuse_per_sr),
            ground_air_extinction_per_m: f32s(light.air_extinction_per_m(0.0)),
            environment_radiance: f32s(light.environment_radiance),
            ..Default::default()
        },
        light: layout::Light {
            phase: phase_uniform(scene.light().phase()),
            octaves,
            sun_steps: settings.sun_steps.unwrap_or(scene.light().sun_steps()),
            sun_march_distance_m: scene.light().sun_march_distance_m() as f32,
            octave_attenuation,
            octave_contribution,
            octave_eccentricity,
            diffusion,
            ambient,
        },
        ..Default::default()
    };
    uniform.night = night_uniform(scene, light);
    for (place, layer) in active.iter().enumerate().take(4) {
        let drift = drifts.get(layer.scene_index).copied().unwrap_or_default();
        uniform.layers[place] = layer_uniform(scene, *layer, place, settings, frame, drift);
        if let Some(air) = light.air() {
            let layer = &scene.layers()[layer.scene_index];
            let heights_m = [layer.base_altitude_m(), layer.top_altitude_m()];
            sun_in_layer(air, light.sun_direction.y, heights_m).tell(&mut uniform.layers[place]);
        }
        uniform.layers[place].has_haze = f32::from(u8::from(settings.aerial_perspective));
        if settings.aerial_perspective {
            uniform.layers[place].air_extinction_per_m =
                f32s(light.air_extinction_per_m(layer.proxy_altitude_m));
        }
    }
    uniform
}

/// Optical depth of the air from a layer's altitudes to the sun: what air has above an altitude falls exponentially, and so
/// does what aerosol has; ozone lies above all clouds. So two exponentials stand for it, through its values at base, middle
/// and top, written so that they hold in thin layers, where both are about linear.
struct SunInLayer {
    /// The layer's thickness over the heights in which air and aerosol fall to 1/e.
    folds: [f64; 2],
    at_base: DVec3,
    rise: DVec3,
    bend: DVec3,
}

/// Least difference of both exponentials in the middle of a layer for which it tells anything in f32.
const LEAST_BEND: f64 = 1e-5;

fn share_below(folds: f64, share: f64) -> f64 {
    (-folds * share).exp_m1() / (-folds).exp_m1()
}

fn sun_in_layer(air: &BaseTables, mu_sun: f64, [base_m, top_m]: [f64; 2]) -> SunInLayer {
    let [base, middle, top] =
        [base_m, 0.5 * (base_m + top_m), top_m].map(|h| air.sun_depth(h, mu_sun));
    let thickness_m = (top_m - base_m).max(1e-3);
    let medium = &air.medium;
    let folds = [medium.rayleigh_scale_m, medium.mie_scale_m].map(|scale| thickness_m / scale);
    let [of_air, of_aerosol] = folds.map(|folds| share_below(folds, 0.5));
    let rise = top - base;
    let apart = of_aerosol - of_air;
    let bend = if apart.abs() < LEAST_BEND {
        DVec3::ZERO
    } else {
        (middle - base - rise * of_air) / apart
    };
    SunInLayer {
        folds,
        at_base: base,
        rise,
        bend,
    }
}

impl SunInLayer {
    fn tell(&self, layer: &mut layout::Layer) {
        layer.sun_depth_at_base = f32s(self.at_base);
        layer.sun_depth_rise = f32s(self.rise);
        layer.sun_depth_bend = f32s(self.bend);
        [layer.air_folds, layer.aerosol_folds] = self.folds.map(|folds| folds as f32);
    }

    /// As `sun_at_altitude` of the composite has it.
    #[cfg(test)]
    fn depth(&self, share: f64) -> DVec3 {
        let [air, aerosol] = self.folds.map(|folds| share_below(folds, share));
        self.at_base + air * self.rise + (aerosol - air) * self.bend
    }
}

/// Where a layer without maps can have density: its bounds, or for a whole layer more than any ray sees.
fn bounds_m(density: &DensityModel) -> Option<[DVec3; 2]> {
    match density {
        DensityModel::Weather(_) | DensityModel::Cirrus(_) => None,
        bounded => Some(
            bounded
                .bounds_m()
                .unwrap_or([DVec3::new(-1e9, -1e6, -1e9), DVec3::new(1e9, 1e6, 1e9)]),
        ),
    }
}

/// First slice of each layer's voxels in the texture that holds those of all layers, one behind the other.
#[must_use]
pub fn grid_first_slices(scene: &Scene) -> Vec<u32> {
    let mut next = 0;
    scene
        .layers()
        .iter()
        .map(|layer| {
            let first = next;
            if let DensityModel::Grid(grid) = layer.density() {
                next += grid.dimensions()[2];
            }
            first
        })
        .collect()
}

/// Steps that no ray exceeds when they grow with distance: from the highest eye over the horizon to the layer's top
/// behind it, ∫ ds / length. A ray that ended earlier would see through haze.
fn steps_of_longest_ray(radius_m: f64, layer: &CloudLayer, steps: f64) -> u32 {
    let to_horizon_m = |altitude_m: f64| (altitude_m * (2.0 * radius_m + altitude_m)).sqrt();
    let longest_m = to_horizon_m(POSITION_ALTITUDE_M.max) + to_horizon_m(layer.top_altitude_m());
    let thickness_m = layer.top_altitude_m() - layer.base_altitude_m();
    // Steps grow beyond twice the thickness.
    let relative = longest_m / (2.0 * thickness_m);
    let lengths = if relative > 1.0 {
        1.0 + relative.ln()
    } else {
        relative
    };
    (2.0 * steps * lengths).ceil() as u32 + 1
}

fn layer_uniform(
    scene: &Scene,
    active: ActiveLayer,
    place: usize,
    settings: MarchSettings,
    frame: &CellFrame,
    drift: DVec3,
) -> layout::Layer {
    let layer = &scene.layers()[active.scene_index];
    let thickness_m = layer.top_altitude_m() - layer.base_altitude_m();
    let steps = f64::from(settings.steps.max(1));
    let first_slice = grid_first_slices(scene)
        .get(active.scene_index)
        .copied()
        .unwrap_or(0);
    let phase = phase_uniform(scene.layer_phase(active.scene_index));
    let mut uniform = layout::Layer {
        base_altitude_m: layer.base_altitude_m() as f32,
        top_altitude_m: layer.top_altitude_m() as f32,
        extinction_per_m: layer.extinction_per_m() as f32,
        single_scattering_albedo: layer.single_scattering_albedo() as f32,
        map_index: place as u32,
        proxy_altitude_m: active.proxy_altitude_m as f32,
        step_min_m: (thickness_m / steps) as f32,
        // A step grows with distance as the height that a pixel sees does; or by so little that it never shows.
        step_per_distance: if settings.adaptive_step {
            (0.5 / steps) as f32
        } else {
            1e-9
        },
        steps_max: if settings.adaptive_step {
            steps_of_longest_ray(scene.planet().radius_m(), layer, steps)
        } else {
            STEPS_MAX
        },
        transmittance_min: if settings.early_exit {
            TRANSMITTANCE_MIN
        } else {
            0.0
        },
        lights_empty_steps: u32::from(!settings.low_density_skip),
        transport_share: transport_share(&phase) as f32,
        phase,
        ..Default::default()
    };
    if let Some([min_m, max_m]) = bounds_m(layer.density()) {
        let [x, z] = frame.origin_m();
        // A layer that fills everything is everywhere the same: neither wind nor the cell's place carries it away.
        let moved = match layer.density() {
            DensityModel::Homogeneous(Shape::Layer) => DVec3::ZERO,
            _ => DVec3::new(drift.x - x, 0.0, drift.z - z),
        };
        let in_frame = min_m + moved;
        uniform.bounds_min = f32s(in_frame);
        uniform.bounds_per_m = f32s(1.0 / (max_m - min_m));
        uniform.is_ball = u32::from(matches!(
            layer.density(),
            DensityModel::Homogeneous(Shape::Sphere { .. })
        ));
    }
    if let DensityModel::Grid(grid) = layer.density() {
        uniform.grid_dimensions = grid.dimensions();
        uniform.grid_first_slice = first_slice;
    }
    if let DensityModel::Cirrus(cirrus) = layer.density() {
        let [x, z] = frame.origin_m();
        let offset = |[axis_x, axis_z]: [f64; 2], period_m: f64| {
            period_offset(
                axis_x * x + axis_z * z,
                axis_x * drift.x + axis_z * drift.z,
                period_m,
            )
        };
        let span_m = cirrus.map_span_m();
        uniform.map_offset = [offset([1.0, 0.0], span_m), offset([0.0, 1.0], span_m)];
        uniform.map_per_m = (1.0 / span_m) as f32;
        let [axis_x, axis_z] = cirrus.fibre_axis();
        uniform.fibre_axis = [axis_x as f32, axis_z as f32];
        let period_m = cirrus.fibre_period_m();
        uniform.shape_offset = [
            offset([axis_x, axis_z], period_m),
            0.0,
            offset([-axis_z, axis_x], period_m),
        ];
        uniform.shape_per_m = (1.0 / period_m) as f32;
        uniform.coverage = cirrus.coverage() as f32;
        uniform.cloud_type = cirrus.cloud_type() as f32;
    }
    if let DensityModel::Weather(weather) = layer.density() {
        let [x, z] = frame.origin_m();
        let offset = |period_m: f64| {
            [
                period_offset(x, drift.x, period_m),
                period_offset(0.0, drift.y, period_m),
                period_offset(z, drift.z, period_m),
            ]
        };
        let map = offset(weather.map_span_m());
        uniform.map_offset = [map[0], map[2]];
        uniform.map_per_m = (1.0 / weather.map_span_m()) as f32;
        uniform.shape_offset = offset(weather.shape_period_m());
        uniform.shape_per_m = (1.0 / weather.shape_period_m()) as f32;
        uniform.detail_offset = offset(weather.detail_period_m());
        uniform.detail_per_m = (1.0 / weather.detail_period_m()) as f32;
        uniform.coverage = weather.coverage() as f32;
        uniform.cloud_type = weather.cloud_type() as f32;
        uniform.detail_strength = if settings.detail_noise {
            weather.detail_strength() as f32
        } else {
            0.0
        };
        let form = weather.form();
        uniform.shape_floor = form.shape_floor as f32;
        uniform.shape_range = form.shape_range as f32;
        uniform.steepness = form.steepness as f32;
        uniform.dome = form.dome as f32;
        uniform.wispiness = form.wispiness as f32;
        uniform.type_spread = form.type_spread as f32;
        uniform.skip_range_m = (weather.map_span_m() * SKIP_RANGE_SHARE) as f32;
    }
    uniform
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atmosphere::Medium;
    use serde_json::json;

    fn exp(v: DVec3) -> DVec3 {
        DVec3::from_array(v.to_array().map(f64::exp))
    }

    #[test]
    fn layers_that_show_nothing_are_left_out() {
        let document = json!({"version": 1, "layers": [
            {"name": "thin", "base_altitude_m": 2000, "top_altitude_m": 2000},
            {"name": "clear", "density": {"model": "weather", "coverage": 0}},
            {"name": "glass", "extinction_per_m": 0},
            {"name": "fog", "density": {"model": "homogeneous"}},
        ]});
        let scene = Scene::from_json(&document).expect("valid");
        let active = active_layers(&scene);
        assert_eq!(active.len(), 1);
        assert_eq!(active[0].scene_index, 3);
    }

    #[test]
    fn the_suns_light_in_a_layer_is_that_of_the_air() {
        // Relative to the light at the layer's top; the table is read between its texels on both sides. With the sun on the
        // horizon aerosol along the slant no longer falls by one exponential.
        let mut worst = [0.0f64; 2];
        for (aerosol, scale_m) in [(0.35, 1200.0), (0.2, 4000.0)] {
            let document = json!({"version": 1, "atmosphere": {"model": "physical",
                "aerosol_optical_depth": aerosol, "aerosol_scale_height_m": scale_m}});
            let scene = Scene::from_json(&document).expect("valid");
            let radius_rad = super::super::sky::sun_angular_radius_rad();
            let air = BaseTables::new(Medium::of(&scene).expect("air"), radius_rad);
            for heights_m in [
                [0.0, 500.0],
                [1100.0, 13_000.0],
                [1500.0, 4000.0],
                [2000.0, 2000.5],
                [8000.0, 8500.0],
            ] {
                let [base_m, top_m]: [f64; 2] = heights_m;
                for elevation_deg in [0.5, 2.0, 5.0, 10.0, 17.0, 40.0, 90.0f64] {
                    let mu = elevation_deg.to_radians().sin();
                    let found = sun_in_layer(&air, mu, heights_m);
                    let top = air.sun_transmittance(top_m, mu);
                    for share in (0..=40).map(|i| f64::from(i) / 40.0) {
                        let at_m = base_m + share * (top_m - base_m);
                        let visible =
                            air.sun_transmittance(at_m, mu) / exp(-air.sun_depth(at_m, mu));
                        let off =
                            visible * exp(-found.depth(share)) - air.sun_transmittance(at_m, mu);
                        let off = (off / top).abs().max_element();
                        let low = usize::from(elevation_deg < 5.0);
                        worst[low] = worst[low].max(off);
                    }
                }
            }
        }
        println!("{worst:?}");
        assert!(worst[0] < 0.004 && worst[1] < 0.02, "{worst:?}");
    }

    #[test]
    fn offsets_stay_exact_after_a_month_of_wind_at_the_far_side_of_the_planet() {
        let drift = 20.0 * 30.0 * 86_400.0;
        let offset = f64::from(period_offset(1.0e7 + 0.5, drift, 5_000.0));
        let exact = ((1.0e7 + 0.5 - drift) / 5_000.0).rem_euclid(1.0);
        assert!((offset - exact).abs() * 5_000.0 < 1e-3);
    }

    #[test]
    fn droplets_of_ten_micrometres_have_the_published_parameters() {
        // Values computed from the paper's eq. 4 to 7 in exact arithmetic.
        let [g_hg, g_draine, alpha, w] = hg_draine_parameters(10.0);
        assert!((g_hg - 0.98818).abs() < 1e-4, "{g_hg}");
        assert!((g_draine - 0.5557).abs() < 1e-3, "{g_draine}");
        assert!((alpha - 21.995).abs() < 1e-2, "{alpha}");
        assert!((w - 0.48194).abs() < 1e-3, "{w}");
    }
}
