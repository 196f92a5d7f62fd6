//! Where the texels of a proxy lie.

use super::CellFrame;
use glam::DVec3;

/// From above, rays from an anchor that pass over its shell have their places no nearer than this share of the way to where a
/// ray touches the shell.
const LEAST_SHARE: f64 = 0.25;
/// A point that is so far over a shell is not on it, m.
const BEYOND_MIN_M: f64 = 0.1;

/// Where texels lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// On a sphere about the planet.
    Shell {
        /// Its altitude, m.
        altitude_m: f64,
    },
    /// On such a sphere as it is seen from an anchor above it, and where rays from the anchor pass over it, where they come
    /// closest to it (`geometry/surface.wgsl`).
    ShellFromAbove {
        /// Its altitude, m.
        altitude_m: f64,
        /// Beyond its rim no place is nearer than this, m.
        least_m: f64,
    },
    /// On a sphere about their anchor.
    Dome {
        /// Its radius, m.
        radius_m: f64,
    },
}

impl Surface {
    /// A shell at an altitude about an anchor: seen from above where the anchor is higher.
    #[must_use]
    pub fn shell(frame: &CellFrame, anchor: DVec3, altitude_m: f64) -> Self {
        let height_m = frame.altitude_m(anchor) - altitude_m;
        if height_m > 0.0 {
            let from_centre_m = 2.0 * (frame.planet_radius_m() + altitude_m) + height_m;
            Self::ShellFromAbove {
                altitude_m,
                least_m: LEAST_SHARE * (height_m * from_centre_m).sqrt(),
            }
        } else {
            Self::Shell { altitude_m }
        }
    }

    /// Its normal at one of its points.
    #[must_use]
    pub fn normal(&self, frame: &CellFrame, anchor: DVec3, point: DVec3) -> DVec3 {
        match *self {
            Self::ShellFromAbove { altitude_m, .. }
                if frame.altitude_m(point) > altitude_m + BEYOND_MIN_M =>
            {
                let centre = 0.5 * (anchor - DVec3::Y * frame.planet_radius_m());
                (point - centre).normalize_or(DVec3::Y)
            }
            Self::Shell { .. } | Self::ShellFromAbove { .. } => frame.up(point),
            Self::Dome { .. } => (point - anchor).normalize_or_zero(),
        }
    }

    /// How far along a unit direction it is from a point inside it or above it, m.
    #[must_use]
    pub fn distance_m(
        &self,
        frame: &CellFrame,
        anchor: DVec3,
        from: DVec3,
        direction: DVec3,
    ) -> f64 {
        match *self {
            Self::Shell { altitude_m } => frame.distance_to_shell_m(from, direction, altitude_m),
            Self::ShellFromAbove {
                altitude_m,
                least_m,
            } => {
                let near_m = frame.shell_roots_m(from, direction, altitude_m);
                let seen_m = near_m.map(|[near_m, _]| near_m).filter(|near_m| {
                    let point = from + direction * near_m;
                    *near_m > 0.0 && (anchor - point).dot(frame.up(point)) >= 0.0
                });
                seen_m.unwrap_or_else(|| {
                    let from_anchor = from - anchor;
                    let from_centre = from + DVec3::Y * frame.planet_radius_m();
                    let b = 0.5 * (direction.dot(from_anchor) + direction.dot(from_centre));
                    let c = from_anchor.dot(from_centre);
                    ((b * b - c).max(0.0).sqrt() - b).max(least_m)
                })
            }
            Self::Dome { radius_m } => {
                let from = from - anchor;
                let b = direction.dot(from);
                let c = from.length_squared() - radius_m * radius_m;
                (b * b - c).max(0.0).sqrt() - b
            }
        }
    }
}
