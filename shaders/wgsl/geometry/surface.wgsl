#define_import_path skycell::surface
#import skycell::scene::Proxy
#import skycell::shell::{ShellRoots, shell_roots}

// The surface on which a proxy's texels lie: a shell at an altitude about the planet, or a dome, which is a sphere about the
// proxy's anchor. Whoever asks stands inside it, or above a shell that is seen from above. Of a layer that rays start in, the
// far part is kept on a dome, whatever others are kept on.

/// How far along a unit direction a sphere about the origin of coordinates is, m. Roots of t² + 2 b t + c = 0 with b = d·p and
/// c = (|p| - r)(|p| + r), which is negative inside: of q and c / q the one in front. From outside a ray that misses the
/// sphere gets the place that is nearest to it.
fn dome_distance_m(radius_m: f32, position: vec3f, direction: vec3f) -> f32 {
    let b = dot(direction, position);
    let from_centre_m = length(position);
    let c = (from_centre_m - radius_m) * (from_centre_m + radius_m);
    let root = sqrt(max(b * b - c, 0.0));
    // Both signs add what has one sign: nothing cancels. b + root is 0 only on the sphere with the direction outwards and tangent.
    return select(root - b, -c / max(b + root, 1e-30), b > 0.0);
}

/// How far along a unit direction the surface of a proxy is that is seen from above, m; `sphere` are the ray's roots of its
/// shell.
///
/// It is as much of the shell as the anchor sees, and beyond its rim, where rays from the anchor pass over the shell, the points
/// at which they come closest to it. Those lie on the sphere that has the way from the anchor to the planet's centre for a
/// diameter (Thales), so rays from elsewhere find the same surface: each of its points has one direction from the anchor.
fn distance_from_above_m(planet_radius_m: f32, proxy: Proxy, origin: vec3f, sphere: ShellRoots, direction: vec3f) -> f32 {
    let on_sphere = origin + direction * sphere.near_m;
    let up = vec3f(on_sphere.x, on_sphere.y + planet_radius_m, on_sphere.z);
    let is_seen = sphere.hit && sphere.near_m > 0.0 && dot(proxy.anchor - on_sphere, up) >= 0.0;
    // t² + 2 b t + c = 0 of the points from which anchor and centre are seen at a right angle.
    let from_anchor = origin - proxy.anchor;
    let from_centre = vec3f(origin.x, origin.y + planet_radius_m, origin.z);
    let b = 0.5 * (dot(direction, from_anchor) + dot(direction, from_centre));
    let c = dot(from_anchor, from_centre);
    let beyond_m = max(sqrt(max(b * b - c, 0.0)) - b, proxy.least_m);
    return select(beyond_m, sphere.near_m, is_seen);
}

/// How far along a unit direction a proxy's surface is from a place inside or above it, m. origin_altitude_m must be
/// altitude_m(origin).
fn surface_distance_m(planet_radius_m: f32, proxy: Proxy, origin: vec3f, origin_altitude_m: f32, direction: vec3f) -> f32 {
#ifdef DOMES
    return max(dome_distance_m(proxy.radius_m, origin - proxy.anchor, direction), 1e-3);
#else
    let sphere = shell_roots(planet_radius_m, proxy.altitude_m, origin, origin_altitude_m, direction);
#ifdef ABOVE
    let from_above_m = distance_from_above_m(planet_radius_m, proxy, origin, sphere, direction);
    let on_shell_m = select(max(sphere.far_m, 1e-3), from_above_m, proxy.from_above > 0u);
#else
    let on_shell_m = max(sphere.far_m, 1e-3);
#endif
#ifdef INSIDE
    let on_dome_m = max(dome_distance_m(proxy.radius_m, origin - proxy.anchor, direction), 1e-3);
    return select(on_shell_m, on_dome_m, proxy.radius_m > 0.0);
#else
    return on_shell_m;
#endif
#endif
}

/// The point of a proxy's surface along a ray from a place inside it.
fn surface_point(planet_radius_m: f32, proxy: Proxy, origin: vec3f, origin_altitude_m: f32, direction: vec3f) -> vec3f {
    return origin + direction * surface_distance_m(planet_radius_m, proxy, origin, origin_altitude_m, direction);
}
