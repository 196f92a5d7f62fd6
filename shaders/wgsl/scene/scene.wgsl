#define_import_path skycell::scene
#import skycell::scattering::Diffusion

// Everything that the shaders know of the scene, in the frame of one cell: origin at the ground point of the cell, y up,
// metres. The Rust side of each struct is in `skycell_shaders::layout`; a test compares names, offsets and sizes.

/// The sphere on which the scene stands. Its centre is at (0, -radius_m, 0).
struct Planet {
    radius_m: f32,
    ground_albedo: f32,
    /// 1, or 0 where nothing lies below: a flat world.
    has_ground: f32,
    /// Fills the struct to 16 bytes, as uniforms demand of nested ones.
    pad_uniform: f32,
}

/// The sun, as seen from the cell.
struct Sun {
    /// Unit vector towards the sun.
    direction: vec3f,
    angular_radius_rad: f32,
    /// Spectral irradiance above the atmosphere, per colour channel.
    irradiance: vec3f,
    /// 1 - cos(angular radius), computed in f64: the shader's cosine would cancel.
    one_minus_mu_disc: f32,
    /// Spectral irradiance on a surface that faces the sun at cloud height.
    irradiance_at_clouds: vec3f,
    /// Spectral irradiance on the ground, from the sun alone.
    ground_irradiance_factor: f32,
}

/// The plain analytic sky: optical depths of the whole column straight up.
struct Sky {
    rayleigh_optical_depth: vec3f,
    aerosol_optical_depth: f32,
    /// Mean radiance of the sky's upper hemisphere (in-scattered into clouds as ambient light).
    mean_radiance: vec3f,
    aerosol_asymmetry: f32,
    /// Radiance of the sunlit ground.
    ground_radiance: vec3f,
    /// How much of the sun's light the sky still has: 1 by day, 0 at night.
    lit: f32,
    /// Optical depth of the whole column towards the sun, and e to its negative.
    sun_column: vec3f,
    pad_column: f32,
    sun_column_kept: vec3f,
    pad_kept: f32,
    /// Higher orders of scattering per unit of what the column towards the viewer takes out, 1/sr.
    diffuse_per_sr: vec3f,
    pad_diffuse: f32,
    /// Extinction of the air at the ground, per channel, 1/m.
    ground_air_extinction_per_m: vec3f,
    pad_ground: f32,
    /// Radiance that comes from every direction beside that of the air.
    environment_radiance: vec3f,
    pad_environment: f32,
}

/// Where droplets or crystals scatter light to: (1 - w) HG(g_hg) + w Draine(g_draine, alpha). One of the two alone, two
/// lobes of HG (alpha 0) and isotropic (HG with g 0) are cases of it.
struct Phase {
    g_hg: f32,
    g_draine: f32,
    alpha_draine: f32,
    draine_weight: f32,
}

/// How light scatters in cloud.
struct Light {
    /// What layers have that have none of their own.
    phase: Phase,
    octaves: u32,
    sun_steps: u32,
    sun_march_distance_m: f32,
    ambient: f32,
    /// Octave i in component i % 4 of element i / 4: a^i, b^i (0 beyond the last octave) and c^i.
    octave_attenuation: array<vec4f, 4>,
    octave_contribution: array<vec4f, 4>,
    octave_eccentricity: array<vec4f, 4>,
    /// What is scattered many times.
    diffusion: Diffusion,
}

