//! The proxy-sphere caches: which texels exist, who wants them, which are marched next. Pure bookkeeping; the device
//! side is in `march`.

mod address;
mod budget;
mod pool;
mod requests;
mod samples;
mod sky_way;
mod sphere;

pub use address::{
    BASE_TILES, GUTTER, LEVELS, TILE_INTERIOR, TILE_STRIDE, TileKey, direction_from_octahedral,
    octahedral_from_direction, texel_solid_angle_sr,
};
pub use budget::{
    LEVELS_LOST_MAX, MemoryGovernor, Rate, RateGovernor, TileLimits, Wish, coarsened, least_losses,
};
pub use pool::{Slot, SlotPool};
pub use requests::{
    Band, ProxySphere, TileRequest, ViewFrustum, coarse_tiles, requested_by_eyes, requested_tiles,
    seen_blocks,
};
pub use samples::TexelSamples;
pub use sky_way::SkyWay;
pub use sphere::{AgeingRates, LAG_RAD, NO_TILE, PageTables, SphereCache, Want};

use glam::{DVec2, DVec3};
use skycell_protocol::CellId;
use sphere::AuditScale;
use std::collections::BTreeMap;

/// Texels of a stored tile.
pub const TEXELS_PER_TILE: u64 = (TILE_STRIDE * TILE_STRIDE) as u64;
/// Bytes of a texel: four half floats of radiance and transmittance, one float of distance.
pub const BYTES_PER_TEXEL: u64 = 12;

/// One proxy sphere: a part of a layer of the scene in a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SphereId {
    /// The cell.
    pub cell: CellId,
    /// Index among the scene's proxies.
    pub proxy: u32,
}

/// One tile that takes a sample now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileUpdate {
    /// The sphere.
    pub sphere: SphereId,
    /// The tile.
    pub key: TileKey,
    /// Where it is stored.
    pub slot: Slot,
    /// Which of the jittered samples.
    pub sample_index: u32,
    /// Share of the sample in the new value.
    pub weight: f32,
    /// Where the rays of the sample start, in the frame that drifts with the layer; the whole mixture is seen from there.
    pub from: DVec3,
    /// Where those of the old texels started.
    pub old_from: DVec3,
}

/// All spheres of all cells over one pool of slots.
#[derive(Debug)]
pub struct Caches {
    pool: SlotPool,
    spheres: BTreeMap<SphereId, SphereCache>,
    samples: TexelSamples,
    frame: u64,
    evicted: u64,
    refused: u64,
    /// Most tiles of a cell.
    cell_tiles_max: u32,
    /// Samples that are to be taken, as of the last plan.
    backlog: u64,
    is_calm: bool,
    audits: AuditScale,
}

/// Tiles that may lose their slots: the one unseen for longest last.
type Evictable = Vec<(u64, SphereId, TileKey)>;

impl Caches {
    /// Caches of at most `tiles_max` tiles whose texels average `samples` samples.
    #[must_use]
    pub fn new(tiles_max: u32, samples: u32) -> Self {
        Self {
            pool: SlotPool::new(tiles_max),
            spheres: BTreeMap::new(),
            samples: TexelSamples::each(samples),
            frame: 0,
            evicted: 0,
            refused: 0,
            cell_tiles_max: u32::MAX,
            backlog: 0,
            is_calm: true,
            audits: AuditScale::default(),
        }
    }

    /// Another limit of the tiles of each cell; what is beyond it goes when something else is wanted.
    pub fn set_cell_tiles_max(&mut self, tiles_max: u32) {
        self.cell_tiles_max = tiles_max;
    }

    /// How many tiles there may be.
    #[must_use]
    pub fn limits(&self) -> TileLimits {
        TileLimits {
            server: u64::from(self.pool.limit()),
            cell: u64::from(self.cell_tiles_max.min(self.pool.limit())),
        }
    }

    /// Tiles that a cell holds.
    #[must_use]
    pub fn resident_in(&self, cell: CellId) -> u64 {
        self.spheres_of(cell)
            .map(|(_, sphere)| sphere.resident() as u64)
            .sum()
    }

    /// A sphere; made when it is not there.
    pub fn sphere_mut(&mut self, id: SphereId) -> &mut SphereCache {
        self.spheres.entry(id).or_default()
    }

    /// A sphere.
    #[must_use]
    pub fn sphere(&self, id: SphereId) -> Option<&SphereCache> {
        self.spheres.get(&id)
    }

