//! Altitudes, shells, and where rays meet them.

use crate::Ray;
use glam::DVec3;

/// How far a ray is followed in a flat world, m, where a horizontal one would never leave its layer.
pub const FLAT_REACH_M: f64 = 2.0e6;

/// What lies below: a ground sphere around (0, −R, 0), or nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Globe {
    /// A sphere with ground.
    Sphere {
        /// Its radius, m.
        radius_m: f64,
    },
    /// Altitude is y, and there is no ground.
    Flat,
}

/// A part of a ray, m; empty where it does not end behind its start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Interval {
    /// Where it begins.
    pub start_m: f64,
    /// Where it ends.
    pub end_m: f64,
}

impl Interval {
    /// Nothing.
    pub const EMPTY: Self = Self {
        start_m: 0.0,
        end_m: 0.0,
    };

    /// From a start to an end.
    #[must_use]
    pub const fn new(start_m: f64, end_m: f64) -> Self {
        Self { start_m, end_m }
    }

    /// Whether it holds nothing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.end_m <= self.start_m
    }

    /// Its length, m; 0 where it is empty.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        if self.is_empty() {
            0.0
        } else {
            self.end_m - self.start_m
        }
    }

    /// What both have.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            start_m: self.start_m.max(other.start_m),
            end_m: self.end_m.min(other.end_m),
        }
    }
}

impl Globe {
    /// Altitude of a point above the ground, m.
    ///
    /// On a sphere h = |p + R ŷ| − R = (|p|² + 2 R p_y) / (|p + R ŷ| + R), which does not cancel.
    #[must_use]
    pub fn altitude_m(&self, position_m: DVec3) -> f64 {
        match *self {
            Self::Flat => position_m.y,
            Self::Sphere { radius_m: r } => {
                let from_centre = position_m + DVec3::Y * r;
                (position_m.length_squared() + 2.0 * r * position_m.y) / (from_centre.length() + r)
            }
        }
    }

    /// Unit vector straight up at a place.
    #[must_use]
    pub fn up(&self, position_m: DVec3) -> DVec3 {
        match self {
            Self::Flat => DVec3::Y,
            Self::Sphere { radius_m } => (position_m + DVec3::Y * *radius_m).normalize(),
        }
    }

    /// How fast altitude grows along a ray at a distance, m per m.
    #[must_use]
    pub fn climb(&self, ray: &Ray, distance_m: f64) -> f64 {
        match *self {
            Self::Flat => ray.direction.y,
            Self::Sphere { radius_m } => {
                let up = (ray.at(distance_m) + DVec3::Y * radius_m).normalize_or(DVec3::Y);
                ray.direction.dot(up)
            }
        }
    }

    /// Where the line of a ray is at most at an altitude: distances near ≤ far, also behind the origin, infinite where the
    /// line never leaves. `None` where it is always higher.
    ///
    /// On a sphere the roots of t² + 2 b t + c = 0 with b = d·(p + R ŷ) and c = (h − H)(h + H + 2R), found as q and c/q
    /// with q = −(b + sign(b) √(b² − c)) (Press et al., Numerical Recipes, 5.6): squares of radii are never subtracted.
    #[must_use]
    pub fn at_most(&self, altitude_m: f64, ray: &Ray) -> Option<Interval> {
        match *self {
            Self::Flat => {
                let below = altitude_m - ray.origin_m.y;
                let climb = ray.direction.y;
                if climb == 0.0 {
                    let all = Interval::new(f64::NEG_INFINITY, f64::INFINITY);
                    return (below >= 0.0).then_some(all);
                }
                let at = below / climb;
                Some(if climb > 0.0 {
                    Interval::new(f64::NEG_INFINITY, at)
                } else {
                    Interval::new(at, f64::INFINITY)
                })
            }
            Self::Sphere { radius_m: r } => {
                if altitude_m < -r {
                    return None;
                }
                let h = self.altitude_m(ray.origin_m);
                let b = ray.direction.dot(ray.origin_m) + r * ray.direction.y;
                let c = (h - altitude_m) * (h + altitude_m + 2.0 * r);
                let discriminant = b * b - c;
                if discriminant < 0.0 {
                    return None;
                }
                let root = discriminant.sqrt();
                let q = if b < 0.0 { root - b } else { -(b + root) };
                let other = if q == 0.0 { 0.0 } else { c / q };
                Some(Interval::new(q.min(other), q.max(other)))
            }
        }
    }

