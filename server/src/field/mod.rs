//! The cloud field: what the density model reads. Noise volumes, coverage and type maps, vertical profile; made on the
//! CPU once, kept on disk, uploaded by `gpu`.

mod grid;
mod maps;
mod noise;
mod profile;
mod store;
mod volumes;

pub use grid::{GridError, VoxelGrid, check_grids, load_grid};
pub use maps::{MAP_SIZE, SKIP_RANGE_SHARE, WeatherMaps, skip_distances};
pub use profile::{PROFILE_SIZE, mean_height_fraction, profile_texels, vertical_profile};
pub use store::FieldStore;
pub use volumes::{NoiseVolume, VolumeKind};
