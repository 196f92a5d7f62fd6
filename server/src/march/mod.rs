//! From the scene document to marched light: what the marching kernels read, the atlas that they fill, their passes.

mod atlas;
mod audit;
mod cell_buffers;
mod frame;
mod night;
mod pixels;
mod settings;
mod sky;
mod sun_columns;
mod texels;
mod uniforms;

pub use atlas::{Atlas, TILES_PER_PAGE};
pub use audit::{AUDIT_PLACES, AUDIT_TEXELS_MAX, AuditGroup, AuditMarch, audit_key, finer};
pub use cell_buffers::CellBuffers;
pub use frame::CellFrame;
pub use pixels::{LISTED_VALUES, MarchedPixels, PixelStrip, pixels_key};
pub use settings::MarchSettings;
pub use sky::{SkyLight, sky_light, sun_angular_radius_rad};
pub use sun_columns::{SunBinding, SunVolumeTexture, sun_columns_key, without_own};
pub use texels::{BATCH_TILES_MAX, TexelGroup, TexelMarch, texels_key};
pub use uniforms::{
    ActiveLayer, EXPOSURE_AT_ZERO_EV, LayerBlend, active_layers, drift_m_per_s, grid_first_slices,
    hg_draine_parameters, layer_features, placed_sheets, placed_weather, scene_uniform,
    wind_drifts,
};
