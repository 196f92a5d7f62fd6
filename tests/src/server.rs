//! A real `skycell-server serve` process.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, LazyLock, OnceLock, mpsc};
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use serde_json::{Value, json};
use skycell_client::{Access, HttpApi, ServerAddress};

use crate::{PATIENCE, until};

/// Two cores serve one server at a time: whoever holds one, the next waits.
static TURN: LazyLock<Arc<tokio::sync::Mutex<()>>> = LazyLock::new(Arc::default);
static BIN_DIR: OnceLock<Result<PathBuf, String>> = OnceLock::new();

/// How a server is started.
#[derive(Clone, Debug, Default)]
pub struct ServerOptions {
    /// Keeps its state here instead of in a folder that is removed with it.
    pub state_dir: Option<PathBuf>,
    /// Added to its configuration file, before `[render]`.
    pub top_level_toml: String,
    /// Added to section `[render]`.
    pub render_toml: String,
    /// Added at the end: `[[cells]]`.
    pub cells_toml: String,
    /// Listens here instead of on a free port: for one that takes another's place.
    pub listen: Option<String>,
    /// Further arguments of `serve`.
    pub arguments: Vec<String>,
    /// Further environment variables.
    pub environment: Vec<(String, String)>,
    /// How the test's own clients are let in.
    pub access: Access,
}

/// A running server; killed when dropped.
pub struct Server {
    child: Child,
    /// `http://HOST:PORT`, or `https://`.
    origin: String,
    access: Access,
    api: HttpApi,
    http: reqwest::Client,
    log: PathBuf,
    // Removed after the process has ended.
    _scratch: tempfile::TempDir,
    // Shared with the servers that were started beside this one.
    turn: Arc<tokio::sync::OwnedMutexGuard<()>>,
}

impl Server {
    /// A server with the defaults.
    ///
    /// # Errors
    /// When it does not become ready; the end of its log is told.
    pub async fn start() -> anyhow::Result<Self> {
        Self::start_with(ServerOptions::default()).await
    }

