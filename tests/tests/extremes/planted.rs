//! Defects that are planted into the shaders, one at a time, and the line that finds each.

use super::line::Line;
use super::stage::{Stage, stage};
use super::{
    camera, depth, layers, maps, phase, scattering, sheets, shells, steps, sun_volume, window,
};
use skycell_shaders::SourceEdit;

/// What is planted where; the text must be there.
fn replaced(path: &str, source: &str, file: &str, from: &str, to: &str) -> String {
    if path != file {
        return source.to_owned();
    }
    assert!(source.contains(from), "{file} has no {from:?}");
    source.replace(from, to)
}

macro_rules! edit {
    ($file:expr, $from:expr, $to:expr) => {
        |path, source| replaced(path, source, $file, $from, $to)
    };
}

type Case = (
    &'static str,
    SourceEdit,
    &'static str,
    fn(&mut Stage) -> Line,
);

const DEFECTS: [Case; 17] = [
    (
        "shell roots from squares of radii",
        edit!(
            "geometry/shell.wgsl",
            "let c = (origin_altitude_m - shell_altitude_m) * (origin_altitude_m + shell_altitude_m + 2.0 * planet_radius_m);",
            "let at = vec3f(origin.x, origin.y + planet_radius_m, origin.z);
             let c = dot(at, at) - (planet_radius_m + shell_altitude_m) * (planet_radius_m + shell_altitude_m);"
        ),
        "grazing rays",
        shells::grazed,
    ),
    (
        "(1 - e^-x)/x without its series",
        edit!(
            "light/transport.wgsl",
            "select((1.0 - exp(-x)) / max(x, 1e-9), series, x < 1e-2)",
            "(1.0 - exp(-x)) / max(x, 1e-30)"
        ),
        "optical depth",
        depth::any,
    ),
    (
        "a phase that is not normalised",
        edit!(
            "light/phase.wgsl",
            "/ (FOUR_PI * base * sqrt(base))",
            "/ (base * sqrt(base))"
        ),
        "phase",
        phase::sharpest,
    ),
    (
        "the cancelling denominator of the phase",
        edit!(
            "light/phase.wgsl",
            "let base = (1.0 - sharpness) * (1.0 - sharpness) + 2.0 * sharpness * from_peak;",
            "let base = 1.0 + g * g - 2.0 * g * (1.0 - one_minus_mu);"
        ),
        "phase",
        phase::sharpest,
    ),
    (
        "the sun's disc left out of a backward peak",
        edit!(
            "light/phase.wgsl",
            "one_minus_mu + (1.0 - one_minus_mu) * 0.5 * one_minus_mu_disc",
            "min(one_minus_mu + 0.5 * one_minus_mu_disc, 2.0)"
        ),
        "phase",
        phase::sharpest,
    ),
    (
        "a ground that does not hide what is under an eye that lies on it",
        edit!(
            "geometry/shell.wgsl",
            "ground.hit && ground.near_m + ground.far_m > 0.0",
            "ground.hit && ground.near_m > 0.0"
        ),
        "camera",
        camera::anywhere,
    ),
    (
        "layers blended from below wherever the eye is",
        edit!(
            "composite/composite.wgsl",
            "let swapped = b.rank < a.rank;",
            "let swapped = false;"
        ),
        "layers",
        layers::any,
    ),
    (
        "maps blended the wrong way round",
        edit!(
            "cloud/blend.wgsl",
            "mix(earlier.xy, later.xy, share)",
            "mix(later.xy, earlier.xy, share)"
        ),
        "maps on their way",
        maps::mixed,
    ),
    (
        "a sheet as thick from the side as from below",
        edit!(
            "march/march.wgsl",
            "let optical_depth = density * layer.extinction_per_m * length_m;\n        let opacity",
            "let optical_depth = density * layer.extinction_per_m * (layer.top_altitude_m - layer.base_altitude_m);\n        let opacity"
        ),
        "sheets",
        sheets::anywhere,
    ),
    (
        "diffuse light that does not know how thick its cloud is",
        edit!(
            "light/scattering.wgsl",
            "taken * least / (least + light.thickness)",
            "taken"
        ),
        "scattering",
        scattering::any,
    ),
    (
        "light from below left out",
        edit!(
            "composite/shade.wgsl",
            " + world.sky.ground_radiance * from_below",
            ""
        ),
        "furnace",
        scattering::furnace,
    ),
    (
        "rays that end after four times their steps",
        edit!(
            "march/march.wgsl",
            "for (var lit = 0u; lit < layer.steps_max; lit += 1u) {",
            "for (var lit = 0u; lit < min(layer.steps_max, u32(4.0 * (layer.top_altitude_m - layer.base_altitude_m) / layer.step_min_m)); lit += 1u) {"
        ),
        "grazing rays",
        shells::grazed,
    ),
    (
        "a sun volume that leaves out the layers above",
        edit!(
            "march/march.wgsl",
            "beyond += other_layers_sun_depth(ray, position);",
            "beyond += 0.0;"
        ),
        "sun volume through slabs",
        sun_volume::through_slabs,
    ),
    (
        "a sun volume read half a slice too low",
        edit!(
            "march/sun_volume.wgsl",
            "(0.5 + saturate(height_fraction) * sun.slices)",
            "(saturate(height_fraction) * sun.slices)"
        ),
        "sun volume through slabs",
        sun_volume::through_slabs,
    ),
    (
        "a reprojection whose up is down",
        edit!(
            "march/temporal.wgsl",
            "-dot(point_from_eye, upward)",
            "dot(point_from_eye, upward)"
        ),
        "temporal window",
        window::any,
    ),
    (
        "rays that go in circles where the part before a cloud is empty",
        edit!(
            "march/march.wgsl",
            "false, fine, start_fraction, begin), share < 1.0);",
            "false, fine, start_fraction, begin), false);"
        ),
        "temporal window",
        window::any,
    ),
    (
        "a window that keeps a thousandth of every frame",
        edit!(
            "march/resolve.wgsl",
            "marched[at] = mean.light.x;",
            "marched[at] = 1e-3 * marched[at] + mean.light.x + select(0.0, marched[at], window.newest == 0u);"
        ),
        "temporal window",
        window::any,
    ),
];

/// Eleven digits.
fn half_rounded(value: f32) -> f32 {
    f32::from_bits((value.to_bits() + 0x1000) & 0xffff_e000)
}

#[test]
fn every_planted_defect_is_found() {
    let mut stage = stage();
    let mut missed = Vec::new();
    for (what, edit, by, run) in DEFECTS {
        stage.plant(Some(edit));
        let worst = run(&mut stage).worst();
        println!("{what}: found by \"{by}\" at {worst:.3e} of its bound");
        if worst <= 1.0 {
            missed.push(what);
        }
    }
    stage.plant(None);
    let without_bound: SourceEdit = edit!(
        "march/accumulate.wgsl",
        "let bounded = min(sample, vec4f(STORED_MAX));",
        "let bounded = sample;"
    );
    let windows = [
        (
            "radiance stored in halves without a bound",
            steps::accumulated_with(Some(without_bound)),
        ),
        (
            "a window that adds and takes out, in f32",
            steps::sliding_window(|sum| sum),
        ),
        (
            "a window that adds and takes out, in halves",
            steps::sliding_window(half_rounded),
        ),
    ];
    for (what, line) in windows {
        println!(
            "{what}: found by \"accumulation\" at {:.3e} of its bound",
            line.worst()
        );
        if line.worst() <= 1.0 {
            missed.push(what);
        }
    }
    assert!(missed.is_empty(), "not found: {missed:?}");
}
