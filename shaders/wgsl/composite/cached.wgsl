#define_import_path skycell::cached
#import skycell::octahedral::octahedral_from_direction
#ifdef CATMULL_ROM
#import skycell::cubic::{softness, cubic_weights}
#endif
#import skycell::shell::{altitude_m, shell_roots}
#import skycell::surface::{surface_point, surface_distance_m}
#ifdef DISTANCES
#import skycell::surface::dome_distance_m
#endif
#import skycell::scene::Proxy
#import skycell::march::{LayerRadiance, CLEAR_OPACITY, distance_seen_m}
#import skycell::view::{View, PageTable}

/// Page tables as rows of TABLE_WIDTH entries. A texture and no buffer: software drivers read buffers lane by lane.
@group(2) @binding(0) var page_table: texture_2d<u32>;
@group(2) @binding(1) var atlas_radiance: texture_2d_array<f32>;
@group(2) @binding(2) var atlas_distance: texture_2d_array<f32>;
@group(2) @binding(3) var atlas_sampler: sampler;
#ifdef SLOT_ORIGINS
/// Where the rays of a slot's texels started, from the layer's anchor, m: slot s in column s % ORIGINS_WIDTH.
@group(2) @binding(4) var slot_origins: texture_2d<f32>;
#endif

const TABLE_WIDTH: u32 = 1024u;
const ORIGINS_WIDTH: u32 = 256u;
const NO_TILE: u32 = 0xffffffffu;
const TILE_STRIDE: u32 = 64u;
const TILE_INTERIOR: f32 = 60.0;
const GUTTER: f32 = 2.0;
/// Tiles of a page, one below the other, and its texels.
const PAGE_TILES: u32 = 128u;
const PAGE_TEXELS: vec2f = vec2f(64.0, 8192.0);
/// Tiles along the octahedral square at level 0.
const BASE_TILES: u32 = 5u;
const FULL_SPHERE_SR: f32 = 12.566370614359172;
#ifdef CACHE_READS
/// Reads of the atlas, of its page tables and of where rays started, for one pixel.
var<private> cache_reads: u32 = 0u;
#endif

#ifdef CATMULL_ROM
/// Reconstruction by a cubic filter from five bilinear reads: the separable form with merged middle taps. The gutter of two
/// texels keeps every tap inside the tile.
fn read_radiance(texel: vec2f, page: u32, soft: f32) -> vec4f {
    let centre = floor(texel - 0.5) + 0.5;
    let across = cubic_weights(texel.x - centre.x, soft);
    let down = cubic_weights(texel.y - centre.y, soft);
    let w_first = vec2f(across.x, down.x);
    let w_third = vec2f(across.z, down.z);
    let w_last = vec2f(across.w, down.w);
    // At least 5/6.
    let w_middle = vec2f(across.y, down.y) + w_third;
    let at_first = (centre - 1.0) / PAGE_TEXELS;
    let at_middle = (centre + w_third / w_middle) / PAGE_TEXELS;
    let at_last = (centre + 2.0) / PAGE_TEXELS;
    var sum = textureSampleLevel(atlas_radiance, atlas_sampler, at_middle, page, 0.0) * (w_middle.x * w_middle.y);
    sum += textureSampleLevel(atlas_radiance, atlas_sampler, vec2f(at_first.x, at_middle.y), page, 0.0) * (w_first.x * w_middle.y);
    sum += textureSampleLevel(atlas_radiance, atlas_sampler, vec2f(at_last.x, at_middle.y), page, 0.0) * (w_last.x * w_middle.y);
    sum += textureSampleLevel(atlas_radiance, atlas_sampler, vec2f(at_middle.x, at_first.y), page, 0.0) * (w_middle.x * w_first.y);
    sum += textureSampleLevel(atlas_radiance, atlas_sampler, vec2f(at_middle.x, at_last.y), page, 0.0) * (w_middle.x * w_last.y);
    // The four corners weigh at most 1/36 each; dropping them and dividing by what is left costs less than they do.
    let total = w_middle.x * w_middle.y + (w_first.x + w_last.x) * w_middle.y + w_middle.x * (w_first.y + w_last.y);
    let value = max(sum / total, vec4f(0.0));
    return vec4f(value.xyz, min(value.w, 1.0));
}
#else
fn read_radiance(texel: vec2f, page: u32, soft: f32) -> vec4f {
    return textureSampleLevel(atlas_radiance, atlas_sampler, texel / PAGE_TEXELS, page, 0.0);
}
#endif

