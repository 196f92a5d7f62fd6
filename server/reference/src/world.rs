//! A scene with its data, ready for rays.

use crate::density::grid::Grid;
use crate::density::profile::mean_height_fraction;
use crate::density::shape::{self, Parts};
use crate::density::sheet::Sheet;
use crate::density::weather::{FieldPlace, Weather};
use crate::error::checked;
use crate::path::majorant::{Majorant, Majorants};
use crate::phase::Phase;
use crate::shell::{Globe, Interval};
use crate::sky::SkyLight;
use crate::{Field, LayerField, Noise, Ray, ReferenceError, SheetMaps, WeatherMaps};
use glam::{DVec2, DVec3};
use serde::Serialize;
use skycell_protocol::Scene;
use skycell_protocol::scene::{DensityModel, Shape};
use std::sync::{Arc, OnceLock};

/// Which of the renderer's approximations take part. All are off by default: what is left is the physics that both
/// renderers of this crate agree on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Approximations {
    /// Detail noise frays the edges; off, the layer's detail strength counts as 0.
    pub detail_noise: bool,
    /// Light of sky and ground: by the march as its ambient term, by the path tracer as light that paths find. A uniform
    /// environment always reaches the path tracer's.
    pub ambient: bool,
    /// Air in front of clouds dims them and adds its own light; off, only what is behind them has air.
    pub aerial_perspective: bool,
}

impl Approximations {
    /// Everything that the renderer does.
    pub const ALL: Self = Self {
        detail_noise: true,
        ambient: true,
        aerial_perspective: true,
    };
}

/// Where and when a world is seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct WorldSettings {
    /// Sky time since the scene's epoch, s: wind has blown for that long.
    pub time_s: f64,
    /// World x and z of the local frame's origin, m.
    pub origin_xz_m: [f64; 2],
    /// Which approximations take part.
    pub approximations: Approximations,
}

/// What fills a layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Medium {
    /// Weather maps and noise.
    Weather(Weather),
    /// Density 1 everywhere.
    Full,
    /// Density 1 in a box of the field.
    Box {
        /// Lower corner: x, altitude, z, m.
        min_m: DVec3,
        /// Upper corner, m.
        max_m: DVec3,
    },
    /// Density 1 in a ball of the field.
    Ball {
        /// Its middle: x, altitude, z, m.
        center_m: DVec3,
        /// Its radius, m.
        radius_m: f64,
    },
    /// Voxels.
    Grid(Grid),
    /// A thin sheet of ice.
    Sheet(Sheet),
}

/// A layer that can show something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldLayer {
    /// Index in the scene's layers.
    pub scene_index: usize,
    /// Where clouds begin, m above the ground.
    pub base_altitude_m: f64,
    /// Where they end, m.
    pub top_altitude_m: f64,
    /// Extinction where density is 1, 1/m.
    pub extinction_per_m: f64,
    /// Share of extinction that is scattering.
    pub albedo: f64,
    /// What leads from x, z of the local frame to those of the field, m: origin − drift.
    pub offset_xz_m: DVec2,
    /// Altitude of the proxy sphere, m: it orders layers and tells how much air is in front.
    pub proxy_altitude_m: f64,
    /// Mean extinction of the air between the ground and the proxy sphere, 1/m.
    pub air_extinction_per_m: DVec3,
    /// Where its droplets or crystals scatter light to.
    pub phase: Phase,
    /// What fills it.
    pub medium: Medium,
}

impl WorldLayer {
    /// Thickness, m; not 0.
    #[must_use]
    pub fn thickness_m(&self) -> f64 {
        (self.top_altitude_m - self.base_altitude_m).max(1e-3)
    }

    /// Height fraction of an altitude in the layer, not bounded.
    #[must_use]
    pub fn height_fraction(&self, altitude_m: f64) -> f64 {
        (altitude_m - self.base_altitude_m) / self.thickness_m()
    }
}

