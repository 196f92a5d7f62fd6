//! A session that comes back: a server that starts anew, or a line that breaks, costs the outage and nothing else.
//!
//! It goes on at the live edge, with the newest camera; nothing of the outage is replayed. The wait before a try is the one that a
//! server tells when it closes, else it doubles; half of it is random, so that a crowd does not return as one.

use std::time::Duration;

use skycell_protocol::message::{Acknowledgement, ErrorCode, Hello, Welcome};
use skycell_protocol::{Camera, InputSequence};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep};

use crate::{Connection, ConnectionError, ConnectionLimits, Event, ServerAddress};

const RETRY_FIRST: Duration = Duration::from_millis(500);
const RETRY_LONGEST: Duration = Duration::from_secs(15);
/// After this long without a connection the session is given up.
const OUTAGE_MAX: Duration = Duration::from_secs(60);
/// Close codes of a server that may be back: it goes away, failed, restarts, or has no room now.
const PASSING_CODES: [u16; 4] = [1001, 1011, 1012, 1013];

/// A connection that is opened again when it is lost.
#[derive(Debug)]
pub struct Session {
    address: ServerAddress,
    hello: Hello,
    limits: ConnectionLimits,
    connection: Connection,
    /// On its way to the next connection. A task of its own, so that whoever stops waiting does not stop it.
    coming_back: Option<ComingBack>,
    reconnects: u32,
}

#[derive(Debug)]
struct ComingBack {
    opening: JoinHandle<Result<Connection, ConnectionError>>,
    /// The camera of its hello.
    camera: Camera,
}

impl Drop for ComingBack {
    fn drop(&mut self) {
        self.opening.abort();
    }
}

/// Whether another try may go better.
fn is_passing(error: &ConnectionError) -> bool {
    match error {
        ConnectionError::Connect { .. }
        | ConnectionError::Timeout { .. }
        | ConnectionError::Transport(_) => true,
        ConnectionError::Closed { code, .. } => {
            code.is_none_or(|code| PASSING_CODES.contains(&code))
        }
        // The others of a crowd may have been faster; some leave again.
        ConnectionError::Refused(refusal) => refusal.code == ErrorCode::TooManyViewers,
        _ => false,
    }
}

/// The time that a server tells when it closes: `…; retry_after_s=1.75`.
fn told_wait(error: &ConnectionError) -> Option<Duration> {
    let ConnectionError::Closed { reason, .. } = error else {
        return None;
    };
    let (_, told) = reason.split_once("retry_after_s=")?;
    let end = told
        .find(|c: char| !c.is_ascii_digit() && c != '.')
        .unwrap_or(told.len());
    let seconds: f64 = told[..end].parse().ok()?;
    Duration::try_from_secs_f64(seconds)
        .ok()
        .map(|wait| wait.min(RETRY_LONGEST))
}

/// How long to wait before a try; `failures` in a row, at least 1, `random` from 0 to 1.
fn wait_before(failures: u32, random: f64) -> Duration {
    let longest = RETRY_FIRST
        .saturating_mul(1 << (failures - 1).min(16))
        .min(RETRY_LONGEST);
    longest.mul_f64(0.5 + 0.5 * random)
}

impl Session {
    /// Connects as [`Connection::open`] does; only what is lost later is tried again.
    ///
    /// # Errors
    /// As [`Connection::open`].
    pub async fn open(
        address: &ServerAddress,
        hello: Hello,
        limits: ConnectionLimits,
    ) -> Result<Self, ConnectionError> {
        Ok(Self {
            connection: Connection::open(address, hello.clone(), limits).await?,
            address: address.clone(),
            hello,
            limits,
            coming_back: None,
            reconnects: 0,
        })
    }

    /// What the server said at the beginning of the present connection.
    pub fn welcome(&self) -> &Welcome {
        self.connection.welcome()
    }

    /// How often it has come back.
    pub fn reconnects(&self) -> u32 {
        self.reconnects
    }

    /// Looks somewhere else. During an outage the camera goes with the next hello, as input 0.
    ///
    /// # Errors
    /// If the session cannot come back.
    pub async fn send_camera(&mut self, camera: Camera) -> Result<InputSequence, ConnectionError> {
        self.hello.camera = camera;
        if self.coming_back.is_some() {
            return Ok(InputSequence(0));
        }
        match self.connection.send_camera(camera).await {
            Ok(input) => Ok(input),
            Err(error) => self.come_back(error).map(|()| InputSequence(0)),
        }
    }

