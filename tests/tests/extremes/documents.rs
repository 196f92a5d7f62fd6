//! Numbers of the document at their ends that no other line walks: families and fields, light in clouds, clocks, drifts and
//! ways from one sky to another.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, difference, eye, ray, size, slab, small, weather};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::scene::Family;
use skycell_protocol::{Camera, Moment, Scene};
use skycell_server::march::MarchSettings;

fn up() -> Camera {
    eye([0.0, 2.0, 0.0], 100.0, 25.0, 60.0)
}

/// Every family with thick and thin layers; every pattern of every profile; periods at their ends.
pub(crate) fn fields(stage: &mut Stage) -> Line {
    let mut line = Line::new("families and fields");
    for family in Family::ALL {
        for renderer in [SCREEN, CACHED] {
            stage.scene(&weather(json!({"layers": [{"family": family.name()}]})));
            let picture = stage.look(up(), size(16, 9), renderer);
            line.picture(format!("{}, {renderer:?}", family.name()), &picture);
        }
    }
    let mut of_layer = |what: &str, density: Value| {
        stage.scene(&weather(json!({"layers": [{"density": density}]})));
        let picture = stage.look(up(), size(16, 9), SCREEN);
        line.picture(what, &picture);
    };
    for profile in ["low", "high"] {
        for pattern in ["puffs", "rolls", "ripples", "veils"] {
            for cloud_type in [0.0, 1.0] {
                of_layer(
                    &format!("{pattern}, {profile}, type {cloud_type}"),
                    json!({"model": "weather", "pattern": pattern, "profile": profile, "type": cloud_type, "coverage": 0.7}),
                );
            }
        }
    }
    for (key, ends) in [
        ("map_span_m", [1e3, 1e6]),
        ("shape_period_m", [100.0, 1e5]),
        ("detail_period_m", [10.0, 1e4]),
        ("detail_strength", [0.0, 1.0]),
    ] {
        for end in ends {
            of_layer(
                &format!("{key} {end}"),
                json!({"model": "weather", key: end}),
            );
        }
    }
    for (key, ends) in [
        ("map_span_m", [1e3, 1e6]),
        ("fibre_period_m", [1e3, 1e6]),
        ("fibres_towards_deg", [-360.0, 360.0]),
        ("coverage", [0.0, 1.0]),
        ("type", [0.0, 1.0]),
    ] {
        for end in ends {
            of_layer(
                &format!("sheet, {key} {end}"),
                json!({"model": "cirrus", "optical_depth": 3, key: end}),
            );
        }
    }
    line
}

