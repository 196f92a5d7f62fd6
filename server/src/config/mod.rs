//! The configuration of the service: a TOML file, over it the environment (`SKYCELL_...`), over
//! it the flags of the command line. Unknown keys are refused with the nearest known one.

mod access;
mod sources;
#[cfg(test)]
mod tests;

use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use crate::access::{PROXIES_MAX, ProxyHeader, ProxyNet, TrustedProxies};
use crate::encode::video::{KBIT_PER_S_MAX, KBIT_PER_S_MIN};
use crate::march::{
    BANDS, BandEnds, DOME_FOLLOW_M, PROXIES_PER_LAYER_MAX, ProxySettings, ProxySetup,
};
use crate::quality::PARALLAX_STEPS_MAX;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use skycell_protocol::QualityChoice;
use skycell_protocol::camera::{POSITION_ALTITUDE_M, POSITION_HORIZONTAL_M};
use skycell_protocol::number_range::NumberRange;
use skycell_protocol::read_json::{ObjectReader, ReadJson, read_name};
use skycell_protocol::value_error::ValueError;

pub use access::{
    CONNECTIONS_PER_PEER_MAX, ConfiguredTokens, FAILED_TOKENS_PER_MIN, Limits, LimitsConfig,
    MEGAPIXELS_MAX, REQUESTS_BURST, REQUESTS_PER_S, TlsConfig, UPGRADES_PER_MIN,
    VIEWERS_PER_PEER_MAX,
};
pub use sources::{ConfigError, Flags, Origin};

/// How many viewers may be connected at once.
pub const VIEWERS_MAX: NumberRange = NumberRange::new(1.0, 1024.0);
/// How many threads may encode frames.
pub const ENCODER_THREADS: NumberRange = NumberRange::new(1.0, 64.0);
/// What a viewer's video may take of its line.
pub const VIDEO_KBIT_PER_S: NumberRange =
    NumberRange::new(KBIT_PER_S_MIN as f64, KBIT_PER_S_MAX as f64);
/// After how long without progress a viewer is dropped.
pub const VIEWER_STALL_S: NumberRange = NumberRange::new(1.0, 3600.0);
/// How long no viewer is taken any more before the sessions are closed.
pub const DRAIN_S: NumberRange = NumberRange::new(0.0, 3600.0);
/// Share of frames that are traced.
pub const OTLP_FRAME_SHARE: NumberRange = NumberRange::new(0.0, 1.0);
/// How many view cells may be placed by hand.
pub const CELLS_MAX: usize = 64;
/// How many characters the name of a cell may have; at least one.
pub const CELL_NAME_MAX_CHARS: usize = 32;
/// The radius of a cell.
pub const CELL_RADIUS_M: NumberRange = NumberRange::new(1.0, 1.0e6);
/// Halvings of the caches' resolution below that of the screen.
pub const MIP_BIAS: NumberRange = NumberRange::new(0.0, 4.0);
/// Jittered samples that a texel averages.
pub const SAMPLES: NumberRange = NumberRange::new(1.0, 16.0);
/// GPU memory for caches.
pub const CACHE_MEMORY_MIB: NumberRange = NumberRange::new(16.0, 65_536.0);
/// GPU memory for the caches of one cell: at least the coarse levels of four layers.
pub const CELL_MEMORY_MIB: NumberRange = NumberRange::new(4.0, 65_536.0);
/// Share of the time for marching while somebody moves or the sky does.
pub const MARCH_SHARE: NumberRange = NumberRange::new(0.01, 1.0);
/// How much older or younger than usual what caches hold may become.
pub const AGE_FACTOR: NumberRange = NumberRange::new(0.1, 4.0);
/// Places of a search for what texels show.
pub const PARALLAX_STEPS: NumberRange = NumberRange::new(0.0, PARALLAX_STEPS_MAX as f64);
/// Slabs that a layer may be cut into.
pub const SLABS: NumberRange = NumberRange::new(1.0, PROXIES_PER_LAYER_MAX as f64);
/// Steps of the march through the clouds.
pub const MARCH_STEPS: NumberRange = NumberRange::new(1.0, 4096.0);

