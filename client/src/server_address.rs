//! Where a server is: one address for its WebSocket and its HTTP API.

use std::fmt;
use std::str::FromStr;

use reqwest::Url;
use thiserror::Error;

use crate::Access;

/// The path of the WebSocket under the server's root.
const WEBSOCKET_PATH: &str = "ws";

/// A server's address, written as `ws://host:port/ws` or `http://host:port`, with TLS as `wss://` or `https://`; and how
/// a client is let in there.
///
/// Behind a proxy the server may stand under a path: `ws://host/sky/ws` has its API at
/// `http://host/sky/api/v1/`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerAddress {
    /// `http://host:port/prefix/` or `https://`, with the slash at its end.
    root: Url,
    access: Access,
}

/// Why a text is no server address.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum ServerAddressError {
    /// No URL at all.
    #[error("{text:?} is no address ({reason}); write one like ws://127.0.0.1:8080/ws")]
    NotAUrl {
        /// What was written.
        text: String,
        /// What the parser says.
        reason: String,
    },
    /// Another scheme.
    #[error("{0}:// is no scheme of a Skycell server; allowed: ws://, wss://, http://, https://")]
    UnknownScheme(String),
}

impl ServerAddress {
    /// The address of the WebSocket.
    pub fn websocket_url(&self) -> String {
        let path = self.http_url(WEBSOCKET_PATH);
        // The scheme of the root is http or https.
        format!("ws{}", path.as_str().trim_start_matches("http"))
    }

    /// Whether TLS is spoken there.
    pub fn is_tls(&self) -> bool {
        self.root.scheme() == "https"
    }

    /// The same server, for a client with a token or its own authorities.
    #[must_use]
    pub fn with_access(mut self, access: Access) -> Self {
        self.access = access;
        self
    }

    /// How a client is let in there.
    pub fn access(&self) -> &Access {
        &self.access
    }

    /// The address of a resource, such as `api/v1/scene`.
    pub fn http_url(&self, path: &str) -> Url {
        let mut url = self.root.clone();
        url.set_path(&format!("{}{path}", self.root.path()));
        url
    }
}

impl FromStr for ServerAddress {
    type Err = ServerAddressError;

    fn from_str(text: &str) -> Result<Self, ServerAddressError> {
        let not_a_url = |reason: String| ServerAddressError::NotAUrl {
            text: text.to_owned(),
            reason,
        };
        let url = Url::parse(text).map_err(|error| not_a_url(error.to_string()))?;
        let scheme = match url.scheme() {
            "ws" | "http" => "http",
            "wss" | "https" => "https",
            // `localhost:8080` parses as a URL of the scheme `localhost`.
            other => return Err(ServerAddressError::UnknownScheme(other.to_owned())),
        };
        let host_and_port = url
            .as_str()
            .split_once("://")
            .and_then(|(_, rest)| rest.split(['/', '?', '#']).next())
            .filter(|host| !host.is_empty())
            .ok_or_else(|| not_a_url("it names no host".to_owned()))?;
        let path = url.path().trim_end_matches('/');
        let prefix = path
            .strip_suffix(WEBSOCKET_PATH)
            .filter(|prefix| prefix.ends_with('/'))
            .unwrap_or(path)
            .trim_end_matches('/');
        let root = Url::parse(&format!("{scheme}://{host_and_port}{prefix}/"))
            .map_err(|error| not_a_url(error.to_string()))?;
        Ok(Self {
            root,
            access: Access::default(),
        })
    }
}

impl fmt::Display for ServerAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.websocket_url().fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(text: &str) -> ServerAddress {
        text.parse().expect("an address")
    }

    #[test]
    fn one_address_leads_to_the_websocket_and_to_the_api() {
        for text in [
            "ws://127.0.0.1:8080/ws",
            "ws://127.0.0.1:8080",
            "ws://127.0.0.1:8080/",
            "http://127.0.0.1:8080",
            "http://127.0.0.1:8080/?yaw=3#here",
        ] {
            let address = address(text);
            assert_eq!(address.websocket_url(), "ws://127.0.0.1:8080/ws", "{text}");
            assert_eq!(
                address.http_url("api/v1/scene").as_str(),
                "http://127.0.0.1:8080/api/v1/scene",
                "{text}"
            );
        }
    }

    #[test]
    fn a_prefix_of_a_proxy_is_kept() {
        let address = address("ws://sky.example/north/ws");
        assert_eq!(address.websocket_url(), "ws://sky.example/north/ws");
        assert_eq!(
            address.http_url("api/v1/stats").as_str(),
            "http://sky.example/north/api/v1/stats"
        );
        assert_eq!(
            super::tests::address("http://sky.example/news").websocket_url(),
            "ws://sky.example/news/ws"
        );
    }

    #[test]
    fn ipv6_and_default_ports_work() {
        assert_eq!(
            address("ws://[::1]:8080").websocket_url(),
            "ws://[::1]:8080/ws"
        );
        let with_tls = address("https://sky.example:8443");
        assert!(with_tls.is_tls() && !address("ws://sky.example").is_tls());
        assert_eq!(with_tls.websocket_url(), "wss://sky.example:8443/ws");
        assert_eq!(
            address("wss://sky.example/ws")
                .http_url("api/v1/scene")
                .as_str(),
            "https://sky.example/api/v1/scene"
        );
        assert_eq!(
            address("ws://sky.example:80/ws").websocket_url(),
            "ws://sky.example/ws"
        );
    }

    #[test]
    fn other_schemes_are_refused_with_what_is_allowed() {
        for (text, part) in [
            (
                "ftp://sky.example",
                "allowed: ws://, wss://, http://, https://",
            ),
            (
                "localhost:8080",
                "allowed: ws://, wss://, http://, https://",
            ),
            ("127.0.0.1:8080", "write one like"),
            ("", "write one like"),
        ] {
            let error = text.parse::<ServerAddress>().expect_err(text);
            assert!(error.to_string().contains(part), "{text}: {error}");
        }
    }
}
