//! The wall clock as the wire counts it.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use skycell_protocol::Moment;

/// This moment, by this machine's clock: what every server of a sky reckons sky time from.
pub fn now() -> Moment {
    Moment::from_unix_us(i64::try_from(unix_now_us()).unwrap_or(i64::MAX))
}

/// Microseconds since 1970, by this machine's clock. 0 if that clock stands before 1970.
pub fn unix_now_us() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| {
            u64::try_from(since.as_micros()).unwrap_or(u64::MAX)
        })
}

/// A duration for a 32-bit field of microseconds: the largest number (71 minutes) if it is longer.
pub fn saturating_us(duration: Duration) -> u32 {
    u32::try_from(duration.as_micros()).unwrap_or(u32::MAX)
}
