//! The temporal window of the screen-space renderer: where a slice shows a point, and how much its samples weigh.

use glam::{DMat3, DVec3};

/// Where a pinhole camera shows a point, in pixels from the picture's upper left corner; `None` when the point is not in
/// front of it. `right` and `up` are half the picture's width and height at distance 1, `point` is seen from the eye.
///
/// The point lies on the ray through (x, y) of the picture's plane: t (f + x r + y u) = p, three equations for t, t x, t y.
#[must_use]
pub fn picture_place(
    forward: DVec3,
    right: DVec3,
    up: DVec3,
    size: [f64; 2],
    point: DVec3,
) -> Option<[f64; 2]> {
    let solved = DMat3::from_cols(forward, right, up).inverse() * point;
    let depth = solved.x;
    (depth > 0.0).then(|| {
        let (x, y) = (solved.y / depth, solved.z / depth);
        [0.5 * (1.0 + x) * size[0], 0.5 * (1.0 - y) * size[1]]
    })
}

/// Weight of a sample `offset` picture pixels away: Gaussian of width σ.
#[must_use]
pub fn sample_weight(offset: [f64; 2], sigma: f64) -> f64 {
    let [x, y] = offset;
    (-(x * x + y * y) / (2.0 * sigma * sigma)).exp()
}

/// How much parallax takes from what an eye elsewhere saw: 1/(1 + (50 β)²), where β is the angle under which the movement
/// is seen from the cloud.
#[must_use]
pub fn parallax_weight(moved_m: f64, distance_m: f64) -> f64 {
    let angle = moved_m / distance_m;
    1.0 / (1.0 + (50.0 * angle).powi(2))
}
