//! View cells on the device: their frames, anchors and buffers, and what their caches are told.

use super::metering::Meter;
use super::renderer::SkyRenderer;
use super::viewers_on_device::ActiveViewer;
use crate::cache::{
    Band, LAG_RAD, ProxySphere, SphereId, TexelSamples, TileRequest, Wish, coarse_tiles, coarsened,
    requested_by_eyes, requested_tiles,
};
use crate::composite::view_frustum;
use crate::march::{
    ActiveLayer, CellBuffers, CellFrame, MarchSettings, PROXIES_MAX, Proxy, REACH_M, Side,
    anchor_off_max_m, drift_m_per_s, scene_uniform,
};
use glam::DVec3;
use skycell_protocol::{Camera, CellId, Scene, ViewerId};
use std::time::{Duration, Instant};

/// Under wind tiles move past the viewers; what they need is looked up this often. At 50 m/s that is 2.5 m.
const REQUESTS_INTERVAL: Duration = Duration::from_millis(50);
/// Where ages of tiles are looked at, tables tell them this often.
const AGES_INTERVAL: Duration = Duration::from_millis(500);

/// Base and top of a layer that are this far apart in a viewer's picture and no farther look as they do from the reference,
/// pixels.
const PARALLAX_PIXELS: f64 = 1.0;
/// The same where wind carries the clouds past all viewers: their edges move by it to and fro.
const WIND_PIXELS: f64 = 0.25;
/// Layers are not looked at from nearer, m.
const LAYER_NEAREST_M: f64 = 10.0;
/// A reference that is late goes 63 % of its way in this time, s, ...
const FOLLOW_TIME_S: f64 = 2.0;
/// ... until it is so near, m.
const ARRIVED_M: f64 = 20.0;

/// Frames of a cell whose caches have just begun wait this long for the coarse level at most: no cloudless sky flashes.
const COARSE_WAIT: Duration = Duration::from_millis(500);

/// How often wishes are told the caches in a turn at most: as they are, counted, and as they fit.
const TELLINGS_MAX: u32 = 3;

/// Where a layer's addresses are centred: follows the layer's wind.
#[derive(Clone, Copy, Debug)]
pub(super) struct Anchor {
    pub(super) at_start_m: DVec3,
    drift_at_start_m: DVec3,
}

/// A cell with members, on the device.
pub(super) struct ActiveCell {
    pub(super) frame: CellFrame,
    pub(super) reference_m: DVec3,
    pub(super) anchors: Vec<Anchor>,
    coarse: Vec<Vec<TileRequest>>,
    pub(super) buffers: CellBuffers,
    /// How its rays are marched.
    pub(super) settings: MarchSettings,
    /// Jittered samples that its texels average.
    pub(super) samples: TexelSamples,
    /// When its caches began.
    begun: Instant,
    /// Requests or reference have changed since the caches were told.
    requests_changed: bool,
    /// When the tiles were last looked up for where the wind has carried them.
    looked_up: Instant,
    /// When page tables last told how old tiles are.
    ages_written: Instant,
    /// Measures the light of the sky, where exposure follows it.
    pub(super) meter: Option<Meter>,
    /// Tiles that its viewers ask for.
    pub(super) wish: Wish,
    /// Levels that it has lost because memory or time do not suffice.
    pub(super) lost: u8,
    /// Where rays started before the reference last moved.
    pub(super) came_from_m: DVec3,
    /// The reference has stood still while it should have moved, and follows.
    pub(super) is_late: bool,
    /// How far what its texels show may be seen from elsewhere than the reference because of the wind, rad.
    wind_lag_rad: f64,
    /// That of its viewers' pictures, as the shaders have it.
    pub(super) exposure: f32,
    /// Of a cell that is shown as it was before it became another: which one, and its exposure.
    pub(super) stands_for: Option<(CellId, f64)>,
}