/// The resolved configuration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Config {
    /// Address and port to listen on.
    pub listen: SocketAddr,
    /// Where the scene is kept.
    pub state_dir: PathBuf,
    /// How many viewers may be connected at once.
    pub viewers_max: u32,
    /// How many threads encode frames.
    pub encoder_threads: u32,
    /// What the video of a viewer takes of its line at most, 100 to 50000 kbit/s. Without: 8000 at 1280x720, in proportion to
    /// pixels.
    pub video_kbit_per_s: Option<u32>,
    /// A viewer that takes or says nothing for this long is dropped.
    pub viewer_stall_s: f64,
    /// After SIGTERM: how long the server is not ready and takes no viewer before it closes the sessions.
    pub drain_s: f64,
    /// Origins of other sites whose pages may open `/ws`, such as `https://example.org`. Pages of
    /// this server and clients that are no browsers always may.
    pub allowed_origins: Vec<String>,
    /// Names under which clients reach this server, such as `sky.example`, beside `localhost` and addresses.
    pub allowed_hosts: Vec<String>,
    /// Reverse proxies that are believed where requests come from: addresses or networks, such as `10.0.0.0/8`.
    pub trusted_proxies: Vec<ProxyNet>,
    /// The header in which they tell it.
    pub proxy_header: ProxyHeader,
    /// File of tokens, one a line. With any token, here or there, every request needs one.
    pub tokens_file: Option<PathBuf>,
    /// Tokens, as lines of that file.
    pub tokens: ConfiguredTokens,
    /// How much one peer, and all viewers together, may ask for.
    pub limits: LimitsConfig,
    /// Speaks HTTPS and wss; without it HTTP and ws.
    pub tls: Option<TlsConfig>,
    /// What to log, as `tracing` filters are written: `info`, `skycell_server=debug`.
    pub log: String,
    /// How it is written.
    pub log_format: LogFormat,
    /// Base address of an OpenTelemetry collector that takes traces by OTLP over HTTP; none for no traces.
    pub otlp_endpoint: Option<String>,
    /// Share of frames whose stages are traced.
    pub otlp_frame_share: f64,
    /// The renderer's settings.
    pub render: RenderConfig,
    /// View cells placed by hand.
    pub cells: Vec<PlacedCell>,
}

/// How the log is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum LogFormat {
    /// A line for people.
    Text,
    /// A JSON object a line.
    Json,
}

/// The renderer's settings: section `[render]`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RenderConfig {
    /// Halvings of the caches' resolution below that of the screen, 0 to 4. Without: what the quality says.
    pub mip_bias: Option<f32>,
    /// Jittered samples that a texel averages, 1 to 16. Without: what the quality says.
    pub samples: Option<u32>,
    /// How good pictures are for viewers who do not say, in scenes that do not. Without: `balanced`; on a software
    /// driver the fastest point with an error of at most 0.03.
    pub quality: Option<QualityChoice>,
    /// GPU memory for caches.
    pub cache_memory_mib: u32,
    /// GPU memory for the caches of one cell. Without: as much as there is for all.
    pub cell_memory_mib: Option<u32>,
    /// Share of the time in which the device marches while somebody moves or the sky does, 0.01 to 1.
    pub march_share: f32,
    /// How old under wind, and behind a sky that changes, what is marched may become until it is marched again, times what is
    /// usual.
    pub age_factor: f64,
    /// Steps of the march through a layer's thickness. Without: what the quality says.
    pub march_steps: Option<u32>,
    /// How caches are read for a frame. Without: what the quality says.
    pub frame_filter: Option<FrameFilter>,
    /// Most places along a ray at which viewers away from a reference look for what texels show. Without: what the quality
    /// says, and less on a software driver.
    pub parallax_steps: Option<u32>,
    /// Where several texels make a pixel, it is their samples together that are as many as the pixel's; what the quality sets
    /// without.
    pub samples_by_area: Option<bool>,
    /// What layers are kept on: keys `proxies`, `slabs`, `bands`, `band_ends` and `dome_follow_m`.
    pub proxies: ProxySettings,
    /// What viewers are shown on their way from one view cell to another.
    pub transitions: Transitions,
    /// Where noise volumes are kept between runs.
    pub noise_cache_dir: PathBuf,
    /// Where the files of voxels lie that scenes name: `grids` in the folder of the state.
    pub grids_dir: PathBuf,
    /// Where the files of maps lie that scenes name: `maps` in the folder of the state.
    pub maps_dir: PathBuf,
}

