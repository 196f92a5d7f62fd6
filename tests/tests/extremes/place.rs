//! The same cloud from cells far apart, and after a month of wind.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, relative_l2, small, weather};
use serde_json::json;

/// The default scene's maps and noise repeat after 40 km, 5 km and 420 m: all together after 840 km.
const PERIOD_M: f64 = 840_000.0;

pub(crate) fn anywhere_and_anytime(stage: &mut Stage) -> Line {
    let mut line = Line::new("cells and clock");
    stage.scene(&weather(json!({})));
    let look_from = |stage: &mut Stage, x_m: f64, z_m: f64, renderer| {
        stage.look(eye([x_m, 2.0, z_m], 90.0, 25.0, 60.0), small(), renderer)
    };
    for renderer in [SCREEN, CACHED] {
        let here = look_from(stage, 0.0, 0.0, renderer);
        // Whole periods away the offsets are the same numbers, and so is the picture, to the last bit.
        for (x, z) in [(1.0, 0.0), (12.0, 0.0), (-12.0, 12.0), (-23.0, 23.0)] {
            let there = look_from(stage, x * PERIOD_M, z * PERIOD_M, renderer);
            let what = format!("{renderer:?}: {x} and {z} periods of 840 km away");
            line.picture(&what, &there);
            line.holds(&what, relative_l2(&here, &there), 1e-30);
        }
        // Wind of 5 m/s towards the east carries clouds 12 960 km in 30 days; an eye that goes along sees no change. The
        // offsets are reduced in f64 and then rounded in f32 around another number: within U of a period, 2.4 mm of the map
        // and 0.3 mm of the shape noise. Density changes by at most 7 · 0.44 · 128 / 5000 = 0.08 per metre, and a ray's
        // radiance by about as much of itself.
        for days in [1.0 / 86_400.0, 1.0, 30.0] {
            let seconds = days * 86_400.0;
            stage.at_time(seconds);
            let there = look_from(stage, 5.0 * seconds, 0.0, renderer);
            let what = format!("{renderer:?}: {days} days of wind");
            line.picture(&what, &there);
            line.holds(&what, relative_l2(&here, &there), 3e-4);
            stage.at_time(0.0);
        }
    }
    // One place from cells whose origins lie up to 100 km aside, in a world without curvature, where both have the same up.
    stage.scene(&weather(json!({"planet": "flat"})));
    let camera = eye([1.0e7, 2.0, -1.9e7], 90.0, 25.0, 60.0);
    let here = stage.look(camera, small(), SCREEN);
    for aside_m in [300.0, 3_000.0, 30_000.0, 100_000.0] {
        let mut settings = super::stage::settings(SCREEN);
        settings.reference_offset_m = [aside_m, 0.0, -aside_m];
        let there = stage.look_with(camera, small(), &settings);
        let what = format!("cell {aside_m} m aside");
        line.picture(&what, &there);
        // Places are rounded to U of their distance from the origin, √2 · 100 km: 8 mm. At a steepness of 7 density feels
        // 7 · 0.44 · 128 / 5000 = 0.08 per metre of the shape noise and 7 · 0.22 · 32 / 420 = 0.12 of the detail; a few such
        // roundings.
        line.holds(
            &what,
            relative_l2(&here, &there),
            4.0 * 0.2 * (2.0 * aside_m * 6e-8 + 3e-3),
        );
    }
    line
}
