//! One step and 4096 of them, and a texel or pixel that takes samples for ever.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, ray, size, slab, weather};
use glam::DVec3;
use serde_json::json;
use skycell_server::march::MarchSettings;
use skycell_tests::numbers::U;

pub(crate) fn any(stage: &mut Stage) -> Line {
    let mut line = Line::new("step counts");
    // The slab begins a whole number of its thickness away, so every number of steps fills it.
    for steps in [1, 2, 3, 25, 4096] {
        stage.scene(&slab(json!({})));
        let march = MarchSettings::plain(steps);
        let found = stage.rays(DVec3::ZERO, vec![ray([0.0; 3], [0.0, 1.0, 0.0])], march);
        line.case();
        let layer = &found.layers[0][0];
        line.layer(format!("{steps} steps"), layer, 0.0, 0.0);
        // One sample more or less where rounding puts the last one on the edge; sums of n terms.
        let bound = 8.0 * U * (f64::from(steps) + 16.0);
        line.holds(
            format!("{steps} steps: optical depth"),
            (f64::from(layer.optical_depth) - 1.0).abs(),
            bound,
        );
    }
    stage.scene(&weather(json!({})));
    for steps in [1, 2, 4096] {
        for sun_steps in [1, 64] {
            let mut settings = super::stage::settings(SCREEN);
            settings.march.steps = steps;
            settings.march.sun_steps = Some(sun_steps);
            let size = if steps > 2 { size(4, 4) } else { size(32, 18) };
            let picture = stage.look_with(eye([0.0, 2.0, 0.0], 0.0, 20.0, 60.0), size, &settings);
            line.picture(format!("{steps} steps, {sun_steps} to the sun"), &picture);
        }
    }
    for steps in [1, 2] {
        let mut settings = super::stage::settings(CACHED);
        settings.march.steps = steps;
        let picture = stage.look_with(
            eye([0.0, 2.0, 0.0], 0.0, 20.0, 60.0),
            size(32, 18),
            &settings,
        );
        line.picture(format!("{steps} steps, cached"), &picture);
    }
    // Steps that do not grow, and none that is skipped.
    for (adaptive_step, low_density_skip) in [(false, true), (false, false)] {
        let mut settings = super::stage::settings(SCREEN);
        settings.march.adaptive_step = adaptive_step;
        settings.march.low_density_skip = low_density_skip;
        let picture = stage.look_with(
            eye([0.0, 2.0, 0.0], 0.0, 20.0, 60.0),
            size(16, 9),
            &settings,
        );
        line.picture(
            format!("adaptive {adaptive_step}, skip {low_density_skip}"),
            &picture,
        );
    }
    line
}
