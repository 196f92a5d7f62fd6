//! From the scene document to marched light: what the marching kernels read, the atlas that they fill, their passes.

mod anchors;
mod atlas;
mod audit;
mod blue_noise;
mod cell_buffers;
mod frame;
mod inside;
mod night;
mod pattern;
mod pixels;
mod proxies;
mod resample;
mod settings;
mod sides;
mod sky;
mod sun_columns;
mod surface;
mod texels;
mod uniforms;
mod window;
mod window_pass;

pub use anchors::anchor_off_max_m;
pub use atlas::{Atlas, TILES_PER_PAGE};
pub use audit::{AUDIT_PLACES, AUDIT_TEXELS_MAX, AuditGroup, AuditMarch, audit_key, finer};
pub use blue_noise::{BLUE_NOISE_SIZE, blue_noise_words};
pub use cell_buffers::CellBuffers;
pub use frame::CellFrame;
pub use inside::{FarPart, REACH_FADE_M, REACH_M, near_layers};
pub use pattern::{FramePlace, WINDOW_FRAMES_MAX, window_places};
pub use pixels::{LISTED_VALUES, MarchedPixels, PixelStrip, pixels_key};
pub use proxies::{
    BANDS, BandEnds, DOME_FOLLOW_M, Dome, PROXIES_MAX, PROXIES_PER_LAYER_MAX, Proxy, ProxySettings,
    ProxySetup, SlabsWithDomes, keep_places, look_where_clouds_are, proxies_of,
};
pub use resample::{ResampleGroup, ResampledTile, record_resample, resample_key};
pub use settings::MarchSettings;
pub use sides::{Side, layer_bounds_m};
pub use sky::{SkyLight, sky_light, sun_angular_radius_rad};
pub use sun_columns::{SunBinding, SunVolumeTexture, sun_columns_key, without_own};
pub use surface::Surface;
pub use texels::{BATCH_TILES_MAX, TexelGroup, TexelMarch, texels_key};
pub use uniforms::{
    ActiveLayer, EXPOSURE_AT_ZERO_EV, LayerBlend, active_layers, drift_m_per_s, grid_first_slices,
    hg_draine_parameters, layer_features, placed_sheets, placed_weather, scene_uniform,
    wind_drifts,
};
pub use window::{TemporalWindow, WindowPlan};
pub use window_pass::{
    WindowRing, WindowStrip, fitting_window, possible_frames, resolve_key, ring_bytes, window_key,
};
