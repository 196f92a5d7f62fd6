#define_import_path skycell::shade
#import skycell::shell::{altitude_m, shell_roots}
#import skycell::sky::{clear_sky, sun_disc_radiance}
#import skycell::phase::{one_minus_mu, phase_over_disc_per_sr}
#import skycell::march::{scene, LayerRadiance}

/// What lies behind all clouds: sky and sun, or the ground.
struct Background {
    radiance: vec3f,
    /// Radiance of clear air towards the direction: what haze fades to.
    air: vec3f,
    /// 1 / (1 - transmittance of the whole column): how much of `air` a part of the column has.
    air_share: vec3f,
    /// The phase of single scattering towards the viewer, 1/sr.
    sun_phase_per_sr: f32,
    /// The ray ends on the ground.
    on_ground: bool,
}

/// altitude_m must be that of the position.
fn background(position: vec3f, altitude_m: f32, direction: vec3f) -> Background {
    var result: Background;
    let angle = one_minus_mu(direction, scene.sun.direction);
    result.sun_phase_per_sr = phase_over_disc_per_sr(scene.light, 1.0, angle, scene.sun.one_minus_mu_disc);
    let sky = clear_sky(scene.planet, scene.sky, scene.sun, direction, angle);
    result.air = sky.radiance;
    result.air_share = 1.0 / max(vec3f(1.0) - sky.transmittance, vec3f(1e-6));
    let ground = shell_roots(scene.planet.radius_m, 0.0, position, altitude_m, direction);
    result.on_ground = ground.hit && ground.near_m > 0.0;
    // Light from the ground is dimmed over the way, and the air adds its own: the share of the whole column's that lies
    // in front. At the horizon both agree with the sky behind.
    let kept = exp(-max(ground.near_m, 0.0) * scene.sky.ground_air_extinction_per_m);
    let ground_seen = scene.sky.ground_radiance * kept + result.air * saturate((vec3f(1.0) - kept) * result.air_share);
    let sky_seen = sky.radiance + sun_disc_radiance(scene.sun, angle) * sky.transmittance;
    result.radiance = select(sky_seen, ground_seen, result.on_ground);
    return result;
}

/// One layer over what lies behind it. Clouds are stored premultiplied by their opacity: the haze in front of them is
/// weighted by the same opacity, so edges are dimmed once only. air_extinction_per_m: mean along the way to the layer.
fn layer_over(back: Background, behind: vec3f, cloud: LayerRadiance, air_extinction_per_m: vec3f) -> vec3f {
    let opacity = 1.0 - cloud.transmittance;
    let sunlit = scene.sun.irradiance_at_clouds * (back.sun_phase_per_sr * cloud.single + cloud.octaves);
    let lit = sunlit + scene.sky.mean_radiance * cloud.ambient;
    let kept = exp(-cloud.distance_m * air_extinction_per_m);
    let share = saturate((vec3f(1.0) - kept) * back.air_share);
    return lit * kept + back.air * share * opacity + behind * cloud.transmittance;
}
