//! When to try again after a connection was lost.

use std::time::Duration;

const FIRST: Duration = Duration::from_millis(500);
const LONGEST: Duration = Duration::from_secs(15);

/// How long to wait before each try: doubles up to 15 s, the upper half is random, so that a crowd does not return as one.
/// The page in `client/web` waits alike.
#[derive(Clone, Copy, Debug, Default)]
pub struct RetryDelays {
    failures: u32,
}

impl RetryDelays {
    /// How long to wait after another failure. `random`: 0 to 1.
    pub fn after_failure(&mut self, random: f64) -> Duration {
        // Beyond, it is the longest anyway.
        let doubled = 1 << self.failures.min(16);
        self.failures = self.failures.saturating_add(1);
        let longest = FIRST.saturating_mul(doubled).min(LONGEST);
        longest.mul_f64(0.5 + 0.5 * random.clamp(0.0, 1.0))
    }

    /// A session that held: the next failure is the first again.
    pub fn held(&mut self) {
        self.failures = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_stay_within_15_s_and_keep_their_upper_half_random() {
        let mut least = RetryDelays::default();
        let mut most = RetryDelays::default();
        let waits: Vec<(u128, u128)> = (0..7)
            .map(|_| {
                let (least, most) = (least.after_failure(0.0), most.after_failure(1.0));
                (least.as_millis(), most.as_millis())
            })
            .collect();
        assert_eq!(waits[..3], [(250, 500), (500, 1_000), (1_000, 2_000)]);
        assert_eq!(waits[6], (7_500, 15_000));
        most.held();
        assert_eq!(most.after_failure(1.0), FIRST);
        let mut endless = RetryDelays { failures: u32::MAX };
        assert_eq!(endless.after_failure(f64::NAN.max(1.0)), LONGEST);
    }
}
