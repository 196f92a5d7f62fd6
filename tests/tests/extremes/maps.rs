//! Maps of any size, any constant, any number of bits, and on their way to others; noise that rises for months.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, difference, eye, small, weather};
use super::truth::{compare, compare_with, compare_within};
use serde_json::{Value, json};
use skycell_protocol::Scene;
use skycell_reference::{Approximations, LayerField, World, WorldSettings};
use skycell_server::field::{FieldStore, GreyMap, MapFileFormat, check_maps};
use skycell_server::truth::reference_field;
use skycell_tests::server::target_dir;
use std::sync::Arc;

fn write(stage: &Stage, name: &str, width: u32, height: u32, value: impl Fn(u32, u32) -> f32) {
    let map = GreyMap {
        width,
        height,
        values: (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| value(x, y))
            .collect(),
    };
    let format = if name.ends_with("png") {
        MapFileFormat::Png
    } else {
        MapFileFormat::Exr
    };
    let bytes = map.encode(format).expect("a file");
    std::fs::write(stage.grids_dir.join(name), bytes).expect("written");
}

fn with_maps(maps: Value) -> Value {
    weather(json!({"wind": {"speed_m_per_s": 0},
        "layers": [{"density": {"model": "weather", "maps": maps}}]}))
}

/// Stripes and spots of every size.
fn drawn(x: u32, y: u32) -> f32 {
    let cell = |n: u32| ((x / n) * 7919 + (y / n) * 104_729) % 1013;
    (cell(1) + cell(16) + cell(256)) as f32 / (3.0 * 1012.0)
}

/// How well f32 knows a place in the field of a map of 40 km: 8 U (|p| + period), see `shader_twins`.
const PLACE_M: f64 = 0.03;

fn up() -> skycell_protocol::Camera {
    eye([0.0, 2.0, 0.0], 100.0, 25.0, 60.0)
}

pub(crate) fn any(stage: &mut Stage) -> Line {
    let mut line = Line::new("maps");
    write(stage, "one.png", 1, 1, |_, _| 1.0);
    write(stage, "none.png", 1, 1, |_, _| 0.0);
    write(stage, "deep.exr", 1, 1, |_, _| 0.437_219);
    write(stage, "row.png", 8192, 1, drawn);
    write(stage, "column.exr", 1, 8192, drawn);
    write(stage, "large.png", 3000, 2000, drawn);
    write(stage, "full.png", 1024, 1024, drawn);
    for file in [
        "one.png",
        "none.png",
        "deep.exr",
        "row.png",
        "column.exr",
        "large.png",
        "full.png",
    ] {
        for kind in ["coverage", "type", "profile"] {
            let scene = with_maps(json!({kind: file}));
            stage.scene(&scene);
            let cached = stage.look(up(), small(), CACHED);
            line.picture(format!("{kind} {file}, cached"), &cached);
            let what = format!("{kind} {file}");
            if (kind, file) == ("profile", "large.png") {
                // Its profile is another one every 2.4 m of altitude and, by the type map, every few metres sideways.
                compare_within(stage, &mut line, &what, &scene, up(), PLACE_M);
            } else {
                compare(stage, &mut line, &what, &scene, up());
            }
        }
    }
    line
}

pub(crate) fn blends(stage: &mut Stage) -> Line {
    let mut line = Line::new("maps on their way");
    stage.at_time(0.0);
    write(stage, "full.png", 1024, 1024, drawn);
    write(stage, "one.png", 1, 1, |_, _| 1.0);
    // At 0 it is the old sky (but for what bytes lose in halves, beside maps of 16 bits), at the end and ever after the
    // new one; in between neither.
    for (file, is_bytes) in [("full.png", false), ("one.png", true)] {
        let new = with_maps(json!({"coverage": file, "profile": file}));
        let on_the_way = with_maps(json!({"coverage": file, "profile": file, "transition_s": 10}));
        stage.scene(&new);
        let after = stage.look(up(), small(), SCREEN);
        stage.scene(&with_maps(json!({})));
        let before = stage.look(up(), small(), SCREEN);
        stage.scene(&on_the_way);
        for (time_s, like) in [
            (0.0, is_bytes.then_some(&before)),
            (1e-6, None),
            (5.0, None),
            (10.0, Some(&after)),
            (1e9, Some(&after)),
        ] {
            stage.at_time(time_s);
            let picture = stage.look(up(), small(), SCREEN);
            line.picture(format!("{file} at {time_s} s"), &picture);
            let (worst, largest) = difference(&picture, like.unwrap_or(&picture));
            // Shorter skips lead to the same samples, but for a unit in the last place of their steps: millimetres.
            line.holds(
                format!("{file} at {time_s} s is not what it should be"),
                worst,
                1e-3 * largest,
            );
            if time_s == 5.0 {
                for (name, end) in [("old", &before), ("new", &after)] {
                    let (worst, largest) = difference(&picture, end);
                    line.is(
                        format!("{file} at {time_s} s is the {name} sky"),
                        worst > 0.01 * largest,
                    );
                }
            }
        }
        stage.at_time(0.0);
    }
    line
}

