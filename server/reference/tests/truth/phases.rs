//! Phase functions: energy, mean cosine, and directions that have their distribution.

use glam::DVec3;
use skycell_protocol::scene::PhaseFunction;
use skycell_reference::path::Random;
use skycell_reference::phase::{Phase, turned};
use std::f64::consts::PI;

fn functions() -> Vec<PhaseFunction> {
    let mut all = vec![PhaseFunction::Isotropic];
    for g in [-0.999, -0.5, 1e-9, 0.5, 0.85, 0.999] {
        all.push(PhaseFunction::Hg { g });
        for alpha in [0.0, 1.0, 20.0, 1e4] {
            all.push(PhaseFunction::Draine { g, alpha });
        }
    }
    for droplet_diameter_um in [5.0, 10.0, 20.0, 50.0] {
        all.push(PhaseFunction::HgDraine {
            droplet_diameter_um,
        });
    }
    all
}

/// ∫ f(x) p dω over parts in x = 1 − µ that are even in log x, so that peaks are resolved, from both ends.
fn integral(phase: &Phase, low: f64, high: f64, f: impl Fn(f64) -> f64) -> f64 {
    const PARTS: u32 = 20_000;
    let edge = |i: u32| low * (high / low).powf(f64::from(i) / f64::from(PARTS));
    (0..PARTS)
        .map(|i| {
            let (a, b) = (edge(i), edge(i + 1));
            let x = 0.5 * (a + b);
            2.0 * PI * (b - a) * f(x) * phase.per_sr(1.0, x)
        })
        .sum()
}

/// The same from 0 to 2, peaks at either end.
fn whole(phase: &Phase, f: impl Fn(f64) -> f64 + Copy) -> f64 {
    let flipped = Phase {
        g_hg: -phase.g_hg,
        g_draine: -phase.g_draine,
        ..*phase
    };
    integral(phase, 1e-15, 1.0, f) + integral(&flipped, 1e-15, 1.0, |x| f(2.0 - x))
}

#[test]
fn every_phase_gives_back_all_light() {
    for function in functions() {
        let phase = Phase::of(&function);
        let all = whole(&phase, |_| 1.0);
        assert!((all - 1.0).abs() < 1e-6, "{function:?}: {all}");
        // Planted: without Draine's denominator the integral is far off.
        if let PhaseFunction::Draine { g, alpha } = function
            && alpha > 0.0
        {
            let factor = 1.0 + alpha * (1.0 + 2.0 * g * g) / 3.0;
            assert!((all * factor - 1.0).abs() > 0.1);
        }
    }
}

#[test]
fn every_mean_cosine_is_its_closed_form() {
    for function in functions() {
        let phase = Phase::of(&function);
        let mean = whole(&phase, |x| 1.0 - x);
        let closed = phase.mean_cosine();
        assert!(
            (mean - closed).abs() < 1e-6,
            "{function:?}: {mean} {closed}"
        );
    }
}

#[test]
fn sampled_directions_have_their_phase() {
    const SAMPLES: u64 = 40_000;
    const BINS: usize = 20;
    let (mut compared, mut beyond_two) = (0, 0);
    for (index, function) in functions().into_iter().enumerate() {
        let phase = Phase::of(&function);
        let mut random = Random::new(1, index as u64, 0);
        let (mut sum, mut squares) = (0.0, 0.0);
        // Bins even in log x or log (2 − x), whichever end the peak is at; the first holds all that is nearer to it.
        let backward = phase.g_hg < 0.0 || phase.g_draine < 0.0;
        let edge = |i: usize| 2.0 * 1e-6f64.powf(1.0 - i as f64 / BINS as f64);
        let mut counts = [0.0; BINS];
        for _ in 0..SAMPLES {
            let x = phase.sample(|| random.unit());
            assert!((0.0..=2.0).contains(&x));
            sum += x;
            squares += x * x;
            let from_peak = if backward { 2.0 - x } else { x };
            let bin = (1..BINS).filter(|i| from_peak >= edge(*i)).count();
            counts[bin] += 1.0;
        }
        let n = SAMPLES as f64;
        let error = ((squares / n - (sum / n).powi(2)).max(0.0) / n).sqrt();
        let off = (1.0 - sum / n - phase.mean_cosine()).abs();
        assert!(off < 3.5 * error + 1e-12, "{function:?}: {off} of {error}");
        compared += 1;
        beyond_two += u32::from(off > 2.0 * error);
        let oriented = if backward {
            Phase {
                g_hg: -phase.g_hg,
                g_draine: -phase.g_draine,
                ..phase
            }
        } else {
            phase
        };
        let (mut chi, mut degrees) = (0.0, -1.0);
        for (i, count) in counts.iter().enumerate() {
            let low = if i == 0 { 1e-14 } else { edge(i) };
            let expected = n * integral(&oriented, low, edge(i + 1), |_| 1.0);
            if expected > 10.0 {
                chi += (count - expected).powi(2) / expected;
                degrees += 1.0;
            }
        }
        // Chi² has the mean `degrees` and the variance 2 `degrees`.
        assert!(
            chi < degrees + 4.5 * (2.0f64 * degrees).sqrt() + 5.0,
            "{function:?}: {chi} for {degrees} degrees of freedom"
        );
    }
    println!("mean cosines: {compared} compared, {beyond_two} beyond 2 standard errors");
    assert!(beyond_two <= 6);
}

#[test]
fn turned_directions_have_their_angle_and_go_all_round() {
    for from in [
        DVec3::X,
        DVec3::Y,
        DVec3::Z,
        -DVec3::Z,
        DVec3::new(0.6, -0.48, 0.64),
    ] {
        let mut sum = DVec3::ZERO;
        for k in 0..8 {
            let to = turned(from, 0.3, f64::from(k) * PI / 4.0);
            assert!((to.length() - 1.0).abs() < 1e-14);
            assert!((1.0 - from.dot(to) - 0.3).abs() < 1e-14);
            sum += to / 8.0;
        }
        assert!((sum - from * 0.7).length() < 1e-14);
    }
}
