//! Where the configuration comes from and in which order: file, environment, flags.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};
use skycell_protocol::read_json::nearest_name;
use skycell_protocol::value_error::ValueError;
use thiserror::Error;

use super::{Config, LogFormat};

/// What names of environment variables begin with.
const PREFIX: &str = "SKYCELL_";

/// The variable that names the file, unless a flag does.
const FILE_VARIABLE: &str = "SKYCELL_CONFIG";

/// How the text of a variable becomes a value.
#[derive(Clone, Copy)]
enum Kind {
    Text,
    Number,
    /// Separated by commas.
    List,
    /// JSON, or a name.
    JsonOrText,
}

/// The keys that the environment can set. `render/samples` is `SKYCELL_RENDER_SAMPLES`.
const KEYS: &[(&str, Kind)] = &[
    ("listen", Kind::Text),
    ("state_dir", Kind::Text),
    ("viewers_max", Kind::Number),
    ("encoder_threads", Kind::Number),
    ("video_kbit_per_s", Kind::Number),
    ("viewer_stall_s", Kind::Number),
    ("drain_s", Kind::Number),
    ("allowed_origins", Kind::List),
    ("allowed_hosts", Kind::List),
    ("trusted_proxies", Kind::List),
    ("proxy_header", Kind::Text),
    ("tokens_file", Kind::Text),
    ("tokens", Kind::List),
    ("limits/requests_per_s", Kind::Number),
    ("limits/requests_burst", Kind::Number),
    ("limits/upgrades_per_min", Kind::Number),
    ("limits/failed_tokens_per_min", Kind::Number),
    ("limits/connections_per_peer_max", Kind::Number),
    ("limits/viewers_per_peer_max", Kind::Number),
    ("limits/megapixels_max", Kind::Number),
    ("tls/certificate", Kind::Text),
    ("tls/key", Kind::Text),
    ("log", Kind::Text),
    ("log_format", Kind::Text),
    ("otlp_endpoint", Kind::Text),
    ("otlp_frame_share", Kind::Number),
    ("render/mip_bias", Kind::Number),
    ("render/samples", Kind::Number),
    ("render/quality", Kind::JsonOrText),
    ("render/cache_memory_mib", Kind::Number),
    ("render/cell_memory_mib", Kind::Number),
    ("render/march_share", Kind::Number),
    ("render/age_factor", Kind::Number),
    ("render/march_steps", Kind::Number),
    ("render/frame_filter", Kind::Text),
    ("render/parallax_steps", Kind::Number),
    ("render/samples_by_area", Kind::JsonOrText),
    ("render/proxies", Kind::Text),
    ("render/slabs", Kind::Number),
    ("render/bands", Kind::Number),
    ("render/band_ends", Kind::Text),
    ("render/dome_follow_m", Kind::Number),
    ("render/transitions", Kind::Text),
    ("render/noise_cache_dir", Kind::Text),
];

/// What the command line says; it has the last word.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Flags {
    /// `--listen`
    pub listen: Option<SocketAddr>,
    /// `--state`
    pub state_dir: Option<PathBuf>,
    /// `--log-format`
    pub log_format: Option<LogFormat>,
    /// `--config`
    pub file: Option<PathBuf>,
}

/// Why there is no configuration.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration file {path}: {error}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why not.
        error: std::io::Error,
    },
    /// The file is not TOML.
    #[error("the configuration file {path} is not TOML: {message}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Where and why not.
        message: String,
    },
    /// A key is unknown or a value is not allowed.
    #[error("configuration from {origin}: {error}")]
    Value {
        /// The file, the environment or the flags.
        origin: String,
        /// Which value, and what is allowed.
        error: ValueError,
    },
    /// A path that is not UTF-8.
    #[error("the path {0:?} is not UTF-8")]
    Path(PathBuf),
}

/// A key of the resolved configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Origin {
    /// `listen`, `render.samples`.
    pub key: String,
    /// What it is; null for what depends on the quality or on the machine.
    pub value: Value,
    /// The default, the file, a variable or a flag.
    pub from: String,
}