    /// Where a ray meets the ground, m, if it does: its line comes down and reaches altitude 0.
    #[must_use]
    pub fn ground_m(&self, ray: &Ray) -> Option<f64> {
        let Self::Sphere { radius_m: r } = *self else {
            return None;
        };
        let b = ray.direction.dot(ray.origin_m) + r * ray.direction.y;
        if b >= 0.0 {
            return None;
        }
        self.at_most(0.0, ray).map(|line| line.start_m.max(0.0))
    }

    /// Distance of the lowest point of a ray's line, m; infinite in a flat world unless it is level.
    #[must_use]
    pub fn lowest_m(&self, ray: &Ray) -> f64 {
        match *self {
            Self::Flat if ray.direction.y > 0.0 => f64::NEG_INFINITY,
            Self::Flat if ray.direction.y < 0.0 => f64::INFINITY,
            Self::Flat => 0.0,
            Self::Sphere { radius_m: r } => {
                -(ray.direction.dot(ray.origin_m) + r * ray.direction.y)
            }
        }
    }

    /// The lowest and highest altitude of a part of a ray, m. Altitude is convex along a ray, so the highest is at an end
    /// and the lowest at an end or where the line comes closest to the planet's centre.
    #[must_use]
    pub fn altitude_range_m(&self, ray: &Ray, part: Interval) -> [f64; 2] {
        let start = self.altitude_m(ray.at(part.start_m));
        let end = self.altitude_m(ray.at(part.end_m));
        let lowest_m = self.lowest_m(ray);
        let mut low = start.min(end);
        if lowest_m > part.start_m && lowest_m < part.end_m {
            low = low.min(self.altitude_m(ray.at(lowest_m)));
        }
        [low, start.max(end)]
    }

