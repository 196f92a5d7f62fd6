#define_import_path skycell::physical
#import skycell::air::{Air, VIEW_COLUMNS, VIEW_SKY_ROWS, VIEW_GROUND_ROWS, HAZE_COLUMNS, HAZE_SKY_ROWS, HAZE_GROUND_ROWS, HAZE_SLICES, HAZE_EXTINCTION_SLICES, air_path, elevation_place, azimuth_place, cos_azimuth, distance_place, row_place, texel_place, phase_rayleigh_per_sr}
#import skycell::phase::phase_hg_per_sr
#ifdef LIGHT_SHAFTS
#import skycell::shafts::{ShaftFrame, SHAFT_ANGLES, SHAFT_SLICES, angle_from_sun, azimuth_place as shaft_azimuth_place, slice_place, texel_of}
#endif

// The air's tables as a composite reads them. They are made for an altitude; every viewer there shares them, whichever
// way he looks. Directions are told by their angle from the viewer's own horizon.

@group(1) @binding(0) var<uniform> air: Air;
@group(1) @binding(1) var air_table: texture_2d<f32>;
@group(1) @binding(2) var mie_table: texture_2d<f32>;
@group(1) @binding(3) var source_table: texture_3d<f32>;
@group(1) @binding(4) var extinction_table: texture_2d<f32>;
@group(1) @binding(5) var air_sampler: sampler;
#ifdef LIGHT_SHAFTS
@group(1) @binding(6) var<uniform> shaft_frame: ShaftFrame;
/// Share of the air's light that clouds leave: across by half-plane, down by angle from the sun, deep by distance.
@group(1) @binding(7) var shaft_table: texture_3d<f32>;
/// Repeats across.
@group(1) @binding(8) var shaft_sampler: sampler;
#endif

/// A direction through the air.
struct AirView {
    /// Of sky, or of the ground and the air in front of it, per unit of the sun's irradiance, 1/sr.
    radiance_per_sr: vec3f,
    /// Rayleigh's phase and the aerosol's, as the haze's source was divided by them.
    mixed_phase_per_sr: f32,
    /// Of all the air.
    transmittance: vec3f,
    on_ground: bool,
    /// Places in the table of haze.
    azimuth: f32,
    row: f32,
    /// The part of the ray that has air.
    start_m: f32,
    length_m: f32,
#ifdef LIGHT_SHAFTS
    /// Places in the table of light shafts.
    shafts: vec2f,
#endif
}

/// Mean extinction and source of the air as far as a distance.
struct Haze {
    extinction_per_m: vec3f,
    /// Per unit of the sun's irradiance, 1/sr.
    source_per_sr: vec3f,
    start_m: f32,
}

/// Towards a direction: mu, mu_sun: cosines of its and the sun's angle from the zenith; angle: 1 - cos from the sun.
fn air_view(radius_m: f32, altitude_m: f32, mu: f32, mu_sun: f32, angle: f32, on_ground: bool) -> AirView {
    let medium = air;
    let nu = 1.0 - angle;
    let azimuth = azimuth_place(cos_azimuth(mu, mu_sun, nu));
    let elevation = elevation_place(medium, altitude_m, mu, on_ground);
    let at = vec2f(texel_place(azimuth, VIEW_COLUMNS), row_place(elevation, VIEW_SKY_ROWS, VIEW_GROUND_ROWS, on_ground));
    let scattered = exp(textureSampleLevel(air_table, air_sampler, at, 0.0).xyz);
    let mie = exp(textureSampleLevel(mie_table, air_sampler, at, 0.0).xyz);
    let mie_per_sr = phase_hg_per_sr(medium.mie_asymmetry, angle);
    let path = air_path(radius_m, medium.top_m, altitude_m, mu, on_ground);
    var view: AirView;
    view.radiance_per_sr = (scattered + mie * mie_per_sr) * select(max(path.end_m - path.start_m, 0.0), 1.0, on_ground);
    view.mixed_phase_per_sr = phase_rayleigh_per_sr(nu) + medium.haze_mie_weight * mie_per_sr;
    view.on_ground = on_ground;
    view.azimuth = texel_place(azimuth, HAZE_COLUMNS);
    view.row = row_place(elevation, HAZE_SKY_ROWS, HAZE_GROUND_ROWS, on_ground);
    view.start_m = path.start_m;
    view.length_m = max(path.end_m - path.start_m, 0.0);
    let last = vec2f(texel_place(1.0, HAZE_EXTINCTION_SLICES), view.row);
    let extinction = textureSampleLevel(extinction_table, air_sampler, last, 0.0).xyz;
    view.transmittance = exp(-extinction * view.length_m);
    return view;
}

/// The air along a direction as far as a distance from the eye.
fn haze_until(view: AirView, distance_m: f32) -> Haze {
    let share = (distance_m - view.start_m) / max(view.length_m, 1.0);
    let place = distance_place(share, view.on_ground);
    let source = textureSampleLevel(source_table, air_sampler, vec3f(view.azimuth, view.row, texel_place(place, HAZE_SLICES)), 0.0).xyz;
    let extinction = textureSampleLevel(extinction_table, air_sampler, vec2f(texel_place(place, HAZE_EXTINCTION_SLICES), view.row), 0.0).xyz;
#ifdef LIGHT_SHAFTS
    let lit = shaft_share(view, slice_place(shaft_frame, distance_m - view.start_m));
    return Haze(extinction, source * view.mixed_phase_per_sr * lit, view.start_m);
#else
    return Haze(extinction, source * view.mixed_phase_per_sr, view.start_m);
#endif
}

#ifdef LIGHT_SHAFTS
/// Share of the light of the air as far as a place among the slices that clouds leave.
fn shaft_share(view: AirView, slice: f32) -> vec3f {
    let at = vec3f(view.shafts, texel_of(slice, SHAFT_SLICES));
    let share = textureSampleLevel(shaft_table, shaft_sampler, at, 0.0).xyz;
    return 1.0 - shaft_frame.is_known * (1.0 - share);
}

/// The same view with the shadow of clouds in its air. What the ground throws back comes through as without.
fn shaded_view(view: AirView, direction: vec3f) -> AirView {
    var shaded = view;
    let frame = shaft_frame;
    shaded.shafts = vec2f(shaft_azimuth_place(frame, direction), texel_of(angle_from_sun(frame, direction) / 3.141592653589793, SHAFT_ANGLES));
    let share = shaft_share(shaded, select(1.0, slice_place(frame, view.length_m), view.on_ground));
    // The haze in front of the ground, of the table without shadow. No branch: the software driver of Mesa 22 crashes over
    // one whose condition holds a uniform.
    let last = texel_place(1.0, HAZE_SLICES);
    let source = textureSampleLevel(source_table, air_sampler, vec3f(view.azimuth, view.row, last), 0.0).xyz;
    let added = source * view.mixed_phase_per_sr * (1.0 - view.transmittance);
    let scattered = select(view.radiance_per_sr, added, view.on_ground);
    shaded.radiance_per_sr = max(view.radiance_per_sr - (1.0 - share) * scattered, vec3f(0.0));
    return shaded;
}
#endif
