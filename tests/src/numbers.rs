//! Numbers for tests that hold f32 against f64: random ones, error budgets, rays and shells from their equations.

/// Half a unit in the last place of 1 in f32: the largest relative error of one rounding.
pub const U: f64 = 1.0 / (1u64 << 24) as f64;

/// Radius of the default planet.
pub const RADIUS_M: f64 = 6_360_000.0;

/// Numbers in 0...1 that are the same in every run: splitmix64.
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    /// Evenly in 0...1.
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((bits ^ (bits >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Evenly between two numbers.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// One of some numbers.
    pub fn one_of(&mut self, choices: &[f64]) -> f64 {
        choices[((self.unit() * choices.len() as f64) as usize).min(choices.len() - 1)]
    }
}

/// The first three of four numbers.
pub fn wide(vector: [f32; 4]) -> [f64; 3] {
    [vector[0].into(), vector[1].into(), vector[2].into()]
}

/// Scalar product.
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Length of the difference.
pub fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let difference = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    dot(difference, difference).sqrt()
}

/// Along a vector, of length 1.
pub fn unit(vector: [f64; 3]) -> [f64; 3] {
    let length = dot(vector, vector).sqrt();
    vector.map(|part| part / length)
}

/// An error in units of its bound. Not a number is the worst of errors, and max() would drop it.
pub fn share(error: f64, bound: f64) -> f64 {
    if error.is_nan() {
        f64::INFINITY
    } else if error == 0.0 {
        0.0
    } else {
        error / bound
    }
}

/// Largest of `errors / bounds`; at most 1 where the bound holds.
pub fn worst(pairs: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    pairs
        .into_iter()
        .map(|(error, bound)| share(error, bound))
        .fold(0.0, f64::max)
}

/// |p + R y| - R, from the definition; f64 loses 1e-9 m to the cancellation.
pub fn altitude_twin_m(position: [f64; 3]) -> f64 {
    let from_centre = [position[0], position[1] + RADIUS_M, position[2]];
    dot(from_centre, from_centre).sqrt() - RADIUS_M
}

/// The numerator's terms |p|² and 2 R p_y are each rounded a few times and divided by 2 R; the quotient a few times more.
pub fn altitude_bound_m(position: [f64; 3], altitude_m: f64) -> f64 {
    let terms = dot(position, position) + 2.0 * RADIUS_M * position[1].abs();
    6.0 * U * terms / (2.0 * RADIUS_M) + 6.0 * U * altitude_m.abs() + 1e-8
}

/// Where a line meets a sphere around the planet's centre, from |o + t d|² = (R + H)², d of any length.
#[derive(Clone, Copy, Debug)]
pub struct ShellTwin {
    /// Negative where the line misses.
    pub discriminant: f64,
    /// First root.
    pub near_m: f64,
    /// Second root.
    pub far_m: f64,
}

/// The roots in f64.
pub fn shell_twin(position: [f64; 3], direction: [f64; 3], shell_m: f64) -> ShellTwin {
    let from_centre = [position[0], position[1] + RADIUS_M, position[2]];
    let a = dot(direction, direction);
    let b = dot(direction, from_centre);
    let c = dot(from_centre, from_centre) - (RADIUS_M + shell_m).powi(2);
    let discriminant = b * b - a * c;
    let root = discriminant.max(0.0).sqrt();
    // c is a difference of 4e13: known to 0.01 m², so t to 1e-9 m but at the shell itself, and q keeps its digits.
    let q = if b < 0.0 { root - b } else { -(b + root) };
    let (first, second) = if q == 0.0 { (0.0, 0.0) } else { (q / a, c / q) };
    ShellTwin {
        discriminant,
        near_m: first.min(second),
        far_m: first.max(second),
    }
}

/// Error budget of the roots: of b and c by their roundings, of the discriminant by both, of its root, of q, of c / q.
#[derive(Clone, Copy, Debug)]
pub struct ShellBound {
    /// Of the discriminant.
    pub discriminant: f64,
    /// Of the first root.
    pub near_m: f64,
    /// Of the second root.
    pub far_m: f64,
}

/// The budget of the roots in f32.
pub fn shell_bound(
    position: [f64; 3],
    direction: [f64; 3],
    shell_m: f64,
    twin: &ShellTwin,
) -> ShellBound {
    let altitude_m = altitude_twin_m(position);
    let b = dot(direction, position) + RADIUS_M * direction[1];
    let b_terms: f64 = (0..3)
        .map(|axis| (direction[axis] * position[axis]).abs())
        .sum::<f64>()
        + RADIUS_M * direction[1].abs();
    let b_error = 4.0 * U * b_terms;
    let sum = altitude_m + shell_m + 2.0 * RADIUS_M;
    let c = (altitude_m - shell_m) * sum;
    let height_error = altitude_bound_m(position, altitude_m) + U * (altitude_m - shell_m).abs();
    let c_error = height_error * sum + 4.0 * U * c.abs();
    // With the direction's length, which is 1 to a rounding: 2 U c.
    let discriminant = 2.0 * b.abs() * b_error + c_error + 4.0 * U * (b * b + c.abs());
    let root = twin.discriminant.max(0.0).sqrt();
    // |sqrt(D + e) - sqrt(D)| <= min(e / sqrt(D), sqrt(e)).
    let root_error = (discriminant / root).min(discriminant.sqrt()) + 2.0 * U * root;
    let q = b.abs() + root;
    let q_error = b_error + root_error + 4.0 * U * q;
    // Where q is lost in its error, both roots are as small as it.
    let other_error = if q > 2.0 * q_error {
        (c_error + c.abs() * (q_error / q + 4.0 * U)) / (q - q_error)
    } else {
        q_error + discriminant.sqrt()
    };
    // b < 0: q is the far root.
    let (near_m, far_m) = if b < 0.0 {
        (other_error, q_error)
    } else {
        (q_error, other_error)
    };
    ShellBound {
        discriminant,
        near_m: near_m + 1e-6,
        far_m: far_m + 1e-6,
    }
}

/// A part of a ray, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Where it begins.
    pub start_m: f64,
    /// Where it ends; beyond the start.
    pub end_m: f64,
    /// How far f32 may misplace both ends together.
    pub bound_m: f64,
}

