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

#[tokio::test(flavor = "multi_thread")]
async fn the_page_sets_presets_stops_the_sky_and_moves_the_sun() -> anyhow::Result<()> {
    let Some(program) = Browser::find() else {
        eprintln!("SKIPPED page test: no chromium in PATH");
        return Ok(());
    };
    let server = Server::start_calm().await?;
    let browser = Browser::start(&program).await?;
    let tab = browser
        .open(&server.url("?width=240&height=135&fps=10"))
        .await?;
    tab.wait_for(SHOWS_FRAMES).await?;
    let text = |id: &str| format!("document.getElementById('{id}').textContent");
    let put = |id: &str, value: &str, event: &str| {
        format!(
            "(() => {{ const control = document.getElementById('{id}'); control.value = '{value}'; \
             control.dispatchEvent(new Event('{event}')); return true; }})()"
        )
    };
    tab.wait_for("document.getElementById('preset').options.length > 10")
        .await?;
    tab.wait_for(&format!("/^[0-9:]+$/.test({})", text("sky-time")))
        .await?;

    // A preset comes with its camera.
    let before = tab
        .evaluate("window.skycell.status.header.scene_revision")
        .await?;
    tab.evaluate(&put("transition", "0", "change")).await?;
    tab.evaluate(&put("preset", "cirrus-evening", "change"))
        .await?;
    tab.wait_for(&format!(
        "window.skycell.status.header.scene_revision > {before}"
    ))
    .await?;
    let presets = server.get("api/v1/presets").await?;
    let evening = presets
        .as_array()
        .and_then(|presets| presets.iter().find(|p| p["name"] == "cirrus-evening"))
        .context("the preset")?;
    let yaw_deg = tab.evaluate("window.skycell.camera.yaw_deg").await?;
    assert_eq!(yaw_deg.as_f64(), evening["camera"]["yaw_deg"].as_f64());

    // Pause, and another hour: the sun stands by the clock from then on.
    tab.evaluate("document.getElementById('pause').click()")
        .await?;
    tab.wait_for(&format!("{} === 'Resume'", text("pause")))
        .await?;
    assert_eq!(clock_of(&server).await?["paused"], true);
    tab.evaluate(&put("hour", "9.5", "change")).await?;
    tab.wait_for(&format!("{} === '09:30'", text("hour-text")))
        .await?;
    let time = clock_of(&server).await?;
    let date = time["date"].as_str().context("a date")?;
    assert!(date.contains("T09:30") || date.contains("T09:29"), "{date}");
    tab.evaluate(&put("pace", "24", "change")).await?;
    tab.wait_for("document.getElementById('pace').value === '24'")
        .await?;
    let file = target_dir()?
        .join("page-screenshots")
        .join("sky-controls.png");
    tab.screenshot(&file).await?;
    assert_eq!(tab.evaluate(&text("sky-problem")).await?, "");
    let errors = browser.console_errors();
    assert!(errors.is_empty(), "errors on the console: {errors:#?}");
    Ok(())
}

