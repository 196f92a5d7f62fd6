//! Which tiles a viewer needs: those inside its frustum and above its horizon, at the level of its pixels.

use super::address::{GUTTER, LEVELS, TILE_INTERIOR, TILE_STRIDE, TileKey, texel_solid_angle_sr};
use crate::march::{CellFrame, Side, Surface};
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;

/// A texel may look this much wider than the pixel that shows it before the next level is asked for. At 0.8 a picture of
/// 16:9 at 60° needs one level almost everywhere, so that viewers who look at the same clouds with different parts of
/// their pictures ask for the same texels, and bilinear reads are as good as sharper ones.
const TEXELS_PER_PIXEL_MAX: f64 = 0.8;
/// A texel may look so many pixels long in the direction in which it is longest before the next level is asked for. Texels have equal
/// areas, so about an anchor below those at the horizon are 2.5 times as high as wide: there clouds have the finest lines, and level ones.
/// Tuned: at 1920×1080 FLIP against a screen-space picture .0039, .0040 without a limit, for 7 % more texels; at 1.15 they would be 19 %
/// more, at 1.1 36 %.
const TEXEL_PIXELS_LONG_MAX: f64 = 1.2;

/// Texels along a block, and blocks along a stored tile.
const BLOCK: u32 = 8;
const BLOCKS: u32 = TILE_STRIDE / BLOCK;

/// Pixels of a tile whose texels are as wide as pixels.
const TILE_PIXELS: f64 = (TILE_INTERIOR * TILE_INTERIOR) as f64;

/// A camera in the frame of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewFrustum {
    /// Eye.
    pub position: DVec3,
    /// Unit vector through the middle of the picture.
    pub forward: DVec3,
    /// Half the picture's width at distance 1.
    pub right: DVec3,
    /// Half the picture's height at distance 1.
    pub up: DVec3,
    /// Angle of a pixel at the middle of the picture, rad.
    pub pixel_angle_rad: f64,
}

/// Where a layer's texels lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProxySphere {
    /// The cell's frame.
    pub frame: CellFrame,
    /// Centre of the addresses, inside the surface, in the cell's frame.
    pub anchor: DVec3,
    /// The surface.
    pub surface: Surface,
    /// Top of what it keeps, m, where rays go down to it: none that passes over it is asked for.
    pub top_m: Option<f64>,
    /// Where rays start, in the cell's frame.
    pub reference: DVec3,
    /// Altitudes between which a viewer away from there looks for what a texel shows, m; without, on the sphere alone.
    pub seen_between_m: Option<[f64; 2]>,
    /// What it keeps of its layer, where that is not all.
    pub band: Option<Band>,
}

/// What is between two distances from where rays start, of a layer between two altitudes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// The layer's altitudes, m.
    pub altitudes_m: [f64; 2],
    /// The distances, m.
    pub distances_m: [f64; 2],
}

impl ProxySphere {
    /// The point of the surface in a direction from the anchor.
    #[must_use]
    pub fn point(&self, from_anchor: DVec3) -> DVec3 {
        self.point_along(self.anchor, from_anchor)
    }

    /// The point of the surface along a ray from inside it.
    #[must_use]
    pub fn point_along(&self, from: DVec3, direction: DVec3) -> DVec3 {
        from + direction
            * self
                .surface
                .distance_m(&self.frame, self.anchor, from, direction)
    }

    /// Whether there may be anything to see in a direction from an eye: from below not under the horizon, from above not over
    /// the top.
    #[must_use]
    pub fn may_show(&self, eye: DVec3, direction: DVec3) -> bool {
        let visible = Visible::of(self, eye);
        let edge = -visible.dip_rad.sin();
        let sine = direction.dot(visible.up);
        if visible.from_above {
            sine <= edge
        } else {
            sine >= edge
        }
    }

    /// The layer's altitudes, m, where rays start in it and its far part is kept.
    fn layer_around(&self) -> Option<[f64; 2]> {
        let altitudes_m = self.band.map(|band| band.altitudes_m)?;
        let is_dome = matches!(self.surface, Surface::Dome { .. });
        let altitude_m = self.frame.altitude_m(self.anchor);
        (is_dome && Side::of(altitudes_m, altitude_m) == Side::Within).then_some(altitudes_m)
    }

