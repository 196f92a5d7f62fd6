//! The caches of a crowd without a device: what its viewers request, how texels age, how many would be marched.
//!
//! It drives the bookkeeping that the service runs, [`Caches`], as the frame loop does.

use crate::cache::{
    BYTES_PER_TEXEL, Caches, ProxySphere, SphereId, TEXELS_PER_TILE, TileRequest, coarse_tiles,
    requested_tiles,
};
use crate::cells::Cells;
use crate::composite::view_frustum;
use crate::march::{ActiveLayer, CellFrame, Surface, active_layers};
use glam::DVec3;
use rayon::prelude::*;
use skycell_protocol::{Camera, CellId, FrameSize, Moment, Scene, ViewerId};
use std::collections::BTreeMap;

/// As many tiles as slots can be told apart.
const TILES_MAX: u32 = 65_535;
/// An anchor farther from its cell's reference than this is given up, m, with all its texels, …
const ANCHOR_MAX_M: f64 = 4_000.0;
/// … and so is one that is above or below by this share of the height of the proxy sphere, as in the frame loop.
const ANCHOR_RISE_MAX: f64 = 0.5;

/// How viewers look and how texels are made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileSetup {
    /// Of a viewer's picture.
    pub size: FrameSize,
    /// Halvings of the cache's resolution below the screen's.
    pub mip_bias: f64,
    /// Samples of a texel.
    pub samples: u32,
    /// Tiles that may be marched in a second.
    pub tiles_per_s: f64,
}

/// Where a cell's texels are addressed from: the same for all layers when it begins.
struct Anchored {
    frame: CellFrame,
    at_start_m: DVec3,
    drifts_at_start_m: Vec<DVec3>,
}

/// Sums over a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TileSums {
    /// Tiles marched, one sample each.
    pub marched: u64,
    /// Looks at the caches at which the budget was spent with work left.
    pub short_looks: u64,
    /// Looks at the caches.
    pub looks: u64,
    /// Viewers below the clouds, who read a cache, summed over looks.
    pub readers: u64,
    /// Viewers in or above the clouds, who have rays of their own, summed over looks.
    pub others: u64,
    /// Tiles requested, summed over viewers and looks.
    pub requested: u64,
    /// The same, each tile of a cell once.
    pub unique: u64,
    /// Caches that began anew because their anchor was too far from the reference.
    pub new_anchors: u64,
    /// The most tiles that were held.
    pub resident_most: u32,
}

impl TileSums {
    /// Texels of tiles.
    #[must_use]
    pub fn texels(tiles: u64) -> u64 {
        tiles * TEXELS_PER_TILE
    }

    /// Memory of the most tiles that were held, bytes.
    #[must_use]
    pub fn bytes_most(&self) -> u64 {
        Self::texels(u64::from(self.resident_most)) * BYTES_PER_TEXEL
    }
}

/// The caches of all cells of a crowd.
pub struct CrowdTiles<'a> {
    scene: &'a Scene,
    setup: TileSetup,
    layers: Vec<ActiveLayer>,
    lowest_base_m: f64,
    caches: Caches,
    anchored: BTreeMap<CellId, Anchored>,
    sums: TileSums,
}

impl<'a> CrowdTiles<'a> {
    /// Without anybody.
    #[must_use]
    pub fn new(scene: &'a Scene, setup: TileSetup) -> Self {
        let layers = active_layers(scene);
        let bases = layers
            .iter()
            .map(|layer| scene.layers()[layer.scene_index].base_altitude_m());
        Self {
            lowest_base_m: bases.fold(f64::INFINITY, f64::min),
            scene,
            setup,
            layers,
            caches: Caches::new(TILES_MAX, setup.samples),
            anchored: BTreeMap::new(),
            sums: TileSums::default(),
        }
    }

    /// What was counted so far.
    #[must_use]
    pub fn sums(&self) -> TileSums {
        self.sums
    }

