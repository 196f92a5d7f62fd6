//! The real page of the real server in a real browser.

use std::path::Path;

use anyhow::Context;
use serde_json::json;
use skycell_tests::picture::colours;
use skycell_tests::server::target_dir;
use skycell_tests::{Browser, Server};

/// A sky has thousands of colours, a page without a picture some dozens.
const COLOURS_MIN: usize = 500;

const SHOWS_FRAMES: &str = "window.skycell?.status.state === 'open' && window.skycell.counts.drawn > 0 \
                            && window.skycell.status.server !== null";

/// Where the canvas is on the screenshot: left, top, width, height.
const CANVAS_BOX: &str = "(() => { const box = document.getElementById('picture').getBoundingClientRect(); \
                          return [box.left, box.top, box.width, box.height]; })()";

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_the_sky_looks_around_and_shares_it_with_a_second_tab() -> anyhow::Result<()>
{
    let Some(program) = Browser::find() else {
        let reason = "no chromium in PATH; on Debian `apt-get install chromium` brings one";
        assert!(
            std::env::var_os("CI").is_none_or(|ci| ci != "true"),
            "{reason}"
        );
        // Past the capture of a passing test, so that nobody takes this for a pass.
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), "SKIPPED page test: {reason}");
        return Ok(());
    };
    let server = Server::start_calm().await?;
    let browser = Browser::start(&program).await?;
    // Small pictures: the browser decodes on the same cores.
    let url = server.url("?width=480&height=270&fps=15");

    let first = browser.open(&url).await?;
    first.wait_for(SHOWS_FRAMES).await?;
    let canvas = first.evaluate(CANVAS_BOX).await?;
    let canvas: Vec<f64> = serde_json::from_value(canvas)?;
    let [left, top, width, height] = canvas[..] else {
        anyhow::bail!("the canvas has no box: {canvas:?}");
    };
    assert!(
        width > 100.0 && height > 100.0,
        "the canvas is {width} x {height}"
    );

    // Drag to the left: the camera turns to the right, and a frame comes that shows it.
    let yaw_deg = first.evaluate("window.skycell.camera.yaw_deg").await?;
    let middle = (left + width / 2.0, top + height / 2.0);
    let shown = first.evaluate("window.skycell.status.header.input").await?;
    first
        .drag(middle, (middle.0 - width / 4.0, middle.1 + height / 8.0))
        .await?;
    first
        .wait_for(&format!("window.skycell.status.header.input > {shown}"))
        .await?;
    let turned_deg = first.evaluate("window.skycell.camera.yaw_deg").await?;
    let turn_deg = turned_deg.as_f64().context("a yaw")? - yaw_deg.as_f64().context("a yaw")?;
    assert!(
        turn_deg > 5.0 && turn_deg < 60.0,
        "the camera turned by {turn_deg}°"
    );

    // What the picture looks like when the sky is done.
    first
        .wait_for("window.skycell.status.server.sky_converged")
        .await?;
    // The audit of the converged sky.
    first
        .wait_for(
            "/^p50 [0-9.]+ % p95 [0-9.]+ %$/.test(document.getElementById('cache-error').textContent)",
        )
        .await?;
    let folder = target_dir()?.join("page-screenshots");
    let file = folder.join("one-tab.png");
    first.screenshot(&file).await?;
    assert_shows_a_sky(&file, [left, top, width, height])?;

    // Another quality is picked, marched and told.
    let choose = |preset: &str| {
        format!(
            "(() => {{ const chooser = document.getElementById('quality'); chooser.value = '{preset}'; \
             chooser.dispatchEvent(new Event('change')); return true; }})()"
        )
    };
    first.evaluate(&choose("draft")).await?;
    first
        .wait_for(
            "/^draft · FLIP (about )?[0-9.]+/.test(document.getElementById('picked').textContent)",
        )
        .await?;
    first.evaluate(&choose("")).await?;
    first
        .wait_for("/^(balanced|custom) /.test(document.getElementById('picked').textContent)")
        .await?;

    // A second tab shares the cell; it looks where the page looks at first, 20° or so beside the first.
    let second = browser.open(&url).await?;
    second.wait_for(SHOWS_FRAMES).await?;
    for tab in [&first, &second] {
        tab.wait_for(
            "window.skycell.status.server.viewers_in_cell === 2 && window.skycell.status.server.overlap > 0",
        )
        .await?;
        tab.wait_for(
            "document.getElementById('viewers').textContent === '2' \
             && /^[1-9][0-9]* %$/.test(document.getElementById('overlap').textContent)",
        )
        .await?;
    }

    // Both follow a patch.
    let mut layers = server.api().scene().await?.document["layers"].clone();
    layers[0]["density"]["coverage"] = json!(0.8);
    let revision = server.patch(&json!({"layers": layers})).await?;
    for tab in [&first, &second] {
        tab.wait_for(&format!(
            "window.skycell.status.header.scene_revision === {revision} \
             && window.skycell.status.server.scene_revision === {revision}"
        ))
        .await?;
    }
    second
        .wait_for("window.skycell.status.server.sky_converged")
        .await?;
    let file = folder.join("second-tab-patched.png");
    second.screenshot(&file).await?;
    assert_shows_a_sky(&file, [left, top, width, height])?;

    for tab in [&first, &second] {
        assert_eq!(tab.evaluate("window.skycell.counts.broken").await?, 0);
        assert_eq!(tab.evaluate("window.skycell.status.problem").await?, "");
    }
    let errors = browser.console_errors();
    assert!(errors.is_empty(), "errors on the console: {errors:#?}");
    Ok(())
}

fn assert_shows_a_sky(file: &Path, canvas: [f64; 4]) -> anyhow::Result<()> {
    let page = image::open(file)?.to_rgb8();
    // The middle half of the canvas: no text of the page.
    let [left, top, width, height] = canvas;
    let part = image::imageops::crop_imm(
        &page,
        (left + width / 4.0) as u32,
        (top + height / 4.0) as u32,
        (width / 2.0) as u32,
        (height / 2.0) as u32,
    )
    .to_image();
    let found = colours(&part);
    assert!(
        found >= COLOURS_MIN,
        "{} has {found} colours",
        file.display()
    );
    Ok(())
}