    /// Spheres of a cell.
    pub fn spheres_of(&self, cell: CellId) -> impl Iterator<Item = (&SphereId, &SphereCache)> {
        self.spheres.iter().filter(move |(id, _)| id.cell == cell)
    }

    /// Gives up all tiles of a cell.
    pub fn remove_cell(&mut self, cell: CellId) {
        let gone: Vec<SphereId> = self.spheres_of(cell).map(|(id, _)| *id).collect();
        for id in gone {
            if let Some(mut sphere) = self.spheres.remove(&id) {
                for slot in sphere.clear() {
                    self.pool.release(slot);
                }
            }
        }
    }

    /// Everything shows an older scene from now on; it is shown until it is marched anew.
    pub fn age_all(&mut self) {
        for sphere in self.spheres.values_mut() {
            sphere.age_all();
        }
    }

    /// The clouds have changed a little: every tile takes one more sample, and keeps what it shows.
    pub fn refresh_all(&mut self) {
        for sphere in self.spheres.values_mut() {
            sphere.refresh_all();
        }
    }

    /// Whether every wanted tile has had a sample since the clouds last changed.
    #[must_use]
    pub fn is_refreshed(&self) -> bool {
        self.spheres.values().all(SphereCache::is_refreshed)
    }

    /// The sky has moved, what each proxy keeps by a way of its own. Texels are mixed towards the present when it is their turn;
    /// nothing is thrown away.
    pub fn age_by(&mut self, ways_of_proxies: &[SkyWay]) {
        for (id, sphere) in &mut self.spheres {
            if let Some(way) = ways_of_proxies.get(id.proxy as usize) {
                sphere.age_by(*way);
            }
        }
    }

    /// Whether the sky moves no more, so that texels have to come all the way to the present.
    pub fn set_calm(&mut self, is_calm: bool) {
        self.is_calm = is_calm;
    }

    /// Gives a cell other proxies: the one at place i is the one that was at `kept[i]`, or a new one. What is not kept gives
    /// its slots back.
    pub fn keep_proxies(&mut self, cell: CellId, kept: &[Option<u32>]) {
        let mut old: BTreeMap<u32, SphereCache> = BTreeMap::new();
        let ids: Vec<SphereId> = self.spheres_of(cell).map(|(id, _)| *id).collect();
        for id in ids {
            if let Some(sphere) = self.spheres.remove(&id) {
                old.insert(id.proxy, sphere);
            }
        }
        for (proxy, kept) in (0..).zip(kept) {
            if let Some(sphere) = kept.and_then(|kept| old.remove(&kept)) {
                self.spheres.insert(SphereId { cell, proxy }, sphere);
            }
        }
        for mut sphere in old.into_values() {
            for slot in sphere.clear() {
                self.pool.release(slot);
            }
        }
    }

    /// Takes a cell's spheres out, with their slots, and leaves empty ones that know what time it is.
    pub fn take_spheres(&mut self, cell: CellId) -> BTreeMap<u32, SphereCache> {
        let ids: Vec<SphereId> = self.spheres_of(cell).map(|(id, _)| *id).collect();
        let mut taken = BTreeMap::new();
        for id in ids {
            if let Some(sphere) = self.spheres.get_mut(&id) {
                let fresh = sphere.like();
                taken.insert(id.proxy, std::mem::replace(sphere, fresh));
            }
        }
        taken
    }

    /// Gives the tiles that a sphere wants slots as far as there are any, to be filled from those of the sphere that was in its
    /// place; `places` are the tile's in the octahedral square of that one, and `reference` is where rays start. Tiles of which
    /// the old sphere shows nothing are left out. `reprojected`: they are filled with what is seen from the reference. Returns
    /// what is to be filled.
    pub fn resample(
        &mut self,
        id: SphereId,
        old: &SphereCache,
        reference: DVec3,
        reprojected: bool,
        places: impl Fn(TileKey) -> Vec<DVec2>,
    ) -> Vec<(TileKey, Slot)> {
        let mut filled = Vec::new();
        let mut evictable = None;
        let keys = self
            .spheres
            .get(&id)
            .map(SphereCache::wanted_keys)
            .unwrap_or_default();
        for key in keys {
            let sources = old.sources(key, &places(key));
            if sources.is_empty() {
                continue;
            }
            let Some(slot) = self.slot_for(id.cell, &mut evictable) else {
                break;
            };
            if let Some(sphere) = self.spheres.get_mut(&id) {
                sphere.insert_resampled(key, slot, old, &sources, reference, self.frame);
                if reprojected {
                    sphere.shows_from(&key, reference);
                }
                filled.push((key, slot));
            }
        }
        filled
    }

