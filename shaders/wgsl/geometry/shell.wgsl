#define_import_path skycell::shell

/// Altitude above the ground sphere of a point of the cell's frame, m.
/// h = (|p|² + 2 R p_y) / (|p + R ŷ| + R): the difference |p + R ŷ| - R without its cancellation. The denominator is at
/// least R > 0 for every point that is not at the planet's far side.
fn altitude_m(planet_radius_m: f32, position: vec3f) -> f32 {
    let numerator = dot(position, position) + 2.0 * planet_radius_m * position.y;
    let from_centre = vec3f(position.x, position.y + planet_radius_m, position.z);
    return numerator / (length(from_centre) + planet_radius_m);
}

/// Where a ray's line meets a shell: distances along the unit direction, near <= far. `hit` is false when it misses.
struct ShellRoots {
    hit: bool,
    near_m: f32,
    far_m: f32,
}

/// Roots of t² + 2 b t + c = 0 with b = d·(p + R ŷ) and c = (h - H)(h + H + 2R), the form that never subtracts squares of
/// radii; the roots are q and c / q with q = -(b + sign(b) sqrt(b² - c)) (Press et al., Numerical Recipes, 5.6).
/// origin_altitude_m must be altitude_m(origin).
fn shell_roots(planet_radius_m: f32, shell_altitude_m: f32, origin: vec3f, origin_altitude_m: f32, direction: vec3f) -> ShellRoots {
    let b = dot(direction, origin) + planet_radius_m * direction.y;
    let c = (origin_altitude_m - shell_altitude_m) * (origin_altitude_m + shell_altitude_m + 2.0 * planet_radius_m);
    let discriminant = b * b - c;
    var roots: ShellRoots;
    roots.hit = discriminant >= 0.0;
    let root = sqrt(max(discriminant, 0.0));
    // q = 0 only where b = c = 0: the origin on the shell and the direction tangent; both roots are then 0.
    let q = select(-(b + root), root - b, b < 0.0);
    let other = select(0.0, c / q, q != 0.0);
    roots.near_m = min(q, other);
    roots.far_m = max(q, other);
    return roots;
}

/// The parts of a ray inside a layer: at most two, since a shell's inside is not convex. Empty where end <= start.
struct LayerIntervals {
    first_start_m: f32,
    first_end_m: f32,
    second_start_m: f32,
    second_end_m: f32,
}

/// Intervals of the ray between two altitudes, in front of its origin and, where there is one, in front of the ground.
fn layer_intervals(planet_radius_m: f32, has_ground: bool, base_altitude_m: f32, top_altitude_m: f32, origin: vec3f, direction: vec3f) -> LayerIntervals {
    let altitude = altitude_m(planet_radius_m, origin);
    let ground = shell_roots(planet_radius_m, 0.0, origin, altitude, direction);
    let base = shell_roots(planet_radius_m, base_altitude_m, origin, altitude, direction);
    let top = shell_roots(planet_radius_m, top_altitude_m, origin, altitude, direction);
    var intervals = LayerIntervals(0.0, 0.0, 0.0, 0.0);
    let start_m = max(top.near_m, 0.0);
    // A line that misses the ground, or meets it behind the origin, is not cut. Where the middle of the chord lies decides,
    // as it does for pixels: on the ground itself the near root is 0 or, by rounding, a little less.
    let ground_cuts = has_ground && ground.hit && ground.near_m + ground.far_m > 0.0;
    let end_m = select(top.far_m, min(top.far_m, max(ground.near_m, 0.0)), ground_cuts);
    let some = top.hit && end_m > start_m;
    intervals.first_start_m = start_m;
    intervals.first_end_m = select(start_m, select(end_m, clamp(base.near_m, start_m, end_m), base.hit), some);
    intervals.second_start_m = max(base.far_m, start_m);
    intervals.second_end_m = select(intervals.second_start_m, end_m, some && base.hit);
    return intervals;
}