impl ActiveCell {
    /// Goes on as another one did, but for where its texels are.
    pub(super) fn take_over(&mut self, before: &mut Self) {
        self.settings = before.settings;
        self.samples = before.samples;
        self.lost = before.lost;
        self.begun = before.begun;
        // Eyes stay used to the light.
        self.meter = before.meter.take();
    }

    /// Anchor of a layer in the frame that drifts with it, where it stays.
    pub(super) fn drifting_anchor(&self, layer: usize) -> Option<DVec3> {
        let anchor = self.anchors.get(layer)?;
        Some(anchor.at_start_m - anchor.drift_at_start_m.with_y(0.0))
    }

    /// Moves where rays start: at once, or where it is late by and by.
    fn follow(&mut self, reference_m: DVec3, passed_s: f64, is_through_layer: bool) {
        // What was seen from the other side of a layer is of no use here.
        self.is_late &= !is_through_layer;
        self.came_from_m = self.reference_m;
        self.is_late &= self.reference_m.distance(reference_m) > ARRIVED_M;
        if self.is_late {
            let share = 1.0 - (-passed_s / FOLLOW_TIME_S).exp();
            self.reference_m = self.reference_m.lerp(reference_m, share);
        } else {
            self.reference_m = reference_m;
        }
    }

    /// Goes on as what a cell was before it became another one.
    pub(super) fn stand_for(&mut self, id: CellId, exposure_ev: f64) {
        self.meter = None;
        self.stands_for = Some((id, exposure_ev));
        self.requests_changed = true;
    }
}

/// Most places at which an eye of a viewer of a cell looks for what texels show: none where what it sees would not be told apart from
/// what the reference sees.
pub(super) fn parallax_steps(
    scene: &Scene,
    active: &[ActiveLayer],
    domes: bool,
    viewer: &ActiveViewer,
    eye: &Camera,
    cell: &ActiveCell,
) -> u32 {
    let reference_m = cell.reference_m;
    let eye_m = DVec3::from_array(eye.position_m());
    // A dome keeps what was marched from about its anchor while the reference goes on.
    let anchor_m = cell.anchors.first().filter(|_| domes);
    let away_m = anchor_m
        .map_or(0.0, |anchor| anchor.at_start_m.distance(eye_m))
        .max(reference_m.distance(eye_m));
    let pixel_rad = 2.0 * (eye.vertical_fov_deg().to_radians() / 2.0).tan()
        / f64::from(viewer.view.size.height());
    let is_seen = active.iter().any(|layer| {
        let layer = &scene.layers()[layer.scene_index];
        let between_m = [layer.base_altitude_m(), layer.top_altitude_m()];
        if !domes && Side::of(between_m, reference_m.y) == Side::Within {
            // The far part is between where it begins and the end of the world.
            return away_m / REACH_M > PARALLAX_PIXELS * pixel_rad;
        }
        let [base_m, top_m] =
            between_m.map(|altitude_m| (altitude_m - reference_m.y).abs().max(LAYER_NEAREST_M));
        // A shell is in the layer; a dome is as far as the sky anywhere.
        let between_per_m = if domes {
            1.0 / base_m.min(top_m)
        } else {
            (1.0 / base_m - 1.0 / top_m).abs()
        };
        // Seen from what hangs lowest, the wind's lag is an angle.
        let wind_rad = cell.wind_lag_rad * base_m.min(top_m) * between_per_m;
        away_m * between_per_m > PARALLAX_PIXELS * pixel_rad || wind_rad > WIND_PIXELS * pixel_rad
    });
    if is_seen {
        viewer.quality.settings.parallax_steps
    } else {
        0
    }
}