/// One cloud layer. Offsets are fractions of a period, reduced in f64 on the CPU, so that time and place never cost
/// precision here.
struct Layer {
    base_altitude_m: f32,
    top_altitude_m: f32,
    extinction_per_m: f32,
    single_scattering_albedo: f32,
    map_offset: vec2f,
    map_per_m: f32,
    /// 1: the shape is the ball in the bounds, else all of them.
    is_ball: u32,
    shape_offset: vec3f,
    shape_per_m: f32,
    detail_offset: vec3f,
    detail_per_m: f32,
    coverage: f32,
    cloud_type: f32,
    detail_strength: f32,
    /// Horizontal distance that the map's skip channel means at 1, m.
    skip_range_m: f32,
    /// Index of this layer's map in the map array.
    map_index: u32,
    /// Mean altitude of its clouds, m above ground.
    proxy_altitude_m: f32,
    /// Unit vector along the fibres of a sheet, x and z.
    fibre_axis: vec2f,
    /// Shortest step inside cloud, m.
    step_min_m: f32,
    /// Step per distance from the ray's origin.
    step_per_distance: f32,
    /// Longest number of lit samples of a ray.
    steps_max: u32,
    /// Mean extinction of the air between the ground and that altitude, per channel, 1/m.
    air_extinction_per_m: vec3f,
    /// A ray stops where less than this share of the light behind could still come through; 0: never.
    transmittance_min: f32,
    /// Lower corner of what has density without maps: x and z in the cell's frame, y an altitude, m.
    bounds_min: vec3f,
    /// 1: every step is lit, empty or not.
    lights_empty_steps: u32,
    /// 1 over the edges of the bounds, 1/m.
    bounds_per_m: vec3f,
    /// First slice of this layer's voxels in the texture that holds all layers'.
    grid_first_slice: u32,
    /// Voxels along x, y and z.
    grid_dimensions: vec3u,
    pad_grid: u32,
    /// Where the droplets or crystals scatter light to.
    phase: Phase,
    /// Shape noise is squeezed into this floor and range: the rest of the threshold is the dimensional profile's, which
    /// keeps bodies whole instead of scattering crumbs above them.
    shape_floor: f32,
    shape_range: f32,
    /// How steeply density rises from a cloud's surface inwards.
    steepness: f32,
    /// How much of the local type hangs on the local coverage, 0...1.
    dome: f32,
    /// Share of wispy noise above the base, 0...1.
    wispiness: f32,
    /// 1 - mean cosine of the phase.
    transport_share: f32,
    /// Share of the type map in the local type, 0...1.
    type_spread: f32,
    pad_form: f32,
    /// Optical depth of the air towards the sun at the layer's base, how much more it is at its top, and what is added in
    /// between: see sun_on_cloud.
    sun_depth_at_base: vec3f,
    /// The layer's thickness over the heights in which air and aerosol fall to 1/e.
    air_folds: f32,
    sun_depth_rise: vec3f,
    aerosol_folds: f32,
    sun_depth_bend: vec3f,
    /// 1; 0 where air in front of the layer is left out.
    has_haze: f32,
}

/// What is seen at night beside sky and clouds. Read only where a scene has a moon or stars.
struct Night {
    /// Unit vector towards the moon.
    moon_direction: vec3f,
    moon_one_minus_mu_disc: f32,
    /// Twice the radiance of the full disc's surface, before the atmosphere dims it.
    moon_radiance: vec3f,
    /// 1, or 0 where the moon takes the sun's place as what lights the sky.
    sun_disc: f32,
    /// Unit vector from the moon to the sun.
    moon_to_sun: vec3f,
    star_brightness: f32,
    /// Rows of the matrix that turns a direction of the cell into one of the stars' field.
    star_x: vec3f,
    pad_x: f32,
    star_y: vec3f,
    pad_y: f32,
    star_z: vec3f,
    pad_z: f32,
}

/// Which part of a ray through a layer counts.
struct Part {
    /// What lies between two altitudes, m, ...
    low_altitude_m: f32,
    high_altitude_m: f32,
    /// ... and between two distances from where the ray starts, m.
    near_m: f32,
    far_m: f32,
    /// The same for a ray that stands in cloud there: it begins and ends in the next gap between clouds, or here.
    near_gap_m: f32,
    far_gap_m: f32,
    /// Between these distances it has all of the density; from near_m and to far_m that goes up and down evenly, m. What a part
    /// lacks of it, the one that it meets has.
    full_near_m: f32,
    full_far_m: f32,
}

/// What keeps a part of a layer: a surface on which the results of rays through it lie.
struct Proxy {
    /// Centre of the octahedral addresses, in the cell's frame; drifts with the layer's wind.
    anchor: vec3f,
    /// Where a shell stands, m above ground; of a dome, the mean altitude of what it keeps.
    altitude_m: f32,
    part: Part,
    /// Index of the layer.
    layer: u32,
    /// Of a dome, which is a sphere about the anchor, m; 0 of a shell.
    radius_m: f32,
    /// 1: anchor and reference are above the layer, and rays go down to it.
    from_above: u32,
    /// From above: rays that pass over the shell have their places no nearer than this, m.
    least_m: f32,
    /// Altitudes between which there is cloud to be looked for, m.
    seen_low_altitude_m: f32,
    seen_high_altitude_m: f32,
    pad_x: u32,
    pad_y: u32,
}

struct Scene {
    planet: Planet,
    layer_count: u32,
    exposure: f32,
    sun: Sun,
    sky: Sky,
    light: Light,
    layers: array<Layer, 4>,
    /// Those of one layer after another, each with as many.
    proxies: array<Proxy, 16>,
    night: Night,
}
