// One picture for one viewer: the layers of its cell, back to front, over sky and ground.
#import skycell::march::{scene, LayerRadiance, distance_seen_m}
#import skycell::scene::{Scene, Layer}
#import skycell::shade::{Background, Ray, background, hidden_by_ground, pixel_ray}
// What a viewer looks at instead of the picture takes the place of these functions.
#ifdef SHOW_VALUES
#import skycell::show::{no_values as background_radiance, values_over as layer_over, colour_of_values}
#else
#ifdef SHOW_PART
#import skycell::show::{black_background as background_radiance, part_over as layer_over}
#else
#ifdef CLOUDS_ALONE
#import skycell::show::{black_background as background_radiance}
#import skycell::shade::layer_over
#import skycell::clouds::{CloudsSeen, CLOUDS_WORDS, no_clouds_seen, layer_before, clouds_pixel, packed_clouds, power_of_two_below}
#else
#import skycell::shade::{background_radiance, layer_over}
#endif
#endif
#endif
#ifdef SHOW_PHASE_OFF
#import skycell::show::isotropic_per_sr as sun_phase_per_sr
#else
#import skycell::shade::sun_phase_per_sr
#endif
#import skycell::tone::{balanced, encoded, dithered_bytes}
#ifdef STARS
#import skycell::night::star_radiance
#endif
#ifdef PHYSICAL_SKY
#import skycell::shade::{haze_of_layer, sun_on_cloud, layer_in_air_over}
#import skycell::physical::Haze
#endif
#import skycell::view::{View, ListedRay, pixel_direction}
#import skycell::shell::altitude_m
#ifndef SCREEN_SPACE
#import skycell::cached::Kept
#ifdef SHOW_CACHE
#import skycell::show::cached_entry
#import skycell::surface::surface_point
#else
#import skycell::cached::cached_layer
#ifdef INSIDE
#import skycell::cached::{in_front_of, hides_next}
#endif
#ifdef CACHE_READS
#import skycell::cached::cache_reads
#endif
#ifdef PHASE_OF_REFERENCE
#import skycell::cached::marched_direction
#import skycell::phase::one_minus_mu
#endif
#endif
#endif

@group(3) @binding(0) var<uniform> view: View;
#ifdef LINEAR_OUTPUT
@group(3) @binding(1) var<storage, read_write> picture: array<vec4f>;
#else
@group(3) @binding(1) var<storage, read_write> picture: array<u32>;
#endif
#ifdef SCREEN_SPACE
/// Per layer and pixel: single, octaves, ambient, transmittance and the distance, as marched by march_pixels; for listed
/// rays two values more.
@group(2) @binding(0) var<storage, read> marched: array<f32>;
#ifdef RAY_LIST
@group(3) @binding(2) var<storage, read> rays: array<ListedRay>;
const VALUES: u32 = 7u;
#else
const VALUES: u32 = 5u;
#endif
#endif
#ifdef INSIDE
/// The same of the near part of the layers that the viewer is in.
@group(2) @binding(5) var<storage, read> marched: array<f32>;
const VALUES: u32 = 5u;
#endif

#ifdef MARCHED
/// The marched pixel at a column and row.
fn marched_pixel(eye: View, layer_index: u32, pixel: vec2u) -> LayerRadiance {
    let at = ((layer_index * eye.height + pixel.y) * eye.width + pixel.x) * VALUES;
    return LayerRadiance(marched[at], marched[at + 1u], marched[at + 2u], marched[at + 3u], marched[at + 4u]);
}
#endif

#ifdef SCREEN_SPACE
/// What the viewer sees of one layer along a ray.
fn layer_radiance(world: Scene, eye: View, layer: Layer, layer_index: u32, pixel: vec2u, ray: Ray) -> LayerRadiance {
    let cloud = marched_pixel(eye, layer_index, pixel);
    // Samples of the pixels at the horizon reach above it; the middle of the pixel decides, as it does for the cache.
    let hidden = hidden_by_ground(ray, layer.base_altitude_m);
    let seen = select(1.0, 0.0, hidden);
    let transmittance = select(cloud.transmittance, 1.0, hidden);
    return LayerRadiance(seen * cloud.single, seen * cloud.octaves, seen * cloud.ambient, transmittance, seen * cloud.opacity_distance_m);
}
#else
#ifdef INSIDE
/// The near part of a layer that the viewer is in, nothing of others.
fn near_part(eye: View, layer_index: u32, pixel: vec2u) -> LayerRadiance {
    let bit = 1u << layer_index;
    let place = countOneBits(eye.near_layers & (bit - 1u));
    let near = marched_pixel(eye, place, pixel);
    let is_in = (eye.near_layers & bit) != 0u;
    return LayerRadiance(
        select(0.0, near.single, is_in),
        select(0.0, near.octaves, is_in),
        select(0.0, near.ambient, is_in),
        select(1.0, near.transmittance, is_in),
        select(0.0, near.opacity_distance_m, is_in),
    );
}
#endif