/// Where the atlas holds what the cache has in a direction.
struct Found {
    held: bool,
    slot: u32,
    /// Of its page, in texels.
    texel: vec2f,
    level: u32,
}

fn find(table: PageTable, from_anchor: vec3f) -> Found {
    let square = octahedral_from_direction(from_anchor);
    let tile = min(vec2u(square * f32(table.tiles_per_side)), vec2u(max(table.tiles_per_side, 1u) - 1u));
    let index = table.offset + tile.y * table.tiles_per_side + tile.x;
#ifdef CACHE_READS
    cache_reads += 1u;
#endif
    let entry = textureLoad(page_table, vec2u(index % TABLE_WIDTH, index / TABLE_WIDTH), 0).x;
    let held = entry != NO_TILE && table.tiles_per_side != 0u;
    let level = min((entry >> 16u) & 0xffu, table.level);
    let slot = select(0u, entry & 0xffffu, held);
    // Tiles double with each level, so a tile of a coarser level is found by a shift.
    let level_tile = vec2f(tile >> vec2u(table.level - level));
    let within = (square * f32(BASE_TILES << level) - level_tile) * TILE_INTERIOR;
    let origin = vec2f(0.0, f32(slot % PAGE_TILES * TILE_STRIDE));
    return Found(held, slot, origin + GUTTER + clamp(within, vec2f(0.0), vec2f(TILE_INTERIOR)), level);
}

/// What the cache holds of a layer in a direction from its anchor, for a pixel of a solid angle as seen from there, sr; 0: as sharply
/// as may be. Without any tile, and where something hides the layer: clear sky.
fn cached_radiance(table: PageTable, from_anchor: vec3f, pixel_sr: f32, hidden: bool) -> LayerRadiance {
    let found = find(table, from_anchor);
    let held = found.held && !hidden;
    let page = found.slot / PAGE_TILES;
#ifdef CATMULL_ROM
    let texels_per_side = f32(BASE_TILES << found.level) * TILE_INTERIOR;
    let soft = softness(pixel_sr * texels_per_side * texels_per_side / FULL_SPHERE_SR);
#else
    let soft = 0.0;
#endif
#ifdef CACHE_READS
#ifdef CATMULL_ROM
    cache_reads += 7u;
#else
    cache_reads += 2u;
#endif
#endif
    let radiance = select(vec4f(0.0, 0.0, 0.0, 1.0), read_radiance(found.texel, page, soft), held);
    var opacity_distance_m = textureSampleLevel(atlas_distance, atlas_sampler, found.texel / PAGE_TEXELS, page, 0.0).x;
#ifdef CATMULL_ROM
    // Its opacity must come from the same filter, or the distance jumps at edges.
    let transmittance = textureSampleLevel(atlas_radiance, atlas_sampler, found.texel / PAGE_TEXELS, page, 0.0).w;
    opacity_distance_m *= (1.0 - radiance.w + CLEAR_OPACITY) / (1.0 - transmittance + CLEAR_OPACITY);
#endif
    return LayerRadiance(radiance.x, radiance.y, radiance.z, radiance.w, select(0.0, opacity_distance_m, held));
}

/// A part of a layer in the cache.
struct Kept {
    proxy: Proxy,
    table: PageTable,
}

/// The point of a viewer's ray at an altitude above it.
fn point_at_altitude(planet_radius_m: f32, eye: View, direction: vec3f, altitude: f32) -> vec3f {
    let shell = shell_roots(planet_radius_m, altitude, eye.position, eye.altitude_m, direction);
    return eye.position + direction * max(shell.far_m, 1e-3);
}

