//! What stands in a place: maps, noise, shapes, voxels.
//!
//! The budget of a read is backward: in f32 a function of a place is the exact function of a place nearby. Coordinates in
//! periods are p / period + offset, of at most |p| / period + 1, each rounded a few times: 8 U (|p| + period) in metres.
//! How far the exact function moves over that distance is asked of the twin itself.

use super::support::{SceneProbe, judge, noise_dir};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::Scene;
use skycell_protocol::scene::{CloudForm, WeatherProfile};
use skycell_reference::density::profile::vertical_profile;
use skycell_reference::density::weather::Weather;
use skycell_reference::{LayerField, Medium, WorldLayer};
use skycell_server::probe::{FieldPoint, FieldQuestion};
use skycell_server::truth::reference_field;
use skycell_tests::numbers::{Random, U, wide, worst};

pub(crate) const SPAN_M: f64 = 40_000.0;

fn weather() -> Value {
    json!({"version": 1, "layers": [{"density": {"model": "weather", "coverage": 0.6, "detail_strength": 0.5}}]})
}

/// Places in and around the default layer, up to 30 km away; every weight of the detail.
pub(crate) fn places(count: usize) -> Vec<FieldPoint> {
    let mut random = Random(11);
    (0..count)
        .map(|index| {
            let altitude_m = match index % 8 {
                0 => random.one_of(&[1500.0, 4000.0, 1501.0, 3999.0]),
                _ => random.between(1500.0, 4000.0),
            };
            let (x, z) = (random.between(-3e4, 3e4), random.between(-3e4, 3e4));
            let y = altitude_m - (x * x + z * z) / (2.0 * 6_360_000.0);
            let weight = random.one_of(&[0.0, 0.5, 1.0]);
            [
                [x as f32, y as f32, z as f32, weight as f32],
                [0.0; 4],
                [0.0; 4],
                [0.0; 4],
            ]
        })
        .collect()
}

pub(crate) fn reach_m(position: DVec3) -> f64 {
    8.0 * U * (position.abs().max_element() + SPAN_M)
}

/// How far a function moves where its place does by `reach_m` along each axis.
pub(crate) fn moves(function: impl Fn(DVec3) -> f64, position: DVec3, reach_m: f64) -> f64 {
    let here = function(position);
    (0..8)
        .map(|corner| {
            let sign = |bit: u32| {
                if corner >> bit & 1 == 1 {
                    reach_m
                } else {
                    -reach_m
                }
            };
            (function(position + DVec3::new(sign(0), sign(1), sign(2))) - here).abs()
        })
        .fold(0.0, f64::max)
}

#[test]
fn weather_densities_are_those_of_places_a_centimetre_away() {
    let probe = SceneProbe::open(&weather(), true);
    let points = places(16_000);
    let values = probe.ask(FieldQuestion::Density, &points);
    let layer = &probe.world.layers()[0];
    let check = |swapped: bool, smooth: bool| {
        worst(points.iter().zip(&values).map(|(point, value)| {
            let position = DVec3::from_array(wide(point[0]));
            let weight = f64::from(point[0][3]);
            let twin = |at: DVec3| {
                let at = if swapped {
                    DVec3::new(at.z, at.y, at.x)
                } else {
                    at
                };
                if smooth {
                    probe.world.smooth_density(layer, at)
                } else {
                    probe.world.density(layer, at, weight)
                }
            };
            let error = (f64::from(value[0][usize::from(smooth)]) - twin(position)).abs();
            // Twice the corners: between them the function bends. Some twenty roundings of numbers below 2, times the
            // surface's steepness of 6.
            let bound = 2.0 * moves(twin, position, reach_m(position)) + 240.0 * U;
            (error, bound)
        }))
    };
    for (what, smooth) in [("carved density", false), ("smooth density", true)] {
        // Planted: x and z swapped.
        judge(
            what,
            points.len(),
            check(false, smooth),
            check(true, smooth),
        );
    }
}

/// Places in and around a layer, up to 60 km away; every weight of the detail.
fn places_in(base_m: f64, top_m: f64, count: usize) -> Vec<FieldPoint> {
    let mut random = Random(17);
    (0..count)
        .map(|_| {
            let altitude_m = random.between(base_m, top_m);
            let (x, z) = (random.between(-6e4, 6e4), random.between(-6e4, 6e4));
            let y = altitude_m - (x * x + z * z) / (2.0 * 6_360_000.0);
            let weight = random.one_of(&[0.0, 0.5, 1.0]);
            [
                [x as f32, y as f32, z as f32, weight as f32],
                [0.0; 4],
                [0.0; 4],
                [0.0; 4],
            ]
        })
        .collect()
}

