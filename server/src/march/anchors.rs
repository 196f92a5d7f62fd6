//! How far a cell's reference may be from where its texels are addressed from.

use super::Side;

/// Beyond this distance between anchor and reference the cache's texels no longer have even sizes for the viewers.
const ANCHOR_DRIFT_MAX_M: f64 = 4_000.0;
/// The same upwards and downwards, as a share of the height of the proxy sphere above the reference: from an anchor that is
/// farther below, texels over the viewers are twice as wide as high. After a jump from the ground to 5 m under a base of 1.5 km
/// a picture was 2.5 steps of 8 bits off in the mean, with a new anchor 0.1 (320×180).
const ANCHOR_RISE_MAX: f64 = 0.5;
/// Heights above the reference count as this at least, m.
const SPHERE_HEIGHT_MIN_M: f64 = 100.0;

/// The same about a dome that keeps the far part of a layer, m. Tuned: after a climb by 595 m about one anchor, tiles that were
/// carried over showed clouds where they had been (`--test camera_anywhere`: FLIP .057 instead of .025); with 250 m new anchors
/// in the midst of a climb are a step of .045 when it ends (`frame_loop::sides`).
const ANCHOR_IN_LAYER_MAX_M: f64 = 500.0;

/// How far aside of a reference at an altitude the anchor of a layer may be, and how far above or below it, m. The layer is between
/// two altitudes, its proxy sphere at `proxy_m`.
#[must_use]
pub fn anchor_off_max_m(
    between_m: [f64; 2],
    proxy_m: f64,
    altitude_m: f64,
    keeps_far_parts: bool,
) -> [f64; 2] {
    let rise_max_m = |height_m: f64| ANCHOR_RISE_MAX * height_m.max(SPHERE_HEIGHT_MIN_M);
    match Side::of(between_m, altitude_m) {
        Side::Below => [ANCHOR_DRIFT_MAX_M, rise_max_m(proxy_m - altitude_m)],
        Side::Within if keeps_far_parts => [ANCHOR_IN_LAYER_MAX_M; 2],
        Side::Within => [ANCHOR_DRIFT_MAX_M, ANCHOR_IN_LAYER_MAX_M],
        // Rays from above that graze the layer meet the surface about an anchor that is no lower than half way to the top.
        Side::Above => [ANCHOR_DRIFT_MAX_M, rise_max_m(altitude_m - between_m[1])],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_anchor_may_be_half_the_height_off_and_a_short_way_in_a_layer() {
        let off_max_m =
            |altitude_m, keeps| anchor_off_max_m([1_500.0, 4_000.0], 2_400.0, altitude_m, keeps);
        assert_eq!(off_max_m(0.0, true), [4_000.0, 1_200.0]);
        assert_eq!(off_max_m(1_450.0, true), [4_000.0, 475.0]);
        assert_eq!(off_max_m(2_400.0, true), [500.0, 500.0]);
        assert_eq!(off_max_m(2_400.0, false), [4_000.0, 500.0]);
        assert_eq!(off_max_m(4_050.0, true), [4_000.0, 50.0]);
        assert_eq!(off_max_m(12_000.0, true), [4_000.0, 4_000.0]);
    }
}
