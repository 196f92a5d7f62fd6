// Functions that read the scene or its cloud field, at given points, one thread per point: for comparison with their f64
// twins and for the probe command.
#import skycell::march::{scene, steps_at, distance_at_m, first_sample_at, sample_offset, sun_optical_depth, ray_scene, LayerRadiance}
#import skycell::scene::Layer
#import skycell::shell::{altitude_m, layer_intervals}
#import skycell::phase::{one_minus_mu, phase_per_sr, phase_over_disc_per_sr}
#import skycell::sky::{clear_sky, relative_air_mass, sun_disc_radiance}
#import skycell::shade::{background, background_radiance, pixel_ray, layer_over, sun_phase_per_sr}
#import skycell::tone::{balanced, filmic, agx_encoded, neutral}
#import skycell::accumulate::accumulated
#import skycell::temporal::{reprojected, window_weight, parallax_weight, packed, unpacked}
#import skycell::density::{coverage_from_map, type_from_map}
#ifdef DENSITY_WEATHER
#import skycell::density::{map_texel, dimensional_profile, vertical_profile, carved_density, smooth_density}
#else
#ifdef DENSITY_CIRRUS
#import skycell::density::{map_texel, sheet_density}
#else
#import skycell::density::{bounded_density, over_bounds}
#endif
#endif

/// Four vectors a point.
@group(2) @binding(0) var<storage, read> points: array<vec4f>;
/// Two vectors an answer.
@group(2) @binding(1) var<storage, read_write> values: array<vec4f>;
/// x: which function, see below; y: number of points; z: layer.
@group(3) @binding(0) var<uniform> question: vec4u;

