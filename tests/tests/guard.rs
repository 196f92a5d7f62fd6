//! A server that is guarded: tokens, TLS, what its log holds, and whose frames are whose.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};
use serde_json::json;
use skycell_client::{Access, HttpApi, ServerAddress};
use skycell_protocol::message::Hello;
use skycell_protocol::{Camera, Codec, FrameSize};
use skycell_server::access::{Role, Token, TokenDigest, TokenEntry};
use skycell_tests::picture::{decoded, mean_difference};
use skycell_tests::server::{ServerOptions, binary, target_dir};
use skycell_tests::{Browser, Server, Viewer, until};

/// Tokens of a test, one of each role, and the file that the server reads.
struct Guarded {
    folder: tempfile::TempDir,
    tokens: Vec<(Role, Token)>,
}

impl Guarded {
    fn new() -> anyhow::Result<Self> {
        let tokens = Role::NAMES.map(|(_, role)| Some((role, Token::new_random()?)));
        let guarded = Self {
            folder: tempfile::tempdir()?,
            tokens: tokens.into_iter().flatten().collect(),
        };
        guarded.write()?;
        Ok(guarded)
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("tokens")
    }

    fn write(&self) -> anyhow::Result<()> {
        let lines = self.tokens.iter().map(|(role, token)| {
            let entry = TokenEntry {
                role: *role,
                name: format!("test-{role}"),
                digest: TokenDigest::of(token.text()),
            };
            format!("{entry}\n")
        });
        write_secret(&self.file(), &lines.collect::<String>())
    }

    fn text(&self, role: Role) -> &str {
        let held = self.tokens.iter().find(|(held, _)| *held == role);
        held.map_or("", |(_, token)| token.text())
    }

    fn access(&self, role: Role) -> anyhow::Result<Access> {
        Ok(Access::default().with_token_text(self.text(role), "the test")?)
    }

    fn toml(&self) -> String {
        format!("tokens_file = {}\n", json!(self.file()))
    }

    async fn serve(&self, toml: &str) -> anyhow::Result<Server> {
        Server::start_with(ServerOptions {
            top_level_toml: format!("{}{toml}", self.toml()),
            access: self.access(Role::Admin)?,
            ..ServerOptions::default()
        })
        .await
    }
}

fn write_secret(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text)?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600))?;
    }
    Ok(())
}

fn small(yaw_deg: f64, pitch_deg: f64, width: u32, height: u32) -> anyhow::Result<Hello> {
    let camera = Camera::new([0.0, 2.0, 0.0], yaw_deg, pitch_deg, 60.0)?;
    let mut hello = Hello::new(FrameSize::new(width, height)?, 5.0, camera);
    hello.codec = Codec::Png;
    Ok(hello)
}

