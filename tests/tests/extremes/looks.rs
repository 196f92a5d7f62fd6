//! What is shown and how: the night's lights, curves and exposures, and every view of what a picture is made of.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, difference, eye, settings, size, small, weather};
use serde_json::{Value, json};
use skycell_protocol::{Camera, Show};
use skycell_server::frame_loop::{StillPicture, StillSettings};

fn up() -> Camera {
    eye([0.0, 2.0, 0.0], 200.0, 30.0, 60.0)
}

/// Red, green and blue of all pixels, summed.
fn light_of(picture: &StillPicture) -> f64 {
    let pixels = picture.linear.chunks_exact(4);
    pixels.flat_map(|p| &p[..3]).map(|v| f64::from(*v)).sum()
}

/// Moons of every phase and place, and stars of every brightness, under a set sun and beside one that shines.
pub(crate) fn night(stage: &mut Stage) -> Line {
    let mut line = Line::new("night");
    let scene = |sun_deg: f64, moon: Value, stars: Value| {
        weather(json!({"sun": {"elevation_deg": sun_deg}, "moon": moon, "stars": stars}))
    };
    // The fuller the moon, the more light; behind the planet there is none.
    for elevation_deg in [-90.0, -0.3, 0.0, 35.0, 90.0] {
        let mut before = f64::INFINITY;
        for phase_angle_deg in [0.0, -90.0, 179.999, -180.0] {
            let moon = json!({"azimuth_deg": 200, "elevation_deg": elevation_deg, "phase_angle_deg": phase_angle_deg});
            stage.scene(&scene(-90.0, moon, Value::Null));
            let what = format!("moon at {elevation_deg}°, phase {phase_angle_deg}°");
            let camera = eye([0.0, 2.0, 0.0], 200.0, elevation_deg, 20.0);
            let picture = stage.look(camera, size(16, 9), SCREEN);
            line.picture(&what, &picture);
            let light = light_of(&picture);
            line.is(
                format!("{what}: {light:e} after {before:e}"),
                light <= before,
            );
            before = light;
        }
    }
    // By day it changes clouds and air by no bit: one light at a time.
    stage.scene(&scene(40.0, Value::Null, Value::Null));
    let day = stage.look(up(), small(), CACHED);
    let moon = json!({"azimuth_deg": 20, "elevation_deg": 35, "phase_angle_deg": 0});
    stage.scene(&scene(40.0, moon, Value::Null));
    let moon_behind = stage.look(up(), small(), CACHED);
    line.picture("a full moon by day, out of sight", &moon_behind);
    line.holds(
        "a full moon by day, out of sight",
        difference(&day, &moon_behind).0,
        1e-30,
    );
    // The light of stars is as many times theirs as the document says.
    let stars = |brightness: f64, latitude_deg: f64, turn_deg: f64| {
        let stars =
            json!({"brightness": brightness, "latitude_deg": latitude_deg, "turn_deg": turn_deg});
        let mut scene = scene(-90.0, Value::Null, stars);
        scene["layers"] = json!([]);
        scene
    };
    for (latitude_deg, turn_deg) in [(90.0, 0.0), (-90.0, 1e6), (0.0, -1e6), (50.0, 360.0)] {
        let [none, one, thousand] = [0.0, 1.0, 1e3].map(|brightness| {
            stage.scene(&stars(brightness, latitude_deg, turn_deg));
            let picture = stage.look(up(), size(64, 36), SCREEN);
            let what = format!("stars {brightness} at {latitude_deg}°, {turn_deg}°");
            line.picture(what, &picture);
            light_of(&picture)
        });
        line.holds("no stars", none, 1e-30);
        line.is("there are stars", one > 0.0);
        // Each is one product more; the smallest are no normal numbers.
        line.holds(
            format!("a thousandfold stars at {latitude_deg}°, {turn_deg}°"),
            (thousand / 1e3 / one - 1.0).abs(),
            1e-5,
        );
    }
    line
}

