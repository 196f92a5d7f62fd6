#define_import_path skycell::march
#import skycell::scene::{Scene, Layer}
#import skycell::shell::{altitude_m, layer_intervals}
#import skycell::transport::one_minus_exp_over
#import skycell::phase::{one_minus_mu, phase_per_sr}
#ifdef DENSITY_WEATHER
#import skycell::density::{map_texel, dimensional_profile, carved_density, smooth_density}
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
    /// Distance of what is seen, weighted by its opacity, m from the ray's origin; 0 where nothing is.
    distance_m: f32,
}

/// A ray stops where less than this share of the light behind could still come through.
const TRANSMITTANCE_MIN: f32 = 0.004;
/// Steps outside cloud are longer by this factor.
const EMPTY_STEP_FACTOR: f32 = 1.5;
/// Detail fades out where its voxels are seen under this angle or less, half a pixel of a 720-line picture. The same for
/// every renderer and resolution: a cloud's shape must not depend on who looks.
const DETAIL_ANGLE_RAD: f32 = 8e-4;
/// A limit that no sensible ray reaches (empty steps are at least step_min_m long).
const PROBES_MAX: u32 = 4096u;

/// Length of a step inside cloud at a distance from the ray's origin, m.
fn step_length_m(layer: Layer, distance_m: f32) -> f32 {
    return max(layer.step_min_m, distance_m * layer.step_per_distance);
}

/// Optical depth from a point towards the sun within its layer, by sun_steps samples at quadratically growing distances.
fn sun_optical_depth(layer: Layer, position: vec3f) -> f32 {
    let count = f32(scene.light.sun_steps);
    let thickness_m = max(layer.top_altitude_m - layer.base_altitude_m, 1e-3);
    var sum_m = 0.0;
    for (var i = 0u; i < scene.light.sun_steps; i += 1u) {
        let near = f32(i) / count;
        let far = f32(i + 1u) / count;
        let start_m = near * near * scene.light.sun_march_distance_m;
        let end_m = far * far * scene.light.sun_march_distance_m;
        let sample = position + scene.sun.direction * (0.5 * (start_m + end_m));
        let altitude = altitude_m(scene.planet.radius_m, sample);
        let height_fraction = (altitude - layer.base_altitude_m) / thickness_m;
        let inside = height_fraction >= 0.0 && height_fraction <= 1.0;
#ifdef DENSITY_WEATHER
        let profile = dimensional_profile(layer, map_texel(layer, sample.xz), height_fraction);
        let density = smooth_density(layer, sample, altitude, height_fraction, profile);
#else
        let density = 1.0;
#endif
        sum_m += select(0.0, density * (end_m - start_m), inside);
    }
    return sum_m * layer.extinction_per_m;
}