    /// Brings all caches to where viewers look now, and marches for `passed_s`. Returns the tiles that were marched.
    pub fn look(
        &mut self,
        cells: &Cells,
        cameras: &[(ViewerId, Camera)],
        passed_s: f64,
        time_s: f64,
    ) -> u64 {
        let drifts = self.drifts_m(time_s);
        self.anchor(cells, &drifts);
        self.request(cells, cameras, &drifts);
        let references: BTreeMap<SphereId, DVec3> = self
            .anchored
            .keys()
            .filter_map(|id| Some((*id, cells.get(*id)?.reference_m)))
            .flat_map(|(cell, reference_m)| {
                (0..).zip(&drifts).map(move |(proxy, drift)| {
                    (SphereId { cell, proxy }, reference_m - drift.with_y(0.0))
                })
            })
            .collect();
        let budget = (self.setup.tiles_per_s * passed_s).ceil().max(1.0) as usize;
        let at = |sphere: SphereId| references.get(&sphere).copied();
        let mut marched = 0;
        // A tile takes one sample a plan, as it takes one a batch.
        while marched < budget {
            let updates = self.caches.plan(budget - marched, at).len();
            if updates == 0 {
                break;
            }
            marched += updates;
        }
        for cell in self.anchored.keys() {
            self.caches.frame_shown(*cell);
        }
        self.sums.marched += marched as u64;
        self.sums.short_looks += u64::from(marched >= budget);
        self.sums.looks += 1;
        self.sums.resident_most = self.sums.resident_most.max(self.caches.resident());
        marched as u64
    }

    /// Where the wind has carried each active layer.
    fn drifts_m(&self, time_s: f64) -> Vec<DVec3> {
        let now = Moment::UNIX_EPOCH.plus_s(time_s);
        let carried = self.scene.carried_by(self.scene.layers(), now);
        self.layers
            .iter()
            .map(|layer| carried[layer.scene_index])
            .collect()
    }

    /// Cells that have come get anchors, those that have gone lose theirs, and what is too far off begins anew.
    fn anchor(&mut self, cells: &Cells, drifts: &[DVec3]) {
        let gone: Vec<CellId> = self
            .anchored
            .keys()
            .filter(|id| cells.get(**id).is_none_or(|cell| cell.members.is_empty()))
            .copied()
            .collect();
        for id in gone {
            self.anchored.remove(&id);
            self.caches.remove_cell(id);
        }
        let planet_radius_m = self.scene.planet().radius_m();
        for (id, cell) in cells.iter().filter(|(_, cell)| !cell.members.is_empty()) {
            let is_far = self
                .anchored
                .get(&id)
                .is_some_and(|anchored| self.is_far(anchored, cell.reference_m, drifts));
            if is_far {
                self.sums.new_anchors += 1;
                self.caches.remove_cell(id);
            }
            if is_far || !self.anchored.contains_key(&id) {
                let anchored = Anchored {
                    frame: CellFrame::at(cell.reference_m, planet_radius_m),
                    at_start_m: cell.reference_m,
                    drifts_at_start_m: drifts.to_vec(),
                };
                self.anchored.insert(id, anchored);
            }
        }
    }

    fn is_far(&self, anchored: &Anchored, reference_m: DVec3, drifts: &[DVec3]) -> bool {
        self.layers.iter().enumerate().any(|(index, layer)| {
            let off_m = anchored.anchor_m(index, drifts) - reference_m;
            let height_m = (layer.proxy_altitude_m - reference_m.y).abs().max(100.0);
            off_m.with_y(0.0).length() > ANCHOR_MAX_M
                || (reference_m.y < self.lowest_base_m
                    && off_m.y.abs() > ANCHOR_RISE_MAX * height_m)
        })
    }

