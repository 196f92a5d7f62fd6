//! Thin sheets of ice: density and the way to the sun.

use super::density::moves;
use super::support::{SceneProbe, judge};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_reference::march::sheet_sun_depth;
use skycell_server::probe::{FieldPoint, FieldQuestion};
use skycell_tests::numbers::{Random, U, wide, worst};

const BASE_M: f64 = 9000.0;
const TOP_M: f64 = 9300.0;
/// Period of the patches.
const SPAN_M: f64 = 83_000.0;

fn sheet(sun_elevation_deg: f64) -> Value {
    json!({"version": 1, "sun": {"elevation_deg": sun_elevation_deg, "azimuth_deg": 70},
        "layers": [{"family": "cirrus", "density": {"type": 0.6, "coverage": 0.7}}]})
}

/// Places in the sheet and at its ends, up to 100 km away.
fn places(count: usize) -> Vec<FieldPoint> {
    let mut random = Random(23);
    (0..count)
        .map(|_| {
            let altitude_m = random.between(BASE_M + 1.0, TOP_M - 1.0);
            let (x, z) = (random.between(-1e5, 1e5), random.between(-1e5, 1e5));
            let from_centre_m = 6_360_000.0 + altitude_m;
            let y = (from_centre_m * from_centre_m - x * x - z * z).sqrt() - 6_360_000.0;
            [
                [x as f32, y as f32, z as f32, 1.0],
                [0.0; 4],
                [0.0; 4],
                [0.0; 4],
            ]
        })
        .collect()
}

fn reach_m(position: DVec3) -> f64 {
    // Turned along the fibres a coordinate is the sum of two, and is rounded once more.
    12.0 * U * (position.abs().max_element() + SPAN_M)
}

#[test]
fn sheets_are_as_dense_as_at_places_a_few_centimetres_away() {
    let probe = SceneProbe::open(&sheet(40.0), true);
    let points = places(12_000);
    let values = probe.ask(FieldQuestion::Density, &points);
    let layer = &probe.world.layers()[0];
    let check = |turned: bool| {
        worst(points.iter().zip(&values).map(|(point, value)| {
            let position = DVec3::from_array(wide(point[0]));
            let twin = |at: DVec3| {
                let at = if turned {
                    DVec3::new(at.z, at.y, at.x)
                } else {
                    at
                };
                probe.world.density(layer, at, 1.0)
            };
            let error = (f64::from(value[0][0]) - twin(position)).abs();
            // Some fifteen roundings of numbers up to 1, times the coverage's steepness of 1 / 0.55.
            (
                error,
                2.0 * moves(twin, position, reach_m(position)) + 32.0 * U,
            )
        }))
    };
    // Planted: x and z swapped.
    judge(
        "density of a sheet",
        points.len(),
        check(false),
        check(true),
    );
}

#[test]
fn a_sheets_depth_towards_the_sun_is_summed_along_the_way_there() {
    for elevation_deg in [90.0, 40.0, 3.0, -1.0] {
        let probe = SceneProbe::open(&sheet(elevation_deg), true);
        let points = places(10_000);
        let values = probe.ask(FieldQuestion::SunOpticalDepth, &points);
        let layer = &probe.world.layers()[0];
        let sun_steps = probe.world.scene().light().sun_steps();
        let check = |factor: f64| {
            worst(points.iter().zip(&values).map(|(point, value)| {
                let position = DVec3::from_array(wide(point[0]));
                let depth = |at: DVec3| sheet_sun_depth(&probe.world, layer, at, sun_steps);
                let exact = depth(position);
                // The altitude of a place 100 km away is known to some centimetres, as is the place.
                let moved = moves(depth, position, reach_m(position));
                let error = (f64::from(value[0][0]) - factor * exact).abs();
                (
                    error,
                    4.0 * moved + 64.0 * U * exact + 1e-6 * layer.extinction_per_m,
                )
            }))
        };
        // Planted: a hundredth more.
        judge(
            &format!("a sheet towards a sun at {elevation_deg}"),
            points.len(),
            check(1.0),
            check(1.01),
        );
    }
}