    /// How far a ray goes from the reference, which is in a layer, until it leaves that for good, m: on its way down at the base,
    /// and where it passes over the ground at the top.
    fn leaves_layer_m(&self, along: DVec3, [base_m, top_m]: [f64; 2]) -> f64 {
        let (frame, from) = (&self.frame, self.reference);
        let is_ahead = |[near_m, _]: &[f64; 2]| *near_m > 0.0;
        let ground_m = frame.shell_roots_m(from, along, 0.0).filter(is_ahead);
        let below_m = frame.shell_roots_m(from, along, base_m).filter(is_ahead);
        match (ground_m, below_m) {
            (Some(_), Some([near_m, _])) => near_m,
            _ => frame.distance_to_shell_m(from, along, top_m),
        }
    }

    /// Whether some texel of a tile may hold something of a layer that rays start in: those whose rays leave it before the far
    /// part begins do not.
    fn may_hold_far_part(&self, tile: TileKey, between_rad: f64, layer_m: [f64; 2]) -> bool {
        let near_m = self.band.map_or(0.0, |band| band.distances_m[0]);
        // Rays between this and the horizontal pass over the ground's edge.
        let dip_rad = horizon_dip_rad(&self.frame, self.reference);
        (0..9).any(|index| {
            let within = DVec2::new(f64::from(index % 3), f64::from(index / 3)) / 2.0;
            let along =
                (self.point(tile.direction(within)) - self.reference).normalize_or(DVec3::Y);
            let across = along.with_y(0.0).normalize_or(DVec3::X);
            let elevation_rad = along.y.clamp(-1.0, 1.0).asin();
            // The flatter, the longer.
            let flatter_rad = if elevation_rad < 0.0 {
                (elevation_rad + between_rad).min(0.0)
            } else {
                (elevation_rad - between_rad).max(0.0)
            };
            let flattest = across * flatter_rad.cos() + DVec3::Y * flatter_rad.sin();
            (-dip_rad..=0.0).contains(&flatter_rad)
                || self.leaves_layer_m(flattest, layer_m) >= near_m
        })
    }

    /// Where a ray from the reference enters and leaves what is kept between two altitudes; none where it passes over it.
    fn ends_between(&self, along: DVec3, [low_m, high_m]: [f64; 2]) -> Option<[DVec3; 2]> {
        let (frame, from) = (&self.frame, self.reference);
        let ends_m = if let Some(layer_m) = self.layer_around() {
            [0.0, self.leaves_layer_m(along, layer_m)]
        } else if self.top_m.is_some() {
            // What is behind is on no ray.
            let [enters_m, leaves_m] = frame
                .shell_roots_m(from, along, high_m)
                .filter(|[enters_m, _]| *enters_m > 0.0)?;
            let base_m = frame.shell_roots_m(from, along, low_m);
            [enters_m, base_m.map_or(leaves_m, |[near_m, _]| near_m)]
        } else {
            [low_m, high_m].map(|altitude_m| frame.distance_to_shell_m(from, along, altitude_m))
        };
        let ends_m = ends_m.map(|distance_m| {
            self.band.map_or(distance_m, |band| {
                let [near_m, far_m] = band.distances_m;
                distance_m.clamp(near_m, far_m)
            })
        });
        Some(ends_m.map(|distance_m| from + along * distance_m))
    }

    /// Whether some texel of a tile may hold something: away from the band's directions, nothing is marched.
    fn may_hold(&self, tile: TileKey) -> bool {
        let Some(band) = self.band.filter(|_| self.top_m.is_none()) else {
            return true;
        };
        // Between the places that are looked at, directions are this far away from one of them at most: tiles are up to twice
        // as long as wide.
        let between_rad = 0.5 * texel_solid_angle_sr(tile.level).sqrt() * f64::from(TILE_INTERIOR);
        if let Some(layer_m) = self.layer_around() {
            return self.may_hold_far_part(tile, between_rad, layer_m);
        }
        (0..9).any(|index| {
            let within = DVec2::new(f64::from(index % 3), f64::from(index / 3)) / 2.0;
            let along =
                (self.point(tile.direction(within)) - self.reference).normalize_or(DVec3::Y);
            let across = along.with_y(0.0).normalize_or(DVec3::X);
            let elevation_rad = along.y.clamp(-1.0, 1.0).asin();
            // The layer is nearest where a ray is steepest.
            let distance_m = |elevation_rad: f64, altitude_m: f64| {
                let elevation_rad = elevation_rad.clamp(0.0, std::f64::consts::FRAC_PI_2);
                let direction = across * elevation_rad.cos() + DVec3::Y * elevation_rad.sin();
                self.frame
                    .distance_to_shell_m(self.reference, direction, altitude_m)
            };
            let nearest_m = distance_m(elevation_rad + between_rad, band.altitudes_m[0]);
            let farthest_m = distance_m(elevation_rad - between_rad, band.altitudes_m[1]);
            nearest_m <= band.distances_m[1] && farthest_m >= band.distances_m[0]
        })
    }

