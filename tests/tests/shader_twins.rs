//! The physical functions of the WGSL, run on the real device, against twins in f64 that are written from the equations.
//! Every bound is an error budget of f32 arithmetic, and each test shows that a planted defect breaks it.

use std::f64::consts::{FRAC_PI_4, PI};

use skycell_server::probe::{FunctionProbe, FunctionQuestion as Question};

/// Half a unit in the last place of 1 in f32: the largest relative error of one rounding.
const U: f64 = 1.0 / (1u64 << 24) as f64;

type Point = [[f32; 4]; 2];

/// The device, for tests of at least ten thousand points.
struct Probe(FunctionProbe);

impl Probe {
    fn open() -> Self {
        Self(FunctionProbe::open().expect("a device"))
    }

    fn ask(&self, question: Question, points: &[Point]) -> Vec<[f32; 4]> {
        let count = points.len();
        assert!(count >= 10_000, "{count} points are too few");
        self.0.ask(question, points).expect("values")
    }
}

/// Numbers in 0...1 that are the same in every run: splitmix64.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((bits ^ (bits >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn one_of(&mut self, choices: &[f64]) -> f64 {
        choices[((self.unit() * choices.len() as f64) as usize).min(choices.len() - 1)]
    }
}

fn wide(vector: [f32; 4]) -> [f64; 3] {
    [vector[0].into(), vector[1].into(), vector[2].into()]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    let difference = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    dot(difference, difference).sqrt()
}

/// Largest of `errors / bounds`; at most 1 where the bound holds.
fn worst(pairs: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    pairs
        .into_iter()
        .map(|(error, bound)| {
            // Not a number is the worst of errors, and max() would drop it.
            if error.is_nan() {
                f64::INFINITY
            } else {
                error / bound
            }
        })
        .fold(0.0, f64::max)
}

/// The bound holds for the GPU and is broken by the defect, else the test could not fail.
fn judge(what: &str, gpu: f64, defect: f64) {
    println!("{what}: GPU at {gpu:.3} of the bound, planted defect at {defect:.3e}");
    assert!(gpu <= 1.0, "{what}: {gpu} times the bound");
    assert!(
        defect > 1.0,
        "{what}: the planted defect passes, at {defect} of the bound"
    );
}

const RADIUS_M: f64 = 6_360_000.0;

/// Places near the cell's middle at every altitude, and far from it along the ground.
fn places() -> Vec<([f32; 4], f64)> {
    let mut random = Random(1);
    let altitudes_m = [
        0.0, 0.01, 2.0, 100.0, 1_500.0, 4_000.0, 12_000.0, 100_000.0, 400_000.0,
    ];
    (0..12_000)
        .map(|index| {
            let altitude_m = if index % 2 == 0 {
                random.one_of(&altitudes_m)
            } else {
                4e5 * random.unit().powi(3)
            };
            // Where a cell reaches: 300 km along the ground; the ground has sunk by 7 km there.
            let angle = random.between(0.0, 0.05) * random.one_of(&[0.0, 1e-4, 1.0]);
            let towards = random.between(0.0, 2.0 * PI);
            let from_centre_m = RADIUS_M + altitude_m;
            let sideways_m = from_centre_m * angle.sin();
            // r cos a - R without its cancellation.
            let y_m = altitude_m - 2.0 * from_centre_m * (angle / 2.0).sin().powi(2);
            let point = [
                (sideways_m * towards.cos()) as f32,
                y_m as f32,
                (sideways_m * towards.sin()) as f32,
                RADIUS_M as f32,
            ];
            (point, angle)
        })
        .collect()
}

/// |p + R y| - R, from the definition; f64 loses 1e-9 m to the cancellation.
fn altitude_twin_m(position: [f64; 3]) -> f64 {
    let from_centre = [position[0], position[1] + RADIUS_M, position[2]];
    dot(from_centre, from_centre).sqrt() - RADIUS_M
}

/// The numerator's terms |p|² and 2 R p_y are each rounded a few times and divided by 2 R; the quotient a few times more.
fn altitude_bound_m(position: [f64; 3], altitude_m: f64) -> f64 {
    let terms = dot(position, position) + 2.0 * RADIUS_M * position[1].abs();
    6.0 * U * terms / (2.0 * RADIUS_M) + 6.0 * U * altitude_m.abs() + 1e-8
}

