#define_import_path skycell::proxy
#import skycell::scene::Proxy
#import skycell::shell::{ShellRoots, altitude_m, shell_roots}

/// Distance along a ray to the surface on which a proxy's results lie, m; `sphere` are the ray's roots of the proxy's sphere.
///
/// From below that is the sphere. From above it is as much of the sphere as the anchor sees, and beyond its rim, where rays
/// from the anchor pass over the sphere, the points at which they come closest to it. Those lie on the sphere that has the way
/// from the anchor to the planet's centre for a diameter (Thales), so rays from elsewhere find the same surface: each of its
/// points has one direction from the anchor.
fn proxy_distance_m(planet_radius_m: f32, proxy: Proxy, origin: vec3f, sphere: ShellRoots, direction: vec3f) -> f32 {
    let on_sphere = origin + direction * sphere.near_m;
    let up = vec3f(on_sphere.x, on_sphere.y + planet_radius_m, on_sphere.z);
    let is_seen = sphere.hit && sphere.near_m > 0.0 && dot(proxy.anchor - on_sphere, up) >= 0.0;
    // t² + 2 b t + c = 0 of the points from which anchor and centre are seen at a right angle.
    let from_anchor = origin - proxy.anchor;
    let from_centre = vec3f(origin.x, origin.y + planet_radius_m, origin.z);
    let b = 0.5 * (dot(direction, from_anchor) + dot(direction, from_centre));
    let c = dot(from_anchor, from_centre);
    let beyond_m = max(sqrt(max(b * b - c, 0.0)) - b, proxy.least_m);
    let from_above_m = select(beyond_m, sphere.near_m, is_seen);
    return select(max(sphere.far_m, 1e-3), from_above_m, proxy.from_above > 0u);
}

/// The same with the roots of the sphere found here.
fn distance_to_proxy_m(planet_radius_m: f32, proxy: Proxy, origin: vec3f, direction: vec3f) -> f32 {
    let altitude = altitude_m(planet_radius_m, origin);
    let sphere = shell_roots(planet_radius_m, proxy.altitude_m, origin, altitude, direction);
    return proxy_distance_m(planet_radius_m, proxy, origin, sphere, direction);
}
