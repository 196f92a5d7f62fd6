#define_import_path skycell::shade
#import skycell::scene::{Scene, Layer}
#import skycell::shell::{altitude_m, shell_roots}
#import skycell::sky::{sky_radiance, sun_disc_radiance, column_optical_depth, path_optical_depth}
#import skycell::phase::{one_minus_mu, phase_over_disc_per_sr}
#import skycell::march::{scene, LayerRadiance}

/// What lies behind all clouds: sky and sun, or the ground.
struct Background {
    radiance: vec3f,
    /// Radiance of clear air towards the direction: what haze fades to.
    air: vec3f,
    /// Optical depth of the whole column along the direction.
    column: vec3f,
    /// The same light as a cloud scatters it towards the viewer, per unit of single scattering, 1/sr.
    sun_phase_per_sr: f32,
}

fn background(position: vec3f, direction: vec3f) -> Background {
    var result: Background;
    let angle = one_minus_mu(direction, scene.sun.direction);
    result.sun_phase_per_sr = phase_over_disc_per_sr(scene.light, 1.0, angle, scene.sun.one_minus_mu_disc);
    result.air = sky_radiance(scene.planet, scene.sky, scene.sun, direction);
    result.column = column_optical_depth(scene.planet, scene.sky, direction.y);
    let altitude = altitude_m(scene.planet.radius_m, position);
    let ground = shell_roots(scene.planet.radius_m, 0.0, position, altitude, direction);
    let on_ground = ground.hit && ground.near_m > 0.0;
    let ground_depth = path_optical_depth(scene.sky, max(ground.near_m, 0.0), 0.0);
    let ground_seen = through_air(result.air, result.column, ground_depth, scene.sky.ground_radiance);
    let sky_seen = result.air + sun_disc_radiance(scene.sun, direction) * exp(-result.column);
    result.radiance = select(sky_seen, ground_seen, on_ground);
    return result;
}

/// Light from something in the air: dimmed over the way, and the air's own light added as the share of the whole column
/// that lies in front of it. At the horizon both agree with the sky behind.
fn through_air(air: vec3f, column: vec3f, path: vec3f, radiance: vec3f) -> vec3f {
    let kept = exp(-path);
    let share = saturate((vec3f(1.0) - kept) / max(vec3f(1.0) - exp(-column), vec3f(1e-6)));
    return radiance * kept + air * share;
}

/// One layer over what lies behind it. Clouds are stored premultiplied by their opacity: the haze in front of them is
/// weighted by the same opacity, so edges are dimmed once only.
fn layer_over(back: Background, behind: vec3f, cloud: LayerRadiance, altitude_m: f32) -> vec3f {
    let opacity = 1.0 - cloud.transmittance;
    let sunlit = scene.sun.irradiance_at_clouds * (back.sun_phase_per_sr * cloud.single + cloud.octaves);
    let lit = sunlit + scene.sky.mean_radiance * cloud.ambient;
    let path = path_optical_depth(scene.sky, cloud.distance_m, altitude_m);
    let kept = exp(-path);
    let share = saturate((vec3f(1.0) - kept) / max(vec3f(1.0) - exp(-back.column), vec3f(1e-6)));
    return lit * kept + back.air * share * opacity + behind * cloud.transmittance;
}