#[test]
fn altitude_keeps_millimetres_near_the_ground_and_a_planet_away_from_the_centre() {
    let places = places();
    let points: Vec<Point> = places.iter().map(|(p, _)| [*p, [0.0; 4]]).collect();
    let values = Probe::open().ask(Question::Altitude, &points);
    let check = |value: &dyn Fn(usize) -> f64| {
        worst(points.iter().enumerate().map(|(index, point)| {
            let position = wide(point[0]);
            let altitude_m = altitude_twin_m(position);
            (
                (value(index) - altitude_m).abs(),
                altitude_bound_m(position, altitude_m),
            )
        }))
    };
    let gpu = check(&|index| values[index][0].into());
    // The definition in f32 knows altitudes to half a metre.
    let defect = check(&|index| {
        let [x, y, z, radius] = points[index][0];
        let y = y + radius;
        ((x * x + y * y + z * z).sqrt() - radius).into()
    });
    judge("altitude", gpu, defect);
    // What the bound means for a person on the ground in the cell's middle.
    assert!(altitude_bound_m([10.0, 2.0, 10.0], 2.0) < 2e-6);
}

/// Where a line meets a sphere around the planet's centre, from |o + t d|² = (R + H)², d of any length.
struct ShellTwin {
    discriminant: f64,
    near_m: f64,
    far_m: f64,
}

