//! On which side of a layer a place is: a cache of a layer holds for those on the side of its reference.

use super::ActiveLayer;
use skycell_protocol::Scene;

/// Where a place is as seen from a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Below its base.
    Below,
    /// Between base and top, or on one of them.
    Within,
    /// Above its top.
    Above,
}

impl Side {
    /// The side of a layer between two altitudes on which an altitude is, m.
    #[must_use]
    pub fn of([base_m, top_m]: [f64; 2], altitude_m: f64) -> Self {
        if altitude_m < base_m {
            Self::Below
        } else if altitude_m > top_m {
            Self::Above
        } else {
            Self::Within
        }
    }
}

/// Base and top of each active layer, m.
#[must_use]
pub fn layer_bounds_m(scene: &Scene, active: &[ActiveLayer]) -> Vec<[f64; 2]> {
    let layers = active
        .iter()
        .map(|layer| &scene.layers()[layer.scene_index]);
    layers
        .map(|layer| [layer.base_altitude_m(), layer.top_altitude_m()])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base_and_top_belong_to_the_layer() {
        let between_m = [1_500.0, 4_000.0];
        for (altitude_m, side) in [
            (1_499.999, Side::Below),
            (1_500.0, Side::Within),
            (4_000.0, Side::Within),
            (4_000.001, Side::Above),
        ] {
            assert_eq!(Side::of(between_m, altitude_m), side);
        }
    }
}