#ifdef ABOVE
/// Whether a viewer's ray from above passes over a proxy's part: tiles end a little above its edge, and coarse ones reach far
/// beyond.
fn passes_over(planet_radius_m: f32, eye: View, proxy: Proxy, direction: vec3f) -> bool {
    let top = shell_roots(planet_radius_m, proxy.part.high_altitude_m, eye.position, eye.altitude_m, direction);
    return proxy.from_above > 0u && !(top.hit && top.far_m > 0.0);
}
#endif

#ifdef PHASE_OF_REFERENCE
/// The direction of the ray that was marched for what a viewer sees on a proxy's sphere.
fn marched_direction(planet_radius_m: f32, eye: View, kept: Kept, direction: vec3f) -> vec3f {
    let from_anchor = point_at_altitude(planet_radius_m, eye, direction, kept.proxy.altitude_m) - kept.proxy.anchor;
    let found = find(kept.table, from_anchor);
    let origin = textureLoad(slot_origins, vec2u(found.slot % ORIGINS_WIDTH, found.slot / ORIGINS_WIDTH), 0).xyz;
    return select(direction, normalize(from_anchor - origin), found.held);
}
#endif

#ifdef PARALLAX
/// What a viewer away from where texels were marched knows of a proxy's part along its ray.
struct Parallax {
    /// Where it is on the ray, see Way.
    place: f32,
    /// Where the rays of the texels started that show it, from the anchor, m.
    origin: vec3f,
}

/// The place of the surface, from the anchor, whose texel shows a point: where the ray from that texel's origin through the
/// point meets it.
fn place_of_point(planet_radius_m: f32, proxy: Proxy, parallax: Parallax, point: vec3f) -> vec3f {
    let origin = proxy.anchor + parallax.origin;
    let direction = normalize(point - origin);
    return parallax.origin + direction * surface_distance_m(planet_radius_m, proxy, origin, altitude_m(planet_radius_m, origin), direction);
}

/// What a texel tells of what it shows.
struct Shown {
    held: bool,
    opacity: f32,
    /// From where its ray started, m.
    distance_m: f32,
    /// Where that is, from the anchor.
    origin: vec3f,
}

fn shown_at(table: PageTable, from_anchor: vec3f) -> Shown {
    let found = find(table, from_anchor);
    let page = found.slot / PAGE_TILES;
    let at = found.texel / PAGE_TEXELS;
#ifdef CACHE_READS
    cache_reads += 3u;
#endif
    let opacity = 1.0 - textureSampleLevel(atlas_radiance, atlas_sampler, at, page, 0.0).w;
    let opacity_distance_m = textureSampleLevel(atlas_distance, atlas_sampler, at, page, 0.0).x;
    let origin = textureLoad(slot_origins, vec2u(found.slot % ORIGINS_WIDTH, found.slot / ORIGINS_WIDTH), 0).xyz;
    return Shown(found.held, opacity, distance_seen_m(opacity_distance_m, 1.0 - opacity), origin);
}

/// What a texel says of a point on a viewer's ray.
struct Probed {
    /// How far the point lies behind what the texel shows, m; negative in front of it, and where the texel shows nothing.
    behind_m: f32,
    opacity: f32,
    /// Where the texel's ray started, from the anchor.
    origin: vec3f,
}

/// Less opacity than this is nothing to be seen.
const SEEN_OPACITY: f32 = 0.02;
/// Of a texel that shows nothing.
const NOTHING_BEHIND_M: f32 = -1e9;

fn probe_point(planet_radius_m: f32, proxy: Proxy, table: PageTable, before: Parallax, point: vec3f) -> Probed {
    let shown = shown_at(table, place_of_point(planet_radius_m, proxy, before, point));
    let behind_m = length(point - proxy.anchor - shown.origin) - shown.distance_m;
    let shows = shown.held && shown.opacity > SEEN_OPACITY;
    return Probed(select(NOTHING_BEHIND_M, behind_m, shows), select(0.0, shown.opacity, shown.held), select(before.origin, shown.origin, shown.held));
}