/// The variables of this process that begin as ours do. One that is not UTF-8 is none of ours.
fn own_variables() -> Vec<(String, String)> {
    std::env::vars_os()
        .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)))
        .filter(|(name, _)| name.starts_with(PREFIX))
        .collect()
}

/// The file that the flags or the environment name.
fn file_of(flags: &Flags, variables: &[(String, String)]) -> Option<PathBuf> {
    flags.file.clone().or_else(|| {
        variables
            .iter()
            .find(|(name, _)| name == FILE_VARIABLE)
            .map(|(_, value)| PathBuf::from(value))
    })
}

impl Config {
    /// The configuration of this process: `flags` over its environment over the file.
    ///
    /// # Errors
    /// Says which source is wrong, and where.
    pub fn load(flags: &Flags) -> Result<Self, ConfigError> {
        Self::resolve(flags, &own_variables())
    }

    /// The same key by key, each with where it comes from.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn explain(flags: &Flags) -> Result<Vec<Origin>, ConfigError> {
        Self::explain_with(flags, &own_variables())
    }

    /// As [`Config::explain`], with the environment as a value.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn explain_with(
        flags: &Flags,
        variables: &[(String, String)],
    ) -> Result<Vec<Origin>, ConfigError> {
        let config = Self::resolve(flags, variables)?;
        // Strings, numbers and lists only, so that writing them cannot fail.
        let config = serde_json::to_value(config).unwrap_or_default();
        let file = file_of(flags, variables);
        let written = file
            .as_deref()
            .map(read_file)
            .transpose()?
            .map(Value::Object);
        let mut by_flags = Map::new();
        set_from_flags(&mut by_flags, flags)?;
        let by_flags = Value::Object(by_flags);
        let mut found = Vec::new();
        for key in KEYS.iter().map(|(key, _)| *key).chain(["cells"]) {
            let pointer = format!("/{key}");
            let variable = variable_of(key);
            let from = if by_flags.pointer(&pointer).is_some() {
                "the command line".to_owned()
            } else if variables.iter().any(|(name, _)| *name == variable) {
                variable
            } else if let (Some(path), Some(_)) = (
                &file,
                written.as_ref().and_then(|tree| tree.pointer(&pointer)),
            ) {
                path.display().to_string()
            } else {
                "default".to_owned()
            };
            found.push(Origin {
                value: config
                    .pointer(&resolved_pointer(key))
                    .cloned()
                    .unwrap_or_default(),
                key: key.replace('/', "."),
                from,
            });
        }
        Ok(found)
    }

    /// As [`Config::load`], with the environment as a value.
    ///
    /// # Errors
    /// Says which source is wrong, and where.
    pub fn resolve(flags: &Flags, variables: &[(String, String)]) -> Result<Self, ConfigError> {
        let mut tree = Map::new();
        let mut config = None;
        if let Some(path) = file_of(flags, variables) {
            tree = read_file(&path)?;
            config = Some(check(&tree, || format!("file {}", path.display()))?);
        }
        if set_from_environment(&mut tree, variables) || config.is_none() {
            config = Some(check(&tree, || format!("the environment ({PREFIX}...)"))?);
        }
        if set_from_flags(&mut tree, flags)? {
            config = Some(check(&tree, || "the command line".to_owned())?);
        }
        // Set above: without a file the second step always does.
        config.map_or_else(|| check(&tree, String::new), Ok)
    }
}

/// Where the value of a key stands in the resolved configuration.
fn resolved_pointer(key: &str) -> String {
    let of_proxies = match key {
        "render/proxies" => "setup",
        "render/slabs" => "slabs",
        "render/bands" => "bands",
        "render/band_ends" => "band_ends",
        "render/dome_follow_m" => "follow_m",
        _ => return format!("/{key}"),
    };
    format!("/render/proxies/{of_proxies}")
}

