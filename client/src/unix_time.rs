//! This machine's clock, as the protocol writes it.

use std::time::{SystemTime, UNIX_EPOCH};

/// µs since 1970. A clock set before 1970 reads 0.
pub fn unix_us_now() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| {
            u64::try_from(since.as_micros()).unwrap_or(u64::MAX)
        })
}