/// How caches are read for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FrameFilter {
    /// Sharp, 16 texels.
    CatmullRom,
    /// Soft, 4 texels.
    Bilinear,
}

/// What viewers are shown on their way from one view cell to another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Transitions {
    /// A mix of both cells' pictures.
    #[default]
    Fade,
    /// Rays of the viewer's own, whose start moves from the old cell's reference to the new one's (Weinrauch et al. 2023, 3.3.1).
    OwnRays,
}

/// A view cell placed by hand: section `[[cells]]`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlacedCell {
    /// What people call it; no other cell has the same name.
    pub name: String,
    /// Its reference point: x, altitude, z.
    pub center_m: [f64; 3],
    /// Viewers within this distance belong to it.
    pub radius_m: f64,
}

impl FrameFilter {
    /// Every filter.
    pub const ALL: [Self; 2] = [Self::CatmullRom, Self::Bilinear];
}

impl RenderConfig {
    /// The defaults of a server that keeps its noise in `noise_cache_dir`.
    pub fn new(noise_cache_dir: PathBuf) -> Self {
        Self {
            mip_bias: None,
            samples: None,
            quality: None,
            cache_memory_mib: 256,
            cell_memory_mib: None,
            march_share: 0.25,
            age_factor: 1.0,
            march_steps: None,
            frame_filter: None,
            parallax_steps: None,
            samples_by_area: None,
            proxies: ProxySettings::default(),
            transitions: Transitions::default(),
            grids_dir: noise_cache_dir.join("grids"),
            maps_dir: noise_cache_dir.join("maps"),
            noise_cache_dir,
        }
    }

    fn read(value: &Value, default: Self) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, "/render")?;
        members.only(&[
            "mip_bias",
            "samples",
            "samples_by_area",
            "quality",
            "cache_memory_mib",
            "cell_memory_mib",
            "march_share",
            "age_factor",
            "march_steps",
            "frame_filter",
            "parallax_steps",
            "proxies",
            "slabs",
            "bands",
            "band_ends",
            "dome_follow_m",
            "transitions",
            "noise_cache_dir",
        ])?;
        let read = Self {
            mip_bias: match members.optional::<f64>("mip_bias")? {
                Some(bias) => Some(MIP_BIAS.check(&members.pointer_of("mip_bias"), bias)? as f32),
                None => default.mip_bias,
            },
            samples: match members.optional::<u32>("samples")? {
                Some(samples) => Some(SAMPLES.check_u32(&members.pointer_of("samples"), samples)?),
                None => default.samples,
            },
            samples_by_area: members
                .optional("samples_by_area")?
                .or(default.samples_by_area),
            quality: members.optional("quality")?.or(default.quality),
            cache_memory_mib: count(
                &members,
                "cache_memory_mib",
                CACHE_MEMORY_MIB,
                default.cache_memory_mib,
            )?,
            cell_memory_mib: match members.optional::<u32>("cell_memory_mib")? {
                Some(memory_mib) => Some(
                    CELL_MEMORY_MIB
                        .check_u32(&members.pointer_of("cell_memory_mib"), memory_mib)?,
                ),
                None => default.cell_memory_mib,
            },
            march_share: number(
                &members,
                "march_share",
                MARCH_SHARE,
                f64::from(default.march_share),
            )? as f32,
            age_factor: number(&members, "age_factor", AGE_FACTOR, default.age_factor)?,
            march_steps: match members.optional::<u32>("march_steps")? {
                Some(steps) => {
                    Some(MARCH_STEPS.check_u32(&members.pointer_of("march_steps"), steps)?)
                }
                None => default.march_steps,
            },
            frame_filter: members.optional("frame_filter")?.or(default.frame_filter),
            parallax_steps: match members.optional::<u32>("parallax_steps")? {
                Some(steps) => {
                    Some(PARALLAX_STEPS.check_u32(&members.pointer_of("parallax_steps"), steps)?)
                }
                None => default.parallax_steps,
            },
            proxies: read_proxies(&members, default.proxies)?,
            transitions: members.member_or("transitions", default.transitions)?,
            noise_cache_dir: members
                .optional::<String>("noise_cache_dir")?
                .map_or(default.noise_cache_dir, PathBuf::from),
            grids_dir: default.grids_dir,
            maps_dir: default.maps_dir,
        };
        read.check_transitions(&members)?;
        Ok(read)
    }

    /// Own rays begin and end where caches show what rays from their references through one sphere of each layer show.
    fn check_transitions(&self, members: &ObjectReader<'_>) -> Result<(), ValueError> {
        let is_plain = self.parallax_steps == Some(0)
            && self.proxies.setup == ProxySetup::InLayer
            && self.proxies.slabs == 1;
        if self.transitions == Transitions::Fade || is_plain {
            return Ok(());
        }
        Err(ValueError::new(
            members.pointer_of("transitions"),
            &Value::from("own-rays"),
            "\"fade\"; \"own-rays\" with parallax_steps = 0, slabs = 1 and proxies = \"in-layer\" alone",
        ))
    }
}

