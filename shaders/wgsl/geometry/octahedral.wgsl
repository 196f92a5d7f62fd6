#define_import_path skycell::octahedral

// Equal-area octahedral map between unit directions and the square [0,1]², pole (+y) at its centre: every texel has the
// solid angle 4π / N². P. Clarberg, "Fast Equal-Area Mapping of the (Hemi)Sphere using SIMD", 2008.

const FRAC_PI_FOUR: f32 = 0.7853981633974483;
const TWO_OVER_PI: f32 = 0.6366197723675814;

fn sign_not_zero(value: vec2f) -> vec2f {
    return select(vec2f(-1.0), vec2f(1.0), value >= vec2f(0.0));
}

/// Angle from the x axis of a vector in the first quadrant, as a share of it: 0 on x, 1 on y, 0 for the null vector.
/// The arctangent is Abramowitz & Stegun 4.4.49, |error| <= 2e-8: the built-in one may be wrong by 4096 units (Vulkan),
/// and is by 3e-6 on Mesa's software driver.
fn quadrant_share(vector: vec2f) -> f32 {
    let high = max(vector.x, vector.y);
    let slope = select(min(vector.x, vector.y) / high, 0.0, high == 0.0);
    let s = slope * slope;
    let far = ((((0.0028662257 * s - 0.0161657367) * s + 0.0429096138) * s - 0.0752896400) * s + 0.1065626393) * s;
    let share = slope * ((((far - 0.1420889944) * s + 0.1999355085) * s - 0.3333314528) * s + 1.0) * TWO_OVER_PI;
    return select(share, 1.0 - share, vector.y > vector.x);
}

/// Square coordinates of a direction of any length but zero.
fn octahedral_from_direction(direction: vec3f) -> vec2f {
    let across = abs(direction.xz);
    // 1 - |y|/l = (x² + z²) / (l (l + |y|)) keeps its digits near the poles.
    let length = sqrt(dot(direction, direction));
    let radius = sqrt(dot(across, across) / (length * (length + abs(direction.y))));
    let v = quadrant_share(across) * radius;
    let upper = vec2f(radius - v, v);
    let folded = select(upper, vec2f(1.0) - upper.yx, direction.y < 0.0);
    return 0.5 + 0.5 * folded * sign_not_zero(direction.xz);
}

/// Unit direction of square coordinates. Coordinates a little outside [0,1]² continue across the edge: the map's edges
/// are mirrored, so gutters of tiles at the rim hold what lies beyond.
fn direction_from_octahedral(square: vec2f) -> vec3f {
    var uv = 2.0 * square - 1.0;
    // Crossing the edge u = ±1 arrives at v -> -v on the same edge; the same for v.
    if abs(uv.x) > 1.0 { uv = vec2f(sign_not_zero(uv).x * (2.0 - abs(uv.x)), -uv.y); }
    if abs(uv.y) > 1.0 { uv = vec2f(-uv.x, sign_not_zero(uv).y * (2.0 - abs(uv.y))); }
    let a = abs(uv);
    let signed_distance = 1.0 - (a.x + a.y);
    let radius = 1.0 - abs(signed_distance);
    let angle = select((((a.y - a.x) / radius) + 1.0) * FRAC_PI_FOUR, 0.0, radius == 0.0);
    // 0 <= radius <= 1, so 2 - radius² is in 1...2.
    let sin_theta = radius * sqrt(2.0 - radius * radius);
    let across = vec2f(cos(angle), sin(angle)) * sign_not_zero(uv) * sin_theta;
    let y = select(-1.0, 1.0, signed_distance >= 0.0) * (1.0 - radius * radius);
    return vec3f(across.x, y, across.y);
}
