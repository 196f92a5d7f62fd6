#define_import_path skycell::march
#import skycell::scene::{Scene, Layer, Part}
#import skycell::shell::{altitude_m, layer_intervals, LayerIntervals}
#import skycell::transport::one_minus_exp_over
#import skycell::phase::{one_minus_mu, phase_per_sr}
#import skycell::scattering::{Diffusion, Surroundings, diffuse_share, sky_share}
#ifdef DENSITY_WEATHER
#import skycell::density::{map_texel, dimensional_profile, carved_density, smooth_density, broad_density}
#else
#ifdef DENSITY_CIRRUS
#import skycell::density::sheet_density
#else
#import skycell::density::{bounded_density, over_bounds}
#endif
#endif
#ifdef SUN_VOLUME
#import skycell::sun_volume::{SunLayer, sun_layer, volume_place, volume_depth}
#endif

@group(0) @binding(0) var<uniform> scene: Scene;

/// What one ray gathers in one layer, per unit of the light that comes in; colours and the single scattering's phase are
/// multiplied in where it is shown.
struct LayerRadiance {
    /// Single scattering without its phase: ∫ T σs e^(-τ_sun) dt.
    single: f32,
    /// Octaves from the second on, with their broad phases for this ray, 1/sr.
    octaves: f32,
    /// Ambient light that is scattered in, as a share of the sky's mean radiance.
    ambient: f32,
    transmittance: f32,
    /// Distance of what is seen from the ray's origin, m, times its opacity. With what is behind weighed by
    /// CLEAR_OPACITY: see distance_seen_m. Like the other members, this can be averaged and interpolated.
    opacity_distance_m: f32,
}

/// What the layer itself counts for in the mean distance, so that it is known where nothing is seen.
const CLEAR_OPACITY: f32 = 1e-3;

/// Mean distance of what is seen, m.
fn distance_seen_m(opacity_distance_m: f32, transmittance: f32) -> f32 {
    return opacity_distance_m / (1.0 - transmittance + CLEAR_OPACITY);
}

/// Detail begins to fade where its voxels are seen under this angle, a pixel and a half of a 720-line picture, and is gone
/// at half of it. The same for every renderer and resolution: a cloud's shape must not depend on who looks.
const DETAIL_ANGLE_RAD: f32 = 2.2e-3;
/// How far what is around a cloud's light is looked for upright, m; sideways twice as far. The fitted constants go with it.
const SURROUNDINGS_REACH_M: f32 = 1500.0;
/// What a ray sees of a cloud within so much of where it first meets it is lit as one place, m; what lies farther back, as
/// another. One mean place for both could stand in the clear air between two clouds.
const FRONT_LENGTH_M: f32 = 1000.0;
/// A limit that no sensible ray reaches (steps are at least step_min_m long).
const PROBES_MAX: u32 = 4096u;

#ifdef RAY_LIST
/// What the last ray took: lit steps and probes, and its optical depth.
var<private> steps_taken: u32 = 0u;
var<private> optical_depth_seen: f32 = 0.0;
#endif

#ifdef WINDOW
/// How many steps of the whole march one step is long: a frame of a temporal window takes every so many-th sample.
var<private> step_scale: f32 = 1.0;
/// Into how many parts a step is cut where cloud begins.
var<private> refinement: f32 = 1.0;
#endif

/// What a ray needs of the scene. Read once before the first branch: software drivers read uniforms lane by lane behind
/// one, which costs more than the arithmetic.
struct RayScene {
    planet_radius_m: f32,
    sun_direction: vec3f,
    sun_steps: u32,
    sun_march_distance_m: f32,
    diffusion: Diffusion,
#ifdef SUN_VOLUME
    /// The sun volume of the ray's layer, and of the others.
    sun_own: SunLayer,
#if SUN_LAYERS > 1
    sun_second: SunLayer,
#endif
#if SUN_LAYERS > 2
    sun_third: SunLayer,
#endif
#if SUN_LAYERS > 3
    sun_fourth: SunLayer,
#endif
#endif
}