/// What layers are kept on.
fn read_proxies(
    members: &ObjectReader<'_>,
    default: ProxySettings,
) -> Result<ProxySettings, ValueError> {
    let settings = ProxySettings {
        setup: members.member_or("proxies", default.setup)?,
        slabs: count(members, "slabs", SLABS, default.slabs)?,
        bands: count(members, "bands", BANDS, default.bands)?,
        band_ends: members.member_or("band_ends", default.band_ends)?,
        follow_m: number(members, "dome_follow_m", DOME_FOLLOW_M, default.follow_m)?,
    };
    settings.checked().map_err(|error| {
        let allowed = format!(
            "1 with {}: domes are not cut into slabs",
            error.setup.name()
        );
        ValueError::new(
            members.pointer_of("slabs"),
            &Value::from(error.slabs),
            allowed,
        )
    })
}

impl ReadJson for ProxySetup {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &Self::NAMES)
    }
}

impl ReadJson for BandEnds {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &[("gaps", Self::Gaps), ("cut", Self::Cut)])
    }
}

impl ReadJson for Transitions {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let names = [("fade", Self::Fade), ("own-rays", Self::OwnRays)];
        read_name(value, pointer, &names)
    }
}

impl ReadJson for FrameFilter {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(
            value,
            pointer,
            &[
                ("catmull-rom", Self::CatmullRom),
                ("bilinear", Self::Bilinear),
            ],
        )
    }
}

impl ReadJson for LogFormat {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(
            value,
            pointer,
            &[("text", Self::Text), ("json", Self::Json)],
        )
    }
}

impl ReadJson for PlacedCell {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, pointer)?;
        members.only(&["name", "center_m", "radius_m"])?;
        let name: String = members.required("name", "a name")?;
        if name.is_empty() || name.chars().count() > CELL_NAME_MAX_CHARS {
            return Err(ValueError::new(
                members.pointer_of("name"),
                &Value::from(name),
                format!("1 to {CELL_NAME_MAX_CHARS} characters"),
            ));
        }
        let center_m: [f64; 3] = members.required("center_m", "an array of 3 numbers")?;
        let center_pointer = members.pointer_of("center_m");
        POSITION_HORIZONTAL_M.check(&format!("{center_pointer}/0"), center_m[0])?;
        POSITION_ALTITUDE_M.check(&format!("{center_pointer}/1"), center_m[1])?;
        POSITION_HORIZONTAL_M.check(&format!("{center_pointer}/2"), center_m[2])?;
        Ok(Self {
            name,
            center_m,
            radius_m: CELL_RADIUS_M.check(
                &members.pointer_of("radius_m"),
                members.required("radius_m", &CELL_RADIUS_M.to_string())?,
            )?,
        })
    }
}

