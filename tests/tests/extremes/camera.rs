//! Cameras on the ground, on the boundaries of a layer, inside, above and in orbit; straight up and down; any angle of view.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, small, weather};
use serde_json::json;

const BASE_M: f32 = 1500.0;
const TOP_M: f32 = 4000.0;

pub(crate) fn anywhere(stage: &mut Stage) -> Line {
    let mut line = Line::new("camera");
    stage.scene(&weather(
        json!({"layers": [{"base_altitude_m": BASE_M, "top_altitude_m": TOP_M}]}),
    ));
    let mut look = |stage: &mut Stage,
                    altitude_m: f64,
                    yaw_deg: f64,
                    pitch_deg: f64,
                    fov_deg: f64,
                    renderer| {
        let camera = eye([0.0, altitude_m, 0.0], yaw_deg, pitch_deg, fov_deg);
        let picture = stage.look(camera, small(), renderer);
        line.picture(
            format!("{renderer:?} at {altitude_m} m, {pitch_deg}° up, view of {fov_deg}°"),
            &picture,
        );
    };
    let altitudes_m = [
        0.0,
        1e-6,
        2.0,
        f64::from(BASE_M.next_down()),
        f64::from(BASE_M),
        f64::from(BASE_M.next_up()),
        2750.0,
        f64::from(TOP_M.next_down()),
        f64::from(TOP_M),
        f64::from(TOP_M.next_up()),
        12_000.0,
        400_000.0,
    ];
    for altitude_m in altitudes_m {
        for (yaw_deg, pitch_deg) in [(0.0, 90.0), (0.0, -90.0), (150.0, 0.0), (150.0, -20.0)] {
            look(stage, altitude_m, yaw_deg, pitch_deg, 60.0, SCREEN);
            if altitude_m < f64::from(BASE_M) {
                look(stage, altitude_m, yaw_deg, pitch_deg, 60.0, CACHED);
            }
        }
    }
    for fov_deg in [1.0, 60.0, 170.0] {
        for (altitude_m, pitch_deg) in [
            (0.0, 0.0),
            (2.0, 30.0),
            (2750.0, 0.0),
            (400_000.0, -90.0),
            (400_000.0, -20.0),
        ] {
            look(stage, altitude_m, 1e6, pitch_deg, fov_deg, SCREEN);
            if altitude_m < f64::from(BASE_M) {
                look(stage, altitude_m, -1e6, pitch_deg, fov_deg, CACHED);
            }
        }
    }
    // Straight down from the ground itself and up again: nothing of the planet's far side is seen.
    for pitch_deg in [-90.0f64, -45.0, -1.0, -1e-3, 90.0, 45.0, 1.0] {
        let (sine, cosine) = pitch_deg.to_radians().sin_cos();
        let found = stage.rays(
            glam::DVec3::ZERO,
            vec![super::stage::ray([0.0, 0.0, 0.0], [cosine, sine, 0.0])],
            skycell_server::march::MarchSettings::plain(64),
        );
        line.case();
        let layer = &found.layers[0][0];
        line.layer(format!("ground, {pitch_deg}°"), layer, 1e6, 1.0);
        if pitch_deg < 0.0 {
            line.holds(
                format!("ground, {pitch_deg}°: no cloud below"),
                layer.optical_depth.into(),
                1e-30,
            );
        }
    }
    line
}