    /// Where what the texel at a point of the surface shows may be: on its ray.
    fn seen_at(&self, point: DVec3) -> impl Iterator<Item = DVec3> {
        let along = (point - self.reference).normalize_or_zero();
        let between_m = self.seen_between_m;
        let ends = between_m.and_then(|between_m| self.ends_between(along, between_m));
        ends.unwrap_or([point; 2]).into_iter()
    }
}

impl ViewFrustum {
    /// Inward normals of the four side planes.
    fn planes(&self) -> [DVec3; 4] {
        let (f, r, u) = (self.forward, self.right, self.up);
        // A side's normal is perpendicular to its corner rays.
        [
            (f + r).cross(u),
            u.cross(f - r),
            r.cross(f + u),
            (f - u).cross(r),
        ]
        .map(|n| {
            let n = n.normalize_or_zero();
            if n.dot(f) < 0.0 { -n } else { n }
        })
    }
}

/// Places of a tile that stand for all of it: three by three, each at both ends of where it may be seen.
const PLACES: usize = 18;

/// A tile as seen from a point.
struct SeenTile {
    /// Towards its middle.
    axis: DVec3,
    /// Towards its places.
    directions: [DVec3; PLACES],
    /// How far its edges may bulge beyond these: less than a tenth of its own half angle.
    bulge_rad: f64,
    /// Distance of its nearest part, m.
    distance_m: f64,
    /// Solid angle of the tile's sphere element seen from the eye, relative to that seen from the anchor.
    solid_angle_ratio: f64,
}

fn seen_tile(sphere: &ProxySphere, tile: TileKey, eye: DVec3) -> SeenTile {
    seen_part(sphere, tile, [DVec2::ZERO, DVec2::ONE], eye)
}

/// A part of a tile between two corners, (0, 0) to (1, 1) for all of it, as seen from a point.
fn seen_part(sphere: &ProxySphere, tile: TileKey, corners: [DVec2; 2], eye: DVec3) -> SeenTile {
    let [low, high] = corners;
    let middle = sphere.point(tile.direction(0.5 * (low + high)));
    let axis = (middle - eye).normalize_or_zero();
    let mut half_angle_rad: f64 = 0.0;
    // The middle of a tile at the horizon may be on the other side of the planet.
    let mut nearest_m = f64::INFINITY;
    let mut directions = [DVec3::ZERO; PLACES];
    for (index, pair) in directions.chunks_exact_mut(2).enumerate() {
        let within = DVec2::new((index % 3) as f64, (index / 3) as f64) / 2.0;
        let point = sphere.point(tile.direction(low + (high - low) * within));
        half_angle_rad = half_angle_rad.max(axis.angle_between((point - eye).normalize_or_zero()));
        for (direction, seen) in pair.iter_mut().zip(sphere.seen_at(point)) {
            let from_eye = seen - eye;
            nearest_m = nearest_m.min(from_eye.length());
            *direction = from_eye.normalize_or_zero();
        }
    }
    let from_anchor = middle - sphere.anchor;
    let from_eye = middle - eye;
    let normal = (sphere.surface).normal(&sphere.frame, sphere.anchor, middle);
    let slant = |v: DVec3| v.normalize_or_zero().dot(normal).abs().max(1e-3);
    let solid_angle_ratio = from_anchor.length_squared() / from_eye.length_squared().max(1.0)
        * slant(from_eye)
        / slant(from_anchor);
    SeenTile {
        axis,
        directions,
        bulge_rad: 0.1 * half_angle_rad,
        distance_m: nearest_m,
        solid_angle_ratio,
    }
}

/// In which directions an eye may see anything of a sphere.
struct Visible {
    /// From above they are below this angle under the horizontal, from below above it.
    dip_rad: f64,
    from_above: bool,
    /// Straight up at the eye.
    up: DVec3,
}

