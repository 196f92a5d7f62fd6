#define_import_path skycell::shade
#import skycell::shell::shell_roots
#import skycell::sky::{clear_sky, sun_disc_radiance}
#import skycell::phase::{one_minus_mu, phase_over_disc_per_sr}
#import skycell::march::{LayerRadiance, distance_seen_m}
#import skycell::scene::{Scene, Phase}

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
}

/// Whether the ground hides a layer from a ray: where the ray ends on the ground below the layer.
fn hidden_by_ground(ray: Ray, base_altitude_m: f32) -> bool {
    return ray.on_ground && ray.origin_altitude_m < base_altitude_m;
}

/// Towards a direction from a position; altitude_m must be that of the position.
fn background(world: Scene, position: vec3f, altitude_m: f32, direction: vec3f) -> Background {
    var result: Background;
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
}

/// A pixel's ray. It meets the ground where t² + 2 b t + c = 0 has a root in front (see shell_roots): b < 0 and b² >= c.
fn pixel_ray(world: Scene, position: vec3f, altitude_m: f32, direction: vec3f) -> Ray {
    let b = dot(direction, position) + world.planet.radius_m * direction.y;
    let c = altitude_m * (altitude_m + 2.0 * world.planet.radius_m);
    return Ray(direction, one_minus_mu(direction, world.sun.direction), b < 0.0 && b * b >= c && world.planet.has_ground > 0.0, altitude_m);
}

/// What a ray sees where no cloud is: sky and sun, or the ground.
fn background_radiance(world: Scene, back: Background, ray: Ray) -> vec3f {
    let sky = back.air + sun_disc_radiance(world.sun, ray.angle) * back.transmittance;
    return select(sky, back.ground, ray.on_ground);
}

/// A layer's phase of single scattering towards the viewer, 1/sr.
fn sun_phase_per_sr(world: Scene, phase: Phase, ray: Ray) -> f32 {
    return phase_over_disc_per_sr(phase, 1.0, ray.angle, world.sun.one_minus_mu_disc);
}

/// One layer over what lies behind it. Clouds are stored premultiplied by their opacity: the haze in front of them is
/// weighted by the same opacity, so edges are dimmed once only. air_extinction_per_m: mean along the way to the layer.
fn layer_over(world: Scene, back: Background, sun_phase_per_sr: f32, behind: vec3f, cloud: LayerRadiance, air_extinction_per_m: vec3f) -> vec3f {
    let opacity = 1.0 - cloud.transmittance;
    let sunlit = world.sun.irradiance_at_clouds * (sun_phase_per_sr * cloud.single + cloud.octaves);
    let lit = sunlit + world.sky.mean_radiance * cloud.ambient;
    let kept = exp(-distance_seen_m(cloud.opacity_distance_m, cloud.transmittance) * air_extinction_per_m);
    let share = saturate((vec3f(1.0) - kept) * back.air_share);
    return lit * kept + back.air * share * opacity + behind * cloud.transmittance;
}
