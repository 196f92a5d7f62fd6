//! What Skycell's server and its clients say to each other: the scene document, the camera, the
//! messages and the header of a frame. No GPU and no I/O.
//!
//! Conventions: right-handed, y up, metres. North is -z, east is +x. A yaw or azimuth of 0 looks
//! north and grows clockwise (90 = east); a pitch or elevation is positive upwards. The y of a
//! position is the altitude above the ground sphere at that point; x and z are planar coordinates.
//!
//! Wire types are called `...Document`, have public fields and can hold anything. Domain types
//! have private fields, are made from documents by `TryFrom` and cannot be wrong.

pub mod camera;
pub mod clouds;
pub mod colour_scale;
pub mod frame;
pub mod id;
pub mod message;
pub mod moment;
pub mod number_range;
pub mod quality;
pub mod read_json;
pub mod scene;
pub mod schema;
pub mod show;
pub mod stereo;
pub mod value_error;
pub mod view;

pub use camera::{Camera, CameraDocument};
pub use colour_scale::ColourScale;
pub use frame::{FrameCodec, FrameHeader, FrameStages};
pub use id::{CellId, FrameSequence, InputSequence, ViewerId};
pub use moment::Moment;
pub use quality::{QualityChoice, QualityPreset};
pub use scene::{Scene, SceneDocument, SceneError, SunDepth};
pub use show::{Show, ShowReport};
pub use stereo::Stereo;
pub use value_error::ValueError;
pub use view::{Codec, FrameSize, JpegQuality, RendererKind};

/// The version of messages that this crate speaks; frame headers have a version of their own.
pub const PROTOCOL_VERSION: u32 = 1;

/// The WebSocket subprotocol of [`PROTOCOL_VERSION`]; a server refuses a connection without it.
pub const SUBPROTOCOL: &str = "skycell.v1";

/// The largest message that a server takes from a client. A hello is about 300 bytes.
pub const INBOUND_MESSAGE_MAX_BYTES: usize = 64 * 1024;
