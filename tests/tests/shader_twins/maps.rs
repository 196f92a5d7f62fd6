//! Maps from files and on their way to others, and noise that rises.
//!
//! Budgets of reads are those of `density.rs`.

use super::density::{SPAN_M, moves, places, reach_m};
use super::support::{SceneProbe, judge, noise_dir};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::Scene;
use skycell_reference::{LayerField, WeatherMaps};
use skycell_server::field::{FieldStore, GreyMap, MapFileFormat};
use skycell_server::probe::{FieldPoint, FieldQuestion};
use skycell_server::truth::reference_field;
use skycell_tests::numbers::{Random, U, wide, worst};

/// A scene whose first layer has these maps.
fn with_maps(maps: Value) -> Value {
    json!({"version": 1, "layers": [{"density":
        {"model": "weather", "coverage": 0.6, "detail_strength": 0.5, "maps": maps}}]})
}

fn write(name: &str, map: &GreyMap, format: MapFileFormat) {
    let folder = noise_dir();
    std::fs::create_dir_all(&folder).expect("a folder");
    let bytes = map.encode(format).expect("a file");
    // By a name of its own first: whoever reads the map meanwhile finds the old one or the new one.
    let whole = tempfile::NamedTempFile::new_in(&folder).expect("a file");
    std::fs::write(whole.path(), bytes).expect("written");
    whole.persist(folder.join(name)).expect("renamed");
}

fn random_map(seed: u64, width: u32, height: u32, levels: f64) -> GreyMap {
    let mut random = Random(seed);
    GreyMap {
        width,
        height,
        values: (0..width * height)
            .map(|_| ((random.unit() * levels).round() / levels) as f32)
            .collect(),
    }
}

fn maps_of(document: &Value) -> WeatherMaps {
    let scene = Scene::from_json(document).expect("valid");
    let field = reference_field(&scene, &noise_dir(), &noise_dir()).expect("data");
    match field.layers.into_iter().next() {
        Some(LayerField::Weather(maps)) => maps,
        other => panic!("a weather layer has maps: {other:?}"),
    }
}

/// What the device's texture may round by: coverage and type, and skips.
type Digits = [f64; 2];
const NONE: Digits = [0.0; 2];

/// The worst of coverage, type and skip as the device has them at places, in units of the bound.
fn map_error(probe: &SceneProbe, twin: &WeatherMaps, points: &[FieldPoint], digits: Digits) -> f64 {
    let values = probe.ask(FieldQuestion::Density, points);
    worst(points.iter().zip(&values).flat_map(|(point, value)| {
        let position = DVec3::from_array(wide(point[0]));
        [
            (&twin.coverage, digits[0]),
            (&twin.cloud_type, digits[0]),
            (&twin.skip, digits[1]),
        ]
        .into_iter()
        .zip(value[1])
        .map(|((map, digits), value)| {
            let exact = |at: DVec3| map.repeated(at.x / SPAN_M, at.z / SPAN_M);
            let error = (f64::from(value) - exact(position)).abs();
            let reach = 2.0 * moves(exact, position, reach_m(position));
            (error, reach + 16.0 * U + digits)
        })
        .collect::<Vec<_>>()
    }))
}

#[test]
fn maps_of_sixteen_bits_are_read_with_eleven_digits_or_more() {
    write(
        "twin-deep.png",
        &random_map(21, 512, 256, 65_535.0),
        MapFileFormat::Png,
    );
    write(
        "twin-deep.exr",
        &random_map(22, 3, 700, 1e6),
        MapFileFormat::Exr,
    );
    let document = with_maps(json!({"coverage": "twin-deep.png", "type": "twin-deep.exr"}));
    let probe = SceneProbe::open(&document, true);
    let points = places(12_000);
    let twin = maps_of(&document);
    // What the truth reads is what the device reads, to the last digit; of the files it keeps eleven.
    let error = map_error(&probe, &twin, &points, NONE);
    let store = FieldStore::new(Some(noise_dir()));
    let read = |file, kind| store.map_file(&noise_dir(), file, kind).expect("a map");
    let drawn = read("twin-deep.png", skycell_protocol::scene::MapKind::Coverage);
    let side = skycell_server::field::MAP_SIZE as usize;
    for (index, texel) in drawn.iter().enumerate().step_by(97) {
        let exact = f64::from(*texel) / 65_535.0;
        let stored = twin
            .coverage
            .texel_repeated((index % side) as i64, (index / side) as i64);
        assert!((stored - exact).abs() <= exact * 2f64.powi(-11) + 2f64.powi(-25));
    }
    // Planted: eight bits.
    let bytes = twin.stored(|value| (value * 255.0).round() / 255.0);
    judge(
        "maps of 16 bits",
        points.len(),
        error,
        map_error(&probe, &bytes, &points, NONE),
    );
}

