//! Density from voxels.

use super::weather::FieldPlace;
use crate::texture::clamped;
use glam::DVec3;
use skycell_protocol::scene::GridDensity;

/// A box of voxels in the field: x, altitude, z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Voxels along x, altitude and z.
    pub dimensions: [u32; 3],
    /// Lower corner, m.
    pub min_m: DVec3,
    /// Upper corner, m.
    pub max_m: DVec3,
}

impl Grid {
    /// The box of a layer of the scene.
    #[must_use]
    pub fn new(density: &GridDensity) -> Self {
        Self {
            dimensions: density.dimensions(),
            min_m: density.bounds_min_m(),
            max_m: density.bounds_max_m(),
        }
    }

    /// Density at a place: linear between the middles of voxels, the outermost voxel's nearer to the bounds, 0 outside.
    /// `voxels` holds as many values as the dimensions ask for.
    #[must_use]
    pub fn density(&self, voxels: &[f32], place: FieldPlace) -> f64 {
        let at = DVec3::new(place.x_m, place.altitude_m, place.z_m);
        if at.cmplt(self.min_m).any() || at.cmpgt(self.max_m).any() {
            return 0.0;
        }
        let relative = (at - self.min_m) / (self.max_m - self.min_m);
        let [nx, ny, nz] = self.dimensions;
        let (x0, x1, fx) = clamped(relative.x * f64::from(nx), nx);
        let (y0, y1, fy) = clamped(relative.y * f64::from(ny), ny);
        let (z0, z1, fz) = clamped(relative.z * f64::from(nz), nz);
        let line = |y: usize, z: usize| {
            let row = nx as usize * (y + ny as usize * z);
            let (a, b) = (f64::from(voxels[row + x0]), f64::from(voxels[row + x1]));
            a + (b - a) * fx
        };
        let plane = |z: usize| {
            let (a, b) = (line(y0, z), line(y1, z));
            a + (b - a) * fy
        };
        let (a, b) = (plane(z0), plane(z1));
        a + (b - a) * fz
    }
}
