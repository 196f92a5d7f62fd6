// What the cloud field holds along a pixel's ray, in a column seen from above or in a vertical section, and how many
// samples a ray takes: one pass per layer, each adding to what the passes before have left in the picture.
#import skycell::march::scene
#import skycell::scene::Layer
#import skycell::shell::{altitude_m, layer_intervals}
#import skycell::view::{View, pixel_direction}
#import skycell::colour_scale::{viridis, NOTHING}
#ifdef SHOW_STEPS
#import skycell::march::{march_layer, whole, steps_taken}
#endif
#ifdef DENSITY_WEATHER
#import skycell::density::{map_texel, coverage_from_map, type_from_map, dimensional_profile, carved_density}
#else
#ifdef DENSITY_CIRRUS
#import skycell::density::sheet_density
#else
#import skycell::density::bounded_density
#endif
#endif

struct Inspection {
    layer: u32,
    /// 1: nothing has been left in the picture yet.
    is_first: u32,
    /// 1: the picture is to hold colours now.
    is_last: u32,
    /// Top of the highest layer, m.
    highest_top_m: f32,
}

@group(2) @binding(0) var<uniform> inspection: Inspection;
@group(3) @binding(0) var<uniform> view: View;
@group(3) @binding(1) var<storage, read_write> picture: array<u32>;

/// Samples along a ray's part in a layer, and of a column.
const SAMPLES: u32 = 96u;
/// Longest part of a ray that is looked at, m.
const LENGTH_MAX_M: f32 = 150000.0;
/// Height of the ground that a view from above shows and length of a section, m.
const MAP_EXTENT_M: f32 = 40000.0;
/// Samples of a ray at the light end of the scale.
const STEPS_HIGH: f32 = 256.0;

/// x: the value at a place of a layer; y: how much it counts against others of its pixel, 0: nothing is there.
fn value_at(layer: Layer, position: vec3f, altitude: f32) -> vec2f {
    let thickness_m = max(layer.top_altitude_m - layer.base_altitude_m, 1e-3);
    let height_fraction = (altitude - layer.base_altitude_m) / thickness_m;
    let inside = height_fraction >= 0.0 && height_fraction <= 1.0;
#ifdef DENSITY_WEATHER
    let map = map_texel(layer, position.xz);
    let profile = dimensional_profile(layer, map, saturate(height_fraction));
#ifdef SHOW_COVERAGE
    let coverage = coverage_from_map(layer.coverage, map.x);
    let found = vec2f(coverage, coverage);
#else
#ifdef SHOW_TYPE
#ifdef FROM_ABOVE
    let found = vec2f(type_from_map(layer.cloud_type, layer.type_spread, map.y), 1.0);
#else
    let found = vec2f(type_from_map(layer.cloud_type, layer.type_spread, map.y), profile);
#endif
#else
#ifdef SHOW_DENSITY
    let density = carved_density(layer, position, altitude, saturate(height_fraction), profile, 1.0);
    let found = vec2f(density, density);
#else
    let found = vec2f(profile, profile);
#endif
#endif
#endif
#else
    // Without maps there is neither coverage nor type; what stands for the profile is the density itself.
#ifdef DENSITY_CIRRUS
    let density = sheet_density(layer, position.xz);
#else
    let density = bounded_density(layer, position, altitude);
#endif
#ifdef SHOW_TYPE
    let found = vec2f(0.0);
#else
    let found = vec2f(density, density);
#endif
#endif
    return select(vec2f(0.0), found, inside);
}

fn counting_more(a: vec2f, b: vec2f) -> vec2f {
    return select(a, b, b.y > a.y);
}

/// The value that counts most between two distances along a ray.
fn most_along(layer: Layer, origin: vec3f, direction: vec3f, start_m: f32, end_m: f32) -> vec2f {
    var best = vec2f(0.0);
    let step_m = min(end_m - start_m, LENGTH_MAX_M) / f32(SAMPLES);
    if step_m <= 0.0 { return best; }
    for (var i = 0u; i < SAMPLES; i += 1u) {
        let position = origin + direction * (start_m + (f32(i) + 0.5) * step_m);
        best = counting_more(best, value_at(layer, position, altitude_m(scene.planet.radius_m, position)));
    }
    return best;
}

/// What a pixel shows of a layer.
fn found_in_layer(layer: Layer, pixel: vec2u) -> vec2f {
    let size = vec2f(f32(view.width), f32(view.height));
    let ndc = (2.0 * (vec2f(pixel) + 0.5) / size - 1.0) * vec2f(1.0, -1.0);
#ifdef SHOW_STEPS
    let marched = march_layer(inspection.layer, whole(scene.layers[inspection.layer]), view.position, pixel_direction(view, vec2f(pixel) + 0.5), 0.5);
    // The march's result is of no interest, but without it there would be no march.
    return vec2f(f32(steps_taken) / STEPS_HIGH, select(1.0, 0.0, marched.transmittance < 0.0));
#else
#ifdef FROM_ABOVE
    let place = view.position.xz + ndc * vec2f(size.x / size.y, -1.0) * (0.5 * MAP_EXTENT_M);
    var best = vec2f(0.0);
    for (var i = 0u; i < SAMPLES; i += 1u) {
        let altitude = mix(layer.base_altitude_m, layer.top_altitude_m, (f32(i) + 0.5) / f32(SAMPLES));
        best = counting_more(best, value_at(layer, vec3f(place.x, altitude, place.y), altitude));
    }
    return best;
#else
#ifdef SECTION
    // Straight up or down there is no way ahead: north.
    let across = length(view.forward.xz);
    let ahead = select(vec2f(0.0, -1.0), view.forward.xz / max(across, 1e-6), across > 1e-6);
    let place = view.position.xz + ahead * ((f32(pixel.x) + 0.5) / size.x * MAP_EXTENT_M);
    let altitude = (1.0 - (f32(pixel.y) + 0.5) / size.y) * inspection.highest_top_m;
    return value_at(layer, vec3f(place.x, altitude, place.y), altitude);
#else
    let direction = pixel_direction(view, vec2f(pixel) + 0.5);
    let parts = layer_intervals(scene.planet.radius_m, scene.planet.has_ground > 0.0, layer.base_altitude_m, layer.top_altitude_m, view.position, direction);
    let first = most_along(layer, view.position, direction, parts.first_start_m, parts.first_end_m);
    let second = most_along(layer, view.position, direction, parts.second_start_m, parts.second_end_m);
    return counting_more(first, second);
#endif
#endif
#endif
}

@compute @workgroup_size(8, 8, 1)
fn inspect(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= view.width || id.y >= view.height { return; }
    let at = id.y * view.picture_width + view.first_column + id.x;
    var found = found_in_layer(scene.layers[inspection.layer], id.xy);
    if inspection.is_first == 0u {
        let before = unpack2x16unorm(picture[at]);
#ifdef SHOW_STEPS
        found = vec2f(found.x + before.x, max(found.y, before.y));
#else
        found = counting_more(before, found);
#endif
    }
    if inspection.is_last == 1u {
        let colour = select(NOTHING, viridis(found.x), found.y > 0.0);
        picture[at] = pack4x8unorm(vec4f(colour, 1.0));
    } else {
        picture[at] = pack2x16unorm(found);
    }
}
