#define_import_path skycell::sun_column

// Columns of the sun volume: straight lines along the sun's direction, named by where they meet the layer's base.

/// Distance along a direction that rises from a point to an altitude, m; negative where the altitude lies below. The upper
/// root of the shell's quadratic (see skycell::shell), without cancellation: b > 0 wherever the direction rises.
fn rise_m(planet_radius_m: f32, position: vec3f, position_altitude_m: f32, direction: vec3f, target_altitude_m: f32) -> f32 {
    let b = dot(direction, position) + planet_radius_m * direction.y;
    let c = (position_altitude_m - target_altitude_m) * (position_altitude_m + target_altitude_m + 2.0 * planet_radius_m);
    return -c / (b + sqrt(max(b * b - c, 0.0)));
}

/// The point of the frame at an altitude over x and z: (y + R)² + x² + z² = (R + h)², so
/// y = (h (2R + h) - x² - z²) / (√((R + h)² - x² - z²) + R).
fn foot_m(planet_radius_m: f32, altitude_m: f32, xz: vec2f) -> vec3f {
    let across = dot(xz, xz);
    let from_centre = planet_radius_m + altitude_m;
    let root = sqrt(max(from_centre * from_centre - across, 0.0));
    let y = (altitude_m * (2.0 * planet_radius_m + altitude_m) - across) / (root + planet_radius_m);
    return vec3f(xz.x, y, xz.y);
}

/// Altitude of a slice: the lowest stands on the layer's base, the highest on its top.
fn slice_altitude_m(base_altitude_m: f32, top_altitude_m: f32, slice: u32, slices: u32) -> f32 {
    return mix(base_altitude_m, top_altitude_m, f32(slice) / f32(slices - 1u));
}