    /// Puts a sphere that was taken out in the place of another.
    pub fn put(&mut self, id: SphereId, sphere: SphereCache) {
        if let Some(before) = self.spheres.insert(id, sphere) {
            self.release(before);
        }
    }

    /// Gives the slots of a sphere back that was taken out.
    pub fn release(&mut self, mut sphere: SphereCache) {
        for slot in sphere.clear() {
            self.pool.release(slot);
        }
    }

    /// A frame was composited for a cell: its wanted tiles were seen.
    pub fn frame_shown(&mut self, cell: CellId) {
        self.frame += 1;
        for (id, sphere) in &mut self.spheres {
            if id.cell == cell {
                sphere.touch(self.frame);
            }
        }
    }

    /// Chooses at most `tiles_max` updates, the most urgent first, and gives new tiles their slots. `references` are the
    /// reference points of the spheres in the frames that drift with their layers.
    pub fn plan(
        &mut self,
        tiles_max: usize,
        references: impl Fn(SphereId) -> Option<DVec3>,
    ) -> Vec<TileUpdate> {
        let mut candidates = Vec::new();
        let mut found = Vec::new();
        let all_samples = self.samples;
        let mut backlog = 0;
        for (id, sphere) in &mut self.spheres {
            let Some(reference) = references(*id) else {
                continue;
            };
            sphere.plan_at(reference);
            let samples = sphere.samples().unwrap_or(all_samples);
            sphere.candidates(samples, reference, self.is_calm, &mut found);
            backlog += found
                .iter()
                .map(|candidate| u64::from(candidate.owed))
                .sum::<u64>();
            candidates.extend(found.drain(..).map(|candidate| (*id, reference, candidate)));
        }
        candidates.sort_unstable_by(|a, b| a.2.rank(&b.2).then(a.0.cmp(&b.0)));
        self.backlog = backlog;
        let mut evictable = None;
        let mut updates = Vec::new();
        for (id, reference, candidate) in candidates {
            if updates.len() == tiles_max {
                break;
            }
            let resident = self
                .spheres
                .get(&id)
                .is_some_and(|sphere| sphere.tiles.contains_key(&candidate.key));
            if !resident {
                let Some(slot) = self.slot_for(id.cell, &mut evictable) else {
                    // Not even the coarse levels of all cells fit: this tile is shown by a coarser one, if there is any.
                    self.refused += 1;
                    continue;
                };
                if let Some(sphere) = self.spheres.get_mut(&id) {
                    sphere.insert(candidate.key, slot, self.frame);
                }
            }
            let samples = self.samples;
            let sample = self.spheres.get_mut(&id).and_then(|sphere| {
                let samples = sphere.samples().unwrap_or(samples);
                sphere.sample(candidate.key, samples, reference)
            });
            if let Some(sample) = sample {
                updates.push(TileUpdate {
                    sphere: id,
                    key: candidate.key,
                    slot: sample.slot,
                    sample_index: sample.index,
                    weight: sample.weight,
                    from: sample.from,
                    old_from: sample.old_from,
                });
            }
        }
        updates
    }

    /// A slot for a tile of a cell: a free one, or that of a tile which nobody wants, of the same cell where that is at its
    /// limit. While what is wanted fits, there always is one.
    fn slot_for(&mut self, cell: CellId, evictable: &mut Option<Evictable>) -> Option<Slot> {
        let is_full = self.resident_in(cell) >= u64::from(self.cell_tiles_max);
        if !is_full && let Some(slot) = self.pool.allocate() {
            return Some(slot);
        }
        self.evict(is_full.then_some(cell), evictable)
    }

    /// The slot of the tile that was unseen for longest, of one cell or of all. The list is made at the first call and used up.
    fn evict(&mut self, cell: Option<CellId>, list: &mut Option<Evictable>) -> Option<Slot> {
        let list = list.get_or_insert_with(|| {
            let mut all: Evictable = self
                .spheres
                .iter()
                .flat_map(|(id, sphere)| {
                    let evictable = sphere.evictable().into_iter();
                    evictable.map(|(seen, key)| (seen, *id, key))
                })
                .collect();
            all.sort_unstable_by(|a, b| b.cmp(a));
            all
        });
        let is_of = |id: &SphereId| cell.is_none_or(|cell| id.cell == cell);
        let place = list.iter().rposition(|(_, id, _)| is_of(id))?;
        let (_, id, key) = list.remove(place);
        self.evicted += 1;
        self.spheres.get_mut(&id)?.remove(&key)
    }

