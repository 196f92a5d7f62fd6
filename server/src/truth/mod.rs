//! The way from a scene to the truth about it: gives the f64 reference (`skycell_reference`) the data that the device
//! reads, made by the same generators. The data are inputs of both sides; nothing computed from them is shared.

use crate::field::{
    FieldStore, GridError, MAP_SIZE, PROFILE_SIZE, VolumeKind, load_grid, profile_texels,
    skip_distances,
};
use glam::DVec3;
use skycell_protocol::Scene;
use skycell_protocol::scene::DensityModel;
use skycell_reference::{
    Approximations, ByteMap, ByteVolume, Field, LayerField, Noise, ReferenceError, WeatherMaps,
    World, WorldSettings,
};
use std::path::Path;
use std::sync::Arc;

/// Seed of the noise volumes, as on the device.
const VOLUME_SEED: u32 = 1;

/// Why there is no truth about a scene.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TruthError {
    /// Voxels are missing.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// Data or settings do not fit.
    #[error(transparent)]
    Reference(#[from] ReferenceError),
}

/// What the densities of a scene read. Noise is kept in `noise_dir`, voxels are looked for in `grids_dir`.
///
/// # Errors
/// When voxels cannot be read.
pub fn reference_field(
    scene: &Scene,
    noise_dir: &Path,
    grids_dir: &Path,
) -> Result<Field, TruthError> {
    let store = FieldStore::new(Some(noise_dir.to_owned()));
    let mut field = Field::default();
    for layer in scene.layers() {
        field.layers.push(match layer.density() {
            DensityModel::Homogeneous(_) => LayerField::Nothing,
            DensityModel::Grid(grid) => LayerField::Grid(load_grid(grids_dir, grid)?.values),
            DensityModel::Weather(weather) => {
                let maps = store.weather_maps(weather.seed());
                let skip = skip_distances(&maps.coverage, weather.coverage());
                let map = |what, texels| ByteMap::new(what, MAP_SIZE, MAP_SIZE, texels);
                LayerField::Weather(WeatherMaps {
                    coverage: map("the coverage map", maps.coverage)?,
                    cloud_type: map("the type map", maps.cloud_type)?,
                    skip: map("the skip map", skip)?,
                })
            }
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
        let [heights, types] = PROFILE_SIZE;
        field.noise = Some(Noise {
            shape: volume(VolumeKind::Shape)?,
            detail: volume(VolumeKind::Detail)?,
            profile: ByteMap::new("the profile", heights, types, profile_texels())?,
        });
    }
    Ok(field)
}

/// A scene for the reference, in the frame on the ground under `origin_m` (x, altitude, z).
///
/// # Errors
/// When voxels cannot be read or a number is out of range.
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
