//! Upper bounds of density per coarse cell of a layer's field.
//!
//! Linear interpolation never leaves the range of the texels that it reads, and every step from texels to density is
//! monotone. So the greatest texels that a cell's places can read bound its density. Cells are taken a little larger than
//! they are, for places that rounding moves across their edge.

use crate::density::grid::Grid;
use crate::density::weather::Weather;
use crate::shell::{Globe, Interval};
use crate::world::Medium;
use crate::{Noise, Ray, TexelMap, WeatherMaps, World, WorldLayer};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// By how much of its edge a cell is taken larger on each side.
const MARGIN: f64 = 1e-3;
/// By how much of its edge a ray is pushed across a cell's border.
const PUSH: f64 = 1e-5;
/// Texels of a weather map along a cell.
const TEXELS_PER_CELL: u32 = 8;
/// Cells through the thickness of a weather layer.
const WEATHER_HEIGHTS: usize = 48;
/// Most cells of a grid along each axis.
const GRID_CELLS_MAX: usize = 64;
/// Edge of the columns of a thin sheet, m.
const SHEET_CELL_M: f64 = 1e6;
/// What rounding may add to a dimensional profile.
const ROUNDING: f64 = 1e-12;

/// The upper bound of one layer's density.
#[derive(Clone, Debug, PartialEq)]
pub enum Majorant {
    /// Density is 1 in all of the layer's parts.
    Exact,
    /// One bound per cell.
    Cells(Cells),
}

/// Bounds of all layers, in the order of the world's.
#[derive(Clone, Debug, PartialEq)]
pub struct Majorants(Vec<Majorant>);

/// Bounds of the densities in the cells of a box of the field, which may repeat along x and z.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    repeats: bool,
    min_m: DVec3,
    cell_m: DVec3,
    counts: [usize; 3],
    push_m: f64,
    /// Altitudes along a column, columns along x, then z.
    bounds: Vec<f32>,
}

/// Indices of the texels that linear reads between two coordinates (in texels) touch.
fn texels_between(low: f64, high: f64) -> RangeInclusive<i64> {
    (low - 0.5).floor() as i64..=(high - 0.5).floor() as i64 + 1
}

/// Coordinates of a cell with its margin, in units of `per_cell`.
fn extent(cell: usize, per_cell: f64) -> [f64; 2] {
    let cell = cell as f64;
    [(cell - MARGIN) * per_cell, (cell + 1.0 + MARGIN) * per_cell]
}

/// A bound as it is stored: not below its value.
fn stored(bound: f64) -> f32 {
    let near = bound as f32;
    if f64::from(near) < bound {
        near.next_up()
    } else {
        near
    }
}

impl Majorants {
    /// Bounds for every layer of a world.
    #[must_use]
    pub(crate) fn new(world: &World) -> Self {
        Self(
            world
                .layers()
                .iter()
                .map(|layer| match &layer.medium {
                    Medium::Full | Medium::Box { .. } | Medium::Ball { .. } => Majorant::Exact,
                    Medium::Grid(grid) => {
                        Majorant::Cells(Cells::of_grid(grid, world.voxels(layer)))
                    }
                    Medium::Sheet(_) => Majorant::Cells(Cells::of_sheet(layer)),
                    Medium::Weather(weather) => match (world.noise(), world.maps(layer)) {
                        (Some(noise), Some(maps)) => {
                            Majorant::Cells(Cells::of_weather(weather, noise, maps))
                        }
                        // Without data there is no cloud; a world with such a layer is not made.
                        _ => Majorant::Cells(Cells::nothing()),
                    },
                })
                .collect(),
        )
    }

    /// Bounds in the order of the world's layers.
    #[must_use]
    pub fn layers(&self) -> &[Majorant] {
        &self.0
    }
}

impl Cells {
    fn nothing() -> Self {
        Self {
            repeats: false,
            min_m: DVec3::ZERO,
            cell_m: DVec3::ONE,
            counts: [1; 3],
            push_m: PUSH,
            bounds: vec![0.0],
        }
    }

