//! Thin clients of a Skycell server.
//!
//! [`Connection`] is a viewer without a screen: it says hello, moves its camera, receives frames
//! and acknowledges them. [`Session`] comes back when it is lost. [`HttpApi`] reads and patches the scene and reads the server's counters.
//! [`record`] and [`load`] are what the binary `skycell` does with them.

pub mod access;
pub mod camera_path;
pub mod clouds_file;
pub mod connection;
pub mod http_api;
pub mod load;
pub mod picture;
pub mod record;
pub mod retry;
pub mod server_address;
pub mod server_stats;
pub mod session;
pub mod unix_time;
pub mod video;

pub use access::{Access, AccessError};
pub use connection::{Connection, ConnectionError, ConnectionLimits, Event, Frame};
pub use http_api::{HttpApi, HttpApiError, MapChoice, SceneRevision};
pub use server_address::{ServerAddress, ServerAddressError};
pub use server_stats::ServerStats;
pub use session::Session;