/// A scene at a time, seen from a local frame, with all that its densities read.
#[derive(Debug)]
pub struct World {
    globe: Globe,
    light: SkyLight,
    phase: Phase,
    scene: Scene,
    settings: WorldSettings,
    layers: Vec<WorldLayer>,
    field: Arc<Field>,
    majorants: OnceLock<Majorants>,
}

/// Whether a layer can show anything.
fn shows(layer: &skycell_protocol::scene::CloudLayer) -> bool {
    let covers = match layer.density() {
        DensityModel::Weather(weather) => weather.coverage() > 0.0,
        DensityModel::Cirrus(cirrus) => cirrus.coverage() > 0.0,
        DensityModel::Homogeneous(_) | DensityModel::Grid(_) => true,
    };
    covers && layer.extinction_per_m() > 0.0 && layer.top_altitude_m() > layer.base_altitude_m()
}

impl World {
    /// A scene with its data. Layers without thickness, extinction or coverage are left out and need none.
    ///
    /// # Errors
    /// Names the data that is missing or does not fit, or a time or an origin that is out of range.
    pub fn new(
        scene: &Scene,
        field: Arc<Field>,
        settings: WorldSettings,
    ) -> Result<Self, ReferenceError> {
        checked(
            "the sky time",
            settings.time_s,
            -1e12..=1e12,
            "-1e12 to 1e12 s",
        )?;
        for value in settings.origin_xz_m {
            checked("the frame's origin", value, -1e9..=1e9, "-1e9 to 1e9 m")?;
        }
        let globe = if scene.planet().is_flat() {
            Globe::Flat
        } else {
            Globe::Sphere {
                radius_m: scene.planet().radius_m(),
            }
        };
        let mut layers = Vec::new();
        for (scene_index, layer) in scene.layers().iter().enumerate() {
            if !shows(layer) {
                continue;
            }
            check_data(scene_index, layer.density(), &field)?;
            let thickness_m = (layer.top_altitude_m() - layer.base_altitude_m()).max(1e-3);
            let medium = match layer.density() {
                DensityModel::Weather(weather) => Medium::Weather(Weather::new(
                    weather,
                    layer.base_altitude_m(),
                    thickness_m,
                    settings.approximations.detail_noise,
                    scene.carried_m(scene_index).y + weather.evolution_m_per_s() * settings.time_s,
                )),
                DensityModel::Homogeneous(Shape::Layer) => Medium::Full,
                DensityModel::Homogeneous(Shape::Box { center_m, size_m }) => Medium::Box {
                    min_m: *center_m - 0.5 * *size_m,
                    max_m: *center_m + 0.5 * *size_m,
                },
                DensityModel::Homogeneous(Shape::Sphere { center_m, radius_m }) => Medium::Ball {
                    center_m: *center_m,
                    radius_m: *radius_m,
                },
                DensityModel::Grid(grid) => Medium::Grid(Grid::new(grid)),
                DensityModel::Cirrus(cirrus) => Medium::Sheet(Sheet::new(cirrus)),
            };
            let height_fraction = match layer.density() {
                DensityModel::Weather(weather) => {
                    mean_height_fraction(weather.profile(), weather.cloud_type())
                }
                DensityModel::Homogeneous(_) | DensityModel::Grid(_) | DensityModel::Cirrus(_) => {
                    0.5
                }
            };
            let drift_m = scene.carried_m(scene_index).with_y(0.0)
                + scene.layer_wind(scene_index).velocity_m_per_s() * settings.time_s;
            layers.push(WorldLayer {
                scene_index,
                base_altitude_m: layer.base_altitude_m(),
                top_altitude_m: layer.top_altitude_m(),
                extinction_per_m: layer.extinction_per_m(),
                albedo: layer.single_scattering_albedo(),
                offset_xz_m: DVec2::from_array(settings.origin_xz_m)
                    - DVec2::new(drift_m.x, drift_m.z),
                proxy_altitude_m: layer.base_altitude_m()
                    + height_fraction * (layer.top_altitude_m() - layer.base_altitude_m()),
                air_extinction_per_m: DVec3::ZERO,
                phase: Phase::of(scene.layer_phase(scene_index)),
                medium,
            });
        }
        layers.sort_by(|a, b| a.proxy_altitude_m.total_cmp(&b.proxy_altitude_m));
        let cloud_altitude_m = layers.first().map_or(0.0, |layer| layer.proxy_altitude_m);
        let light = SkyLight::new(scene, cloud_altitude_m);
        for layer in &mut layers {
            layer.air_extinction_per_m = light.air_extinction_per_m(layer.proxy_altitude_m);
        }
        Ok(Self {
            globe,
            light,
            phase: Phase::of(scene.light().phase()),
            scene: scene.clone(),
            settings,
            layers,
            field,
            majorants: OnceLock::new(),
        })
    }

