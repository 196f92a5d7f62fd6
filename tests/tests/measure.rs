//! `skycell-server measure trade` and `measure codec` from the command line to the page, on whatever renders here.

use serde_json::Value;
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use skycell_server::measure::reference::{shown_picture, without_alpha};
use skycell_tests::server::{binary, target_dir};
use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

fn measure(out: &Path, arguments: &[&str]) -> anyhow::Result<Output> {
    measure_what("trade", out, arguments)
}

fn measure_what(what: &str, out: &Path, arguments: &[&str]) -> anyhow::Result<Output> {
    Ok(Command::new(binary("skycell-server")?)
        .args(["measure", what, "--json", "--out"])
        .arg(out)
        .arg("--noise-cache-dir")
        .arg(target_dir()?.join("noise-of-tests"))
        .args(arguments)
        .output()?)
}

fn summary(output: &Output) -> anyhow::Result<Value> {
    anyhow::ensure!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    Ok(serde_json::from_slice(&output.stdout)?)
}

#[test]
fn a_quick_run_writes_the_report_and_each_rung_saves_what_it_says() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let out = scratch.path().join("trade");
    let quality = scratch.path().join("quality.json");
    let quality_name = quality.display().to_string();
    let arguments = [
        "--quick",
        "--only",
        "ladder,mip-bias,front",
        "--size",
        "96x54",
        "--write-quality",
        &quality_name,
    ];
    let first = summary(&measure(&out, &arguments)?)?;

    let rungs = first["ladder"].as_array().expect("rungs");
    let names: Vec<&str> = rungs
        .iter()
        .filter_map(|rung| rung["name"].as_str())
        .collect();
    assert_eq!(names, skycell_server::measure::plan::RUNGS);
    let reads: Vec<f64> = rungs
        .iter()
        .filter_map(|rung| rung["frame"]["texture_reads"].as_f64())
        .collect();
    assert_eq!(reads.len(), rungs.len(), "reads are counted");
    for (pair, name) in reads.windows(2).zip(&names[1..]) {
        assert!(
            pair[1] <= pair[0],
            "{name} reads more than the rung above: {reads:?}"
        );
    }
    // Nothing that is left out by an early exit or by skipping can be seen.
    let flip = |rung: usize| rungs[rung]["flip"].as_f64().unwrap_or(f64::NAN);
    assert!(
        (flip(1) - flip(0)).abs() < 0.005 && (flip(2) - flip(1)).abs() < 0.005,
        "{first}"
    );
    let rays: Vec<f64> = rungs
        .iter()
        .filter_map(|rung| rung["frame"]["marches"].as_f64())
        .collect();
    let (half, quarter) = (rays[5] / rays[4], rays[6] / rays[4]);
    assert!(
        (half - 0.25).abs() < 0.02 && (quarter - 0.0625).abs() < 0.01,
        "half {half}, quarter {quarter}"
    );

    let page = std::fs::read_to_string(out.join("report.html"))?;
    for name in skycell_server::measure::plan::RUNGS {
        assert!(page.contains(name), "the page has no {name}");
    }
    assert!(page.contains("<svg") && page.contains("data:image/jpeg;base64,"));
    for elsewhere in ["src=\"http", "href=\"http", "<script"] {
        assert!(!page.contains(elsewhere), "the page needs nothing else");
    }
    let results: Value = serde_json::from_slice(&std::fs::read(out.join("results.json"))?)?;
    let points = results["points"].as_array().expect("points");
    let rows = std::fs::read_to_string(out.join("results.csv"))?
        .lines()
        .count();
    assert_eq!(
        rows,
        points.len() + 1,
        "a row for each point below the names"
    );

    let quality: Value = serde_json::from_slice(&std::fs::read(&quality)?)?;
    let best = quality["points"]
        .as_array()
        .and_then(|points| points.last())
        .expect("a point");
    assert_eq!(
        (&best["preset"], &best["cost"]["relative"]),
        (&"reference".into(), &1.0.into())
    );
    // Octaves are the scene's: another number is another sky.
    assert!(best["settings"]["march_steps"].is_u64() && best["settings"]["octaves"].is_null());

    // What is there is not measured again.
    let again = summary(&measure(&out, &arguments)?)?;
    assert_eq!(again["measured_now"], 0, "{again}");
    assert_eq!(again["points"], first["points"]);
    Ok(())
}