#[tokio::test(flavor = "multi_thread")]
async fn no_token_is_in_the_log_at_its_finest() -> anyhow::Result<()> {
    let guarded = Guarded::new()?;
    // Compilers of shaders know no tokens, and fill a million lines.
    let finest = "trace,naga=info,naga_oil=info,wgpu_core=info,wgpu_hal=info";
    let server = guarded.serve(&format!("log = \"{finest}\"\n")).await?;
    let wrong = "sky_wrong-but-nobodys-business";
    let in_address = "sky_in-an-address";
    // In headers and hellos, known and unknown, in addresses, and where they do not belong.
    let viewer = Viewer::join_as(&server, small(0.0, 10.0, 64, 36)?).await?;
    viewer.picture().await?;
    let bearer = |token: &str| format!("Bearer {token}");
    for (path, authorization) in [
        ("api/v1/scene", bearer(guarded.text(Role::View))),
        ("api/v1/stats", bearer(guarded.text(Role::View))),
        ("api/v1/stats", bearer(guarded.text(Role::Admin))),
        ("api/v1/scene", bearer(wrong)),
        ("api/v1/scene", format!("Basic {wrong}")),
        ("api/v1/scene?token=sky_in-an-address", bearer(wrong)),
        ("ws?access_token=sky_in-an-address", bearer(wrong)),
        ("api/v1/scene?x=sky_in-an-address", bearer(wrong)),
    ] {
        let request = server.http().get(server.url(path));
        request
            .header("authorization", authorization)
            .send()
            .await?;
    }
    for token in [wrong, guarded.text(Role::Steer)] {
        let access = Access::default().with_token_text(token, "the test")?;
        let address = server.url("").parse::<ServerAddress>()?.with_access(access);
        let connection = skycell_client::Connection::open(
            &address,
            small(0.0, 10.0, 32, 18)?,
            skycell_client::ConnectionLimits::default(),
        );
        ensure!(connection.await.is_ok() == (token != wrong));
    }
    viewer.close().await;
    let log = server.log()?;
    ensure!(log.contains("DEBUG"), "the log is not fine");
    ensure!(log.contains("a request is refused"), "refusals are told");
    let secrets = guarded.tokens.iter().flat_map(|(_, token)| {
        [
            token.text().to_owned(),
            TokenDigest::of(token.text()).to_hex(),
        ]
    });
    for secret in secrets.chain([wrong.to_owned(), in_address.to_owned()]) {
        let line = log.lines().find(|line| line.contains(&secret));
        ensure!(line.is_none(), "the log holds a token: {line:?}");
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn two_viewers_of_one_place_see_each_their_own_picture() -> anyhow::Result<()> {
    let server = Server::start_calm().await?;
    // One looks at the ground, the other into the sky.
    let (down, up) = (small(0.0, -60.0, 96, 54)?, small(180.0, 60.0, 128, 72)?);
    let viewers = [
        (Viewer::join_as(&server, down.clone()).await?, down),
        (Viewer::join_as(&server, up.clone()).await?, up),
    ];
    let mut pictures = Vec::new();
    for (viewer, hello) in &viewers {
        let seen = viewer
            .wait_for("a sharp picture", |seen| {
                seen.frame.as_ref().is_some_and(|frame| frame.header.exact)
            })
            .await?;
        let frame = seen.frame()?;
        ensure!(frame.header.viewer == viewer.id(), "{:?}", frame.header);
        let size = (
            u32::from(frame.header.width),
            u32::from(frame.header.height),
        );
        ensure!(
            size == (hello.size.width(), hello.size.height()),
            "{size:?}"
        );
        pictures.push(decoded(frame)?);
    }
    // Alone, each sees the same as beside the other.
    for ((viewer, hello), beside) in viewers.into_iter().zip(&pictures) {
        viewer.close().await;
        let alone = Viewer::join_as(&server, hello).await?;
        let seen = alone
            .wait_for("a sharp picture", |seen| {
                seen.frame.as_ref().is_some_and(|frame| frame.header.exact)
            })
            .await?;
        let apart = mean_difference(&decoded(seen.frame()?)?, beside);
        println!("beside and alone differ by {apart:.3} of 255");
        ensure!(
            apart < 2.0,
            "beside the other it saw something else: {apart}"
        );
        alone.close().await;
    }
    let small_up =
        image::imageops::resize(&pictures[1], 96, 54, image::imageops::FilterType::Triangle);
    let apart = mean_difference(&pictures[0], &small_up);
    println!("ground and sky differ by {apart:.1} of 255");
    ensure!(apart > 20.0, "ground and sky look alike: {apart}");
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_client_speaks_tls_with_a_token_and_tokens_are_read_again()
-> anyhow::Result<()> {
    let mut guarded = Guarded::new()?;
    let made = rcgen::generate_simple_self_signed(vec!["127.0.0.1".to_owned()])?;
    let (certificate, key) = (
        guarded.folder.path().join("cert.pem"),
        guarded.folder.path().join("key.pem"),
    );
    std::fs::write(&certificate, made.cert.pem())?;
    write_secret(&key, &made.signing_key.serialize_pem())?;
    let server = Server::start_with(ServerOptions {
        top_level_toml: guarded.toml(),
        cells_toml: format!(
            "[tls]\ncertificate = {}\nkey = {}\n",
            json!(certificate),
            json!(key)
        ),
        access: guarded.access(Role::Admin)?.with_ca_file(&certificate)?,
        ..ServerOptions::default()
    })
    .await?;
    ensure!(server.url("").starts_with("https://"), "{}", server.url(""));
    let viewer = Viewer::join_as(&server, small(0.0, 10.0, 64, 36)?).await?;
    viewer.picture().await?;
    viewer.close().await;

    let token_file = guarded.folder.path().join("steer.token");
    write_secret(&token_file, guarded.text(Role::Steer))?;
    let skycell = |arguments: &[&str], with_token: bool| -> anyhow::Result<(bool, String)> {
        let mut command = Command::new(binary("skycell")?);
        command.args(arguments).args(["--url", &server.url("")]);
        command.env_remove("SKYCELL_TOKEN");
        command.arg("--ca-file").arg(&certificate);
        if with_token {
            command.arg("--token-file").arg(&token_file);
        }
        let ran = command.output()?;
        let said = String::from_utf8_lossy(&ran.stdout) + String::from_utf8_lossy(&ran.stderr);
        Ok((ran.status.success(), said.into_owned()))
    };
    let patch = ["scene", "patch", "{\"wind\": {\"speed_m_per_s\": 0}}"];
    let (done, said) = skycell(&patch, true)?;
    ensure!(done, "{said}");
    let (done, said) = skycell(&patch, false)?;
    ensure!(!done && said.contains("401"), "{said}");
    // What is new is known after SIGHUP, and what is gone is not.
    let old = guarded.text(Role::Steer).to_owned();
    for (role, token) in &mut guarded.tokens {
        if *role == Role::Steer {
            *token = Token::new_random().context("random")?;
        }
    }
    guarded.write()?;
    server.hang_up()?;
    let api_with = |token: &str| -> anyhow::Result<HttpApi> {
        let access = Access::default()
            .with_token_text(token, "the test")?
            .with_ca_file(&certificate)?;
        Ok(HttpApi::new(
            server.url("").parse::<ServerAddress>()?.with_access(access),
        )?)
    };
    let (new, old) = (api_with(guarded.text(Role::Steer))?, api_with(&old)?);
    until("the new token is known", async || {
        Ok(new.scene().await.is_ok().then_some(()))
    })
    .await?;
    ensure!(old.scene().await.is_err(), "the old token is still known");
    // So is a new certificate: who trusts it alone is connected, who trusts the old one alone is not.
    let old_file = guarded.folder.path().join("old.pem");
    std::fs::copy(&certificate, &old_file)?;
    let made = rcgen::generate_simple_self_signed(vec!["127.0.0.1".to_owned()])?;
    std::fs::write(&certificate, made.cert.pem())?;
    write_secret(&key, &made.signing_key.serialize_pem())?;
    let trusting = |file: &Path| -> anyhow::Result<HttpApi> {
        let access = Access::default()
            .with_token_text(guarded.text(Role::Steer), "the test")?
            .with_ca_file(file)?;
        Ok(HttpApi::new(
            server.url("").parse::<ServerAddress>()?.with_access(access),
        )?)
    };
    ensure!(
        trusting(&certificate)?.scene().await.is_err(),
        "it is known too early"
    );
    server.hang_up()?;
    until("the new certificate is shown", async || {
        Ok(trusting(&certificate)?.scene().await.is_ok().then_some(()))
    })
    .await?;
    ensure!(
        trusting(&old_file)?.scene().await.is_err(),
        "the old certificate is still shown"
    );
    Ok(())
}

#[test]
fn a_new_token_is_printed_with_its_line_and_nothing_starts_open() -> anyhow::Result<()> {
    let server = binary("skycell-server")?;
    let made = Command::new(&server)
        .args(["token", "new", "--role", "steer", "--name", "show"])
        .output()?;
    let token = String::from_utf8(made.stdout)?.trim().to_owned();
    let line = String::from_utf8(made.stderr)?.trim().to_owned();
    let entry = TokenEntry::parse(&line).context(line.clone())?;
    ensure!(entry.role == Role::Steer && entry.name == "show", "{line}");
    ensure!(entry.digest.is(&TokenDigest::of(&token)), "{line}");
    ensure!(!line.contains(&token), "{line}");

    let state = tempfile::tempdir()?;
    let open = Command::new(&server)
        .args(["serve", "--listen", "0.0.0.0:0", "--state"])
        .arg(state.path())
        .output()?;
    let said = String::from_utf8_lossy(&open.stderr).into_owned();
    ensure!(!open.status.success(), "it started");
    for part in ["no token is configured", "token new", "tokens_file"] {
        ensure!(said.contains(part), "{said}");
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_asks_for_the_token_and_goes_on_with_it() -> anyhow::Result<()> {
    let Some(program) = Browser::find() else {
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), "SKIPPED page test: no chromium in PATH");
        return Ok(());
    };
    let guarded = Guarded::new()?;
    let server = guarded.serve("").await?;
    let browser = Browser::start(&program).await?;
    let tab = browser
        .open(&server.url("?width=160&height=90&fps=5&pitch=20"))
        .await?;
    let asks = "document.querySelector('dialog.token-dialog[open] #token') !== null";
    let told = "document.getElementById('token-told').textContent";
    let enter = |token: &str| {
        format!(
            "(() => {{ const field = document.getElementById('token'); field.value = {}; \
             field.form.requestSubmit(field.form.querySelector('[value=enter]')); return true; }})()",
            json!(token)
        )
    };
    tab.wait_for(asks).await?;
    let file = target_dir()?.join("page-screenshots").join("token.png");
    tab.screenshot(&file).await?;
    tab.evaluate(&enter("sky_wrong")).await?;
    tab.wait_for(&format!("{asks} && {told}.includes('does not know')"))
        .await?;
    tab.evaluate(&enter(guarded.text(Role::View))).await?;
    tab.wait_for(
        "window.skycell?.status.state === 'open' && window.skycell.counts.drawn > 0 \
         && document.querySelector('dialog.token-dialog') === null",
    )
    .await?;
    // What the page fetches carries the token too: the presets are there, and it may look but not change.
    tab.wait_for("document.getElementById('preset').options.length > 3")
        .await?;
    let status = tab
        .evaluate("fetch('api/v1/scene').then((answer) => answer.status)")
        .await?;
    ensure!(status == 200, "{status}");
    let status = tab
        .evaluate(
            "fetch('api/v1/scene', {method: 'PATCH', headers: {'If-Match': '*', \
             'Content-Type': 'application/merge-patch+json'}, body: '{}'}).then((answer) => answer.status)",
        )
        .await?;
    ensure!(status == 403, "{status}");
    let address = tab.evaluate("location.href").await?;
    ensure!(!address.to_string().contains(guarded.text(Role::View)));
    // It outlives a reload of the tab.
    tab.reload().await?;
    tab.wait_for("window.skycell?.status.state === 'open' && window.skycell.counts.drawn > 0")
        .await?;
    Ok(())
}