    /// What lies below.
    #[must_use]
    pub fn globe(&self) -> &Globe {
        &self.globe
    }

    /// Light from outside the clouds.
    #[must_use]
    pub fn light(&self) -> &SkyLight {
        &self.light
    }

    /// The scene's phase function, which layers have that have none of their own.
    #[must_use]
    pub fn phase(&self) -> &Phase {
        &self.phase
    }

    /// The scene.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Where and when it is seen.
    #[must_use]
    pub fn settings(&self) -> &WorldSettings {
        &self.settings
    }

    /// The layers that can show something, by the altitude of their proxy spheres.
    #[must_use]
    pub fn layers(&self) -> &[WorldLayer] {
        &self.layers
    }

    /// The noise, for a weather layer.
    pub(crate) fn noise(&self) -> Option<&Noise> {
        self.field.noise.as_ref()
    }

    /// The maps of a weather layer.
    pub(crate) fn maps(&self, layer: &WorldLayer) -> Option<&WeatherMaps> {
        match self.field.layers.get(layer.scene_index) {
            Some(LayerField::Weather(maps)) => Some(maps),
            _ => None,
        }
    }

    /// The maps of a thin sheet.
    pub(crate) fn sheet_maps(&self, layer: &WorldLayer) -> Option<&SheetMaps> {
        match self.field.layers.get(layer.scene_index) {
            Some(LayerField::Sheet(maps)) => Some(maps),
            _ => None,
        }
    }

    /// Whether two layers share altitudes.
    #[must_use]
    pub fn layers_overlap(&self) -> bool {
        let overlap = |a: &WorldLayer, b: &WorldLayer| {
            a.base_altitude_m < b.top_altitude_m && b.base_altitude_m < a.top_altitude_m
        };
        (0..self.layers.len()).any(|i| (0..i).any(|j| overlap(&self.layers[i], &self.layers[j])))
    }

    /// The voxels of a grid layer; none for others.
    pub(crate) fn voxels(&self, layer: &WorldLayer) -> &[f32] {
        match self.field.layers.get(layer.scene_index) {
            Some(LayerField::Grid(voxels)) => voxels,
            _ => &[],
        }
    }

    /// Upper bounds of all layers' densities, made when they are first needed.
    pub(crate) fn majorants(&self) -> &Majorants {
        self.majorants.get_or_init(|| Majorants::new(self))
    }

    /// The upper bound of one layer's density.
    pub(crate) fn majorant(&self, layer_place: usize) -> &Majorant {
        &self.majorants().layers()[layer_place]
    }

    /// A point (x, altitude, z) of the world in the local frame, m: y drops with the planet's curvature.
    ///
    /// With horizontal distance d and altitude h, (y + R)² + d² = (R + h)². Beyond a quarter of the planet there is no such
    /// point; the farthest one stands for it.
    #[must_use]
    pub fn frame_from_world_m(&self, world_m: DVec3) -> DVec3 {
        let [origin_x, origin_z] = self.settings.origin_xz_m;
        let (x, h, z) = (world_m.x - origin_x, world_m.y, world_m.z - origin_z);
        let y = match self.globe {
            Globe::Flat => h,
            Globe::Sphere { radius_m: r } => {
                let across = x * x + z * z;
                let root = ((r + h) * (r + h) - across).max(0.0).sqrt();
                (h * (2.0 * r + h) - across) / (root + r)
            }
        };
        DVec3::new(x, y, z)
    }