#[test]
fn wrong_arguments_are_named_with_what_is_allowed() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let file = scratch.path().join("file");
    std::fs::write(&file, b"")?;
    for (out, arguments, said) in [
        (
            scratch.path().to_owned(),
            ["--only", "colour"],
            ["--only", "colour", "sun-steps"],
        ),
        (
            scratch.path().to_owned(),
            ["--size", "4x4"],
            ["--size", "4x4", "11x11"],
        ),
        (
            file.join("in-a-file"),
            ["--size", "96x54"],
            ["--out", "in-a-file", "cannot"],
        ),
    ] {
        let output = measure(&out, &arguments)?;
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success());
        assert!(said.iter().all(|word| error.contains(word)), "{error}");
    }
    Ok(())
}

/// The reference's shown picture is made from its radiance on the processor, the tested ones' on the device. There two by
/// two pixels share the clear sky, in radiance they do not: the angle of view is so small that it makes no difference.
#[test]
fn the_shown_picture_of_radiance_is_the_devices_own() -> anyhow::Result<()> {
    let config = RenderConfig::new(target_dir()?.join("noise-of-tests"));
    let mut still = StillRenderer::new(config, Arc::default(), &[])?;
    let size = FrameSize::new(64, 36)?;
    let settings = StillSettings {
        renderer: RendererKind::ScreenSpace,
        samples: 1,
        ..StillSettings::default()
    };
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 15.0, 1.0)?;
    let picture = still.render_with(camera, size, &settings, |_| {})?;
    let shown = shown_picture(&without_alpha(&picture.linear), size, &Scene::default());
    for (at, (ours, devices)) in shown
        .as_raw()
        .iter()
        .zip(without_alpha(&picture.display))
        .enumerate()
    {
        assert!(
            ours.abs_diff(devices) <= 1,
            "value {at}: {ours} and {devices}"
        );
    }
    Ok(())
}

#[test]
fn the_codec_study_tells_that_more_bits_are_closer_to_the_picture() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let out = scratch.path().join("codec");
    // A turn so fast, of pictures so large, that the lower rate is too little.
    let arguments = "--sizes 320x180 --rates-kbit-per-s 100,4000 --jpeg-qualities 20,95 --seconds 1 --fps 30 \
                     --turn-deg-per-s 60 --compared-every 10 --steps 8 --samples 1";
    let arguments: Vec<&str> = arguments.split_whitespace().collect();
    let report = summary(&measure_what("codec", &out, &arguments)?)?;
    let file: Value = serde_json::from_slice(&std::fs::read(out.join("codec.json"))?)?;
    assert_eq!(file, report);
    let points = report["points"].as_array().expect("points");
    assert_eq!(points.len(), 8, "{report:#}");
    let number = |point: usize, key: &str| points[point][key].as_f64().expect("a number");
    for (coarse, fine) in [(0, 1), (2, 3), (4, 5)] {
        assert!(
            number(fine, "flip") < 0.95 * number(coarse, "flip"),
            "{report:#}"
        );
        assert!(
            number(fine, "mbit_per_s") > number(coarse, "mbit_per_s"),
            "{report:#}"
        );
        assert_eq!(number(coarse, "compared"), 3.0, "{report:#}");
    }
    // Colours that are spread are closer than plain ones, compressed and not.
    for (spread, plain) in [(1, 3), (6, 7)] {
        assert!(
            number(spread, "flip") < 0.9 * number(plain, "flip"),
            "{report:#}"
        );
    }
    assert!(report["bar_is_met"].is_null(), "the bar is another size's");
    let page = std::fs::read_to_string(out.join("codec.html"))?;
    assert!(page.contains("<svg") && page.contains("JPEG 95"));
    Ok(())
}
