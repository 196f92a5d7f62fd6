#define_import_path skycell::sun_volume
#import skycell::shell::altitude_m
#import skycell::sun_column::rise_m
#ifdef COUNT_READS
#import skycell::density::texture_reads
#endif

// What stands between a place and the sun does not depend on who looks. For each layer a clipmap holds the amount of cloud
// (density integrated over length, m) from a place to the layer's end towards the sun. Its columns run along the sun's
// direction, so that one sweep from the top adds each up; a column is named by its foot, where it meets the layer's base.

/// Levels of the clipmap, each twice as wide as the one before.
const SUN_LEVELS: u32 = 5u;

/// One level, on a torus: the columns that a moving window loses and gains share their texels.
struct SunLevel {
    /// A foot's place on the torus, in periods: foot times per_m plus this.
    offset: vec2f,
    /// Feet between these are known, in the cell's frame, m.
    feet_min_m: vec2f,
    feet_max_m: vec2f,
    /// Periods of the torus per metre.
    per_m: f32,
    /// Where the level's first slice begins along the texture's depth, 0...1.
    first_w: f32,
}

/// One layer's volume, as seen from one cell.
struct SunLayer {
    /// The columns' direction: that of the sun when they were made.
    direction: vec3f,
    base_altitude_m: f32,
    top_altitude_m: f32,
    extinction_per_m: f32,
    /// Length of the samples before the read, in periods of the torus.
    near_periods: f32,
    /// A slice as a share of the texture's depth.
    slice_w: f32,
    /// Distance between the lowest and the highest slice, in slices.
    slices: f32,
    /// Samples before the read.
    near_steps: u32,
    pad_levels: vec2u,
    levels: array<SunLevel, 5>,
}

struct SunVolume {
    layers: array<SunLayer, 4>,
}

@group(0) @binding(1) var sun_depths: texture_3d<f32>;
@group(0) @binding(2) var sun_sampler: sampler;
@group(0) @binding(3) var<uniform> sun_volume: SunVolume;

/// The volume of a layer.
fn sun_layer(layer_index: u32) -> SunLayer {
    return sun_volume.layers[layer_index];
}

/// Where a place is found.
struct SunPlace {
    is_known: bool,
    /// On the torus, in periods.
    uv: vec2f,
    first_w: f32,
    near_m: f32,
}

fn has_foot(level: SunLevel, foot_m: vec2f) -> bool {
    return all(foot_m >= level.feet_min_m) && all(foot_m <= level.feet_max_m);
}

/// The finest level that knows the column through a position.
fn volume_place(planet_radius_m: f32, sun: SunLayer, position: vec3f) -> SunPlace {
    let altitude = altitude_m(planet_radius_m, position);
    let down_m = rise_m(planet_radius_m, position, altitude, sun.direction, sun.base_altitude_m);
    let foot_m = position.xz + sun.direction.xz * down_m;
    let levels = sun.levels;
    var level = levels[4];
    let known4 = has_foot(levels[4], foot_m);
    let known3 = has_foot(levels[3], foot_m);
    let known2 = has_foot(levels[2], foot_m);
    let known1 = has_foot(levels[1], foot_m);
    let known0 = has_foot(levels[0], foot_m);
    if known3 { level = levels[3]; }
    if known2 { level = levels[2]; }
    if known1 { level = levels[1]; }
    if known0 { level = levels[0]; }
    let known = known0 || known1 || known2 || known3 || known4;
    return SunPlace(
        known,
        foot_m * level.per_m + level.offset,
        level.first_w,
        select(0.0, sun.near_periods / level.per_m, known),
    );
}

/// Optical depth of a layer from a position of the place's column towards the sun; 0 where nothing is known.
fn volume_depth(planet_radius_m: f32, sun: SunLayer, place: SunPlace, position: vec3f) -> f32 {
    let altitude = altitude_m(planet_radius_m, position);
    let thickness_m = max(sun.top_altitude_m - sun.base_altitude_m, 1e-3);
    let height_fraction = (altitude - sun.base_altitude_m) / thickness_m;
    let w = place.first_w + sun.slice_w * (0.5 + saturate(height_fraction) * sun.slices);
    let amount_m = read_volume(vec3f(place.uv, w));
    return select(0.0, amount_m * sun.extinction_per_m, place.is_known && height_fraction < 1.0);
}

fn read_volume(uvw: vec3f) -> f32 {
#ifdef COUNT_READS
    texture_reads += 1u;
#endif
#ifdef EXACT_INTERPOLATION
    let size = vec3i(textureDimensions(sun_depths));
    let at = vec3f(fract(uvw.xy), uvw.z) * vec3f(size) - 0.5;
    let below = vec3i(floor(at));
    let share = at - floor(at);
    let low = vec3i((below.xy + size.xy) % size.xy, clamp(below.z, 0, size.z - 1));
    let high = vec3i((below.xy + 1) % size.xy, clamp(below.z + 1, 0, size.z - 1));
    let near = mix(
        mix(textureLoad(sun_depths, low, 0).x, textureLoad(sun_depths, vec3i(high.x, low.yz), 0).x, share.x),
        mix(textureLoad(sun_depths, vec3i(low.x, high.y, low.z), 0).x, textureLoad(sun_depths, vec3i(high.xy, low.z), 0).x, share.x),
        share.y,
    );
    let far = mix(
        mix(textureLoad(sun_depths, vec3i(low.xy, high.z), 0).x, textureLoad(sun_depths, vec3i(high.x, low.y, high.z), 0).x, share.x),
        mix(textureLoad(sun_depths, vec3i(low.x, high.yz), 0).x, textureLoad(sun_depths, high, 0).x, share.x),
        share.y,
    );
    return mix(near, far, share.z);
#else
    return textureSampleLevel(sun_depths, sun_sampler, uvw, 0.0).x;
#endif
}