#[test]
fn maps_on_their_way_are_a_linear_mix_with_skips_that_suit_both() {
    let mut spots = random_map(23, 64, 64, 255.0);
    for value in &mut spots.values {
        *value = if *value > 0.97 { 1.0 } else { 0.0 };
    }
    write("twin-spots.png", &spots, MapFileFormat::Png);
    // As large as the device's maps, so that nothing is interpolated and bytes stay bytes.
    let bytes = random_map(25, 1024, 1024, 255.0);
    write("twin-bytes.png", &bytes, MapFileFormat::Png);
    for (what, file, digits) in [
        // Half a 255th; eleven digits, whatever way the driver rounds.
        ("blend in bytes", "twin-bytes.png", [0.5 / 255.0, 0.0]),
        // The old skips were 255ths and are 256ths now.
        (
            "blend in halves",
            "twin-spots.png",
            [2f64.powi(-11), 1.0 / 256.0],
        ),
    ] {
        let to = with_maps(json!({"coverage": file, "transition_s": 100}));
        let mut probe = SceneProbe::open(&with_maps(json!({})), true);
        let scene = Scene::from_json(&to).expect("valid");
        let points = places(10_000);
        // To a quarter of the way, then on to three quarters.
        for share in [0.25, 0.75] {
            probe
                .device
                .change_maps(&scene, 50.0 * (share + 0.25), &noise_dir())
                .expect("a pass");
            let twin = |share: f64| {
                let from = maps_of(&with_maps(json!({})));
                from.blended(&maps_of(&to), share)
            };
            judge(
                &format!("{what}, {share}"),
                points.len(),
                map_error(&probe, &twin(share), &points, digits),
                map_error(&probe, &twin(1.0 - share), &points, digits),
            );
        }
        // And the new ones alone, at the end.
        probe
            .device
            .change_maps(&scene, 30.0, &noise_dir())
            .expect("a pass");
        let error = map_error(&probe, &maps_of(&to), &points, digits);
        assert!(error <= 1.0, "{what}, ended: {error}");
    }
}

#[test]
fn a_blend_that_is_replaced_midway_goes_on_from_where_it_is() {
    write(
        "twin-bytes.png",
        &random_map(25, 1024, 1024, 255.0),
        MapFileFormat::Png,
    );
    let first = with_maps(json!({"coverage": "twin-bytes.png", "transition_s": 100}));
    let mut second = with_maps(json!({"transition_s": 100}));
    second["layers"][0]["density"]["seed"] = json!(5);
    let mut probe = SceneProbe::open(&with_maps(json!({})), true);
    let mut change = |document: &Value, passed_s: f64| {
        let scene = Scene::from_json(document).expect("valid");
        probe
            .device
            .change_maps(&scene, passed_s, &noise_dir())
            .expect("a pass");
    };
    change(&first, 40.0);
    // Another sky is asked for at 40 s: nothing jumps at that moment …
    change(&second, 0.0);
    let midway = maps_of(&with_maps(json!({}))).blended(&maps_of(&first), 0.4);
    let points = places(10_000);
    // Two roundings to bytes; skips are new ones, which suit the mix and the third sky.
    let digits = [1.0 / 255.0, 1.0];
    let third = maps_of(&second);
    let error = map_error(&probe, &midway, &points, digits);
    judge(
        "replaced midway",
        points.len(),
        error,
        map_error(&probe, &third, &points, digits),
    );
}

#[test]
fn noise_that_has_risen_stands_higher_and_periods_do_not_matter() {
    let points = places(12_000);
    let scene = |evolution_m_per_s: f64| {
        json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [{"density": {"model": "weather",
            "coverage": 0.6, "detail_strength": 0.5, "detail_period_m": 500, "evolution_m_per_s": evolution_m_per_s}}]})
    };
    // 1000 s at 5 m/s are one period of the shape and ten of the detail: the same clouds.
    for (what, speed, time_s, planted) in [
        ("noise 137 m up", 1.0, 137.0, 0.0),
        ("noise a period up", 5.0, 1000.0, 137.0),
        ("noise 30 days up", 0.37, 2_592_000.0, 0.0),
    ] {
        let probe = SceneProbe::open_at(&scene(speed), true, time_s);
        let values = probe.ask(FieldQuestion::Density, &points);
        let check = |late_s: f64| {
            let world = SceneProbe::world_at(&scene(speed), time_s + late_s);
            let layer = &world.layers()[0];
            worst(points.iter().zip(&values).map(|(point, value)| {
                let position = DVec3::from_array(wide(point[0]));
                let twin = |at: DVec3| world.density(layer, at, f64::from(point[0][3]));
                let error = (f64::from(value[0][0]) - twin(position)).abs();
                let bound = 2.0 * moves(twin, position, reach_m(position)) + 240.0 * U;
                (error, bound)
            }))
        };
        judge(what, points.len(), check(0.0), check(planted + 10.0));
    }
}
