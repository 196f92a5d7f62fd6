#define_import_path skycell::density
#import skycell::scene::Layer

@group(1) @binding(0) var field_maps: texture_2d_array<f32>;
@group(1) @binding(1) var field_profile: texture_2d_array<f32>;
@group(1) @binding(2) var field_shape: texture_3d<f32>;
@group(1) @binding(3) var field_detail: texture_3d<f32>;
@group(1) @binding(4) var field_repeat: sampler;
@group(1) @binding(5) var field_clamp: sampler;
/// Voxels of all layers, one behind the other along z.
@group(1) @binding(6) var field_grids: texture_3d<f32>;

#ifdef COUNT_READS
/// Texture reads of this invocation.
var<private> texture_reads: u32 = 0u;
/// Evaluations of a density.
var<private> density_evaluations: u32 = 0u;
#endif

// Every read of the field is one of the functions below. A sampler weighs neighbours with 8 bits or so and may round what
// it reads to 8; with EXACT_INTERPOLATION they are loaded and mixed in f32 instead.

fn count_read() {
#ifdef COUNT_READS
    texture_reads += 1u;
#endif
}

fn count_density() {
#ifdef COUNT_READS
    density_evaluations += 1u;
#endif
}

/// Whole texel below a place given in texels (middles at whole numbers), and the place between the two.
struct Between {
    below: vec3i,
    share: vec3f,
}

fn between(texels: vec3f) -> Between {
    let below = floor(texels);
    return Between(vec3i(below), texels - below);
}

/// An index taken into 0...size-1 by whole periods.
fn wrapped(index: vec3i, size: vec3i) -> vec3i {
    return ((index % size) + size) % size;
}

fn read_map(uv: vec2f, index: u32) -> vec3f {
    count_read();
#ifdef EXACT_INTERPOLATION
    let size = vec3i(vec2i(textureDimensions(field_maps)), 1);
    let at = between(vec3f(fract(uv) * vec2f(size.xy) - 0.5, 0.0));
    let low = wrapped(at.below, size).xy;
    let high = wrapped(at.below + 1, size).xy;
    let first = mix(textureLoad(field_maps, low, index, 0), textureLoad(field_maps, vec2i(high.x, low.y), index, 0), at.share.x);
    let second = mix(textureLoad(field_maps, vec2i(low.x, high.y), index, 0), textureLoad(field_maps, high, index, 0), at.share.x);
    return mix(first, second, at.share.y).xyz;
#else
    return textureSampleLevel(field_maps, field_repeat, uv, index, 0.0).xyz;
#endif
}

fn read_profile(uv: vec2f, index: u32) -> f32 {
    count_read();
#ifdef EXACT_INTERPOLATION
    let size = vec2i(textureDimensions(field_profile));
    let at = between(vec3f(uv * vec2f(size) - 0.5, 0.0));
    let low = clamp(at.below.xy, vec2i(0), size - 1);
    let high = clamp(at.below.xy + 1, vec2i(0), size - 1);
    let first = mix(textureLoad(field_profile, low, index, 0).x, textureLoad(field_profile, vec2i(high.x, low.y), index, 0).x, at.share.x);
    let second = mix(textureLoad(field_profile, vec2i(low.x, high.y), index, 0).x, textureLoad(field_profile, high, index, 0).x, at.share.x);
    return mix(first, second, at.share.y);
#else
    return textureSampleLevel(field_profile, field_clamp, uv, index, 0.0).x;
#endif
}

#ifdef EXACT_INTERPOLATION
/// Trilinear mix of eight values; the suffix says which corner, x first.
fn mixed(v000: vec2f, v100: vec2f, v010: vec2f, v110: vec2f, v001: vec2f, v101: vec2f, v011: vec2f, v111: vec2f, share: vec3f) -> vec2f {
    let near = mix(mix(v000, v100, share.x), mix(v010, v110, share.x), share.y);
    let far = mix(mix(v001, v101, share.x), mix(v011, v111, share.x), share.y);
    return mix(near, far, share.z);
}

/// Trilinear read of a volume between two whole corners.
fn load_mixed(volume: texture_3d<f32>, low: vec3i, high: vec3i, share: vec3f) -> vec2f {
    return mixed(
        textureLoad(volume, low, 0).xy,
        textureLoad(volume, vec3i(high.x, low.yz), 0).xy,
        textureLoad(volume, vec3i(low.x, high.y, low.z), 0).xy,
        textureLoad(volume, vec3i(high.xy, low.z), 0).xy,
        textureLoad(volume, vec3i(low.xy, high.z), 0).xy,
        textureLoad(volume, vec3i(high.x, low.y, high.z), 0).xy,
        textureLoad(volume, vec3i(low.x, high.yz), 0).xy,
        textureLoad(volume, high, 0).xy,
        share,
    );
}
#endif