/// Low clouds of a type: its span, and its layer.
fn of_type(cloud_type: f64, span_m: f64, [base_m, top_m]: [f64; 2]) -> Value {
    json!({"version": 1, "layers": [{"base_altitude_m": base_m, "top_altitude_m": top_m, "density": {"model": "weather",
        "coverage": 0.7, "type": cloud_type, "map_span_m": span_m, "shape_period_m": 5000, "detail_period_m": 700,
        "detail_strength": 0.4}}]})
}

/// Heaps (type 1/2), anvils (1), and a type between their knots.
const TYPES: [(f64, f64, [f64; 2]); 3] = [
    (0.5, 40_000.0, [1_500.0, 4_000.0]),
    (0.9, 100_000.0, [1_000.0, 9_000.0]),
    (1.0, 200_000.0, [800.0, 11_000.0]),
];

#[test]
fn clouds_of_a_type_have_its_form() {
    for (cloud_type, span_m, heights_m) in TYPES {
        let probe = SceneProbe::open(&of_type(cloud_type, span_m, heights_m), true);
        let points = places_in(heights_m[0], heights_m[1], 12_000);
        let values = probe.ask(FieldQuestion::Density, &points);
        let layer = probe.world.layers()[0];
        let Medium::Weather(weather) = layer.medium else {
            panic!("a weather layer");
        };
        let check = |form: CloudForm| {
            let layer = WorldLayer {
                medium: Medium::Weather(Weather { form, ..weather }),
                ..layer
            };
            worst(points.iter().zip(&values).map(|(point, value)| {
                let position = DVec3::from_array(wide(point[0]));
                let weight = f64::from(point[0][3]);
                let twin = |at: DVec3| probe.world.density(&layer, at, weight);
                let error = (f64::from(value[0][0]) - twin(position)).abs();
                let reach_m = 8.0 * U * (position.abs().max_element() + span_m);
                (
                    error,
                    2.0 * moves(twin, position, reach_m) + 60.0 * form.steepness * U,
                )
            }))
        };
        let form = weather.form;
        // Planted: each number of the form a little aside.
        for (number, defect) in [
            (
                "threshold",
                CloudForm {
                    shape_floor: form.shape_floor + 0.01,
                    ..form
                },
            ),
            (
                "range",
                CloudForm {
                    shape_range: form.shape_range + 0.01,
                    ..form
                },
            ),
            (
                "steepness",
                CloudForm {
                    steepness: form.steepness * 1.01,
                    ..form
                },
            ),
            (
                "dome",
                CloudForm {
                    dome: form.dome + 0.01,
                    ..form
                },
            ),
            (
                "wispiness",
                CloudForm {
                    wispiness: form.wispiness + 0.01,
                    ..form
                },
            ),
            (
                "spread of the type",
                CloudForm {
                    type_spread: form.type_spread + 0.01,
                    ..form
                },
            ),
        ] {
            judge(
                &format!("type {cloud_type}: {number}"),
                points.len(),
                check(form),
                check(defect),
            );
        }
    }
}

#[test]
fn a_cloud_begins_where_coverage_times_profile_reaches_the_threshold_of_its_noise() {
    // From what the device says of map, height and density alone: no noise lets cloud stand below the least threshold that
    // its form allows, and where noise has its mean, that is the form's threshold.
    for (cloud_type, span_m, heights_m) in TYPES {
        let probe = SceneProbe::open(&of_type(cloud_type, span_m, heights_m), true);
        let points = places_in(heights_m[0], heights_m[1], 24_000);
        let values = probe.ask(FieldQuestion::Density, &points);
        let form = CloudForm::of(WeatherProfile::Low, cloud_type);
        let least = 1.0 - form.shape_floor - form.shape_range;
        let most = 1.0 - form.shape_floor;
        let check = |moved: f64| {
            worst(values.iter().map(|value| {
                let [density, smooth, _, profile] = value[0].map(f64::from);
                // Solid above all thresholds, but for what detail takes away (0.4, half of it in the mean) and the surface's
                // softness; nothing below the least.
                let below = density.max(smooth) * f64::from(u8::from(profile < least + moved));
                let solid = most + 0.2 + 1.0 / form.steepness;
                let above = (1.0 - smooth) * f64::from(u8::from(profile > solid - moved - 1e-5));
                (below.max(above), 1e-5)
            }))
        };
        judge(
            &format!("type {cloud_type}: where cloud begins"),
            points.len(),
            check(0.0),
            check(0.2),
        );
    }
}

