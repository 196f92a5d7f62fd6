//! The real page while its server is started anew.

use skycell_tests::{Browser, Server, ServerOptions};

const SHOWS_FRAMES: &str =
    "window.skycell?.status.state === 'open' && window.skycell.counts.drawn > 0";

#[tokio::test(flavor = "multi_thread")]
async fn the_page_comes_back_to_a_server_that_was_started_anew() -> anyhow::Result<()> {
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
    let state = tempfile::tempdir()?;
    let options = ServerOptions {
        state_dir: Some(state.path().to_owned()),
        top_level_toml: "drain_s = 0".to_owned(),
        ..ServerOptions::default()
    };
    let server = Server::start_with(options.clone()).await?;
    let browser = Browser::start(&program).await?;
    let listen = server.address().to_owned();
    let tab = browser
        .open(&server.url("?width=320&height=180&fps=10"))
        .await?;
    tab.wait_for(SHOWS_FRAMES).await?;
    server.signal("TERM")?;
    let (ended, log) = server.end().await?;
    assert_eq!(ended.code(), Some(0), "{log}");
    tab.wait_for("window.skycell.status.reconnects > 0").await?;
    let problem = tab.evaluate("window.skycell.status.problem").await?;
    assert!(
        problem.to_string().contains("the server shuts down"),
        "{problem}"
    );
    let drawn = tab.evaluate("window.skycell.counts.drawn").await?;
    let server = Server::start_with(ServerOptions {
        listen: Some(listen),
        ..options
    })
    .await?;
    tab.wait_for(&format!(
        "{SHOWS_FRAMES} && window.skycell.counts.drawn > {drawn}"
    ))
    .await?;
    drop(server);
    Ok(())
}
