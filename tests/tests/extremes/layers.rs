//! Layers without thickness, in one another, empty and solid, none and four; seen from below, between and above.

use super::line::Line;
use super::stage::{
    CACHED, SCREEN, Stage, difference, eye, pixel, ray, size, slab, small, weather,
};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::{Moment, Scene};
use skycell_server::march::MarchSettings;
use skycell_tests::numbers::U;

const NOW: &str = "2026-06-21T12:00:00Z";

fn full(name: &str, base_m: f64, top_m: f64, extinction_per_m: f64, albedo: f64) -> Value {
    json!({"name": name, "base_altitude_m": base_m, "top_altitude_m": top_m, "extinction_per_m": extinction_per_m,
        "single_scattering_albedo": albedo, "density": {"model": "homogeneous"}})
}

pub(crate) fn any(stage: &mut Stage) -> Line {
    let mut line = Line::new("layers");
    let up = || eye([0.0, 2.0, 0.0], 0.0, 30.0, 60.0);
    // What shows nothing leaves the picture as it is without layers, to the last bit.
    stage.scene(&weather(json!({"layers": []})));
    let clear = [SCREEN, CACHED].map(|renderer| stage.look(up(), small(), renderer));
    let thin = 1500.0f64;
    for (what, layer) in [
        (
            "no thickness",
            json!({"base_altitude_m": thin, "top_altitude_m": thin}),
        ),
        (
            "one ulp of f64 thick",
            json!({"base_altitude_m": thin, "top_altitude_m": thin.next_up()}),
        ),
        ("no extinction", json!({"extinction_per_m": 0})),
        (
            "no coverage",
            json!({"density": {"model": "weather", "coverage": 0}}),
        ),
    ] {
        stage.scene(&weather(json!({"layers": [layer]})));
        for (renderer, clear) in [SCREEN, CACHED].into_iter().zip(&clear) {
            let picture = stage.look(up(), small(), renderer);
            line.picture(format!("{what}, {renderer:?}"), &picture);
            let (apart, _) = difference(clear, &picture);
            line.holds(format!("{what}, {renderer:?}: against none"), apart, 1e-30);
        }
    }
    // One ulp of f32 thick and as solid as can be: still only the step that a ray may take in it.
    let thin32 = f64::from(1500.0f32.next_up());
    stage.scene(&weather(
        json!({"layers": [full("sheet", thin, thin32, 1e3, 1.0)]}),
    ));
    let picture = stage.look(up(), small(), SCREEN);
    line.picture("one ulp of f32 thick", &picture);

    // A layer that fills everything is as thick as it is, however far wind has carried it.
    for east_m in [0.0, 1e12] {
        let scene = slab(
            json!({"layers": [full("all", 1000.0, 2000.0, 1e-3, 1.0)], "time": {"epoch": NOW},
            "drift": {"since": NOW, "layers_m": {"all": [east_m, 0.0, -east_m]}}}),
        );
        let now = Moment::parse(NOW, "now").expect("a moment");
        stage.show(Scene::from_json(&scene).expect("valid").at(now));
        let found = stage.rays(
            DVec3::ZERO,
            vec![
                ray([0.0; 3], [0.0, 1.0, 0.0]),
                ray([0.0; 3], [0.0, 0.5, 0.75f64.sqrt()]),
            ],
            MarchSettings::plain(25),
        );
        // Straight up by whole steps; at a slant the last one goes beyond the layer.
        let exact = [(1.0, 64.0 * U), (2.0, 2.0 / 25.0)];
        for (found, (depth, bound)) in found.layers[0].iter().zip(exact) {
            line.case();
            line.holds(
                format!("carried by {east_m} m: an optical depth of {depth}"),
                (f64::from(found.optical_depth) - depth).abs(),
                bound,
            );
        }
    }

    // Layers in one another and of all alike: transmittances multiply.
    for count in [2, 3, 4u32] {
        let layers: Vec<Value> = (0..count)
            .map(|i| full(&format!("layer {i}"), 1000.0, 2000.0, 1e-3, 1.0))
            .collect();
        stage.scene(&slab(json!({"layers": layers})));
        let found = stage.rays(
            DVec3::ZERO,
            vec![ray([0.0; 3], [0.0, 1.0, 0.0])],
            MarchSettings::plain(25),
        );
        line.case();
        let product: f64 = found
            .layers
            .iter()
            .map(|layer| f64::from(layer[0].transmittance))
            .product();
        let exact = (-f64::from(count)).exp();
        line.holds(
            format!("{count} layers in one another"),
            (product / exact - 1.0).abs(),
            256.0 * U,
        );
        for layer in &found.layers {
            line.layer(
                format!("{count} layers in one another"),
                &layer[0],
                0.0,
                0.0,
            );
        }
    }
    // A black, solid layer over and under a white one: what is nearer hides what is behind it, from either side.
    for (what, altitude_m, pitch_deg, black_low, dark) in [
        ("black below white, from below", 0.0, 90.0, true, true),
        ("black below white, from above", 9_000.0, -90.0, true, false),
    ] {
        let [low, high] = if black_low { [0.0, 1.0] } else { [1.0, 0.0] };
        let layers = json!([
            full("low", 1000.0, 2000.0, 1.0, low),
            full("high", 3000.0, 4000.0, 1.0, high)
        ]);
        // From below the sun stands below, which only a flat world allows: so that what is near is lit.
        let elevation_deg = if altitude_m > 0.0 { 90.0 } else { -90.0 };
        stage.scene(&slab(
            json!({"layers": layers, "sun": {"elevation_deg": elevation_deg}}),
        ));
        let picture = stage.look(
            eye([0.0, altitude_m, 0.0], 0.0, pitch_deg, 10.0),
            size(8, 8),
            SCREEN,
        );
        line.picture(what, &picture);
        // Opaque: e^-1000 of what is behind. White returns a good part of 1 / 4π, black nothing.
        let seen = pixel(&picture, 2, 2)[0];
        line.is(
            format!("{what}: {seen}"),
            if dark { seen < 1e-6 } else { seen > 1e-3 },
        );
    }
    line
}
