//! The sharpest phases, forward, backward and across, as they come out of the whole renderer: the ratio of radiance to
//! what the march gathered is the phase, averaged over the sun's disc.

use super::line::Line;
use super::stage::{Stage, ray, slab};
use glam::DVec3;
use serde_json::{Value, json};
use skycell_reference::sky::limb;
use skycell_server::march::{MarchSettings, hg_draine_parameters};
use skycell_tests::numbers::U;
use std::f64::consts::PI;

/// Henyey and Greenstein 1941.
pub(crate) fn hg_twin(g: f64, mu: f64) -> f64 {
    (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * mu).powf(1.5))
}

/// Draine 2003, eq. 4.
pub(crate) fn draine_twin(g: f64, alpha: f64, mu: f64) -> f64 {
    hg_twin(g, mu) * (1.0 + alpha * mu * mu) / (1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0)
}

/// Jendersie & d'Eon 2023, eq. 3.
fn blend_twin(diameter_um: f64, mu: f64) -> f64 {
    let [g_hg, g_draine, alpha, w] =
        hg_draine_parameters(diameter_um).map(|value| f64::from(value as f32));
    (1.0 - w) * hg_twin(g_hg, mu) + w * draine_twin(g_draine, alpha, mu)
}

type Twin = Box<dyn Fn(f64) -> f64>;

fn models() -> Vec<(Value, Twin)> {
    // The device has the document's numbers as f32.
    let narrow = |value: f64| f64::from(value as f32);
    let hg = |g: f64| -> (Value, Twin) {
        (
            json!({"model": "hg", "g": g}),
            Box::new(move |mu| hg_twin(narrow(g), mu)),
        )
    };
    let draine = |g: f64, alpha: f64| -> (Value, Twin) {
        (
            json!({"model": "draine", "g": g, "alpha": alpha}),
            Box::new(move |mu| draine_twin(narrow(g), narrow(alpha), mu)),
        )
    };
    let droplet = |d: f64| -> (Value, Twin) {
        (
            json!({"model": "hg-draine", "droplet_diameter_um": d}),
            Box::new(move |mu| blend_twin(d, mu)),
        )
    };
    vec![
        hg(0.999),
        hg(-0.999),
        hg(0.0),
        draine(0.999, 1e4),
        draine(-0.999, 1e4),
        draine(0.5, 0.0),
        droplet(5.0),
        droplet(20.0),
        droplet(50.0),
        (
            json!({"model": "isotropic"}),
            Box::new(|_| 1.0 / (4.0 * PI)),
        ),
    ]
}

/// µ averaged over a disc around a direction: µ (1 + cos r) / 2.
fn mu_of_disc(mu: f64) -> f64 {
    mu * 0.5 * (1.0 + 0.2666f64.to_radians().cos())
}

pub(crate) fn sharpest(stage: &mut Stage) -> Line {
    let mut line = Line::new("phase");
    for (model, twin) in models() {
        for (what, mu, direction) in [
            ("forward", 1.0, [0.0, 1.0, 0.0]),
            ("across", 0.6, [0.8, 0.6, 0.0]),
            ("backward", -1.0, [0.0, -1.0, 0.0]),
        ] {
            stage.scene(&slab(json!({"light": {"phase": model.clone()}})));
            // From the middle of a thin layer: steps of 40 m, so 12.5 each way.
            let origin = [0.0, 1500.0, 0.0];
            let found = stage.rays(
                DVec3::ZERO,
                vec![ray(origin, direction)],
                MarchSettings::plain(25),
            );
            line.case();
            let layer = &found.layers[0][0];
            line.layer(format!("{model} {what}"), layer, 0.0, 0.0);
            let background = if mu == 1.0 {
                let disc_sr = 4.0 * PI * (0.5 * 0.2666f64.to_radians()).sin().powi(2);
                // The middle of the disc is brighter than its mean.
                limb(1.0).x * f64::from(layer.transmittance) / disc_sr
            } else {
                0.0
            };
            let lit = f64::from(found.radiance[0][0]) - background;
            let phase = twin(mu_of_disc(mu));
            let exact = phase * f64::from(layer.single);
            // Some thirty roundings, and the background that is subtracted. Near 2, 1 - µ is known to 4 U; a backward peak
            // of base (1 - |g|)² + 2 |g| (1 + µ) feels 3 |g| / base times as much of it.
            let g = model["g"].as_f64().unwrap_or(0.0);
            let base = (1.0 + g).powi(2) + 2.0 * g.abs() * (1.0 + mu_of_disc(mu));
            let backward = if g < 0.0 {
                3.0 * g.abs() / base * 4.0
            } else {
                0.0
            };
            let bound = (64.0 + backward) * U * (exact + background);
            line.holds(
                format!("{model} {what}: {exact:.4e}"),
                (lit - exact).abs(),
                bound,
            );
        }
    }
    line
}