/// A quarter of the way, against the f64 reference with the same mix.
pub(crate) fn mixed(stage: &mut Stage) -> Line {
    let mut line = Line::new("maps on their way, mixed");
    stage.at_time(0.0);
    write(stage, "bytes.png", 1024, 1024, |x, y| {
        (drawn(x, y) * 255.0).round() / 255.0
    });
    let new = json!({"coverage": "bytes.png", "type": "bytes.png", "transition_s": 8});
    let (old, new) = (with_maps(json!({})), with_maps(new));
    stage.scene(&old);
    stage.scene(&new);
    // Not a simple fraction: a quarter of the way from byte to byte is often half-way between two bytes, and which of them it
    // becomes is chance.
    let share = 0.248_371;
    stage.at_time(8.0 * share);
    let world = blended_world(stage, &old, &new, share);
    compare_with(stage, &mut line, "a quarter of the way", &world, up());
    stage.at_time(1e3);
    stage.scene(&old);
    stage.at_time(0.0);
    line
}

fn blended_world(stage: &Stage, old: &Value, new: &Value, share: f64) -> World {
    let noise = target_dir().expect("a folder").join("noise-of-tests");
    let scenes = [old, new].map(|document| Scene::from_json(document).expect("valid"));
    let [mut old, new] =
        [0, 1].map(|i| reference_field(&scenes[i], &noise, &stage.grids_dir).expect("data"));
    if let (Some(LayerField::Weather(from)), Some(LayerField::Weather(to))) =
        (old.layers.first().cloned(), new.layers.first())
    {
        let stored = |value: f64| (value * 255.0).round() / 255.0;
        old.layers[0] = LayerField::Weather(from.blended(to, share).stored(stored));
    }
    let settings = WorldSettings {
        approximations: Approximations::ALL,
        ..WorldSettings::default()
    };
    World::new(&scenes[0], Arc::new(old), settings).expect("a world")
}

pub(crate) fn refused(stage: &mut Stage) -> Line {
    let mut line = Line::new("files that are no maps");
    let store = FieldStore::new(None);
    for (name, value, told) in [
        ("nan.exr", f32::NAN, "NaN"),
        ("inf.exr", f32::INFINITY, "inf"),
        ("minus.exr", -f32::MIN_POSITIVE, "column 1, row 1"),
        ("above.exr", 1.0f32.next_up(), "1.0000001"),
    ] {
        write(
            stage,
            name,
            2,
            2,
            |x, y| if x + y == 2 { value } else { 0.5 },
        );
        let scene = Scene::from_json(&with_maps(json!({"type": name}))).expect("valid");
        let error = check_maps(&scene, &store, &stage.grids_dir)
            .map_or_else(|error| error.to_string(), |()| "taken".into());
        line.case();
        line.is(format!("{told} in {error:?}"), error.contains(told));
    }
    line
}

pub(crate) fn evolution(stage: &mut Stage) -> Line {
    let mut line = Line::new("evolution");
    stage.at_time(0.0);
    let scene = |evolution_m_per_s: f64| {
        weather(json!({"wind": {"speed_m_per_s": 0},
            "layers": [{"density": {"model": "weather", "evolution_m_per_s": evolution_m_per_s,
                "detail_period_m": 500}}]}))
    };
    for speed in [-50.0, -1e-9, 0.0, 50.0] {
        stage.scene(&scene(speed));
        stage.at_time(2_592_000.0);
        let picture = stage.look(up(), small(), SCREEN);
        line.picture(format!("{speed} m/s for 30 days"), &picture);
        stage.at_time(0.0);
    }
    // 100 periods of the shape in a day: the same sky as at first.
    stage.scene(&scene(0.0));
    let first = stage.look(up(), small(), SCREEN);
    stage.scene(&scene(5000.0 / 864.0));
    stage.at_time(86_400.0);
    let later = stage.look(up(), small(), SCREEN);
    stage.at_time(0.0);
    line.picture("100 periods", &later);
    let (worst, largest) = difference(&first, &later);
    line.holds("100 periods of the noise", worst, 2e-3 * largest);
    line
}