impl SkyRenderer {
    pub(super) fn new_active_cell(&self, reference_m: DVec3) -> ActiveCell {
        let anchors = self
            .active
            .iter()
            .map(|layer| Anchor {
                at_start_m: reference_m,
                drift_at_start_m: self.drifts[layer.scene_index],
            })
            .collect();
        ActiveCell {
            frame: CellFrame::at(reference_m, self.scene.planet().radius_m()),
            reference_m,
            anchors,
            coarse: Vec::new(),
            buffers: CellBuffers::new(&self.gpu, &self.pipelines, &self.field.bind_group),
            settings: self.settings,
            samples: self.caches.samples(),
            begun: Instant::now(),
            requests_changed: true,
            looked_up: Instant::now(),
            ages_written: Instant::now(),
            meter: None,
            wish: Wish::default(),
            lost: 0,
            came_from_m: reference_m,
            is_late: false,
            wind_lag_rad: 0.0,
            exposure: 1.0,
            stands_for: None,
        }
    }

    pub(super) fn restart_cell(&mut self, id: CellId) {
        self.caches.remove_cell(id);
        if let Some(cell) = self.active_cells.get(&id) {
            let reference_m = cell.reference_m;
            let mut fresh = self.new_active_cell(reference_m);
            // Eyes stay used to the light.
            if let Some(cell) = self.active_cells.get_mut(&id) {
                fresh.meter = cell.meter.take();
            }
            self.active_cells.insert(id, fresh);
        }
        // What they ask for is told by places about the old anchor.
        for viewer in self.viewers.values_mut().filter(|v| v.needs(id)) {
            viewer.forget_requests();
        }
    }

    /// Gives a cell's layers their places: those that were there before keep their anchors.
    pub(super) fn keep_anchors(&self, cell: &mut ActiveCell, kept: &[Option<usize>]) {
        cell.anchors = self
            .active
            .iter()
            .zip(kept)
            .map(|(layer, kept)| {
                kept.and_then(|place| cell.anchors.get(place).copied())
                    .unwrap_or(Anchor {
                        at_start_m: cell.reference_m,
                        drift_at_start_m: self.drifts[layer.scene_index],
                    })
            })
            .collect();
        cell.coarse.clear();
        cell.requests_changed = true;
    }

    pub(super) fn touch_all_requests(&mut self) {
        for cell in self.active_cells.values_mut() {
            cell.requests_changed = true;
        }
    }

    /// How far what texels show may be seen from elsewhere than the reference because of the wind, rad; nothing where viewers do
    /// not search for it.
    fn wind_lag_rad(&self) -> f64 {
        if self.is_living && self.wind_is_searched && self.wind_speed_max_m_per_s() > 0.0 {
            LAG_RAD
        } else {
            0.0
        }
    }

    /// What viewers need is looked up again, where the wind has carried it by now.
    pub(super) fn look_up_all(&mut self) {
        for cell in self.active_cells.values_mut() {
            cell.coarse.clear();
            cell.requests_changed = true;
        }
    }

    /// Says where a viewer's camera is; returns its cell, which is on the device from now on.
    pub(super) fn place(&mut self, viewer: ViewerId, camera: &Camera) -> CellId {
        let position_m = DVec3::from_array(camera.position_m());
        self.tell_storeys();
        let id = self.cells.place(viewer, position_m);
        if !self.active_cells.contains_key(&id)
            && let Some(cell) = self.cells.get(id)
        {
            let cell = self.new_active_cell(cell.reference_m);
            self.active_cells.insert(id, cell);
        }
        id
    }

