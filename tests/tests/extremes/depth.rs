//! Optical depths from 1e-8 to 1e8, straight up through a slab whose steps fit it: closed forms to rounding.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, ray, slab, small};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_server::march::MarchSettings;
use skycell_tests::numbers::U;

fn scene(depth: f64) -> Value {
    // The thickest needs 100 km at the document's highest extinction.
    let thickness_m = if depth > 1e6 { 1e5 } else { 1e3 };
    slab(json!({
        "layers": [{"base_altitude_m": thickness_m, "top_altitude_m": 2.0 * thickness_m,
            "extinction_per_m": depth / thickness_m, "single_scattering_albedo": 1, "density": {"model": "homogeneous"}}],
    }))
}

pub(crate) fn any(stage: &mut Stage) -> Line {
    let mut line = Line::new("optical depth");
    for exponent in -8..=8 {
        let depth = 10f64.powi(exponent);
        stage.scene(&scene(depth));
        let up = ray([0.0; 3], [0.0, 1.0, 0.0]);
        // 25 steps from the ground to the base and 25 through the slab: samples fill it exactly.
        let found = stage.rays(DVec3::ZERO, vec![up], MarchSettings::plain(25));
        let layer = &found.layers[0][0];
        line.case();
        let what = format!("depth {depth:e}");
        line.layer(&what, layer, 0.0, 0.0);
        // 25 products and sums, and the step's and the extinction's own rounding.
        line.holds(
            format!("{what}: optical depth"),
            (f64::from(layer.optical_depth) / depth - 1.0).abs(),
            64.0 * U,
        );
        // e^-x of f32 is known to 3 + 2 x units (WGSL) in each of 25 factors.
        let transmittance = (-depth).exp();
        let bound = (64.0 * U * (1.0 + depth)).min(1.0) * transmittance
            + 25.0 * f64::from(f32::MIN_POSITIVE);
        line.holds(
            format!("{what}: transmittance"),
            (f64::from(layer.transmittance) - transmittance).abs(),
            bound + U,
        );
        // 1 - e^-τ; the march towards the sun is 1 m long and takes at most its extinction out.
        let opacity = -(-depth).exp_m1();
        let dimmed = (-f64::from(layer.optical_depth) / if depth > 1e6 { 1e5 } else { 1e3 }).exp();
        let single = f64::from(layer.single);
        line.holds(
            format!("{what}: too bright"),
            single / opacity - 1.0,
            128.0 * U,
        );
        line.holds(
            format!("{what}: too dark"),
            dimmed - single / opacity,
            128.0 * U,
        );
        for renderer in [SCREEN, CACHED] {
            let picture = stage.look(eye([0.0, 2.0, 0.0], 0.0, 45.0, 90.0), small(), renderer);
            line.picture(format!("{what}, {renderer:?}"), &picture);
        }
    }
    line
}