/// Places of a search stand this far apart in the cache, pixels.
const SEARCH_PIXELS: f32 = 1.0;
/// How far behind what a texel shows its cloud may go on, as a share of the way between two places of a search, and m.
const CLOUD_DEPTH_SHARE: f32 = 0.7;
const CLOUD_DEPTH_M: f32 = 50.0;
/// How fast a ray may get behind one surface, per m of its way.
const CLOUD_SLOPE: f32 = 3.0;

/// Altitudes between which a viewer's ray is searched for what a proxy keeps: those where it has cloud, as far as its distances from
/// where its rays start go.
fn searched_altitudes(planet_radius_m: f32, eye: View, proxy: Proxy, starts: vec3f, direction: vec3f) -> vec2f {
    let part = vec2f(proxy.seen_low_altitude_m, proxy.seen_high_altitude_m);
#ifdef DOMES
    let along = searched_distances_m(eye, proxy, starts, direction);
    let ends = vec2f(altitude_m(planet_radius_m, eye.position + direction * along.x), altitude_m(planet_radius_m, eye.position + direction * along.y));
    return clamp(vec2f(min(ends.x, ends.y), max(ends.x, ends.y)), part.xx, part.yy);
#else
    return part;
#endif
}

#ifdef DISTANCES
/// Farther than any cloud is seen, m.
const FARTHEST_M: f32 = 2e6;

/// Distances along a viewer's ray between which it is as far from where a proxy's rays start as the proxy keeps something.
fn searched_distances_m(eye: View, proxy: Proxy, starts: vec3f, direction: vec3f) -> vec2f {
    let from_start = eye.position - starts;
    // No ray in a layer is longer than this, and no square of it is beyond a float.
    let distances_m = min(vec2f(proxy.part.near_m, proxy.part.far_gap_m), vec2f(FARTHEST_M));
    let near_m = max(dome_distance_m(distances_m.x, from_start, direction), 0.0);
    let far_m = max(dome_distance_m(distances_m.y, from_start, direction), 0.0);
    return vec2f(near_m, far_m);
}
#endif

#ifdef INSIDE
/// Whether a viewer is in the layer of which a proxy keeps the far part.
fn is_around(proxy: Proxy) -> bool {
    return proxy.radius_m > 0.0;
}

/// In a layer a ray may go on for hundreds of kilometres: places on it are even as they are seen from beside it, by one over the
/// distance, 1/km, less than 0 so that the nearer is the less one.
fn place_at_m(distance_m: f32) -> f32 {
    return -1e3 / max(distance_m, 1.0);
}

/// Ends of a viewer's way through what lies far in the layer that it is in.
fn way_in_layer(planet_radius_m: f32, eye: View, proxy: Proxy, starts: vec3f, direction: vec3f) -> Way {
    let along = searched_distances_m(eye, proxy, starts, direction);
    let top = shell_roots(planet_radius_m, proxy.part.high_altitude_m, eye.position, eye.altitude_m, direction);
    let base = shell_roots(planet_radius_m, proxy.part.low_altitude_m, eye.position, eye.altitude_m, direction);
    let ground = shell_roots(planet_radius_m, 0.0, eye.position, eye.altitude_m, direction);
    // A ray that passes over the horizon comes up to the layer again.
    let goes_down = base.hit && base.near_m > 0.0 && ground.hit && ground.near_m > 0.0;
    let leaves_m = select(top.far_m, base.near_m, goes_down);
    return Way(place_at_m(along.x), place_at_m(max(min(along.y, leaves_m), along.x)));
}
#endif

/// Ends of a viewer's way through a proxy's part, the nearer first. Places on it are altitudes; from above distances, since a
/// ray may leave the part at the altitude at which it has entered it.
struct Way {
    near: f32,
    far: f32,
}

