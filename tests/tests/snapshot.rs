//! `GET /api/v1/snapshot` and `skycell scene snapshot` of a real server.

use std::process::Command;

use skycell_tests::server::binary;
use skycell_tests::{Server, until};

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
