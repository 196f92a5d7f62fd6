//! How wide a cell may be.

use crate::march::{REACH_M, Side};
use glam::DVec3;

/// Sideways, where the error of a shared reference becomes just noticeable, m (Weinrauch et al. 2023, user study).
const RADIUS_M: f64 = 3_000.0;
/// The same upwards, m.
const RADIUS_UP_M: f64 = 1_100.0;

/// In a layer, sideways, m: its far part begins nearer than clouds are from elsewhere.
const IN_LAYER_RADIUS_M: f64 = 0.25 * REACH_M;

/// Bounds of storeys: twice as many as a scene has layers.
const STOREYS_MAX: usize = 8;

/// Storeys of the sky: below, in, between and above layers. Nobody shares what is seen from another storey.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Storeys {
    /// Base and top of each layer, m; an infinite base is no layer.
    layers_m: [[f64; 2]; STOREYS_MAX / 2],
}

impl Default for Storeys {
    fn default() -> Self {
        Self::of(&[])
    }
}

impl Storeys {
    /// Those of layers between altitudes, base and top, m; of four layers at most.
    #[must_use]
    pub fn of(layers_m: &[[f64; 2]]) -> Self {
        let mut storeys = Self {
            layers_m: [[f64::INFINITY; 2]; STOREYS_MAX / 2],
        };
        for (place, layer_m) in storeys.layers_m.iter_mut().zip(layers_m) {
            *place = *layer_m;
        }
        storeys
    }

    /// Whether an altitude is in a layer.
    fn is_in_layer(&self, altitude_m: f64) -> bool {
        let mut layers = self.layers_m.iter();
        layers.any(|between_m| Side::of(*between_m, altitude_m) == Side::Within)
    }

    /// Whether two altitudes are in one storey.
    fn share(&self, a_m: f64, b_m: f64) -> bool {
        self.layers_m
            .iter()
            .all(|between_m| Side::of(*between_m, a_m) == Side::of(*between_m, b_m))
    }
}

/// How far viewers may be from the reference of a cell that forms. A step upwards shows another side of a cloud sooner than one
/// sideways, so it counts for more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellLimit {
    radius_m: f64,
    up_weight: f64,
    storeys: Storeys,
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
            storeys: Storeys::default(),
        }
    }

    /// The same with other storeys.
    #[must_use]
    pub fn with_storeys(self, storeys: Storeys) -> Self {
        Self { storeys, ..self }
    }

    /// Where layers are.
    #[must_use]
    pub fn storeys(self) -> Storeys {
        self.storeys
    }

    /// Whether two places are on the same side of each layer.
    #[must_use]
    pub fn share_storey(self, a_m: DVec3, b_m: DVec3) -> bool {
        self.storeys.share(a_m.y, b_m.y)
    }

    /// What keeps to both limits.
    #[must_use]
    pub fn narrower(self, other: Self) -> Self {
        if self == other {
            return self;
        }
        let radius_up_m = |limit: Self| limit.radius_m / limit.up_weight;
        Self::new(
            self.radius_m.min(other.radius_m),
            radius_up_m(self).min(radius_up_m(other)),
        )
        .with_storeys(self.storeys)
    }

    /// Farthest from the reference sideways, m.
    #[must_use]
    pub fn radius_m(self) -> f64 {
        self.radius_m
    }

    /// How far apart two places are, as the error of a shared reference goes, m sideways: farther in a layer, whose clouds are near,
    /// and infinitely far where they are not on the same side of each layer.
    #[must_use]
    pub fn distance_m(self, a_m: DVec3, b_m: DVec3) -> f64 {
        if !self.share_storey(a_m, b_m) {
            return f64::INFINITY;
        }
        let weight = if self.storeys.is_in_layer(a_m.y) {
            (self.radius_m / IN_LAYER_RADIUS_M).max(1.0)
        } else {
            1.0
        };
        let away = a_m - b_m;
        weight * DVec3::new(away.x, away.y * self.up_weight, away.z).length()
    }
}