fn shell_twin(position: [f64; 3], direction: [f64; 3], shell_m: f64) -> ShellTwin {
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
struct ShellBound {
    discriminant: f64,
    near_m: f64,
    far_m: f64,
}

fn shell_bound(
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

/// Rays from every place in every direction, most of them near the horizon, with shells from the ground to space.
fn rays() -> Vec<Point> {
    let mut random = Random(2);
    places()
        .iter()
        .map(|(place, _)| {
            let shell_m = random.one_of(&[0.0, 1_500.0, 2_750.0, 4_000.0, 12_000.0, 1e5, 4e5]);
            let altitude_m = altitude_twin_m(wide(*place)).max(0.0);
            // The pitch at which a ray grazes the shell, or the horizontal where it is above.
            let lower = (RADIUS_M + shell_m).min(RADIUS_M + altitude_m);
            let grazing = -(lower / (RADIUS_M + altitude_m)).clamp(-1.0, 1.0).acos();
            let pitch = match (random.unit() * 4.0) as u32 {
                0 => random.between(-PI / 2.0, PI / 2.0),
                1 => random.one_of(&[-PI / 2.0, 0.0, PI / 2.0, grazing]),
                2 => grazing + random.between(-1e-2, 1e-2),
                _ => grazing + random.between(-1e-4, 1e-4),
            };
            let yaw = random.between(0.0, 2.0 * PI);
            let direction = [
                (yaw.sin() * pitch.cos()) as f32,
                pitch.sin() as f32,
                (-yaw.cos() * pitch.cos()) as f32,
                shell_m as f32,
            ];
            [*place, direction]
        })
        .collect()
}

#[test]
fn shell_intersections_stay_within_the_budget_of_f32_from_the_ground_to_space() {
    let points = rays();
    let values = Probe::open().ask(Question::ShellRoots, &points);
    let compare = |roots: &dyn Fn(usize) -> [f64; 3]| {
        let mut pairs = Vec::new();
        let mut skipped = 0;
        for (index, point) in points.iter().enumerate() {
            let (position, direction) = (wide(point[0]), wide(point[1]));
            let shell_m = point[1][3].into();
            let twin = shell_twin(position, direction, shell_m);
            let bound = shell_bound(position, direction, shell_m, &twin);
            let [near_m, far_m, hit] = roots(index);
            let hits = twin.discriminant >= 0.0;
            if (hit != 0.0) != hits {
                // A tangent within rounding may be called either way; no other.
                pairs.push((twin.discriminant.abs(), bound.discriminant));
            } else if hits {
                pairs.push(((near_m - twin.near_m).abs(), bound.near_m));
                pairs.push(((far_m - twin.far_m).abs(), bound.far_m));
            } else {
                skipped += 1;
            }
        }
        assert!(
            pairs.len() > 10_000,
            "{skipped} of {} rays miss",
            points.len()
        );
        worst(pairs)
    };
    let gpu =
        compare(&|index| [values[index][0], values[index][1], values[index][2]].map(f64::from));
    let defect = compare(&|index| textbook_roots(&points[index]));
    judge("shell roots", gpu, defect);
}

/// The quadratic as books have it, in f32: squares of radii are subtracted.
fn textbook_roots(point: &Point) -> [f64; 3] {
    let [x, y, z, radius] = point[0];
    let [dx, dy, dz, shell] = point[1];
    let y = y + radius;
    let b = dx * x + dy * y + dz * z;
    let c = x * x + y * y + z * z - (radius + shell) * (radius + shell);
    let discriminant = b * b - c;
    let root = discriminant.max(0.0).sqrt();
    let hit = if discriminant >= 0.0 { 1.0 } else { 0.0 };
    [(-b - root).into(), (-b + root).into(), hit]
}

#[test]
fn the_clouds_above_a_person_are_met_within_two_metres_at_any_pitch() {
    // What the budget means: the far root of the layers' shells for eyes 2 m above the ground, down to the horizon,
    // where the ray is 200 km long.
    let points: Vec<Point> = (0..12_000)
        .map(|index| {
            let pitch = (f64::from(index / 3) / 3_999.0).powi(3) * PI / 2.0;
            let shell_m = [1_500.0, 2_750.0, 12_000.0][index as usize % 3];
            let direction = [pitch.cos() as f32, pitch.sin() as f32, 0.0, shell_m];
            [[0.0, 2.0, 0.0, RADIUS_M as f32], direction]
        })
        .collect();
    let values = Probe::open().ask(Question::ShellRoots, &points);
    let check = |far: &dyn Fn(usize) -> f64| {
        worst(points.iter().enumerate().map(|(index, point)| {
            let twin = shell_twin(wide(point[0]), wide(point[1]), point[1][3].into());
            ((far(index) - twin.far_m).abs(), 2.0)
        }))
    };
    let gpu = check(&|index| values[index][1].into());
    let defect = check(&|index| textbook_roots(&points[index])[1]);
    judge("layer above a person", gpu, defect);
}

fn unit(vector: [f64; 3]) -> [f64; 3] {
    let length = dot(vector, vector).sqrt();
    vector.map(|part| part / length)
}

#[test]
fn a_direction_comes_back_from_the_octahedral_square() {
    let mut random = Random(3);
    let edges = [0.0, 1.0, -1.0, 1e-3, -1e-3, 1e-6, -1e-6];
    let points: Vec<Point> = (0..12_000)
        .map(|index| {
            let mut part = || {
                if index % 2 == 0 {
                    random.one_of(&edges)
                } else {
                    random.between(-1.0, 1.0)
                }
            };
            let vector = [part(), part(), part()];
            let vector = if dot(vector, vector) < 1e-8 {
                [0.0, 1.0, 0.0]
            } else {
                vector
            };
            let direction = unit(vector).map(|part| part as f32);
            [[direction[0], direction[1], direction[2], 0.0], [0.0; 4]]
        })
        .collect();
    let values = Probe::open().ask(Question::OctahedralRoundTrip, &points);
    let check = |back: &dyn Fn(usize) -> [f64; 3]| {
        worst(
            points
                .iter()
                .enumerate()
                .map(|(index, point)| (distance(back(index), unit(wide(point[0]))), 2e-6)),
        )
    };
    let gpu = check(&|index| wide(values[index]));
    // Forgets which hemisphere it was.
    let defect = check(&|index| {
        let [x, y, z] = wide(values[index]);
        [x, y.abs(), z]
    });
    judge("octahedral round trip", gpu, defect);
}

/// Clarberg 2008, the inverse map, of u, v in -1...1; pole y. `sine` is that of the polar angle at a radius.
fn octahedral_twin(square: [f64; 2], sine: impl Fn(f64) -> f64) -> [f64; 3] {
    let [u, v] = square.map(|part| 2.0 * part - 1.0);
    let from_diagonal = 1.0 - (u.abs() + v.abs());
    let radius = 1.0 - from_diagonal.abs();
    let angle = if radius == 0.0 {
        0.0
    } else {
        FRAC_PI_4 * ((v.abs() - u.abs()) / radius + 1.0)
    };
    let height = (1.0 - radius * radius) * if from_diagonal < 0.0 { -1.0 } else { 1.0 };
    let sign = |part: f64| if part < 0.0 { -1.0 } else { 1.0 };
    let sine = sine(radius);
    [
        sign(u) * angle.cos() * sine,
        height,
        sign(v) * angle.sin() * sine,
    ]
}

#[test]
fn the_octahedral_square_is_the_equal_area_map() {
    let mut random = Random(4);
    let edges = [0.0, 0.25, 0.5, 0.75, 1.0, 1e-4, 1.0 - 1e-4];
    let points: Vec<Point> = (0..12_000)
        .map(|index| {
            let mut part = || {
                if index % 2 == 0 {
                    random.one_of(&edges)
                } else {
                    random.unit()
                }
            };
            [[part() as f32, part() as f32, 0.0, 0.0], [0.0; 4]]
        })
        .collect();
    let values = Probe::open().ask(Question::DirectionFromOctahedral, &points);
    let check = |sine: fn(f64) -> f64| {
        worst(points.iter().zip(&values).map(|(point, value)| {
            let square = [point[0][0].into(), point[0][1].into()];
            (distance(wide(*value), octahedral_twin(square, sine)), 2e-6)
        }))
    };
    let gpu = check(|radius| radius * (2.0 - radius * radius).sqrt());
    // The other octahedral map in use: concentric, not of equal area.
    let defect = check(|radius| (radius * PI / 2.0).sin());
    judge("octahedral square", gpu, defect);
}

/// Henyey and Greenstein 1941.
fn hg_twin(g: f64, one_minus_mu: f64) -> f64 {
    let mu = 1.0 - one_minus_mu;
    (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * mu).powf(1.5))
}

/// Draine 2003, eq. 4.
fn draine_twin(g: f64, alpha: f64, one_minus_mu: f64) -> f64 {
    let mu = 1.0 - one_minus_mu;
    hg_twin(g, one_minus_mu) * (1.0 + alpha * mu * mu) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
}

const SHARPEST: [f64; 11] = [
    0.999, -0.999, 0.99, -0.99, 0.9, -0.9, 0.5, -0.5, 1e-4, -1e-4, 0.0,
];

#[test]
fn phase_functions_keep_their_digits_in_the_sharpest_peaks_forward_and_backward() {
    let mut random = Random(5);
    let points: Vec<Point> = (0..20_000)
        .map(|index| {
            let g = if index % 2 == 0 {
                random.one_of(&SHARPEST)
            } else {
                random.between(-0.999, 0.999)
            };
            let alpha = random.one_of(&[0.0, 1.0, 5.0, 100.0, 1e4]);
            let small = 2.0 * 10f64.powf(random.between(-12.0, 0.0));
            let one_minus_mu = match index % 4 {
                0 => random.one_of(&[0.0, 1e-12, 1e-6, 1.0, 2.0]),
                1 => small,
                2 => 2.0 - small,
                _ => random.between(0.0, 2.0),
            };
            [[g as f32, alpha as f32, one_minus_mu as f32, 0.0], [0.0; 4]]
        })
        .collect();
    let values = Probe::open().ask(Question::Phase, &points);
    // Some ten roundings and a square root, each of 1 to 2.5 units: nothing of it cancels.
    let bound = 24.0 * U;
    let check = |value: &dyn Fn(usize) -> [f64; 2]| {
        worst(points.iter().enumerate().flat_map(|(index, point)| {
            let [g, alpha, one_minus_mu] = wide(point[0]);
            let twins = [
                hg_twin(g, one_minus_mu),
                draine_twin(g, alpha, one_minus_mu),
            ];
            let [hg, draine] = value(index);
            [
                ((hg / twins[0] - 1.0).abs(), bound),
                ((draine / twins[1] - 1.0).abs(), bound),
            ]
        }))
    };
    let gpu = check(&|index| [values[index][0].into(), values[index][1].into()]);
    // 1 + g² - 2 g µ in f32.
    let defect = check(&|index| {
        let [g, _, one_minus_mu, _] = points[index][0];
        let base = 1.0 + g * g - 2.0 * g * (1.0 - one_minus_mu);
        let hg = (1.0 - g * g) / (4.0 * std::f32::consts::PI * base * base.sqrt());
        [hg.into(), values[index][1].into()]
    });
    judge("phase", gpu, defect);
}

#[test]
fn phase_functions_integrate_to_one_over_the_sphere() {
    const NODES: usize = 10_001;
    let probe = Probe::open();
    for g in [-0.99, -0.9, -0.5, -0.1, 0.0, 0.3, 0.7, 0.9, 0.97, 0.99f64] {
        for alpha in [0.0, 1.0, 20.0f64] {
            // Nodes as dense as the peak is sharp: 1 ∓ µ = s (e^(k i) - 1) from 0 to 2.
            let scale = (1.0 - g.abs()).powi(2);
            let rate = (2.0 / scale).ln_1p();
            let points: Vec<Point> = (0..NODES)
                .map(|index| {
                    let from_peak = scale * (rate * index as f64 / (NODES - 1) as f64).exp_m1();
                    let from_peak = from_peak.min(2.0);
                    let one_minus_mu = if g < 0.0 { 2.0 - from_peak } else { from_peak };
                    [[g as f32, alpha as f32, one_minus_mu as f32, 0.0], [0.0; 4]]
                })
                .collect();
            let values = probe.ask(Question::Phase, &points);
            let integral = |value: &dyn Fn(usize) -> f64| {
                let node = |index: usize| f64::from(points[index][0][2]);
                let area = (1..NODES).map(|index| {
                    let width = (node(index) - node(index - 1)).abs();
                    width * (value(index) + value(index - 1)) / 2.0
                });
                2.0 * PI * area.sum::<f64>()
            };
            // The trapezoids' error, (ln 2e4 / 1e4)² ~ 1e-6, and the nodes' rounding.
            let bound = 2e-5;
            for column in [0, 1] {
                let whole = integral(&|index| values[index][column].into());
                let error = (whole - 1.0).abs();
                assert!(
                    error < bound,
                    "g {g}, alpha {alpha}, function {column}: integral {whole}"
                );
            }
            // Draine's numerator without its normalisation.
            if alpha > 0.0 {
                let defect = integral(&|index| {
                    let mu = 1.0 - f64::from(points[index][0][2]);
                    f64::from(values[index][0]) * (1.0 + alpha * mu * mu)
                });
                assert!((defect - 1.0).abs() > bound, "the planted defect passes");
            }
        }
    }
}

#[test]
fn the_share_of_a_constant_source_is_right_from_thin_to_opaque() {
    let mut points: Vec<Point> = (0..12_000)
        .map(|index| 10f64.powf(-12.0 + 14.0 * f64::from(index) / 11_999.0))
        .map(|x| [[x as f32, 0.0, 0.0, 0.0], [0.0; 4]])
        .collect();
    // Both sides of the change of formula.
    points.extend(
        [0.0, 0.01f32.next_down(), 0.01, 0.01f32.next_up()].map(|x| [[x, 0.0, 0.0, 0.0], [0.0; 4]]),
    );
    let values = Probe::open().ask(Question::OneMinusExpOver, &points);
    // Above the change at 1e-2, e^-x is known to (3 + 2 x) units (WGSL) and cancels against 1: at most 3.5 · 2 U / 1e-2.
    let bound = 7.0 * U / 1e-2;
    let twin = |x: f64| if x == 0.0 { 1.0 } else { -(-x).exp_m1() / x };
    let check = |value: &dyn Fn(usize) -> f64| {
        worst(points.iter().enumerate().map(|(index, point)| {
            let exact = twin(point[0][0].into());
            ((value(index) / exact - 1.0).abs(), bound)
        }))
    };
    let gpu = check(&|index| values[index][0].into());
    // Unguarded.
    let defect = check(&|index| {
        let x = points[index][0][0];
        ((1.0 - (-x).exp()) / x).into()
    });
    judge("(1 - e^-x) / x", gpu, defect);
}

/// IEC 61966-2-1.
fn srgb_twin(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

#[test]
fn the_fast_srgb_curve_stays_within_a_hundredth_of_an_eight_bit_step() {
    let mut points: Vec<Point> = (0..12_000)
        .map(|index| {
            let share = f64::from(index) / 11_999.0;
            [
                [
                    share as f32,
                    share.powi(4) as f32,
                    (share * 0.01) as f32,
                    0.0,
                ],
                [0.0; 4],
            ]
        })
        .collect();
    let edge = 0.003_130_8f32;
    points.push([[edge.next_down(), edge, edge.next_up(), 0.0], [0.0; 4]]);
    let values = Probe::open().ask(Question::Srgb, &points);
    let bound = 0.01 / 255.0;
    let check = |twin: fn(f64) -> f64| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let (linear, encoded) = (wide(point[0]), wide(*value));
            [0, 1, 2].map(|channel| ((encoded[channel] - twin(linear[channel])).abs(), bound))
        }))
    };
    let gpu = check(srgb_twin);
    // The power that is often taken for sRGB.
    let defect = check(|linear| linear.powf(1.0 / 2.2));
    judge("sRGB", gpu, defect);
}
