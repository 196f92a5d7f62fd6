//! The page with two eyes, in a real browser.

use anyhow::ensure;
use skycell_tests::picture::{colours, mean_difference};
use skycell_tests::server::target_dir;
use skycell_tests::{Browser, Server};

const SHOWS_FRAMES: &str = "window.skycell?.status.state === 'open' && window.skycell.counts.drawn > 0 \
                            && window.skycell.status.server !== null";

/// Canvas and header agree on a picture of one eye or two, and the server knows.
fn shows(stereo: bool, width: u32, height: u32) -> String {
    format!(
        "(() => {{ const {{ header, server }} = window.skycell.status; const canvas = document.getElementById('picture'); \
         return header.stereo === {stereo} && (server.stereo !== null) === {stereo} && header.width === {width} \
         && header.height === {height} && canvas.width === {width} && canvas.height === {height}; }})()"
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_two_eyes_side_by_side_by_its_address_and_by_its_checkbox()
-> anyhow::Result<()> {
    let Some(program) = Browser::find() else {
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), "SKIPPED page test: no chromium in PATH");
        return Ok(());
    };
    let server = Server::start_calm().await?;
    let browser = Browser::start(&program).await?;
    let url = server.url("?width=240&height=200&fps=10&pitch=20&stereo=60&predict=off");
    let tab = browser.open(&url).await?;
    tab.wait_for(SHOWS_FRAMES).await?;
    tab.wait_for(&shows(true, 480, 200)).await?;
    let told = tab
        .evaluate("window.skycell.status.server.stereo.eye_distance_m")
        .await?;
    ensure!(told == 60.0, "{told}");
    tab.wait_for("window.skycell.status.server.sky_converged")
        .await?;
    tab.wait_for("document.getElementById('picture-size').textContent === '2 × 240 × 200'")
        .await?;
    let folder = target_dir()?.join("page-screenshots");
    let file = folder.join("two-eyes.png");
    tab.screenshot(&file).await?;

    // What the canvas holds: two skies, of which the nearer clouds stand apart.
    let canvas = "document.getElementById('picture').toDataURL('image/png').split(',')[1]";
    let png = tab.evaluate(canvas).await?;
    let png = {
        use base64::Engine as _;
        let text = png.as_str().unwrap_or_default();
        base64::engine::general_purpose::STANDARD.decode(text)?
    };
    let picture = image::load_from_memory(&png)?.to_rgb8();
    let [left, right] =
        [0, 240].map(|x| image::imageops::crop_imm(&picture, x, 0, 240, 200).to_image());
    ensure!(colours(&left) > 500 && colours(&right) > 500);
    let apart = mean_difference(&left, &right);
    ensure!((1.0..60.0).contains(&apart), "{apart}");

    // The box closes the second eye and opens it again.
    let click = "(() => { document.getElementById('stereo').click(); return true; })()";
    tab.evaluate(click).await?;
    tab.wait_for(&shows(false, 240, 200)).await?;
    tab.wait_for("document.getElementById('picture-size').textContent.startsWith('240 × 200')")
        .await?;
    tab.evaluate(click).await?;
    tab.wait_for(&shows(true, 480, 200)).await?;

    // Without the address it is closed, and people's eyes are 64 mm apart.
    let plain = browser
        .open(&server.url("?width=160&height=90&fps=5&predict=off"))
        .await?;
    plain.wait_for(SHOWS_FRAMES).await?;
    plain.wait_for(&shows(false, 160, 90)).await?;
    plain.evaluate(click).await?;
    plain.wait_for(&shows(true, 320, 90)).await?;
    let told = plain
        .evaluate("window.skycell.status.server.stereo.eye_distance_m")
        .await?;
    ensure!(told == 0.064, "{told}");
    let errors = browser.console_errors();
    ensure!(errors.is_empty(), "errors on the console: {errors:#?}");
    Ok(())
}