    /// The bound 1 in all of a thin sheet: it is so thin that finer ones would save little.
    fn of_sheet(layer: &WorldLayer) -> Self {
        let cell_m = DVec3::new(SHEET_CELL_M, layer.thickness_m(), SHEET_CELL_M);
        Self {
            repeats: true,
            min_m: DVec3::new(0.0, layer.base_altitude_m, 0.0),
            cell_m,
            counts: [1; 3],
            push_m: PUSH * cell_m.min_element(),
            bounds: vec![1.0],
        }
    }

    /// Bounds of voxels.
    #[must_use]
    pub fn of_grid(grid: &Grid, voxels: &[f32]) -> Self {
        let dimensions = grid.dimensions.map(|n| n as usize);
        let counts = dimensions.map(|n| n.min(GRID_CELLS_MAX));
        let range = |axis: usize, cell: usize| {
            let per_cell = dimensions[axis] as f64 / counts[axis] as f64;
            let [low, high] = extent(cell, per_cell);
            let last = dimensions[axis] as i64 - 1;
            let texels = texels_between(low, high);
            let (low, high) = (*texels.start(), *texels.end());
            low.clamp(0, last) as usize..=high.clamp(0, last) as usize
        };
        let [nx, ny, nz] = counts;
        let bounds = (0..nx * nz)
            .into_par_iter()
            .flat_map_iter(|column| {
                let (x, z) = (column % nx, column / nx);
                (0..ny).map(move |y| {
                    let mut most = 0.0f32;
                    for k in range(2, z) {
                        for j in range(1, y) {
                            let row = dimensions[0] * (j + dimensions[1] * k);
                            for i in range(0, x) {
                                most = most.max(voxels[row + i]);
                            }
                        }
                    }
                    // Interpolation may round up by a few units of its last place.
                    stored(f64::from(most) * (1.0 + ROUNDING))
                })
            })
            .collect();
        let size_m = grid.max_m - grid.min_m;
        let cell_m = size_m / DVec3::from_array(counts.map(|n| n as f64));
        Self {
            repeats: false,
            min_m: grid.min_m,
            cell_m,
            counts,
            push_m: PUSH * cell_m.min_element(),
            bounds,
        }
    }

    /// Bounds of a weather layer: one period of its maps.
    #[must_use]
    pub fn of_weather(weather: &Weather, noise: &Noise, maps: &WeatherMaps) -> Self {
        let columns = |size: u32| (size / TEXELS_PER_CELL).max(1) as usize;
        let nx = columns(maps.coverage.width().min(maps.cloud_type.width()));
        let nz = columns(maps.coverage.height().min(maps.cloud_type.height()));
        let ny = WEATHER_HEIGHTS;
        let rows = ProfileBounds::new(&maps.profile, ny);
        let shape = ShapeBounds::new(weather, noise, [nx, ny, nz]);
        let form = weather.form;
        let bounds = (0..nx * nz)
            .into_par_iter()
            .flat_map_iter(|column| {
                let (x, z) = (column % nx, column / nx);
                let [rim, middle] = value_range(&maps.coverage, [x, z], [nx, nz])
                    .map(|value| weather.coverage_from_map(value));
                let coverage = middle;
                let [least, most] = value_range(&maps.cloud_type, [x, z], [nx, nz]);
                let types = [
                    weather.domed_type(least, rim),
                    weather.domed_type(most, middle),
                ];
                let (rows, shape) = (&rows, &shape);
                (0..ny).map(move |y| {
                    let profile = coverage * rows.most(y, types) + ROUNDING;
                    if profile <= weather.profile_min() {
                        return 0.0;
                    }
                    let noise = form.shape_floor + form.shape_range * shape.most([x, y, z]);
                    let carved = noise - (1.0 - profile);
                    stored(((carved + ROUNDING) * form.steepness).clamp(0.0, 1.0))
                })
            })
            .collect();
        let cell_m = DVec3::new(
            weather.map_span_m / nx as f64,
            weather.thickness_m / ny as f64,
            weather.map_span_m / nz as f64,
        );
        Self {
            repeats: true,
            min_m: DVec3::new(0.0, weather.base_altitude_m, 0.0),
            cell_m,
            counts: [nx, ny, nz],
            push_m: PUSH * cell_m.min_element(),
            bounds,
        }
    }