fn read_shape(uvw: vec3f) -> vec2f {
    count_read();
#ifdef EXACT_INTERPOLATION
    let size = vec3i(textureDimensions(field_shape));
    let at = between(fract(uvw) * vec3f(size) - 0.5);
    return load_mixed(field_shape, wrapped(at.below, size), wrapped(at.below + 1, size), at.share);
#else
    return textureSampleLevel(field_shape, field_repeat, uvw, 0.0).xy;
#endif
}

fn read_detail(uvw: vec3f) -> vec2f {
    count_read();
#ifdef EXACT_INTERPOLATION
    let size = vec3i(textureDimensions(field_detail));
    let at = between(fract(uvw) * vec3f(size) - 0.5);
    return load_mixed(field_detail, wrapped(at.below, size), wrapped(at.below + 1, size), at.share);
#else
    return textureSampleLevel(field_detail, field_repeat, uvw, 0.0).xy;
#endif
}

/// Voxels of a layer at a share of its bounds, 0...1: values hold at the middles of voxels, and the outermost ones out to
/// the bounds.
fn read_grid(layer: Layer, share: vec3f) -> f32 {
    count_read();
    let size = vec3f(layer.grid_dimensions);
    let texels = clamp(share * size, vec3f(0.5), size - 0.5) + vec3f(0.0, 0.0, f32(layer.grid_first_slice));
#ifdef EXACT_INTERPOLATION
    let at = between(texels - 0.5);
    // The upper neighbour of the last voxel weighs nothing; it must not be another layer's or outside the texture.
    let last = vec3i(layer.grid_dimensions) - 1 + vec3i(0, 0, i32(layer.grid_first_slice));
    return load_mixed(field_grids, at.below, min(at.below + 1, last), at.share).x;
#else
    return textureSampleLevel(field_grids, field_clamp, texels / vec3f(textureDimensions(field_grids)), 0.0).x;
#endif
}

/// Width of the rise of coverage around its threshold, in units of the map.
/// Tuned: narrower makes cliffs, wider veils (`skycell-server render` of the default scene).
const COVERAGE_SOFTNESS: f32 = 0.55;
/// Mean of both detail channels: what stands for detail that is too fine to be seen.
const DETAIL_MEAN: f32 = 0.5;
/// Half the width of what most of the detail's values lie in.
const DETAIL_SPREAD: f32 = 0.3;

/// What the layer's map holds at a horizontal position: x coverage, y type, z distance to the nearest possible cloud
/// as a share of the layer's skip range.
fn map_texel(layer: Layer, position_xz: vec2f) -> vec3f {
    let uv = position_xz * layer.map_per_m + layer.map_offset;
    return read_map(uv, layer.map_index);
}

/// Local coverage in 0...1 from the map's value. A layer coverage of 0 is clear and of 1 solid, whatever the map holds.
fn coverage_from_map(layer_coverage: f32, map_value: f32) -> f32 {
    let threshold = mix(1.0, -COVERAGE_SOFTNESS, layer_coverage);
    return saturate((map_value - threshold) / COVERAGE_SOFTNESS);
}

/// Local type in 0...1 before the dome's share. type_spread: share of the type map in it.
fn type_from_map(layer_type: f32, type_spread: f32, map_value: f32) -> f32 {
    return saturate(layer_type * (1.0 - type_spread + type_spread * map_value));
}

/// Vertical profile: how much of its coverage a cloud of this type keeps at a height fraction of the layer.
fn vertical_profile(layer: Layer, cloud_type: f32, height_fraction: f32) -> f32 {
    return read_profile(vec2f(height_fraction, cloud_type), layer.map_index);
}

/// Dimensional profile d = c v: the cloud before noise carves it. Where the layer has domes, less coverage means a flatter
/// type: heaps are low at their rims and tall in their middles, and no noise is needed for their tops, which would leave
/// crumbs above them.
fn dimensional_profile(layer: Layer, map: vec3f, height_fraction: f32) -> f32 {
    count_density();
    let coverage = coverage_from_map(layer.coverage, map.x);
    let cloud_type = type_from_map(layer.cloud_type, layer.type_spread, map.y) * mix(1.0, coverage, layer.dome);
    return coverage * vertical_profile(layer, cloud_type, height_fraction);
}

/// How much billowy noise there is against wispy noise: clouds fray at their bases.
fn billowy_share(layer: Layer, height_fraction: f32) -> f32 {
    return saturate(height_fraction * 5.0) * (1.0 - layer.wispiness);
}

/// How far shape noise reaches above what the profile forbids.
fn carved_surface(layer: Layer, field_position: vec3f, billowy: f32, profile: f32) -> f32 {
    let shape = read_shape(field_position * layer.shape_per_m + layer.shape_offset);
    return layer.shape_floor + layer.shape_range * mix(shape.y, shape.x, billowy) - (1.0 - profile);
}

