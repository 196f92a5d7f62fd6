//! Clocks at their ends: any place, any date, backwards, standing and racing.

use super::line::Line;
use super::stage::{SCREEN, Stage, difference, eye, small, weather};
use serde_json::json;
use skycell_protocol::{Moment, Scene};

const NOW: &str = "2026-06-21T10:00:00Z";

/// Latitude, longitude, date at sky time 0, sky time at the epoch, rate, seconds since the epoch.
type Clock = (f64, f64, &'static str, f64, f64, f64);

const CLOCKS: [Clock; 12] = [
    (90.0, 0.0, "2026-12-21T00:00:00Z", 0.0, 1.0, 0.0),
    (90.0, 0.0, "2026-06-21T00:00:00Z", 0.0, 1.0, 2_592_000.0),
    (-90.0, 180.0, "2026-12-21T00:00:00Z", 0.0, -1.0, 2_592_000.0),
    (66.56, -180.0, "1900-01-01T00:00:00Z", 0.0, 0.0, 1e9),
    (-66.56, 12.0, "2100-12-31T23:59:59Z", -1e11, 1.0, 0.0),
    (0.0, 0.0, "2026-03-20T12:00:00Z", 1e11 - 1.0, 1.0, 1.0),
    (0.0, 0.0, "2026-03-20T12:07:00Z", 0.0, 1e4, 2_592_000.0),
    (47.0, 8.0, "2026-09-01T05:00:00Z", 0.0, 1e5, 2_592_000.0),
    (47.0, 8.0, "2026-09-01T05:00:00Z", 0.0, -1e5, 1e9),
    (47.0, 8.0, "2026-09-01T05:00:00Z", -3600.0, 24.0, -1e9),
    (23.44, 0.0, "2026-06-21T12:02:00Z", 0.0, 1.0, 0.0),
    (51.0, 0.0, "2026-06-21T03:43:00Z", 0.0, 1.0, 1e-6),
];

/// The sky of a moment is that of the same numbers set by hand, and can be shown.
pub(crate) fn any_clock(stage: &mut Stage) -> Line {
    let mut line = Line::new("time");
    let epoch = Moment::parse(NOW, "").expect("a date");
    for (latitude_deg, longitude_deg, date, start_s, rate, since_s) in CLOCKS {
        let what = format!("{latitude_deg}°, {date}, {start_s} s + {rate} × {since_s} s");
        let place =
            json!({"latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "date": date});
        let moving = weather(json!({
            "sun": {"place_and_time": place},
            "time": {"epoch": NOW, "sky_s_at_epoch": start_s, "rate": rate},
            "wind": {"speed_m_per_s": 0},
            "animation": [{"path": "/layers/0/density/coverage", "repeat": "ping-pong", "keyframes": [
                {"at_s": -1e11, "value": 0}, {"at_s": 0, "value": 1}, {"at_s": 1e11, "value": 0.5}]}]
        }));
        let scene = Scene::from_json(&moving).expect("a scene");
        let shown = scene.at(epoch.plus_s(since_s));
        let camera = eye([0.0, 2.0, 0.0], shown.sun().azimuth_deg(), 10.0, 60.0);
        stage.show(shown.clone());
        let picture = stage.look(camera, small(), SCREEN);
        line.picture(&what, &picture);
        // By hand, from the document of the moment.
        stage.scene(&serde_json::to_value(shown.to_document()).expect("serialises"));
        let by_hand = stage.look(camera, small(), SCREEN);
        line.holds(what, difference(&picture, &by_hand).0, 1e-30);
    }
    line
}