    /// Brings cells to where their viewers are; returns those who are in another cell than before.
    pub(super) fn regroup(&mut self, passed_s: f64) -> Vec<ViewerId> {
        self.tell_storeys();
        let changes = self.cells.regroup(passed_s);
        for change in &changes {
            self.follow_cell(change.viewer);
            self.change_requests(change.from);
            self.change_requests(change.to);
        }
        let references: Vec<(CellId, DVec3)> = self
            .cells
            .iter()
            .filter(|(_, cell)| !cell.members.is_empty())
            .map(|(id, cell)| (id, cell.reference_m))
            .collect();
        let limit = self.cells.limit();
        for (id, reference_m) in references {
            if self.holds_reference(id, reference_m) {
                if let Some(cell) = self.active_cells.get_mut(&id) {
                    cell.is_late = true;
                }
                continue;
            }
            if self.let_go(id, reference_m) {
                continue;
            }
            let stays = self.dome_stays(id, reference_m);
            match self.active_cells.get_mut(&id) {
                Some(_) if stays => {}
                Some(cell) if cell.reference_m != reference_m => {
                    let is_through_layer = !limit.share_storey(cell.reference_m, reference_m);
                    cell.follow(reference_m, passed_s, is_through_layer);
                    cell.coarse.clear();
                    cell.requests_changed = true;
                }
                Some(_) => {}
                None => {
                    let cell = self.new_active_cell(reference_m);
                    self.active_cells.insert(id, cell);
                }
            }
        }
        if !changes.is_empty() {
            self.end_empty_cells();
        }
        changes.into_iter().map(|change| change.viewer).collect()
    }

    pub(super) fn end_empty_cells(&mut self) {
        let ended: Vec<CellId> = self
            .active_cells
            .keys()
            .filter(|id| {
                let cell = self.cells.get(**id);
                cell.is_none_or(|cell| cell.members.is_empty())
                    && !self.viewers.values().any(|viewer| viewer.needs(**id))
            })
            .copied()
            .collect();
        for id in ended {
            self.active_cells.remove(&id);
            self.caches.remove_cell(id);
            self.shafts.remove_cell(id);
        }
        self.atlas.fit(&self.gpu, self.caches.slots_needed());
    }

    pub(super) fn change_requests(&mut self, cell: CellId) {
        if let Some(cell) = self.active_cells.get_mut(&cell) {
            cell.requests_changed = true;
        }
    }

    pub(super) fn anchor_m(&self, cell: &ActiveCell, layer: usize) -> DVec3 {
        let anchor = cell.anchors[layer];
        let drift = self.drifts[self.active[layer].scene_index] - anchor.drift_at_start_m;
        cell.frame.from_world(anchor.at_start_m + drift.with_y(0.0))
    }

    /// Where a proxy's texels lie in a cell.
    pub(super) fn sphere_of(&self, cell: &ActiveCell, proxy: &Proxy) -> ProxySphere {
        let anchor = self.anchor_m(cell, proxy.layer);
        let distances_m = proxy.band_m(&cell.frame, anchor);
        ProxySphere {
            frame: cell.frame,
            anchor,
            surface: proxy.surface(&cell.frame, anchor),
            top_m: proxy
                .is_from_above(&cell.frame, anchor)
                .then_some(proxy.between_m[1]),
            reference: cell.frame.from_world(cell.reference_m),
            seen_between_m: None,
            band: distances_m.map(|distances_m| Band {
                altitudes_m: proxy.altitudes_m(&cell.frame, anchor),
                distances_m,
            }),
        }
    }

    /// Reference point of a sphere in the frame that drifts with its layer.
    pub(super) fn drifting_reference(&self, sphere: SphereId) -> Option<DVec3> {
        let cell = self.active_cells.get(&sphere.cell)?;
        let proxy = self.proxies.get(sphere.proxy as usize)?;
        Some(cell.reference_m - self.drifts[proxy.scene_index].with_y(0.0))
    }

    /// Anchor of a sphere in the frame that drifts with its layer, where it stays.
    pub(super) fn drifting_anchor(&self, sphere: SphereId) -> Option<DVec3> {
        let cell = self.active_cells.get(&sphere.cell)?;
        cell.drifting_anchor(self.proxies.get(sphere.proxy as usize)?.layer)
    }