fn ray_scene(layer_index: u32) -> RayScene {
    var ray: RayScene;
    ray.planet_radius_m = scene.planet.radius_m;
    ray.sun_direction = scene.sun.direction;
    ray.sun_steps = scene.light.sun_steps;
    ray.sun_march_distance_m = scene.light.sun_march_distance_m;
    ray.diffusion = scene.light.diffusion;
#ifdef SUN_VOLUME
    ray.sun_own = sun_layer(layer_index);
#if SUN_LAYERS > 1
    ray.sun_second = sun_layer((layer_index + 1u) % #{SUN_LAYERS}u);
#endif
#if SUN_LAYERS > 2
    ray.sun_third = sun_layer((layer_index + 2u) % #{SUN_LAYERS}u);
#endif
#if SUN_LAYERS > 3
    ray.sun_fourth = sun_layer((layer_index + 3u) % #{SUN_LAYERS}u);
#endif
#endif
    return ray;
}

/// Factor of the sun's optical depth in an octave's four components: as the document has it, or per transport share where
/// constants are fitted.
fn attenuation_of(ray: RayScene, layer: Layer, factors: vec4f, vector: u32) -> vec4f {
    let scale = select(1.0, layer.transport_share, ray.diffusion.strength > 0.0);
    let scaled = min(factors * scale, vec4f(1.0));
    return select(scaled, vec4f(1.0, scaled.yzw), vector == 0u);
}

/// Length of a step at a distance from the ray's origin, m: step_min_m, and in proportion to the distance beyond.
fn step_length_m(layer: Layer, distance_m: f32) -> f32 {
    return max(layer.step_min_m, distance_m * layer.step_per_distance);
}

// Every ray samples at steps whose count from its origin has the same fraction, wherever cloud begins and however far
// empty space was skipped. Samples of one texel with other fractions then interleave to one march with as many times
// finer steps, and their mean hardly differs from texel to texel; free-running samples are noise.

/// Steps from the ray's origin to a distance.
fn steps_at(layer: Layer, distance_m: f32) -> f32 {
    let relative = distance_m * layer.step_per_distance / layer.step_min_m;
    return select(relative, 1.0 + log(max(relative, 1.0)), relative > 1.0) / layer.step_per_distance;
}

/// Distance of a number of steps from the ray's origin, m: the inverse.
fn distance_at_m(layer: Layer, steps: f32) -> f32 {
    let relative = steps * layer.step_per_distance;
    return select(relative, exp(max(relative, 1.0) - 1.0), relative > 1.0) * layer.step_min_m / layer.step_per_distance;
}

/// The first sample at or beyond a distance, in steps.
fn first_sample_at(layer: Layer, distance_m: f32, start_fraction: f32) -> f32 {
    return ceil(steps_at(layer, distance_m) - start_fraction) + start_fraction;
}

#ifdef WINDOW
/// The first whole step behind the present one.
fn whole_step_after(steps: f32, share: f32, start_fraction: f32) -> f32 {
    return ceil(steps + 0.5 * share - start_fraction) + start_fraction;
}

/// Where a ray goes on that is not in cloud or has just come upon it with a whole step (x: steps from its origin, y: length
/// of the next step, z: parts of a step without cloud). Coming upon cloud it goes back to behind the last whole step and
/// on in parts; after a whole step's parts without cloud it takes whole steps again.
/// Never before `begin`, where the ray has entered the layer.
fn refined_step(steps: f32, share: f32, empty_parts: f32, is_cloud: bool, fine: f32, start_fraction: f32, begin: f32) -> vec3f {
    let begins = is_cloud && share >= 1.0;
    let empty = empty_parts + 1.0;
    let ends = share < 1.0 && empty * share >= 1.0;
    let goes_on = select(vec3f(steps + share, share, empty), vec3f(whole_step_after(steps, share, start_fraction), 1.0, 0.0), ends);
    let first = ceil((begin - start_fraction) / fine) * fine + start_fraction;
    return select(goes_on, vec3f(max(steps - 1.0 + fine, first), fine, 0.0), begins);
}
#endif

/// Density at a place as the sun sees it, 0...1: without detail, and 0 outside the layer.
fn sun_density(planet_radius_m: f32, layer: Layer, position: vec3f) -> f32 {
    let altitude = altitude_m(planet_radius_m, position);
    let thickness_m = max(layer.top_altitude_m - layer.base_altitude_m, 1e-3);
    let height_fraction = (altitude - layer.base_altitude_m) / thickness_m;
    let inside = height_fraction >= 0.0 && height_fraction <= 1.0;
#ifdef DENSITY_WEATHER
    let profile = dimensional_profile(layer, map_texel(layer, position.xz), height_fraction);
    let density = smooth_density(layer, position, altitude, height_fraction, profile);
#else
#ifdef DENSITY_CIRRUS
    let density = sheet_density(layer, position.xz);
#else
    let density = bounded_density(layer, position, altitude);
#endif
#endif
    return select(0.0, density, inside);
}

/// Density around a place on the mean, 0...1: what light that has been scattered often passes through. 0 outside the layer.
fn surrounding_density(planet_radius_m: f32, layer: Layer, position: vec3f) -> f32 {
#ifdef DENSITY_WEATHER
    let altitude = altitude_m(planet_radius_m, position);
    let thickness_m = max(layer.top_altitude_m - layer.base_altitude_m, 1e-3);
    let height_fraction = (altitude - layer.base_altitude_m) / thickness_m;
    let inside = height_fraction >= 0.0 && height_fraction <= 1.0;
    let profile = dimensional_profile(layer, map_texel(layer, position.xz), height_fraction);
    return select(0.0, broad_density(layer, profile), inside);
#else
    return sun_density(planet_radius_m, layer, position);
#endif
}

/// Optical depth towards the sun of the layers that a ray does not march through, where the volume knows them.
fn other_layers_sun_depth(ray: RayScene, position: vec3f) -> f32 {
    var depth = 0.0;
#if SUN_LAYERS > 1
    depth += volume_depth(ray.planet_radius_m, ray.sun_second, volume_place(ray.planet_radius_m, ray.sun_second, position), position);
#endif
#if SUN_LAYERS > 2
    depth += volume_depth(ray.planet_radius_m, ray.sun_third, volume_place(ray.planet_radius_m, ray.sun_third, position), position);
#endif
#if SUN_LAYERS > 3
    depth += volume_depth(ray.planet_radius_m, ray.sun_fourth, volume_place(ray.planet_radius_m, ray.sun_fourth, position), position);
#endif
    return depth;
}

#ifdef DENSITY_CIRRUS
/// How far apart samples of a sheet stand along the ground where their number allows it, m: a few texels of its map.
const SHEET_SAMPLE_M: f32 = 120.0;
/// Samples of a sheet on one part of a ray that every quality may take, and steps of a layer's march that one more stands for.
const SHEET_SAMPLES_LEAST: f32 = 8.0;
const STEPS_PER_SHEET_SAMPLE: f32 = 16.0;

/// Samples on a part of a ray through a sheet, `most` of them where it is long.
fn sheet_samples(length_m: f32, across: f32, most: f32) -> f32 {
    return select(0.0, clamp(ceil(length_m * across / SHEET_SAMPLE_M), 1.0, max(most, 1.0)), length_m > 0.0);
}

/// Most samples on a part of a view ray: more where other layers take more steps.
fn sheet_samples_max(layer: Layer) -> f32 {
    let steps = (layer.top_altitude_m - layer.base_altitude_m) / layer.step_min_m;
    return max(SHEET_SAMPLES_LEAST, floor(steps / STEPS_PER_SHEET_SAMPLE + 0.5));
}

/// Optical depth from a point of a sheet towards the sun, within the sheet: by samples in the middles of even parts, as far
/// apart as those along the view where sun_steps allow as many. Under a low sun one fibre shades the next.
fn sheet_sun_depth(ray: RayScene, layer: Layer, position: vec3f) -> f32 {
    let length_m = sheet_sun_length_m(ray, layer, position);
    let count = sheet_samples(length_m, length(ray.sun_direction.xz), f32(ray.sun_steps));
    let part_m = length_m / max(count, 1.0);
    var sum = 0.0;
    for (var i = 0.0; i < count; i += 1.0) {
        let sample = position + ray.sun_direction * ((i + 0.5) * part_m);
        sum += sheet_density(layer, sample.xz);
    }
    return sum * part_m * layer.extinction_per_m;
}

/// Optical depth from a point of a sheet towards the sun, of all layers where the volume knows them.
fn sun_optical_depth(ray: RayScene, layer: Layer, position: vec3f) -> f32 {
    return sheet_sun_depth(ray, layer, position) + other_layers_sun_depth(ray, position);
}

/// The way from a point of a sheet towards the sun inside it, m.
fn sheet_sun_length_m(ray: RayScene, layer: Layer, position: vec3f) -> f32 {
    let way = layer_intervals(ray.planet_radius_m, false, layer.base_altitude_m, layer.top_altitude_m, position, ray.sun_direction);
    // Going up, a ray has the base behind it and the second part alone.
    let first_m = way.first_end_m - way.first_start_m;
    let second_m = way.second_end_m - way.second_start_m;
    return min(max(select(second_m, first_m, first_m > 0.0), 0.0), ray.sun_march_distance_m);
}

/// How much of a sheet is around a point of it: it goes on as it is there. samples: 0 where nobody asks.
fn surroundings(ray: RayScene, layer: Layer, position: vec3f, up: vec3f, samples: u32) -> Surroundings {
    let per_m = select(0.0, sheet_density(layer, position.xz) * layer.extinction_per_m, samples > 0u);
    let away = layer_intervals(ray.planet_radius_m, false, layer.base_altitude_m, layer.top_altitude_m, position, -ray.sun_direction);
    let behind_m = min(max(away.first_end_m - away.first_start_m, 0.0), 2.0 * SURROUNDINGS_REACH_M);
    let altitude = clamp(altitude_m(ray.planet_radius_m, position), layer.base_altitude_m, layer.top_altitude_m);
    return Surroundings(
        per_m * behind_m,
        per_m * (layer.top_altitude_m - altitude),
        per_m * (altitude - layer.base_altitude_m),
        per_m * 4.0 * SURROUNDINGS_REACH_M,
    );
}
#else
/// Optical depth from a point towards the sun. By the cone: within the point's layer, by sun_steps samples in the middles
/// of quadratically growing parts. By the volume: of all layers and to their ends, the first part by samples and the rest
/// by one read; where no level of the volume knows the point, by the cone.
fn sun_optical_depth(ray: RayScene, layer: Layer, position: vec3f) -> f32 {
    var steps = ray.sun_steps;
    var distance_m = ray.sun_march_distance_m;
    var beyond = 0.0;
#ifdef SUN_VOLUME
    let place = volume_place(ray.planet_radius_m, ray.sun_own, position);
    steps = select(steps, ray.sun_own.near_steps, place.is_known);
    distance_m = select(distance_m, place.near_m, place.is_known);
    beyond = volume_depth(ray.planet_radius_m, ray.sun_own, place, position + ray.sun_direction * place.near_m);
    beyond += other_layers_sun_depth(ray, position);
#endif
    let count = f32(steps);
    var sum_m = 0.0;
    for (var i = 0u; i < steps; i += 1u) {
        let near = f32(i) / count;
        let far = f32(i + 1u) / count;
        let start_m = near * near * distance_m;
        let end_m = far * far * distance_m;
        let sample = position + ray.sun_direction * (0.5 * (start_m + end_m));
        sum_m += sun_density(ray.planet_radius_m, layer, sample) * (end_m - start_m);
    }
    return sum_m * layer.extinction_per_m + beyond;
}

/// How much cloud is around a point: five ways in one loop, which keeps the code as short as one. samples: of each way, in
/// the middles of parts that grow with the square of their number.
fn surroundings(ray: RayScene, layer: Layer, position: vec3f, up: vec3f, samples: u32) -> Surroundings {
    let across = cross(ray.sun_direction, up);
    let across_squared = dot(across, across);
    // Under a sun in the zenith any horizontal way will do.
    let side = select(vec3f(1.0, 0.0, 0.0), across * inverseSqrt(max(across_squared, 1e-6)), across_squared > 1e-6);
    var depths = vec4f(0.0);
    for (var i = 0u; i < 5u * samples; i += 1u) {
        let way = i % 5u;
        var direction = select(-side, side, way == 3u);
        direction = select(direction, -ray.sun_direction, way == 0u);
        direction = select(direction, up, way == 1u);
        direction = select(direction, -up, way == 2u);
        // Clouds are wider than they are high.
        let reach_m = SURROUNDINGS_REACH_M * select(2.0, 1.0, way == 1u || way == 2u);
        let near = f32(i / 5u) / f32(samples);
        let far = f32(i / 5u + 1u) / f32(samples);
        let middle_m = 0.5 * (near * near + far * far) * reach_m;
        let length_m = (far * far - near * near) * reach_m;
        let depth = surrounding_density(ray.planet_radius_m, layer, position + direction * middle_m) * length_m * layer.extinction_per_m;
        depths += select(vec4f(0.0), vec4f(depth), vec4<bool>(way == 0u, way == 1u, way == 2u, way >= 3u));
    }
    return Surroundings(depths.x, depths.y, depths.z, depths.w);
}
#endif

/// All of a layer.
fn whole(layer: Layer) -> Part {
    return Part(layer.base_altitude_m, layer.top_altitude_m, 0.0, 1e30, 0.0, 1e30, 0.0, 1e30);
}

/// Share of the density that a part has at a distance, 0...1.
fn share_at(part: Part, distance_m: f32) -> f32 {
    let from_near = (part.full_near_m - distance_m) / max(part.full_near_m - part.near_m, 1.0);
    let from_far = (distance_m - part.full_far_m) / max(part.far_m - part.full_far_m, 1.0);
    return saturate(1.0 - max(from_near, from_far));
}

#ifdef BANDS
// A band of distance ends in a gap between clouds. Of two bands that meet, both look at the first sample at or beyond the
// distance at which they do: where that is clear, there the near one ends and the far one begins. Where it is in cloud, the near
// one goes on, and the far one takes no light, until a sample is clear, or at a distance of which both know. Of each ray so each
// sample is in one band.

/// Where an interval of a layer begins in a band, and where it ends at the latest; empty where it begins behind the band's end:
/// outside a layer is a gap. A sheet is in one band as a whole.
fn within_band(part: Part, start_m: f32, end_m: f32) -> vec2f {
#ifdef DENSITY_CIRRUS
    return vec2f(start_m, select(start_m, end_m, start_m >= part.near_m && start_m < part.far_m));
#else
    let latest_m = min(end_m, part.far_gap_m);
    return vec2f(max(start_m, part.near_m), select(latest_m, start_m, start_m >= part.far_m));
#endif
}

/// How far a band's ray goes on without light while it is in the cloud in which it begins, m; 0 where it begins at its layer.
fn head_end_m(part: Part, start_m: f32) -> f32 {
    return select(0.0, part.near_gap_m, start_m <= part.near_m);
}

/// Where a band's ray ends: here, when it is clear behind the band's end.
fn band_end_m(part: Part, end_m: f32, distance_m: f32, is_clear: bool) -> f32 {
    return select(end_m, min(end_m, distance_m), is_clear && distance_m >= part.far_m);
}
#endif

/// Where a ray is in a part of a layer: both intervals between its altitudes, cut to its distances.
fn part_intervals(planet_radius_m: f32, has_ground: bool, part: Part, origin: vec3f, direction: vec3f) -> LayerIntervals {
    let between = layer_intervals(planet_radius_m, has_ground, part.low_altitude_m, part.high_altitude_m, origin, direction);
#ifdef BANDS
    let first = within_band(part, between.first_start_m, between.first_end_m);
    let second = within_band(part, between.second_start_m, between.second_end_m);
    return LayerIntervals(first.x, first.y, second.x, second.y);
#else
    return LayerIntervals(
        max(between.first_start_m, part.near_m),
        min(between.first_end_m, part.far_m),
        max(between.second_start_m, part.near_m),
        min(between.second_end_m, part.far_m),
    );
#endif
}

#ifdef DENSITY_CIRRUS
/// One ray through a thin sheet: a few samples where it is met, no march. start_fraction in 0...1 as in the other march_layer.
fn march_layer(layer_index: u32, part: Part, origin: vec3f, direction: vec3f, start_fraction: f32) -> LayerRadiance {
    let ray = ray_scene(layer_index);
    let layer = scene.layers[layer_index];
    var octave_attenuation: array<vec4f, #{OCTAVE_VECTORS}>;
    for (var k = 0u; k < #{OCTAVE_VECTORS}u; k += 1u) {
        octave_attenuation[k] = attenuation_of(ray, layer, scene.light.octave_attenuation[k], k);
    }
    let intervals = part_intervals(ray.planet_radius_m, scene.planet.has_ground > 0.0, part, origin, direction);
    let across = length(direction.xz);
    let lengths_m = max(vec2f(intervals.first_end_m - intervals.first_start_m, intervals.second_end_m - intervals.second_start_m), vec2f(0.0));
    let most = sheet_samples_max(layer);
    let counts = vec2f(sheet_samples(lengths_m.x, across, most), sheet_samples(lengths_m.y, across, most));
    let layer_distance_m = 0.5 * select(intervals.second_start_m + intervals.second_end_m, intervals.first_start_m + intervals.first_end_m, lengths_m.x > 0.0);

    var transmittance = 1.0;
    // What the lit samples weigh: the opacity, with all digits where it is small.
    var shown = 0.0;
    var weighted_sun_depth = 0.0;
    var weighted_distance_m = 0.0;
    var octave_sums: array<vec4f, #{OCTAVE_VECTORS}>;
    for (var k = 0u; k < #{OCTAVE_VECTORS}u; k += 1u) { octave_sums[k] = vec4f(0.0); }
#ifdef RAY_LIST
    optical_depth_seen = 0.0;
    steps_taken = u32(counts.x + counts.y);
#endif
    for (var i = 0.0; i < counts.x + counts.y; i += 1.0) {
        let is_second = i >= counts.x;
        let length_m = select(lengths_m.x / max(counts.x, 1.0), lengths_m.y / max(counts.y, 1.0), is_second);
        let start_m = select(intervals.first_start_m, intervals.second_start_m, is_second);
        let distance_m = start_m + (select(i, i - counts.x, is_second) + start_fraction) * length_m;
        let position = origin + direction * distance_m;
        let density = sheet_density(layer, position.xz) * share_at(part, distance_m);
        let optical_depth = density * layer.extinction_per_m * length_m;
        let opacity = optical_depth * one_minus_exp_over(optical_depth);
        let weight = transmittance * opacity;
        let sun_depth = sun_optical_depth(ray, layer, position);
        for (var k = 0u; k < #{OCTAVE_VECTORS}u; k += 1u) {
            octave_sums[k] += weight * exp(-octave_attenuation[k] * sun_depth);
        }
        shown += weight;
        weighted_sun_depth += weight * sun_depth;
        weighted_distance_m += weight * distance_m;
        transmittance *= exp(-optical_depth);
#ifdef RAY_LIST
        optical_depth_seen += optical_depth;
#endif
    }
    return ray_light(ray, layer, origin, direction, octave_sums, Weighed(shown, weighted_sun_depth, weighted_distance_m), Weighed(0.0, 0.0, 0.0), transmittance, layer_distance_m);
}
#else
/// Marches one ray through a part of one layer. start_fraction in 0...1 shifts the samples by that share of a step. Steps are
/// counted from the origin, so that parts of a layer have each sample of the whole once.
fn march_layer(layer_index: u32, part: Part, origin: vec3f, direction: vec3f, start_fraction: f32) -> LayerRadiance {
    let ray = ray_scene(layer_index);
#ifdef WINDOW
    var layer = scene.layers[layer_index];
    layer.step_min_m *= step_scale;
    layer.step_per_distance *= step_scale;
    // Length of the present step as a share of a whole one: where cloud begins, the ray steps back and goes on in parts.
    let fine = 1.0 / refinement;
    var share = 1.0;
    var empty_parts = 0.0;
#else
    let layer = scene.layers[layer_index];
#endif
    var octave_attenuation: array<vec4f, #{OCTAVE_VECTORS}>;
    for (var k = 0u; k < #{OCTAVE_VECTORS}u; k += 1u) {
        octave_attenuation[k] = attenuation_of(ray, layer, scene.light.octave_attenuation[k], k);
    }
    let thickness_m = max(layer.top_altitude_m - layer.base_altitude_m, 1e-3);
    let has_ground = scene.planet.has_ground > 0.0;
    let intervals = part_intervals(ray.planet_radius_m, has_ground, part, origin, direction);
    // Horizontal metres per metre of ray; the floor keeps the quotient finite for vertical rays.
    let across = max(length(direction.xz), 1e-3);
    let detail_voxel_m = 1.0 / max(layer.detail_per_m * 32.0, 1e-9);

    var end_m = intervals.first_end_m;
    var start_m = intervals.first_start_m;
    var second_start_m = intervals.second_start_m;
    var second_end_m = intervals.second_end_m;
    let layer_distance_m = 0.5 * select(second_start_m + second_end_m, start_m + end_m, end_m > start_m);
#ifndef DENSITY_WEATHER
    let over = over_bounds(layer, origin, direction);
    start_m = max(start_m, over.x);
    end_m = min(end_m, over.y);
    second_start_m = max(second_start_m, over.x);
    second_end_m = min(second_end_m, over.y);
#endif
    var second = second_end_m > second_start_m;
    if end_m <= start_m {
        start_m = second_start_m;
        end_m = select(start_m, second_end_m, second);
        second = false;
    }
    var steps = first_sample_at(layer, start_m, start_fraction);
    var distance_m = distance_at_m(layer, steps);
#ifdef WINDOW
    var begin = steps_at(layer, start_m);
#endif
#ifdef BANDS
    var unlit_to_m = head_end_m(part, start_m);
    let tail_steps = first_sample_at(layer, part.far_m, start_fraction);
#endif

    var transmittance = 1.0;
    var front = Weighed(0.0, 0.0, 0.0);
    var back = Weighed(0.0, 0.0, 0.0);
    var front_end_m = 1e30;
    var octave_sums: array<vec4f, #{OCTAVE_VECTORS}>;
    for (var k = 0u; k < #{OCTAVE_VECTORS}u; k += 1u) { octave_sums[k] = vec4f(0.0); }

    let lights_empty = layer.lights_empty_steps == 1u;
    var probes = 0u;
#ifdef RAY_LIST
    steps_taken = 0u;
    optical_depth_seen = 0.0;
#endif
    for (var lit = 0u; lit < layer.steps_max; lit += 1u) {
        var position = vec3f(0.0);
        var altitude = 0.0;
        var height_fraction = 0.0;
        var density = 0.0;
        var profile = 0.0;
        // Goes on until it stands in cloud or has left the layer. The loops are nested by cost (map; map and noise; map,
        // noise and sun march), so that neighbouring rays wait for one another only where the work is worth it.
        loop {
#ifdef DENSITY_WEATHER
            loop {
                if distance_m >= end_m && second {
                    steps = first_sample_at(layer, second_start_m, start_fraction);
#ifdef WINDOW
                    begin = steps_at(layer, second_start_m);
#endif
                    distance_m = distance_at_m(layer, steps);
                    end_m = second_end_m;
                    second = false;
#ifdef BANDS
                    unlit_to_m = head_end_m(part, second_start_m);
#endif
                }
                if distance_m >= end_m || probes >= PROBES_MAX { break; }
                position = origin + direction * distance_m;
                altitude = altitude_m(ray.planet_radius_m, position);
                height_fraction = saturate((altitude - layer.base_altitude_m) / thickness_m);
                let map = map_texel(layer, position.xz);
                profile = dimensional_profile(layer, map, height_fraction);
#ifdef BANDS
                end_m = band_end_m(part, end_m, distance_m, profile <= 0.0);
                unlit_to_m = select(unlit_to_m, 0.0, profile <= 0.0);
#endif
                if profile > 0.0 || lights_empty { break; }
                probes += 1u;
                let skip_m = map.z * layer.skip_range_m / across;
#ifdef WINDOW
                // A part without cloud goes on to the next one. A leap from there would lead back to the whole step that came
                // upon the cloud, and from that back here.
                let leap = vec3f(max(first_sample_at(layer, distance_m + skip_m, start_fraction), whole_step_after(steps, share, start_fraction)), 1.0, 0.0);
                let stepped = select(leap, refined_step(steps, share, empty_parts, false, fine, start_fraction, begin), share < 1.0);
                steps = stepped.x;
                share = stepped.y;
                empty_parts = stepped.z;
#else
#ifdef BANDS
                let next = steps + max(ceil(steps_at(layer, distance_m + skip_m) - steps), 1.0);
                // Never past the sample at which both bands look.
                steps = select(next, min(next, tail_steps), steps + 0.5 < tail_steps);
#else
                steps += max(ceil(steps_at(layer, distance_m + skip_m) - steps), 1.0);
#endif
#endif
                distance_m = distance_at_m(layer, steps);
            }
            if distance_m >= end_m || probes >= PROBES_MAX { break; }
            let detail_weight = saturate(2.0 - distance_m * DETAIL_ANGLE_RAD / detail_voxel_m);
            density = carved_density(layer, position, altitude, height_fraction, profile, detail_weight) * share_at(part, distance_m);
#ifdef WINDOW
            if (density > 0.0 || lights_empty) && (share < 1.0 || refinement <= 1.0) { break; }
            probes += 1u;
            let stepped = refined_step(steps, share, empty_parts, density > 0.0, fine, start_fraction, begin);
            steps = stepped.x;
            share = stepped.y;
            empty_parts = stepped.z;
#else
#ifdef BANDS
            end_m = band_end_m(part, end_m, distance_m, density <= 0.0);
            unlit_to_m = select(unlit_to_m, 0.0, density <= 0.0);
            density = select(density, 0.0, distance_m < unlit_to_m);
#endif
            if density > 0.0 || lights_empty { break; }
            probes += 1u;
            steps += 1.0;
#endif
            distance_m = distance_at_m(layer, steps);
#else
            if distance_m >= end_m && second {
                steps = first_sample_at(layer, second_start_m, start_fraction);
#ifdef WINDOW
                begin = steps_at(layer, second_start_m);
#endif
                distance_m = distance_at_m(layer, steps);
                end_m = second_end_m;
                second = false;
#ifdef BANDS
                unlit_to_m = head_end_m(part, second_start_m);
#endif
            }
            if distance_m >= end_m || probes >= PROBES_MAX { break; }
            position = origin + direction * distance_m;
            altitude = altitude_m(ray.planet_radius_m, position);
            height_fraction = saturate((altitude - layer.base_altitude_m) / thickness_m);
            density = bounded_density(layer, position, altitude) * share_at(part, distance_m);
#ifdef WINDOW
            if (density > 0.0 || lights_empty) && (share < 1.0 || refinement <= 1.0) { break; }
            probes += 1u;
            let stepped = refined_step(steps, share, empty_parts, density > 0.0, fine, start_fraction, begin);
            steps = stepped.x;
            share = stepped.y;
            empty_parts = stepped.z;
#else
#ifdef BANDS
            end_m = band_end_m(part, end_m, distance_m, density <= 0.0);
            unlit_to_m = select(unlit_to_m, 0.0, density <= 0.0);
            density = select(density, 0.0, distance_m < unlit_to_m);
#endif
            if density > 0.0 || lights_empty { break; }
            probes += 1u;
            steps += 1.0;
#endif
            distance_m = distance_at_m(layer, steps);
#endif
        }
        if distance_m >= end_m || probes >= PROBES_MAX { break; }

#ifdef WINDOW
        let length_m = share * step_length_m(layer, distance_m);
        empty_parts = 0.0;
#else
        let length_m = step_length_m(layer, distance_m);
#endif
        let optical_depth = density * layer.extinction_per_m * length_m;
        // 1 - e^-τ without cancellation for thin steps.
        let opacity = optical_depth * one_minus_exp_over(optical_depth);
        let weight = transmittance * opacity;
        let sun_depth = sun_optical_depth(ray, layer, position);
        for (var k = 0u; k < #{OCTAVE_VECTORS}u; k += 1u) {
            octave_sums[k] += weight * exp(-octave_attenuation[k] * sun_depth);
        }
        front_end_m = select(front_end_m, min(front_end_m, distance_m + FRONT_LENGTH_M), weight > 0.0);
        let sums = weight * vec3f(1.0, sun_depth, distance_m);
        let in_front = select(vec3f(0.0), sums, distance_m < front_end_m);
        front = plus(front, in_front);
        back = plus(back, sums - in_front);
        transmittance *= exp(-optical_depth);
#ifdef RAY_LIST
        steps_taken = lit + 1u + probes;
        optical_depth_seen += optical_depth;
#endif
#ifdef WINDOW
        steps += share;
#else
        steps += 1.0;
#endif
        distance_m = distance_at_m(layer, steps);
        if transmittance < layer.transmittance_min { break; }
    }

    // What a ray that has ended early did not see is taken to be like the rest of it. The sun's disc is ten thousands of times
    // as bright as the sky: it would shine through what is left of any cloud.
    let ended = transmittance < layer.transmittance_min;
    let whole = select(1.0, 1.0 / (1.0 - min(transmittance, 0.5)), ended);
    transmittance = select(transmittance, 0.0, ended);
    for (var k = 0u; k < #{OCTAVE_VECTORS}u; k += 1u) { octave_sums[k] *= whole; }
    front = times(front, whole);
    back = times(back, whole);
    return ray_light(ray, layer, origin, direction, octave_sums, front, back, transmittance, layer_distance_m);
}
#endif

/// What the lit samples of a ray weigh, and sums by these weights.
struct Weighed {
    /// The opacity, with all digits where it is small.
    shown: f32,
    sun_depth: f32,
    distance_m: f32,
}

fn plus(sums: Weighed, more: vec3f) -> Weighed {
    return Weighed(sums.shown + more.x, sums.sun_depth + more.y, sums.distance_m + more.z);
}

fn times(sums: Weighed, factor: f32) -> Weighed {
    return Weighed(sums.shown * factor, sums.sun_depth * factor, sums.distance_m * factor);
}

/// The light of a ray whose samples have been summed up. Light that was scattered often hardly changes along what a ray
/// sees of one cloud: it is found once for the front of what is seen and once for what lies behind, where their light comes
/// from on the mean. Parts without cloud take no sample.
fn ray_light(ray: RayScene, layer: Layer, origin: vec3f, direction: vec3f, octave_sums: array<vec4f, #{OCTAVE_VECTORS}>, front: Weighed, back: Weighed, transmittance: f32, layer_distance_m: f32) -> LayerRadiance {
    let often = scattered_often(ray, layer, origin, direction, front) + scattered_often(ray, layer, origin, direction, back);
    let distance_m = front.distance_m + back.distance_m;
    return gathered(layer, one_minus_mu(direction, ray.sun_direction), octave_sums, often.x, often.y, transmittance, distance_m + CLEAR_OPACITY * layer_distance_m);
}

/// x: diffuse sunlight of a part of a ray, in units of its phase; y: the sky's share of its ambient light.
fn scattered_often(ray: RayScene, layer: Layer, origin: vec3f, direction: vec3f, sums: Weighed) -> vec2f {
    let shown = sums.shown;
    let per_shown = 1.0 / max(shown, 1e-30);
    let middle = origin + direction * (sums.distance_m * per_shown);
    let up = normalize(vec3f(middle.x, middle.y + ray.planet_radius_m, middle.z));
    let around = surroundings(ray, layer, middle, up, select(0u, ray.diffusion.samples, shown > 0.0));
    let diffuse = diffuse_share(ray.diffusion, layer.transport_share, sums.sun_depth * per_shown, dot(ray.sun_direction, up), around);
    let sky = sky_share(ray.diffusion, layer.transport_share, around, dot(direction, up));
    return shown * vec2f(diffuse, sky);
}

/// Sums of a ray with albedo, phases and the factor of ambient light. angle: 1 - cos of that to the sun.
fn gathered(layer: Layer, angle: f32, octave_sums: array<vec4f, #{OCTAVE_VECTORS}>, diffuse: f32, sky: f32, transmittance: f32, opacity_distance_m: f32) -> LayerRadiance {
    var sums = octave_sums;
    var result: LayerRadiance;
    let albedo = layer.single_scattering_albedo;
    result.single = albedo * sums[0].x;
    result.octaves = 0.0;
    for (var i = 1u; i < scene.light.octaves; i += 1u) {
        let contribution = scene.light.octave_contribution[i / 4u][i % 4u];
        let phase = phase_per_sr(layer.phase, scene.light.octave_eccentricity[i / 4u][i % 4u], angle);
        result.octaves += albedo * contribution * phase * sums[i / 4u][i % 4u];
    }
    result.octaves += albedo * diffuse * phase_per_sr(layer.phase, scene.light.diffusion.eccentricity, angle);
    result.ambient = albedo * scene.light.ambient * sky;
    result.transmittance = transmittance;
    result.opacity_distance_m = opacity_distance_m;
    return result;
}

/// Noise in 0...1 with evenly spread neighbours. J. Jimenez, "Next Generation Post Processing in Call of Duty", 2014.
fn interleaved_gradient_noise(position: vec2f) -> f32 {
    return fract(52.9829189 * fract(dot(position, vec2f(0.06711056, 0.00583715))));
}

/// Eight places of 1/8 by 1/8, no two in a row or column, whose mean is the middle (the standard pattern of eightfold
/// multisampling), in 1/16: a mean beside the middle would shift the picture. Those next to the middle come first, and two that
/// follow one another are on opposite sides, so that the mean of the first two is there and that of four and six within 1/32 of it.
const SAMPLE_PLACES: array<vec2f, 8> = array<vec2f, 8>(
    vec2f(1.0, -3.0), vec2f(-1.0, 3.0), vec2f(3.0, 7.0), vec2f(-3.0, -5.0),
    vec2f(5.0, 1.0), vec2f(-7.0, -1.0), vec2f(-5.0, 5.0), vec2f(7.0, -7.0),
);

/// Offset of sample k inside its texel or pixel, each component in -0.5...0.5. Every other neighbour takes each two places the
/// other way round, so that few samples do not shift the picture. Every further eight move inside their places by the R2 sequence
/// of M. Roberts, 2018, pairwise to opposite sides.
fn sample_offset(cell: vec2f, index: u32) -> vec2f {
    var places = SAMPLE_PLACES;
    let at = cell_indices(cell);
    let round = index / 8u;
    let within = fract(vec2f(0.5) + f32((round + 1u) / 2u) * vec2f(0.7548776662466927, 0.5698402909980532)) - 0.5;
    let place = index % 8u ^ (at.x + at.y) % 2u;
    return places[place] / 16.0 + select(within, -within, round % 2u == 1u) / 8.0;
}

/// Fraction of a step at which sample k of a texel or pixel stands, 0...1. Eight samples stand in eight equal parts of the
/// step, far ones first, and eight neighbours, two across and four down, begin with another part each: one sample of each shows
/// all parts of the step. Within a part neighbours differ, and so do further eight, by the golden ratio.
fn sample_start_fraction(cell: vec2f, index: u32) -> f32 {
    let at = cell_indices(cell);
    let part = reverseBits((index + 3u * at.x + 2u * at.y) % 8u) >> 29u;
    let within = fract(interleaved_gradient_noise(cell) + f32(index / 8u) * 0.6180339887498949);
    return (f32(part) + within) / 8.0;
}

/// Column and row of a texel or pixel, modulo 8: gutters have those of the texels that they repeat.
fn cell_indices(cell: vec2f) -> vec2u {
    return vec2u(vec2i(floor(cell)) & vec2i(7));
}
