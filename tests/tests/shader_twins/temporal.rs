//! The temporal window: where slices are looked up, and what their samples weigh.

use super::support::{SceneProbe, judge};
use glam::DVec3;
use serde_json::json;
use skycell_reference::window::{parallax_weight, picture_place, sample_weight};
use skycell_server::probe::{FieldPoint, FieldQuestion};
use skycell_tests::numbers::{Random, U, worst};

fn with(v: DVec3, last: f64) -> [f32; 4] {
    let [x, y, z] = v.as_vec3().to_array();
    [x, y, z, last as f32]
}

#[test]
fn a_point_is_found_where_the_camera_shows_it() {
    let probe = SceneProbe::open(&json!({"version": 1}), true);
    let mut random = Random(31);
    let mut cameras = Vec::new();
    let points: Vec<FieldPoint> = (0..12_000)
        .map(|_| {
            let yaw = random.between(-3.2, 3.2);
            let pitch = random.one_of(&[-1.5, -0.4, 0.0, 0.4, 1.5]);
            let forward = DVec3::new(
                pitch.cos() * yaw.sin(),
                pitch.sin(),
                -pitch.cos() * yaw.cos(),
            );
            let side = DVec3::new(yaw.cos(), 0.0, yaw.sin());
            let half = random
                .one_of(&[0.5f64, 30.0, 60.0, 85.0])
                .to_radians()
                .tan();
            let aspect = random.one_of(&[0.1, 1.0, 16.0 / 9.0]);
            let (right, up) = (side * half * aspect, side.cross(forward) * half);
            let size = [
                random.one_of(&[1.0, 320.0, 3840.0]),
                random.one_of(&[1.0, 180.0, 2160.0]),
            ];
            // On the ray through a place of the picture or beside it, in front or behind.
            let [x, y] = [(); 2].map(|()| random.between(-1.5, 1.5));
            let away_m = 10f64.powf(random.between(0.0, 6.0)) * random.one_of(&[1.0, 1.0, -1.0]);
            let point = (forward + right * x + up * y).normalize() * away_m;
            cameras.push((right, up));
            [
                with(forward, size[0]),
                with(right / right.length_squared(), size[1]),
                with(up / up.length_squared(), 0.0),
                with(point, 0.0),
            ]
        })
        .collect();
    let values = probe.ask(FieldQuestion::Reprojected, &points);
    let check =
        |mirrored: bool| {
            worst(points.iter().zip(&values).zip(&cameras).flat_map(
                |((point, value), (right, up))| {
                    let wide = |v: [f32; 4]| DVec3::from_array([v[0], v[1], v[2]].map(f64::from));
                    let (forward, seen) = (wide(point[0]), wide(point[3]));
                    let size = [f64::from(point[0][3]), f64::from(point[1][3])];
                    let place = picture_place(forward, *right, *up, size, seen);
                    let [x, y, in_front, _] = value[0].map(f64::from);
                    let Some([true_x, true_y]) = place else {
                        return [(in_front, 0.5), (0.0, 1.0)];
                    };
                    // Sums of three products, each rounded thrice, of vectors that are known to U; then the quotient.
                    let depth = forward.dot(seen);
                    let slant = seen.length() / depth;
                    let error = |half: f64, place: f64, size: f64| {
                        let ndc = (2.0 * place / size - 1.0).abs();
                        size * U * (8.0 * slant * (1.0 / half + ndc) + 4.0 * (1.0 + ndc))
                    };
                    let y = if mirrored { size[1] - y } else { y };
                    [
                        ((x - true_x).abs(), error(right.length(), true_x, size[0])),
                        ((y - true_y).abs(), error(up.length(), true_y, size[1])),
                    ]
                },
            ))
        };
    // Planted: a picture that stands on its head.
    judge("reprojection", points.len(), check(false), check(true));
}

#[test]
fn samples_weigh_by_distance_and_parallax_and_are_kept_in_sixteen_bytes() {
    let probe = SceneProbe::open(&json!({"version": 1}), true);
    let mut random = Random(32);
    let points: Vec<FieldPoint> = (0..12_000)
        .map(|_| {
            let sigma = random.between(0.4, 4.0);
            let [x, y] = [(); 2].map(|()| random.between(-4.0, 4.0) * sigma);
            let moved_m = random.one_of(&[0.0, 1.0, 50.0, 1e4]);
            let distance_m = 10f64.powf(random.between(0.0, 6.0));
            let sharpness = 0.5 / (sigma * sigma);
            [
                [x as f32, y as f32, sharpness as f32, moved_m as f32],
                [distance_m as f32, 0.0, 0.0, 0.0],
                [
                    random.between(0.0, 1.0) as f32,
                    10f64.powf(random.between(-6.0, 5.0)) as f32,
                    random.between(0.0, 10.0) as f32,
                    random.one_of(&[0.0, 1e-7, 0.25, 0.999_999, 1.0]) as f32,
                ],
                [10f64.powf(random.between(-3.0, 6.5)) as f32, 0.0, 0.0, 0.0],
            ]
        })
        .collect();
    let values = probe.ask(FieldQuestion::WindowWeights, &points);
    let check = |width: f64| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let [x, y, sharpness, moved_m] = point[0].map(f64::from);
            let distance_m = f64::from(point[1][0]);
            let weight = sample_weight([x, y], width / (2.0 * sharpness).sqrt());
            let exponent = (x * x + y * y) * sharpness;
            let parallax = parallax_weight(moved_m, distance_m);
            let [found, found_parallax, distance_back_m, _] = value[0].map(f64::from);
            let kept = value[1].map(f64::from);
            let given = point[2].map(f64::from);
            let given_distance_m = f64::from(point[3][0]);
            [
                // exp is known to 3 + 2 |x| units, and feels four roundings of its argument.
                (
                    (found - weight).abs(),
                    weight * U * (8.0 + 12.0 * exponent) + 1e-26,
                ),
                ((found_parallax - parallax).abs(), 12.0 * U * parallax),
                ((kept[0] - given[0]).abs(), 0.1 * U),
                ((kept[1] - given[1]).abs(), 0.1 * U),
                ((kept[2] - given[2]).abs(), 0.1 * U),
                // Half of a step of 16 bits, and of eight digits.
                ((kept[3] - given[3]).abs(), 0.5 / 65_535.0 + 2.0 * U),
                (
                    (distance_back_m - given_distance_m).abs(),
                    given_distance_m * 2f64.powi(-8),
                ),
            ]
        }))
    };
    // Planted: a Gaussian that is a hundredth wider.
    judge("window weights", points.len(), check(1.0), check(1.01));
}