    /// What is wanted now counts as seen. Returns the number of a frame: what nobody has wanted since was seen in none from
    /// that one on.
    pub fn mark_seen(&mut self) -> u64 {
        self.frame += 1;
        for sphere in self.spheres.values_mut() {
            sphere.touch(self.frame);
        }
        self.frame
    }

    /// Gives the slots of tiles back that nobody wants and no frame has shown since one. Returns how many.
    pub fn release_unseen(&mut self, since_frame: u64) -> usize {
        let mut count = 0;
        for sphere in self.spheres.values_mut() {
            for (seen, key) in sphere.evictable() {
                if seen < since_frame
                    && let Some(slot) = sphere.remove(&key)
                {
                    self.pool.release(slot);
                    count += 1;
                }
            }
        }
        count
    }

    /// Gives at most so many tiles that have the highest slots the lowest free ones, until all that are in use follow each other.
    /// Returns from where to where, those that were highest first; what they hold is to be copied.
    pub fn gather(&mut self, tiles_max: usize) -> Vec<(Slot, Slot)> {
        let mut beyond: Vec<(Slot, SphereId, TileKey)> = Vec::new();
        for (id, sphere) in &self.spheres {
            let slots = sphere.slots_from(Slot(self.pool.used()));
            beyond.extend(slots.map(|(slot, key)| (slot, *id, key)));
        }
        beyond.sort_unstable_by_key(|(slot, _, _)| std::cmp::Reverse(*slot));
        let mut moved = Vec::new();
        for (from, id, key) in beyond.into_iter().take(tiles_max) {
            let (Some(to), Some(sphere)) = (self.pool.allocate(), self.spheres.get_mut(&id)) else {
                break;
            };
            sphere.put_in(&key, to);
            self.pool.release(from);
            moved.push((from, to));
        }
        moved
    }

    /// An audit of some texels of a tile has found another mean deviation than was expected, both percent: the tile is taken to
    /// age faster or more slowly from now on, within limits.
    pub fn note_audit(&mut self, id: SphereId, key: &TileKey, expected: f64, found: f64) {
        if let (Some(times), Some(sphere)) = (
            self.audits.times(expected, found),
            self.spheres.get_mut(&id),
        ) {
            sphere.note_audit(key, times);
        }
    }

    /// Whether nothing is left to do for any sphere that has a reference.
    #[must_use]
    pub fn has_work(&self, references: impl Fn(SphereId) -> Option<DVec3>) -> bool {
        let mut found = Vec::new();
        for (id, sphere) in &self.spheres {
            if let Some(reference) = references(*id) {
                sphere.candidates(self.samples_of(sphere), reference, self.is_calm, &mut found);
                if !found.is_empty() {
                    return true;
                }
            }
        }
        false
    }

    /// Everything of a cell is to be marched anew; it is shown until then.
    pub fn age_cell(&mut self, cell: CellId) {
        for (id, sphere) in &mut self.spheres {
            if id.cell == cell {
                sphere.age_all();
            }
        }
    }

    /// Samples that a sphere's texels average.
    #[must_use]
    pub fn samples_of(&self, sphere: &SphereCache) -> TexelSamples {
        sphere.samples().unwrap_or(self.samples)
    }

    /// Another number of samples that a texel averages.
    pub fn set_samples(&mut self, samples: TexelSamples) {
        self.samples = samples;
    }

    /// Samples that a texel averages.
    #[must_use]
    pub fn samples(&self) -> TexelSamples {
        self.samples
    }

    /// Counts on from the sums of caches whose device is gone.
    pub fn count_on_from(&mut self, evicted: u64, refused: u64) {
        self.evicted += evicted;
        self.refused += refused;
    }

    /// Tiles that have lost their slot to others so far.
    #[must_use]
    pub fn evicted(&self) -> u64 {
        self.evicted
    }

    /// How often a wanted tile found no slot, because not even the coarse levels of all cells fit.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Samples that were to be taken when updates were last planned, in tiles.
    #[must_use]
    pub fn backlog(&self) -> u64 {
        self.backlog
    }

    /// Tiles that have a slot.
    #[must_use]
    pub fn resident(&self) -> u32 {
        self.pool.used()
    }

    /// Slots that an atlas must hold.
    #[must_use]
    pub fn slots_needed(&self) -> u32 {
        self.pool.high_water()
    }
}

#[cfg(test)]
mod tests;
