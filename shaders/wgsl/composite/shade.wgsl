#define_import_path skycell::shade
#import skycell::shell::shell_roots
#import skycell::sky::{clear_sky, sun_disc_radiance}
#import skycell::phase::{one_minus_mu, phase_over_disc_per_sr}
#import skycell::march::{LayerRadiance, distance_seen_m}
#import skycell::scene::{Scene, Sun, Layer, Phase}
#ifdef MOON
#import skycell::night::moon_disc_radiance
#endif
#ifdef PHYSICAL_SKY
#import skycell::physical::{AirView, Haze, air_view, haze_until}
#import skycell::air::mu_horizon
#import skycell::transport::one_minus_exp_over
#ifdef LIGHT_SHAFTS
#import skycell::physical::shaded_view
#endif
#endif

/// What lies behind all clouds around a direction. Air and ground change so little over two pixels that four share one;
/// what does not is in Ray.
struct Background {
    /// Radiance of clear air towards the direction: the sky, and what haze fades to.
    air: vec3f,
    /// Of the whole column of air.
    transmittance: vec3f,
    /// 1 / (1 - transmittance): how much of `air` a part of the column has.
    air_share: vec3f,
    /// Radiance of the ground as it is seen through the air.
    ground: vec3f,
#ifdef PHYSICAL_SKY
    view: AirView,
#ifdef HAZE_OF_SPHERES
    /// Air in front of each layer's proxy sphere.
#if LAYERS >= 1
    first_haze: Haze,
#endif
#if LAYERS >= 2
    second_haze: Haze,
#endif
#if LAYERS >= 3
    third_haze: Haze,
#endif
#if LAYERS >= 4
    fourth_haze: Haze,
#endif
#endif
#endif
}

/// What differs from pixel to pixel.
struct Ray {
    direction: vec3f,
    /// 1 - cos of the angle to the sun.
    angle: f32,
    /// The ray ends on the ground.
    on_ground: bool,
    /// Altitude of its origin, m.
    origin_altitude_m: f32,
    /// Cosine of its angle from the zenith there.
    mu: f32,
}

/// Whether the ground hides a layer from a ray: where the ray ends on the ground below the layer.
fn hidden_by_ground(ray: Ray, base_altitude_m: f32) -> bool {
    return ray.on_ground && ray.origin_altitude_m < base_altitude_m;
}

#ifdef HAZE_OF_SPHERES
/// Air in front of a layer's proxy sphere; nearer and farther clouds have that of its mean extinction and source.
fn haze_of_sphere(world: Scene, view: AirView, layer: Layer, position: vec3f, altitude_m: f32, direction: vec3f) -> Haze {
    let sphere = shell_roots(world.planet.radius_m, layer.proxy_altitude_m, position, altitude_m, direction);
    return haze_until(view, select(sphere.far_m, sphere.near_m, sphere.near_m > 0.0));
}
#endif