    /// A server whose scene has no wind, so that it converges and rests.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub async fn start_calm() -> anyhow::Result<Self> {
        let server = Self::start().await?;
        server.calm().await?;
        Ok(server)
    }

    /// Starts a server on a free port and waits until it is ready. A test that holds another one starts it with
    /// [`Self::start_beside`], or waits for itself.
    ///
    /// # Errors
    /// When it does not become ready; the end of its log is told.
    pub async fn start_with(options: ServerOptions) -> anyhow::Result<Self> {
        let turn = TURN.clone().lock_owned().await;
        Self::start_in_turn(options, Arc::new(turn)).await
    }

    /// A second server with the defaults, in the same turn as this one.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub async fn start_beside(&self) -> anyhow::Result<Self> {
        Self::start_in_turn(ServerOptions::default(), self.turn.clone()).await
    }

    async fn start_in_turn(
        options: ServerOptions,
        turn: Arc<tokio::sync::OwnedMutexGuard<()>>,
    ) -> anyhow::Result<Self> {
        let binary = binary("skycell-server")?;
        let scratch = tempfile::tempdir()?;
        let state = options
            .state_dir
            .unwrap_or_else(|| scratch.path().join("state"));
        let config = scratch.path().join("skycell.toml");
        // Quoted as JSON, which TOML's basic strings are a superset of.
        let noise = json!(target_dir()?.join("noise-of-tests"));
        std::fs::write(
            &config,
            format!(
                "{}\n[render]\nnoise_cache_dir = {noise}\n{}\n{}\n",
                options.top_level_toml, options.render_toml, options.cells_toml
            ),
        )?;
        let log = scratch.path().join("log");
        let mut child = Command::new(&binary)
            .args(["serve", "--listen"])
            .arg(options.listen.as_deref().unwrap_or("127.0.0.1:0"))
            .arg("--state")
            .arg(&state)
            .arg("--config")
            .arg(&config)
            .args(&options.arguments)
            .envs(options.environment.iter().cloned())
            // Ours, not the server's, which warns of SKYCELL_ variables that it does not know.
            .env_remove("SKYCELL_BIN_DIR")
            .env_remove("SKYCELL_TOKEN")
            .env_remove("SKYCELL_WSTEST")
            .env_remove("SKYCELL_FULL")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(&log)?)
            .spawn()
            .with_context(|| format!("{} does not start", binary.display()))?;
        // Whatever asks for TLS in this process finds it.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let origin = match origin_of(&mut child).await {
            Ok(origin) => origin,
            Err(error) => {
                let _ = child.kill();
                let _ = child.wait();
                bail!("{error}; its log ends with:\n{}", tail(&log));
            }
        };
        let access = options.access;
        let server_address = origin.parse::<ServerAddress>()?.with_access(access.clone());
        let tls = access.tls_config(server_address.is_tls());
        let server = Self {
            child,
            origin,
            access,
            api: HttpApi::new(server_address)?,
            http: reqwest::Client::builder()
                .no_proxy()
                .tls_backend_preconfigured(rustls::ClientConfig::clone(&tls))
                .timeout(Duration::from_secs(20))
                .build()?,
            log,
            _scratch: scratch,
            turn,
        };
        until("a ready server", async || {
            let ready = server.http.get(server.url("readyz")).send().await?;
            Ok(ready.status().is_success().then_some(()))
        })
        .await?;
        Ok(server)
    }

    /// HOST:PORT.
    pub fn address(&self) -> &str {
        self.origin
            .split_once("://")
            .map_or(self.origin.as_str(), |(_, address)| address)
    }

    /// Tells it to read tokens and certificate again.
    ///
    /// # Errors
    /// When the signal cannot be sent.
    pub fn hang_up(&self) -> anyhow::Result<()> {
        let id = self.child.id().to_string();
        let sent = Command::new("kill").args(["-HUP", &id]).status()?;
        ensure!(sent.success(), "kill: {sent}");
        Ok(())
    }

    /// As clients write it.
    ///
    /// # Errors
    /// Never for a server that has started.
    pub fn client_address(&self) -> anyhow::Result<ServerAddress> {
        let address: ServerAddress = self.origin.parse()?;
        Ok(address.with_access(self.access.clone()))
    }

    /// The HTTP API as clients use it.
    pub fn api(&self) -> &HttpApi {
        &self.api
    }

    /// A plain HTTP client.
    pub fn http(&self) -> &reqwest::Client {
        &self.http
    }

    /// Address of a path without its leading slash.
    pub fn url(&self, path: &str) -> String {
        format!("{}/{path}", self.origin)
    }

    /// The answer to a GET as JSON.
    ///
    /// # Errors
    /// When it is refused or no JSON.
    pub async fn get(&self, path: &str) -> anyhow::Result<Value> {
        let answer = self.http.get(self.url(path)).send().await?;
        let answer = answer.error_for_status()?.text().await?;
        Ok(serde_json::from_str(&answer)?)
    }

    /// Changes the scene; returns its new revision.
    ///
    /// # Errors
    /// When it is refused.
    pub async fn patch(&self, patch: &Value) -> anyhow::Result<u64> {
        let revision = self.api.patch_current_scene(patch).await?.revision();
        revision.context("the ETag is a revision")
    }

    /// Stops the wind.
    ///
    /// # Errors
    /// When the patch is refused.
    pub async fn calm(&self) -> anyhow::Result<u64> {
        self.patch(&json!({"wind": {"speed_m_per_s": 0.0}})).await
    }

    /// A sum of `/api/v1/stats`, such as `texels_updated`.
    ///
    /// # Errors
    /// When there is none of that name.
    pub async fn total(&self, name: &str) -> anyhow::Result<u64> {
        total_of(&self.get("api/v1/stats").await?, name)
    }

    /// Waits until `viewers` viewers are placed, no cell waits for an update, what motion had taken from the sky is there again
    /// (which begins when all has rested for 2 s), every frame is acknowledged, and nothing has been submitted for 600 ms.
    /// Returns the figures.
    ///
    /// # Errors
    /// When that takes too long.
    pub async fn at_rest(&self, viewers: usize) -> anyhow::Result<Value> {
        let mut before = (u64::MAX, tokio::time::Instant::now());
        let mut last = Value::Null;
        let rested = until("a sky at rest", async || {
            let stats = self.get("api/v1/stats").await?;
            let submissions = total_of(&stats, "submissions")?;
            let converged = stats["cells"]
                .as_array()
                .is_some_and(|cells| cells.iter().all(|cell| cell["converged"] == true));
            let acknowledged = stats["viewers"].as_array().is_some_and(|all| {
                all.len() == viewers && all.iter().all(|viewer| viewer["frames_in_flight"] == 0)
            });
            let is_whole = stats["losses"]["rate_step"] == 0;
            if submissions != before.0 || !converged || !is_whole || !acknowledged {
                before = (submissions, tokio::time::Instant::now());
            }
            last = stats;
            // Figures are published every 100 ms, and a resting view that gets sharper is sent every 200 ms.
            Ok((before.1.elapsed() > Duration::from_millis(600)).then_some(()))
        })
        .await;
        rested.with_context(|| format!("the last figures: {last}"))?;
        Ok(last)
    }

    /// Resident memory of the process, KiB; none where the system has no /proc.
    pub fn memory_kib(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status
            .lines()
            .find_map(|line| line.strip_prefix("VmRSS:"))?;
        line.trim().strip_suffix("kB")?.trim().parse().ok()
    }

    /// Ends the process at once, as a power cut would, and gives its turn away.
    ///
    /// # Errors
    /// When it had ended before.
    pub fn kill(mut self) -> anyhow::Result<()> {
        let ended = self.child.try_wait()?;
        ensure!(
            ended.is_none(),
            "the server had ended ({ended:?}): {}",
            tail(&self.log)
        );
        // SIGKILL on Unix.
        self.child.kill()?;
        self.child.wait()?;
        Ok(())
    }

    /// Sends the process a signal, such as `TERM`.
    ///
    /// # Errors
    /// When there is no `kill`, or no process.
    pub fn signal(&self, name: &str) -> anyhow::Result<()> {
        let sent = Command::new("kill")
            .arg(format!("-{name}"))
            .arg(self.child.id().to_string())
            .status()?;
        ensure!(sent.success(), "kill -{name}: {sent}");
        Ok(())
    }

    /// Waits until the process has ended by itself; how, and what it had logged. Gives its turn away.
    ///
    /// # Errors
    /// When it does not end.
    pub async fn end(mut self) -> anyhow::Result<(ExitStatus, String)> {
        let status = until("an end", async || Ok(self.child.try_wait()?)).await?;
        Ok((status, std::fs::read_to_string(&self.log)?))
    }

    /// All that it has logged so far.
    ///
    /// # Errors
    /// When the log cannot be read.
    pub fn log(&self) -> anyhow::Result<String> {
        Ok(std::fs::read_to_string(&self.log)?)
    }

    /// The last lines that it logged.
    pub fn log_tail(&self) -> String {
        tail(&self.log)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(Some(_))) {
            return;
        }
        if std::thread::panicking() {
            eprintln!("the server's log ends with:\n{}", tail(&self.log));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A sum among the figures of `/api/v1/stats`.
///
/// # Errors
/// When there is none of that name.
pub fn total_of(stats: &Value, name: &str) -> anyhow::Result<u64> {
    stats["totals"][name]
        .as_u64()
        .with_context(|| format!("no totals.{name} in {stats}"))
}

/// Reads where it listens, which the server prints, and goes on reading so that it never waits for a reader.
async fn origin_of(child: &mut Child) -> anyhow::Result<String> {
    let stdout = child.stdout.take().context("a pipe")?;
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        for line in BufReader::new(stdout).lines().map_while(Result::ok) {
            if let Some(origin) = line.strip_prefix("listening on ") {
                let _ = sender.send(origin.trim_end_matches('/').to_owned());
            }
        }
    });
    let waited = tokio::task::spawn_blocking(move || receiver.recv_timeout(PATIENCE)).await?;
    waited.context("the server printed no address")
}

