//! New anchors for a cell's caches when the old ones are too far from the reference: what they hold is resampled about the
//! new ones, so that the cell goes on showing what it showed and nothing has to be marched for that.

#[cfg(test)]
mod following_tests;
#[cfg(test)]
mod tests;

use super::cells_on_device::ActiveCell;
use super::renderer::SkyRenderer;
use super::transitions::{LeftBehind, NEW_ANCHORS_RAD};
use crate::cache::{
    ProxySphere, SphereCache, SphereId, TileKey, TileUpdate, octahedral_from_direction,
    texel_solid_angle_sr,
};
use crate::march::{Proxy, ResampleGroup, ResampledTile, Surface, record_resample};
use glam::{DVec2, DVec3};
use skycell_protocol::CellId;
use skycell_shaders::layout;

/// A cell's frame goes with it when its reference is this far from the frame's origin, m. Seen from there a frame's up is tilted by
/// the angle between both on the planet, 0.01°; a frame that is changed tilts the picture by that.
const FRAME_MOVES_M: f64 = 1_000.0;

/// Where a proxy's texels were and are.
struct Readdressed {
    kept: Proxy,
    old: ProxySphere,
    new: ProxySphere,
    /// Most places of a search for what old texels show.
    parallax_steps: u32,
}

impl Readdressed {
    /// Places of a new tile's corners, edges and middle in the old square.
    fn places(&self, key: TileKey) -> Vec<DVec2> {
        let thirds = [0.0, 0.5, 1.0];
        let within = thirds.map(|y| thirds.map(|x| DVec2::new(x, y)));
        within
            .as_flattened()
            .iter()
            .map(|within| {
                let from_old =
                    self.before(self.new.point(key.direction(*within))) - self.old.anchor;
                octahedral_from_direction(from_old.normalize_or(DVec3::Y))
            })
            .collect()
    }

    /// The place of the old surface, in the old frame, whose texel shows what is at a point of the new one: of a shell the same
    /// place, of a dome where it is seen from the reference.
    fn before(&self, point: DVec3) -> DVec3 {
        match self.new.surface {
            Surface::Shell { altitude_m } => self.in_old_frame(point, altitude_m),
            Surface::ShellFromAbove { .. } => {
                self.in_old_frame(point, self.new.frame.altitude_m(point))
            }
            Surface::Dome { .. } => {
                let [point, eye] = [point, self.new.reference]
                    .map(|p| self.in_old_frame(p, self.new.frame.altitude_m(p)));
                let along = (point - eye).normalize_or(DVec3::Y);
                self.old.point_along(eye, along)
            }
        }
    }

    /// A point at an altitude in the old frame.
    fn in_old_frame(&self, point: DVec3, altitude_m: f64) -> DVec3 {
        let [x, z] = self.new.frame.origin_m();
        let world_m = DVec3::new(x + point.x, altitude_m, z + point.z);
        self.old.frame.from_world(world_m)
    }

    /// `finest`: level of the finest new tile.
    fn addresses(&self, finest: u8) -> layout::Resample {
        let [[from_x, from_z], [to_x, to_z]] = [&self.old, &self.new].map(|s| s.frame.origin_m());
        let [old_proxy, new_proxy] =
            [&self.old, &self.new].map(|s| self.kept.uniform(&s.frame, s.anchor));
        layout::Resample {
            new_proxy,
            old_proxy,
            reference: self.new.reference.as_vec3().to_array(),
            planet_radius_m: self.new.frame.planet_radius_m() as f32,
            moved: [(to_x - from_x) as f32, (to_z - from_z) as f32],
            parallax_steps: self.parallax_steps,
            texel_angle_rad: texel_solid_angle_sr(finest).sqrt() as f32,
        }
    }
}

/// Those who look at a cell that gets new anchors, while its reference goes from one place to another.
fn at_new_anchors(references_m: [DVec3; 2], has_jumped: bool) -> LeftBehind {
    LeftBehind {
        apart_rad: NEW_ANCHORS_RAD,
        has_jumped,
        references_m,
    }
}