/// Light in clouds: all that is absorbed, all of the sky's, the shortest and longest ways to the sun; phases and winds of
/// layers of their own.
pub(crate) fn light(stage: &mut Stage) -> Line {
    let mut line = Line::new("light of documents");
    for (what, patch) in [
        ("no ambient", json!({"light": {"ambient": 0}})),
        ("ten times the ambient", json!({"light": {"ambient": 10}})),
        (
            "a metre to the sun",
            json!({"light": {"sun_march_distance_m": 1, "sun_steps": 64}}),
        ),
        (
            "100 km to the sun",
            json!({"light": {"sun_march_distance_m": 1e5, "sun_steps": 1}}),
        ),
        (
            "no sun",
            json!({"sun": {"irradiance_w_per_m2_nm": [0, 0, 0]}}),
        ),
        (
            "a thousand suns",
            json!({"sun": {"irradiance_w_per_m2_nm": [1e4, 1e4, 1e4]}}),
        ),
        ("a black ground", json!({"planet": {"ground_albedo": 0}})),
        ("a white ground", json!({"planet": {"ground_albedo": 1}})),
        (
            "octaves with ten times the ambient",
            json!({"light": {"scattering": "octaves", "ambient": 10, "octaves": 16,
            "octave_contribution": 1}}),
        ),
    ] {
        stage.scene(&weather(patch));
        for renderer in [SCREEN, CACHED] {
            let picture = stage.look(up(), size(16, 9), renderer);
            line.picture(format!("{what}, {renderer:?}"), &picture);
        }
    }
    // Black clouds only take.
    for scattering in ["fitted", "octaves"] {
        stage.scene(&slab(
            json!({"light": {"scattering": scattering, "octaves": 8, "ambient": 10},
            "layers": [{"base_altitude_m": 1000, "top_altitude_m": 2000, "extinction_per_m": 1e-3,
                "single_scattering_albedo": 0, "density": {"model": "homogeneous"}}]}),
        ));
        let settings = MarchSettings {
            ambient: true,
            ..MarchSettings::plain(25)
        };
        let found = stage.rays(DVec3::ZERO, vec![ray([0.0; 3], [0.6, 0.8, 0.0])], settings);
        line.case();
        let layer = &found.layers[0][0];
        let light = layer.single + layer.octaves + layer.ambient;
        line.holds(format!("black clouds, {scattering}"), light.into(), 1e-30);
    }
    // A phase that both layers have of their own is the scene's, to the last bit; others have the extremes side by side.
    let layers = |phases: [Value; 2]| {
        let [low, high] = phases;
        json!([
            {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 2500, "phase": low},
            {"name": "high", "base_altitude_m": 4000, "top_altitude_m": 5000, "phase": high, "density": {"seed": 3, "model": "weather"}}
        ])
    };
    let sharp = |g: f64| json!({"model": "hg", "g": g});
    for renderer in [SCREEN, CACHED] {
        stage.scene(&weather(
            json!({"light": {"phase": sharp(0.8)}, "layers": layers([Value::Null, Value::Null])}),
        ));
        let of_scene = stage.look(up(), small(), renderer);
        stage.scene(&weather(
            json!({"light": {"phase": sharp(-0.2)}, "layers": layers([sharp(0.8), sharp(0.8)])}),
        ));
        let of_layers = stage.look(up(), small(), renderer);
        let what = format!("the same phase of layers and scene, {renderer:?}");
        line.picture(&what, &of_layers);
        line.holds(what, difference(&of_scene, &of_layers).0, 1e-30);
    }
    for phases in [
        [sharp(0.999), sharp(-0.999)],
        [json!({"model": "ice"}), json!({"model": "isotropic"})],
        [
            json!({"model": "draine", "g": -0.999, "alpha": 1e4}),
            json!({"model": "hg-draine", "droplet_diameter_um": 50}),
        ],
    ] {
        let what = format!("{phases:?}");
        stage.scene(&weather(json!({"layers": layers(phases)})));
        let into_the_sun = eye([0.0, 2.0, 0.0], 150.0, 40.0, 60.0);
        for renderer in [SCREEN, CACHED] {
            let picture = stage.look(into_the_sun, size(16, 9), renderer);
            line.picture(format!("{what}, {renderer:?}"), &picture);
        }
    }
    line
}

const NOW: &str = "2026-06-21T10:00:00Z";

/// The scene that a document is at some seconds after its epoch.
fn at(document: &Value, since_s: f64) -> Scene {
    let epoch = Moment::parse(NOW, "").expect("a date");
    let scene = Scene::from_json(document).expect("a scene");
    scene.at(epoch.plus_s(since_s))
}

