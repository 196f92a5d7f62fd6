//! `GET /api/v1/snapshot` and `skycell scene snapshot` of a real server.

use std::process::Command;

use skycell_protocol::FrameSize;
use skycell_protocol::message::Hello;
use skycell_tests::server::binary;
use skycell_tests::viewer::camera;
use skycell_tests::{Server, Viewer, tone, until};

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_shows_the_sky_in_its_direction_and_leaves_no_viewer_behind()
-> anyhow::Result<()> {
    let server = Server::start_calm().await?;
    let picture = async |query: &str| -> anyhow::Result<image::RgbImage> {
        let url = server.url(&format!("api/v1/snapshot?width=96&height=54&{query}"));
        let answer = server.http().get(url).send().await?.error_for_status()?;
        assert_eq!(answer.headers()["content-type"], "image/png");
        Ok(image::load_from_memory(&answer.bytes().await?)?.into_rgb8())
    };
    let up = picture("pitch_deg=60").await?;
    let down = picture("pitch_deg=-60").await?;
    assert_eq!((up.width(), up.height()), (96, 54));
    let mean = |picture: &image::RgbImage| {
        let sum: u64 = picture.as_raw().iter().map(|byte| u64::from(*byte)).sum();
        sum as f64 / picture.as_raw().len() as f64
    };
    println!("mean up {:.1}, down {:.1}", mean(&up), mean(&down));
    // The sky at noon is brighter than the ground that it lights.
    assert!(mean(&up) > mean(&down) + 10.0);
    until("viewers that have left", async || {
        let viewers = server.get("api/v1/viewers").await?;
        Ok(viewers.as_array().is_some_and(Vec::is_empty).then_some(()))
    })
    .await?;

    let scratch = tempfile::tempdir()?;
    let file = scratch.path().join("sky.png");
    let status = Command::new(binary("skycell")?)
        .args(["scene", "snapshot", "--pitch-deg", "-60"])
        .args(["--width", "96", "--height", "54", "--url"])
        .arg(format!("http://{}", server.address()))
        .arg(&file)
        .status()?;
    assert!(status.success());
    let written = image::open(&file)?.into_rgb8();
    assert!((mean(&written) - mean(&down)).abs() < 5.0);
    Ok(())
}

/// The picture of a snapshot that nothing finer follows, and its content type.
async fn exact(
    server: &Server,
    query: &str,
    accept: &str,
) -> anyhow::Result<(image::DynamicImage, String)> {
    let url = server.url(&format!("api/v1/snapshot?{query}"));
    let request = server.http().get(url).header("accept", accept);
    let answer = request.send().await?.error_for_status()?;
    assert_eq!(answer.headers()["skycell-exact"], "true");
    assert_eq!(answer.headers()["vary"], "accept");
    let kind = answer.headers()["content-type"].to_str()?.to_owned();
    Ok((image::load_from_memory(&answer.bytes().await?)?, kind))
}

#[tokio::test(flavor = "multi_thread")]
async fn an_exr_snapshot_is_the_radiance_of_which_the_png_is_the_picture() -> anyhow::Result<()> {
    let server = Server::start_calm().await?;
    // Somebody looks the same way, so that both are made from one and the same cache.
    let looks = camera([0.0, 2.0, 0.0], 130.0, 25.0)?;
    let hello = Hello::new(FrameSize::new(160, 90)?, 5.0, looks);
    let _viewer = Viewer::join_as(&server, hello).await?;
    server.at_rest(1).await?;
    let view = "width=160&height=90&yaw_deg=130&pitch_deg=25";
    let (png, kind) = exact(&server, view, "*/*").await?;
    assert_eq!(kind, "image/png");
    let (exr, kind) = exact(&server, view, "image/x-exr").await?;
    assert_eq!(kind, "image/x-exr");
    let (asked, kind) = exact(&server, &format!("{view}&format=exr"), "image/png").await?;
    assert_eq!(kind, "image/x-exr");
    assert_eq!(exr.color(), image::ColorType::Rgb32F);
    assert_eq!(exr, asked);

    let exr = exr.into_rgb32f();
    assert_eq!((exr.width(), exr.height()), (160, 90));
    let radiance: Vec<[f64; 3]> = exr.pixels().map(|p| p.0.map(f64::from)).collect();
    let most = radiance.iter().flatten().copied().fold(0.0, f64::max);
    assert!(
        radiance
            .iter()
            .flatten()
            .all(|c| c.is_finite() && *c >= 0.0)
    );
    let shown = tone::shown(160, 90, &radiance);
    let png = png.into_rgb8();
    let (mut sum, mut furthest) = (0, 0);
    for (a, b) in png.as_raw().iter().zip(shown.as_raw()) {
        let off = i64::from(*a) - i64::from(*b);
        sum += off;
        furthest = furthest.max(off.abs());
    }
    let mean = sum as f64 / png.as_raw().len() as f64;
    println!("off by {furthest} steps at most, {mean:.4} in the mean; most radiance {most:.3}");
    // Half a step of dither and half a step of rounding; the dither's mean is nothing.
    assert!(furthest <= 1 && mean.abs() < 0.03);

    let scratch = tempfile::tempdir()?;
    let file = scratch.path().join("sky.exr");
    let status = Command::new(binary("skycell")?)
        .args(["scene", "snapshot", "--width", "160", "--height", "90"])
        .args(["--yaw-deg", "130", "--pitch-deg", "25", "--url"])
        .arg(format!("http://{}", server.address()))
        .arg(&file)
        .status()?;
    assert!(status.success());
    assert_eq!(image::open(&file)?.into_rgb32f(), exr);
    Ok(())
}