impl Visible {
    fn of(sphere: &ProxySphere, eye: DVec3) -> Self {
        let frame = &sphere.frame;
        if sphere.layer_around().is_some() {
            // What is around is seen in all directions.
            return Self {
                dip_rad: std::f64::consts::FRAC_PI_2,
                from_above: false,
                up: DVec3::Y,
            };
        }
        let Some(top_m) = sphere.top_m else {
            return Self {
                dip_rad: horizon_dip_rad(frame, eye),
                from_above: false,
                // The frame's own will do: the ground's edge is wide of it by less than a tile.
                up: DVec3::Y,
            };
        };
        // Where a ray touches the top.
        let height_m = (frame.altitude_m(eye) - top_m).max(0.0);
        let from_centre_m = frame.planet_radius_m() + top_m;
        let touches_m = (height_m * (2.0 * from_centre_m + height_m)).sqrt();
        Self {
            dip_rad: touches_m.atan2(from_centre_m),
            from_above: true,
            up: frame.up(eye),
        }
    }

    /// Whether it may see something of a tile.
    fn some_of(&self, tile: &SeenTile) -> bool {
        let turned = if self.from_above {
            self.dip_rad - tile.bulge_rad
        } else {
            self.dip_rad + tile.bulge_rad
        };
        let edge = -turned.min(std::f64::consts::FRAC_PI_2).sin();
        let sines = tile.directions.iter().map(|d| d.dot(self.up));
        if self.from_above {
            sines.fold(f64::INFINITY, f64::min) <= edge
        } else {
            sines.fold(f64::NEG_INFINITY, f64::max) >= edge
        }
    }
}

/// Whether some of a tile may be in front of all planes and in a direction in which there is something.
fn may_be_seen(tile: &SeenTile, planes: &[DVec3], visible: &Visible) -> bool {
    let reach = tile.bulge_rad.min(std::f64::consts::FRAC_PI_2).sin();
    visible.some_of(tile)
        && planes
            .iter()
            .all(|plane| tile.directions.iter().any(|d| plane.dot(*d) >= -reach))
}

/// Angle of the horizon below the horizontal at an altitude.
fn horizon_dip_rad(frame: &CellFrame, eye: DVec3) -> f64 {
    let altitude_m = frame.altitude_m(eye).max(0.0);
    (frame.planet_radius_m() / (frame.planet_radius_m() + altitude_m)).acos()
}

/// A tile that a viewer wants, with how far it lies from the middle of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileRequest {
    /// The tile.
    pub key: TileKey,
    /// Angle from the middle of the picture, rad.
    pub eccentricity_rad: f64,
    /// Distance of the tile's nearest part from the viewer, m.
    pub distance_m: f64,
    /// Share of the picture that it would cover if all of it were inside, 0 to 1; 0 where nobody looks at it.
    pub screen_share: f64,
    /// Pixels that one of its texels covers in the picture.
    pub texel_pixels: f64,
}

/// The tiles that a viewer needs of one sphere, none twice, none covering another.
#[must_use]
pub fn requested_tiles(
    view: &ViewFrustum,
    sphere: &ProxySphere,
    mip_bias: f64,
) -> Vec<TileRequest> {
    let planes = view.planes();
    let visible = Visible::of(sphere, view.position);
    let allowed = TEXELS_PER_PIXEL_MAX * mip_bias.exp2();
    let picture_pixels =
        4.0 * view.right.length() * view.up.length() / view.pixel_angle_rad.powi(2);
    let mut requests = Vec::new();
    let longest = TEXEL_PIXELS_LONG_MAX * mip_bias.exp2();
    let mut open: Vec<(TileKey, bool)> = TileKey::all_of(0).map(|tile| (tile, false)).collect();
    // Once is enough: seen at a grazing angle texels are long at every level.
    while let Some((tile, is_cut_for_length)) = open.pop() {
        let seen = seen_tile(sphere, tile, view.position);
        if !may_be_seen(&seen, &planes, &visible) || !sphere.may_hold(tile) {
            continue;
        }
        // A pixel θ off the middle has cos³θ of the solid angle.
        let mu = seen.axis.dot(view.forward).max(0.2);
        let pixel_sr = view.pixel_angle_rad.powi(2) * mu.powi(3);
        let texel_sr = texel_solid_angle_sr(tile.level) * seen.solid_angle_ratio;
        let texel_pixels = texel_sr / pixel_sr;
        let is_wide = texel_pixels.sqrt() > allowed;
        let is_long =
            !is_wide && !is_cut_for_length && longest_texel_pixels(view, sphere, tile) > longest;
        if !is_cut_for_length && (is_wide || is_long) && tile.level + 1 < LEVELS {
            open.extend(tile.children().map(|child| (child, is_long)));
        } else {
            requests.push(TileRequest {
                key: tile,
                eccentricity_rad: seen.axis.angle_between(view.forward),
                distance_m: seen.distance_m,
                screen_share: (TILE_PIXELS * texel_pixels / picture_pixels).min(1.0),
                texel_pixels,
            });
        }
    }
    requests
}

