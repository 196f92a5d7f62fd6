//! A layer that rays start in. What is near of it each viewer's own rays go through; what is far is kept on a dome about the
//! anchor, whatever other layers are kept on.

use super::Side;
use super::proxies::{FAR_M, Proxy};
use super::{ActiveLayer, CellFrame};
use glam::DVec3;

/// Near is what is no farther from where the rays of the far part start, m. From beside there something at distance d is seen at
/// another angle, by as much as the way over d: so this is large against how wide cells are in a layer.
/// Tuned: `cargo test --release -p skycell-tests --test inside -- --nocapture`.
pub const REACH_M: f64 = 2_000.0;
/// Over so long a way before that the near part has less and less of the layer and the far part more and more, m: where both
/// are not seen from the same place, or not marched alike, there is no ring.
pub const REACH_FADE_M: f64 = 400.0;

/// What a dome keeps of a layer that rays start in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FarPart {
    /// Radius of the dome, m.
    pub radius_m: f64,
    /// It begins here, ...
    pub near_m: f64,
    /// ... from here on has all of the layer, ...
    pub full_near_m: f64,
    /// ... and ends here, m.
    pub far_m: f64,
}

impl FarPart {
    /// Part k of n. Bands of distance are cut evenly in 1/d from the reach to infinity, and the dome of each is at the harmonic mean
    /// of its ends, for the reasons that [`super::Dome::of_band`] gives.
    #[must_use]
    pub fn of(k: u32, n: u32) -> Self {
        let n = n.max(1);
        let share = |i: u32| f64::from(n.saturating_sub(i)) / f64::from(n);
        let end_m = |i: u32| {
            if i >= n { FAR_M } else { REACH_M / share(i) }
        };
        Self {
            radius_m: 2.0 * REACH_M / (share(k) + share(k + 1)).max(f64::EPSILON),
            near_m: if k == 0 {
                REACH_M - REACH_FADE_M
            } else {
                end_m(k)
            },
            full_near_m: end_m(k),
            far_m: end_m(k + 1),
        }
    }
}

impl Proxy {
    /// What it keeps about an anchor that is in its layer; None of others, and where layers are kept on domes anyway.
    #[must_use]
    pub fn far_part(&self, frame: &CellFrame, anchor: DVec3) -> Option<FarPart> {
        let side = Side::of(self.layer_m, frame.altitude_m(anchor));
        (self.dome.is_none() && side == Side::Within).then(|| FarPart::of(self.part, self.parts))
    }
}

/// The layers, among the active ones, of which a cell with such anchors keeps the far part alone: one bit for each.
#[must_use]
pub fn near_layers(
    proxies: &[Proxy],
    active: &[ActiveLayer],
    frame: &CellFrame,
    anchors: &[DVec3],
) -> u32 {
    let layers = (0..).zip(active).zip(anchors);
    layers
        .filter(|((place, _), anchor)| {
            let proxy = proxies.iter().find(|proxy| proxy.layer == *place);
            proxy.is_some_and(|proxy| proxy.far_part(frame, **anchor).is_some())
        })
        .fold(0, |bits, ((place, _), _)| bits | (1 << place))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_far_parts_of_a_layer_meet_and_leave_nothing_out() {
        for parts in 1..=4 {
            let of = |part| FarPart::of(part, parts);
            assert_eq!(of(0).full_near_m, REACH_M);
            assert_eq!(of(parts - 1).far_m, FAR_M);
            for part in 1..parts {
                assert_eq!(of(part).near_m, of(part - 1).far_m);
                assert_eq!(of(part).near_m, of(part).full_near_m);
            }
            for part in (0..parts).map(of) {
                assert!(part.near_m < part.far_m && part.radius_m >= part.full_near_m);
            }
        }
    }
}