fn way_through(planet_radius_m: f32, eye: View, proxy: Proxy, starts: vec3f, direction: vec3f) -> Way {
    let between = searched_altitudes(planet_radius_m, eye, proxy, starts, direction);
#ifdef ABOVE
    let top = shell_roots(planet_radius_m, proxy.part.high_altitude_m, eye.position, eye.altitude_m, direction);
    let base = shell_roots(planet_radius_m, proxy.part.low_altitude_m, eye.position, eye.altitude_m, direction);
    var near_m = max(top.near_m, 1e-3);
    var far_m = max(select(top.far_m, base.near_m, base.hit), near_m);
#ifdef DOMES
    let along = searched_distances_m(eye, proxy, starts, direction);
    near_m = clamp(along.x, near_m, far_m);
    far_m = clamp(along.y, near_m, far_m);
#endif
    let is_above = proxy.from_above > 0u;
    let way = Way(select(between.x, near_m, is_above), select(between.y, far_m, is_above));
#ifdef INSIDE
    let in_layer = way_in_layer(planet_radius_m, eye, proxy, starts, direction);
    return Way(select(way.near, in_layer.near, is_around(proxy)), select(way.far, in_layer.far, is_around(proxy)));
#else
    return way;
#endif
#else
    return Way(between.x, between.y);
#endif
}

/// A place of a viewer's way. No branches here and below: where the air has light shafts, the software driver of Mesa 22 crashes over
/// one that is about uniforms.
fn point_at_place(planet_radius_m: f32, eye: View, proxy: Proxy, direction: vec3f, place: f32) -> vec3f {
    var point = point_at_altitude(planet_radius_m, eye, direction, place);
#ifdef ABOVE
    point = select(point, eye.position + direction * place, proxy.from_above > 0u);
#endif
#ifdef INSIDE
    point = select(point, eye.position + direction * (-1e3 / min(place, -1e-4)), is_around(proxy));
#endif
    return point;
}

/// The place of a point beside a viewer's ray.
fn place_beside(planet_radius_m: f32, eye: View, proxy: Proxy, direction: vec3f, point: vec3f) -> f32 {
    var place = altitude_m(planet_radius_m, point);
#ifdef ABOVE
    let along_m = dot(point - eye.position, direction);
    place = select(place, along_m, proxy.from_above > 0u);
#endif
#ifdef INSIDE
    place = select(place, place_at_m(along_m), is_around(proxy));
#endif
    return place;
}

