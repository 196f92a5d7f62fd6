//! `measure octaves`: how far light that clouds scatter more than once is from the path tracer's.
//!
//! `shapes` says what is looked at, `truth` what the path tracer sees (kept in a file), `model` what the renderer's model
//! makes of the same rays, `fit` finds its constants.

mod fit;
pub mod model;
pub mod shapes;
pub mod truth;

use anyhow::Context;
use model::{Look, Model, SunMarch, looks};
use serde::Serialize;
use shapes::{Droplets, shapes};
use skycell_protocol::scene::{FITTED, FittedScattering};
use std::path::PathBuf;
use truth::{Effort, Truth};

/// What `measure octaves` is asked for.
#[derive(Clone, Debug, clap::Args)]
pub struct OctavesArguments {
    /// What the path tracer has seen.
    #[arg(
        long,
        default_value = "tests/data/oracles/octaves.json",
        value_name = "FILE"
    )]
    pub truth: PathBuf,
    /// Trace the truth anew and write it there: a quarter of an hour on one core with 2500 paths.
    #[arg(long)]
    pub trace: bool,
    /// Paths of a look, with --trace.
    #[arg(long, default_value_t = 2500, value_parser = clap::value_parser!(u64).range(64..=10_000_000))]
    pub paths: u64,
    /// Seed of the paths, with --trace.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Search for constants that fit better, and judge them.
    #[arg(long)]
    pub fit: bool,
    /// Samples towards the sun.
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub sun_steps: u32,
    /// How far they reach, m.
    #[arg(long)]
    pub sun_march_distance_m: Option<f64>,
    /// Print as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Relative errors of a model over some looks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Errors {
    /// How many looks.
    pub looks: usize,
    /// Mean of the relative luminance error.
    pub mean: f64,
    /// Its 95th percentile.
    pub p95: f64,
    /// Median of modelled over exact.
    pub median_quotient: f64,
}

impl Errors {
    /// Of pairs of modelled and exact values.
    #[must_use]
    pub fn of(pairs: impl Iterator<Item = (f64, f64)>) -> Self {
        let mut errors = Vec::new();
        let mut quotients = Vec::new();
        for (modelled, exact) in pairs {
            errors.push((modelled - exact).abs() / exact);
            quotients.push(modelled / exact);
        }
        errors.sort_by(f64::total_cmp);
        quotients.sort_by(f64::total_cmp);
        let at = |sorted: &[f64], share: f64| {
            let index = (share * sorted.len() as f64) as usize;
            sorted
                .get(index.min(sorted.len().saturating_sub(1)))
                .copied()
                .unwrap_or(0.0)
        };
        Self {
            looks: errors.len(),
            mean: errors.iter().sum::<f64>() / errors.len().max(1) as f64,
            p95: at(&errors, 0.95),
            median_quotient: at(&quotients, 0.5),
        }
    }
}

/// The models that are compared.
#[must_use]
pub fn models(fitted: FittedScattering) -> [(&'static str, Model); 6] {
    [
        ("single scattering", Model::Single),
        ("octaves 4, 0.5 0.5 0.5", Model::Octaves(4, 0.5, 0.5, 0.5)),
        ("octaves 8, 0.5 0.5 0.5", Model::Octaves(8, 0.5, 0.5, 0.5)),
        (
            "octaves 8, fitted a b c",
            Model::Octaves(8, 0.179, 0.384, 0.685),
        ),
        ("octaves 8 with powder", Model::Powder(8, 0.5, 0.5, 0.5)),
        ("fitted", Model::Fitted(fitted)),
    ]
}

/// Errors of one model, over all looks and over parts of them.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The model.
    pub model: &'static str,
    /// Part of the looks and its errors.
    pub parts: Vec<(String, Errors)>,
}

/// What is printed.
#[derive(Clone, Debug, Serialize)]
struct Report {
    constants: [f64; 12],
    sunlight: Vec<Row>,
    sky: Vec<Row>,
}

/// Errors of scattered sunlight for each model.
#[must_use]
pub fn sunlight_errors(looks: &[Look], fitted: FittedScattering) -> Vec<Row> {
    models(fitted)
        .into_iter()
        .map(|(name, model)| {
            row(name, looks, |look| {
                Some((look.modelled(&model), look.sunlit.mean))
            })
        })
        .collect()
}

/// Errors of the sky's light.
#[must_use]
pub fn sky_errors(looks: &[Look], fitted: FittedScattering) -> Vec<Row> {
    // The sky knows no sun: one of them stands for all.
    let seen = |look: &Look, modelled: f64| {
        let known = look.sky.mean > 3.0 * look.sky.standard_error && look.sun_deg == 30.0;
        known.then_some((modelled, look.sky.mean))
    };
    vec![
        row("by height", looks, |look| seen(look, look.sky_by_height())),
        row("fitted", looks, |look| {
            seen(look, look.modelled_sky(&fitted))
        }),
    ]
}

fn row(model: &'static str, looks: &[Look], pair: impl Fn(&Look) -> Option<(f64, f64)>) -> Row {
    let over = |used: &dyn Fn(&Look) -> bool| {
        Errors::of(looks.iter().filter(|l| used(l)).filter_map(&pair))
    };
    let mut parts = vec![
        ("all".to_owned(), over(&|_| true)),
        ("fitted to".to_owned(), over(&|look| !look.held_out)),
        ("held out".to_owned(), over(&|look| look.held_out)),
    ];
    for droplets in Droplets::ALL {
        parts.push((
            droplets.name().to_owned(),
            over(&|look| look.droplets == droplets),
        ));
    }
    for shape in shapes() {
        parts.push((
            shape.name.to_owned(),
            over(&|look| look.shape == shape.name),
        ));
    }
    Row { model, parts }
}

