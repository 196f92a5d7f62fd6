// One ray per texel of a tile: fills the proxy-sphere cache.
#import skycell::march::{scene, march_layer, sample_offset, sample_start_fraction, LayerRadiance, CLEAR_OPACITY}
#import skycell::cubic::cubic_weights
#import skycell::texel_ray::{TILE_STRIDE, PAGE_TILES, FOOTPRINT_TEXELS, texel_in_level, texel_direction, place_on_surface}
#import skycell::accumulate::accumulated
#ifdef COUNT_READS
#import skycell::density::texture_reads
#endif

/// One tile that takes one more sample.
struct TileWork {
    tile: vec2u,
    /// Texels along the whole octahedral square at the tile's level.
    texels_per_side: f32,
    /// Where the atlas keeps the tile.
    slot: u32,
    /// Where the rays of this sample start, in the cell's frame.
    origin: vec3f,
    /// Index among the scene's proxies.
    proxy: u32,
    /// Where the rays of the old texels started.
    old_origin: vec3f,
    /// Which of the jittered samples this is.
    sample_index: u32,
    /// Share of this sample in the texel's new value; 1 replaces.
    weight: f32,
    /// Place of the old texels on the working page.
    previous: u32,
}

@group(2) @binding(0) var<storage, read> work: array<TileWork>;
@group(2) @binding(1) var previous_radiance: texture_2d<f32>;
@group(2) @binding(2) var previous_distance: texture_2d<f32>;
@group(2) @binding(3) var atlas_radiance: texture_storage_2d_array<rgba16float, write>;
@group(2) @binding(4) var atlas_distance: texture_storage_2d_array<r32float, write>;
/// Texture reads so far, low and high word.
@group(2) @binding(5) var<storage, read_write> read_counter: array<atomic<u32>, 2>;

/// What a texel held, or what is looked up between texels.
struct OldTexel {
    radiance: vec4f,
    opacity_distance_m: f32,
}

/// Old texels at a place of their stored tile, in texels from the first one's middle. Sharply, since it is done again with each
/// sample; beyond the tile its edge goes on. The distance is interpolated by its opacity.
fn old_between(previous: u32, place: vec2f) -> OldTexel {
    let first = floor(place) - 1.0;
    let x = cubic_weights(place.x - first.x - 1.0, 0.0);
    let y = cubic_weights(place.y - first.y - 1.0, 0.0);
    let last = vec2f(f32(TILE_STRIDE - 1u));
    var sum = vec4f(0.0);
    var opacity_distance_m = 0.0;
    var opacity = 0.0;
    for (var row = 0u; row < 4u; row += 1u) {
        for (var column = 0u; column < 4u; column += 1u) {
            let tap = first + vec2f(f32(column), f32(row));
            let at = vec2u(clamp(tap, vec2f(0.0), last)) + vec2u(0u, previous * TILE_STRIDE);
            let radiance = textureLoad(previous_radiance, at, 0);
            sum += x[column] * y[row] * radiance;
            // Of the four around the place, without negative weights.
            let near = max(vec2f(0.0), 1.0 - abs(place - tap));
            opacity_distance_m += near.x * near.y * textureLoad(previous_distance, at, 0).x;
            opacity += near.x * near.y * (1.0 - radiance.w);
        }
    }
    let radiance = vec4f(max(sum.xyz, vec3f(0.0)), clamp(sum.w, 0.0, 1.0));
    return OldTexel(radiance, opacity_distance_m * (1.0 - radiance.w + CLEAR_OPACITY) / (opacity + CLEAR_OPACITY));
}

/// What the old texels showed of what a texel of new origin shows: the new sample and the old texel tell how far it is; the ray
/// of old that went there is looked up. Its distance is told from the new origin.
fn carried_over(item: TileWork, stored: vec2u, sample: LayerRadiance) -> OldTexel {
    let planet_radius_m = scene.planet.radius_m;
    let proxy = scene.proxies[item.proxy];
    let at = vec2u(0u, item.previous * TILE_STRIDE) + stored;
    var old = OldTexel(textureLoad(previous_radiance, at, 0), textureLoad(previous_distance, at, 0).x);
    if any(item.old_origin != item.origin) && item.weight < 1.0 {
        let opacities = (1.0 - old.radiance.w) + (1.0 - sample.transmittance) + 2.0 * CLEAR_OPACITY;
        let seen_m = (old.opacity_distance_m + sample.opacity_distance_m) / opacities;
        let square = (texel_in_level(item.tile, stored) + 0.5) / item.texels_per_side;
        let point = item.origin + texel_direction(planet_radius_m, proxy, item.origin, square) * seen_m;
        // Both places are worked out alike: where rays below the horizon were raised, that cancels.
        let place = place_on_surface(planet_radius_m, proxy, item.old_origin, point);
        let shift = (place - place_on_surface(planet_radius_m, proxy, item.origin, point)) * item.texels_per_side;
        let told_anew = distance(point, item.origin) / max(distance(point, item.old_origin), 1.0);
        old = old_between(item.previous, vec2f(stored) + clamp(shift, vec2f(-f32(TILE_STRIDE)), vec2f(f32(TILE_STRIDE))));
        old.opacity_distance_m *= told_anew;
    }
    return old;
}

@compute @workgroup_size(8, 8, 1)
fn march_texels(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let item = work[group.z];
    let stored = group.xy * 8u + local.xy;
    let texel = texel_in_level(item.tile, stored);
    let square = (texel + 0.5 + FOOTPRINT_TEXELS * sample_offset(texel, item.sample_index)) / item.texels_per_side;
    let proxy = scene.proxies[item.proxy];
    let direction = texel_direction(scene.planet.radius_m, proxy, item.origin, square);

    let start = sample_start_fraction(texel, item.sample_index);
    let sample = march_layer(proxy.layer, proxy.part, item.origin, direction, start);

#ifdef COUNT_READS
    let before = atomicAdd(&read_counter[0], texture_reads);
    if before + texture_reads < before { atomicAdd(&read_counter[1], 1u); }
#endif
    let old = carried_over(item, stored, sample);
    let new_radiance = vec4f(sample.single, sample.octaves, sample.ambient, sample.transmittance);
    let new_distance = sample.opacity_distance_m;
    let radiance = accumulated(old.radiance, new_radiance, item.weight);
    let replaces = item.weight >= 1.0;
    let distance = select(mix(old.opacity_distance_m, new_distance, item.weight), new_distance, replaces);

    let target_texel = vec2u(0u, item.slot % PAGE_TILES * TILE_STRIDE) + stored;
    let page = item.slot / PAGE_TILES;
    textureStore(atlas_radiance, target_texel, page, radiance);
    textureStore(atlas_distance, target_texel, page, vec4f(distance, 0.0, 0.0, 0.0));
}
