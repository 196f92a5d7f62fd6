//! Which numbers a scene may hold. The domain types check them; tests of extremes walk them.

use crate::number_range::NumberRange;

/// `/planet/radius_m`
pub const PLANET_RADIUS_M: NumberRange = NumberRange::new(1.0e4, 1.0e8);
/// `/planet/ground_albedo`
pub const GROUND_ALBEDO: NumberRange = NumberRange::new(0.0, 1.0);
/// `/sun/azimuth_deg` and the `towards_deg` of winds
pub const AZIMUTH_DEG: NumberRange = NumberRange::new(-360.0, 360.0);
/// `/sun/elevation_deg`
pub const ELEVATION_DEG: NumberRange = NumberRange::new(-90.0, 90.0);
/// `/moon/phase_angle_deg`
pub const PHASE_ANGLE_DEG: NumberRange = NumberRange::new(-180.0, 180.0);
/// `/stars/brightness`
pub const STAR_BRIGHTNESS: NumberRange = NumberRange::new(0.0, 1.0e3);
/// `/stars/turn_deg`
pub const TURN_DEG: NumberRange = NumberRange::new(-1.0e6, 1.0e6);
/// each of `/sun/irradiance_w_per_m2_nm`
pub const IRRADIANCE_W_PER_M2_NM: NumberRange = NumberRange::new(0.0, 1.0e4);
/// `/atmosphere/aerosol_optical_depth`
pub const AEROSOL_OPTICAL_DEPTH: NumberRange = NumberRange::new(0.0, 5.0);
/// `/atmosphere/aerosol_angstrom_exponent`
pub const AEROSOL_ANGSTROM_EXPONENT: NumberRange = NumberRange::new(-1.0, 4.0);
/// `/atmosphere/aerosol_single_scattering_albedo`
pub const AEROSOL_SINGLE_SCATTERING_ALBEDO: NumberRange = NumberRange::new(0.0, 1.0);
/// `/atmosphere/aerosol_asymmetry`
pub const AEROSOL_ASYMMETRY: NumberRange = NumberRange::new(-0.95, 0.95);
/// `/atmosphere/aerosol_scale_height_m` and `rayleigh_scale_height_m`
pub const SCALE_HEIGHT_M: NumberRange = NumberRange::new(200.0, 2.0e4);
/// `/atmosphere/rayleigh_density`
pub const RAYLEIGH_DENSITY: NumberRange = NumberRange::new(0.0, 20.0);
/// `/atmosphere/ozone_dobson`
pub const OZONE_DOBSON: NumberRange = NumberRange::new(0.0, 2000.0);
/// How many layers a scene may have.
pub const LAYERS_MAX: usize = 4;
/// How many characters a layer's name may have; at least one.
pub const LAYER_NAME_MAX_CHARS: usize = 32;
/// `base_altitude_m` and `top_altitude_m`; the top is not below the base either
pub const LAYER_ALTITUDE_M: NumberRange = NumberRange::new(0.0, 2.0e5);
/// x and z of the shapes and bounds of a layer's density
pub const SHAPE_HORIZONTAL_M: NumberRange = NumberRange::new(-2.0e7, 2.0e7);
/// altitudes of the shapes and bounds of a layer's density
pub const SHAPE_ALTITUDE_M: NumberRange = NumberRange::new(-2.0e5, 4.0e5);
/// `size_m` of a box and `radius_m` of a ball
pub const SHAPE_SIZE_M: NumberRange = NumberRange::new(1.0e-3, 4.0e7);
/// each of `dimensions` of a grid
pub const GRID_DIMENSION: NumberRange = NumberRange::new(1.0, 2048.0);
/// How many voxels a grid may have: 256 MiB.
pub const GRID_VOXELS_MAX: u64 = 1 << 26;
/// How many characters the name of a grid's file may have; at least one.
pub const GRID_FILE_MAX_CHARS: usize = 64;
/// each of `radiance_w_per_m2_nm_sr` of a uniform environment
pub const ENVIRONMENT_RADIANCE: NumberRange = NumberRange::new(0.0, 1.0e4);
/// `coverage`
pub const COVERAGE: NumberRange = NumberRange::new(0.0, 1.0);
/// `type`
pub const CLOUD_TYPE: NumberRange = NumberRange::new(0.0, 1.0);
/// `map_span_m`
pub const MAP_SPAN_M: NumberRange = NumberRange::new(1.0e3, 1.0e6);
/// `shape_period_m`
pub const SHAPE_PERIOD_M: NumberRange = NumberRange::new(100.0, 1.0e5);
/// `detail_period_m`
pub const DETAIL_PERIOD_M: NumberRange = NumberRange::new(10.0, 1.0e4);
/// `detail_strength`
pub const DETAIL_STRENGTH: NumberRange = NumberRange::new(0.0, 1.0);
/// `evolution_m_per_s`
pub const EVOLUTION_M_PER_S: NumberRange = NumberRange::new(-50.0, 50.0);
/// `transition_s` of maps and `/transition/duration_s`: a day at most
pub const TRANSITION_S: NumberRange = NumberRange::new(0.0, 86_400.0);
/// `optical_depth` of a sheet of ice
pub const SHEET_OPTICAL_DEPTH: NumberRange = NumberRange::new(0.0, 100.0);
/// `fibre_period_m`
pub const FIBRE_PERIOD_M: NumberRange = NumberRange::new(1.0e3, 1.0e6);
/// `extinction_per_m`
pub const EXTINCTION_PER_M: NumberRange = NumberRange::new(0.0, 1.0e3);
/// `single_scattering_albedo`
pub const SINGLE_SCATTERING_ALBEDO: NumberRange = NumberRange::new(0.0, 1.0);
/// `droplet_diameter_um`: where the fit of Jendersie & d'Eon 2023 holds
pub const DROPLET_DIAMETER_UM: NumberRange = NumberRange::new(5.0, 50.0);
/// `g`
pub const PHASE_G: NumberRange = NumberRange::new(-0.999, 0.999);
/// `alpha`
pub const DRAINE_ALPHA: NumberRange = NumberRange::new(0.0, 1.0e4);
/// `octaves`
pub const OCTAVES: NumberRange = NumberRange::new(1.0, 16.0);
/// `octave_attenuation`, `octave_contribution` and `octave_eccentricity`
pub const OCTAVE_FACTOR: NumberRange = NumberRange::new(0.0, 1.0);
/// `sun_steps`
pub const SUN_STEPS: NumberRange = NumberRange::new(1.0, 64.0);
/// `sun_march_distance_m`
pub const SUN_MARCH_DISTANCE_M: NumberRange = NumberRange::new(1.0, 1.0e5);
/// `ambient`
pub const AMBIENT: NumberRange = NumberRange::new(0.0, 10.0);
/// `speed_m_per_s`
pub const WIND_SPEED_M_PER_S: NumberRange = NumberRange::new(0.0, 200.0);
/// `adaptation_s` of `/tone/auto_exposure`
pub const ADAPTATION_S: NumberRange = NumberRange::new(0.0, 60.0);
/// `/exposure_ev`, and `min_ev` and `max_ev` of `/tone/auto_exposure`
pub const EXPOSURE_EV: NumberRange = NumberRange::new(-30.0, 30.0);
/// `/sun/place_and_time/latitude_deg` and `/stars/latitude_deg`
pub const LATITUDE_DEG: NumberRange = NumberRange::new(-90.0, 90.0);
/// `/sun/place_and_time/longitude_deg`
pub const LONGITUDE_DEG: NumberRange = NumberRange::new(-180.0, 180.0);
/// Sky times: about 3000 years before and after
pub const SKY_TIME_S: NumberRange = NumberRange::new(-1.0e11, 1.0e11);
/// `rate` and `wind_rate` of `/time`: at the ends a day passes in less than a second
pub const TIME_RATE: NumberRange = NumberRange::new(-1.0e5, 1.0e5);
/// How many animations a scene may have.
pub const ANIMATIONS_MAX: usize = 32;
/// How many keyframes an animation may have; at least one.
pub const KEYFRAMES_MAX: usize = 64;
/// How far the wind may have carried clouds along an axis: beyond, places have less than a millimetre's digits
pub const DRIFT_M: NumberRange = NumberRange::new(-1.0e12, 1.0e12);
