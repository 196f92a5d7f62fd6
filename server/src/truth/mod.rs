//! The way from a scene to the truth about it: gives the f64 reference (`skycell_reference`) the data that the device
//! reads, made by the same generators. The data are inputs of both sides; nothing computed from them is shared.

use crate::field::{
    FieldStore, GridError, LayerMaps, MAP_SIZE, MapFileError, MapFormat, PROFILE_SIZE, VOLUME_SEED,
    VolumeKind, load_grid,
};
use glam::DVec3;
use skycell_protocol::Scene;
use skycell_protocol::scene::DensityModel;
use skycell_reference::{
    Approximations, ByteVolume, Field, LayerField, Noise, ReferenceError, SheetMaps, TexelMap,
    WeatherMaps, World, WorldSettings,
};
use std::path::Path;
use std::sync::Arc;

/// Why there is no truth about a scene.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TruthError {
    /// Voxels are missing.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// A map is missing.
    #[error("{error}; allowed: {}", .error.allowed())]
    Map {
        /// What is wrong with it.
        #[from]
        error: MapFileError,
    },
    /// Data or settings do not fit.
    #[error(transparent)]
    Reference(#[from] ReferenceError),
}

/// Maps of a layer as the device reads them in a format; skips for a layer's coverage.
///
/// # Errors
/// Never: the maps fill their sizes.
pub fn weather_maps(
    maps: &LayerMaps,
    format: MapFormat,
    layer_coverage: f64,
) -> Result<WeatherMaps, ReferenceError> {
    let values = |texels: &[u16]| texels.iter().map(|t| format.value(*t)).collect();
    let map = |what, values| TexelMap::of_values(what, MAP_SIZE, MAP_SIZE, values);
    let skips = maps.skips(format, layer_coverage);
    let [heights, types] = PROFILE_SIZE;
    Ok(WeatherMaps {
        coverage: map("the coverage map", values(&maps.coverage))?,
        cloud_type: map("the type map", values(&maps.cloud_type))?,
        skip: map(
            "the skip map",
            skips.iter().map(|level| format.skip(*level)).collect(),
        )?,
        profile: TexelMap::of_values("the profile", heights, types, values(&maps.profile))?,
    })
}

/// The maps of a thin sheet.
fn sheet_maps(store: &FieldStore, seed: u32) -> Result<SheetMaps, ReferenceError> {
    let maps = store.sheet_maps(seed);
    let map = |what, texels| TexelMap::new(what, MAP_SIZE, MAP_SIZE, texels);
    Ok(SheetMaps {
        patches: map("the map of patches", maps.patches)?,
        fibres: map("the map of fibres", maps.fibres)?,
        veil: map("the map of the veil", maps.veil)?,
    })
}

/// What the densities of a scene read. Noise is kept in `noise_dir`, voxels and maps are looked for in `grids_dir`.
///
/// # Errors
/// When voxels or maps cannot be read.
pub fn reference_field(
    scene: &Scene,
    noise_dir: &Path,
    grids_dir: &Path,
) -> Result<Field, TruthError> {
    let store = FieldStore::new(Some(noise_dir.to_owned()));
    let mut field = Field::default();
    let maps = scene
        .layers()
        .iter()
        .map(|layer| match layer.density() {
            DensityModel::Weather(weather) => store.layer_maps(weather, grids_dir).map(Some),
            _ => Ok(None),
        })
        .collect::<Result<Vec<Option<LayerMaps>>, MapFileError>>()?;
    let format = MapFormat::of(maps.iter().flatten());
    for (layer, maps) in scene.layers().iter().zip(&maps) {
        field.layers.push(match (layer.density(), maps) {
            (DensityModel::Grid(grid), _) => LayerField::Grid(load_grid(grids_dir, grid)?.values),
            (DensityModel::Cirrus(cirrus), _) => {
                LayerField::Sheet(sheet_maps(&store, cirrus.seed())?)
            }
            (DensityModel::Weather(weather), Some(maps)) => {
                LayerField::Weather(weather_maps(maps, format, weather.coverage())?)
            }
            _ => LayerField::Nothing,
        });
    }
    if field
        .layers
        .iter()
        .any(|layer| matches!(layer, LayerField::Weather(_)))
    {
        let volume = |kind: VolumeKind| {
            let noise = store.volume(kind, VOLUME_SEED);
            ByteVolume::new(kind.name(), noise.size, noise.texels)
        };
        field.noise = Some(Noise {
            shape: volume(VolumeKind::Shape)?,
            detail: volume(VolumeKind::Detail)?,
        });
    }
    Ok(field)
}

/// A scene for the reference, in the frame on the ground under `origin_m` (x, altitude, z).
///
/// # Errors
/// When voxels or maps cannot be read or a number is out of range.
pub fn reference_world(
    scene: &Scene,
    noise_dir: &Path,
    grids_dir: &Path,
    time_s: f64,
    origin_m: DVec3,
    approximations: Approximations,
) -> Result<World, TruthError> {
    let field = reference_field(scene, noise_dir, grids_dir)?;
    Ok(World::new(
        scene,
        Arc::new(field),
        WorldSettings {
            time_s,
            origin_xz_m: [origin_m.x, origin_m.z],
            approximations,
        },
    )?)
}
