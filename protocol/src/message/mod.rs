//! The JSON text messages of a viewer's WebSocket, told apart by their `type`.
//!
//! Client to server: `hello` (first, once), `camera`, `view`, `ack`. Server to client: `welcome`,
//! `status`, `error`, and binary frames ([`crate::frame`]).

mod client;
mod server;
mod token;

pub use client::{Acknowledgement, CameraInput, ClientMessage, Hello, MessageError, ViewChange};
pub use server::{ErrorCode, ErrorMessage, PickedQuality, ServerMessage, Status, Welcome};
pub use token::{ACCESS_TOKEN_MAX_BYTES, AccessToken};