/// How long a texel in the middle of a tile is in a picture in the direction in which it is longest, pixels. 0 where the tile is not in
/// front of the viewer.
fn longest_texel_pixels(view: &ViewFrustum, sphere: &ProxySphere, tile: TileKey) -> f64 {
    let place = |x: f64, y: f64| {
        let seen = sphere.point(tile.direction(DVec2::new(x, y))) - view.position;
        let ahead = seen.dot(view.forward);
        let is_ahead = ahead > 0.2 * seen.length();
        is_ahead.then(|| {
            let across = seen.dot(view.right.normalize_or_zero());
            let up = seen.dot(view.up.normalize_or_zero());
            DVec2::new(across, up) / (ahead * view.pixel_angle_rad)
        })
    };
    let ends = [
        place(0.0, 0.5),
        place(1.0, 0.5),
        place(0.5, 0.0),
        place(0.5, 1.0),
    ];
    let [Some(left), Some(right), Some(top), Some(bottom)] = ends else {
        return 0.0;
    };
    let texels = f64::from(TILE_INTERIOR);
    let [along_x, along_y] = [(right - left) / texels, (bottom - top) / texels];
    // The larger singular value of the matrix with these two columns.
    let sum = along_x.length_squared() + along_y.length_squared();
    let area = along_x.perp_dot(along_y);
    (0.5 * (sum + (sum * sum - 4.0 * area * area).max(0.0).sqrt())).sqrt()
}

/// Which blocks of 8 × 8 stored texels of a tile a viewer may see, or reads beside what it sees: bit 8 y + x. A picture's edge
/// crosses tiles, and what of them lies outside is marched for nobody.
#[must_use]
pub fn seen_blocks(view: &ViewFrustum, sphere: &ProxySphere, tile: TileKey) -> u64 {
    let planes = view.planes();
    let visible = Visible::of(sphere, view.position);
    let along = |block: u32, texels: i32| {
        let stored = (block * BLOCK) as i32 + texels - GUTTER as i32;
        f64::from(stored) / f64::from(TILE_INTERIOR)
    };
    let mut seen = 0;
    for (y, x) in (0..BLOCKS).flat_map(|y| (0..BLOCKS).map(move |x| (y, x))) {
        // A read reaches as far as a gutter is wide.
        let ends = [-(GUTTER as i32), (BLOCK + GUTTER) as i32];
        let corners = ends.map(|end| DVec2::new(along(x, end), along(y, end)));
        let part = seen_part(sphere, tile, corners, view.position);
        seen |= u64::from(may_be_seen(&part, &planes, &visible)) << (BLOCKS * y + x);
    }
    seen
}

/// The tiles that several eyes of one viewer need of a sphere, each once, as near to the middle of a picture as the eye that
/// sees it nearest there has it. A tile of one eye may cover a finer one of another.
#[must_use]
pub fn requested_by_eyes(of_eyes: impl IntoIterator<Item = Vec<TileRequest>>) -> Vec<TileRequest> {
    let mut of_eyes = of_eyes.into_iter();
    let mut all = of_eyes.next().unwrap_or_default();
    for of_eye in of_eyes {
        let places: BTreeMap<TileKey, usize> = all
            .iter()
            .enumerate()
            .map(|(place, request)| (request.key, place))
            .collect();
        for request in of_eye {
            match places.get(&request.key) {
                Some(place) => {
                    let known = &mut all[*place];
                    known.eccentricity_rad = known.eccentricity_rad.min(request.eccentricity_rad);
                    known.distance_m = known.distance_m.min(request.distance_m);
                    known.screen_share = known.screen_share.max(request.screen_share);
                    known.texel_pixels = known.texel_pixels.max(request.texel_pixels);
                }
                None => all.push(request),
            }
        }
    }
    all
}

