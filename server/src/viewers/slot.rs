//! A place for one thing, where a newer one replaces an older one that nobody has taken.

use std::sync::{Mutex, PoisonError};

use tokio::sync::Notify;

/// Holds the latest value until it is taken. Never more than one, so never a queue.
#[derive(Debug)]
pub struct LatestSlot<T> {
    value: Mutex<Option<T>>,
    filled: Notify,
}

impl<T> Default for LatestSlot<T> {
    fn default() -> Self {
        Self {
            value: Mutex::new(None),
            filled: Notify::new(),
        }
    }
}

impl<T> LatestSlot<T> {
    /// Puts a value and returns the one that it replaces.
    pub fn put(&self, value: T) -> Option<T> {
        // Replacing an Option cannot be cut short, so a poisoned lock holds a whole value.
        let replaced = self
            .value
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .replace(value);
        self.filled.notify_one();
        replaced
    }

    /// Takes the value, if there is one.
    pub fn take(&self) -> Option<T> {
        self.value
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
    }

    /// Whether a value waits.
    pub fn is_full(&self) -> bool {
        let value = self.value.lock();
        value.unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Waits for a value and takes it. For one taker at a time; to stop waiting loses nothing.
    pub async fn next(&self) -> T {
        loop {
            if let Some(value) = self.take() {
                return value;
            }
            self.filled.notified().await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::time::Duration;

    use super::*;

    #[tokio::test]
    async fn only_the_latest_value_is_taken() {
        let slot = LatestSlot::default();
        assert_eq!(slot.put(1), None);
        assert_eq!(slot.put(2), Some(1));
        assert_eq!(slot.next().await, 2);
        assert_eq!(slot.take(), None);
    }

    #[tokio::test]
    async fn a_taker_that_waits_is_woken() {
        let slot = Arc::new(LatestSlot::default());
        let taker = tokio::spawn({
            let slot = Arc::clone(&slot);
            async move { slot.next().await }
        });
        tokio::task::yield_now().await;
        slot.put("frame");
        let taken = tokio::time::timeout(Duration::from_secs(5), taker).await;
        assert_eq!(taken.expect("in time").expect("no panic"), "frame");
    }
}
