//! How far the sky has moved under what texels hold.

use std::ops::{Add, AddAssign, Mul, Sub};

/// A way of the sky: how much of it is seen, and what texels that stay behind are expected to be wrong by.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SkyWay {
    /// In steps that are just not seen.
    pub steps: f64,
    /// Expected deviation as audits measure it, percent: steps of different causes are not alike.
    pub percent: f64,
}

impl Add for SkyWay {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            steps: self.steps + other.steps,
            percent: self.percent + other.percent,
        }
    }
}

impl AddAssign for SkyWay {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for SkyWay {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + other * -1.0
    }
}

impl Mul<f64> for SkyWay {
    type Output = Self;

    fn mul(self, share: f64) -> Self {
        Self {
            steps: self.steps * share,
            percent: self.percent * share,
        }
    }
}