/// Finds the place of what a viewer sees: goes along its ray, from the near side of what the proxy keeps to its far one, until it is
/// behind what the texels there show. Where that moves what is read by little, the texel on the sphere tells it.
fn parallax_along(planet_radius_m: f32, eye: View, proxy: Proxy, table: PageTable, direction: vec3f, hidden: bool) -> Parallax {
    let on_surface = surface_point(planet_radius_m, proxy, eye.position, eye.altitude_m, direction);
#ifdef ABOVE
    let on_surface_place = place_beside(planet_radius_m, eye, proxy, direction, on_surface);
#else
    let on_surface_place = proxy.altitude_m;
#endif
    var result = Parallax(on_surface_place, vec3f(0.0));
    let first = shown_at(table, on_surface - proxy.anchor);
    result.origin = select(vec3f(0.0), first.origin, first.held);
    let starts = proxy.anchor + result.origin;
    let way = way_through(planet_radius_m, eye, proxy, starts, direction);
    let seen = starts + normalize(on_surface - starts) * first.distance_m;
#ifdef ABOVE
    let seen_place = clamp(place_beside(planet_radius_m, eye, proxy, direction, seen), way.near, way.far);
#else
    let seen_place = clamp(altitude_m(planet_radius_m, seen), proxy.part.low_altitude_m, proxy.part.high_altitude_m);
#endif
    result.place = select(on_surface_place, seen_place, first.held);

    let from_near = normalize(point_at_place(planet_radius_m, eye, proxy, direction, way.near) - starts);
    let from_far = normalize(point_at_place(planet_radius_m, eye, proxy, direction, way.far) - starts);
    let wanted = u32(min(length(from_near - from_far) / (SEARCH_PIXELS * eye.pixel_angle_rad), f32(eye.parallax_steps)));
    let searches = select(0u, wanted, wanted > 1u && !hidden);
    var near = way.near;
    var near_behind_m = NOTHING_BEHIND_M;
    var far = way.far;
    var far_behind_m = 0.0;
    var is_hit = false;
    var last = point_at_place(planet_radius_m, eye, proxy, direction, near);
    for (var i = 0u; i < searches && !is_hit; i += 1u) {
        let place = mix(way.near, way.far, f32(i + 1u) / f32(max(searches, 1u)));
        let point = point_at_place(planet_radius_m, eye, proxy, direction, place);
        let probed = probe_point(planet_radius_m, proxy, table, result, point);
        let is_behind = probed.behind_m >= 0.0;
        // A point far behind a cloud is no part of it: it is in what the cloud hides. Along one surface it gets behind by no
        // more than some times the way that it has come.
        let way_m = length(point - last);
        let is_on_surface = probed.behind_m - near_behind_m < CLOUD_SLOPE * way_m;
        is_hit = is_behind && (probed.behind_m < CLOUD_DEPTH_SHARE * way_m + CLOUD_DEPTH_M || is_on_surface);
        far = select(far, place, is_hit);
        far_behind_m = select(far_behind_m, probed.behind_m, is_hit);
        near = select(place, near, is_behind);
        near_behind_m = select(probed.behind_m, select(near_behind_m, NOTHING_BEHIND_M, is_behind && !is_hit), is_behind);
        result.origin = probed.origin;
        last = point;
    }
    // The interval in which the ray goes under the surface is narrowed. At an edge it ends in the cloud.
    let follows = is_hit && near_behind_m > 0.5 * NOTHING_BEHIND_M;
    let narrowings = select(0u, 2u, is_hit);
    for (var i = 0u; i < narrowings; i += 1u) {
        let between = clamp(near_behind_m / min(near_behind_m - far_behind_m, -1e-3), 0.1, 0.9);
        let place = mix(near, far, select(0.5, between, follows));
        let point = point_at_place(planet_radius_m, eye, proxy, direction, place);
        let probed = probe_point(planet_radius_m, proxy, table, result, point);
        let is_behind = probed.behind_m >= 0.0;
        let is_far = is_behind && (follows || probed.opacity > 0.5);
        let is_near = !is_far;
        far = select(far, place, is_far);
        far_behind_m = select(far_behind_m, probed.behind_m, is_far);
        near = select(near, place, is_near);
        near_behind_m = select(near_behind_m, probed.behind_m, is_near && follows);
    }
    let between = clamp(near_behind_m / min(near_behind_m - far_behind_m, -1e-3), 0.0, 1.0);
    let surface = mix(near, far, select(1.0, between, follows));
    result.place = select(result.place, select(near, surface, is_hit), searches > 0u);
    return result;
}
#endif

/// The solid angle that what a viewer's pixel shows at a point has from an anchor, sr. θ off the middle of a picture a pixel has
/// cos³θ of what it has there; from twice as far a thing has a quarter of the solid angle.
fn pixel_sr(eye: View, direction: vec3f, point: vec3f, anchor: vec3f) -> f32 {
    let mu = max(dot(direction, eye.forward), 0.0);
    let from_eye = point - eye.position;
    let from_anchor = point - anchor;
    let nearer = dot(from_eye, from_eye) / max(dot(from_anchor, from_anchor), 1.0);
    return eye.pixel_angle_rad * eye.pixel_angle_rad * mu * mu * mu * nearer;
}

/// What the cache holds of a part of a layer along a viewer's ray.
fn cached_part(planet_radius_m: f32, eye: View, kept: Kept, direction: vec3f, hidden: bool) -> LayerRadiance {
    let proxy = kept.proxy;
    let table = kept.table;
#ifdef ABOVE
    // Both are looked at, as `||` would branch.
    let is_clear = hidden | passes_over(planet_radius_m, eye, proxy, direction);
#else
    let is_clear = hidden;
#endif
#ifdef PARALLAX
    let parallax = parallax_along(planet_radius_m, eye, proxy, table, direction, is_clear);
    let point = point_at_place(planet_radius_m, eye, proxy, direction, parallax.place);
    var cloud = cached_radiance(table, place_of_point(planet_radius_m, proxy, parallax, point), pixel_sr(eye, direction, point, proxy.anchor), is_clear);
    // The viewer is as far from what it sees as it is, not as far as the origin of the texel's ray.
    cloud.opacity_distance_m *= length(point - eye.position) / max(length(point - proxy.anchor - parallax.origin), 1.0);
    return cloud;
#else
    let point = surface_point(planet_radius_m, proxy, eye.position, eye.altitude_m, direction);
    return cached_radiance(table, point - proxy.anchor, pixel_sr(eye, direction, point, proxy.anchor), is_clear);
#endif
}