#[test]
fn clouds_keep_the_share_of_their_coverage_that_their_height_and_type_have_in_closed_form() {
    for (cloud_type, span_m, heights_m) in TYPES {
        let probe = SceneProbe::open(&of_type(cloud_type, span_m, heights_m), true);
        let points = places_in(heights_m[0], heights_m[1], 12_000);
        let values = probe.ask(FieldQuestion::Density, &points);
        let Medium::Weather(weather) = probe.world.layers()[0].medium else {
            panic!("a weather layer");
        };
        let check = |closed_form: &dyn Fn(f64, f64) -> f64| {
            worst(values.iter().map(|value| {
                let profile = f64::from(value[0][3]);
                let [map, type_map, _, height] = value[1].map(f64::from);
                let coverage = weather.coverage_from_map(map);
                let local_type = weather.domed_type(type_map, coverage).clamp(0.0, 1.0);
                let exact = coverage * closed_form(local_type, height);
                // The table's digits, and what lies between its texels of 1/128 and 1/64: an eighth of the second difference
                // where it is smooth, and all of the first at a kink.
                let apart = |dt: f64, dh: f64| {
                    let at = |sign: f64| {
                        closed_form(
                            (local_type + sign * dt).clamp(0.0, 1.0),
                            (height + sign * dh).clamp(0.0, 1.0),
                        )
                    };
                    let here = closed_form(local_type, height);
                    (at(1.0) - here).abs().max((at(-1.0) - here).abs())
                };
                let bound =
                    0.5 / 255.0 + 1e-5 + 0.5 * (apart(1.0 / 64.0, 0.0) + apart(0.0, 1.0 / 128.0));
                ((profile - exact).abs(), bound)
            }))
        };
        // Planted: towers without anvils, or at heaps a top that rises with the type itself.
        let planted = |local_type: f64, height: f64| {
            if cloud_type < 0.85 {
                vertical_profile(WeatherProfile::Low, local_type * local_type, height)
            } else {
                vertical_profile(WeatherProfile::Low, local_type.min(0.84), height)
            }
        };
        judge(
            &format!("type {cloud_type}: profile"),
            points.len(),
            check(&|t, h| vertical_profile(WeatherProfile::Low, t, h)),
            check(&planted),
        );
    }
}

#[test]
fn maps_are_read_exactly_in_f32_and_to_eight_bits_by_the_sampler() {
    let noise = noise_dir();
    let scene = Scene::from_json(&weather()).expect("valid");
    let field = reference_field(&scene, &noise, &noise).expect("data");
    let Some(LayerField::Weather(maps)) = field.layers.first() else {
        panic!("a weather layer has maps");
    };
    let points = places(12_000);
    for (what, exact) in [
        ("maps, interpolated in f32", true),
        ("maps, by the sampler", false),
    ] {
        let probe = SceneProbe::open(&weather(), exact);
        let values = probe.ask(FieldQuestion::Density, &points);
        let check = |shift: f64| {
            worst(points.iter().zip(&values).flat_map(|(point, value)| {
                let position = DVec3::from_array(wide(point[0]));
                [&maps.coverage, &maps.cloud_type, &maps.skip]
                    .into_iter()
                    .zip(value[1])
                    .map(|(map, value)| {
                        let twin = |at: DVec3| map.repeated(at.x / SPAN_M + shift, at.z / SPAN_M);
                        let error = (f64::from(value) - twin(position)).abs();
                        let bound = if exact {
                            2.0 * moves(twin, position, reach_m(position)) + 16.0 * U
                        } else {
                            // Weights of 8 bits in both directions, of neighbours up to 1 apart, and 8 bits of result.
                            2.0 / 256.0 + 1.0 / 255.0
                        };
                        (error, bound)
                    })
                    .collect::<Vec<_>>()
            }))
        };
        // Planted: half a texel aside.
        judge(what, points.len(), check(0.0), check(0.5 / 1024.0));
    }
}

