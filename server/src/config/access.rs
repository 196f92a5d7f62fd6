//! Sections `[limits]` and `[tls]`, and tokens.

use std::path::PathBuf;

use serde::{Serialize, Serializer};
use serde_json::Value;
use skycell_protocol::number_range::NumberRange;
use skycell_protocol::read_json::{ObjectReader, ReadJson};
use skycell_protocol::value_error::ValueError;

use crate::access::{LINE_FORM, TokenEntry};

/// Requests of one peer.
pub const REQUESTS_PER_S: NumberRange = NumberRange::new(1.0, 100_000.0);
/// Requests of one peer at once.
pub const REQUESTS_BURST: NumberRange = NumberRange::new(1.0, 100_000.0);
/// WebSockets that one peer opens.
pub const UPGRADES_PER_MIN: NumberRange = NumberRange::new(1.0, 100_000.0);
/// Wrong tokens of one peer.
pub const FAILED_TOKENS_PER_MIN: NumberRange = NumberRange::new(1.0, 1000.0);
/// Connections of one peer.
pub const CONNECTIONS_PER_PEER_MAX: NumberRange = NumberRange::new(1.0, 512.0);
/// Viewers of one peer.
pub const VIEWERS_PER_PEER_MAX: NumberRange = NumberRange::new(1.0, 1024.0);
/// 10⁶ pixels of all viewers' frames together; the largest frame has 8.3.
pub const MEGAPIXELS_MAX: NumberRange = NumberRange::new(1.0, 16_384.0);

/// How much one peer, and all viewers together, may ask for: section `[limits]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LimitsConfig {
    /// Requests of one peer each second. Without: 50, on the loopback interface 2000.
    pub requests_per_s: Option<u32>,
    /// Requests of one peer at once. Without: 500, on the loopback interface 10 000.
    pub requests_burst: Option<u32>,
    /// WebSockets that one peer opens each minute. Without: 60, on the loopback interface 10 000.
    pub upgrades_per_min: Option<u32>,
    /// Wrong tokens of one peer each minute; with more, none of its tokens is looked at. Without: 10.
    pub failed_tokens_per_min: Option<u32>,
    /// Connections of one peer that speak HTTP. Without: 64, on the loopback interface 512.
    pub connections_per_peer_max: Option<u32>,
    /// Viewers of one peer. Without: 32, on the loopback interface 1024.
    pub viewers_per_peer_max: Option<u32>,
    /// 10⁶ pixels of all viewers' frames together. Without: 256.
    pub megapixels_max: Option<u32>,
}

/// [`LimitsConfig`] with every default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Requests of one peer each second.
    pub requests_per_s: u32,
    /// Requests of one peer at once.
    pub requests_burst: u32,
    /// WebSockets that one peer opens each minute.
    pub upgrades_per_min: u32,
    /// Wrong tokens of one peer each minute.
    pub failed_tokens_per_min: u32,
    /// Connections of one peer.
    pub connections_per_peer_max: u32,
    /// Viewers of one peer.
    pub viewers_per_peer_max: u32,
    /// Pixels of all viewers' frames together.
    pub pixels_max: u64,
}

impl LimitsConfig {
    pub(super) fn read(value: &Value) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, "/limits")?;
        members.only(&[
            "requests_per_s",
            "requests_burst",
            "upgrades_per_min",
            "failed_tokens_per_min",
            "connections_per_peer_max",
            "viewers_per_peer_max",
            "megapixels_max",
        ])?;
        let count = |key: &str, range: NumberRange| {
            members
                .optional::<u32>(key)?
                .map(|count| range.check_u32(&members.pointer_of(key), count))
                .transpose()
        };
        Ok(Self {
            requests_per_s: count("requests_per_s", REQUESTS_PER_S)?,
            requests_burst: count("requests_burst", REQUESTS_BURST)?,
            upgrades_per_min: count("upgrades_per_min", UPGRADES_PER_MIN)?,
            failed_tokens_per_min: count("failed_tokens_per_min", FAILED_TOKENS_PER_MIN)?,
            connections_per_peer_max: count("connections_per_peer_max", CONNECTIONS_PER_PEER_MAX)?,
            viewers_per_peer_max: count("viewers_per_peer_max", VIEWERS_PER_PEER_MAX)?,
            megapixels_max: count("megapixels_max", MEGAPIXELS_MAX)?,
        })
    }

    /// With its defaults. Peers on this machine are its own programs: theirs only keep a loop that has gone wild from
    /// taking everything.
    pub fn resolved(&self, is_loopback: bool) -> Limits {
        let default = |here: u32, beyond: u32| if is_loopback { here } else { beyond };
        Limits {
            requests_per_s: self.requests_per_s.unwrap_or(default(2000, 50)),
            requests_burst: self.requests_burst.unwrap_or(default(10_000, 500)),
            upgrades_per_min: self.upgrades_per_min.unwrap_or(default(10_000, 60)),
            failed_tokens_per_min: self.failed_tokens_per_min.unwrap_or(10),
            connections_per_peer_max: self.connections_per_peer_max.unwrap_or(default(512, 64)),
            viewers_per_peer_max: self.viewers_per_peer_max.unwrap_or(default(1024, 32)),
            pixels_max: u64::from(self.megapixels_max.unwrap_or(256)) * 1_000_000,
        }
    }
}

/// HTTPS and wss: section `[tls]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TlsConfig {
    /// PEM file: the server's certificate, then those that lead to a root that clients know.
    pub certificate: PathBuf,
    /// PEM file: its private key, readable for the owner only.
    pub key: PathBuf,
}

impl TlsConfig {
    pub(super) fn read(value: &Value) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, "/tls")?;
        members.only(&["certificate", "key"])?;
        let path = |key: &str| -> Result<PathBuf, ValueError> {
            Ok(members.required::<String>(key, "a PEM file")?.into())
        };
        Ok(Self {
            certificate: path("certificate")?,
            key: path("key")?,
        })
    }
}

/// Tokens of the configuration itself, hashed. Written as their roles and names.
#[derive(Clone, Debug, Default)]
pub struct ConfiguredTokens(pub Vec<TokenEntry>);

impl PartialEq for ConfiguredTokens {
    fn eq(&self, other: &Self) -> bool {
        self.0.len() == other.0.len()
            && self
                .0
                .iter()
                .zip(&other.0)
                .all(|(a, b)| a.role == b.role && a.name == b.name && a.digest.is(&b.digest))
    }
}

impl Serialize for ConfiguredTokens {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(
            self.0
                .iter()
                .map(|entry| format!("{} {}", entry.role, entry.name)),
        )
    }
}

impl ReadJson for TokenEntry {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        value.as_str().and_then(Self::parse).ok_or_else(|| {
            // Not the value: it may be a token.
            ValueError::new(pointer, &Value::from("…"), LINE_FORM)
        })
    }
}