/// Whether f32 may call a ray that all but touches the ground either way.
pub fn grazes_ground(position: [f64; 3], direction: [f64; 3]) -> bool {
    let twin = shell_twin(position, direction, 0.0);
    twin.discriminant.abs() <= shell_bound(position, direction, 0.0, &twin).discriminant
}

/// The parts of a ray between two altitudes, in front of its origin and of the ground, from the distances at which it
/// crosses the shells: at most two. A tangent within f32's rounding counts in `bound_m`.
pub fn layer_parts(
    position: [f64; 3],
    direction: [f64; 3],
    base_m: f64,
    top_m: f64,
    has_ground: bool,
) -> Vec<Part> {
    let roots = |shell_m: f64| {
        let twin = shell_twin(position, direction, shell_m);
        let bound = shell_bound(position, direction, shell_m, &twin);
        (twin, bound)
    };
    let (ground, ground_bound) = roots(0.0);
    // Where f32 may call a tangent either way, it counts as hit: without ground is the other way.
    let hit = ground.discriminant >= -ground_bound.discriminant;
    let ground_in_front = has_ground && hit && ground.near_m + ground.far_m > 0.0;
    let (top, top_bound) = roots(top_m);
    let (base, base_bound) = roots(base_m);
    // What a ray that just misses or just meets a shell may gain or lose: the chord of the discriminant's error.
    let chord = |twin: &ShellTwin, bound: &ShellBound| {
        if twin.discriminant.abs() <= bound.discriminant {
            2.0 * (2.0 * bound.discriminant).sqrt()
        } else {
            0.0
        }
    };
    let slack_m = chord(&top, &top_bound) + chord(&base, &base_bound);
    if top.discriminant < 0.0 {
        return if slack_m > 0.0 {
            vec![Part {
                start_m: 0.0,
                end_m: 0.0,
                bound_m: slack_m,
            }]
        } else {
            Vec::new()
        };
    }
    let start_m = top.near_m.max(0.0);
    let (end_m, end_bound_m) = if ground_in_front && ground.near_m.max(0.0) < top.far_m {
        (ground.near_m.max(0.0), ground_bound.near_m)
    } else {
        (top.far_m, top_bound.far_m)
    };
    let bound_m = top_bound.near_m + end_bound_m + base_bound.near_m + base_bound.far_m + slack_m;
    let whole = Part {
        start_m,
        end_m,
        bound_m,
    };
    let pieces = if base.discriminant < 0.0 {
        vec![whole]
    } else {
        vec![
            Part {
                end_m: base.near_m.clamp(start_m, end_m.max(start_m)),
                ..whole
            },
            Part {
                start_m: base.far_m.max(start_m),
                ..whole
            },
        ]
    };
    pieces
        .into_iter()
        .filter(|part| part.end_m > part.start_m - part.bound_m)
        .map(|part| Part {
            end_m: part.end_m.max(part.start_m),
            ..part
        })
        .collect()
}
