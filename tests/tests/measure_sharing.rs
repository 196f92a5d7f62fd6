//! What viewers who share pay and see, by `skycell-server measure` from the command line to the page: `distance`, `walk`, `proxies`,
//! `living` and `scaling`, on whatever renders here.

use image::AnimationDecoder;
use image::codecs::png::PngDecoder;
use serde_json::Value;
use skycell_server::cells::ErrorCurves;
use skycell_tests::server::{binary, target_dir};
use std::io::Cursor;
use std::path::Path;
use std::process::{Command, Output};

fn measure(what: &str, out: &Path, arguments: &[&str]) -> anyhow::Result<Output> {
    measure_all(what, out, &[&["--quick"], arguments].concat())
}

fn measure_all(what: &str, out: &Path, arguments: &[&str]) -> anyhow::Result<Output> {
    Ok(Command::new(binary("skycell-server")?)
        .args(["measure", what, "--json", "--out"])
        .arg(out)
        .arg("--noise-cache-dir")
        .arg(target_dir()?.join("noise-of-tests"))
        .args(arguments)
        .output()?)
}

/// Arguments as they are typed.
fn typed(line: &str) -> Vec<&str> {
    line.split_whitespace().collect()
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
    let arguments = typed(
        "--size 96x54 --steps 32 --samples 2 --ways walk --variants phase,all --frames 6 --from-m 200 --step-m 20",
    );
    let report = report(&measure_all("walk", scratch.path(), &arguments)?)?;
    let swimming = numbers(&report["sequences"], "swimming");
    let pops = numbers(&report["sequences"], "pop");
    println!("{swimming:?} {pops:?}");
    // Measured: 1.33 and 1.05; over 300 m at 192x108 1.13 and 0.77.
    assert!(swimming[1] < 0.9 * swimming[0], "{swimming:?}");
    assert!(pops.iter().all(|pop| *pop < 1.5), "{pops:?}");
    for name in ["walk-own-rays/0005.png", "walk-all/0005.png", "walk.jpg"] {
        assert!(scratch.path().join(name).is_file(), "{name}");
    }
    let moving = std::fs::read(scratch.path().join("walk-all.png"))?;
    let moving = PngDecoder::new(Cursor::new(moving))?.apng()?;
    let frames = moving.into_frames().collect_frames()?;
    assert_eq!(frames.len(), 6);
    let last = image::open(scratch.path().join("walk-all/0005.png"))?.to_rgb8();
    let shown = frames[5].buffer();
    let is_same = |(x, y, pixel): (u32, u32, &image::Rgb<u8>)| {
        let [r, g, b, _] = shown.get_pixel(x + 100, y).0;
        pixel.0 == [r, g, b]
    };
    assert!(last.enumerate_pixels().all(is_same));
    Ok(())
}

#[test]
fn a_group_that_walks_is_marched_for_once_in_a_cell_that_goes_along() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let arguments = typed(
        "--size 64x36 --viewers 6 --spread-m 200 --walk-m-per-s 5 --beside-own-cells --seconds 2 --fps 5 --steps 16 --samples 2 \
         --texels-per-ray 10 --moments 2 --pictures",
    );
    let found = report(&measure_all("living", scratch.path(), &arguments)?)?;
    let number = |of: &Value, key: &str| of[key].as_f64().unwrap_or(f64::NAN);
    let own = &found["own_cells"];
    assert_eq!([number(&found, "cells"), number(own, "cells")], [1.0, 6.0]);
    let [together, apart] = [&found, own].map(|of| number(of, "texels"));
    let [seen, seen_apart] = [&found, own].map(|of| number(of, "flip"));
    println!("{together} texels {apart}, FLIP {seen} {seen_apart}");
    assert!(together > 0.0 && apart > 1.5 * together);
    // Measured: 139 264 and 323 584 texels, FLIP .038 and .039 of so small pictures.
    assert!(seen < 0.06 && seen_apart < 0.06);
    assert!(scratch.path().join("sheet.jpg").is_file());
    Ok(())
}

#[test]
fn each_setup_of_proxies_is_held_against_rays_of_the_eyes_own() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let arguments = typed(
        "--size 64x36 --steps 16 --samples 2 --only in-layer,static-dome --views away-from-sun --directions sideways \
         --distances-m 0,1000,3000",
    );
    let found = report(&measure_all("proxies", scratch.path(), &arguments)?)?;
    let flips = numbers(&found["points"], "flip");
    println!("{flips:?}");
    // In the layer, in four slabs, on a dome; each alone and searched.
    assert_eq!(flips.len(), 3 * 2 * 3);
    for of_row in flips.chunks(3) {
        assert!(of_row[0] < of_row[1] && of_row[1] < of_row[2], "{of_row:?}");
    }
    // A search finds what a surface alone shows elsewhere, and a dome is elsewhere more than a shell.
    let at_1_km: Vec<f64> = flips.iter().skip(1).step_by(3).copied().collect();
    let [shell, shell_searched, _, _, dome, dome_searched] = at_1_km[..] else {
        anyhow::bail!("six rows: {at_1_km:?}");
    };
    assert!(shell_searched < 0.8 * shell && dome_searched < 0.8 * dome);
    assert!(shell < dome);
    let page = std::fs::read_to_string(scratch.path().join("proxies.html"))?;
    assert_eq!(page.matches("<svg").count(), 2);
    Ok(())
}

/// Sixteen who look around for a minute under 10 m/s: a twentieth of the rays that a screen-space renderer for each would march, at
/// the accuracy that is published for mip bias 1.
#[test]
#[ignore = "slower suite: deploy/test --full"]
fn a_minute_of_living_caches_takes_a_twentieth_of_the_rays() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let arguments =
        typed("--size 640x360 --seconds 60 --moments 12 --mip-bias 0.5 --age-factor 0.4");
    let found = report(&measure_all("living", scratch.path(), &arguments)?)?;
    let number = |key: &str| found[key].as_f64().unwrap_or(f64::NAN);
    let [share, flip, ssim] = ["texels_per_ray", "flip", "ssim"].map(number);
    println!("1/{:.1}, FLIP {flip:.4}, SSIM {ssim:.4}", 1.0 / share);
    assert!(share <= 1.0 / 20.0 && flip <= 0.0088 && ssim >= 0.995);
    Ok(())
}

/// Where the plain cache is at 1 km aside or 300 m up, one searched sphere is not before 3 km or 600 m, and four searched slabs not
/// before 4.5 km or 800 m.
#[test]
#[ignore = "slower suite: deploy/test --full"]
fn a_search_and_slabs_reach_the_plain_caches_error_that_much_later() -> anyhow::Result<()> {
    let scratch = tempfile::tempdir()?;
    let arguments = typed("--directions sideways,up --variants plain,parallax,all --samples 4");
    let found = report(&measure_all("distance", scratch.path(), &arguments)?)?;
    let reaches = found["reaches"].as_array().map_or(&[][..], Vec::as_slice);
    for (variant, sideways_m, up_m) in [("parallax", 3_000.0, 600.0), ("all", 4_500.0, 800.0)] {
        let of_variant = reaches.iter().filter(|reach| reach["variant"] == variant);
        let of_variant: Vec<&Value> = of_variant.collect();
        assert_eq!(of_variant.len(), 4, "both views, both directions");
        for reach in of_variant {
            let wanted_m = match reach["direction"].as_str() {
                Some("up") => up_m,
                _ => sideways_m,
            };
            // None: not within what was measured.
            let reached_m = reach["reached_m"].as_f64().unwrap_or(f64::INFINITY);
            println!("{reach}");
            assert!(reached_m >= wanted_m, "{reach}");
        }
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
