//! The page's map of cells and viewers, in a real browser.

use skycell_protocol::message::Hello;
use skycell_protocol::{Camera, FrameSize};
use skycell_tests::server::target_dir;
use skycell_tests::viewer::camera;
use skycell_tests::{Browser, Server, ServerOptions, Viewer, until};

const SHOWS_FRAMES: &str =
    "window.skycell?.status.state === 'open' && window.skycell.counts.drawn > 0";

async fn joined(server: &Server, camera: Camera) -> anyhow::Result<Viewer> {
    let size = FrameSize::new(64, 36)?;
    Viewer::join_as(server, Hello::new(size, 5.0, camera)).await
}

#[tokio::test(flavor = "multi_thread")]
async fn the_map_shows_every_cell_and_every_viewer_where_they_are() -> anyhow::Result<()> {
    let Some(program) = Browser::find() else {
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), "SKIPPED page test: no chromium in PATH");
        return Ok(());
    };
    let options = ServerOptions {
        cells_toml:
            "[[cells]]\nname = \"plaza\"\ncenter_m = [6000.0, 2.0, 0.0]\nradius_m = 800.0\n".into(),
        ..ServerOptions::default()
    };
    let server = Server::start_with(options).await?;
    server.calm().await?;
    // Two beside the page's own viewer, one of them high up; one on the plaza; one far away.
    let near = joined(&server, camera([700.0, 2.0, -900.0], 90.0, 20.0)?).await?;
    let high = joined(&server, camera([-600.0, 400.0, 300.0], 200.0, 20.0)?).await?;
    let plaza = joined(&server, camera([6200.0, 2.0, 150.0], 0.0, 20.0)?).await?;
    let far = joined(&server, camera([-9000.0, 2.0, 5000.0], 45.0, 20.0)?).await?;
    let browser = Browser::start(&program).await?;
    let tab = browser
        .open(&server.url("?width=240&height=135&fps=5"))
        .await?;
    tab.wait_for(SHOWS_FRAMES).await?;

    // Hidden until it is asked for, and then nothing is asked of the server.
    let hidden = "document.getElementById('cell-map').hidden && window.skycell.cellMap === null";
    assert_eq!(tab.evaluate(hidden).await?, true);
    let asked = "performance.getEntriesByType('resource').filter((e) => e.name.endsWith('api/v1/viewers')).length";
    assert_eq!(tab.evaluate(asked).await?, 0);
    let click = "(() => { document.getElementById('cell-map-button').click(); return true; })()";
    tab.evaluate(click).await?;
    tab.wait_for("window.skycell.cellMap?.viewers.length === 5")
        .await?;
    let cells = server.get("api/v1/cells").await?;
    assert_eq!(cells.as_array().map(Vec::len), Some(3), "{cells}");
    tab.wait_for("document.getElementById('cell-map-told').textContent === '3 cells, 5 viewers'")
        .await?;
    assert_eq!(
        tab.evaluate("window.skycell.cellMap.cells.map((cell) => cell.placed).sort()")
            .await?,
        serde_json::json!([false, false, true])
    );

    // Where the layout says that a viewer is there is its dot in the colour of its cell, and nothing in the map's corner.
    let drawn = "(() => { const canvas = document.getElementById('cell-map-canvas'); \
         const scale = canvas.width / canvas.clientWidth; const context = canvas.getContext('2d'); \
         const at = (x, y) => [...context.getImageData(Math.round(x * scale), Math.round(y * scale), 1, 1).data]; \
         const colour = (text) => { const probe = document.createElement('canvas').getContext('2d'); \
           probe.fillStyle = text; probe.fillRect(0, 0, 1, 1); return [...probe.getImageData(0, 0, 1, 1).data]; }; \
         const same = (a, b) => a.every((value, i) => Math.abs(value - b[i]) < 8); \
         return window.skycell.cellMap.viewers.every((v) => same(at(v.x, v.y), colour(v.colour))) \
           && at(2, 2)[3] === 0; })()";
    tab.wait_for(drawn).await?;
    // Metres east of the page's viewer, who stands at the origin.
    let east = format!(
        "(() => {{ const map = window.skycell.cellMap; const own = map.viewers.find((v) => v.own); \
         const other = map.viewers.find((v) => v.id === {}); return (other.x - own.x) * map.metres_per_pixel; }})()",
        plaza.id()
    );
    let east_m = tab.evaluate(&east).await?.as_f64().unwrap_or(f64::NAN);
    assert!((east_m - 6200.0).abs() < 1.0, "{east_m}");
    tab.screenshot(&target_dir()?.join("page-screenshots").join("cells.png"))
        .await?;

    // Who leaves is gone, with the cell that only it had.
    far.close().await;
    tab.wait_for("document.getElementById('cell-map-told').textContent === '2 cells, 4 viewers'")
        .await?;
    let escape = "(() => { dispatchEvent(new KeyboardEvent('keydown', { key: 'Escape' })); return true; })()";
    tab.evaluate(escape).await?;
    assert_eq!(tab.evaluate(hidden).await?, true);
    let errors = browser.console_errors();
    assert!(errors.is_empty(), "errors on the console: {errors:#?}");
    for viewer in [near, high, plaza] {
        viewer.close().await;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn an_error_that_somebody_asks_for_narrows_their_cell_and_no_others() -> anyhow::Result<()> {
    let server = Server::start_calm().await?;
    let first = joined(&server, camera([0.0, 2.0, 0.0], 0.0, 20.0)?).await?;
    let second = joined(&server, camera([1500.0, 2.0, 0.0], 0.0, 20.0)?).await?;
    let cells = async |count: usize, what: &str| {
        until(what, async || {
            let cells = server.get("api/v1/cells").await?;
            let is_met = cells.as_array().is_some_and(|cells| cells.len() == count);
            Ok(is_met.then_some(cells))
        })
        .await
    };
    let shared = cells(1, "one cell for both").await?;
    let strict_camera = camera([3000.0, 2.0, 0.0], 0.0, 20.0)?;
    let mut hello = Hello::new(FrameSize::new(64, 36)?, 5.0, strict_camera);
    hello.quality = Some(skycell_protocol::QualityChoice::MaxError(0.02));
    let strict = Viewer::join_as(&server, hello).await?;
    let radius_m = |cells: &serde_json::Value| {
        let radii_m = cells.as_array().into_iter().flatten();
        let radii_m = radii_m.filter_map(|cell| cell["radius_m"].as_f64());
        radii_m.fold(f64::INFINITY, f64::min)
    };
    let narrow = until("a narrow cell of its own", async || {
        let cells = server.get("api/v1/cells").await?;
        let count = cells.as_array().map_or(0, Vec::len);
        Ok((count == 2 && radius_m(&cells) < 2_000.0).then_some(cells))
    })
    .await?;
    // Software drivers search at fewer places.
    let curves = skycell_server::cells::ErrorCurves::embedded();
    let asked_m = [4, 16].map(|steps| curves.of(1, steps).limit(0.02).radius_m());
    assert_eq!(
        radius_m(&shared),
        skycell_server::cells::CellLimit::default().radius_m()
    );
    let is_asked = |m: &f64| (radius_m(&narrow) - m).abs() < 1e-6;
    assert!(
        asked_m.iter().any(is_asked) && asked_m[1] < 750.0,
        "{narrow}"
    );
    strict.close().await;
    cells(1, "one cell again").await?;
    first.close().await;
    second.close().await;
    Ok(())
}
