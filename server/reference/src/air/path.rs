//! Straight paths through the air, by distance and by altitude.

use super::{Densities, Medium};

/// A place along a path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Altitude, m.
    pub(super) altitude_m: f64,
    radius_m: f64,
    distance_m: f64,
    origin_radius_m: f64,
}

impl Place {
    /// Distance from the origin, m.
    pub(super) fn distance_m(&self) -> f64 {
        self.distance_m
    }

    /// Cosine of the sun's zenith angle there, from that at the origin and the cosine of the angle between path and sun.
    pub(super) fn mu_sun(&self, mu_sun: f64, nu: f64) -> f64 {
        ((self.origin_radius_m * mu_sun + self.distance_m * nu) / self.radius_m).clamp(-1.0, 1.0)
    }
}

/// One interval of a path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    pub(super) middle: Place,
    /// Densities in the middle.
    pub(super) densities: Densities,
    pub(super) columns_to_middle: Densities,
    pub(super) columns_to_end: Densities,
    pub(super) length_m: f64,
    /// Distance of its end from the origin.
    pub(super) end_m: f64,
}

/// The part of a ray that has air, from a place at an altitude.
#[derive(Clone, Copy, Debug)]
pub(super) struct Path {
    radius_m: f64,
    origin_altitude_m: f64,
    mu: f64,
    start_m: f64,
    end_m: f64,
}

impl Path {
    /// From an altitude in a direction, through the air until it ends or as far as the ground; none where there is no air.
    pub(super) fn new(medium: &Medium, altitude_m: f64, mu: f64, on_ground: bool) -> Option<Self> {
        let r = medium.radius_m;
        let b = (r + altitude_m) * mu;
        let roots = |shell_m: f64| {
            let c = (altitude_m - shell_m) * (altitude_m + shell_m + 2.0 * r);
            let discriminant = b * b - c;
            (discriminant >= 0.0).then(|| {
                let root = discriminant.sqrt();
                let q = if b < 0.0 { root - b } else { -(b + root) };
                let other = if q == 0.0 { 0.0 } else { c / q };
                (q.min(other), q.max(other))
            })
        };
        let (near, far) = roots(medium.top_m)?;
        let start_m = near.max(0.0);
        let end_m = if on_ground {
            // A direction that only just misses ends where it comes closest.
            roots(0.0).map_or(-b, |(near, _)| near).max(0.0)
        } else {
            far
        };
        (end_m > start_m || on_ground).then_some(Self {
            radius_m: r,
            origin_altitude_m: altitude_m,
            mu,
            start_m,
            end_m: end_m.max(start_m),
        })
    }

    /// Where it begins, m from the origin.
    pub(super) fn start_m(&self) -> f64 {
        self.start_m
    }

    fn place(&self, distance_m: f64) -> Place {
        let origin_radius_m = self.radius_m + self.origin_altitude_m;
        let (r, h, t) = (self.radius_m, self.origin_altitude_m, distance_m);
        // (r + a)² = (r + h)² + t² + 2 (r + h) t µ, solved for a without cancellation.
        let excess = h * (h + 2.0 * r) + t * (t + 2.0 * (r + h) * self.mu);
        let radius_m = (r * r + excess).max(0.0).sqrt();
        Place {
            altitude_m: excess / (radius_m + r),
            radius_m,
            distance_m,
            origin_radius_m,
        }
    }

    /// Its last place.
    pub(super) fn end(&self) -> Place {
        self.place(self.end_m)
    }

    /// Calls for every interval and returns the columns of the whole path. On either side of the lowest place distances
    /// grow with the square, so that intervals are short where air is dense.
    pub(super) fn walk(
        &self,
        medium: &Medium,
        intervals: usize,
        mut at: impl FnMut(Part),
    ) -> Densities {
        let lowest_m =
            (-(self.radius_m + self.origin_altitude_m) * self.mu).clamp(self.start_m, self.end_m);
        let mut columns = Densities::default();
        let n = intervals as f64;
        for falling in [true, false] {
            let length_m = if falling {
                lowest_m - self.start_m
            } else {
                self.end_m - lowest_m
            };
            if length_m <= 0.0 {
                continue;
            }
            let distance_m = |i: f64| {
                if falling {
                    let x = 1.0 - i / n;
                    lowest_m - length_m * x * x
                } else {
                    let x = i / n;
                    lowest_m + length_m * x * x
                }
            };
            for i in 0..intervals {
                let i = i as f64;
                let (near, middle, far) = (distance_m(i), distance_m(i + 0.5), distance_m(i + 1.0));
                let place = self.place(middle);
                let densities = medium.densities(place.altitude_m);
                // Simpson's rule for the columns of the half up to the middle and of the whole.
                let quarter = 0.5 * (near + middle);
                let mean = |a: f64, b: f64, c: f64| {
                    let of = |t: f64| medium.densities(self.place(t).altitude_m);
                    Densities::default()
                        .plus(of(a), 1.0 / 6.0)
                        .plus(of(b), 4.0 / 6.0)
                        .plus(of(c), 1.0 / 6.0)
                };
                let half = mean(near, quarter, middle);
                let other = mean(middle, 0.5 * (middle + far), far);
                let columns_to_middle = columns.plus(half, middle - near);
                columns = columns_to_middle.plus(other, far - middle);
                at(Part {
                    middle: place,
                    densities,
                    columns_to_middle,
                    columns_to_end: columns,
                    length_m: far - near,
                    end_m: far,
                });
            }
        }
        columns
    }

    /// The columns of the whole path alone.
    pub(super) fn columns(&self, medium: &Medium, intervals: usize) -> Densities {
        let lowest_m =
            (-(self.radius_m + self.origin_altitude_m) * self.mu).clamp(self.start_m, self.end_m);
        let mut columns = Densities::default();
        for (from_m, length_m) in [
            (lowest_m, self.start_m - lowest_m),
            (lowest_m, self.end_m - lowest_m),
        ] {
            if length_m == 0.0 {
                continue;
            }
            let n = intervals as f64;
            // Two points of Gauss and Legendre an interval, in x of t = x².
            for i in 0..intervals {
                for offset in [0.5 - 0.5 / 3f64.sqrt(), 0.5 + 0.5 / 3f64.sqrt()] {
                    let x = (i as f64 + offset) / n;
                    let t = from_m + length_m * x * x;
                    let weight = length_m.abs() * 2.0 * x * 0.5 / n;
                    columns = columns.plus(medium.densities(self.place(t).altitude_m), weight);
                }
            }
        }
        columns
    }
}