#[test]
fn coverage_and_type_are_straight_lines_that_end_at_0_and_1() {
    let probe = SceneProbe::open(&weather(), true);
    let mut random = Random(12);
    let edges = [0.0, 1.0, 0.5, 1e-7, 1.0 - 1e-7];
    let points: Vec<FieldPoint> = (0..12_000)
        .map(|index| {
            let mut part = || {
                if index % 2 == 0 {
                    random.one_of(&edges)
                } else {
                    random.unit()
                }
            };
            let a = [part(), part(), part(), part()].map(|v| v as f32);
            [a, [part() as f32, 0.0, 0.0, 0.0], [0.0; 4], [0.0; 4]]
        })
        .collect();
    let values = probe.ask(FieldQuestion::CoverageAndType, &points);
    let check = |softness: f64, spread_factor: f64| {
        worst(points.iter().zip(&values).flat_map(|(point, value)| {
            let [layer, map, layer_type, type_map] = point[0].map(f64::from);
            let spread = spread_factor * f64::from(point[1][0]);
            // Clear at 0 whatever the map holds, solid at 1; in between a rise of width `softness`.
            let threshold = 1.0 - (1.0 + softness) * layer;
            let coverage = ((map - threshold) / softness).clamp(0.0, 1.0);
            let local_type = (layer_type * (1.0 - spread * (1.0 - type_map))).clamp(0.0, 1.0);
            [
                // Three roundings of numbers up to 1.55, divided by 0.55.
                ((f64::from(value[0][0]) - coverage).abs(), 12.0 * U),
                ((f64::from(value[0][1]) - local_type).abs(), 4.0 * U),
            ]
        }))
    };
    judge(
        "coverage and type",
        points.len(),
        check(0.55, 1.0),
        check(0.5, 1.0),
    );
    judge(
        "type alone",
        points.len(),
        check(0.55, 1.0),
        check(0.55, 0.9),
    );
}

/// A layer from 1 to 3 km with one bounded density around (200, 2000, -300).
fn bounded(density: Value) -> Value {
    json!({"version": 1, "layers": [{"base_altitude_m": 1000, "top_altitude_m": 3000, "density": density}]})
}

#[test]
fn boxes_balls_and_grids_are_where_they_are_said_to_be() {
    let voxels: Vec<u8> = {
        let mut random = Random(13);
        (0..5 * 4 * 3)
            .flat_map(|_| (random.unit() as f32).to_le_bytes())
            .collect()
    };
    std::fs::create_dir_all(noise_dir()).expect("a folder");
    std::fs::write(noise_dir().join("twin.f32"), voxels).expect("a file");
    let center = [200.0, 2000.0, -300.0];
    for (what, density) in [
        (
            "box",
            json!({"model": "homogeneous", "shape": {"form": "box", "center_m": center, "size_m": [700, 500, 900]}}),
        ),
        (
            "ball",
            json!({"model": "homogeneous", "shape": {"form": "sphere", "center_m": center, "radius_m": 450}}),
        ),
        (
            "grid",
            json!({"model": "grid", "file": "twin.f32", "dimensions": [5, 4, 3],
            "bounds_min_m": [-200, 1600, -800], "bounds_max_m": [600, 2400, 200]}),
        ),
    ] {
        let probe = SceneProbe::open(&bounded(density), true);
        let mut random = Random(14);
        let points: Vec<FieldPoint> = (0..12_000)
            .map(|_| {
                let place =
                    [0, 1, 2].map(|axis| (center[axis] + random.between(-600.0, 600.0)) as f32);
                [
                    [place[0], place[1], place[2], 1.0],
                    [0.0; 4],
                    [0.0; 4],
                    [0.0; 4],
                ]
            })
            .collect();
        let values = probe.ask(FieldQuestion::Density, &points);
        let layer = &probe.world.layers()[0];
        let check = |shift_m: f64| {
            worst(points.iter().zip(&values).map(|(point, value)| {
                let position = DVec3::from_array(wide(point[0]));
                let twin = |at: DVec3| probe.world.density(layer, at + DVec3::X * shift_m, 1.0);
                // Places below 3 km, in a frame of 1 km: 8 U of both.
                let bound = 2.0 * moves(twin, position, 8.0 * U * 4_000.0) + 32.0 * U;
                ((f64::from(value[0][0]) - twin(position)).abs(), bound)
            }))
        };
        judge(what, points.len(), check(0.0), check(1.0));
    }
}
