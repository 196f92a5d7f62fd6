//! The cloud field: what the density model reads. Noise volumes, coverage and type maps, vertical profile; made on the
//! CPU once, kept on disk, uploaded by `gpu`.

mod grid;
mod heights;
mod layer_maps;
mod map_file;
mod maps;
mod noise;
mod patterns;
mod profile;
mod resample;
mod sheet;
mod store;
mod volumes;

pub use grid::{GridError, VoxelGrid, check_grids, load_grid};
pub use heights::{CloudHeights, Slab};
pub use layer_maps::{LayerMaps, MapFormat, check_maps, content_of_maps};
pub use map_file::{
    GreyMap, MAP_FILE_MAX_BYTES, MAP_SIDE_MAX, MapFileError, MapFileFormat, map_pointer,
    read_map_file,
};
pub use maps::{MAP_SIZE, SKIP_RANGE_SHARE, WeatherMaps, skip_coverage, skip_distances};
pub use profile::{PROFILE_SIZE, mean_height_fraction, profile_texels, vertical_profile};
pub use sheet::SheetMaps;
pub use store::FieldStore;
pub use volumes::{NoiseVolume, VOLUME_SEED, VolumeKind};