async fn clock_of(server: &Server) -> anyhow::Result<serde_json::Value> {
    server.get("api/v1/scene/time").await
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

/// Fires a drag event with one file at an element of the page.
fn drag_file(event: &str, at: &str, name: &str, bytes: &[u8]) -> String {
    use base64::Engine as _;
    let content = base64::engine::general_purpose::STANDARD.encode(bytes);
    format!(
        "(() => {{ const files = new DataTransfer(); \
         const bytes = Uint8Array.from(atob('{content}'), (letter) => letter.charCodeAt(0)); \
         files.items.add(new File([bytes], '{name}')); \
         const target = document.querySelector('{at}'); \
         const event = new DragEvent('{event}', {{ dataTransfer: files, bubbles: true, cancelable: true }}); \
         target.dispatchEvent(event); return event.defaultPrevented; }})()"
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_dropped_on_a_zone_replaces_that_map_and_one_that_is_no_map_is_told()
-> anyhow::Result<()> {
    use skycell_server::field::{GreyMap, MapFileFormat};
    let Some(program) = Browser::find() else {
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), "SKIPPED page test: no chromium in PATH");
        return Ok(());
    };
    let server = Server::start_calm().await?;
    let browser = Browser::start(&program).await?;
    let tab = browser
        .open(&server.url("?width=320&height=180&fps=5"))
        .await?;
    tab.wait_for(SHOWS_FRAMES).await?;
    let map = GreyMap {
        width: 2,
        height: 1,
        values: vec![0.0, 1.0],
    };
    let storm = map.encode(MapFileFormat::Png)?;

    // A file over the page shows where it can go; three zones for the only layer.
    assert_eq!(
        tab.evaluate("document.getElementById('maps').hidden")
            .await?,
        true
    );
    let enter = drag_file("dragenter", "#picture", "storm.png", &storm);
    assert_eq!(
        tab.evaluate(&enter).await?,
        true,
        "the browser would take the file"
    );
    let zone = "#maps:not([hidden]) .zone[data-map=coverage][data-layer=low]";
    tab.wait_for(&format!(
        "document.querySelector('{zone}') !== null && document.querySelectorAll('.zone').length === 3"
    ))
    .await?;
    let drop = drag_file("drop", zone, "storm.png", &storm);
    assert_eq!(
        tab.evaluate(&drop).await?,
        true,
        "the browser would take the file"
    );
    tab.wait_for(
        "document.getElementById('map-told').textContent === 'storm.png is the coverage map of layer low.'",
    )
    .await?;
    let scene = server.api().scene().await?;
    let maps = &scene.document["layers"][0]["density"]["maps"];
    assert!(maps["coverage"].is_string(), "{maps}");
    assert_eq!(
        maps["transition_s"], 5.0,
        "the page asks for a change that can be seen"
    );
    let revision = scene.revision().context("a revision")?;
    tab.wait_for(&format!(
        "window.skycell.status.header.scene_revision === {revision}"
    ))
    .await?;

    // A file that is no map: told in the server's words, and the map stays.
    let drop = drag_file("drop", zone, "notes.txt", b"no picture");
    tab.evaluate(&drop).await?;
    tab.wait_for(
        "(() => { const told = document.getElementById('map-told'); return told.classList.contains('problem') \
         && told.textContent.includes('stays as it is') && told.textContent.includes('PNG or EXR'); })()",
    )
    .await?;
    let folder = target_dir()?.join("page-screenshots");
    tab.screenshot(&folder.join("maps.png")).await?;
    // Beside the zones nothing happens but advice.
    let beside = drag_file("drop", "#heading", "storm.png", &storm);
    assert_eq!(
        tab.evaluate(&beside).await?,
        true,
        "the browser would take the file"
    );
    tab.wait_for(
        "document.getElementById('map-told').textContent.startsWith('Drop the file on the map')",
    )
    .await?;
    assert_eq!(server.api().scene().await?.revision(), Some(revision));

    // The generated map again, by its button; then the zones go.
    tab.evaluate(&format!(
        "(() => {{ document.querySelector('{zone} button').click(); return true; }})()"
    ))
    .await?;
    tab.wait_for(
        "document.getElementById('map-told').textContent === 'Layer low has its generated coverage map again.'",
    )
    .await?;
    let scene = server.api().scene().await?.document;
    assert!(scene["layers"][0]["density"]["maps"]["coverage"].is_null());
    tab.evaluate(
        "(() => { dispatchEvent(new KeyboardEvent('keydown', { key: 'Escape' })); return true; })()",
    )
    .await?;
    assert_eq!(
        tab.evaluate("document.getElementById('maps').hidden")
            .await?,
        true
    );
    // The browser notes the refused request; nothing else.
    let errors = browser.console_errors();
    assert!(
        errors.len() <= 1 && errors.iter().all(|error| error.contains("415")),
        "errors on the console: {errors:#?}"
    );
    Ok(())
}
