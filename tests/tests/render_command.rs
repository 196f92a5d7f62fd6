//! `skycell-server render`: whatever renders, a preset is the same sky at the same moment.

use anyhow::ensure;
use skycell_tests::server::{binary, target_dir};
use std::path::Path;
use std::process::Command;

/// Largest sum of differences as a share of the sum of radiance. Pictures of so few pixels have edges of clouds in many of them,
/// where f32 and f64 may take another step; another sky, or one without its air, is off by tens of percent.
const APART_MAX: f64 = 0.03;

/// Linear radiance of a small picture by the steps of the device: the ray through the middle of each pixel.
fn radiance(
    preset: &str,
    renderer: &str,
    choices: &[&str],
    out: &Path,
) -> anyhow::Result<Vec<f32>> {
    let done = Command::new(binary("skycell-server")?)
        .args(["render", "--preset", preset, "--renderer", renderer])
        .args(["--width", "16", "--height", "9", "--samples", "1"])
        .args(["--steps", "48", "--out"])
        .arg(out)
        .arg("--noise-cache-dir")
        .arg(target_dir()?.join("noise-of-tests"))
        .args(choices)
        .output()?;
    ensure!(
        done.status.success(),
        "{}",
        String::from_utf8_lossy(&done.stderr)
    );
    Ok(image::open(out)?.to_rgb32f().into_raw())
}

fn apart(a: &[f32], b: &[f32]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| f64::from((a - b).abs())).sum();
    sum / b.iter().map(|b| f64::from(*b)).sum::<f64>()
}

#[test]
fn device_and_reference_show_the_same_sky_at_the_same_moment() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let out = scratch.path().join("sky.exr");
    let all = "detail-noise,ambient,aerial-perspective,early-exit";
    let an_hour = ["--approximations", all, "--time-s", "3600"];
    for (preset, choices) in [
        // As numbers are asked for: without approximations.
        ("storm", &[] as &[&str]),
        ("cirrus-evening", &["--approximations", "ambient"]),
        (
            "fair-weather-cumulus",
            &[
                "--approximations",
                "aerial-perspective",
                "--at",
                "2026-06-21T18:30:00Z",
            ],
        ),
        ("storm", &an_hour),
    ] {
        let device = radiance(preset, "screen-space", choices, &out)?;
        let reference = radiance(preset, "reference", choices, &out)?;
        let off = apart(&device, &reference);
        println!("{preset} {choices:?}: {off:.4}");
        ensure!(off < APART_MAX, "{preset} {choices:?}: {off}");
        if choices == an_hour {
            // Planted: the sky of another hour.
            let now = radiance(preset, "screen-space", &an_hour[..2], &out)?;
            let off = apart(&now, &reference);
            ensure!(off > 2.0 * APART_MAX, "another hour is only {off} off");
        }
    }
    Ok(())
}
