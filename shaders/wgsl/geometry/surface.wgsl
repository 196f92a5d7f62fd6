#define_import_path skycell::surface
#import skycell::scene::Proxy
#import skycell::shell::shell_roots

// The surface on which a proxy's texels lie: a shell at an altitude about the planet, or a dome, which is a sphere about the
// proxy's anchor. Whoever asks stands inside it.

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

/// How far along a unit direction a proxy's surface is from a place inside it, m. origin_altitude_m must be
/// altitude_m(origin).
fn surface_distance_m(planet_radius_m: f32, proxy: Proxy, origin: vec3f, origin_altitude_m: f32, direction: vec3f) -> f32 {
#ifdef DOMES
    return max(dome_distance_m(proxy.radius_m, origin - proxy.anchor, direction), 1e-3);
#else
    return max(shell_roots(planet_radius_m, proxy.altitude_m, origin, origin_altitude_m, direction).far_m, 1e-3);
#endif
}

/// The point of a proxy's surface along a ray from a place inside it.
fn surface_point(planet_radius_m: f32, proxy: Proxy, origin: vec3f, origin_altitude_m: f32, direction: vec3f) -> vec3f {
    return origin + direction * surface_distance_m(planet_radius_m, proxy, origin, origin_altitude_m, direction);
}
