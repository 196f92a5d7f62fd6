//! How wide a cell may be.

use glam::DVec3;

/// Sideways, where the error of a shared reference becomes just noticeable, m (Weinrauch et al. 2023, user study).
const RADIUS_M: f64 = 3_000.0;
/// The same upwards, m.
const RADIUS_UP_M: f64 = 1_100.0;

/// How far viewers may be from the reference of a cell that forms. A step upwards shows another side of a cloud sooner than one
/// sideways, so it counts for more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellLimit {
    radius_m: f64,
    up_weight: f64,
}

impl Default for CellLimit {
    fn default() -> Self {
        Self::new(RADIUS_M, RADIUS_UP_M)
    }
}

impl CellLimit {
    /// Viewers may be this far from the reference sideways, and this far upwards or downwards, m. Distances below 1 m count
    /// as 1 m.
    #[must_use]
    pub fn new(radius_m: f64, radius_up_m: f64) -> Self {
        let radius_m = radius_m.max(1.0);
        Self {
            radius_m,
            up_weight: radius_m / radius_up_m.max(1.0),
        }
    }

    /// What keeps to both limits.
    #[must_use]
    pub fn narrower(self, other: Self) -> Self {
        let radius_up_m = |limit: Self| limit.radius_m / limit.up_weight;
        Self::new(
            self.radius_m.min(other.radius_m),
            radius_up_m(self).min(radius_up_m(other)),
        )
    }

    /// Farthest from the reference sideways, m.
    #[must_use]
    pub fn radius_m(self) -> f64 {
        self.radius_m
    }

    /// How far apart two places are, as the error of a shared reference goes, m sideways.
    #[must_use]
    pub fn distance_m(self, a_m: DVec3, b_m: DVec3) -> f64 {
        let away = a_m - b_m;
        DVec3::new(away.x, away.y * self.up_weight, away.z).length()
    }
}
