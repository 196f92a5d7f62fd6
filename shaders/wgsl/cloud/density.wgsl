#define_import_path skycell::density
#import skycell::scene::Layer

@group(1) @binding(0) var field_maps: texture_2d_array<f32>;
@group(1) @binding(1) var field_profile: texture_2d<f32>;
@group(1) @binding(2) var field_shape: texture_3d<f32>;
@group(1) @binding(3) var field_detail: texture_3d<f32>;
@group(1) @binding(4) var field_repeat: sampler;
@group(1) @binding(5) var field_clamp: sampler;

/// Width of the rise of coverage around its threshold, in units of the map.
/// Tuned: narrower makes cliffs, wider veils (`skycell-server render` of the default scene).
const COVERAGE_SOFTNESS: f32 = 0.55;
/// How steeply density rises from a cloud's surface inwards. Tuned by eye against photographs of cumulus.
const SURFACE_STEEPNESS: f32 = 6.0;
/// Shape noise is squeezed into this floor and range: the rest of the threshold is the dimensional profile's, which keeps
/// bodies whole instead of scattering crumbs above them. Tuned by eye against photographs of cumulus.
const SHAPE_FLOOR: f32 = 0.34;
const SHAPE_RANGE: f32 = 0.6;
/// Mean of both detail channels: what stands for detail that is too fine to be seen.
const DETAIL_MEAN: f32 = 0.5;
/// Half the width of what most of the detail's values lie in.
const DETAIL_SPREAD: f32 = 0.3;
/// Share of the type map in the local type.
const TYPE_SPREAD: f32 = 0.45;

/// What the layer's map holds at a horizontal position: x coverage, y type, z distance to the nearest possible cloud
/// as a share of the layer's skip range.
fn map_texel(layer: Layer, position_xz: vec2f) -> vec3f {
    let uv = position_xz * layer.map_per_m + layer.map_offset;
    return textureSampleLevel(field_maps, field_repeat, uv, layer.map_index, 0.0).xyz;
}

/// Local coverage in 0...1 from the map's value. A layer coverage of 0 is clear and of 1 solid, whatever the map holds.
fn coverage_from_map(layer_coverage: f32, map_value: f32) -> f32 {
    let threshold = mix(1.0, -COVERAGE_SOFTNESS, layer_coverage);
    return saturate((map_value - threshold) / COVERAGE_SOFTNESS);
}

/// Local type in 0 (stratus) ... 1 (cumulus).
fn type_from_map(layer_type: f32, map_value: f32) -> f32 {
    return saturate(layer_type * (1.0 - TYPE_SPREAD + TYPE_SPREAD * map_value));
}

/// Vertical profile: how much of its coverage a cloud of this type keeps at a height fraction of the layer.
fn vertical_profile(cloud_type: f32, height_fraction: f32) -> f32 {
    return textureSampleLevel(field_profile, field_clamp, vec2f(height_fraction, cloud_type), 0.0).x;
}

/// Dimensional profile d = c v: the cloud before noise carves it.
fn dimensional_profile(layer: Layer, map: vec3f, height_fraction: f32) -> f32 {
    let cloud_type = type_from_map(layer.cloud_type, map.y);
    return coverage_from_map(layer.coverage, map.x) * vertical_profile(cloud_type, height_fraction);
}

/// Density in 0...1 where the dimensional profile is known: the shape noise above what the profile forbids, its surface
/// eroded by detail noise (after A. Schneider, "Nubis", 2015-2023, and P. Ford 2024, 3.1).
/// detail_weight: 1 full detail, 0 its mean.
fn carved_density(layer: Layer, position: vec3f, altitude_m: f32, height_fraction: f32, profile: f32, detail_weight: f32) -> f32 {
    let field_position = vec3f(position.x, altitude_m, position.z);
    let shape = textureSampleLevel(field_shape, field_repeat, field_position * layer.shape_per_m + layer.shape_offset, 0.0).xy;
    let billowy = saturate(height_fraction * 5.0);
    let noise = mix(shape.y, shape.x, billowy);
    let carved = SHAPE_FLOOR + SHAPE_RANGE * noise - (1.0 - profile);
#ifdef WITHOUT_DETAIL
    let detail = DETAIL_MEAN;
#else
    let fine = textureSampleLevel(field_detail, field_repeat, field_position * layer.detail_per_m + layer.detail_offset, 0.0).xy;
    let detail = mix(DETAIL_MEAN, mix(fine.y, fine.x, billowy), detail_weight);
#endif
    // Detail that is too fine to be seen blurs the surface by as much as it would move it.
    let blur = (1.0 - detail_weight) * layer.detail_strength * DETAIL_SPREAD;
    let surface = carved - layer.detail_strength * (1.0 - detail);
    return saturate((surface + blur) / (1.0 / SURFACE_STEEPNESS + 2.0 * blur));
}

/// As carved_density with the detail's mean: what the sun march reads.
fn smooth_density(layer: Layer, position: vec3f, altitude_m: f32, height_fraction: f32, profile: f32) -> f32 {
    let field_position = vec3f(position.x, altitude_m, position.z);
    let shape = textureSampleLevel(field_shape, field_repeat, field_position * layer.shape_per_m + layer.shape_offset, 0.0).xy;
    let noise = mix(shape.y, shape.x, saturate(height_fraction * 5.0));
    let carved = SHAPE_FLOOR + SHAPE_RANGE * noise - (1.0 - profile);
    return saturate((carved - layer.detail_strength * (1.0 - DETAIL_MEAN)) * SURFACE_STEEPNESS);
}
