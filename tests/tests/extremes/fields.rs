//! What density comes from: coverage and type at their ends, grids of any shape, and grids that hold no densities.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, ray, slab, small, weather};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_protocol::Scene;
use skycell_server::field::check_grids;
use skycell_server::march::MarchSettings;
use skycell_tests::numbers::U;

pub(crate) fn coverage(stage: &mut Stage) -> Line {
    let mut line = Line::new("coverage");
    for coverage in [0.0, 1e-9, 1.0] {
        for cloud_type in [0.0, 1.0] {
            for detail_strength in [0.0, 1.0] {
                stage.scene(&weather(
                    json!({"layers": [{"density": {"model": "weather", "coverage": coverage,
                    "type": cloud_type, "detail_strength": detail_strength}}]}),
                ));
                for renderer in [SCREEN, CACHED] {
                    let picture =
                        stage.look(eye([0.0, 2.0, 0.0], 0.0, 40.0, 90.0), small(), renderer);
                    line.picture(
                        format!("{renderer:?}: coverage {coverage}, type {cloud_type}, detail {detail_strength}"),
                        &picture,
                    );
                }
            }
        }
    }
    line
}

/// A grid over x, z = -500...500 m between 1 and 2 km.
fn grid_layer(dimensions: [u32; 3], extinction_per_m: f64) -> Value {
    json!({"base_altitude_m": 1000, "top_altitude_m": 2000, "extinction_per_m": extinction_per_m,
        "density": {"model": "grid", "file": "extreme.f32", "dimensions": dimensions,
            "bounds_min_m": [-500, 1000, -500], "bounds_max_m": [500, 2000, 500]}})
}

fn write(stage: &Stage, values: impl IntoIterator<Item = f32>) {
    let bytes: Vec<u8> = values.into_iter().flat_map(f32::to_le_bytes).collect();
    std::fs::write(stage.grids_dir.join("extreme.f32"), bytes).expect("a file");
}

pub(crate) fn grids(stage: &mut Stage) -> Line {
    let mut line = Line::new("grids");
    let up = ray([0.0; 3], [0.0, 1.0, 0.0]);
    for dimensions in [
        [1, 1, 1],
        [2, 1, 1],
        [512, 1, 1],
        [1, 512, 1],
        [1, 1, 512],
        [2048, 1, 2],
        [33, 65, 17],
    ] {
        let count: u32 = dimensions.iter().product();
        // Density 1/2 everywhere: as a box of half the extinction. Grids are known by name and shape, so an empty scene
        // in between makes the renderer read the file again.
        stage.scene(&slab(json!({"layers": []})));
        write(stage, (0..count).map(|_| 0.5));
        stage.scene(&slab(json!({"layers": [grid_layer(dimensions, 2e-3)]})));
        let found = stage.rays(DVec3::ZERO, vec![up], MarchSettings::plain(25));
        line.case();
        let layer = &found.layers[0][0];
        line.layer(format!("{dimensions:?}"), layer, 0.0, 0.0);
        line.holds(
            format!("{dimensions:?}: optical depth"),
            (f64::from(layer.optical_depth) - 1.0).abs(),
            64.0 * U,
        );
    }
    // A ramp along the ray: linear between the middles of voxels, level at both ends. 500 samples of 2 m, of which the
    // bends at the first and last middle cost an eighth of a sample each.
    stage.scene(&slab(json!({"layers": []})));
    write(stage, (0..8).map(|i| i as f32 / 7.0));
    stage.scene(&slab(json!({"layers": [grid_layer([1, 8, 1], 1e-3)]})));
    let found = stage.rays(DVec3::ZERO, vec![up], MarchSettings::plain(500));
    line.case();
    let bend = 2.0 * (2.0 / 125.0 / 7.0) / 8.0 * 2e-3;
    line.holds(
        "a ramp of 8 voxels",
        (f64::from(found.layers[0][0].optical_depth) - 0.5).abs(),
        bend + 0.5 * 600.0 * U,
    );

    // No densities: refused with the place and the value.
    let refuse = |line: &mut Line, stage: &Stage, values: Vec<f32>, told: &str| {
        write(stage, values);
        let scene = Scene::from_json(&slab(json!({"layers": [grid_layer([2, 1, 1], 1.0)]})))
            .expect("valid");
        let error = check_grids(&scene, &stage.grids_dir)
            .map_or_else(|error| error.allowed, |()| "taken".into());
        line.case();
        line.is(format!("{told} in {error:?}"), error.contains(told));
    };
    refuse(&mut line, stage, vec![0.5, f32::NAN], "NaN at voxel 1");
    refuse(&mut line, stage, vec![f32::INFINITY, 0.5], "inf at voxel 0");
    refuse(
        &mut line,
        stage,
        vec![f32::NEG_INFINITY, 0.5],
        "-inf at voxel 0",
    );
    refuse(
        &mut line,
        stage,
        vec![0.5, 1.0f32.next_up()],
        "1.0000001 at voxel 1",
    );
    refuse(&mut line, stage, vec![0.5], "4 bytes");
    for dimensions in [json!([0, 1, 1]), json!([2049, 1, 1])] {
        let mut scene = slab(json!({"layers": [grid_layer([1, 1, 1], 1.0)]}));
        scene["layers"][0]["density"]["dimensions"] = dimensions.clone();
        line.case();
        let refused =
            Scene::from_json(&scene).is_err_and(|error| error.pointer.contains("/dimensions/0"));
        line.is(format!("{dimensions} refused"), refused);
    }
    line
}