/// Every curve at the ends of exposure, by hand and by the light that is there: black at one end, white at the other, and the
/// light itself untouched.
pub(crate) fn tone(stage: &mut Stage) -> Line {
    let mut line = Line::new("tone");
    // All that is seen shines: with a floor of light in every channel, the brightest exposure is white everywhere.
    let scene = |curve: &str, exposure_ev: f64, auto: Value| {
        weather(
            json!({"exposure_ev": exposure_ev, "tone": {"curve": curve, "auto_exposure": auto}}),
        )
    };
    stage.scene(&scene("aces", 0.0, Value::Null));
    let plain = stage.look(up(), small(), SCREEN);
    for curve in ["aces", "agx", "neutral"] {
        let mut middle = f64::NEG_INFINITY;
        for exposure_ev in [-30.0, -8.0, 0.0, 4.0, 30.0] {
            let what = format!("{curve} at {exposure_ev} EV");
            stage.scene(&scene(curve, exposure_ev, Value::Null));
            let picture = stage.look(up(), small(), SCREEN);
            line.picture(&what, &picture);
            line.holds(
                format!("{what}: its light"),
                difference(&plain, &picture).0,
                1e-30,
            );
            let rgb = || picture.display.chunks_exact(4).flat_map(|p| &p[..3]);
            let mean = rgb().map(|v| f64::from(*v)).sum::<f64>() / (3.0 * 32.0 * 18.0);
            line.is(
                format!("{what}: {mean} after {middle}, brighter"),
                mean > middle,
            );
            middle = mean;
            let [darkest, brightest] = [rgb().min(), rgb().max()].map(|v| v.copied().unwrap_or(0));
            if exposure_ev == -30.0 {
                line.holds(format!("{what}: black"), brightest.into(), 1.0);
            }
            if exposure_ev == 30.0 {
                line.holds(format!("{what}: white"), f64::from(255 - darkest), 1.0);
            }
        }
        // Bounds that leave one exposure are that exposure, noon and night.
        for (ev, sun_deg) in [(-30.0, 40.0), (0.0, 40.0), (30.0, -90.0)] {
            let auto = json!({"min_ev": ev, "max_ev": ev, "adaptation_s": 0});
            let what = format!("{curve}, automatic at {ev} EV, sun at {sun_deg}°");
            let sun = json!({"sun": {"elevation_deg": sun_deg}});
            let merged =
                |auto, by_hand| super::stage::merged(scene(curve, by_hand, auto), sun.clone());
            stage.scene(&merged(auto, 0.0));
            let automatic = stage.look(up(), size(16, 9), CACHED);
            line.picture(&what, &automatic);
            stage.scene(&merged(Value::Null, ev));
            let by_hand = stage.look(up(), size(16, 9), CACHED);
            let apart = automatic.display.iter().zip(&by_hand.display);
            let worst = apart.map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0);
            // Two factors instead of one: a rounding, which may be a byte at its edge.
            line.holds(what, worst.into(), 1.0);
        }
    }
    line
}

/// Every view, where it can be seen, from below and above; and of a sky without clouds.
pub(crate) fn views(stage: &mut Stage) -> Line {
    let mut line = Line::new("views");
    let from =
        |altitude_m: f64, pitch_deg: f64| eye([0.0, altitude_m, 0.0], 200.0, pitch_deg, 60.0);
    let mut look = |stage: &mut Stage, name: &str, show: Show, camera: Camera, what: &str| {
        let settings = StillSettings {
            show,
            ..settings(if show.is_of_cache() { CACHED } else { SCREEN })
        };
        let picture = stage.look_with(camera, size(16, 9), &settings);
        line.case();
        // Views of values have -1 where there is none.
        let good = |value: f32| (value >= 0.0 && value.is_finite()) || value == -1.0;
        let bad = picture.linear.iter().find(|value| !good(**value));
        line.is(
            format!("{name}, {what}: a value is {bad:?}"),
            bad.is_none() && !picture.linear.is_empty(),
        );
        let is_opaque = picture.display.chunks_exact(4).all(|p| p[3] == 255);
        line.is(format!("{name}, {what}: opaque"), is_opaque);
    };
    stage.scene(&weather(json!({"layers": [{"family": "cumulus"}]})));
    for (name, show) in Show::ALL {
        look(stage, name, show, from(2.0, 30.0), "from the ground");
        if !show.is_of_cache() {
            look(stage, name, show, from(4e5, -60.0), "from orbit");
        }
    }
    stage.scene(&weather(json!({"layers": []})));
    for (name, show) in Show::ALL {
        look(stage, name, show, from(2.0, 30.0), "without clouds");
    }
    line
}
