//! Altitudes, shells, parts of rays, the octahedral map.

use super::support::{Point, Probe, SceneProbe, judge};
use skycell_server::probe::{FieldPoint, FieldQuestion, FunctionQuestion as Question};
use skycell_tests::numbers::{
    RADIUS_M, Random, U, altitude_bound_m, altitude_twin_m, distance, dot, grazes_ground,
    layer_parts, shell_bound, shell_twin, unit, wide, worst,
};
use std::f64::consts::{FRAC_PI_4, PI};

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
    judge("altitude", points.len(), gpu, defect);
    // What the bound means for a person on the ground in the cell's middle.
    assert!(altitude_bound_m([10.0, 2.0, 10.0], 2.0) < 2e-6);
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
    judge("shell roots", points.len(), gpu, defect);
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
    judge("layer above a person", points.len(), gpu, defect);
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
    judge("octahedral round trip", points.len(), gpu, defect);
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

/// Mitchell & Netravali 1988, eq. 8.
fn mitchell_netravali(b: f64, c: f64, x: f64) -> f64 {
    let x = x.abs();
    let polynomial = |k: [f64; 4]| k.iter().fold(0.0, |sum, k| sum * x + k) / 6.0;
    if x < 1.0 {
        polynomial([
            12.0 - 9.0 * b - 6.0 * c,
            -18.0 + 12.0 * b + 6.0 * c,
            0.0,
            6.0 - 2.0 * b,
        ])
    } else if x < 2.0 {
        polynomial([
            -b - 6.0 * c,
            6.0 * b + 30.0 * c,
            -12.0 * b - 48.0 * c,
            8.0 * b + 24.0 * c,
        ])
    } else {
        0.0
    }
}

#[test]
fn reads_are_sharp_where_texels_are_as_wide_as_pixels_and_wider_where_several_make_one() {
    let mut random = Random(8);
    let points: Vec<Point> = (0..12_000)
        .map(|index| {
            let texels_per_pixel = match index % 3 {
                0 => random.one_of(&[0.0, 0.25, 1.0, 1.0 + 1e-6, 8.0, 1e6]),
                _ => random.between(0.0, 9.0),
            };
            let place = match index % 2 {
                0 => random.one_of(&[0.0, 0.5, 1.0, 1e-6, 1.0 - 1e-6]),
                _ => random.unit(),
            };
            [[texels_per_pixel as f32, place as f32, 0.0, 0.0], [0.0; 4]]
        })
        .collect();
    let values = Probe::open().ask(Question::CubicWeights, &points);
    let check = |c_of: fn(f64) -> f64| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let [texels_per_pixel, place, _, _] = point[0].map(f64::from);
            let soft = (0.12 * (texels_per_pixel - 1.0)).clamp(0.0, 1.0);
            let twin =
                move |tap: usize| mitchell_netravali(soft, c_of(soft), place + 1.0 - tap as f64);
            // Sums of up to five terms, none beyond 4, and the rounded softness.
            (0..4).map(move |tap| ((f64::from(value[tap]) - twin(tap)).abs(), 16.0 * U))
        }))
    };
    let gpu = check(|soft| 0.5 * (1.0 - soft));
    // The filter of the same paper that is the most used one, beside this family but for B = 1/3.
    let defect = check(|_| 1.0 / 3.0);
    judge("cubic filter", points.len(), gpu, defect);
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
    judge("octahedral square", points.len(), gpu, defect);
}

#[test]
fn the_parts_of_a_ray_in_a_layer_are_where_it_crosses_the_shells() {
    let probe = SceneProbe::open(&serde_json::json!({"version": 1}), true);
    let mut random = Random(6);
    let points: Vec<FieldPoint> = rays()
        .into_iter()
        .map(|[place, direction]| {
            let base_m = random.one_of(&[0.0, 300.0, 1_500.0, 6_000.0]);
            let top_m = base_m + random.one_of(&[10.0, 2_500.0, 50_000.0]);
            let ground = random.one_of(&[0.0, 1.0]) as f32;
            let d = [direction[0], direction[1], direction[2], ground];
            [place, d, [base_m as f32, top_m as f32, 0.0, 0.0], [0.0; 4]]
        })
        .collect();
    let values = probe.ask(FieldQuestion::LayerIntervals, &points);
    let check = |shift_m: f64| {
        worst(points.iter().zip(&values).filter_map(|(point, value)| {
            let (origin, direction) = (wide(point[0]), wide(point[1]));
            if grazes_ground(origin, direction) {
                return None;
            }
            let [base_m, top_m, ..] = point[2].map(f64::from);
            let ground = point[1][3] > 0.0;
            let parts = layer_parts(origin, direction, base_m + shift_m, top_m + shift_m, ground);
            let exact: f64 = parts.iter().map(|part| part.end_m - part.start_m).sum();
            let bound: f64 = parts.iter().map(|part| part.bound_m).sum();
            let [a, b, c, d] = value[0].map(f64::from);
            let found = (b - a).max(0.0) + (d - c).max(0.0);
            Some(((found - exact).abs(), bound + 8.0 * U * exact + 1e-6))
        }))
    };
    // Planted: a layer 10 m higher.
    judge("parts of a layer", points.len(), check(0.0), check(10.0));
}

#[test]
fn the_part_of_a_ray_over_bounds_is_where_it_crosses_their_sides() {
    let document = serde_json::json!({"version": 1, "layers": [{"density": {"model": "homogeneous",
        "shape": {"form": "box", "center_m": [200, 2500, -300], "size_m": [700, 500, 900]}}}]});
    let probe = SceneProbe::open(&document, true);
    let mut random = Random(7);
    let points: Vec<FieldPoint> = (0..12_000)
        .map(|_| {
            let mut part = |scale: f64| (scale * random.between(-1.0, 1.0)) as f32;
            let origin = [part(3e4), part(2e3), part(3e4), 0.0];
            let direction =
                unit([part(1.0), part(1.0), part(1.0)].map(f64::from)).map(|v| v as f32);
            [
                origin,
                [direction[0], direction[1], direction[2], 0.0],
                [0.0; 4],
                [0.0; 4],
            ]
        })
        .collect();
    let values = probe.ask(FieldQuestion::OverBounds, &points);
    let check = |shift_m: f64| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let (origin, direction) = (wide(point[0]), wide(point[1]));
            let sides = [(0, [-150.0, 550.0]), (2, [-750.0, 150.0])];
            let (mut near, mut far, mut bound) = (f64::NEG_INFINITY, f64::INFINITY, 0.0f64);
            for (axis, edges) in sides {
                let at = edges.map(|edge| (edge + shift_m - origin[axis]) / direction[axis]);
                near = near.max(at[0].min(at[1]));
                far = far.min(at[0].max(at[1]));
                // Differences and quotients of the numbers as they are: three roundings; the far side's place two more.
                let places = origin[axis].abs() + 1_500.0;
                bound = bound.max(6.0 * U * places / direction[axis].abs());
            }
            [
                (
                    (f64::from(value[0][0]) - near).abs(),
                    bound + 4.0 * U * near.abs(),
                ),
                (
                    (f64::from(value[0][1]) - far).abs(),
                    bound + 4.0 * U * far.abs(),
                ),
            ]
        }))
    };
    judge("part over bounds", points.len(), check(0.0), check(1.0));
}
