//! A running service with a stand-in renderer, in a folder of its own.

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use reqwest::{Method, RequestBuilder, Response};
use serde_json::Value;
use skycell_server::config::Config;
use skycell_server::service::{Service, ServiceParts};

use crate::stand_in::{Behaviour, StandIn};

pub(crate) struct World {
    pub(crate) service: Service,
    pub(crate) renderer: StandIn,
    pub(crate) folder: tempfile::TempDir,
    http: reqwest::Client,
}

/// Starts a service whose configuration `change` has changed.
pub(crate) async fn start_with(behaviour: Behaviour, change: impl FnOnce(&mut Config)) -> World {
    // Any client that may speak TLS asks for it; the second one of a process is told that there is one.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (service, renderer) = start_in(folder.path(), behaviour, change).await;
    World {
        service,
        renderer,
        folder,
        http: reqwest::Client::new(),
    }
}

pub(crate) async fn start() -> World {
    start_with(Behaviour::default(), |_| {}).await
}

pub(crate) async fn start_in(
    folder: &Path,
    behaviour: Behaviour,
    change: impl FnOnce(&mut Config),
) -> (Service, StandIn) {
    let mut config = Config::new(folder.to_owned());
    config.listen = SocketAddr::from(([127, 0, 0, 1], 0));
    change(&mut config);
    let parts = ServiceParts::prepare(config).expect("prepares");
    let renderer = StandIn::start(parts.scene(), parts.frame_sink(), behaviour);
    let service = parts.start(renderer.handle.clone()).await.expect("starts");
    (service, renderer)
}

impl World {
    pub(crate) fn address(&self) -> SocketAddr {
        self.service.address()
    }

    pub(crate) fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.http
            .request(method, format!("http://{}{path}", self.address()))
    }

    pub(crate) async fn get(&self, path: &str) -> Response {
        self.request(Method::GET, path)
            .send()
            .await
            .expect("an answer")
    }

    pub(crate) async fn get_json(&self, path: &str) -> Value {
        let response = self.get(path).await;
        assert_eq!(response.status(), 200, "{path}");
        response.json().await.expect("JSON")
    }

    /// A merge patch of the scene.
    pub(crate) async fn patch(&self, if_match: Option<&str>, body: &str) -> Response {
        let mut request = self
            .request(Method::PATCH, "/api/v1/scene")
            .header("content-type", "application/merge-patch+json")
            .body(body.to_owned());
        if let Some(tag) = if_match {
            request = request.header("if-match", tag);
        }
        request.send().await.expect("an answer")
    }

    /// The world still serves: what every test of bad input ends with.
    pub(crate) async fn goes_on(&self) {
        assert_eq!(self.get("/livez").await.status(), 200);
        let mut client = crate::client::Client::join(self.address()).await;
        client.frame().await;
    }
}

/// Waits until `holds`, for at most five seconds.
pub(crate) async fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    for _ in 0..500 {
        if holds() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    panic!("never: {what}");
}
