//! Thin sheets of ice: from below, at their faces, from within, above and orbit, through them and along them; of no optical
//! depth and of all that the document allows.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, ray, slab, small, weather};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_server::march::MarchSettings;
use skycell_tests::numbers::{U, layer_parts};

const BASE_M: f64 = 9000.0;
const TOP_M: f64 = 9300.0;
/// Thinnest and thickest place of a veil that covers everything: bytes 127 and 255 of its map.
const DENSITY: [f64; 2] = [127.0 / 255.0, 1.0];

fn veil(optical_depth: f64) -> Value {
    let mut scene = slab(
        json!({"layers": [{"family": "cirrostratus", "base_altitude_m": BASE_M,
        "top_altitude_m": TOP_M,
        "density": {"type": 0, "coverage": 1, "optical_depth": optical_depth}}]}),
    );
    if let Some(members) = scene.as_object_mut() {
        members.remove("planet");
    }
    scene
}

pub(crate) fn anywhere(stage: &mut Stage) -> Line {
    let mut line = Line::new("sheets");
    stage.scene(&veil(0.3));
    let above = |altitude_m: f64| f64::from((altitude_m as f32).next_up());
    let below = |altitude_m: f64| f64::from((altitude_m as f32).next_down());
    let altitudes_m = [
        2.0,
        below(BASE_M),
        above(BASE_M),
        9150.0,
        below(TOP_M),
        above(TOP_M),
        12_000.0,
        400_000.0,
    ];
    // Sines of pitches: through, at a slant, and along the sheet.
    let sines = [1.0, 0.5, 1e-2, 0.0, -1e-3, -0.05, -0.5, -1.0];
    let rays: Vec<_> = altitudes_m
        .into_iter()
        .flat_map(|altitude_m| {
            sines.map(|sine: f64| {
                let cosine = (1.0 - sine * sine).sqrt();
                (
                    altitude_m,
                    sine,
                    ray([0.0, altitude_m, 0.0], [0.6 * cosine, sine, 0.8 * cosine]),
                )
            })
        })
        .collect();
    let found = stage.rays(
        DVec3::ZERO,
        rays.iter().map(|(.., ray)| *ray).collect(),
        MarchSettings::plain(25),
    );
    let per_m = 0.3 / (TOP_M - BASE_M);
    for ((altitude_m, sine, ray), layer) in rays.iter().zip(&found.layers[0]) {
        line.case();
        let what = format!("from {altitude_m} m at a sine of {sine}");
        line.layer(&what, layer, 0.0, 0.0);
        let origin = ray.origin_m.as_vec3().as_dvec3().to_array();
        let direction = ray.direction.as_vec3().as_dvec3().to_array();
        let parts = layer_parts(origin, direction, BASE_M, TOP_M, true);
        let length_m: f64 = parts.iter().map(|part| part.end_m - part.start_m).sum();
        // The ends of the way are where f32 puts them; its few samples are summed.
        let ends_m: f64 = parts.iter().map(|part| part.bound_m).sum();
        let bound = per_m * ends_m + 64.0 * U * per_m * length_m + 1e-9;
        let depth = f64::from(layer.optical_depth);
        let [thin, thick] = DENSITY.map(|density| density * per_m * length_m);
        let outside = (thin - depth).max(depth - thick).max(0.0);
        line.holds(format!("{what}: optical depth {depth}"), outside, bound);
        line.holds(
            format!("{what}: transmittance"),
            (f64::from(layer.transmittance) - (-depth).exp()).abs(),
            64.0 * U,
        );
    }
    // Nothing and a wall; with everything else of a sky.
    for optical_depth in [0.0, 100.0] {
        stage.scene(&weather(json!({"layers": [
            {"family": "cirrus", "density": {"optical_depth": optical_depth}}, {"family": "cumulus"}]})));
        let up = eye([0.0, 2.0, 0.0], 0.0, 30.0, 60.0);
        let renderer = if optical_depth > 0.0 { CACHED } else { SCREEN };
        let picture = stage.look(up, small(), renderer);
        line.picture(format!("an optical depth of {optical_depth}"), &picture);
    }
    line
}
