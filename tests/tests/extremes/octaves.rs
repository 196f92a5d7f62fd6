//! One to sixteen octaves whose factors are 0 or 1: every one of them has a closed form.

use super::line::Line;
use super::phase::hg_twin;
use super::stage::{CACHED, SCREEN, Stage, eye, ray, slab, small};
use glam::DVec3;
use serde_json::json;
use skycell_server::march::MarchSettings;
use skycell_tests::numbers::U;

pub(crate) fn any(stage: &mut Stage) -> Line {
    let mut line = Line::new("octaves");
    for octaves in 1..=16u32 {
        for factors in 0..8u32 {
            let [a, b, c] = [factors & 1, factors >> 1 & 1, factors >> 2].map(f64::from);
            stage.scene(&slab(
                json!({"light": {"phase": {"model": "hg", "g": 0.9}, "scattering": "octaves", "octaves": octaves,
                "octave_attenuation": a, "octave_contribution": b, "octave_eccentricity": c,
                "sun_steps": 3, "sun_march_distance_m": 600}}),
            ));
            let direction = [0.6, 0.8, 0.0];
            let found = stage.rays(
                DVec3::ZERO,
                vec![ray([0.0; 3], direction)],
                MarchSettings::plain(25),
            );
            line.case();
            let layer = &found.layers[0][0];
            let what = format!("{octaves} octaves, a {a}, b {b}, c {c}");
            // Octave i > 0 takes out a^i of the sun's depth: all of it as the first does, or none, which leaves 1 - T.
            let gathered = if a == 1.0 {
                f64::from(layer.single)
            } else {
                1.0 - (-f64::from(layer.optical_depth)).exp()
            };
            let phase = hg_twin(0.9 * c, 0.8);
            let exact = f64::from(octaves - 1) * b * phase * gathered;
            line.layer(&what, layer, f64::from(octaves) * phase, 0.0);
            // 1 - µ is known to 4 U, by which a phase of this width moves 3 g / base times as far; 16 sums.
            let bound = (64.0 + 40.0) * U * exact;
            line.holds(
                &what,
                (f64::from(layer.octaves) - exact).abs(),
                bound + 1e-30,
            );
        }
    }
    // The largest value that the cache is ever asked to hold: 15 unscaled octaves of the sharpest phase, towards the sun.
    for g in [0.999, -0.999] {
        stage.scene(&slab(json!({"sun": {"elevation_deg": 60.0}, "light": {"phase": {"model": "hg", "g": g}, "scattering": "octaves", "octaves": 16,
            "octave_attenuation": 0, "octave_contribution": 1, "octave_eccentricity": 1}})));
        for renderer in [SCREEN, CACHED] {
            let mut settings = super::stage::settings(renderer);
            settings.samples = 2;
            let yaw_deg = if g > 0.0 { 150.0 } else { 330.0 };
            let picture =
                stage.look_with(eye([0.0, 2.0, 0.0], yaw_deg, 60.0, 1.0), small(), &settings);
            line.picture(
                format!("{renderer:?}: sixteen octaves of g = {g}"),
                &picture,
            );
        }
    }
    line
}