    /// Tells all caches what their cells' viewers want.
    fn request(&mut self, cells: &Cells, cameras: &[(ViewerId, Camera)], drifts: &[DVec3]) {
        let mut spheres: BTreeMap<CellId, Vec<ProxySphere>> = BTreeMap::new();
        for (id, anchored) in &self.anchored {
            if let Some(cell) = cells.get(*id) {
                let of_layers = self.layers.iter().enumerate();
                let of_layers = of_layers.map(|(index, layer)| {
                    let between = &self.scene.layers()[layer.scene_index];
                    ProxySphere {
                        frame: anchored.frame,
                        anchor: anchored.frame.from_world(anchored.anchor_m(index, drifts)),
                        surface: Surface::Shell {
                            altitude_m: layer.proxy_altitude_m,
                        },
                        reference: anchored.frame.from_world(cell.reference_m),
                        top_m: None,
                        seen_between_m: Some([between.base_altitude_m(), between.top_altitude_m()]),
                        band: None,
                    }
                });
                spheres.insert(*id, of_layers.collect());
            }
        }
        let TileSetup { size, mip_bias, .. } = self.setup;
        let lowest_base_m = self.lowest_base_m;
        type Requests = (CellId, Vec<Vec<TileRequest>>);
        let requests: Vec<Requests> = cameras
            .par_iter()
            .filter(|(_, camera)| camera.position_m()[1] < lowest_base_m)
            .filter_map(|(viewer, camera)| {
                let cell = cells.cell_of(*viewer)?;
                let spheres = spheres.get(&cell)?;
                let frustum = view_frustum(camera, size, &spheres.first()?.frame);
                let tiles = spheres.iter();
                let tiles = tiles.map(|sphere| requested_tiles(&frustum, sphere, mip_bias));
                Some((cell, tiles.collect()))
            })
            .collect();
        self.sums.readers += requests.len() as u64;
        self.sums.others += (cameras.len() - requests.len()) as u64;
        let mut of_cells: BTreeMap<CellId, Vec<&Vec<Vec<TileRequest>>>> = BTreeMap::new();
        for (cell, tiles) in &requests {
            of_cells.entry(*cell).or_default().push(tiles);
        }
        for (id, spheres) in &spheres {
            let Some(cell) = cells.get(*id) else {
                continue;
            };
            let readers = of_cells.get(id).map_or(&[][..], Vec::as_slice);
            for (index, sphere) in spheres.iter().enumerate() {
                let eye = sphere.frame.from_world(cell.reference_m);
                // Nobody who reads the cache: nobody who needs its coarse level.
                let coarse = if readers.is_empty() {
                    Vec::new()
                } else {
                    coarse_tiles(sphere, eye)
                };
                let cache = self.caches.sphere_mut(SphereId {
                    cell: *id,
                    proxy: index as u32,
                });
                cache.set_evolved(drifts[index].y);
                let course = -drifts[index].with_y(0.0).normalize_or_zero();
                cache.set_drifts(drifts[index] != DVec3::ZERO, course);
                cache.set_wanted(&coarse, readers.iter().flat_map(|tiles| &tiles[index]));
                let (requested, unique) = cache.requested_and_unique();
                self.sums.requested += requested;
                self.sums.unique += unique;
            }
        }
    }
}

impl Anchored {
    /// Anchor of a layer by now, which follows its wind: x, altitude, z.
    fn anchor_m(&self, layer: usize, drifts: &[DVec3]) -> DVec3 {
        self.at_start_m + (drifts[layer] - self.drifts_at_start_m[layer]).with_y(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::CellLimit;

    fn setup() -> TileSetup {
        TileSetup {
            size: FrameSize::new(320, 180).expect("a size"),
            mip_bias: 1.0,
            samples: 8,
            tiles_per_s: 1e6,
        }
    }

    /// Viewers who look the same way at places along a line, for a while, under no wind.
    fn sums_of(xs: &[f64], looks: u32) -> TileSums {
        let document = serde_json::json!({"version": 1, "wind": {"speed_m_per_s": 0}});
        let scene = Scene::from_json(&document).expect("a scene");
        let mut tiles = CrowdTiles::new(&scene, setup());
        let mut cells = Cells::new(&[], CellLimit::default());
        let mut cameras = Vec::new();
        for (id, x) in (1..).map(ViewerId).zip(xs) {
            cells.place(id, DVec3::new(*x, 2.0, 0.0));
            let camera = Camera::new([*x, 2.0, 0.0], 30.0, 20.0, 60.0).expect("a camera");
            cameras.push((id, camera));
        }
        for look in 0..looks {
            tiles.look(&cells, &cameras, 0.5, f64::from(look) * 0.5);
        }
        tiles.sums()
    }

    #[test]
    fn viewers_at_one_place_are_marched_for_once_and_those_far_apart_for_each() {
        let [one, same, apart] = [&[0.0][..], &[0.0; 5], &[0.0, 1e5, 2e5]].map(|xs| sums_of(xs, 3));
        assert_eq!(one.marched, same.marched);
        assert_eq!(5 * one.requested, same.requested);
        assert_eq!(3 * one.marched, apart.marched);
        assert!(one.marched > 0);
    }

    #[test]
    fn a_sky_in_which_nothing_changes_is_marched_once() {
        let [short, long] = [2, 20].map(|looks| sums_of(&[0.0, 100.0], looks));
        assert_eq!(short.marched, long.marched);
        // All samples of what is wanted, one of the coarse level that nobody sees.
        let wanted = 8 * long.unique / 20;
        assert!(
            (wanted..wanted + 50).contains(&long.marched),
            "{} of {wanted}",
            long.marched
        );
    }
}
