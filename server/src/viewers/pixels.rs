//! The pixels of all viewers' frames together, and each viewer's share of them.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use thiserror::Error;

/// The frames of all viewers together have as many pixels as they may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "frames of {wanted} pixels do not fit: those of the other viewers have {taken} together, and {max} are allowed; \
     ask for smaller ones, or try again later"
)]
pub struct TooManyPixels {
    /// What the viewer asked for.
    pub wanted: u64,
    /// What others have.
    pub taken: u64,
    /// What is allowed for all together.
    pub max: u64,
}

/// What all viewers share.
#[derive(Debug)]
pub struct PixelBudget {
    max: u64,
    taken: AtomicU64,
}

impl PixelBudget {
    /// A budget of `max` pixels.
    pub fn new(max: u64) -> Arc<Self> {
        Arc::new(Self {
            max,
            taken: AtomicU64::new(0),
        })
    }

    /// A share of `pixels`, for as long as it lives.
    ///
    /// # Errors
    /// If there are not so many left.
    pub fn share(self: &Arc<Self>, pixels: u64) -> Result<PixelShare, TooManyPixels> {
        let share = PixelShare {
            budget: Arc::clone(self),
            pixels: AtomicU64::new(0),
        };
        share.resize(pixels)?;
        Ok(share)
    }

    /// What is taken now.
    pub fn taken(&self) -> u64 {
        self.taken.load(Ordering::Relaxed)
    }
}

/// One viewer's share.
#[derive(Debug)]
pub struct PixelShare {
    budget: Arc<PixelBudget>,
    pixels: AtomicU64,
}

impl PixelShare {
    /// Makes the share another size. Only its viewer's session does, so it is not resized twice at once.
    ///
    /// # Errors
    /// If there are not so many left; then it stays as it was.
    pub fn resize(&self, pixels: u64) -> Result<(), TooManyPixels> {
        let own = self.pixels.load(Ordering::Relaxed);
        let max = self.budget.max;
        self.budget
            .taken
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |taken| {
                let after = (taken - own).checked_add(pixels)?;
                // A smaller picture is always welcome, also where the whole is above a limit that was lowered.
                (after <= max || pixels <= own).then_some(after)
            })
            .map_err(|taken| TooManyPixels {
                wanted: pixels,
                taken: taken - own,
                max,
            })?;
        self.pixels.store(pixels, Ordering::Relaxed);
        Ok(())
    }
}

impl Drop for PixelShare {
    fn drop(&mut self) {
        let own = self.pixels.load(Ordering::Relaxed);
        self.budget.taken.fetch_sub(own, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_pixels_are_given_than_there_are_and_each_comes_back() {
        let budget = PixelBudget::new(100);
        let first = budget.share(60).expect("room");
        assert_eq!(
            budget.share(41).err(),
            Some(TooManyPixels {
                wanted: 41,
                taken: 60,
                max: 100
            })
        );
        let second = budget.share(40).expect("room");
        assert!(first.resize(61).is_err());
        assert_eq!(budget.taken(), 100, "a refusal changes nothing");
        first.resize(10).expect("smaller");
        second.resize(90).expect("room now");
        drop((first, second));
        assert_eq!(budget.taken(), 0);
    }
}