#ifdef PARTS
/// One part of a layer in front of another.
fn in_front_of(front: LayerRadiance, back: LayerRadiance) -> LayerRadiance {
    let kept = front.transmittance;
    let transmittance = kept * back.transmittance;
    // Each has the distance of its clear sky once, the whole has one.
    let weights = (1.0 - kept + CLEAR_OPACITY) + kept * (1.0 - back.transmittance + CLEAR_OPACITY);
    let distance_m = (front.opacity_distance_m + kept * back.opacity_distance_m) / weights;
    return LayerRadiance(
        front.single + kept * back.single,
        front.octaves + kept * back.octaves,
        front.ambient + kept * back.ambient,
        transmittance,
        distance_m * (1.0 - transmittance + CLEAR_OPACITY),
    );
}

#endif

#if PROXIES >= 2
#ifndef DOMES
/// Two parts as an eye sees them: from above the upper one, the second, hides the lower one.
fn both_parts(first: LayerRadiance, second: LayerRadiance, from_above: bool) -> LayerRadiance {
    let below = in_front_of(first, second);
    let above = in_front_of(second, first);
    return LayerRadiance(
        select(below.single, above.single, from_above),
        select(below.octaves, above.octaves, from_above),
        select(below.ambient, above.ambient, from_above),
        select(below.transmittance, above.transmittance, from_above),
        select(below.opacity_distance_m, above.opacity_distance_m, from_above),
    );
}
#endif
#endif

#ifdef PARTS
/// What lets less through than this hides what is behind: half a step of what is shown.
const HIDING_TRANSMITTANCE: f32 = 2e-3;

/// Whether nothing can be seen of the parts that follow. From above each of them is in front.
fn hides_next(cloud: LayerRadiance, from_above: bool) -> bool {
    return !from_above && cloud.transmittance < HIDING_TRANSMITTANCE;
}
#endif

/// What the cache holds of a layer along a viewer's ray: its parts, slabs from the lowest to the highest, one behind the other.
fn cached_layer(planet_radius_m: f32, eye: View, kept: array<Kept, #{PROXIES}>, direction: vec3f, hidden: bool) -> LayerRadiance {
    var cloud = cached_part(planet_radius_m, eye, kept[0], direction, hidden);
#ifdef DOMES
    // Bands of distance, from the nearest to the farthest.
#if PROXIES >= 2
    var behind = hidden || hides_next(cloud, false);
    cloud = in_front_of(cloud, cached_part(planet_radius_m, eye, kept[1], direction, behind));
#endif
#if PROXIES >= 3
    behind = behind || hides_next(cloud, false);
    cloud = in_front_of(cloud, cached_part(planet_radius_m, eye, kept[2], direction, behind));
#endif
#if PROXIES >= 4
    behind = behind || hides_next(cloud, false);
    cloud = in_front_of(cloud, cached_part(planet_radius_m, eye, kept[3], direction, behind));
#endif
#else
#if PROXIES >= 2
    let from_above = eye.altitude_m > kept[0].proxy.part.high_altitude_m;
    var behind = hidden || hides_next(cloud, from_above);
    cloud = both_parts(cloud, cached_part(planet_radius_m, eye, kept[1], direction, behind), from_above);
#endif
#if PROXIES >= 3
    behind = behind || hides_next(cloud, from_above);
    cloud = both_parts(cloud, cached_part(planet_radius_m, eye, kept[2], direction, behind), from_above);
#endif
#if PROXIES >= 4
    behind = behind || hides_next(cloud, from_above);
    cloud = both_parts(cloud, cached_part(planet_radius_m, eye, kept[3], direction, behind), from_above);
#endif
#endif
    return cloud;
}