    /// The place in a layer's field of a point of the frame.
    #[must_use]
    pub fn field_place(&self, layer: &WorldLayer, position_m: DVec3) -> FieldPlace {
        FieldPlace {
            x_m: position_m.x + layer.offset_xz_m.x,
            altitude_m: self.globe.altitude_m(position_m),
            z_m: position_m.z + layer.offset_xz_m.y,
        }
    }

    /// Density of a layer at a point of the frame, in 0…1 (a grid's as its voxels have it), with a weight of the detail
    /// noise: 1 as the path tracer sees it, [`crate::march::detail_weight`] as a ray does. 0 outside the layer.
    #[must_use]
    pub fn density(&self, layer: &WorldLayer, position_m: DVec3, detail_weight: f64) -> f64 {
        let place = self.field_place(layer, position_m);
        let height_fraction = layer.height_fraction(place.altitude_m);
        if !(0.0..=1.0).contains(&height_fraction) {
            return 0.0;
        }
        self.density_at(layer, place, height_fraction, detail_weight)
    }

    /// Density where place and height fraction are known.
    pub(crate) fn density_at(
        &self,
        layer: &WorldLayer,
        place: FieldPlace,
        height_fraction: f64,
        detail_weight: f64,
    ) -> f64 {
        match &layer.medium {
            Medium::Weather(weather) => {
                let (Some(noise), Some(maps)) = (self.noise(), self.maps(layer)) else {
                    return 0.0;
                };
                let profile = weather.dimensional_profile(maps, place, height_fraction);
                weather.carved_density(noise, place, height_fraction, profile, detail_weight)
            }
            _ => self.solid_density(layer, place),
        }
    }

    /// Density as the march to the sun reads it: with the detail's mean. 0 outside the layer.
    #[must_use]
    pub fn smooth_density(&self, layer: &WorldLayer, position_m: DVec3) -> f64 {
        self.density_without_detail(
            layer,
            position_m,
            |weather, place, height_fraction, profile| {
                self.noise().map_or(0.0, |noise| {
                    weather.smooth_density(noise, place, height_fraction, profile)
                })
            },
        )
    }

    /// Density on the mean of a place's surroundings: what light that has been scattered often passes through. 0 outside the
    /// layer.
    #[must_use]
    pub fn surrounding_density(&self, layer: &WorldLayer, position_m: DVec3) -> f64 {
        self.density_without_detail(layer, position_m, |weather, _, _, profile| {
            weather.broad_density(profile)
        })
    }

    /// 0 outside the layer; `of_weather` tells the density of a weather layer's place, height fraction and dimensional
    /// profile.
    fn density_without_detail(
        &self,
        layer: &WorldLayer,
        position_m: DVec3,
        of_weather: impl Fn(&Weather, FieldPlace, f64, f64) -> f64,
    ) -> f64 {
        let place = self.field_place(layer, position_m);
        let height_fraction = layer.height_fraction(place.altitude_m);
        if !(0.0..=1.0).contains(&height_fraction) {
            return 0.0;
        }
        match &layer.medium {
            Medium::Weather(weather) => self.maps(layer).map_or(0.0, |maps| {
                let profile = weather.dimensional_profile(maps, place, height_fraction);
                of_weather(weather, place, height_fraction, profile)
            }),
            _ => self.solid_density(layer, place),
        }
    }

    /// Density of what is no weather, inside the layer's altitudes.
    fn solid_density(&self, layer: &WorldLayer, place: FieldPlace) -> f64 {
        let at = DVec3::new(place.x_m, place.altitude_m, place.z_m);
        let inside = |inside: bool| if inside { 1.0 } else { 0.0 };
        match &layer.medium {
            Medium::Weather(_) => 0.0,
            Medium::Full => 1.0,
            Medium::Box { min_m, max_m } => {
                inside(at.cmpge(*min_m).all() && at.cmple(*max_m).all())
            }
            Medium::Ball { center_m, radius_m } => {
                inside((at - *center_m).length_squared() <= radius_m * radius_m)
            }
            Medium::Grid(grid) => grid.density(self.voxels(layer), place),
            Medium::Sheet(sheet) => self
                .sheet_maps(layer)
                .map_or(0.0, |maps| sheet.density(maps, place)),
        }
    }

