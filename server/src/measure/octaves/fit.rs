//! A search for the constants of the fitted model.
//!
//! Twelve constants in two sums that take a millisecond each: a search along one constant at a time, whose step halves
//! when nothing gets better, finds their least value in seconds and is the same on every machine. An optimiser's crate
//! would have brought derivatives or populations that nothing here needs.

use super::model::{Look, Model};
use indicatif::{ProgressBar, ProgressStyle};
use skycell_protocol::scene::FittedScattering;

/// Relative deviations beyond this count in proportion, smaller ones by their square.
const SOFT: f64 = 0.25;
/// First and last step of the search, in the logarithm of a constant.
const STEPS: [f64; 2] = [0.4, 0.004];
/// Most rounds over all constants.
const ROUNDS_MAX: usize = 200;

/// A constant: how to read and set it, and how large it may be.
type Constant = (fn(&mut FittedScattering) -> &mut f64, f64);

const SUN: [Constant; 9] = [
    (|f| &mut f.forward_attenuation, 6.0),
    (|f| &mut f.forward_strength, 2.0),
    (|f| &mut f.forward_eccentricity, 0.95),
    (|f| &mut f.diffuse_strength, 8.0),
    (|f| &mut f.diffuse_eccentricity, 0.8),
    (|f| &mut f.diffuse_slope, 20.0),
    (|f| &mut f.diffuse_thickness, 10.0),
    (|f| &mut f.diffuse_leak, 20.0),
    (|f| &mut f.diffuse_width, 50.0),
];
const SKY: [Constant; 3] = [
    (|f| &mut f.sky_slope, 20.0),
    (|f| &mut f.sky_thinness, 20.0),
    (|f| &mut f.sky_forward, 1.0),
];

/// What a modelled value costs: too bright by its relative error, too dark by the logarithm of the quotient, so that a half
/// counts about as much as a double; softly, and less where the truth is noisy.
fn cost(modelled: f64, exact: f64, standard_error: f64) -> f64 {
    let quotient = (modelled / exact).max(1e-6);
    let off = if quotient > 1.0 {
        quotient - 1.0
    } else {
        quotient.ln()
    };
    let trust = 1.0 / (1.0 + (standard_error / exact / 0.15).powi(2));
    trust * ((1.0 + (off / SOFT).powi(2)).sqrt() - 1.0)
}

fn sun_cost(looks: &[&Look], fitted: &FittedScattering) -> f64 {
    let model = Model::Fitted(*fitted);
    looks
        .iter()
        .map(|look| {
            cost(
                look.modelled(&model),
                look.sunlit.mean,
                look.sunlit.standard_error,
            )
        })
        .sum()
}

fn sky_cost(looks: &[&Look], fitted: &FittedScattering) -> f64 {
    looks
        .iter()
        .filter(|look| look.sky.mean > 3.0 * look.sky.standard_error)
        .map(|look| {
            cost(
                look.modelled_sky(fitted),
                look.sky.mean,
                look.sky.standard_error,
            )
        })
        .sum()
}

/// The constants that fit the looks of shapes that are not held out best, from others on.
#[must_use]
pub(super) fn fitted(looks: &[Look], from: FittedScattering) -> FittedScattering {
    let used: Vec<&Look> = looks.iter().filter(|look| !look.held_out).collect();
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
        bar.set_style(style);
    }
    let mut best = from;
    let searched = |best: &mut FittedScattering,
                    constants: &[Constant],
                    cost: &dyn Fn(&FittedScattering) -> f64| {
        let mut least = cost(best);
        let mut step = STEPS[0];
        for round in 0..ROUNDS_MAX {
            bar.set_message(format!("round {round}, step {step:.4}, cost {least:.4}"));
            bar.tick();
            let before = least;
            for (constant, most) in constants {
                for factor in [step.exp(), (-step).exp()] {
                    let mut tried = *best;
                    let value = constant(&mut tried);
                    *value = (*value * factor).clamp(1e-3, *most);
                    let cost = cost(&tried);
                    if cost < least {
                        least = cost;
                        *best = tried;
                    }
                }
            }
            if least >= before * (1.0 - 1e-6) {
                step *= 0.5;
                if step < STEPS[1] {
                    break;
                }
            }
        }
    };
    searched(&mut best, &SUN, &|fitted| sun_cost(&used, fitted));
    searched(&mut best, &SKY, &|fitted| sky_cost(&used, fitted));
    bar.finish_and_clear();
    best
}