    /// The parts of a ray between two altitudes, in front of its origin and of the ground: at most two, the first one
    /// nearest. What is empty comes last.
    #[must_use]
    pub fn layer_intervals(&self, base_m: f64, top_m: f64, ray: &Ray) -> [Interval; 2] {
        let Some(under_top) = self.at_most(top_m, ray) else {
            return [Interval::EMPTY; 2];
        };
        let reach_m = match self {
            Self::Flat => FLAT_REACH_M,
            Self::Sphere { .. } => f64::INFINITY,
        };
        let ahead = Interval::new(0.0, self.ground_m(ray).unwrap_or(reach_m));
        let outer = under_top.and(ahead);
        if outer.is_empty() {
            return [Interval::EMPTY; 2];
        }
        let Some(under_base) = self.at_most(base_m, ray) else {
            return [outer, Interval::EMPTY];
        };
        let first = Interval::new(outer.start_m, outer.end_m.min(under_base.start_m));
        let second = Interval::new(outer.start_m.max(under_base.end_m), outer.end_m);
        match (first.is_empty(), second.is_empty()) {
            (false, false) => [first, second],
            (false, true) => [first, Interval::EMPTY],
            (true, false) => [second, Interval::EMPTY],
            (true, true) => [Interval::EMPTY; 2],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EARTH: Globe = Globe::Sphere {
        radius_m: 6_360_000.0,
    };

    fn ray(origin: [f64; 3], direction: [f64; 3]) -> Ray {
        Ray::new(origin.into(), direction.into()).expect("a ray")
    }

    #[test]
    fn altitude_keeps_its_digits_near_the_ground_and_far_away() {
        for h in [-1e-3, 0.0, 1e-6, 1.0, 1500.0, 4.0e5] {
            let altitude = EARTH.altitude_m(DVec3::new(0.0, h, 0.0));
            assert!((altitude - h).abs() <= 1e-15 * h.abs().max(1e-9), "{h}");
        }
        // Sagitta: at a horizontal distance s on the plane y = 0, h = √(R² + s²) − R.
        let s: f64 = 50_000.0;
        let exact = s * s / ((6_360_000.0f64.powi(2) + s * s).sqrt() + 6_360_000.0);
        assert!((EARTH.altitude_m(DVec3::new(s, 0.0, 0.0)) - exact).abs() < 1e-9);
    }

    #[test]
    fn ends_of_intervals_lie_on_their_shells() {
        let cases = [
            ray([0.0, 2.0, 0.0], [1.0, 0.0, 0.0]),
            ray([0.0, 2.0, 0.0], [1.0, 0.5, 0.3]),
            ray([10.0, 5_000.0, 3.0], [1.0, -0.02, 0.0]),
            ray([0.0, 5_000.0, 0.0], [0.0, -1.0, 0.0]),
            ray([0.0, 2_000.0, 0.0], [0.3, -0.001, 0.8]),
        ];
        for ray in cases {
            let parts = EARTH.layer_intervals(1_500.0, 4_000.0, &ray);
            assert!(!parts[0].is_empty());
            for part in parts.iter().filter(|part| !part.is_empty()) {
                for at in [part.start_m, part.end_m] {
                    let h = EARTH.altitude_m(ray.at(at));
                    let on_shell = (h - 1_500.0).abs() < 1e-6 || (h - 4_000.0).abs() < 1e-6;
                    assert!(on_shell || at == 0.0, "{ray:?} {at} {h}");
                }
                let middle = EARTH.altitude_m(ray.at(0.5 * (part.start_m + part.end_m)));
                assert!((1_500.0..=4_000.0).contains(&middle));
            }
        }
    }

    #[test]
    fn a_ray_that_dips_under_a_layer_meets_it_twice_and_the_ground_once() {
        // From 5 km, tangent 1 km above the ground.
        let mu = -((1.0f64 - ((6_361_000.0f64) / 6_365_000.0).powi(2)).sqrt());
        let down = ray([0.0, 5_000.0, 0.0], [(1.0 - mu * mu).sqrt(), mu, 0.0]);
        let parts = EARTH.layer_intervals(1_500.0, 4_000.0, &down);
        assert!(parts.iter().all(|part| !part.is_empty()));
        assert!((parts[0].length_m() - parts[1].length_m()).abs() < 1e-3);
        assert_eq!(EARTH.ground_m(&down), None);
        let steep = ray([0.0, 5_000.0, 0.0], [0.1, -1.0, 0.0]);
        let ground_m = EARTH.ground_m(&steep).expect("ground");
        assert!(EARTH.altitude_m(steep.at(ground_m)).abs() < 1e-6);
        assert!(EARTH.layer_intervals(1_500.0, 4_000.0, &steep)[1].is_empty());
    }

    #[test]
    fn flat_layers_are_cut_by_planes() {
        let slant = ray([0.0, 0.0, 0.0], [0.6, 0.8, 0.0]);
        let [part, none] = Globe::Flat.layer_intervals(800.0, 1_600.0, &slant);
        assert!((part.start_m - 1_000.0).abs() < 1e-9 && (part.end_m - 2_000.0).abs() < 1e-9);
        assert!(none.is_empty());
        let level = ray([0.0, 1_000.0, 0.0], [1.0, 0.0, 0.0]);
        let [part, _] = Globe::Flat.layer_intervals(800.0, 1_600.0, &level);
        assert_eq!(part, Interval::new(0.0, FLAT_REACH_M));
    }

    #[test]
    fn altitude_ranges_hold_every_altitude_of_their_part() {
        let grazing = ray([0.0, 2_000.0, 0.0], [1.0, -0.01, 0.0]);
        let part = Interval::new(0.0, 200_000.0);
        let [low, high] = EARTH.altitude_range_m(&grazing, part);
        for i in 0..=10_000 {
            let h = EARTH.altitude_m(grazing.at(f64::from(i) * 20.0));
            assert!(h >= low - 1e-9 && h <= high + 1e-9);
        }
    }
}