/// The tiles of the coarsest level that can be seen from a point in any direction.
#[must_use]
pub fn coarse_tiles(sphere: &ProxySphere, eye: DVec3) -> Vec<TileRequest> {
    let visible = Visible::of(sphere, eye);
    TileKey::all_of(0)
        .filter_map(|key| {
            let seen = seen_tile(sphere, key, eye);
            (may_be_seen(&seen, &[], &visible) && sphere.may_hold(key)).then_some(TileRequest {
                key,
                eccentricity_rad: std::f64::consts::FRAC_PI_2 - seen.axis.y.clamp(-1.0, 1.0).asin(),
                distance_m: seen.distance_m,
                screen_share: 0.0,
                texel_pixels: 0.0,
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::address::octahedral_from_direction;
    use super::*;
    use proptest::prelude::*;

    fn view(yaw: f64, pitch: f64, fov: f64, width: u32, height: u32) -> ViewFrustum {
        let (yaw, pitch) = (yaw.to_radians(), pitch.to_radians());
        let forward = DVec3::new(
            yaw.sin() * pitch.cos(),
            pitch.sin(),
            -yaw.cos() * pitch.cos(),
        );
        let right = DVec3::new(yaw.cos(), 0.0, yaw.sin());
        let half = (fov.to_radians() / 2.0).tan();
        ViewFrustum {
            position: DVec3::new(0.0, 2.0, 0.0),
            forward,
            right: right * half * f64::from(width) / f64::from(height),
            up: right.cross(forward) * half,
            pixel_angle_rad: 2.0 * half / f64::from(height),
        }
    }

    fn sphere() -> ProxySphere {
        ProxySphere {
            frame: CellFrame::at(DVec3::ZERO, 6.36e6),
            anchor: DVec3::new(300.0, 0.0, -200.0),
            surface: Surface::Shell {
                altitude_m: 2_200.0,
            },
            top_m: None,
            reference: DVec3::ZERO,
            seen_between_m: None,
            band: None,
        }
    }

    /// The same about an anchor above it.
    fn from_above(anchor: DVec3, reference: DVec3) -> ProxySphere {
        let sphere = sphere();
        ProxySphere {
            anchor,
            reference,
            surface: Surface::shell(&sphere.frame, anchor, 2_200.0),
            top_m: Some(4_000.0),
            seen_between_m: Some([1_500.0, 4_000.0]),
            ..sphere
        }
    }

    /// What a viewer away from the reference sees between two altitudes.
    fn sphere_of(reference: DVec3) -> ProxySphere {
        ProxySphere {
            reference,
            seen_between_m: Some([1_500.0, 4_000.0]),
            ..sphere()
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        /// The oracle walks the pixels: whatever tile holds a pixel's texel must have been requested at some level.
        #[test]
        fn every_pixel_of_the_sky_finds_its_tile(yaw in 0.0..360.0f64, pitch in -60.0..90.0f64, fov in 5.0..120.0f64) {
            let view = view(yaw, pitch, fov, 64, 36);
            let sphere = sphere();
            let tiles: std::collections::HashSet<TileKey> =
                requested_tiles(&view, &sphere, 0.0).iter().map(|r| r.key).collect();
            for row in 0..36 {
                for column in 0..64 {
                    let x = 2.0 * (f64::from(column) + 0.5) / 64.0 - 1.0;
                    let y = 1.0 - 2.0 * (f64::from(row) + 0.5) / 36.0;
                    let direction = (view.forward + x * view.right + y * view.up).normalize();
                    if direction.y < 0.0 { continue; }
                    let point = sphere.point_along(view.position, direction);
                    let square = octahedral_from_direction((point - sphere.anchor).normalize());
                    let found = (0..LEVELS).any(|level| {
                        let side = f64::from(TileKey::tiles_per_side(level));
                        let at = (square * side).floor().min(DVec2::splat(side - 1.0));
                        tiles.contains(&TileKey { level, x: at.x as u16, y: at.y as u16 })
                    });
                    prop_assert!(found, "pixel {column} {row}");
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        /// The oracle walks the pixels and the altitudes: the ray from the reference to what is seen there must pass the sphere
        /// in a requested tile.
        #[test]
        fn whatever_is_seen_from_beside_the_reference_has_its_tile(
            yaw in 0.0..360.0f64, pitch in -10.0..80.0f64, fov in 20.0..90.0f64, x in -3e3..3e3f64, z in -3e3..3e3f64,
        ) {
            let view = view(yaw, pitch, fov, 64, 36);
            let sphere = sphere_of(DVec3::new(x, 2.0, z));
            let tiles: std::collections::HashSet<TileKey> =
                requested_tiles(&view, &sphere, 0.0).iter().map(|r| r.key).collect();
            for row in (0..36).step_by(3) {
                for column in (0..64).step_by(3) {
                    let x = 2.0 * (f64::from(column) + 0.5) / 64.0 - 1.0;
                    let y = 1.0 - 2.0 * (f64::from(row) + 0.5) / 36.0;
                    let direction = (view.forward + x * view.right + y * view.up).normalize();
                    if direction.y < 0.0 { continue; }
                    for altitude_m in [1_500.0, 2_200.0, 3_000.0, 4_000.0] {
                        let seen_m = sphere.frame.distance_to_shell_m(view.position, direction, altitude_m);
                        let seen = view.position + direction * seen_m;
                        let along = (seen - sphere.reference).normalize();
                        let place = sphere.point_along(sphere.reference, along) - sphere.anchor;
                        let square = octahedral_from_direction(place.normalize());
                        let found = (0..LEVELS).any(|level| {
                            let side = f64::from(TileKey::tiles_per_side(level));
                            let at = (square * side).floor().min(DVec2::splat(side - 1.0));
                            tiles.contains(&TileKey { level, x: at.x as u16, y: at.y as u16 })
                        });
                        prop_assert!(found, "pixel {column} {row} at {altitude_m} m");
                    }
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        /// From above a layer, beside the reference and the anchor: the texel of a pixel that is not over the top has its tile, and so
        /// has what is seen at each altitude of the layer.
        #[test]
        fn whatever_is_seen_from_above_has_its_tile(
            yaw in 0.0..360.0f64, pitch in -90.0..30.0f64, fov in 5.0..100.0f64, place in 0..6usize,
            x in -1.0..1.0f64, z in -1.0..1.0f64, rise in 0.7..1.4f64,
        ) {
            let altitude_m = [4_000.001, 4_100.0, 6_000.0, 12_000.0, 1e5, 4e5][place];
            let aside_m = 0.3 * (altitude_m - 2_200.0_f64).min(1e4);
            let frame = CellFrame::at(DVec3::ZERO, 6.36e6);
            let eye = frame.from_world(DVec3::new(0.1 * x * aside_m, altitude_m, 0.0));
            let sphere = from_above(
                frame.from_world(DVec3::new(x * aside_m, 2_200.0 + rise * (altitude_m - 2_200.0), z * aside_m)),
                frame.from_world(DVec3::new(0.1 * z * aside_m, altitude_m + 0.1 * x.abs() * aside_m, 0.0)),
            );
            let view = ViewFrustum { position: eye, ..view(yaw, pitch, fov, 64, 36) };
            let tiles: std::collections::HashSet<TileKey> =
                requested_tiles(&view, &sphere, 1.0).iter().map(|r| r.key).collect();
            let is_asked_for = |place: DVec3| {
                let square = octahedral_from_direction((place - sphere.anchor).normalize());
                (0..LEVELS).any(|level| {
                    let side = f64::from(TileKey::tiles_per_side(level));
                    let at = (square * side).floor().min(DVec2::splat(side - 1.0));
                    tiles.contains(&TileKey { level, x: at.x as u16, y: at.y as u16 })
                })
            };
            for row in (0..36).step_by(3) {
                for column in (0..64).step_by(3) {
                    let x = 2.0 * (f64::from(column) + 0.5) / 64.0 - 1.0;
                    let y = 1.0 - 2.0 * (f64::from(row) + 0.5) / 36.0;
                    let direction = (view.forward + x * view.right + y * view.up).normalize();
                    let top = frame.shell_roots_m(eye, direction, 4_000.0);
                    let Some([near_m, far_m]) = top.filter(|top| top[0] > 0.0) else { continue; };
                    let end_m = frame.shell_roots_m(eye, direction, 1_500.0).map_or(far_m, |base| base[0]);
                    for share in [0.0, 0.3, 0.7, 1.0] {
                        let seen = eye + direction * (near_m + share * (end_m - near_m));
                        let along = (seen - sphere.reference).normalize();
                        let place = sphere.point_along(sphere.reference, along);
                        prop_assert!(is_asked_for(place), "pixel {column} {row}, {share} of the way");
                    }
                }
            }
        }
    }

    #[test]
    fn two_who_look_down_at_the_same_clouds_ask_for_the_same_tiles_and_nobody_for_what_is_over_them()
     {
        let frame = CellFrame::at(DVec3::ZERO, 6.36e6);
        let at = |x: f64| frame.from_world(DVec3::new(x, 9_000.0, 0.0));
        let sphere = from_above(at(0.0), at(0.0));
        let keys = |x: f64, pitch: f64| -> std::collections::HashSet<TileKey> {
            let view = ViewFrustum {
                position: at(x),
                ..view(0.0, pitch, 60.0, 640, 360)
            };
            requested_tiles(&view, &sphere, 0.0)
                .iter()
                .map(|r| r.key)
                .collect()
        };
        let (one, other) = (keys(0.0, -40.0), keys(50.0, -40.0));
        let both = one.intersection(&other).count();
        assert!(10 * both >= 9 * one.len(), "{both} of {}", one.len());
        assert!(keys(0.0, 60.0).is_empty());
        // Nor for more than what is seen for being beside the reference.
        let on_surface = ProxySphere {
            seen_between_m: None,
            ..sphere
        };
        let view = ViewFrustum {
            position: at(50.0),
            ..view(0.0, -40.0, 60.0, 640, 360)
        };
        let there = requested_tiles(&view, &on_surface, 0.0).len();
        assert!(4 * other.len() <= 5 * there, "{} {there}", other.len());
    }

    #[test]
    fn no_requested_tile_covers_another() {
        let tiles: Vec<TileKey> =
            requested_tiles(&view(30.0, 20.0, 60.0, 1280, 720), &sphere(), 0.0)
                .iter()
                .map(|r| r.key)
                .collect();
        for tile in &tiles {
            let mut ancestor = tile.parent();
            while let Some(a) = ancestor {
                assert!(!tiles.contains(&a));
                ancestor = a.parent();
            }
        }
        assert!(tiles.len() > 50);
    }

    /// The oracle walks the pixels: one step to the right and one down, in texels, are a matrix whose smaller singular value is one
    /// over the longest way that a texel has.
    #[test]
    fn no_texel_is_much_longer_than_a_pixel_also_at_the_horizon() {
        let (width, height) = (1920, 1080);
        let view = view(0.0, 25.0, 60.0, width, height);
        let sphere = sphere();
        let tiles: std::collections::HashSet<TileKey> = requested_tiles(&view, &sphere, 0.0)
            .iter()
            .map(|r| r.key)
            .collect();
        let square = |column: u32, row: u32| {
            let x = 2.0 * f64::from(column) / f64::from(width) - 1.0;
            let y = 1.0 - 2.0 * f64::from(row) / f64::from(height);
            let direction = (view.forward + x * view.right + y * view.up).normalize();
            let point = sphere.point_along(view.position, direction);
            (direction.y > 0.0)
                .then(|| octahedral_from_direction((point - sphere.anchor).normalize()))
        };
        let mut longest_pixels: f64 = 0.0;
        for (column, row) in (0..960)
            .flat_map(|row| (0..1920).map(move |column| (column, row)))
            .step_by(7)
        {
            let (Some(here), Some(right), Some(below)) = (
                square(column, row),
                square(column + 1, row),
                square(column, row + 1),
            ) else {
                continue;
            };
            let level = (0..LEVELS).find(|level| {
                let at = (here * f64::from(TileKey::tiles_per_side(*level))).floor();
                tiles.contains(&TileKey {
                    level: *level,
                    x: at.x as u16,
                    y: at.y as u16,
                })
            });
            let level = level.expect("a tile");
            let texels = f64::from(TileKey::texels_per_side(level));
            let [across, down] = [right - here, below - here].map(|step| step * texels);
            // At a fold of the square a step goes elsewhere.
            if across.length().max(down.length()) > 10.0 {
                continue;
            }
            let sum = across.length_squared() + down.length_squared();
            let area = across.perp_dot(down);
            let smaller = (0.5 * (sum - (sum * sum - 4.0 * area * area).max(0.0).sqrt())).sqrt();
            longest_pixels = longest_pixels.max(smaller.recip());
        }
        // Tiles are judged in their middles.
        println!("{longest_pixels:.3}");
        assert!(
            longest_pixels < 1.08 * TEXEL_PIXELS_LONG_MAX,
            "{longest_pixels}"
        );
        assert!(
            longest_pixels > 0.9 * TEXEL_PIXELS_LONG_MAX,
            "{longest_pixels}"
        );
    }

    #[test]
    fn each_step_of_mip_bias_quarters_the_request() {
        let count =
            |bias| requested_tiles(&view(0.0, 45.0, 60.0, 1920, 1080), &sphere(), bias).len();
        assert!(count(0.0) > 3 * count(1.0));
    }

    #[test]
    fn nothing_below_the_horizon_is_requested() {
        assert!(requested_tiles(&view(0.0, -89.0, 40.0, 640, 360), &sphere(), 0.0).is_empty());
        let coarse = coarse_tiles(&sphere(), DVec3::new(0.0, 2.0, 0.0));
        assert!(coarse.len() < 25 && coarse.len() >= 12, "{}", coarse.len());
    }
}