/// Stopped clocks, transitions of no time and of a day, animations of one and of 64 keyframes, winds that blow back, and clouds
/// that were carried to the ends of the document.
pub(crate) fn timelines(stage: &mut Stage) -> Line {
    let mut line = Line::new("timelines");
    let shown = |stage: &mut Stage, line: &mut Line, what: &str, document: &Value, since_s: f64| {
        stage.show(at(document, since_s));
        let picture = stage.look(up(), size(16, 9), SCREEN);
        line.picture(format!("{what} after {since_s} s"), &picture);
        picture
    };
    let still = json!({"wind": {"speed_m_per_s": 0}});
    let merged = |patch: Value| super::stage::merged(weather(still.clone()), patch);
    // Nothing happens before the epoch of a stopped clock, and nothing after it has been stopped.
    let stopped = weather(
        json!({"time": {"epoch": NOW, "rate": 1e5, "wind_rate": -1e5, "paused_at": "2026-06-21T10:00:01Z"},
        "wind": {"speed_m_per_s": 200},
        "animation": [{"path": "/sun/elevation_deg", "keyframes": [{"at_s": 0, "value": 10}, {"at_s": 2e5, "value": 60}]}]}),
    );
    let at_stop = shown(stage, &mut line, "a clock stopped at 1 s", &stopped, 1.0);
    for since_s in [1.000_001, 2.0, 1e9] {
        let later = shown(
            stage,
            &mut line,
            "a clock stopped at 1 s",
            &stopped,
            since_s,
        );
        line.holds(
            format!("a clock stopped at 1 s, {since_s} s"),
            difference(&at_stop, &later).0,
            1e-30,
        );
    }
    // From one sky to another: it begins with the one and ends with the other, to the last bit.
    let old = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "sun": {"elevation_deg": 5},
        "layers": [{"name": "low", "density": {"model": "weather", "coverage": 0.9}}, {"name": "leaves", "base_altitude_m": 6000,
            "top_altitude_m": 7000, "density": {"model": "weather", "seed": 2}}]});
    let new = json!({"sun": {"elevation_deg": 70}, "layers": [{"name": "low", "density": {"model": "weather", "coverage": 0.2}},
        {"name": "comes", "base_altitude_m": 9000, "top_altitude_m": 9100, "density": {"model": "cirrus"}}]});
    let ends = [old.clone(), merged(new.clone())]
        .map(|end| shown(stage, &mut line, "an end of a transition", &end, 0.0));
    for duration_s in [0.0, 1e-3, 86_400.0] {
        let mut on_the_way = merged(new.clone());
        on_the_way["transition"] = json!({"began": NOW, "duration_s": duration_s, "from": old});
        for share in [-1e9, 0.0, 0.5, 1.0, 1e9] {
            let since_s = share * duration_s;
            let what = format!("{share} of a transition of {duration_s} s");
            let picture = shown(stage, &mut line, &what, &on_the_way, since_s);
            let end = match share {
                _ if duration_s == 0.0 || share >= 1.0 => Some(&ends[1]),
                _ if share <= 0.0 => Some(&ends[0]),
                _ => None,
            };
            if let Some(end) = end {
                line.holds(what, difference(end, &picture).0, 1e-30);
            }
        }
    }
    // Keyframes: one, as many as there may be, two at one moment, and turns of no length.
    let keys = |values: &[(f64, f64)], repeat: &str| {
        let keyframes: Vec<Value> = values
            .iter()
            .map(|(at_s, value)| json!({"at_s": at_s, "value": value, "ease": "smooth"}))
            .collect();
        merged(json!({"time": {"epoch": NOW}, "animation": [
            {"path": "/layers/0/density/coverage", "repeat": repeat, "keyframes": keyframes}]}))
    };
    let many: Vec<(f64, f64)> = (0..64)
        .map(|i| (f64::from(i) * 1e9, f64::from(i % 2)))
        .collect();
    for (what, document) in [
        ("one keyframe", keys(&[(5.0, 0.3)], "loop")),
        ("64 keyframes", keys(&many, "ping-pong")),
        (
            "a jump",
            keys(&[(0.0, 0.0), (10.0, 0.0), (10.0 + 1e-6, 1.0)], "none"),
        ),
        (
            "a loop of a microsecond",
            keys(&[(0.0, 0.2), (1e-6, 0.2)], "loop"),
        ),
    ] {
        for since_s in [-1e9, 0.0, 10.0, 1e9] {
            shown(stage, &mut line, what, &document, since_s);
        }
    }
    // Carried by whole periods of maps and noise (840 km together), clouds stand where they stood, to the last bit.
    let drifted = |east_m: f64, up_m: f64, south_m: f64| {
        merged(
            json!({"time": {"epoch": NOW}, "drift": {"since": NOW, "layers_m": {"low": [east_m, up_m, south_m]}}}),
        )
    };
    let here = shown(
        stage,
        &mut line,
        "not carried",
        &drifted(0.0, 0.0, 0.0),
        0.0,
    );
    let far_m = 1_190_476.0 * 840_000.0;
    let far = shown(
        stage,
        &mut line,
        "carried far",
        &drifted(far_m, 0.0, -far_m),
        0.0,
    );
    line.holds(
        "carried by a million periods",
        difference(&here, &far).0,
        1e-30,
    );
    for end_m in [-1e12, 1e12] {
        shown(
            stage,
            &mut line,
            "carried to the end",
            &drifted(end_m, end_m, end_m),
            0.0,
        );
    }
    line
}
