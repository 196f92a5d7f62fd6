//! What a server says to a client. Clients ignore keys that they do not know, so that a server
//! may say more than they understand.

use serde::{Deserialize, Serialize};

use crate::{CellId, Codec, RendererKind, Stereo, ViewerId};

/// A message from a server.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "kebab-case")]
pub enum ServerMessage {
    /// The answer to a hello.
    Welcome(Welcome),
    /// How things are, once a second.
    Status(Status),
    /// Something that the client said is not allowed.
    Error(ErrorMessage),
}

/// The answer to a hello: who the client is and what it may ask for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Welcome {
    /// The version that the server speaks.
    pub protocol: u32,
    /// The client's number.
    pub viewer: ViewerId,
    /// The view cell that the client belongs to; null until the renderer has placed it. Later
    /// ones are in `status` and in every frame.
    pub cell: Option<CellId>,
    /// Name and version of the server.
    pub server: String,
    /// What renders: the name of the graphics adapter.
    pub adapter: String,
    /// The widest frame that may be asked for.
    pub max_width: u32,
    /// The highest frame that may be asked for.
    pub max_height: u32,
    /// The most frames a second that may be asked for.
    pub max_fps: f64,
    /// Length of the header of a binary frame.
    pub frame_header_bytes: u32,
    /// How the client's frames are compressed: the first of its `codecs` that the server can give. While a view rests, exact
    /// pictures may come as PNG beside a video.
    #[serde(default)]
    pub codec: Codec,
}

/// How things are, once a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The view cell that the client belongs to; null until the renderer has placed it.
    pub cell: Option<CellId>,
    /// What people call that cell; empty while there is none.
    pub cell_name: String,
    /// How many viewers share the cell.
    pub viewers_in_cell: u32,
    /// Share of the cell's requested texels that another of its viewers requests too, 0 to 1.
    pub overlap: f64,
    /// Texels of the cell that wait for an update.
    pub texels_pending: u64,
    /// Revision of the scene.
    pub scene_revision: u64,
    /// Frames sent to this client in the last second.
    pub fps: f64,
    /// Sent to this client in the last second, in 10^6 bits.
    pub mbit_per_s: f64,
    /// Nothing of the cell waits for an update.
    pub sky_converged: bool,
    /// Half of the cached texels that were marched again at high quality deviate by no more, in percent of what is
    /// shown; null before the first.
    #[serde(default)]
    pub cache_error_p50_percent: Option<f64>,
    /// The same of 95 of 100 texels.
    #[serde(default)]
    pub cache_error_p95_percent: Option<f64>,
    /// How good this client's pictures are; null until the renderer has placed it.
    #[serde(default)]
    pub quality: Option<PickedQuality>,
    /// Which renderer makes this client's frames; null until the renderer has placed it.
    #[serde(default)]
    pub renderer: Option<RendererKind>,
    /// Why it is not the one that was asked for; null where it is.
    #[serde(default)]
    pub renderer_note: Option<String>,
    /// Why this client's frames do not show what was asked for; null where they do.
    #[serde(default)]
    pub show_note: Option<String>,
    /// What this client's cell has lost because the server's memory or time do not suffice; null where nothing is lost.
    #[serde(default)]
    pub loss_note: Option<String>,
    /// The two eyes whose pictures this client's frames hold; null for one.
    #[serde(default)]
    pub stereo: Option<Stereo>,
    /// How this client's frames are compressed.
    #[serde(default)]
    pub codec: Codec,
    /// The rate that its video aims at; null where frames are single pictures.
    #[serde(default)]
    pub target_kbit_per_s: Option<u32>,
}

/// What the server has picked for a client.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PickedQuality {
    /// The preset, or `custom` for a point without a name.
    pub name: String,
    /// Its mean FLIP against the converged picture.
    pub flip: f64,
    /// That FLIP was measured; otherwise it is an estimate.
    pub measured: bool,
    /// The server has something as good, or as fast, as was asked for.
    pub is_met: bool,
    /// Device time of a frame, if the device tells.
    #[serde(default)]
    pub device_ms: Option<f64>,
}

/// Something that the client said is not allowed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ErrorMessage {
    /// What kind of error, for programs.
    pub code: ErrorCode,
    /// JSON pointer of the value in the client's message, if the error is about one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pointer: Option<String>,
    /// What is wrong and what is allowed, for people.
    pub message: String,
}

/// The kinds of errors. Their names on the wire never change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ErrorCode {
    /// The message is not JSON.
    BadJson,
    /// The message's `type` is missing or unknown.
    UnknownType,
    /// A key is unknown or missing, or a value is not allowed; the session goes on.
    BadValue,
    /// The first message was no hello, or none came in time, or a second one came.
    HelloExpected,
    /// The message is larger than [`crate::INBOUND_MESSAGE_MAX_BYTES`].
    TooLarge,
    /// The server has as many viewers as it may.
    TooManyViewers,
    /// The frames of all viewers together have as many pixels as they may. After a change of wishes the session goes on
    /// with the old ones.
    TooManyPixels,
    /// The server needs a token, and the hello has none or one that is not known.
    Unauthorized,
    /// Too many wrong tokens came from the client's address.
    RateLimited,
    /// The message does not belong to the protocol (binary), or the hello asks for a version that
    /// the server does not speak.
    WrongProtocol,
    /// The server failed; its log tells why.
    Internal,
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_codes_on_the_wire_are_pinned() {
        for (code, text) in [
            (ErrorCode::BadJson, "bad-json"),
            (ErrorCode::UnknownType, "unknown-type"),
            (ErrorCode::BadValue, "bad-value"),
            (ErrorCode::HelloExpected, "hello-expected"),
            (ErrorCode::TooLarge, "too-large"),
            (ErrorCode::TooManyViewers, "too-many-viewers"),
            (ErrorCode::TooManyPixels, "too-many-pixels"),
            (ErrorCode::Unauthorized, "unauthorized"),
            (ErrorCode::RateLimited, "rate-limited"),
            (ErrorCode::WrongProtocol, "wrong-protocol"),
            (ErrorCode::Internal, "internal"),
        ] {
            assert_eq!(serde_json::to_value(code).ok(), Some(json!(text)));
        }
    }

    #[test]
    fn a_client_reads_a_status_with_keys_it_does_not_know() {
        let status = json!({
            "type": "status", "cell": 3, "cell_name": "harbour", "viewers_in_cell": 2,
            "overlap": 0.5, "texels_pending": 7, "scene_revision": 9, "fps": 30.0,
            "mbit_per_s": 4.5, "sky_converged": false, "moon": "full"
        });
        match serde_json::from_value(status) {
            Ok(ServerMessage::Status(status)) => assert_eq!(status.cell, Some(CellId(3))),
            other => panic!("not a status: {other:?}"),
        }
    }

    #[test]
    fn an_error_without_a_place_has_no_pointer() {
        let error = ServerMessage::Error(ErrorMessage {
            code: ErrorCode::Internal,
            pointer: None,
            message: "sorry".to_owned(),
        });
        assert_eq!(
            serde_json::to_value(error).ok(),
            Some(json!({"type": "error", "code": "internal", "message": "sorry"}))
        );
    }
}