impl Config {
    /// The keys of the file's top level.
    const KEYS: &[&str] = &[
        "listen",
        "state_dir",
        "viewers_max",
        "encoder_threads",
        "video_kbit_per_s",
        "viewer_stall_s",
        "drain_s",
        "allowed_origins",
        "allowed_hosts",
        "trusted_proxies",
        "proxy_header",
        "tokens_file",
        "tokens",
        "limits",
        "tls",
        "log",
        "log_format",
        "otlp_endpoint",
        "otlp_frame_share",
        "render",
        "cells",
    ];

    /// The defaults of a server that keeps its state in `state_dir`.
    pub fn new(state_dir: PathBuf) -> Self {
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        Self {
            listen: SocketAddr::from((Ipv4Addr::LOCALHOST, 8080)),
            viewers_max: 64,
            // More than eight would starve whatever feeds them.
            encoder_threads: cores.clamp(1, 8) as u32,
            video_kbit_per_s: None,
            viewer_stall_s: 30.0,
            drain_s: 5.0,
            allowed_origins: Vec::new(),
            allowed_hosts: Vec::new(),
            trusted_proxies: Vec::new(),
            proxy_header: ProxyHeader::default(),
            tokens_file: None,
            tokens: ConfiguredTokens::default(),
            limits: LimitsConfig::default(),
            tls: None,
            log: "info".to_owned(),
            log_format: LogFormat::Text,
            otlp_endpoint: None,
            otlp_frame_share: 0.01,
            render: RenderConfig {
                grids_dir: state_dir.join("grids"),
                maps_dir: state_dir.join("maps"),
                ..RenderConfig::new(state_dir.join("cache"))
            },
            cells: Vec::new(),
            state_dir,
        }
    }

    /// Reads a configuration in which keys may be missing. `default_state_dir` is where the state
    /// is kept if the configuration does not tell.
    ///
    /// # Errors
    /// Names an unknown key or the first value that is not allowed.
    pub fn from_json(value: &Value, default_state_dir: PathBuf) -> Result<Self, ValueError> {
        let members = ObjectReader::new(value, "")?;
        members.only(Self::KEYS)?;
        let state_dir = members
            .optional::<String>("state_dir")?
            .map_or(default_state_dir, PathBuf::from);
        let default = Self::new(state_dir);
        Ok(Self {
            listen: read_listen(&members)?.unwrap_or(default.listen),
            viewers_max: count(&members, "viewers_max", VIEWERS_MAX, default.viewers_max)?,
            encoder_threads: count(
                &members,
                "encoder_threads",
                ENCODER_THREADS,
                default.encoder_threads,
            )?,
            video_kbit_per_s: match members.optional::<u32>("video_kbit_per_s")? {
                Some(rate) => Some(VIDEO_KBIT_PER_S.check_u32("/video_kbit_per_s", rate)?),
                None => default.video_kbit_per_s,
            },
            viewer_stall_s: number(
                &members,
                "viewer_stall_s",
                VIEWER_STALL_S,
                default.viewer_stall_s,
            )?,
            drain_s: number(&members, "drain_s", DRAIN_S, default.drain_s)?,
            allowed_origins: members.member_or("allowed_origins", default.allowed_origins)?,
            allowed_hosts: members.member_or("allowed_hosts", default.allowed_hosts)?,
            trusted_proxies: read_trusted_proxies(&members)?,
            proxy_header: members.member_or("proxy_header", default.proxy_header)?,
            tokens_file: members
                .optional::<String>("tokens_file")?
                .map(PathBuf::from),
            tokens: ConfiguredTokens(members.member_or("tokens", default.tokens.0)?),
            limits: match members.optional::<Value>("limits")? {
                Some(limits) => LimitsConfig::read(&limits)?,
                None => default.limits,
            },
            tls: match members.optional::<Value>("tls")? {
                Some(tls) => Some(TlsConfig::read(&tls)?),
                None => default.tls,
            },
            log: members.member_or("log", default.log)?,
            log_format: members.member_or("log_format", default.log_format)?,
            otlp_endpoint: read_endpoint(&members)?.or(default.otlp_endpoint),
            otlp_frame_share: number(
                &members,
                "otlp_frame_share",
                OTLP_FRAME_SHARE,
                default.otlp_frame_share,
            )?,
            render: match members.optional::<Value>("render")? {
                Some(render) => RenderConfig::read(&render, default.render)?,
                None => default.render,
            },
            cells: read_cells(&members)?,
            state_dir: default.state_dir,
        })
    }