fn tail(log: &Path) -> String {
    let text = std::fs::read_to_string(log).unwrap_or_default();
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(15)..].join("\n")
}

/// The folder that Cargo builds into: that of the running test, `target/PROFILE/deps/NAME`.
///
/// # Errors
/// When the test does not stand there.
pub fn target_dir() -> anyhow::Result<PathBuf> {
    let test = std::env::current_exe()?;
    let target = test.ancestors().nth(3).context("a folder of Cargo's")?;
    Ok(target.to_owned())
}

/// A binary of the workspace: from `SKYCELL_BIN_DIR` if that is set, else built as release.
///
/// # Errors
/// When it is not there and cannot be built.
pub fn binary(name: &str) -> anyhow::Result<PathBuf> {
    let folder = BIN_DIR.get_or_init(|| find_binaries().map_err(|error| format!("{error:#}")));
    let folder = folder
        .as_ref()
        .map_err(|error| anyhow::anyhow!("{error}"))?;
    let path = folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    ensure!(path.is_file(), "there is no {}", path.display());
    Ok(path)
}

fn find_binaries() -> anyhow::Result<PathBuf> {
    if let Some(folder) = std::env::var_os("SKYCELL_BIN_DIR") {
        return Ok(folder.into());
    }
    // Always through Cargo, which does nothing when they are up to date: a stale server would test the past.
    let target = target_dir()?;
    let built = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .args([
            "build",
            "--release",
            "--workspace",
            "--bins",
            "--target-dir",
        ])
        .arg(&target)
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .status()
        .context("cargo does not start; set SKYCELL_BIN_DIR to the folder of the binaries")?;
    ensure!(built.success(), "the binaries under test do not build");
    Ok(target.join("release"))
}