/// Density in 0...1 where the dimensional profile is known: the shape noise above what the profile forbids, its surface
/// eroded by detail noise (after A. Schneider, "Nubis", 2015-2023, and P. Ford 2024, 3.1).
/// detail_weight: 1 full detail, 0 its mean.
fn carved_density(layer: Layer, position: vec3f, altitude_m: f32, height_fraction: f32, profile: f32, detail_weight: f32) -> f32 {
    let field_position = vec3f(position.x, altitude_m, position.z);
    let billowy = billowy_share(layer, height_fraction);
    let carved = carved_surface(layer, field_position, billowy, profile);
#ifdef WITHOUT_DETAIL
    let detail = DETAIL_MEAN;
#else
    let fine = read_detail(field_position * layer.detail_per_m + layer.detail_offset);
    let detail = mix(DETAIL_MEAN, mix(fine.y, fine.x, billowy), detail_weight);
#endif
    // Detail that is too fine to be seen blurs the surface by as much as it would move it.
    let blur = (1.0 - detail_weight) * layer.detail_strength * DETAIL_SPREAD;
    let surface = carved - layer.detail_strength * (1.0 - detail);
    return saturate((surface + blur) / (1.0 / layer.steepness + 2.0 * blur));
}

/// As carved_density with the detail's mean: what the sun march reads.
fn smooth_density(layer: Layer, position: vec3f, altitude_m: f32, height_fraction: f32, profile: f32) -> f32 {
    let field_position = vec3f(position.x, altitude_m, position.z);
    let carved = carved_surface(layer, field_position, billowy_share(layer, height_fraction), profile);
    return saturate((carved - layer.detail_strength * (1.0 - DETAIL_MEAN)) * layer.steepness);
}

/// Half the width of what most of the shape noise's values lie in.
const SHAPE_SPREAD: f32 = 0.5;

/// As smooth_density with the shape noise's mean as well, and the surface as wide as the noise would move it: density on
/// the mean of a place's surroundings.
fn broad_density(layer: Layer, profile: f32) -> f32 {
    let carved = layer.shape_floor + 0.5 * layer.shape_range - (1.0 - profile);
    let surface = carved - layer.detail_strength * (1.0 - DETAIL_MEAN);
    let blur = layer.shape_range * SHAPE_SPREAD;
    return select(0.0, saturate((surface + blur) / (1.0 / layer.steepness + 2.0 * blur)), profile > 0.0);
}

#ifdef DENSITY_CIRRUS
/// Density in 0...1 of a thin sheet, the same at all of its altitudes: patches, in which fibres or a veil stand. The map holds
/// patches, read over its span, and fibres and veil, read over the fibres' period and along their axis.
fn sheet_density(layer: Layer, position_xz: vec2f) -> f32 {
    count_density();
    let patches = map_texel(layer, position_xz).x;
    let axis = layer.fibre_axis;
    let along = vec2f(dot(position_xz, axis), dot(position_xz, vec2f(-axis.y, axis.x)));
    let ice = read_map(along * layer.shape_per_m + layer.shape_offset.xz, layer.map_index);
    return coverage_from_map(layer.coverage, patches) * mix(ice.z, ice.y, layer.cloud_type);
}
#endif

/// Density in 0...1 of a layer without maps: a shape that is filled, or voxels. Outside the bounds there is nothing.
fn bounded_density(layer: Layer, position: vec3f, altitude_m: f32) -> f32 {
    count_density();
    let share = (vec3f(position.x, altitude_m, position.z) - layer.bounds_min) * layer.bounds_per_m;
    let inside = all(share >= vec3f(0.0)) && all(share <= vec3f(1.0));
#ifdef DENSITY_GRID
    return select(0.0, read_grid(layer, share), inside);
#else
    // A ball touches its bounds at the middles of their faces.
    let from_middle = 2.0 * share - 1.0;
    let in_ball = dot(from_middle, from_middle) <= 1.0;
    return select(0.0, 1.0, inside && (layer.is_ball == 0u || in_ball));
#endif
}

/// The part of a ray over the bounds of a layer, m: x and z of a frame grow evenly along it. Empty where y <= x.
fn over_bounds(layer: Layer, origin: vec3f, direction: vec3f) -> vec2f {
    // A ray that does not move along an axis is inside for its whole length, or nowhere.
    let along = select(direction.xz, vec2f(1e-12), abs(direction.xz) < vec2f(1e-12));
    let size = 1.0 / layer.bounds_per_m.xz;
    let first = (layer.bounds_min.xz - origin.xz) / along;
    let second = (layer.bounds_min.xz + size - origin.xz) / along;
    let near = min(first, second);
    let far = max(first, second);
    return vec2f(max(near.x, near.y), min(far.x, far.y));
}