    /// Brings everything that the caches and the device know of cells up to the present: anchors that have drifted,
    /// requests of viewers that have turned, new page tables.
    pub(super) fn refresh_cells(&mut self) {
        let ids =
            |renderer: &Self| -> Vec<CellId> { renderer.active_cells.keys().copied().collect() };
        let windy = self.wind_speed_max_m_per_s() > 0.0;
        for id in ids(self) {
            if self.anchors_are_far(id) {
                self.reanchor_cell(id);
            }
        }
        // Among them what is still shown of those that have new anchors.
        let mut outdated = ids(self);
        // Wishes are told; where they have to be counted or do not fit, they are told again.
        for _ in 0..TELLINGS_MAX {
            for id in std::mem::take(&mut outdated) {
                let Some(mut cell) = self.active_cells.remove(&id) else {
                    continue;
                };
                self.refresh_cell(id, &mut cell, windy);
                self.active_cells.insert(id, cell);
            }
            outdated = self.fit_memory();
            if outdated.is_empty() {
                break;
            }
        }
    }

    /// Whether texels of a cell no longer have even sizes for its viewers.
    fn anchors_are_far(&self, id: CellId) -> bool {
        let Some(cell) = self.active_cells.get(&id) else {
            return false;
        };
        let reference = cell.frame.from_world(cell.reference_m);
        let mut in_cell = self
            .viewers
            .values()
            .filter(|viewer| viewer.cell == id)
            .peekable();
        // What is kept for those who leave it stays as they see it.
        if in_cell.peek().is_none() {
            return false;
        }
        // Those with rays of their own have windows that a new frame of the cell would end.
        let is_read = in_cell.any(ActiveViewer::reads_cache);
        self.active.iter().enumerate().any(|(place, layer)| {
            let off = self.anchor_m(cell, place) - reference;
            let altitude_m = cell.frame.altitude_m(reference);
            let shell = &self.scene.layers()[layer.scene_index];
            let between_m = [shell.base_altitude_m(), shell.top_altitude_m()];
            let of_shells_m = anchor_off_max_m(
                between_m,
                layer.proxy_altitude_m,
                altitude_m,
                self.keeps_far_parts(),
            );
            let [aside_max_m, rise_max_m] = self.anchors_may_be_off(cell, of_shells_m);
            off.with_y(0.0).length() > aside_max_m
                || (is_read && off.y.abs() > rise_max_m)
                || (is_read && !self.is_anchored_aright(cell, place))
        })
    }

