//! Camera and view changes go to the renderer at most so often; of those in between, the last.
//!
//! Without this, a client that sends cameras as fast as the network takes them would fill the
//! renderer's channel.

use std::time::Duration;

use skycell_protocol::message::CameraInput;
use tokio::time::Instant;

/// At 8 ms, a camera is never staler than one frame at 120 a second.
const INTERVAL: Duration = Duration::from_millis(8);

/// What is to be sent now.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Due {
    /// The last camera, if there is a new one, and when it came.
    pub(super) camera: Option<(CameraInput, Instant)>,
    /// The wishes have changed.
    pub(super) view: bool,
}

/// Holds back what comes too soon.
#[derive(Debug)]
pub(super) struct InputPace {
    waiting: Due,
    next: Instant,
}

impl InputPace {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            waiting: Due::default(),
            next: now,
        }
    }

    /// A camera has come.
    pub(super) fn camera(&mut self, input: CameraInput, now: Instant) {
        self.waiting.camera = Some((input, now));
    }

    /// The wishes have changed.
    pub(super) fn view(&mut self) {
        self.waiting.view = true;
    }

    /// When something is to be sent next; never, if nothing waits.
    pub(super) fn due_at(&self) -> Option<Instant> {
        (self.waiting.view || self.waiting.camera.is_some()).then_some(self.next)
    }

    /// What is to be sent now, if its time has come.
    pub(super) fn take_due(&mut self, now: Instant) -> Due {
        match self.due_at() {
            Some(due) if due <= now => {
                self.next = now + INTERVAL;
                std::mem::take(&mut self.waiting)
            }
            _ => Due::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use skycell_protocol::{Camera, InputSequence};

    use super::*;

    fn input(number: u64) -> CameraInput {
        CameraInput {
            input: InputSequence(number),
            camera: Camera::default(),
        }
    }

    #[test]
    fn a_single_input_is_due_at_once_and_of_a_flood_the_last_of_each_interval() {
        let start = Instant::now();
        let mut pace = InputPace::new(start);
        assert_eq!(pace.due_at(), None);
        let mut sent = Vec::new();
        for number in 0..1000 {
            let now = start + Duration::from_millis(number);
            pace.camera(input(number), now);
            sent.extend(pace.take_due(now).camera);
        }
        assert_eq!(sent.first(), Some(&(input(0), start)));
        assert!((120..=126).contains(&sent.len()), "{}", sent.len());
        let later = start + Duration::from_secs(1) + INTERVAL;
        let came = start + Duration::from_millis(999);
        assert_eq!(pace.take_due(later).camera, Some((input(999), came)));
        assert_eq!(pace.due_at(), None);
    }
}
