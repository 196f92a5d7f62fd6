//! Which quality JPEGs get so that they are no longer than the rate allows.

/// Qualities of JPEGs as shares of the wished one. Tuned: a step makes a picture of the sky a fifth to a third shorter
/// (`cargo test -p skycell-tests --test pacing -- --nocapture` prints sizes).
const LADDER: [f64; 8] = [1.0, 0.85, 0.7, 0.55, 0.42, 0.32, 0.24, 0.18];
/// The lowest quality, unless less is wished.
const QUALITY_LEAST: u8 = 12;
/// A step down makes a picture shorter by this at least.
const STEP_LEAST_BYTES: f64 = 1.25;
/// A step up makes a picture so many times as long at most.
const STEP_BYTES: f64 = 1.5;
/// Pictures must have been short enough for this long before a step up.
const STEP_UP_AFTER_US: u64 = 1_000_000;
/// The longest that this becomes after steps up that had to be taken back.
const STEP_UP_AFTER_MAX_US: u64 = 16_000_000;

/// Which quality JPEGs get so that they are no longer than the rate allows.
#[derive(Clone, Debug)]
pub struct JpegLadder {
    step: usize,
    short_since_us: Option<u64>,
    stepped_up_us: Option<u64>,
    step_up_after_us: u64,
}

impl Default for JpegLadder {
    fn default() -> Self {
        Self {
            step: 0,
            short_since_us: None,
            stepped_up_us: None,
            step_up_after_us: STEP_UP_AFTER_US,
        }
    }
}

impl JpegLadder {
    /// The quality of the next picture.
    pub fn quality(&self, wished: u8) -> u8 {
        let share = LADDER.get(self.step).copied().unwrap_or(1.0);
        let quality = (f64::from(wished) * share).round() as u8;
        quality.max(QUALITY_LEAST.min(wished))
    }

    /// The last picture has become so long; `turn_bytes` are what may be sent in a frame's turn, none for any number.
    pub fn encoded(&mut self, bytes: usize, turn_bytes: Option<f64>, now_us: u64) {
        let Some(turn_bytes) = turn_bytes else {
            self.step = 0;
            return;
        };
        let bytes = bytes as f64;
        if bytes > turn_bytes {
            self.short_since_us = None;
            // What was tried was too much: back to what it was, and wait longer before the next attempt.
            if let Some(stepped_us) = self.stepped_up_us.take()
                && now_us.saturating_sub(stepped_us) < 2 * STEP_UP_AFTER_US
            {
                self.step = (self.step + 1).min(LADDER.len() - 1);
                self.step_up_after_us = (2 * self.step_up_after_us).min(STEP_UP_AFTER_MAX_US);
                return;
            }
            self.step_up_after_us = STEP_UP_AFTER_US;
            // As many steps as it lacks, at once: what is too long now makes all that follows old.
            let lacks = (bytes / turn_bytes.max(1.0)).ln() / STEP_LEAST_BYTES.ln();
            let steps = (lacks.ceil() as usize).max(1);
            self.step = (self.step + steps).min(LADDER.len() - 1);
            return;
        }
        if self.step == 0 || bytes * STEP_BYTES > turn_bytes {
            self.short_since_us = None;
            return;
        }
        let since_us = *self.short_since_us.get_or_insert(now_us);
        if now_us.saturating_sub(since_us) >= self.step_up_after_us {
            self.short_since_us = None;
            self.stepped_up_us = Some(now_us);
            self.step -= 1;
        }
    }
}