    /// A distance just beyond another one, which decides in which cell a part of a ray begins.
    fn pushed(&self, from_m: f64) -> f64 {
        from_m + self.push_m.max(4.0 * f64::EPSILON * from_m)
    }

    /// The end of the longest part of a ray that begins at a distance and stays in one column of cells, and about in one
    /// cell of it.
    pub(crate) fn limit_m(
        &self,
        globe: &Globe,
        ray: &Ray,
        layer: &WorldLayer,
        from_m: f64,
        end_m: f64,
    ) -> f64 {
        let begin_m = self.pushed(from_m);
        let border_m = |origin: f64, direction: f64, cell_m: f64| {
            if direction == 0.0 {
                return f64::INFINITY;
            }
            let cell = ((origin + direction * begin_m) / cell_m).floor();
            let next = if direction > 0.0 { cell + 1.0 } else { cell };
            (next * cell_m - origin) / direction
        };
        let x = ray.origin_m.x + layer.offset_xz_m.x - self.min_m.x;
        let z = ray.origin_m.z + layer.offset_xz_m.y - self.min_m.z;
        let climb_m = self.cell_m.y / globe.climb(ray, from_m).abs().max(1e-9);
        border_m(x, ray.direction.x, self.cell_m.x)
            .min(border_m(z, ray.direction.z, self.cell_m.z))
            .min(from_m + climb_m)
            .max(begin_m)
            .min(end_m)
    }

    /// The upper bound of density over a part of a ray that [`Self::limit_m`] has not cut.
    pub(crate) fn bound(
        &self,
        globe: &Globe,
        ray: &Ray,
        layer: &WorldLayer,
        part: Interval,
    ) -> f64 {
        let at = ray.at(self.pushed(part.start_m));
        let [nx, ny, nz] = self.counts;
        let index = |value: f64, count: usize| {
            let cell = value.floor() as i64;
            if self.repeats {
                cell.rem_euclid(count as i64) as usize
            } else {
                cell.clamp(0, count as i64 - 1) as usize
            }
        };
        let x = index(
            (at.x + layer.offset_xz_m.x - self.min_m.x) / self.cell_m.x,
            nx,
        );
        let z = index(
            (at.z + layer.offset_xz_m.y - self.min_m.z) / self.cell_m.z,
            nz,
        );
        let [low, high] = globe
            .altitude_range_m(ray, part)
            .map(|altitude_m| (altitude_m - self.min_m.y) / self.cell_m.y)
            .map(|cell| (cell.floor() as i64).clamp(0, ny as i64 - 1) as usize);
        let column = (z * nx + x) * ny;
        self.bounds[column + low..=column + high]
            .iter()
            .fold(0.0f32, |most, bound| most.max(*bound))
            .into()
    }
}

/// Least and greatest value that a cell of a map can read.
fn value_range(map: &TexelMap, cell: [usize; 2], counts: [usize; 2]) -> [f64; 2] {
    let texels = |axis: usize, size: u32| {
        let [low, high] = extent(cell[axis], f64::from(size) / counts[axis] as f64);
        texels_between(low, high)
    };
    let (mut least, mut most) = (1.0f64, 0.0f64);
    for y in texels(1, map.height()) {
        for x in texels(0, map.width()) {
            let texel = map.texel_repeated(x, y);
            least = least.min(texel);
            most = most.max(texel);
        }
    }
    [least, most]
}

/// The greatest profile of each height cell, per row of types.
struct ProfileBounds {
    types: usize,
    /// Rows of types, height cells along each.
    most: Vec<f64>,
    heights: usize,
}

impl ProfileBounds {
    fn new(profile: &TexelMap, heights: usize) -> Self {
        let last = i64::from(profile.width()) - 1;
        let mut most = Vec::new();
        for row in 0..i64::from(profile.height()) {
            for cell in 0..heights {
                let [low, high] = extent(cell, f64::from(profile.width()) / heights as f64);
                let texels = texels_between(low, high)
                    .map(|x| profile.texel_repeated(x.clamp(0, last), row));
                most.push(texels.fold(0.0, f64::max));
            }
        }
        Self {
            types: profile.height() as usize,
            most,
            heights,
        }
    }