    /// The proxies that are believed.
    pub fn proxies(&self) -> TrustedProxies {
        TrustedProxies::new(self.trusted_proxies.clone(), self.proxy_header)
    }

    /// Whether only programs of this machine ask, by a proxy either.
    pub fn serves_this_machine_alone(&self) -> bool {
        self.listen.ip().to_canonical().is_loopback() && self.trusted_proxies.is_empty()
    }

    /// Logs the whole configuration and what in the environment looks like ours and is not;
    /// called once at start.
    pub fn log(&self) {
        for (variable, nearest) in sources::unknown_variables() {
            tracing::warn!(%variable, nearest, "unknown environment variable");
        }
        match serde_json::to_string(self) {
            Ok(text) => tracing::info!(config = %text, "configuration"),
            Err(error) => tracing::warn!(%error, "the configuration cannot be written as JSON"),
        }
    }
}

fn read_listen(members: &ObjectReader<'_>) -> Result<Option<SocketAddr>, ValueError> {
    members
        .optional::<String>("listen")?
        .map(|text| {
            text.parse().map_err(|_| {
                ValueError::new(
                    "/listen",
                    &Value::from(text),
                    "ADDRESS:PORT, such as 127.0.0.1:8080 or [::1]:8080",
                )
            })
        })
        .transpose()
}

/// Without a user and a password, so that there is no secret in it.
fn read_endpoint(members: &ObjectReader<'_>) -> Result<Option<String>, ValueError> {
    let endpoint: Option<String> = members.optional("otlp_endpoint")?;
    match endpoint {
        Some(text)
            if !text.starts_with("http://")
                || text.len() == "http://".len()
                || text.contains(['@', '?', '#', ' ']) =>
        {
            // It may hold what nobody should read in a log.
            Err(ValueError::new(
                members.pointer_of("otlp_endpoint"),
                &Value::from("another address"),
                "http://HOST:PORT without a user, such as http://127.0.0.1:4318",
            ))
        }
        endpoint => Ok(endpoint),
    }
}

fn read_trusted_proxies(members: &ObjectReader<'_>) -> Result<Vec<ProxyNet>, ValueError> {
    let proxies: Vec<ProxyNet> = members.member_or("trusted_proxies", Vec::new())?;
    if proxies.len() > PROXIES_MAX {
        return Err(ValueError::new(
            "/trusted_proxies",
            &Value::from(format!("{} networks", proxies.len())),
            format!("0 to {PROXIES_MAX} networks"),
        ));
    }
    Ok(proxies)
}

fn read_cells(members: &ObjectReader<'_>) -> Result<Vec<PlacedCell>, ValueError> {
    let cells: Vec<PlacedCell> = members.member_or("cells", Vec::new())?;
    if cells.len() > CELLS_MAX {
        return Err(ValueError::new(
            "/cells",
            &Value::from(format!("{} cells", cells.len())),
            format!("0 to {CELLS_MAX} cells"),
        ));
    }
    for (index, cell) in cells.iter().enumerate() {
        if cells[..index].iter().any(|other| other.name == cell.name) {
            return Err(ValueError::new(
                format!("/cells/{index}/name"),
                &Value::from(cell.name.as_str()),
                "a name that no other cell has",
            ));
        }
    }
    Ok(cells)
}

fn number(
    members: &ObjectReader<'_>,
    key: &str,
    range: NumberRange,
    default: f64,
) -> Result<f64, ValueError> {
    range.check(&members.pointer_of(key), members.member_or(key, default)?)
}

fn count(
    members: &ObjectReader<'_>,
    key: &str,
    range: NumberRange,
    default: u32,
) -> Result<u32, ValueError> {
    range.check_u32(&members.pointer_of(key), members.member_or(key, default)?)
}