    pub(super) fn refresh_cell(&mut self, id: CellId, cell: &mut ActiveCell, windy: bool) {
        let anchors: Vec<DVec3> = (0..self.active.len())
            .map(|layer| self.anchor_m(cell, layer))
            .collect();
        if cell.requests_changed {
            self.refresh_cell_settings(id, cell);
        }
        cell.wind_lag_rad = self.wind_lag_rad();
        let mut uniform = scene_uniform(
            &self.scene,
            &self.active,
            &self.light,
            cell.settings,
            &cell.frame,
            &self.drifts,
        );
        for (place, proxy) in self.proxies.iter().enumerate().take(PROXIES_MAX) {
            uniform.proxies[place] = proxy.uniform(&cell.frame, anchors[proxy.layer]);
        }
        uniform.exposure *= cell.auto_exposure_ev().exp2() as f32;
        cell.exposure = uniform.exposure;
        cell.buffers.set_scene(&self.gpu, &uniform);
        let drifted = windy && cell.looked_up.elapsed() >= REQUESTS_INTERVAL;
        if cell.requests_changed || drifted {
            cell.looked_up = Instant::now();
            let eye = cell.frame.from_world(cell.reference_m);
            cell.buffers.set_reference(&self.gpu, eye);
            let spheres: Vec<ProxySphere> = self
                .proxies
                .iter()
                .map(|proxy| self.sphere_of(cell, proxy))
                .collect();
            // Where layers are on domes, nothing is kept of one in which rays start.
            let sides = self.sides_at(cell.reference_m.y);
            let holds: Vec<bool> = self
                .proxies
                .iter()
                .map(|proxy| {
                    self.keeps_far_parts() || sides.get(proxy.layer) != Some(&Side::Within)
                })
                .collect();
            // By drift, or because the reference has moved.
            let moved = drifted || cell.coarse.len() != spheres.len();
            if moved {
                let coarse = spheres.iter().zip(&holds);
                cell.coarse = coarse
                    .map(|(sphere, holds)| {
                        if *holds {
                            coarse_tiles(sphere, eye)
                        } else {
                            Vec::new()
                        }
                    })
                    .collect();
            }
            let wait_share = self.wait_share(id);
            let mut read: Vec<&[Vec<TileRequest>]> = Vec::new();
            // How many pixels the picture of each of them has.
            let mut pixels = Vec::new();
            for viewer in self.viewers.values_mut() {
                let size = viewer.view.size;
                // Of one eye: the other sees almost the same.
                let picture_pixels = u64::from(size.pixels());
                let mip_bias = viewer.quality.settings.mip_bias;
                let domes = self.kept_on.has_domes();
                // Each eye, and whether it searches.
                let steps = |eye: &Camera| {
                    parallax_steps(&self.scene, &self.active, domes, viewer, eye, cell)
                };
                let eyes = viewer.view.eyes();
                let eyes: Vec<(Camera, bool)> =
                    eyes.iter().map(|eye| (*eye, steps(eye) > 0)).collect();
                // Who has jumped is shown what is there until the new cell has more.
                let has_jumped = viewer.has_jumped_from(id);
                let Some(requests) = viewer.requests_in(id) else {
                    continue;
                };
                if has_jumped {
                    *requests = vec![Vec::new(); spheres.len()];
                } else if moved || requests.len() != spheres.len() {
                    *requests = spheres
                        .iter()
                        .zip(&self.proxies)
                        .zip(&holds)
                        .map(|((sphere, proxy), holds)| {
                            if !holds {
                                return Vec::new();
                            }
                            requested_by_eyes(eyes.iter().map(|(eye, searches)| {
                                let sphere = ProxySphere {
                                    seen_between_m: searches.then_some(proxy.seen_between_m),
                                    ..*sphere
                                };
                                let frustum = view_frustum(eye, size, &cell.frame);
                                requested_tiles(&frustum, &sphere, mip_bias)
                            }))
                        })
                        .collect();
                }
                read.push(requests);
                pixels.push(picture_pixels);
            }
            // Nobody who reads the cache: nobody who needs its coarse level.
            let used = !read.is_empty();
            cell.wish = self.losses.wish_of(&cell.coarse, &read);
            let rate = self.losses.rate();
            let age_factor = self.config.age_factor * rate.age_factor * wait_share;
            for (proxy, coarse) in cell.coarse.iter().enumerate() {
                let granted: Vec<TileRequest>;
                let asked = read.iter().filter_map(|r| r.get(proxy));
                let requests: Vec<&TileRequest> = if cell.lost == 0 {
                    asked.flatten().collect()
                } else {
                    granted = asked.flat_map(|r| coarsened(r, cell.lost)).collect();
                    granted.iter().collect()
                };
                let sphere = self.caches.sphere_mut(SphereId {
                    cell: id,
                    proxy: proxy as u32,
                });
                let samples = cell.samples.with_most(rate.samples(cell.samples.most));
                let asked = read.iter().zip(&pixels).filter_map(|(requests, pixels)| {
                    let texels = requests.get(proxy)?.iter().map(|r| r.texel_pixels);
                    Some((texels, *pixels))
                });
                // Where a level is taken away, there is a quarter of the tiles.
                sphere.set_samples(if cell.lost == 0 {
                    samples.fitting(asked)
                } else {
                    samples
                });
                sphere.set_age_factor(age_factor);
                sphere.set_wanted(if used { coarse } else { &[] }, requests);
            }
            cell.requests_changed = false;
        }
        let drifts = windy || self.evolution_max_m_per_s() > 0.0;
        for (proxy, kept) in (0..).zip(&self.proxies) {
            let sphere = self.caches.sphere_mut(SphereId { cell: id, proxy });
            sphere.set_evolved(self.drifts[kept.scene_index].y);
            // Seen from the clouds, the reference goes against the wind.
            let wind = drift_m_per_s(&self.scene, kept.scene_index).with_y(0.0);
            let against = -(wind * self.sky_time.wind_rate()).normalize_or_zero();
            let course = if self.is_living { against } else { DVec3::ZERO };
            sphere.set_drifts(drifts, course);
        }
        let now = Instant::now();
        let ages = (self.ages_are_shown(id)
            && now.duration_since(cell.ages_written) >= AGES_INTERVAL)
            .then_some(now);
        if ages.is_some() {
            cell.ages_written = now;
        }
        let shows_ages = self.ages_are_shown(id).then_some(now);
        let changed = (0..self.proxies.len() as u32).any(|proxy| {
            self.caches
                .sphere_mut(SphereId { cell: id, proxy })
                .take_tables_changed()
        });
        if changed || ages.is_some() {
            let tables: Vec<_> = (0..self.proxies.len() as u32)
                .map(|proxy| {
                    self.caches
                        .sphere_mut(SphereId { cell: id, proxy })
                        .page_tables(shows_ages)
                })
                .collect();
            cell.buffers.set_tables(&self.gpu, &tables);
        }
    }

