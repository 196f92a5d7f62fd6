//! Headless Chromium, driven over its DevTools protocol.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, bail};
use base64::Engine as _;
use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::sync::{mpsc, oneshot};
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;

use crate::until;

/// No command of the browser takes longer on a busy machine.
const COMMAND_TIMEOUT: Duration = Duration::from_secs(30);

/// What Debian, Ubuntu and others call it.
const NAMES: [&str; 4] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
];

#[derive(Default)]
struct Shared {
    waiting: Mutex<HashMap<u64, oneshot::Sender<Value>>>,
    /// Errors of all tabs, as the console shows them.
    errors: Mutex<Vec<String>>,
}

/// A browser with a profile of its own; killed when dropped.
pub struct Browser {
    child: Child,
    profile: Option<tempfile::TempDir>,
    shared: Arc<Shared>,
    commands: mpsc::Sender<String>,
    next_id: AtomicU64,
}

/// A page in a browser.
pub struct Tab<'a> {
    browser: &'a Browser,
    session: String,
}

impl Browser {
    /// Where the browser is, if one is installed.
    pub fn find() -> Option<PathBuf> {
        let path = std::env::var_os("PATH")?;
        std::env::split_paths(&path)
            .flat_map(|folder| NAMES.map(|name| folder.join(name)))
            .find(|file| file.is_file())
    }

    /// Starts it without a window.
    ///
    /// # Errors
    /// When it does not start or does not say where it can be driven.
    pub async fn start(program: &Path) -> anyhow::Result<Self> {
        let profile = tempfile::tempdir()?;
        let child = Command::new(program)
            .args([
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-quic",
                "--no-first-run",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--disable-dev-shm-usage",
                // Both tabs are watched, though at most one is in front.
                "--disable-renderer-backgrounding",
                "--disable-background-timer-throttling",
                "--disable-backgrounding-occluded-windows",
                "--no-proxy-server",
                "--window-size=1000,800",
                "--remote-debugging-port=0",
            ])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .with_context(|| format!("{} does not start", program.display()))?;
        let (commands, command_receiver) = mpsc::channel(64);
        let browser = Self {
            child,
            shared: Arc::default(),
            commands,
            next_id: AtomicU64::new(1),
            profile: Some(profile),
        };
        let port_file = browser
            .profile
            .as_ref()
            .map(|profile| profile.path().join("DevToolsActivePort"))
            .context("a profile")?;
        let url = until("a browser that can be driven", async || {
            let text = std::fs::read_to_string(&port_file).unwrap_or_default();
            Ok(text
                .split_once('\n')
                .filter(|(_, path)| path.starts_with("/devtools/"))
                .map(|(port, path)| format!("ws://127.0.0.1:{port}{}", path.trim())))
        })
        .await?;
        let (socket, _) = connect_async(url).await?;
        tokio::spawn(talk(socket, command_receiver, browser.shared.clone()));
        Ok(browser)
    }

    /// Opens a page in a window of its own.
    ///
    /// # Errors
    /// When the browser does not.
    pub async fn open(&self, url: &str) -> anyhow::Result<Tab<'_>> {
        self.open_after(url, "").await
    }

    /// Opens a page in a window of its own, in which a script has run before its own.
    ///
    /// # Errors
    /// When the browser does not.
    pub async fn open_after(&self, url: &str, script: &str) -> anyhow::Result<Tab<'_>> {
        // A window, not a tab: a page behind another one has no animation frames.
        let target = self
            .command(
                None,
                "Target.createTarget",
                json!({"url": "about:blank", "newWindow": true}),
            )
            .await?;
        let attached = self
            .command(
                None,
                "Target.attachToTarget",
                json!({"targetId": target["targetId"], "flatten": true}),
            )
            .await?;
        let session = attached["sessionId"].as_str().context("a session")?;
        let tab = Tab {
            browser: self,
            session: session.to_owned(),
        };
        for domain in ["Runtime.enable", "Log.enable", "Page.enable"] {
            tab.command(domain, json!({})).await?;
        }
        if !script.is_empty() {
            let script = json!({"source": script});
            tab.command("Page.addScriptToEvaluateOnNewDocument", script)
                .await?;
        }
        tab.command("Page.navigate", json!({"url": url})).await?;
        Ok(tab)
    }

    /// Errors on the consoles of all tabs so far.
    pub fn console_errors(&self) -> Vec<String> {
        let errors = self.shared.errors.lock();
        errors.unwrap_or_else(PoisonError::into_inner).clone()
    }

    async fn command(
        &self,
        session: Option<&str>,
        method: &str,
        params: Value,
    ) -> anyhow::Result<Value> {
        let id = self.next_id.fetch_add(1, Ordering::Relaxed);
        let mut command = json!({"id": id, "method": method, "params": params});
        if let Some(session) = session {
            command["sessionId"] = json!(session);
        }
        let (sender, receiver) = oneshot::channel();
        self.shared
            .waiting
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(id, sender);
        self.commands.send(command.to_string()).await?;
        let answer = tokio::time::timeout(COMMAND_TIMEOUT, receiver)
            .await
            .with_context(|| format!("the browser does not answer {method}"))?
            .with_context(|| format!("the browser ended at {method}"))?;
        if let Some(error) = answer.get("error") {
            bail!("{method}: {error}");
        }
        Ok(answer["result"].clone())
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        // Its helper processes may write for a moment longer.
        if let Some(profile) = self.profile.take() {
            std::thread::sleep(Duration::from_millis(200));
            let _ = profile.close();
        }
    }
}