/// Towards a direction from a position; altitude_m must be that of the position.
fn background(world: Scene, position: vec3f, altitude_m: f32, direction: vec3f) -> Background {
    var result: Background;
#ifdef PHYSICAL_SKY
    // The tables know sky and ground apart; around the horizon the middle of the pixels decides for all of them.
    let ray = pixel_ray(world, position, altitude_m, direction);
    let radius_m = world.planet.radius_m;
    let from_centre_m = radius_m + altitude_m;
    let mu = clamp((dot(direction, position) + radius_m * direction.y) / from_centre_m, -1.0, 1.0);
    let mu_sun = clamp((dot(world.sun.direction, position) + radius_m * world.sun.direction.y) / from_centre_m, -1.0, 1.0);
    result.view = air_view(radius_m, altitude_m, mu, mu_sun, ray.angle, ray.on_ground);
#ifdef LIGHT_SHAFTS
    result.view = shaded_view(result.view, direction);
#endif
    result.air = world.sun.irradiance * result.view.radiance_per_sr + world.sky.environment_radiance;
    result.transmittance = result.view.transmittance;
#ifdef HAZE_OF_SPHERES
#if LAYERS >= 1
    result.first_haze = haze_of_sphere(world, result.view, world.layers[0], position, altitude_m, direction);
#endif
#if LAYERS >= 2
    result.second_haze = haze_of_sphere(world, result.view, world.layers[1], position, altitude_m, direction);
#endif
#if LAYERS >= 3
    result.third_haze = haze_of_sphere(world, result.view, world.layers[2], position, altitude_m, direction);
#endif
#if LAYERS >= 4
    result.fourth_haze = haze_of_sphere(world, result.view, world.layers[3], position, altitude_m, direction);
#endif
#endif
    return result;
#else
    let sky = clear_sky(world.planet, world.sky, world.sun, direction, one_minus_mu(direction, world.sun.direction));
    result.air = sky.radiance;
    result.transmittance = sky.transmittance;
    result.air_share = 1.0 / max(vec3f(1.0) - sky.transmittance, vec3f(1e-6));
    // Light from the ground is dimmed over the way, and the air adds its own: the share of the whole column's that lies
    // in front. At the horizon both agree with the sky behind. A direction just above it has the distance of the point
    // where it comes closest.
    let ground = shell_roots(world.planet.radius_m, 0.0, position, altitude_m, direction);
    let kept = exp(-max(ground.near_m, 0.0) * world.sky.ground_air_extinction_per_m);
    result.ground = world.sky.ground_radiance * kept + result.air * saturate((vec3f(1.0) - kept) * result.air_share);
    return result;
#endif
}

/// A pixel's ray. It meets the ground where t² + 2 b t + c = 0 has a root in front (see shell_roots): b < 0 and b² >= c.
fn pixel_ray(world: Scene, position: vec3f, altitude_m: f32, direction: vec3f) -> Ray {
    let b = dot(direction, position) + world.planet.radius_m * direction.y;
    let c = altitude_m * (altitude_m + 2.0 * world.planet.radius_m);
    return Ray(direction, one_minus_mu(direction, world.sun.direction), b < 0.0 && b * b >= c && world.planet.has_ground > 0.0, altitude_m, b / (world.planet.radius_m + altitude_m));
}

/// What a ray sees where no cloud is: sky and sun, or the ground.
fn background_radiance(world: Scene, back: Background, ray: Ray) -> vec3f {
#ifdef MOON
    let disc = (world.night.sun_disc * sun_disc_radiance(world.sun, ray.angle) + moon_disc_radiance(world.night, ray.direction)) * back.transmittance;
#else
    let disc = sun_disc_radiance(world.sun, ray.angle) * back.transmittance;
#endif
#ifdef PHYSICAL_SKY
    return back.air + select(disc, vec3f(0.0), ray.on_ground);
#else
    return select(back.air + disc, back.ground, ray.on_ground);
#endif
}

/// A layer's phase of single scattering towards the viewer, 1/sr.
fn sun_phase_per_sr(world: Scene, phase: Phase, ray: Ray) -> f32 {
    return phase_over_disc_per_sr(phase, 1.0, ray.angle, world.sun.one_minus_mu_disc);
}

/// Light of sky and ground that a cloud of an albedo scatters. An even light from all around would be scattered by all of
/// the opacity: what is not the sky's is the ground's.
fn around_radiance(world: Scene, cloud: LayerRadiance, albedo: f32) -> vec3f {
    let from_below = max(albedo * world.light.ambient * (1.0 - cloud.transmittance) - cloud.ambient, 0.0);
    return world.sky.mean_radiance * cloud.ambient + world.sky.ground_radiance * from_below;
}

#ifdef PHYSICAL_SKY
/// Air in front of a cloud at about a distance.
fn haze_of_layer(back: Background, distance_m: f32) -> Haze {
    return haze_until(back.view, distance_m);
}