    /// Acknowledges a frame; one of a connection that is lost needs it no more.
    ///
    /// # Errors
    /// If the session cannot come back.
    pub async fn acknowledge(&mut self, ack: Acknowledgement) -> Result<(), ConnectionError> {
        if self.coming_back.is_some() {
            return Ok(());
        }
        match self.connection.acknowledge(ack).await {
            Ok(()) => Ok(()),
            Err(error) => self.come_back(error),
        }
    }

    /// Waits for the server's next word; after an outage that is [`Event::Resumed`]. Nothing is lost when the future is
    /// dropped.
    ///
    /// # Errors
    /// If the session cannot come back, or not within a minute.
    pub async fn next_event(&mut self) -> Result<Event, ConnectionError> {
        if self.coming_back.is_none() {
            match self.connection.next_event().await {
                Err(error) => self.come_back(error)?,
                event => return event,
            }
        }
        if let Some(coming_back) = &mut self.coming_back {
            let opened = (&mut coming_back.opening).await;
            let camera = coming_back.camera;
            self.coming_back = None;
            // Only a task that panicked or was stopped gives no answer, and nobody stops this one.
            self.connection = opened.unwrap_or_else(|_| {
                Err(ConnectionError::Closed {
                    code: None,
                    reason: "the client failed".to_owned(),
                })
            })?;
            self.reconnects += 1;
            if camera != self.hello.camera {
                // It looked elsewhere while the hello was under way. What goes wrong here is heard next.
                self.connection.send_camera(self.hello.camera).await.ok();
            }
        }
        Ok(Event::Resumed)
    }

    /// Says goodbye. A server that does not answer is left after a second.
    pub async fn close(self) {
        if self.coming_back.is_none() {
            self.connection.close().await;
        }
    }

    /// Starts to come back from a loss.
    fn come_back(&mut self, lost: ConnectionError) -> Result<(), ConnectionError> {
        if !is_passing(&lost) {
            return Err(lost);
        }
        let (address, hello, limits) = (self.address.clone(), self.hello.clone(), self.limits);
        let camera = hello.camera;
        let opening = tokio::spawn(async move {
            let give_up = Instant::now() + OUTAGE_MAX;
            let mut error = lost;
            for failures in 1.. {
                let wait =
                    told_wait(&error).unwrap_or_else(|| wait_before(failures, fastrand::f64()));
                if Instant::now() + wait > give_up {
                    break;
                }
                sleep(wait).await;
                match Connection::open(&address, hello.clone(), limits).await {
                    Err(failed) if is_passing(&failed) => error = failed,
                    result => return result,
                }
            }
            Err(error)
        });
        self.coming_back = Some(ComingBack { opening, camera });
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn closed(code: Option<u16>, reason: &str) -> ConnectionError {
        ConnectionError::Closed {
            code,
            reason: reason.to_owned(),
        }
    }

    #[test]
    fn the_servers_own_time_to_come_back_is_taken_within_limits() {
        let told = |reason: &str| told_wait(&closed(Some(1012), reason));
        assert_eq!(
            told("the server shuts down; retry_after_s=1.75 (1012)"),
            Some(Duration::from_millis(1750))
        );
        assert_eq!(told("retry_after_s=9999"), Some(RETRY_LONGEST));
        for silent in [
            "no progress",
            "retry_after_s=",
            "retry_after_s=-1",
            "retry_after_s=1.2.3",
        ] {
            assert_eq!(told(silent), None, "{silent}");
        }
    }

    #[test]
    fn waits_double_up_to_a_limit_and_their_upper_half_is_random() {
        assert_eq!(wait_before(1, 1.0), RETRY_FIRST);
        assert_eq!(wait_before(1, 0.0), RETRY_FIRST / 2);
        assert_eq!(wait_before(3, 1.0), 4 * RETRY_FIRST);
        assert_eq!(wait_before(u32::MAX, 1.0), RETRY_LONGEST);
    }

    #[test]
    fn a_server_that_refuses_or_misunderstands_is_not_asked_again() {
        for code in [1000, 1002, 1003, 1007, 1008, 1009] {
            assert!(!is_passing(&closed(Some(code), "")), "{code}");
        }
        for code in [Some(1001), Some(1011), Some(1012), Some(1013), None] {
            assert!(is_passing(&closed(code, "")), "{code:?}");
        }
    }
}