    fn most(&self, height: usize, types: [f64; 2]) -> f64 {
        let [low, high] = types.map(|t| t * self.types as f64);
        let last = self.types as i64 - 1;
        texels_between(low - MARGIN, high + MARGIN)
            .map(|row| row.clamp(0, last) as usize)
            .map(|row| self.most[row * self.heights + height])
            .fold(0.0, f64::max)
    }
}

/// The greatest shape noise of each cell. Where cells do not repeat with the noise, the greatest at all of its height.
struct ShapeBounds {
    /// Cells along a period of the noise, x and z.
    repeat: [usize; 2],
    heights: usize,
    /// Altitudes along a column, columns along x, then z.
    most: Vec<f64>,
}

impl ShapeBounds {
    fn new(weather: &Weather, noise: &Noise, [nx, ny, nz]: [usize; 3]) -> Self {
        let periods = weather.map_span_m / weather.shape_period_m;
        let whole = periods >= 1.0 && periods.fract() == 0.0;
        let repeating = |n: usize| {
            let cells = n as f64 / periods;
            (whole && cells >= 1.0 && cells.fract() == 0.0).then_some(cells as usize)
        };
        let size = f64::from(noise.shape.size());
        let all = 0..=i64::from(noise.shape.size()) - 1;
        // Voxels of a horizontal cell: its own, or all.
        let voxels = |cell: usize, cells: Option<usize>| match cells {
            Some(cells) => {
                let [low, high] = extent(cell, size / cells as f64);
                texels_between(low, high)
            }
            None => all.clone(),
        };
        let (cells_x, cells_z) = (repeating(nx), repeating(nz));
        let repeat = [cells_x.unwrap_or(1), cells_z.unwrap_or(1)];
        // First the greatest of each column's slices, then of the heights that a cell reads.
        let slices: Vec<[u8; 2]> = (0..repeat[0] * repeat[1])
            .into_par_iter()
            .flat_map_iter(|column| {
                let (x, z) = (column % repeat[0], column / repeat[0]);
                let (xs, zs) = (voxels(x, cells_x), voxels(z, cells_z));
                all.clone().map(move |y| {
                    let mut most = [0; 2];
                    for k in zs.clone() {
                        for i in xs.clone() {
                            let texel = noise.shape.texel([i, y, k]);
                            most = [most[0].max(texel[0]), most[1].max(texel[1])];
                        }
                    }
                    most
                })
            })
            .collect();
        let n = noise.shape.size() as usize;
        let mut most = Vec::with_capacity(slices.len() / n * ny);
        for column in slices.chunks_exact(n) {
            for cell in 0..ny {
                let [low, high] = extent(cell, 1.0 / ny as f64);
                let voxel = |fraction: f64| {
                    let altitude_m = weather.base_altitude_m + fraction * weather.thickness_m;
                    (altitude_m - weather.evolved_m) / weather.shape_period_m * size
                };
                let mut greatest = [0; 2];
                // More than a period of heights reads every voxel once.
                for y in texels_between(voxel(low), voxel(high)).take(n) {
                    let [billowy, wispy] = column[y.rem_euclid(n as i64) as usize];
                    greatest = [greatest[0].max(billowy), greatest[1].max(wispy)];
                }
                // The blend of both is linear in its share, so it is greatest at an end.
                let [billowy, wispy] = greatest.map(|byte| f64::from(byte) / 255.0);
                let blend = |fraction: f64| {
                    let share = weather.billowy(fraction);
                    wispy + (billowy - wispy) * share
                };
                most.push(blend(low).max(blend(high)));
            }
        }
        Self {
            repeat,
            heights: ny,
            most,
        }
    }

    fn most(&self, [x, y, z]: [usize; 3]) -> f64 {
        let column = (z % self.repeat[1]) * self.repeat[0] + x % self.repeat[0];
        self.most[column * self.heights + y]
    }
}
