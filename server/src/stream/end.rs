//! How a session ends.

use std::borrow::Cow;

use axum::extract::ws::close_code;
use skycell_protocol::message::{ErrorCode, ErrorMessage};
use tokio_tungstenite::tungstenite;

/// When clients come back to a server that starts anew, or to another one. Tuned: 64 viewers are one every 40 ms.
const COME_BACK_S: [f64; 2] = [0.5, 3.0];
/// Codes of close frames that are this protocol's own, after the status of HTTP that they correspond to (RFC 6455,
/// section 7.4.2, leaves 4000 to 4999 to applications).
mod close_code_of {
    pub(super) const UNAUTHORIZED: u16 = 4401;
    pub(super) const RATE_LIMITED: u16 = 4429;
}

/// Why a session ends, and what the client is told.
#[derive(Debug)]
pub(super) enum End {
    /// The client has closed or is gone: nobody is there to be told.
    PeerGone,
    /// The server closes.
    Close {
        /// What is said before the close frame, if anything.
        error: Option<ErrorMessage>,
        /// The close frame's code.
        code: u16,
        /// The close frame's reason.
        reason: Cow<'static, str>,
    },
}

impl End {
    fn with_error(code: ErrorCode, message: String, close: u16, reason: &'static str) -> Self {
        Self::Close {
            error: Some(ErrorMessage {
                code,
                pointer: None,
                message,
            }),
            code: close,
            reason: Cow::Borrowed(reason),
        }
    }

    /// The first message was no hello, or a second one came.
    pub(super) fn hello_expected(message: &str) -> Self {
        Self::with_error(
            ErrorCode::HelloExpected,
            message.to_owned(),
            close_code::PROTOCOL,
            "hello expected",
        )
    }

    /// No hello came in time.
    pub(super) fn hello_too_late(seconds: u64) -> Self {
        Self::with_error(
            ErrorCode::HelloExpected,
            format!("no hello within {seconds} s"),
            close_code::POLICY,
            "no hello in time",
        )
    }

    /// The client speaks another version.
    pub(super) fn wrong_version(error: ErrorMessage) -> Self {
        Self::Close {
            error: Some(error),
            code: close_code::PROTOCOL,
            reason: Cow::Borrowed("wrong protocol version"),
        }
    }

    /// The client sent a binary message.
    pub(super) fn binary() -> Self {
        Self::with_error(
            ErrorCode::WrongProtocol,
            "clients send JSON text messages, no binary ones".to_owned(),
            close_code::POLICY,
            "binary message",
        )
    }

    /// No token, or one that is not known.
    pub(super) fn unauthorized(why: &str) -> Self {
        Self::with_error(
            ErrorCode::Unauthorized,
            format!("{why}; send it as token in the hello"),
            close_code_of::UNAUTHORIZED,
            "unauthorized",
        )
    }

    /// Too many wrong tokens came from the peer.
    pub(super) fn blocked(seconds: u64) -> Self {
        Self::with_error(
            ErrorCode::RateLimited,
            format!("too many wrong tokens; try again in {seconds} s"),
            close_code_of::RATE_LIMITED,
            "too many wrong tokens",
        )
    }

    /// The frames of all viewers have as many pixels as may be.
    pub(super) fn too_many_pixels(message: String) -> Self {
        Self::with_error(
            ErrorCode::TooManyPixels,
            message,
            close_code::AGAIN,
            "too many pixels",
        )
    }

    /// As many viewers are connected as may be.
    pub(super) fn too_many_viewers(message: String) -> Self {
        Self::with_error(
            ErrorCode::TooManyViewers,
            message,
            close_code::AGAIN,
            "too many viewers",
        )
    }

    /// The server failed.
    pub(super) fn internal(message: &str) -> Self {
        Self::with_error(
            ErrorCode::Internal,
            message.to_owned(),
            close_code::ERROR,
            "internal error",
        )
    }

    /// The client takes or says nothing.
    pub(super) fn stalled() -> Self {
        Self::Close {
            error: None,
            code: close_code::POLICY,
            reason: Cow::Borrowed("no progress"),
        }
    }

    /// The server shuts down. Each client is told another time after which to come back, so that they do not come at once.
    pub(super) fn restart() -> Self {
        let [least_s, most_s] = COME_BACK_S;
        let after_s = least_s + (most_s - least_s) * fastrand::f64();
        Self::Close {
            error: None,
            code: close_code::RESTART,
            reason: format!("the server shuts down; retry_after_s={after_s:.2}").into(),
        }
    }

    /// The same end without a message before the close frame, for who speaks another protocol.
    pub(super) fn without_message(mut self) -> Self {
        if let Self::Close { error, .. } = &mut self {
            *error = None;
        }
        self
    }

    /// What a socket's error means.
    pub(super) fn of_socket_error(error: axum::Error) -> Self {
        let error = error.into_inner();
        match error.downcast_ref::<tungstenite::Error>() {
            Some(tungstenite::Error::Capacity(limit)) => Self::with_error(
                ErrorCode::TooLarge,
                format!("{limit} bytes"),
                close_code::SIZE,
                "message too large",
            ),
            Some(tungstenite::Error::Utf8(_)) => Self::with_error(
                ErrorCode::BadJson,
                "a text message is not UTF-8".to_owned(),
                close_code::INVALID,
                "not UTF-8",
            ),
            Some(tungstenite::Error::Protocol(
                tungstenite::error::ProtocolError::ResetWithoutClosingHandshake,
            )) => Self::PeerGone,
            Some(tungstenite::Error::Protocol(violation)) => Self::with_error(
                ErrorCode::WrongProtocol,
                format!("not WebSocket: {violation}"),
                close_code::PROTOCOL,
                "protocol violation",
            ),
            _ => Self::PeerGone,
        }
    }
}
