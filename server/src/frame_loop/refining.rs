//! How the video of a view that rests comes to its exact picture: a codec spends what its rate leaves on the same picture a
//! few times, then one picture is sent by itself, then nothing.

use super::interface::Refinement;
use std::time::{Duration, Instant};

/// A view rests when it has shown nothing new for this long.
const REST: Duration = Duration::from_millis(300);
/// Pictures that a codec makes finer before the last one. Tuned: moving grain of 640 x 360 pixels at 6 Mbit/s has gained what it
/// can after four (from 1.49 to 0.76 of 255); at 2 Mbit/s it goes on for eleven, which nobody waits for.
const FINER_FRAMES: u32 = 4;

/// How far a viewer's picture has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Refining {
    made: u32,
}

impl Refining {
    /// Which picture is due next and when, after the viewer's newest one; none when nothing finer comes.
    pub(super) fn next(
        &self,
        newest: Instant,
        interval: Duration,
    ) -> Option<(Instant, Refinement)> {
        let refinement = match self.made {
            0..FINER_FRAMES => Refinement::Finer,
            FINER_FRAMES => Refinement::Last,
            _ => return None,
        };
        let wait = if self.made == 0 { REST } else { interval };
        Some((newest + wait, refinement))
    }

    /// A picture was made; one of something new begins anew.
    pub(super) fn made(&mut self, refinement: Refinement) {
        self.made = match refinement {
            Refinement::None => 0,
            Refinement::Finer => self.made + 1,
            Refinement::Last => FINER_FRAMES + 1,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_that_rests_gets_finer_a_few_times_then_its_last_picture_then_nothing() {
        let (start, interval) = (Instant::now(), Duration::from_millis(200));
        let mut refining = Refining::default();
        let mut newest = start;
        let mut seen = Vec::new();
        while let Some((due, refinement)) = refining.next(newest, interval) {
            assert!(seen.len() < 100, "never ends");
            seen.push((due.duration_since(start).as_millis(), refinement));
            refining.made(refinement);
            newest = due;
        }
        let finer = Refinement::Finer;
        let expected = [
            (300, finer),
            (500, finer),
            (700, finer),
            (900, finer),
            (1100, Refinement::Last),
        ];
        assert_eq!(seen, expected);
        refining.made(Refinement::None);
        assert_eq!(
            refining.next(newest, interval),
            Some((newest + REST, finer)),
            "something new was shown"
        );
    }
}
