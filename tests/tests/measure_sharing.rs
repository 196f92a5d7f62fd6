//! `skycell-server measure distance` and `measure scaling` from the command line to the page, on whatever renders here.

use serde_json::Value;
use skycell_server::cells::ErrorCurves;
use skycell_tests::server::{binary, target_dir};
use std::path::Path;
use std::process::{Command, Output};

fn measure(what: &str, out: &Path, arguments: &[&str]) -> anyhow::Result<Output> {
    Ok(Command::new(binary("skycell-server")?)
        .args(["measure", what, "--quick", "--json", "--out"])
        .arg(out)
        .arg("--noise-cache-dir")
        .arg(target_dir()?.join("noise-of-tests"))
        .args(arguments)
        .output()?)
}

fn report(output: &Output) -> anyhow::Result<Value> {
    anyhow::ensure!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    Ok(serde_json::from_slice(&output.stdout)?)
}

fn numbers(list: &Value, key: &str) -> Vec<f64> {
    let list = list.as_array().map_or(&[][..], Vec::as_slice);
    list.iter().filter_map(|one| one[key].as_f64()).collect()
}

#[test]
fn the_error_grows_with_the_distance_and_cells_get_their_limit_from_it() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let out = scratch.path().join("distance");
    let curve = scratch.path().join("curve.json");
    let curve_name = curve.display().to_string();
    let arguments = [
        "--directions",
        "sideways,up",
        "--views",
        "away-from-sun",
        "--write-curve",
        &curve_name,
    ];
    let first = report(&measure("distance", &out, &arguments)?)?;
    let points = first["points"].as_array().expect("points");
    // Each variant's points of a direction stand together, by rising distance.
    for pair in points.windows(2) {
        let [near_m, far_m] = [0, 1].map(|i| pair[i]["distance_m"].as_f64().unwrap_or(f64::NAN));
        let [near, far] = [0, 1].map(|i| pair[i]["flip"].as_f64().unwrap_or(f64::NAN));
        assert!(far_m < near_m || far > near, "{pair:?}");
    }
    // What each way to read the cache is for: 1 km aside a search halves the error, and slabs leave less.
    let flip_of = |variant: &str| {
        let is_it = |p: &&Value| {
            p["variant"] == variant && p["direction"] == "sideways" && p["distance_m"] == 1_000.0
        };
        let point = points.iter().find(is_it);
        point.and_then(|p| p["flip"].as_f64()).unwrap_or(f64::NAN)
    };
    let [plain, slabs, parallax, all] = ["plain", "slabs", "parallax", "all"].map(flip_of);
    // Measured: .133, .060, .060 and .038.
    assert!(
        all < 0.8 * parallax && parallax < 0.6 * plain && slabs < 0.6 * plain,
        "{plain} {slabs} {parallax} {all}"
    );
    let page = std::fs::read_to_string(out.join("distance.html"))?;
    assert!(page.contains("<svg") && !page.contains("src=\"http") && !page.contains("<script"));

    // What a server would make of it: the widest cell is as wide as was measured, and errors between give widths between.
    let curves = ErrorCurves::from_json_text(&std::fs::read_to_string(&curve)?)?;
    let curve = curves.of(1, 0);
    assert_eq!(curve.limit(1.0).radius_m(), 3_000.0);
    let flip = curve.flip(500.0, 0.0);
    assert!((curve.limit(flip).radius_m() - 500.0).abs() < 1.0, "{flip}");

    // What is there is not measured again, and says the same.
    let begun = std::time::Instant::now();
    let again = measure("distance", &out, &arguments)?;
    println!("again in {:?}", begun.elapsed());
    assert_eq!(
        String::from_utf8_lossy(&again.stderr)
            .matches("is there")
            .count(),
        points.len()
    );
    assert_eq!(report(&again)?, first);
    Ok(())
}

#[test]
fn what_is_searched_in_slabs_moves_more_like_rays_of_its_own() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let output = Command::new(binary("skycell-server")?)
        .args(["measure", "walk", "--json", "--out"])
        .arg(scratch.path())
        .arg("--noise-cache-dir")
        .arg(target_dir()?.join("noise-of-tests"))
        .args(["--size", "96x54", "--steps", "32", "--samples", "2"])
        .args(["--ways", "walk", "--variants", "phase,all"])
        .args(["--frames", "6", "--from-m", "200", "--step-m", "20"])
        .output()?;
    let report = report(&output)?;
    let swimming = numbers(&report["sequences"], "swimming");
    let pops = numbers(&report["sequences"], "pop");
    println!("{swimming:?} {pops:?}");
    // Measured: 1.33 and 1.05; over 300 m at 192x108 1.13 and 0.77.
    assert!(swimming[1] < 0.9 * swimming[0], "{swimming:?}");
    assert!(pops.iter().all(|pop| *pop < 1.5), "{pops:?}");
    for name in ["walk-own-rays/0005.png", "walk-all/0005.png", "walk.jpg"] {
        assert!(scratch.path().join(name).is_file(), "{name}");
    }
    Ok(())
}

#[test]
fn crowds_keep_their_limits_and_rings_march_what_they_do_not_share() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let out = scratch.path().join("scaling");
    let found = report(&measure("scaling", &out, &["--size", "96x54"])?)?;
    let crowds = &found["crowds"];
    assert_eq!(crowds.as_array().map(Vec::len), Some(4));
    assert!(
        numbers(crowds, "widest_share")
            .iter()
            .all(|share| *share <= 1.0)
    );
    assert_eq!(numbers(crowds, "flips"), [0.0; 4]);
    for crowd in crowds.as_array().expect("crowds") {
        assert!(
            crowd["texels"]["per_viewer_second"].as_f64() > Some(0.0),
            "{crowd}"
        );
        assert_eq!(crowd["seconds"].as_array().map(Vec::len), Some(30));
    }
    let rings = &found["rings"];
    let [one, apart, same] = numbers(rings, "marches")[..] else {
        anyhow::bail!("three rings: {rings}");
    };
    // Four who look the same way take what one takes; four who share nothing take more, and no more than four times that.
    let requested = numbers(rings, "texels_requested");
    assert!(same < apart && apart <= 4.0 * one, "{one} {apart} {same}");
    assert_eq!(numbers(rings, "overlap"), [0.0, 0.0, 1.0]);
    let measured = numbers(rings, "measured_overlap");
    assert!(measured[1] < 0.9 && measured[2] == 1.0, "{measured:?}");
    let unique = numbers(rings, "texels_unique");
    assert_eq!(unique[2] * 4.0, requested[2]);
    let page = std::fs::read_to_string(out.join("scaling.html"))?;
    assert!(page.contains("40 who wander") && page.contains("<svg"));
    Ok(())
}

#[test]
fn wrong_arguments_are_named_with_what_is_allowed() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    for (what, arguments, said) in [
        (
            "scaling",
            ["--motions", "dance"],
            ["--motions", "dance", "wander"],
        ),
        (
            "scaling",
            ["--overlaps", "140"],
            ["--overlaps", "140", "0 to 100"],
        ),
        (
            "scaling",
            ["--crowd-viewers", "0"],
            ["--crowd-viewers", "0", "1 to"],
        ),
        (
            "distance",
            ["--directions", "down"],
            ["--directions", "down", "sideways"],
        ),
    ] {
        let output = measure(what, scratch.path(), &arguments)?;
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success());
        assert!(said.iter().all(|word| error.contains(word)), "{error}");
    }
    Ok(())
}