/// Measures, and prints what it found.
///
/// # Errors
/// For a truth that cannot be read or written.
pub fn run(arguments: &OctavesArguments) -> anyhow::Result<()> {
    if arguments.trace {
        let truth = Truth::trace(Effort {
            seed: arguments.seed,
            paths: arguments.paths,
        })?;
        std::fs::write(&arguments.truth, serde_json::to_string(&truth)? + "\n")
            .with_context(|| format!("{} cannot be written", arguments.truth.display()))?;
    }
    let truth = Truth::read(&arguments.truth)?;
    let looks = looks(
        &truth,
        SunMarch {
            steps: arguments.sun_steps,
            distance_m: arguments.sun_march_distance_m,
        },
    )?;
    let fitted = if arguments.fit {
        fit::fitted(&looks, FITTED)
    } else {
        FITTED
    };
    let report = Report {
        constants: [
            fitted.forward_attenuation,
            fitted.forward_strength,
            fitted.forward_eccentricity,
            fitted.diffuse_strength,
            fitted.diffuse_eccentricity,
            fitted.diffuse_slope,
            fitted.diffuse_thickness,
            fitted.diffuse_leak,
            fitted.diffuse_width,
            fitted.sky_slope,
            fitted.sky_thinness,
            fitted.sky_forward,
        ],
        sunlight: sunlight_errors(&looks, fitted),
        sky: sky_errors(&looks, fitted),
    };
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
        return Ok(());
    }
    println!("{fitted:#?}");
    for (title, rows) in [
        ("Scattered sunlight", &report.sunlight),
        ("The sky's light", &report.sky),
    ] {
        println!(
            "\n{title}: mean and 95th percentile of the relative error (median of modelled over traced)"
        );
        print!("{:18}", "");
        for row in rows {
            print!("{:>26}", row.model);
        }
        println!();
        let parts = rows.first().map_or(0, |row| row.parts.len());
        for part in 0..parts {
            for (column, row) in rows.iter().enumerate() {
                let (name, errors) = &row.parts[part];
                if column == 0 {
                    print!("{name:18}");
                }
                print!(
                    "{:>12.2} {:>6.2} ({:.2})",
                    errors.mean, errors.p95, errors.median_quotient
                );
            }
            println!();
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::shapes::SUN_ELEVATIONS_DEG;
    use super::*;

    fn truth() -> Truth {
        let path = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../tests/data/oracles/octaves.json"
        );
        Truth::read(std::path::Path::new(path)).expect("the truth")
    }

    fn of<'a>(rows: &'a [Row], model: &str, part: &str) -> &'a Errors {
        let row = rows.iter().find(|row| row.model == model).expect("a model");
        let found = row.parts.iter().find(|(name, _)| name == part);
        &found.expect("a part").1
    }

    #[test]
    fn fitted_light_halves_the_error_of_customary_octaves() {
        let truth = truth();
        assert!(truth.shapes.len() >= 2 * 12);
        const { assert!(SUN_ELEVATIONS_DEG[0] <= 5.0 && SUN_ELEVATIONS_DEG[4] >= 90.0) };
        let march = SunMarch {
            steps: 6,
            distance_m: None,
        };
        let looks = looks(&truth, march).expect("the same shapes");
        let rows = sunlight_errors(&looks, FITTED);
        let fitted = of(&rows, "fitted", "all");
        for customary in ["octaves 4, 0.5 0.5 0.5", "octaves 8, 0.5 0.5 0.5"] {
            let before = of(&rows, customary, "all");
            println!("{customary}: {before:?}, fitted: {fitted:?}");
            assert!(fitted.mean < 0.5 * before.mean && fitted.p95 < 0.5 * before.p95);
        }
        // Shapes that no constant was fitted to.
        let held_out = of(&rows, "fitted", "held out");
        assert!(held_out.mean < 0.6 * of(&rows, "octaves 8, 0.5 0.5 0.5", "held out").mean);
        // Without knowing how thick a cloud is, the error is not halved: the test can tell.
        let mut blind = FITTED;
        blind.diffuse_thickness = 1e-3;
        let blind = sunlight_errors(&looks, blind);
        assert!(of(&blind, "fitted", "all").mean > 1.5 * fitted.mean);
        let sky = sky_errors(&looks, FITTED);
        let (before, after) = (of(&sky, "by height", "all"), of(&sky, "fitted", "all"));
        println!("sky by height: {before:?}, fitted: {after:?}");
        assert!(after.mean < 0.5 * before.mean && after.p95 < 0.5 * before.p95);
    }

    #[test]
    fn the_kept_truth_is_what_the_path_tracer_sees() {
        let kept = truth();
        let shape = shapes()[0];
        let known = kept.of(&shape, Droplets::Hg).expect("the first shape");
        let seen = truth::traced(
            &shape,
            Droplets::Hg,
            Effort {
                seed: 99,
                paths: 400,
            },
        )
        .expect("paths");
        for (known, seen) in known.measured.iter().zip(&seen.measured) {
            let apart = (known.sky.mean - seen.sky.mean).abs();
            let error = known.sky.standard_error.hypot(seen.sky.standard_error);
            assert!(
                apart < 4.5 * error,
                "view {}: {apart} of {error}",
                known.view
            );
        }
    }
}