type Socket =
    tokio_tungstenite::WebSocketStream<tokio_tungstenite::MaybeTlsStream<tokio::net::TcpStream>>;

async fn talk(mut socket: Socket, mut commands: mpsc::Receiver<String>, shared: Arc<Shared>) {
    loop {
        tokio::select! {
            command = commands.recv() => {
                let Some(command) = command else { return };
                if socket.send(Message::text(command)).await.is_err() { break }
            }
            message = socket.next() => {
                let Some(Ok(message)) = message else { break };
                let Some(message) = message.to_text().ok().and_then(|text| serde_json::from_str(text).ok()) else {
                    continue;
                };
                hear(message, &shared);
            }
        }
    }
    // Whoever waits learns that nothing comes.
    let mut waiting = shared
        .waiting
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    waiting.clear();
}

fn hear(message: Value, shared: &Shared) {
    if let Some(id) = message["id"].as_u64() {
        let mut waiting = shared
            .waiting
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(sender) = waiting.remove(&id) {
            let _ = sender.send(message);
        }
        return;
    }
    let params = &message["params"];
    let is_error = match message["method"].as_str() {
        Some("Runtime.exceptionThrown") => true,
        Some("Runtime.consoleAPICalled") => params["type"] == "error",
        Some("Log.entryAdded") => params["entry"]["level"] == "error",
        _ => false,
    };
    if is_error {
        let mut errors = shared.errors.lock().unwrap_or_else(PoisonError::into_inner);
        errors.push(params.to_string());
    }
}

fn is_of_a_page_that_went(error: &anyhow::Error) -> bool {
    let text = error.to_string();
    let told = [
        "navigated or closed",
        "context was destroyed",
        "Cannot find default execution context",
        "Cannot find context with specified id",
    ];
    told.iter().any(|part| text.contains(part))
}

impl Tab<'_> {
    async fn command(&self, method: &str, params: Value) -> anyhow::Result<Value> {
        self.browser
            .command(Some(&self.session), method, params)
            .await
    }

    /// The value of a JavaScript expression.
    ///
    /// # Errors
    /// When it throws.
    pub async fn evaluate(&self, expression: &str) -> anyhow::Result<Value> {
        let answer = self
            .command(
                "Runtime.evaluate",
                json!({"expression": expression, "returnByValue": true, "awaitPromise": true}),
            )
            .await?;
        if let Some(thrown) = answer.get("exceptionDetails") {
            bail!("{expression}: {thrown}");
        }
        Ok(answer["result"]["value"].clone())
    }

    /// Loads the page again, and waits until the one before is gone.
    ///
    /// # Errors
    /// When the browser does not.
    pub async fn reload(&self) -> anyhow::Result<()> {
        self.evaluate("window.isOfBefore = true").await?;
        self.command("Page.reload", json!({})).await?;
        self.wait_for("window.isOfBefore !== true").await
    }

    /// Waits until a JavaScript expression is true; tells the page's status when it never is.
    ///
    /// # Errors
    /// When it throws or takes too long.
    pub async fn wait_for(&self, condition: &str) -> anyhow::Result<()> {
        let met = until(condition, async || match self.evaluate(condition).await {
            Ok(value) => Ok((value == true).then_some(())),
            // A page that goes takes with it what was asked of it; the one that comes is asked next.
            Err(error) if is_of_a_page_that_went(&error) => Ok(None),
            Err(error) => Err(error),
        })
        .await;
        if met.is_err() {
            let status = self
                .evaluate("JSON.stringify([window.skycell?.status, window.skycell?.counts])")
                .await;
            return met.with_context(|| format!("the page says {status:?}"));
        }
        met
    }

    /// Drags the mouse in steps, coordinates in CSS pixels.
    ///
    /// # Errors
    /// When the browser does not.
    pub async fn drag(&self, from: (f64, f64), to: (f64, f64)) -> anyhow::Result<()> {
        const STEPS: u32 = 8;
        let mouse = async |kind: &str, x: f64, y: f64, buttons: u32| {
            self.command(
                "Input.dispatchMouseEvent",
                json!({"type": kind, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1}),
            )
            .await
        };
        mouse("mousePressed", from.0, from.1, 1).await?;
        for step in 1..=STEPS {
            let share = f64::from(step) / f64::from(STEPS);
            let x = from.0 + (to.0 - from.0) * share;
            let y = from.1 + (to.1 - from.1) * share;
            mouse("mouseMoved", x, y, 1).await?;
        }
        mouse("mouseReleased", to.0, to.1, 0).await?;
        Ok(())
    }

    /// Saves what is shown as a PNG file.
    ///
    /// # Errors
    /// When the browser does not or the file cannot be written.
    pub async fn screenshot(&self, file: &Path) -> anyhow::Result<()> {
        let answer = self
            .command("Page.captureScreenshot", json!({"format": "png"}))
            .await?;
        let text = answer["data"].as_str().context("a picture")?;
        if let Some(folder) = file.parent() {
            std::fs::create_dir_all(folder)?;
        }
        std::fs::write(
            file,
            base64::engine::general_purpose::STANDARD.decode(text)?,
        )?;
        Ok(())
    }
}