    /// The parts of a ray, at most two, outside which the layer's density is 0: all of the layer for weather, the shape or
    /// the grid's box for others, exactly.
    #[must_use]
    pub fn layer_parts(&self, layer: &WorldLayer, ray: &Ray) -> Parts {
        let (base_m, top_m) = (layer.base_altitude_m, layer.top_altitude_m);
        let in_box = |min_m: DVec3, max_m: DVec3| {
            let (low_m, high_m) = (min_m.y.max(base_m), max_m.y.min(top_m));
            if low_m >= high_m {
                return [Interval::EMPTY; 2];
            }
            shape::box_parts(
                &self.globe,
                ray,
                layer.offset_xz_m,
                DVec3::new(min_m.x, low_m, min_m.z),
                DVec3::new(max_m.x, high_m, max_m.z),
            )
        };
        match &layer.medium {
            Medium::Weather(_) | Medium::Full | Medium::Sheet(_) => {
                self.globe.layer_intervals(base_m, top_m, ray)
            }
            Medium::Box { min_m, max_m } => in_box(*min_m, *max_m),
            Medium::Grid(grid) => in_box(grid.min_m, grid.max_m),
            Medium::Ball { center_m, radius_m } => {
                let [first, second] = in_box(*center_m - *radius_m, *center_m + *radius_m);
                let ball = |within: Interval| {
                    shape::ball_parts(
                        &self.globe,
                        ray,
                        layer.offset_xz_m,
                        *center_m,
                        *radius_m,
                        within,
                    )
                };
                let [a, b] = ball(first);
                if second.is_empty() {
                    return [a, b];
                }
                let [c, _] = ball(second);
                // A ball that a grazing ray meets twice in each of two altitude ranges would need a planet of its size.
                match (a.is_empty(), b.is_empty()) {
                    (true, _) => [c, Interval::EMPTY],
                    (false, true) => [a, c],
                    (false, false) => [a, b],
                }
            }
        }
    }
}

/// Refuses data that a layer's density cannot read.
fn check_data(layer: usize, density: &DensityModel, field: &Field) -> Result<(), ReferenceError> {
    let data = field.layers.get(layer);
    match density {
        DensityModel::Homogeneous(_) => Ok(()),
        DensityModel::Weather(_) => {
            if field.noise.is_none() {
                return Err(ReferenceError::Missing {
                    layer,
                    what: "noise volumes and a profile",
                });
            }
            match data {
                Some(LayerField::Weather(_)) => Ok(()),
                _ => Err(ReferenceError::Missing {
                    layer,
                    what: "weather maps",
                }),
            }
        }
        DensityModel::Cirrus(_) => match data {
            Some(LayerField::Sheet(_)) => Ok(()),
            _ => Err(ReferenceError::Missing {
                layer,
                what: "maps of a sheet",
            }),
        },
        DensityModel::Grid(grid) => {
            let Some(LayerField::Grid(voxels)) = data else {
                return Err(ReferenceError::Missing {
                    layer,
                    what: "voxels",
                });
            };
            let expected = usize::try_from(grid.voxels()).unwrap_or(usize::MAX);
            if voxels.len() != expected {
                return Err(ReferenceError::WrongLength {
                    what: format!("the grid of layer {layer}"),
                    given: voxels.len(),
                    expected,
                });
            }
            match voxels.iter().position(|v| !(v.is_finite() && *v >= 0.0)) {
                None => Ok(()),
                Some(index) => Err(ReferenceError::BadVoxel {
                    layer,
                    index,
                    value: voxels[index],
                }),
            }
        }
    }
}
