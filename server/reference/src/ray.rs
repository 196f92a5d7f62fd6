//! Rays.

use crate::ReferenceError;
use crate::error::checked;
use glam::DVec3;
use serde::Serialize;

/// A ray in the local frame, m.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Ray {
    /// Where it begins, m.
    pub origin_m: DVec3,
    /// Where it goes; of length 1.
    pub direction: DVec3,
}

impl Ray {
    /// A ray from a point along a direction of any length.
    ///
    /// # Errors
    /// Names the number that is not finite, or a direction without length.
    pub fn new(origin_m: DVec3, direction: DVec3) -> Result<Self, ReferenceError> {
        for value in origin_m.to_array() {
            checked("a ray's origin", value, -1.0e12..=1.0e12, "-1e12 to 1e12 m")?;
        }
        let length = direction.length();
        checked(
            "the length of a ray's direction",
            length,
            1.0e-150..=1.0e150,
            "1e-150 to 1e150",
        )?;
        Ok(Self {
            origin_m,
            direction: direction / length,
        })
    }

    /// The point at a distance, m.
    #[must_use]
    pub fn at(&self, distance_m: f64) -> DVec3 {
        self.origin_m + self.direction * distance_m
    }
}