impl SkyRenderer {
    /// Gives a cell new anchors at its reference. Who looks at it sees it about the old ones first, and then goes on to the new
    /// ones. Where there is nothing that is worth keeping, its caches start anew.
    pub(super) fn reanchor_cell(&mut self, id: CellId) {
        if !self.can_be_resampled(id) {
            let has_jumped = self
                .active_cells
                .get(&id)
                .is_some_and(|cell| self.is_a_jump(cell.came_from_m, cell.reference_m));
            let references_m = self.active_cells.get(&id).map_or([DVec3::ZERO; 2], |cell| {
                [cell.came_from_m, cell.reference_m]
            });
            let left = at_new_anchors(references_m, has_jumped);
            if !self.leave_behind(id, &left) {
                self.restart_cell(id);
            }
            return;
        }
        let Some(mut old) = self.active_cells.remove(&id) else {
            return;
        };
        let mut cell = self.new_active_cell(old.reference_m);
        let [x, z] = old.frame.origin_m();
        let from_origin_m = DVec3::new(old.reference_m.x - x, 0.0, old.reference_m.z - z);
        if from_origin_m.length() <= FRAME_MOVES_M {
            cell.frame = old.frame;
        }
        let exposure_ev = old.auto_exposure_ev();
        cell.take_over(&mut old);
        // A dome that follows takes short steps, which nobody sees.
        let stand_in = if self.kept_on.follows() {
            None
        } else {
            self.keep_for_viewers(id, &at_new_anchors([old.reference_m; 2], false))
        };
        self.show_all_marched(id, &mut old);
        let proxies = 0..self.proxies.len() as u32;
        let mut spheres = self.caches.take_spheres(id);
        // Asks for what is wanted about the new anchors.
        self.refresh_cell(id, &mut cell, self.wind_speed_max_m_per_s() > 0.0);
        for proxy in proxies {
            if let Some(sphere) = spheres.remove(&proxy) {
                let sphere_id = SphereId { cell: id, proxy };
                self.resample(sphere_id, &mut old, &cell, &sphere);
                match stand_in {
                    Some(cell) => self.caches.put(SphereId { cell, proxy }, sphere),
                    // The next proxy's tiles may take these slots: passes run in their order.
                    None => self.caches.release(sphere),
                }
            }
        }
        if let Some(stand_in) = stand_in {
            old.stand_for(id, exposure_ev);
            self.active_cells.insert(stand_in, old);
        }
        self.audit.tiles_changed();
        self.active_cells.insert(id, cell);
    }

    /// What was marched since the last frame is read, too.
    fn show_all_marched(&mut self, id: CellId, cell: &mut ActiveCell) {
        let proxies = 0..self.proxies.len() as u32;
        let tables: Vec<_> = proxies
            .map(|proxy| {
                let sphere = self.caches.sphere_mut(SphereId { cell: id, proxy });
                sphere.page_tables(None)
            })
            .collect();
        cell.buffers.set_tables(&self.gpu, &tables);
    }

    /// A cell goes so fast with all who are in it that nothing of what it holds can be resampled: they go on seeing that until
    /// there is something at its new place, or after a jump, as from where they were, until there is a coarse sky. So no
    /// frame waits, and none is without clouds. False where it has nothing to show, or nobody looks.
    pub(super) fn leave_behind(&mut self, id: CellId, left: &LeftBehind) -> bool {
        let mut proxies = 0..self.proxies.len() as u32;
        let is_shown = !self.proxies.is_empty()
            && proxies.all(|proxy| {
                let sphere = self.caches.sphere(SphereId { cell: id, proxy });
                sphere.is_some_and(SphereCache::coarse_is_shown)
            });
        if !is_shown {
            return false;
        }
        let Some(mut old) = self.active_cells.remove(&id) else {
            return false;
        };
        let Some(stand_in) = self.keep_for_viewers(id, left) else {
            self.active_cells.insert(id, old);
            return false;
        };
        let mut cell = self.new_active_cell(old.reference_m);
        let exposure_ev = old.auto_exposure_ev();
        // Eyes stay used to the light.
        cell.meter = old.meter.take();
        self.show_all_marched(id, &mut old);
        for (proxy, sphere) in self.caches.take_spheres(id) {
            let cell = stand_in;
            self.caches.put(SphereId { cell, proxy }, sphere);
        }
        old.reference_m = old.came_from_m;
        old.stand_for(id, exposure_ev);
        self.active_cells.insert(stand_in, old);
        self.active_cells.insert(id, cell);
        self.audit.restart();
        true
    }