/// What the viewer sees of one layer along a ray. Texels straddle the horizon; the viewer's own ray decides whether the
/// ground hides the layer.
fn layer_radiance(world: Scene, eye: View, layer: Layer, layer_index: u32, kept: array<Kept, #{PROXIES}>, pixel: vec2u, ray: Ray) -> LayerRadiance {
    let hidden = hidden_by_ground(ray, layer.base_altitude_m);
#ifdef SHOW_CACHE
    // Of the nearest part.
    let proxy = kept[0].proxy;
    let on_surface = surface_point(world.planet.radius_m, proxy, eye.position, eye.altitude_m, ray.direction);
    return cached_entry(kept[0].table, on_surface - proxy.anchor, hidden);
#else
#ifdef INSIDE
    let near = near_part(eye, layer_index, pixel);
    var cloud = in_front_of(near, cached_layer(world.planet.radius_m, eye, kept, ray.direction, hidden || hides_next(near, false)));
#else
    var cloud = cached_layer(world.planet.radius_m, eye, kept, ray.direction, hidden);
#endif
#ifdef PHASE_OF_REFERENCE
    var marched_ray = ray;
    marched_ray.direction = marched_direction(world.planet.radius_m, eye, kept[0], ray.direction);
    marched_ray.angle = one_minus_mu(marched_ray.direction, world.sun.direction);
    // No phase is nothing anywhere.
    cloud.single *= sun_phase_per_sr(world, layer.phase, marched_ray) / sun_phase_per_sr(world, layer.phase, ray);
#endif
    return cloud;
#endif
}