@compute @workgroup_size(64, 1, 1)
fn probe_field(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= question.y { return; }
    let a = points[4u * id.x];
    let b = points[4u * id.x + 1u];
    let c = points[4u * id.x + 2u];
    let d = points[4u * id.x + 3u];
    let world = scene;
    let layer = world.layers[question.z];
    var value = vec4f(0.0);
    var more = vec4f(0.0);
    switch question.x {
        // layer_intervals(R = a.w, ground = b.w, base = c.x, top = c.y, origin = a.xyz, direction = b.xyz)
        case 0u: {
            let found = layer_intervals(a.w, b.w > 0.0, c.x, c.y, a.xyz, b.xyz);
            value = vec4f(found.first_start_m, found.first_end_m, found.second_start_m, found.second_end_m);
        }
        // Steps of a march: step_min = a.x, step_per_distance = a.y, distance = a.z, start fraction = a.w.
        case 1u: {
            var stepped = layer;
            stepped.step_min_m = a.x;
            stepped.step_per_distance = a.y;
            let steps = steps_at(stepped, a.z);
            let first = first_sample_at(stepped, a.z, a.w);
            value = vec4f(steps, distance_at_m(stepped, steps), first, distance_at_m(stepped, first));
        }
        // coverage_from_map(layer's = a.x, map's = a.y), type_from_map(layer's = a.z, spread = b.x, map's = a.w)
        case 2u: { value = vec4f(coverage_from_map(a.x, a.y), type_from_map(a.z, b.x, a.w), 0.0, 0.0); }
        // Density at a.xyz with the weight a.w of detail; smooth density, altitude and dimensional profile; then the map.
        case 3u: {
            let altitude = altitude_m(world.planet.radius_m, a.xyz);
            let thickness_m = layer.top_altitude_m - layer.base_altitude_m;
            let height_fraction = saturate((altitude - layer.base_altitude_m) / thickness_m);
#ifdef DENSITY_WEATHER
            let map = map_texel(layer, a.xz);
            let profile = dimensional_profile(layer, map, height_fraction);
            let density = carved_density(layer, a.xyz, altitude, height_fraction, profile, a.w);
            let smoothed = smooth_density(layer, a.xyz, altitude, height_fraction, profile);
            value = vec4f(density, smoothed, altitude, profile);
            more = vec4f(map, height_fraction);
#else
#ifdef DENSITY_CIRRUS
            let density = sheet_density(layer, a.xz);
            value = vec4f(density, density, altitude, density);
            more = vec4f(map_texel(layer, a.xz), height_fraction);
#else
            let density = bounded_density(layer, a.xyz, altitude);
            value = vec4f(density, density, altitude, 1.0);
            more = vec4f(0.0, 0.0, 0.0, height_fraction);
#endif
#endif
        }
        // Optical depth from a.xyz towards the sun.
        case 4u: {
            value.x = sun_optical_depth(ray_scene(question.z), layer, a.xyz);
        }
        // over_bounds(origin = a.xyz, direction = b.xyz)
        case 5u: {
#ifdef DENSITY_SHAPE
            let over = over_bounds(layer, a.xyz, b.xyz);
            value = vec4f(over, 0.0, 0.0);
#endif
        }
        // clear_sky(direction = a.xyz): radiance, transmittance
        case 6u: {
            let sky = clear_sky(world.planet, world.sky, world.sun, a.xyz, one_minus_mu(a.xyz, world.sun.direction));
            value = vec4f(sky.radiance, 0.0);
            more = vec4f(sky.transmittance, 0.0);
        }
        // relative_air_mass(R = a.x, H = a.y, mu = a.z); sun_disc_radiance at 1 - cos = a.w
        case 7u: {
            value.x = relative_air_mass(a.x, a.y, a.z);
            more = vec4f(sun_disc_radiance(world.sun, a.w), 0.0);
        }
        // The scene's phase at 1 - cos = a.x with eccentricity a.y; averaged over a disc of 1 - cos(radius) = a.z
        case 8u: {
            value = vec4f(phase_per_sr(world.light.phase, a.y, a.x), phase_over_disc_per_sr(world.light.phase, a.y, a.x, a.z), 0.0, 0.0);
        }
        // What lies behind all clouds from a.xyz towards b.xyz: radiance and whether it is ground; transmittance of the air
        case 9u: {
            let altitude = altitude_m(world.planet.radius_m, a.xyz);
            let back = background(world, a.xyz, altitude, b.xyz);
            let ray = pixel_ray(world, a.xyz, altitude, b.xyz);
            value = vec4f(background_radiance(world, back, ray), select(0.0, 1.0, ray.on_ground));
            more = vec4f(back.transmittance, 0.0);
        }
        // layer_over from a.xyz towards b.xyz: cloud = c and opacity distance = b.w, behind = d.xyz
        case 10u: {
            let altitude = altitude_m(world.planet.radius_m, a.xyz);
            let back = background(world, a.xyz, altitude, b.xyz);
            let ray = pixel_ray(world, a.xyz, altitude, b.xyz);
            let cloud = LayerRadiance(c.x, c.y, c.z, c.w, b.w);
            value = vec4f(layer_over(world, back, sun_phase_per_sr(world, layer.phase, ray), d.xyz, cloud, layer.air_extinction_per_m, layer.single_scattering_albedo), 0.0);
        }
        // The tone curves of a.xyz; b.x says which.
        case 11u: {
            let white = balanced(a.xyz);
            if b.x == 0.0 { value = vec4f(filmic(white), 0.0); }
            if b.x == 1.0 { value = vec4f(agx_encoded(white), 0.0); }
            if b.x == 2.0 { value = vec4f(neutral(white), 0.0); }
        }
        // What a texel that has taken b.w samples and holds d has after b.x more, which alternate between a + c and a - c,
        // with 1/n as the weight of the first b.y of all and b.z as that of all later ones. (Mesa's software driver ends
        // loops after 65 535 rounds.)
        case 12u: {
            var held = d;
            let last = u32(b.w) + u32(b.x);
            for (var n = u32(b.w); n < last; n += 1u) {
                let weight = select(b.z, 1.0 / f32(n + 1u), f32(n) < b.y);
                held = accumulated(held, select(a - c, a + c, n % 2u == 0u), weight);
            }
            value = held;
        }
        // The mean offset of the first b.x samples of the texel at a.xy.
        case 13u: {
            for (var n = 0u; n < u32(b.x); n += 1u) { value += vec4f(sample_offset(a.xy, n), 0.0, 0.0) / b.x; }
        }
        // reprojected(forward = a.xyz, across = b.xyz, upward = c.xyz, size = (a.w, b.w), point from the eye = d.xyz)
        case 30u: { value = vec4f(reprojected(a.xyz, b.xyz, c.xyz, vec2f(a.w, b.w), d.xyz), 0.0); }
        // Weights of a sample at a.xy with sharpness a.z and of a move by a.w seen from b.x; c and d.x kept and taken out.
        case 31u: {
            let kept = unpacked(packed(LayerRadiance(c.x, c.y, c.z, c.w, d.x)));
            value = vec4f(window_weight(a.xy, a.z), parallax_weight(a.w, b.x), kept.opacity_distance_m, 0.0);
            more = vec4f(kept.single, kept.octaves, kept.ambient, kept.transmittance);
        }
        default: {}
    }
    values[2u * id.x] = value;
    values[2u * id.x + 1u] = more;
}