/// How much of what a constituent has over a layer lies below a share of the layer's height. folds: the layer's thickness
/// over the height in which the constituent falls to 1/e.
fn share_below(folds: f32, share: f32) -> f32 {
    return share * one_minus_exp_over(folds * share) / one_minus_exp_over(folds);
}

/// Spectral irradiance of the sun at an altitude in or about a layer, on a surface that faces it. What air and aerosol have
/// above an altitude falls exponentially, and so does the optical depth to the sun: two exponentials through its values at
/// base, middle and top. The share of the disc above the horizon is a smooth step over its diameter.
fn sun_at_altitude(planet_radius_m: f32, sun: Sun, layer: Layer, altitude_m: f32) -> vec3f {
    let share = saturate((altitude_m - layer.base_altitude_m) / max(layer.top_altitude_m - layer.base_altitude_m, 1e-3));
    let air = share_below(layer.air_folds, share);
    let aerosol = share_below(layer.aerosol_folds, share);
    let depth = max(layer.sun_depth_at_base + air * layer.sun_depth_rise + (aerosol - air) * layer.sun_depth_bend, vec3f(0.0));
    let height_m = layer.base_altitude_m + share * (layer.top_altitude_m - layer.base_altitude_m);
    let above = (sun.direction.y - mu_horizon(planet_radius_m, height_m)) * (1.0 + height_m / planet_radius_m);
    let visible = smoothstep(-1.0, 1.0, above / sun.angular_radius_rad);
    return sun.irradiance * visible * exp(-depth);
}

/// Spectral irradiance of the sun where a ray sees a cloud, by the altitude of what it sees there.
fn sun_on_cloud(world: Scene, layer: Layer, cloud: LayerRadiance, ray: Ray) -> vec3f {
    let distance_m = distance_seen_m(cloud.opacity_distance_m, cloud.transmittance);
    // Altitude at a distance, to first order in distance over radius.
    let bend = 0.5 * (1.0 - ray.mu * ray.mu) * distance_m / (world.planet.radius_m + ray.origin_altitude_m);
    let altitude = ray.origin_altitude_m + distance_m * (ray.mu + bend);
    return sun_at_altitude(world.planet.radius_m, world.sun, layer, altitude);
}

/// As layer_over, with haze from the tables and the sun's light where the cloud is seen.
fn layer_in_air_over(world: Scene, haze: Haze, sun_irradiance: vec3f, sun_phase_per_sr: f32, behind: vec3f, cloud: LayerRadiance, albedo: f32) -> vec3f {
    let opacity = 1.0 - cloud.transmittance;
    let sunlit = sun_irradiance * (sun_phase_per_sr * cloud.single + cloud.octaves);
    let lit = sunlit + around_radiance(world, cloud, albedo);
    let through_m = max(distance_seen_m(cloud.opacity_distance_m, cloud.transmittance) - haze.start_m, 0.0);
    let kept = exp(-through_m * haze.extinction_per_m);
    let added = world.sun.irradiance * haze.source_per_sr * (vec3f(1.0) - kept);
    return lit * kept + added * opacity + behind * cloud.transmittance;
}
#endif

/// One layer over what lies behind it. Clouds are stored premultiplied by their opacity: the haze in front of them is
/// weighted by the same opacity, so edges are dimmed once only. air_extinction_per_m: mean along the way to the layer;
/// albedo: the layer's.
fn layer_over(world: Scene, back: Background, sun_phase_per_sr: f32, behind: vec3f, cloud: LayerRadiance, air_extinction_per_m: vec3f, albedo: f32) -> vec3f {
    let opacity = 1.0 - cloud.transmittance;
    let sunlit = world.sun.irradiance_at_clouds * (sun_phase_per_sr * cloud.single + cloud.octaves);
    let lit = sunlit + around_radiance(world, cloud, albedo);
    let kept = exp(-distance_seen_m(cloud.opacity_distance_m, cloud.transmittance) * air_extinction_per_m);
    let share = saturate((vec3f(1.0) - kept) * back.air_share);
    return lit * kept + back.air * share * opacity + behind * cloud.transmittance;
}