// The parts of each layer. Written out, with constant indices, for the same reason as the layers below: an index that a function
// is given is read lane by lane on a software driver.
#if LAYERS >= 1
fn kept_first(world: Scene, eye: View) -> array<Kept, #{PROXIES}> {
    var kept: array<Kept, #{PROXIES}>;
    kept[0] = Kept(world.proxies[0u * #{PROXIES}u], eye.tables[0u * #{PROXIES}u]);
#if PROXIES >= 2
    kept[1] = Kept(world.proxies[0u * #{PROXIES}u + 1u], eye.tables[0u * #{PROXIES}u + 1u]);
#endif
#if PROXIES >= 3
    kept[2] = Kept(world.proxies[0u * #{PROXIES}u + 2u], eye.tables[0u * #{PROXIES}u + 2u]);
#endif
#if PROXIES >= 4
    kept[3] = Kept(world.proxies[0u * #{PROXIES}u + 3u], eye.tables[0u * #{PROXIES}u + 3u]);
#endif
    return kept;
}
#endif
#if LAYERS >= 2
fn kept_second(world: Scene, eye: View) -> array<Kept, #{PROXIES}> {
    var kept: array<Kept, #{PROXIES}>;
    kept[0] = Kept(world.proxies[1u * #{PROXIES}u], eye.tables[1u * #{PROXIES}u]);
#if PROXIES >= 2
    kept[1] = Kept(world.proxies[1u * #{PROXIES}u + 1u], eye.tables[1u * #{PROXIES}u + 1u]);
#endif
#if PROXIES >= 3
    kept[2] = Kept(world.proxies[1u * #{PROXIES}u + 2u], eye.tables[1u * #{PROXIES}u + 2u]);
#endif
#if PROXIES >= 4
    kept[3] = Kept(world.proxies[1u * #{PROXIES}u + 3u], eye.tables[1u * #{PROXIES}u + 3u]);
#endif
    return kept;
}
#endif
#if LAYERS >= 3
fn kept_third(world: Scene, eye: View) -> array<Kept, #{PROXIES}> {
    var kept: array<Kept, #{PROXIES}>;
    kept[0] = Kept(world.proxies[2u * #{PROXIES}u], eye.tables[2u * #{PROXIES}u]);
#if PROXIES >= 2
    kept[1] = Kept(world.proxies[2u * #{PROXIES}u + 1u], eye.tables[2u * #{PROXIES}u + 1u]);
#endif
#if PROXIES >= 3
    kept[2] = Kept(world.proxies[2u * #{PROXIES}u + 2u], eye.tables[2u * #{PROXIES}u + 2u]);
#endif
#if PROXIES >= 4
    kept[3] = Kept(world.proxies[2u * #{PROXIES}u + 3u], eye.tables[2u * #{PROXIES}u + 3u]);
#endif
    return kept;
}
#endif
#if LAYERS >= 4
fn kept_fourth(world: Scene, eye: View) -> array<Kept, #{PROXIES}> {
    var kept: array<Kept, #{PROXIES}>;
    kept[0] = Kept(world.proxies[3u * #{PROXIES}u], eye.tables[3u * #{PROXIES}u]);
#if PROXIES >= 2
    kept[1] = Kept(world.proxies[3u * #{PROXIES}u + 1u], eye.tables[3u * #{PROXIES}u + 1u]);
#endif
#if PROXIES >= 3
    kept[2] = Kept(world.proxies[3u * #{PROXIES}u + 2u], eye.tables[3u * #{PROXIES}u + 2u]);
#endif
#if PROXIES >= 4
    kept[3] = Kept(world.proxies[3u * #{PROXIES}u + 3u], eye.tables[3u * #{PROXIES}u + 3u]);
#endif
    return kept;
}
#endif
#endif

/// A layer along a ray with its place in the order of blending.
struct OrderedLayer {
    cloud: LayerRadiance,
#ifdef PHYSICAL_SKY
    haze: Haze,
    /// Of the sun, at the layer.
    sun_irradiance: vec3f,
#else
    air_extinction_per_m: vec3f,
#endif
    albedo: f32,
#ifdef OWN_PHASES
    phase_per_sr: f32,
#endif
    /// Greater for what lies farther back. A ray leaves layers above the eye behind it in rising order, those below it,
    /// all of them nearer, in falling order. Where layers share altitudes: the mean distance of what is seen of each.
    rank: f32,
}

/// More than any altitude, m.
const ABOVE_RANK: f32 = 1e6;

#ifdef HAZE_OF_SPHERES
fn ordered_layer(world: Scene, back: Background, shared_haze: Haze, layer: Layer, cloud: LayerRadiance, ray: Ray) -> OrderedLayer {
#else
fn ordered_layer(world: Scene, back: Background, layer: Layer, cloud: LayerRadiance, ray: Ray) -> OrderedLayer {
#endif
    var ordered: OrderedLayer;
    ordered.cloud = cloud;
#ifdef PHYSICAL_SKY
#ifdef HAZE_OF_SPHERES
    ordered.haze = shared_haze;
#else
    ordered.haze = haze_of_layer(back, distance_seen_m(cloud.opacity_distance_m, cloud.transmittance));
#endif
#ifdef WITHOUT_HAZE
    ordered.haze.extinction_per_m = vec3f(0.0);
#else
    ordered.haze.extinction_per_m *= layer.has_haze;
#endif
    ordered.sun_irradiance = sun_on_cloud(world, layer, cloud, ray);
#else
#ifdef WITHOUT_HAZE
    ordered.air_extinction_per_m = vec3f(0.0);
#else
    ordered.air_extinction_per_m = layer.air_extinction_per_m;
#endif
#endif
    ordered.albedo = layer.single_scattering_albedo;
#ifdef OWN_PHASES
    ordered.phase_per_sr = sun_phase_per_sr(world, layer.phase, ray);
#endif
#ifdef LAYERS_OVERLAP
    ordered.rank = distance_seen_m(cloud.opacity_distance_m, cloud.transmittance);
#else
    let altitude = layer.proxy_altitude_m;
    let is_in = ray.origin_altitude_m >= layer.base_altitude_m && ray.origin_altitude_m <= layer.top_altitude_m;
    let rank = select(-altitude, ABOVE_RANK + altitude, altitude >= ray.origin_altitude_m);
    // A ray begins in the layer that its eye is in.
    ordered.rank = select(rank, -ABOVE_RANK, is_in);
#endif
    return ordered;
}

struct LayerPair {
    nearer: OrderedLayer,
    farther: OrderedLayer,
}

/// Which of two layers hides the other depends on where the eye is: from above the upper one, from below the lower one.
fn nearer_first(a: OrderedLayer, b: OrderedLayer) -> LayerPair {
    let swapped = b.rank < a.rank;
    return LayerPair(chosen(a, b, swapped), chosen(b, a, swapped));
}

fn chosen(a: OrderedLayer, b: OrderedLayer, second: bool) -> OrderedLayer {
    var result: OrderedLayer;
    result.cloud = LayerRadiance(
        select(a.cloud.single, b.cloud.single, second),
        select(a.cloud.octaves, b.cloud.octaves, second),
        select(a.cloud.ambient, b.cloud.ambient, second),
        select(a.cloud.transmittance, b.cloud.transmittance, second),
        select(a.cloud.opacity_distance_m, b.cloud.opacity_distance_m, second),
    );
#ifdef PHYSICAL_SKY
    result.haze = Haze(
        select(a.haze.extinction_per_m, b.haze.extinction_per_m, second),
        select(a.haze.source_per_sr, b.haze.source_per_sr, second),
        a.haze.start_m,
    );
    result.sun_irradiance = select(a.sun_irradiance, b.sun_irradiance, second);
#else
    result.air_extinction_per_m = select(a.air_extinction_per_m, b.air_extinction_per_m, second);
#endif
    result.albedo = select(a.albedo, b.albedo, second);
#ifdef OWN_PHASES
    result.phase_per_sr = select(a.phase_per_sr, b.phase_per_sr, second);
#endif
    result.rank = select(a.rank, b.rank, second);
    return result;
}

/// A layer over what lies behind it. shared_phase_per_sr: of single scattering, where all layers have the same.
fn over(world: Scene, back: Background, layer: OrderedLayer, shared_phase_per_sr: f32, behind: vec3f) -> vec3f {
#ifdef OWN_PHASES
    let phase = layer.phase_per_sr;
#else
    let phase = shared_phase_per_sr;
#endif
#ifdef PHYSICAL_SKY
    return layer_in_air_over(world, layer.haze, layer.sun_irradiance, phase, behind, layer.cloud, layer.albedo);
#else
    return layer_over(world, back, phase, behind, layer.cloud, layer.air_extinction_per_m, layer.albedo);
#endif
}

#ifdef CLOUDS_ALONE
/// What clouds hide along the ray that was looked along last.
var<private> clouds_seen: CloudsSeen;
#endif

/// Radiance that reaches the viewer through the middle of a pixel.
fn pixel_radiance(world: Scene, eye: View, back: Background, pixel: vec2u) -> vec3f {
    let direction = pixel_direction(eye, vec2f(pixel) + 0.5);
    return ray_radiance(world, eye, back, pixel, pixel_ray(world, eye.position, eye.altitude_m, direction));
}

/// Radiance along a ray, which is that of a pixel.
fn ray_radiance(world: Scene, eye: View, back: Background, pixel: vec2u, ray: Ray) -> vec3f {
    var radiance = background_radiance(world, back, ray);
#ifdef STARS
    let stars = star_radiance(world.night, ray.direction, eye.pixel_angle_rad) * back.transmittance;
    radiance += select(stars, vec3f(0.0), ray.on_ground);
#endif
#ifdef CLOUDS_ALONE
    clouds_seen = no_clouds_seen();
#endif
#if LAYERS >= 1
#ifdef OWN_PHASES
    let phase = 0.0;
#else
    let phase = sun_phase_per_sr(world, world.layers[0].phase, ray);
#endif
    // Written out with constant indices, so that all of them are read before the first pixel (and because a loop over
    // layers at computed indices keeps the software driver's compiler busy for minutes).
#ifdef SCREEN_SPACE
    let first_cloud = layer_radiance(world, eye, world.layers[0], 0u, pixel, ray);
#else
    let first_cloud = layer_radiance(world, eye, world.layers[0], 0u, kept_first(world, eye), pixel, ray);
#endif
#ifdef HAZE_OF_SPHERES
    var first = ordered_layer(world, back, back.first_haze, world.layers[0], first_cloud, ray);
#else
    var first = ordered_layer(world, back, world.layers[0], first_cloud, ray);
#endif
#if LAYERS >= 2
#ifdef SCREEN_SPACE
    let second_cloud = layer_radiance(world, eye, world.layers[1], 1u, pixel, ray);
#else
    let second_cloud = layer_radiance(world, eye, world.layers[1], 1u, kept_second(world, eye), pixel, ray);
#endif
#ifdef HAZE_OF_SPHERES
    var second = ordered_layer(world, back, back.second_haze, world.layers[1], second_cloud, ray);
#else
    var second = ordered_layer(world, back, world.layers[1], second_cloud, ray);
#endif
    var pair = nearer_first(first, second);
    first = pair.nearer;
    second = pair.farther;
#endif
#if LAYERS >= 3
#ifdef SCREEN_SPACE
    let third_cloud = layer_radiance(world, eye, world.layers[2], 2u, pixel, ray);
#else
    let third_cloud = layer_radiance(world, eye, world.layers[2], 2u, kept_third(world, eye), pixel, ray);
#endif
#ifdef HAZE_OF_SPHERES
    var third = ordered_layer(world, back, back.third_haze, world.layers[2], third_cloud, ray);
#else
    var third = ordered_layer(world, back, world.layers[2], third_cloud, ray);
#endif
    pair = nearer_first(second, third);
    third = pair.farther;
    pair = nearer_first(first, pair.nearer);
    first = pair.nearer;
    second = pair.farther;
#endif
#if LAYERS >= 4
#ifdef SCREEN_SPACE
    let fourth_cloud = layer_radiance(world, eye, world.layers[3], 3u, pixel, ray);
#else
    let fourth_cloud = layer_radiance(world, eye, world.layers[3], 3u, kept_fourth(world, eye), pixel, ray);
#endif
#ifdef HAZE_OF_SPHERES
    var fourth = ordered_layer(world, back, back.fourth_haze, world.layers[3], fourth_cloud, ray);
#else
    var fourth = ordered_layer(world, back, world.layers[3], fourth_cloud, ray);
#endif
    pair = nearer_first(third, fourth);
    fourth = pair.farther;
    pair = nearer_first(second, pair.nearer);
    third = pair.farther;
    pair = nearer_first(first, pair.nearer);
    first = pair.nearer;
    second = pair.farther;
    radiance = over(world, back, fourth, phase, radiance);
#ifdef CLOUDS_ALONE
    clouds_seen = layer_before(fourth.cloud, clouds_seen);
#endif
#endif
#if LAYERS >= 3
    radiance = over(world, back, third, phase, radiance);
#ifdef CLOUDS_ALONE
    clouds_seen = layer_before(third.cloud, clouds_seen);
#endif
#endif
#if LAYERS >= 2
    radiance = over(world, back, second, phase, radiance);
#ifdef CLOUDS_ALONE
    clouds_seen = layer_before(second.cloud, clouds_seen);
#endif
#endif
    radiance = over(world, back, first, phase, radiance);
#ifdef CLOUDS_ALONE
    clouds_seen = layer_before(first.cloud, clouds_seen);
#endif
#endif
    return radiance;
}

/// Each invocation shades two by two pixels. They share the reads of the uniforms, which a software driver makes lane by
/// lane behind any branch (that costs as much as shading a pixel), and on such a driver what is behind the clouds as well.
@compute @workgroup_size(16, 8, 1)
fn composite(@builtin(global_invocation_id) id: vec3u) {
    let world = scene;
    let eye = view;
    let first = id.xy * 2u + vec2u(0u, eye.first_row);
#ifdef SHARED_BACKGROUND
    let back = background(world, eye.position, eye.altitude_m, pixel_direction(eye, vec2f(first) + 1.0));
#endif
    for (var i = 0u; i < 4u; i += 1u) {
        let pixel = first + vec2u(i & 1u, i >> 1u);
        let shown = min(pixel, vec2u(eye.width, eye.height) - 1u);
#ifdef RAY_LIST
        let listed = rays[shown.y * eye.width + shown.x];
        let altitude = altitude_m(world.planet.radius_m, listed.origin);
        let own = background(world, listed.origin, altitude, listed.direction);
        let radiance = ray_radiance(world, eye, own, shown, pixel_ray(world, listed.origin, altitude, listed.direction));
#else
#ifdef SHARED_BACKGROUND
        let radiance = pixel_radiance(world, eye, back, shown);
#else
        let own = background(world, eye.position, eye.altitude_m, pixel_direction(eye, vec2f(shown) + 0.5));
        let radiance = pixel_radiance(world, eye, own, shown);
#endif
#endif
        let inside = pixel.x < eye.width && pixel.y < eye.height;
        let at = pixel.y * eye.picture_width + eye.first_column + pixel.x;
#ifdef LINEAR_OUTPUT
#ifdef CACHE_READS
        if inside { picture[at] = vec4f(radiance, f32(cache_reads)); }
        cache_reads = 0u;
#else
        if inside { picture[at] = vec4f(radiance, 1.0); }
#endif
#else
#ifdef CLOUDS_ALONE
        let words = packed_clouds(clouds_pixel(balanced(radiance), power_of_two_below(world.exposure), clouds_seen));
        if inside {
            picture[at * CLOUDS_WORDS] = words[0];
            picture[at * CLOUDS_WORDS + 1u] = words[1];
            picture[at * CLOUDS_WORDS + 2u] = words[2];
        }
#else
#ifdef SHOW_VALUES
        let bytes = pack4x8unorm(vec4f(colour_of_values(radiance), 1.0));
#else
        let bytes = dithered_bytes(encoded(balanced(radiance) * world.exposure), pixel >> vec2u(eye.dither_shift));
#endif
        if inside { picture[at] = bytes; }
#endif
#endif
    }
}