/// Marches one ray through one layer. start_fraction in 0...1 shifts the samples by that share of a step.
fn march_layer(layer_index: u32, origin: vec3f, direction: vec3f, start_fraction: f32) -> LayerRadiance {
    let layer = scene.layers[layer_index];
    let thickness_m = max(layer.top_altitude_m - layer.base_altitude_m, 1e-3);
    let intervals = layer_intervals(scene.planet.radius_m, layer.base_altitude_m, layer.top_altitude_m, origin, direction);
    // Horizontal metres per metre of ray; the floor keeps the quotient finite for vertical rays.
    let across = max(length(direction.xz), 1e-3);
    let detail_voxel_m = 1.0 / max(layer.detail_per_m * 32.0, 1e-9);

    var end_m = intervals.first_end_m;
    var start_m = intervals.first_start_m;
    var second = intervals.second_end_m > intervals.second_start_m;
    if end_m <= start_m {
        start_m = intervals.second_start_m;
        end_m = select(start_m, intervals.second_end_m, second);
        second = false;
    }
    var distance_m = start_m + start_fraction * step_length_m(layer, start_m);

    var transmittance = 1.0;
    var ambient = 0.0;
    var weighted_distance_m = 0.0;
    var octave_sums: array<vec4f, #{OCTAVE_VECTORS}>;
    for (var k = 0u; k < #{OCTAVE_VECTORS}u; k += 1u) { octave_sums[k] = vec4f(0.0); }

    var probes = 0u;
    for (var lit = 0u; lit < layer.steps_max; lit += 1u) {
        var position = vec3f(0.0);
        var altitude = 0.0;
        var height_fraction = 0.0;
        var density = 0.0;
        var profile = 0.0;
        var step_m = 0.0;
        // Goes on until it stands in cloud or has left the layer. The loops are nested by cost (map; map and noise; map,
        // noise and sun march), so that neighbouring rays wait for one another only where the work is worth it.
        loop {
#ifdef DENSITY_WEATHER
            loop {
                if distance_m >= end_m && second {
                    distance_m = intervals.second_start_m + start_fraction * step_length_m(layer, intervals.second_start_m);
                    end_m = intervals.second_end_m;
                    second = false;
                }
                if distance_m >= end_m || probes >= PROBES_MAX { break; }
                position = origin + direction * distance_m;
                altitude = altitude_m(scene.planet.radius_m, position);
                height_fraction = saturate((altitude - layer.base_altitude_m) / thickness_m);
                let map = map_texel(layer, position.xz);
                profile = dimensional_profile(layer, map, height_fraction);
                if profile > 0.0 { break; }
                probes += 1u;
                let skip_m = map.z * layer.skip_range_m / across;
                distance_m += max(skip_m, EMPTY_STEP_FACTOR * step_length_m(layer, distance_m));
            }
            if distance_m >= end_m || probes >= PROBES_MAX { break; }
            step_m = step_length_m(layer, distance_m);
            let detail_weight = saturate(2.0 - distance_m * DETAIL_ANGLE_RAD / detail_voxel_m);
            density = carved_density(layer, position, altitude, height_fraction, profile, detail_weight);
            if density > 0.0 { break; }
            probes += 1u;
            distance_m += EMPTY_STEP_FACTOR * step_m;
#else
            if distance_m >= end_m && second {
                distance_m = intervals.second_start_m + start_fraction * step_length_m(layer, intervals.second_start_m);
                end_m = intervals.second_end_m;
                second = false;
            }
            step_m = step_length_m(layer, distance_m);
            position = origin + direction * distance_m;
            altitude = altitude_m(scene.planet.radius_m, position);
            height_fraction = saturate((altitude - layer.base_altitude_m) / thickness_m);
            density = 1.0;
            profile = 1.0;
            break;
#endif
        }
        if distance_m >= end_m || probes >= PROBES_MAX { break; }

        let length_m = min(step_m, end_m - distance_m);
        let optical_depth = density * layer.extinction_per_m * length_m;
        // 1 - e^-τ without cancellation for thin steps.
        let opacity = optical_depth * one_minus_exp_over(optical_depth);
        let weight = transmittance * opacity;
        let sun_depth = sun_optical_depth(layer, position);
        for (var k = 0u; k < #{OCTAVE_VECTORS}u; k += 1u) {
            octave_sums[k] += weight * exp(-scene.light.octave_attenuation[k] * sun_depth);
        }
        // Deep inside and low in a cloud less of the sky is seen. Tuned; replaced when ambient light is measured.
        ambient += weight * (0.3 + 0.7 * height_fraction) * sqrt(saturate(1.0 - 0.75 * profile * density));
        weighted_distance_m += weight * (distance_m + 0.5 * length_m);
        transmittance *= exp(-optical_depth);
        distance_m += length_m;
        if transmittance < TRANSMITTANCE_MIN { break; }
    }

    var result: LayerRadiance;
    let albedo = layer.single_scattering_albedo;
    let angle = one_minus_mu(direction, scene.sun.direction);
    result.single = albedo * octave_sums[0].x;
    result.octaves = 0.0;
    for (var i = 1u; i < scene.light.octaves; i += 1u) {
        let contribution = scene.light.octave_contribution[i / 4u][i % 4u];
        let phase = phase_per_sr(scene.light, scene.light.octave_eccentricity[i / 4u][i % 4u], angle);
        result.octaves += albedo * contribution * phase * octave_sums[i / 4u][i % 4u];
    }
    result.ambient = albedo * scene.light.ambient * ambient;
    result.transmittance = transmittance;
    result.distance_m = weighted_distance_m / max(1.0 - transmittance, 1e-6);
    return result;
}

/// Noise in 0...1 with evenly spread neighbours. J. Jimenez, "Next Generation Post Processing in Call of Duty", 2014.
fn interleaved_gradient_noise(position: vec2f) -> f32 {
    return fract(52.9829189 * fract(dot(position, vec2f(0.06711056, 0.00583715))));
}

/// Offset of sample k inside its texel or pixel, each component in -0.5...0.5: the R2 sequence of M. Roberts, 2018.
fn sample_offset(index: u32) -> vec2f {
    return fract(vec2f(0.5) + f32(index) * vec2f(0.7548776662466927, 0.5698402909980532)) - 0.5;
}

/// Where along a step sample k of a texel or pixel starts, 0...1: its own noise, turned by the golden ratio per sample.
fn sample_start_fraction(cell: vec2f, index: u32) -> f32 {
    return fract(interleaved_gradient_noise(cell) + f32(index) * 0.6180339887498949);
}
