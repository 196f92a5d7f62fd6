//! How texels are addressed: tiles of an equal-area octahedral square around an anchor.

use glam::{DVec2, DVec3};
use std::f64::consts::{FRAC_PI_4, PI};

/// Texels along a stored tile, its gutters included.
pub const TILE_STRIDE: u32 = 64;
/// Texels of gutter on every side: what a Catmull-Rom read reaches across a tile's edge.
pub const GUTTER: u32 = 2;
/// Texels along a tile that it alone addresses.
pub const TILE_INTERIOR: u32 = TILE_STRIDE - 2 * GUTTER;
/// Tiles along the octahedral square at level 0: the level that is always resident, 0.7° a texel. Five rather than a
/// power of two, because then the levels' texels come just under the pixels of 360, 720 and 1440 rows at 60°.
pub const BASE_TILES: u32 = 5;
/// Levels of resolution; the finest has 19 200 texels along the square, 0.6 arc minutes each.
pub const LEVELS: u8 = 7;

/// One tile of one proxy sphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileKey {
    /// 0 is the coarsest.
    pub level: u8,
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
}

impl TileKey {
    /// Tiles along the square at a level.
    #[must_use]
    pub fn tiles_per_side(level: u8) -> u32 {
        BASE_TILES << level
    }

    /// Texels along the square at a level.
    #[must_use]
    pub fn texels_per_side(level: u8) -> u32 {
        Self::tiles_per_side(level) * TILE_INTERIOR
    }

    /// Every tile of a level, row by row.
    pub fn all_of(level: u8) -> impl Iterator<Item = Self> {
        let side = Self::tiles_per_side(level) as u16;
        (0..side).flat_map(move |y| (0..side).map(move |x| Self { level, x, y }))
    }

    /// The four tiles of the next level that cover this one.
    #[must_use]
    pub fn children(self) -> [Self; 4] {
        [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| Self {
            level: self.level + 1,
            x: 2 * self.x + dx,
            y: 2 * self.y + dy,
        })
    }

    /// The tile of the level before that covers this one.
    #[must_use]
    pub fn parent(self) -> Option<Self> {
        (self.level > 0).then(|| Self {
            level: self.level - 1,
            x: self.x / 2,
            y: self.y / 2,
        })
    }

    /// The tile some levels before that covers this one: at level 0 there is nothing coarser.
    #[must_use]
    pub fn coarser(self, levels: u8) -> Self {
        let levels = levels.min(self.level);
        Self {
            level: self.level - levels,
            x: self.x >> levels,
            y: self.y >> levels,
        }
    }

    /// Direction from the anchor through a place in the tile, (0, 0) to (1, 1).
    #[must_use]
    pub fn direction(self, within: DVec2) -> DVec3 {
        let corner = DVec2::new(f64::from(self.x), f64::from(self.y));
        direction_from_octahedral((corner + within) / f64::from(Self::tiles_per_side(self.level)))
    }
}

/// Solid angle of a texel at a level, sr: all texels of a level have the same.
#[must_use]
pub fn texel_solid_angle_sr(level: u8) -> f64 {
    4.0 * PI / f64::from(TileKey::texels_per_side(level)).powi(2)
}

/// Unit direction of octahedral coordinates in 0…1 (P. Clarberg 2008): the pole +y at the middle.
#[must_use]
pub fn direction_from_octahedral(square: DVec2) -> DVec3 {
    let uv = 2.0 * square - DVec2::ONE;
    let a = uv.abs();
    let signed_distance = 1.0 - (a.x + a.y);
    let radius = 1.0 - signed_distance.abs();
    let angle = if radius == 0.0 {
        0.0
    } else {
        ((a.y - a.x) / radius + 1.0) * FRAC_PI_4
    };
    let across = radius * (2.0 - radius * radius).max(0.0).sqrt();
    DVec3::new(
        angle.cos().copysign(uv.x) * across,
        (1.0 - radius * radius).copysign(signed_distance),
        angle.sin().copysign(uv.y) * across,
    )
}

/// Octahedral coordinates in 0…1 of a unit direction.
#[must_use]
pub fn octahedral_from_direction(direction: DVec3) -> DVec2 {
    let a = direction.abs();
    let radius = ((a.x * a.x + a.z * a.z) / (1.0 + a.y)).sqrt();
    let v = if a.x + a.z == 0.0 {
        0.0
    } else {
        a.z.atan2(a.x) / (2.0 * FRAC_PI_4) * radius
    };
    let upper = DVec2::new(radius - v, v);
    let folded = if direction.y < 0.0 {
        DVec2::new(1.0 - upper.y, 1.0 - upper.x)
    } else {
        upper
    };
    let signed = DVec2::new(
        folded.x.copysign(direction.x),
        folded.y.copysign(direction.z),
    );
    0.5 * (DVec2::ONE + signed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn directions_survive_the_octahedral_square(x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64) {
            let v = DVec3::new(x, y, z);
            prop_assume!(v.length() > 1e-3);
            let direction = v.normalize();
            let back = direction_from_octahedral(octahedral_from_direction(direction));
            prop_assert!((back - direction).length() < 1e-7, "{direction} {back}");
        }

        #[test]
        fn the_square_covers_equal_areas(u in 0.01..0.99f64, v in 0.01..0.99f64) {
            // The Jacobian by central differences; the map folds at the diamond and the axes.
            let at = DVec2::new(u, v);
            let c = 2.0 * at - DVec2::ONE;
            prop_assume!((c.x.abs() + c.y.abs() - 1.0).abs() > 0.01 && c.x.abs() > 0.01 && c.y.abs() > 0.01);
            let h = 1e-4;
            let du = (direction_from_octahedral(at + DVec2::X * h) - direction_from_octahedral(at - DVec2::X * h)) / (2.0 * h);
            let dv = (direction_from_octahedral(at + DVec2::Y * h) - direction_from_octahedral(at - DVec2::Y * h)) / (2.0 * h);
            prop_assert!((du.cross(dv).length() - 4.0 * PI).abs() < 1e-2);
        }
    }

    #[test]
    fn a_tile_is_its_childrens_parent() {
        let tile = TileKey {
            level: 3,
            x: 17,
            y: 4,
        };
        for child in tile.children() {
            assert_eq!(child.parent(), Some(tile));
            assert_eq!(child.coarser(1), tile);
            assert_eq!(Some(child.coarser(2)), tile.parent());
            assert_eq!(child.coarser(200).level, 0);
        }
    }
}