    /// Whether the coarse level of every proxy is there and shows what is seen from about where the reference is now: after a
    /// jump it shows another place. A dome that follows takes what it shows along, however old that is.
    fn can_be_resampled(&self, id: CellId) -> bool {
        let is_aright = self.active_cells.get(&id).is_some_and(|cell| {
            (0..self.active.len()).all(|layer| self.is_anchored_aright(cell, layer))
        });
        let follows = self.kept_on.follows() && self.is_inside_domes(id);
        is_aright
            && (0..self.proxies.len() as u32).all(|proxy| {
                let sphere_id = SphereId { cell: id, proxy };
                let (sphere, reference) = (
                    self.caches.sphere(sphere_id),
                    self.drifting_reference(sphere_id),
                );
                match (sphere, reference) {
                    (Some(sphere), Some(reference)) => {
                        sphere.coarse_is_shown() && (follows || !sphere.is_of_elsewhere(reference))
                    }
                    _ => false,
                }
            })
    }

    /// Submits the filling of one proxy's tiles.
    fn resample(
        &mut self,
        id: SphereId,
        old: &mut ActiveCell,
        cell: &ActiveCell,
        sphere: &SphereCache,
    ) {
        let place = id.proxy as usize;
        let Some(kept) = self.proxies.get(place).copied() else {
            return;
        };
        let domes = self.kept_on.has_domes();
        let steps_of_viewers = self
            .viewers
            .values()
            .filter(|viewer| domes && viewer.cell == id.cell)
            .map(|viewer| viewer.quality.settings.parallax_steps);
        let way = Readdressed {
            kept,
            old: self.sphere_of(old, &kept),
            new: self.sphere_of(cell, &kept),
            parallax_steps: steps_of_viewers.max().unwrap_or(0),
        };
        let reference = cell.reference_m - self.drifts[kept.scene_index].with_y(0.0);
        let filled = self
            .caches
            .resample(id, sphere, reference, domes, |key| way.places(key));
        self.atlas.fit(&self.gpu, self.caches.slots_needed());
        let anchor_m = cell.drifting_anchor(kept.layer);
        for (key, slot) in &filled {
            let shown_from = self.caches.sphere(id).and_then(|s| s.shown_from(key));
            if let (Some(shown_from), Some(anchor_m)) = (shown_from, anchor_m) {
                self.atlas
                    .set_origin(&self.gpu, *slot, shown_from - anchor_m);
            }
        }
        let finest = filled.iter().map(|(key, _)| key.level).max().unwrap_or(0);
        let tiles: Vec<ResampledTile> = filled
            .into_iter()
            .map(|(key, slot)| ResampledTile {
                key,
                slot,
                table: old.buffers.table(place, SphereCache::source_level(key)),
            })
            .collect();
        let cached = old
            .buffers
            .cached_group(&self.gpu, &self.pipelines, &self.atlas)
            .clone();
        self.submit_resample(&ResampleGroup {
            cached: &cached,
            addresses: way.addresses(finest),
            domes,
            tiles: &tiles,
        });
        self.counters.tiles_resampled += tiles.len() as u64;
    }

    fn submit_resample(&mut self, group: &ResampleGroup<'_>) {
        self.timing.begin();
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("resample tiles"),
            });
        self.counters.dispatches += record_resample(
            &self.gpu,
            &mut encoder,
            &mut self.timing,
            &self.pipelines,
            &self.atlas,
            group,
        );
        self.timing.resolve(&mut encoder);
        self.submit(encoder);
        self.timing.submitted();
    }

    /// Runs the pass once, over a tile that nobody is shown.
    pub(super) fn warm_up_resample(&mut self, update: &TileUpdate) {
        let Some(cell) = self.active_cells.get_mut(&update.sphere.cell) else {
            return;
        };
        let cached = cell
            .buffers
            .cached_group(&self.gpu, &self.pipelines, &self.atlas)
            .clone();
        self.submit_resample(&ResampleGroup {
            cached: &cached,
            addresses: layout::Resample::default(),
            domes: self.kept_on.has_domes(),
            tiles: &[ResampledTile {
                key: update.key,
                slot: update.slot,
                table: layout::PageTable::default(),
            }],
        });
    }
}