fn check(tree: &Map<String, Value>, origin: impl Fn() -> String) -> Result<Config, ConfigError> {
    Config::from_json(&Value::Object(tree.clone()), default_state_dir()).map_err(|error| {
        ConfigError::Value {
            origin: origin(),
            error,
        }
    })
}

/// The user's own place for state, or a folder here if the system knows none.
fn default_state_dir() -> PathBuf {
    directories::ProjectDirs::from("", "", "skycell").map_or_else(
        || PathBuf::from("skycell-state"),
        |dirs| {
            dirs.state_dir()
                .unwrap_or_else(|| dirs.data_local_dir())
                .to_owned()
        },
    )
}

fn read_file(path: &Path) -> Result<Map<String, Value>, ConfigError> {
    let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Read {
        path: path.to_owned(),
        error,
    })?;
    toml::from_str(&text).map_err(|error| ConfigError::Syntax {
        path: path.to_owned(),
        message: error.to_string(),
    })
}

fn variable_of(key: &str) -> String {
    format!("{PREFIX}{}", key.replace('/', "_").to_uppercase())
}

/// The variables of this process that look like ours and are not, each with the known one that
/// was most likely meant. They are not refused: orchestrators put their own there (Kubernetes:
/// `SKYCELL_SERVICE_HOST` for a service called skycell).
pub(super) fn unknown_variables() -> Vec<(String, Option<String>)> {
    let known: Vec<String> = KEYS.iter().map(|(key, _)| variable_of(key)).collect();
    let known: Vec<&str> = known.iter().map(String::as_str).collect();
    std::env::vars_os()
        .filter_map(|(name, _)| name.into_string().ok())
        .filter(|name| name.starts_with(PREFIX) && name != FILE_VARIABLE)
        .filter(|name| !known.contains(&name.as_str()))
        .map(|name| {
            let nearest = nearest_name(&name, &known).map(str::to_owned);
            (name, nearest)
        })
        .collect()
}

/// Whether a variable has set something.
fn set_from_environment(tree: &mut Map<String, Value>, variables: &[(String, String)]) -> bool {
    let mut has_set = false;
    for (name, text) in variables {
        let Some((key, kind)) = KEYS.iter().find(|(key, _)| variable_of(key) == *name) else {
            continue;
        };
        let value = match kind {
            Kind::Text => Value::from(text.as_str()),
            Kind::JsonOrText => {
                serde_json::from_str(text).unwrap_or_else(|_| Value::from(text.as_str()))
            }
            // What is no number stays text and is refused as such.
            Kind::Number => serde_json::from_str::<serde_json::Number>(text.trim())
                .map_or_else(|_| Value::from(text.as_str()), Value::Number),
            Kind::List => text
                .split(',')
                .map(str::trim)
                .filter(|item| !item.is_empty())
                .collect(),
        };
        set(tree, key, value);
        has_set = true;
    }
    has_set
}

fn set_from_flags(tree: &mut Map<String, Value>, flags: &Flags) -> Result<bool, ConfigError> {
    if let Some(listen) = flags.listen {
        set(tree, "listen", Value::from(listen.to_string()));
    }
    if let Some(path) = &flags.state_dir {
        let text = path
            .to_str()
            .ok_or_else(|| ConfigError::Path(path.clone()))?;
        set(tree, "state_dir", Value::from(text));
    }
    if let Some(format) = flags.log_format {
        let name = match format {
            LogFormat::Text => "text",
            LogFormat::Json => "json",
        };
        set(tree, "log_format", Value::from(name));
    }
    Ok(flags.listen.is_some() || flags.state_dir.is_some() || flags.log_format.is_some())
}

/// Sets `key` or `section/key`.
fn set(tree: &mut Map<String, Value>, key: &str, value: Value) {
    match key.split_once('/') {
        None => {
            tree.insert(key.to_owned(), value);
        }
        Some((section, key)) => {
            let section = tree
                .entry(section)
                .or_insert_with(|| Value::Object(Map::new()));
            // A section of another type was refused when the file was checked.
            if let Value::Object(section) = section {
                section.insert(key.to_owned(), value);
            }
        }
    }
}