    /// Whether a frame waits for its cell's coarse level: the first ones of a viewer, or after another scene. Who comes from
    /// elsewhere is shown that meanwhile.
    pub(super) fn waits_for_tiles(&self, viewer: &ActiveViewer) -> bool {
        let cell = self.active_cells.get(&viewer.cell);
        viewer.transition.is_none()
            && cell.is_none_or(|cell| cell.begun.elapsed() <= COARSE_WAIT)
            && !self.coarse_is_ready(viewer.cell)
    }

    /// Whether the coarse level of a cell shows the present sky.
    pub(super) fn coarse_is_ready(&self, id: CellId) -> bool {
        self.active_cells.get(&id).is_some_and(|cell| {
            cell.coarse.len() == self.proxies.len()
                && cell.coarse.iter().enumerate().all(|(proxy, tiles)| {
                    let id = SphereId {
                        cell: id,
                        proxy: proxy as u32,
                    };
                    self.caches
                        .sphere(id)
                        .is_some_and(|s| tiles.iter().all(|t| s.shows_present(&t.key)))
                })
        })
    }

    /// Whether some tile that is asked for of a cell, as far as it is granted, does not show the present sky yet.
    pub(super) fn is_coarse(&self, cell: CellId, requests: &[Vec<TileRequest>]) -> bool {
        let lost = self.levels_lost(cell);
        requests.iter().enumerate().any(|(proxy, tiles)| {
            let id = SphereId {
                cell,
                proxy: proxy as u32,
            };
            self.caches
                .sphere(id)
                .is_none_or(|s| tiles.iter().any(|t| !s.shows_present(&t.key.coarser(lost))))
        })
    }

    /// Share of the wanted samples that the caches hold.
    pub(super) fn share_done(&self) -> f64 {
        let (mut wanted, mut pending) = (0, 0);
        for id in self.active_cells.keys() {
            for (_, sphere) in self.caches.spheres_of(*id) {
                let samples = self.caches.samples_of(sphere);
                wanted += sphere.wanted_samples(samples);
                pending += sphere.pending_samples(samples);
            }
        }
        1.0 - pending as f64 / (wanted as f64).max(1.0)
    }

    pub(super) fn cache_bytes(&self) -> u64 {
        self.atlas.bytes()
    }

    /// How far a cell's first anchor has drifted, and its reference.
    pub(super) fn cell_drift(&self, id: CellId) -> Option<(DVec3, DVec3)> {
        let cell = self.active_cells.get(&id)?;
        let drift = cell.anchors.first().map_or(DVec3::ZERO, |anchor| {
            (self.drifts[self.active[0].scene_index] - anchor.drift_at_start_m).with_y(0.0)
        });
        Some((drift, cell.reference_m))
    }
}
