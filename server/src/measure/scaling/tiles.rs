//! The caches of a crowd without a device: what its viewers request, how texels age, how many would be marched.
//!
//! It drives the bookkeeping that the service runs, [`Caches`], as the frame loop does.

use crate::cache::{
    BYTES_PER_TEXEL, Band, Caches, ProxySphere, SphereId, TEXELS_PER_TILE, TileRequest,
    coarse_tiles, requested_tiles,
};
use crate::cells::Cells;
use crate::composite::view_frustum;
use crate::march::{
    CellFrame, Proxy, ProxySettings, Side, active_layers, anchor_off_max_m, proxies_of,
};
use glam::DVec3;
use rayon::prelude::*;
use skycell_protocol::{Camera, CellId, FrameSize, Moment, Scene, ViewerId};
use std::collections::BTreeMap;

/// As many tiles as slots can be told apart.
const TILES_MAX: u32 = 65_535;
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

/// Where a cell's texels are addressed from: the same for all proxies when it begins.
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
    /// Viewers who read a cache, summed over looks.
    pub readers: u64,
    /// Those of them who are in a layer, the near part of which their own rays go through.
    pub within: u64,
    /// Viewers who are not where their cell's rays start, below, in or above a layer, and have rays of their own, summed over
    /// looks.
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
    proxies: Vec<Proxy>,
    caches: Caches,
    anchored: BTreeMap<CellId, Anchored>,
    sums: TileSums,
}

impl<'a> CrowdTiles<'a> {
    /// Without anybody.
    #[must_use]
    pub fn new(scene: &'a Scene, setup: TileSetup) -> Self {
        Self {
            proxies: proxies_of(scene, &active_layers(scene), &ProxySettings::default()),
            scene,
            setup,
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

    /// Where the wind has carried each proxy.
    fn drifts_m(&self, time_s: f64) -> Vec<DVec3> {
        let now = Moment::UNIX_EPOCH.plus_s(time_s);
        let carried = self.scene.carried_by(self.scene.layers(), now);
        self.proxies
            .iter()
            .map(|proxy| carried[proxy.scene_index])
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
        self.proxies.iter().enumerate().any(|(index, proxy)| {
            let anchor_m = anchored.anchor_m(index, drifts);
            let off_m = anchor_m - reference_m;
            let [aside_max_m, rise_max_m] =
                anchor_off_max_m(proxy.layer_m, proxy.altitude_m, reference_m.y, true);
            let side = |place_m: DVec3| Side::of(proxy.layer_m, place_m.y);
            off_m.with_y(0.0).length() > aside_max_m
                || off_m.y.abs() > rise_max_m
                || side(anchor_m) != side(reference_m)
        })
    }

    /// Tells all caches what their cells' viewers want.
    fn request(&mut self, cells: &Cells, cameras: &[(ViewerId, Camera)], drifts: &[DVec3]) {
        let mut spheres: BTreeMap<CellId, Vec<ProxySphere>> = BTreeMap::new();
        for (id, anchored) in &self.anchored {
            if let Some(cell) = cells.get(*id) {
                let places = self.proxies.iter().enumerate();
                let of_proxies = places.map(|(index, proxy)| {
                    let frame = anchored.frame;
                    let anchor = frame.from_world(anchored.anchor_m(index, drifts));
                    let band_m = proxy.band_m(&frame, anchor);
                    ProxySphere {
                        frame,
                        anchor,
                        surface: proxy.surface(&frame, anchor),
                        reference: frame.from_world(cell.reference_m),
                        top_m: proxy
                            .is_from_above(&frame, anchor)
                            .then_some(proxy.between_m[1]),
                        seen_between_m: Some(proxy.seen_between_m),
                        band: band_m.map(|distances_m| Band {
                            altitudes_m: proxy.altitudes_m(&frame, anchor),
                            distances_m,
                        }),
                    }
                });
                spheres.insert(*id, of_proxies.collect());
            }
        }
        let TileSetup { size, mip_bias, .. } = self.setup;
        type Requests = (CellId, Vec<Vec<TileRequest>>);
        let requests: Vec<Requests> = cameras
            .par_iter()
            .filter_map(|(viewer, camera)| {
                let cell = cells.cell_of(*viewer)?;
                let eye_m = DVec3::from_array(camera.position_m());
                let holds = cells.get(cell)?.reference_m;
                if !cells.limit().share_storey(eye_m, holds) {
                    return None;
                }
                let spheres = spheres.get(&cell)?;
                let frustum = view_frustum(camera, size, &spheres.first()?.frame);
                let tiles = spheres.iter();
                let tiles = tiles.map(|sphere| requested_tiles(&frustum, sphere, mip_bias));
                Some((cell, tiles.collect()))
            })
            .collect();
        self.sums.readers += requests.len() as u64;
        let is_within = |camera: &Camera| {
            let mut layers_m = self.proxies.iter().map(|proxy| proxy.layer_m);
            layers_m.any(|between_m| Side::of(between_m, camera.position_m()[1]) == Side::Within)
        };
        let within = cameras.iter().filter(|(_, camera)| is_within(camera));
        self.sums.within += within.count() as u64;
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
    /// Anchor of a proxy by now, which follows its layer's wind: x, altitude, z.
    fn anchor_m(&self, proxy: usize, drifts: &[DVec3]) -> DVec3 {
        self.at_start_m + (drifts[proxy] - self.drifts_at_start_m[proxy]).with_y(0.0)
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
    fn who_is_above_or_in_the_clouds_reads_a_cache_as_who_is_below_does() {
        for (altitude_m, within) in [(2.0, 0), (2_000.0, 3), (12_000.0, 0)] {
            let document = serde_json::json!({"version": 1, "wind": {"speed_m_per_s": 0}});
            let scene = Scene::from_json(&document).expect("a scene");
            let mut tiles = CrowdTiles::new(&scene, setup());
            let mut cells = Cells::new(&[], CellLimit::default());
            let id = ViewerId(1);
            cells.place(id, DVec3::new(0.0, altitude_m, 0.0));
            let camera = Camera::new([0.0, altitude_m, 0.0], 30.0, -10.0, 60.0).expect("a camera");
            for _ in 0..3 {
                tiles.look(&cells, &[(id, camera)], 0.5, 0.0);
            }
            let sums = tiles.sums();
            assert_eq!([sums.readers, sums.within, sums.others], [3, within, 0]);
            assert!(sums.marched > 0, "at {altitude_m} m");
        }
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
