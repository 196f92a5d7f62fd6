//! The local frame of a cell: what keeps planet-sized coordinates out of f32.

use glam::DVec3;

/// A frame whose origin lies on the ground at a world position; y is up there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellFrame {
    origin_x_m: f64,
    origin_z_m: f64,
    planet_radius_m: f64,
}

impl CellFrame {
    /// The frame at a world position (x, altitude, z), whose altitude does not matter.
    #[must_use]
    pub fn at(world_m: DVec3, planet_radius_m: f64) -> Self {
        Self {
            origin_x_m: world_m.x,
            origin_z_m: world_m.z,
            planet_radius_m,
        }
    }

    /// World x and z of the origin.
    #[must_use]
    pub fn origin_m(&self) -> [f64; 2] {
        [self.origin_x_m, self.origin_z_m]
    }

    /// Radius of the planet.
    #[must_use]
    pub fn planet_radius_m(&self) -> f64 {
        self.planet_radius_m
    }

    /// A world position (x, altitude, z) in this frame: y drops with the planet's curvature away from the origin.
    ///
    /// With horizontal distance d and altitude h, (y + R)² + d² = (R + h)², so
    /// y = (h (2R + h) − d²) / (√((R + h)² − d²) + R).
    #[must_use]
    pub fn from_world(&self, world_m: DVec3) -> DVec3 {
        let r = self.planet_radius_m;
        let (x, z, h) = (
            world_m.x - self.origin_x_m,
            world_m.z - self.origin_z_m,
            world_m.y,
        );
        let across = x * x + z * z;
        // Beyond a quarter of the planet there is no such point; the farthest one stands for it.
        let root = ((r + h) * (r + h) - across).max(0.0).sqrt();
        DVec3::new(x, (h * (2.0 * r + h) - across) / (root + r), z)
    }

    /// Altitude of a point of this frame above the ground sphere.
    #[must_use]
    pub fn altitude_m(&self, position: DVec3) -> f64 {
        let r = self.planet_radius_m;
        let from_centre = position + DVec3::new(0.0, r, 0.0);
        (position.length_squared() + 2.0 * r * position.y) / (from_centre.length() + r)
    }

    /// Distances from a point along a unit direction to where its line meets the shell at an altitude, the smaller first; none
    /// where it passes over it.
    #[must_use]
    pub fn shell_roots_m(
        &self,
        from: DVec3,
        direction: DVec3,
        altitude_m: f64,
    ) -> Option<[f64; 2]> {
        let r = self.planet_radius_m;
        let h = self.altitude_m(from);
        let b = direction.dot(from) + r * direction.y;
        let c = (h - altitude_m) * (h + altitude_m + 2.0 * r);
        let discriminant = b * b - c;
        if discriminant < 0.0 {
            return None;
        }
        let q = if b < 0.0 {
            discriminant.sqrt() - b
        } else {
            -(b + discriminant.sqrt())
        };
        let other = if q == 0.0 { 0.0 } else { c / q };
        Some([q.min(other), q.max(other)])
    }

    /// Unit vector straight up at a point.
    #[must_use]
    pub fn up(&self, at: DVec3) -> DVec3 {
        (at + DVec3::Y * self.planet_radius_m).normalize_or(DVec3::Y)
    }

    /// Distance from a point along a unit direction to the far side of the shell at an altitude; the point lies inside.
    #[must_use]
    pub fn distance_to_shell_m(&self, from: DVec3, direction: DVec3, altitude_m: f64) -> f64 {
        let r = self.planet_radius_m;
        let h = self.altitude_m(from);
        let b = direction.dot(from) + r * direction.y;
        let c = (h - altitude_m) * (h + altitude_m + 2.0 * r);
        let root = (b * b - c).max(0.0).sqrt();
        // The larger root, without cancellation where b > 0.
        if b > 0.0 { -c / (b + root) } else { root - b }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_keeps_its_altitude_in_every_frame() {
        for origin in [0.0, 5_000.0, 1.0e7] {
            let frame = CellFrame::at(DVec3::new(origin, 0.0, -origin), 6.36e6);
            for offset in [0.0, 100.0, 30_000.0] {
                let world = DVec3::new(origin + offset, 1_234.5, -origin - offset);
                let local = frame.from_world(world);
                assert!((frame.altitude_m(local) - 1_234.5).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn the_far_side_of_a_shell_lies_at_its_altitude() {
        let frame = CellFrame::at(DVec3::ZERO, 6.36e6);
        let eye = DVec3::new(0.0, 2.0, 0.0);
        for elevation_deg in [0.0f64, 0.1, 5.0, 45.0, 90.0] {
            let e = elevation_deg.to_radians();
            let direction = DVec3::new(e.cos(), e.sin(), 0.0);
            let distance = frame.distance_to_shell_m(eye, direction, 2_000.0);
            let altitude = frame.altitude_m(eye + direction * distance);
            assert!(
                (altitude - 2_000.0).abs() < 1e-5,
                "{elevation_deg}: {altitude}"
            );
        }
    }
}
