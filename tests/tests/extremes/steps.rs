//! One step and 4096 of them, and a texel or pixel that takes samples for ever.

use super::line::Line;
use super::stage::{CACHED, SCREEN, Stage, eye, ray, size, slab, weather};
use glam::DVec3;
use serde_json::json;
use skycell_protocol::Scene;
use skycell_server::march::MarchSettings;
use skycell_server::probe::{FieldProbe, FieldQuestion};
use skycell_shaders::SourceEdit;
use skycell_tests::numbers::{Random, U};
use skycell_tests::server::target_dir;

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
    // Many of both. Their product stays below the 65 535 rounds after which the software driver ends a shader's loops.
    stage.scene(&slab(json!({})));
    let march = MarchSettings {
        sun_steps: Some(64),
        ..MarchSettings::plain(900)
    };
    let found = stage.rays(DVec3::ZERO, vec![ray([0.0; 3], [0.0, 1.0, 0.0])], march);
    line.case();
    let layer = &found.layers[0][0];
    line.holds(
        "900 steps, 64 to the sun",
        (f64::from(layer.optical_depth) - 1.0).abs(),
        8.0 * U * 916.0,
    );
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

/// Where the means of a texel are asked for: the functions of the shaders, not pictures.
fn probe() -> FieldProbe {
    let folder = target_dir().expect("a folder").join("noise-of-tests");
    let scene = Scene::from_json(&slab(json!({}))).expect("valid");
    let settings = MarchSettings::default();
    FieldProbe::open(&scene, settings, DVec3::ZERO, 0.0, &folder, &folder).expect("a device")
}

/// Half a unit in the last of a half float's eleven digits.
const HALF: f64 = 1.0 / 2048.0;
const FRAMES: u32 = 100_000;

/// The mean without rounding: samples mean + swing and mean - swing in turns.
fn mean_twin(mean: f64, swing: f64, first: u32, weight: f64) -> f64 {
    (0..FRAMES).fold(0.0, |held, n| {
        let sample = if n % 2 == 0 {
            mean + swing
        } else {
            mean - swing
        };
        let weight = if n < first {
            1.0 / f64::from(n + 1)
        } else {
            weight
        };
        held + weight * (sample - held)
    })
}

const MEANS: [[f32; 4]; 7] = [
    // Mean, swing, samples of the first generation, weight of all later ones.
    [1.0, 0.0, 8.0, 0.25],
    [1.0, 0.5, 8.0, 0.25],
    [0.2503, 0.0, 8.0, 0.0625],
    [0.3, 0.3, 16.0, 0.25],
    [5.0e4, 9.0e3, 8.0, 0.25],
    [6.2e-5, 1e-5, 1.0, 0.25],
    [0.7, 0.1, 8.0, 0.0625],
];

/// 100 000 frames of accumulation, as ARCHITECTURE has the bound: each store rounds by u = 2^-11 of the value, and of all
/// that was rounded before, a share w is forgotten: u / w of the largest value in all.
pub(crate) fn accumulated_with(edit: Option<SourceEdit>) -> Line {
    let mut line = Line::new("accumulation");
    let mut probe = probe();
    probe.plant(edit).expect("shaders");
    // In two halves: the software driver ends loops after 65 535 rounds.
    let half = FRAMES / 2;
    let mut held = vec![[0.0; 4]; MEANS.len()];
    for taken in [0, half] {
        let points: Vec<[[f32; 4]; 4]> = MEANS
            .iter()
            .zip(&held)
            .map(|([mean, swing, first, weight], held)| {
                let rounds = [half as f32, *first, *weight, taken as f32];
                [[*mean; 4], rounds, [*swing; 4], *held]
            })
            .collect();
        let values = probe
            .ask(FieldQuestion::Accumulated, 0, &points)
            .expect("values");
        held = values.iter().map(|value| value[0]).collect();
    }
    for ([mean, swing, first, weight], value) in MEANS.iter().zip(&held) {
        line.case();
        let [mean, swing, weight] = [mean, swing, weight].map(|v| f64::from(*v));
        let exact = mean_twin(mean, swing, *first as u32, weight);
        let bound = HALF / weight * (mean + swing);
        line.holds(
            format!("mean {mean}, swing {swing}, weight {weight}"),
            (f64::from(value[0]) - exact).abs(),
            bound,
        );
    }
    // What is too large for a half float is stored as what fits one: with its digits cut off it must still fit.
    let too_large = [[1e9; 4], [1.0, 1.0, 1.0, 0.0], [0.0; 4], [0.0; 4]];
    let value = probe
        .ask(FieldQuestion::Accumulated, 0, &[too_large])
        .expect("values");
    line.case();
    line.holds("a sample of 1e9", value[0][0][0].into(), 65_504.0);
    line
}

pub(crate) fn accumulated(_: &mut Stage) -> Line {
    accumulated_with(None)
}

/// The window that adds the newest sample and takes out the oldest, in f32 and in halves: the same means, worst of their
/// bounds.
pub(crate) fn sliding_window(round: fn(f32) -> f32) -> Line {
    let mut line = Line::new("sliding window");
    for [mean, swing, first, weight] in MEANS {
        let window = first as usize * 2;
        let mut random = Random(9);
        let mut kept = vec![0.0f32; window];
        let mut sum = 0.0f32;
        let mut exact = vec![0.0f64; window];
        for n in 0..FRAMES as usize {
            // Samples that chance scatters, as jitter does: rounding then walks.
            let sample = mean + swing * (2.0 * random.unit() as f32 - 1.0);
            sum = round(sum + (sample - kept[n % window]) / window as f32);
            kept[n % window] = sample;
            exact[n % window] = sample.into();
        }
        let truth = exact.iter().sum::<f64>() / window as f64;
        line.case();
        // In f32 a window of n samples may be wrong by n roundings of U; in halves by as much as the mean above.
        let bound = if round(1.0 + 1e-5) == 1.0 {
            HALF / f64::from(weight)
        } else {
            U * window as f64
        };
        let error = (f64::from(sum) - truth).abs();
        line.holds(
            format!("mean {mean}, swing {swing}"),
            error,
            bound * f64::from(mean + swing),
        );
    }
    line
}
