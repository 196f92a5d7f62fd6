//! The tiles of one proxy sphere: what its viewers want, what is resident, what an update would gain.

mod expected;
mod resampled;

pub(super) use expected::AuditScale;
pub use expected::{AgeingRates, LAG_RAD};

use super::address::{LEVELS, TileKey};
use super::pool::Slot;
use super::requests::TileRequest;
use super::samples::TexelSamples;
use super::sky_way::SkyWay;
use glam::DVec3;
use skycell_protocol::show::{AGE_HIGH_S, AGE_LOW_S};
use std::collections::HashMap;
use std::time::Instant;

/// A step of age: the reference point has moved this far, as an angle seen from what a tile shows. About four pixels of a
/// small picture.
pub(super) const AGE_STEP_RAD: f64 = 0.012;
/// While wind carries the clouds past it, a tile takes a sample when the reference has moved by so many steps since the last, ...
pub(super) const AGE_MOVED: f64 = 1.0;
/// ... or by so many texels, if that is less: the texels of a tile are carried over by a fraction of that, and its gutters hold
/// two of its neighbours'.
const MOVED_TEXELS: f64 = 3.0;
/// Of what the reference has moved by since the last sample, this share stays in a mixture that is carried over to where the
/// next one is seen from: sides of clouds that were not seen, edges.
const CARRIED_BEHIND: f64 = 0.25;
/// While rising noise ages it, a tile takes a sample when its mixture is this many steps behind, ...
pub(super) const AGE_DRIFTING: f64 = 2.0;
/// ... of which a sample leaves at most so many. ...
const AGE_KEPT: f64 = 1.5;
/// ... Without them, a mixture farther behind than this, a pixel of a small picture, is accumulated anew: a reference that has
/// jumped is at rest. Accumulated once, eight samples leave less than this of what is not replaced at once: 5/17.
pub(super) const AGE_REST: f64 = 0.3;
/// Beyond so many steps old and new samples no longer show the same picture: what was there is replaced.
pub(super) const AGE_RESTART: f64 = 5.0;
/// Rays start no farther ahead of the wind, m.
const LEAD_MAX_M: f64 = 300.0;
/// What is accumulated anew begins with what was there, which counts as so many samples: of N new ones it is a share of
/// 1/(2 N + 1) at the end, and until then no tile shows the noise of a single sample.
const OLD_SAMPLES: f32 = 0.5;
/// What a tile that was filled from others holds counts as so many samples when it is marched: it is blurred a little, and one
/// sample is noisy.
const RESAMPLED_SAMPLES: f32 = 2.0;
/// Least share of a sample that refreshes an aged but converged tile.
const REFRESH_WEIGHT: f32 = 0.25;
/// A tile is mixed towards the present sky when it is this many unseen steps behind a sky that moves, ...
const BEHIND_MOVING: f64 = 1.0;
/// ... and this many when the sky has come to rest.
const BEHIND_CALM: f64 = 0.05;
/// What nobody looks at, the coarse level, may be this many times as far behind.
const UNSEEN_BEHIND: f64 = 4.0;
/// How far behind a tile stays after a sample, in steps: the weight of the sample follows from it, so that a tile that is
/// far behind catches up at once and one that is close takes little noise from one sample.
const BEHIND_KEPT: f64 = 0.75;
/// So far behind, a tile shows another sky: accumulation starts again.
const BEHIND_RESTART: f64 = 16.0;

/// A tile that has a slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tile {
    pub(super) slot: Slot,
    /// Samples of the current generation, 0 before the first.
    samples: u32,
    /// Samples that what was there before them counts as.
    old_samples: f32,
    /// Samples ever: 0 means that the slot holds nothing to show.
    visits: u32,
    generation: u32,
    /// When the last sample was taken.
    sampled: Option<Instant>,
    /// Reference point at the last sample, in the frame that drifts with the layer's wind.
    marched_from: DVec3,
    /// Where the rays of all that is in the mixture start or were carried over to, in the same frame.
    shown_from: DVec3,
    /// How far the noise had risen through the clouds at the last sample, m.
    evolved_m: f64,
    /// How often the clouds had changed a little.
    refreshes: u32,
    pub(super) last_seen_frame: u64,
    /// The sky's way at the last sample.
    moved: SkyWay,
    /// How far behind the sky of then the mixture was.
    left: SkyWay,
    /// How far the mixture was behind its last sample's reference and noise, m.
    left_m: f64,
    /// Filled from other tiles, and not marched since.
    resampled: bool,
    /// How fast it ages beside others: clear sky hardly. By what audits have found.
    rate: f64,
}

impl Tile {
    /// How far behind a sky the tile is that has come so far.
    fn behind(&self, moved: SkyWay) -> SkyWay {
        self.left + (moved - self.moved)
    }
}

impl Tile {
    /// Time since the last sample in 255 steps of equal ratio between the ends of the scale that it is shown by; 0 without
    /// a time.
    fn age_code(&self, now: Option<Instant>) -> u32 {
        let (Some(now), Some(sampled)) = (now, self.sampled) else {
            return 0;
        };
        let age_s = now.saturating_duration_since(sampled).as_secs_f64();
        let share = (age_s / AGE_LOW_S).max(1.0).ln() / (AGE_HIGH_S / AGE_LOW_S).ln();
        // An entry of all ones would be no tile; a level below 255 keeps it from that.
        (255.0 * share.min(1.0)).round() as u32
    }
}

/// What viewers ask of a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Want {
    /// How many viewers request it; 0 for the coarse level that nobody requests and everybody needs.
    pub viewers: u32,
    /// Smallest angle from the middle of a picture.
    pub eccentricity_rad: f64,
    /// Distance of the nearest of what it shows, m.
    pub distance_m: f64,
    /// How much it is seen: the sum of its shares of pictures, those in their middles counting most.
    pub attention: f64,
    /// Pixels that one of its texels covers, of the viewer who has most of them under it.
    pub texel_pixels: f64,
}

/// At this angle from the middle of a picture, rad, a tile is looked at half as much.
const ATTENTION_RAD: f64 = 0.35;

/// How much a tile is seen by the viewer who asks for it.
fn attention(request: &TileRequest) -> f64 {
    request.screen_share / (1.0 + (request.eccentricity_rad / ATTENTION_RAD).powi(2))
}

/// How urgent an update is: smaller first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Urgency {
    /// Part of the coarse level without a picture of the present sky.
    Coarse,
    /// Wanted and never marched.
    Missing,
    /// Shows an older scene.
    Stale,
    /// Has fewer samples than it should, or shows a sky or is seen from where it was some time ago: the one that a sample is
    /// expected to help most comes first.
    Wrong,
}

/// A sample that a tile takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) slot: Slot,
    /// Which of the jittered samples.
    pub(super) index: u32,
    /// Its share of the new value.
    pub(super) weight: f32,
    /// Where its rays start, in the frame that drifts with the layer.
    pub(super) from: DVec3,
    /// Where those of the old texels started.
    pub(super) old_from: DVec3,
}

/// An update that a sphere would like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Candidate {
    pub(super) key: TileKey,
    pub(super) urgency: Urgency,
    /// Expected gain times those who see it, percent.
    seen_percent: f64,
    attention: f64,
    eccentricity_rad: f64,
    /// Samples that it still takes, with this one.
    pub(super) owed: u32,
}

impl Candidate {
    /// Order of updates: urgency, then the largest expected gain, then what is seen most, then nearest to the middle of a
    /// picture.
    pub(super) fn rank(&self, other: &Self) -> std::cmp::Ordering {
        (self.urgency.cmp(&other.urgency))
            .then(other.seen_percent.total_cmp(&self.seen_percent))
            .then(other.attention.total_cmp(&self.attention))
            .then(self.eccentricity_rad.total_cmp(&other.eccentricity_rad))
            .then(self.key.cmp(&other.key))
    }
}

/// Marks a table entry without a tile.
pub const NO_TILE: u32 = u32::MAX;

/// The tables of all levels, one after another: entry = slot | level of the tile in the slot << 16.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PageTables {
    /// Entries.
    pub entries: Vec<u32>,
    /// Where each level's table starts.
    pub level_offsets: Vec<u32>,
}

/// The tiles of one proxy sphere.
#[derive(Debug, Default)]
pub struct SphereCache {
    pub(super) tiles: HashMap<TileKey, Tile>,
    wanted: HashMap<TileKey, Want>,
    generation: u32,
    /// How far the noise has risen through the clouds, m.
    evolved_m: f64,
    /// Whether wind carries the clouds past the reference or noise rises through them.
    drifts: bool,
    /// Which way the wind lets the reference go, seen from the clouds; of length 1, or none.
    course: DVec3,
    /// Where rays started when updates were last planned.
    reference: Option<DVec3>,
    /// How often the clouds have changed a little.
    refreshes: u32,
    /// The sky's way so far.
    moved: SkyWay,
    /// Samples that texels average, if not as many as those of all spheres.
    samples: Option<TexelSamples>,
    /// While it ages all the time, a tile is marched again when it is so many times as far behind as it otherwise may be.
    age_factor: Option<f64>,
    /// Whether tables must be made anew.
    tables_changed: bool,
}

impl SphereCache {
    /// Everything marched so far shows an older scene.
    pub fn age_all(&mut self) {
        self.generation = self.generation.wrapping_add(1);
    }

    /// The clouds have changed a little: every tile takes one more sample, weighed as those of a reference that has moved.
    pub fn refresh_all(&mut self) {
        self.refreshes = self.refreshes.wrapping_add(1);
    }

    /// How far the noise has risen through the clouds: tiles age by it as they do by a reference that moves as far.
    pub fn set_evolved(&mut self, evolved_m: f64) {
        self.evolved_m = evolved_m;
    }

    /// Whether wind carries the clouds past the reference or noise rises through them, so that tiles age all the time; and
    /// which way the reference goes then, as seen from the clouds: a unit vector, or none.
    pub fn set_drifts(&mut self, drifts: bool, course: DVec3) {
        self.drifts = drifts;
        self.course = course;
    }

    /// Whether every wanted tile has had a sample since the clouds last changed.
    #[must_use]
    pub fn is_refreshed(&self) -> bool {
        self.wanted.keys().all(|key| {
            self.shows_present(key)
                && self
                    .tiles
                    .get(key)
                    .is_some_and(|tile| tile.refreshes == self.refreshes)
        })
    }

    /// The sky has moved.
    pub fn age_by(&mut self, way: SkyWay) {
        self.moved += way;
    }

    /// Another number of samples that its texels average. More are added to those that are there.
    pub fn set_samples(&mut self, samples: TexelSamples) {
        self.samples = Some(samples);
    }

    /// Samples that its texels average, if that was said.
    #[must_use]
    pub fn samples(&self) -> Option<TexelSamples> {
        self.samples
    }

    /// While the sky or the reference moves, tiles may be so many times as far behind before they are marched again.
    pub fn set_age_factor(&mut self, age_factor: f64) {
        self.age_factor = Some(age_factor);
    }

    /// Replaces what viewers want by the union of their requests and the coarse level.
    pub fn set_wanted<'a>(
        &mut self,
        coarse: &[TileRequest],
        requests: impl IntoIterator<Item = &'a TileRequest>,
    ) {
        self.wanted.clear();
        for request in coarse {
            self.wanted.insert(
                request.key,
                Want {
                    viewers: 0,
                    eccentricity_rad: request.eccentricity_rad,
                    distance_m: request.distance_m,
                    attention: 0.0,
                    texel_pixels: 0.0,
                },
            );
        }
        for request in requests {
            let want = self.wanted.entry(request.key).or_insert(Want {
                viewers: 0,
                eccentricity_rad: f64::INFINITY,
                distance_m: request.distance_m,
                attention: 0.0,
                texel_pixels: 0.0,
            });
            want.viewers += 1;
            want.eccentricity_rad = want.eccentricity_rad.min(request.eccentricity_rad);
            want.attention += attention(request);
            want.texel_pixels = want.texel_pixels.max(request.texel_pixels);
            // What stands for it until it is there is seen as much.
            if request.key.level > 0
                && let Some(coarse) = self.wanted.get_mut(&request.key.coarser(LEVELS))
            {
                coarse.attention += attention(request);
            }
        }
    }

    /// Marks wanted tiles as seen in a frame.
    pub fn touch(&mut self, frame: u64) {
        for key in self.wanted.keys() {
            if let Some(tile) = self.tiles.get_mut(key) {
                tile.last_seen_frame = frame;
            }
        }
    }

    /// Tiles that are wanted by viewers: summed over the viewers and each once. The coarse level is nobody's request.
    #[must_use]
    pub fn requested_and_unique(&self) -> (u64, u64) {
        self.wanted.values().fold((0, 0), |(sum, unique), want| {
            (
                sum + u64::from(want.viewers),
                unique + u64::from(want.viewers > 0),
            )
        })
    }

    /// Tiles of the coarse level that no viewer requests.
    #[must_use]
    pub fn coarse_only(&self) -> u64 {
        self.wanted
            .values()
            .filter(|want| want.viewers == 0)
            .count() as u64
    }

    /// Tiles with a slot.
    #[must_use]
    pub fn resident(&self) -> usize {
        self.tiles.len()
    }

    fn samples_of(&self, key: &TileKey) -> Option<u32> {
        let tile = self.tiles.get(key)?;
        Some(if tile.generation == self.generation {
            tile.samples
        } else {
            0
        })
    }

    /// Samples that all wanted tiles should have together.
    #[must_use]
    pub fn wanted_samples(&self, samples: TexelSamples) -> u64 {
        self.wanted
            .values()
            .map(|want| u64::from(samples.of(want)))
            .sum()
    }

    /// Samples that are missing until every wanted tile has its own and shows the present sky, in tiles.
    #[must_use]
    pub fn pending_samples(&self, samples: TexelSamples) -> u64 {
        self.wanted
            .iter()
            .map(|(key, want)| {
                let have = self.samples_of(key).unwrap_or(0);
                let missing = u64::from(samples.of(want).saturating_sub(have));
                let Some(tile) = self.tiles.get(key) else {
                    return missing;
                };
                let behind = tile.behind(self.moved).steps > behind_max(true, want);
                if missing == 0 && (tile.resampled || self.is_aged_at_rest(tile, want)) {
                    return u64::from(samples.of(want));
                }
                missing.max(u64::from(behind))
            })
            .sum()
    }

    /// Whether a tile's mixture is visibly older than a reference that stands still over its clouds.
    fn is_aged_at_rest(&self, tile: &Tile, want: &Want) -> bool {
        !self.drifts
            && self.reference.is_some_and(|reference| {
                self.age_steps(tile, reference, want.distance_m) > AGE_REST
            })
    }

    /// Notes where rays start now; updates are planned for that.
    pub(super) fn plan_at(&mut self, reference: DVec3) {
        self.reference = Some(reference);
    }

    /// Whether a tile shows the present scene at all.
    #[must_use]
    pub fn shows_present(&self, key: &TileKey) -> bool {
        self.samples_of(key).is_some_and(|samples| samples > 0)
    }

    /// Tiles that viewers want, that show the present scene and have all their samples, in a fixed order.
    #[must_use]
    pub fn settled(&self, samples: TexelSamples) -> Vec<(TileKey, Slot)> {
        let mut settled: Vec<(TileKey, Slot)> = self
            .wanted
            .iter()
            .filter(|(key, want)| {
                want.viewers > 0 && self.samples_of(key) >= Some(samples.of(want))
            })
            .filter_map(|(key, _)| Some((*key, self.tiles.get(key)?.slot)))
            .collect();
        settled.sort_unstable_by_key(|(key, _)| *key);
        settled
    }

    /// Updates that would gain something.
    pub(super) fn candidates(
        &self,
        samples: TexelSamples,
        reference: DVec3,
        is_calm: bool,
        into: &mut Vec<Candidate>,
    ) {
        for (key, want) in &self.wanted {
            let coarse = key.level == 0;
            let tile = self.tiles.get(key);
            let have = self.samples_of(key).unwrap_or(0);
            let samples = samples.of(want);
            let urgency = match tile {
                None if coarse => Urgency::Coarse,
                None => Urgency::Missing,
                Some(tile) if tile.visits == 0 && coarse => Urgency::Coarse,
                Some(tile) if tile.visits == 0 => Urgency::Missing,
                Some(_) if have == 0 && coarse => Urgency::Coarse,
                Some(_) if have == 0 => Urgency::Stale,
                Some(tile)
                    if have < samples
                        || tile.resampled
                        || tile.refreshes != self.refreshes
                        || self.is_aged(*key, tile, want, reference, is_calm) =>
                {
                    Urgency::Wrong
                }
                Some(_) => continue,
            };
            let gained = tile
                .filter(|_| urgency == Urgency::Wrong)
                .map_or(0.0, |tile| {
                    self.gained_percent(tile, reference, want.distance_m, samples)
                });
            into.push(Candidate {
                key: *key,
                urgency,
                seen_percent: gained * f64::from(want.viewers.max(1)),
                attention: want.attention,
                eccentricity_rad: want.eccentricity_rad,
                owed: samples.saturating_sub(have).max(1),
            });
        }
    }

    /// Gives a tile a slot.
    pub(super) fn insert(&mut self, key: TileKey, slot: Slot, frame: u64) {
        let rate = self.rate_of_parent(key);
        self.tiles.insert(
            key,
            Tile {
                slot,
                samples: 0,
                rate,
                old_samples: 0.0,
                visits: 0,
                generation: self.generation,
                marched_from: DVec3::ZERO,
                shown_from: DVec3::ZERO,
                evolved_m: 0.0,
                refreshes: self.refreshes,
                sampled: None,
                last_seen_frame: frame,
                moved: self.moved,
                left: SkyWay::default(),
                left_m: 0.0,
                resampled: false,
            },
        );
    }

    /// Notes that a tile takes a sample now.
    pub(super) fn sample(
        &mut self,
        key: TileKey,
        samples: TexelSamples,
        reference: DVec3,
    ) -> Option<Sample> {
        let want = self.wanted.get(&key).copied();
        let distance_m = want.map_or(1.0, |want| want.distance_m);
        let owed = want.map_or(samples.most, |want| samples.of(&want));
        let samples = samples.most;
        let old = self.tiles.get(&key)?;
        let age = self.age_steps(old, reference, distance_m);
        let behind_m = self.behind_m(old, reference);
        let from = reference + self.course * self.lead_m(key, old, distance_m);
        let tile = self.tiles.get_mut(&key)?;
        let stale = tile.visits == 0 || tile.generation != self.generation;
        let behind = tile.behind(self.moved);
        // What ages slowly may be seen from farther away.
        let restart = if self.drifts {
            AGE_RESTART / tile.rate.min(1.0)
        } else {
            AGE_RESTART
        };
        if stale || age > restart || behind.steps > BEHIND_RESTART {
            tile.samples = 0;
            tile.old_samples = 0.0;
        } else if !self.drifts && age > AGE_REST && tile.samples >= owed {
            tile.samples = 0;
            tile.old_samples = OLD_SAMPLES;
        } else if tile.resampled && tile.samples >= owed {
            tile.samples = 0;
            tile.old_samples = RESAMPLED_SAMPLES;
        }
        tile.resampled = false;
        let weight = if tile.samples < samples {
            1.0 / ((tile.samples + 1) as f32 + tile.old_samples)
        } else {
            REFRESH_WEIGHT
        };
        // A tile far behind comes as near as it may stay; one that is close takes little noise from one sample.
        let weight = weight.max(weight_that_leaves(BEHIND_KEPT, behind.steps));
        let weight = if self.drifts {
            weight.max(weight_that_leaves(
                AGE_KEPT,
                steps_of_age(behind_m, distance_m),
            ))
        } else {
            weight
        };
        let kept = f64::from(1.0 - weight);
        tile.left = behind * kept;
        tile.left_m = behind_m * kept;
        tile.moved = self.moved;
        let index = if tile.samples < samples {
            tile.samples
        } else {
            tile.visits % samples
        };
        if tile.visits == 0 {
            self.tables_changed = true;
        }
        tile.samples = (tile.samples + 1).min(samples);
        tile.visits = tile.visits.wrapping_add(1).max(1);
        tile.generation = self.generation;
        tile.marched_from = reference;
        let old_from = if weight < 1.0 { tile.shown_from } else { from };
        tile.shown_from = from;
        tile.evolved_m = self.evolved_m;
        tile.refreshes = self.refreshes;
        tile.sampled = Some(Instant::now());
        Some(Sample {
            slot: tile.slot,
            index,
            weight,
            from,
            old_from,
        })
    }

    /// How far what a tile's mixture shows is behind: its reference, and the noise in it, since its last sample, and what that
    /// sample left of before, m. Never less than it is: a way back does not undo a way there.
    fn age_m(&self, tile: &Tile, reference: DVec3) -> f64 {
        let moved_m = tile.marched_from.distance(reference);
        let evolved_m = (tile.evolved_m - self.evolved_m).abs();
        tile.left_m + moved_m + evolved_m
    }

    fn age_steps(&self, tile: &Tile, reference: DVec3, distance_m: f64) -> f64 {
        steps_of_age(self.age_m(tile, reference), distance_m)
    }

    /// As if every tile had taken so many samples.
    #[cfg(test)]
    pub(super) fn set_visits(&mut self, visits: u32) {
        for tile in self.tiles.values_mut() {
            tile.visits = visits;
        }
    }

    /// The tiles in a slot or in a higher one.
    pub(super) fn slots_from(&self, lowest: Slot) -> impl Iterator<Item = (Slot, TileKey)> + '_ {
        let slots = self.tiles.iter().map(|(key, tile)| (tile.slot, *key));
        slots.filter(move |(slot, _)| *slot >= lowest)
    }

    /// What a tile holds is in another slot.
    pub(super) fn put_in(&mut self, key: &TileKey, slot: Slot) {
        if let Some(tile) = self.tiles.get_mut(key) {
            tile.slot = slot;
            self.tables_changed = true;
        }
    }

    /// Takes a tile's slot away.
    pub(super) fn remove(&mut self, key: &TileKey) -> Option<Slot> {
        self.tables_changed = true;
        self.tiles.remove(key).map(|tile| tile.slot)
    }

    /// Takes every slot away.
    pub(super) fn clear(&mut self) -> Vec<Slot> {
        self.tables_changed = true;
        self.tiles.drain().map(|(_, tile)| tile.slot).collect()
    }

    /// The tiles that may go, because nobody wants them, and when they were seen last.
    pub(super) fn evictable(&self) -> Vec<(u64, TileKey)> {
        self.tiles
            .iter()
            .filter(|(key, _)| !self.wanted.contains_key(key))
            .map(|(key, tile)| (tile.last_seen_frame, *key))
            .collect()
    }

    /// The tables are to be made anew.
    pub fn tables_change(&mut self) {
        self.tables_changed = true;
    }

    /// Whether tables have changed since this was last asked.
    pub fn take_tables_changed(&mut self) -> bool {
        std::mem::take(&mut self.tables_changed)
    }

    /// The tables that a composite reads: for every level and tile the tile itself or the nearest coarser one that
    /// holds a picture. With a time, the upper eight bits tell how long ago each tile was marched.
    #[must_use]
    pub fn page_tables(&self, now: Option<Instant>) -> PageTables {
        let shown = |key: &TileKey| self.tiles.get(key).filter(|tile| tile.visits > 0);
        let levels = 1 + self
            .tiles
            .keys()
            .map(|key| key.level)
            .max()
            .unwrap_or_default();
        let mut tables = PageTables::default();
        let mut before: Option<usize> = None;
        for level in 0..levels {
            let start = tables.entries.len();
            let side = TileKey::tiles_per_side(level) as usize;
            for key in TileKey::all_of(level) {
                let entry = match (shown(&key), before) {
                    (Some(tile), _) => {
                        tile.slot.0 | u32::from(level) << 16 | tile.age_code(now) << 24
                    }
                    (None, Some(parents)) => {
                        let at = usize::from(key.y / 2) * (side / 2) + usize::from(key.x / 2);
                        tables.entries[parents + at]
                    }
                    (None, None) => NO_TILE,
                };
                tables.entries.push(entry);
            }
            tables.level_offsets.push(start as u32);
            before = Some(start);
        }
        tables
    }
}

/// An age as an angle from what a tile shows, in steps.
fn steps_of_age(age_m: f64, distance_m: f64) -> f64 {
    age_m / distance_m.max(1.0) / AGE_STEP_RAD
}

/// The weight of a sample that leaves a mixture `kept` steps of the `behind` that it was; 0 where it may keep all.
fn weight_that_leaves(kept: f64, behind: f64) -> f32 {
    if behind > kept {
        (1.0 - kept / behind) as f32
    } else {
        0.0
    }
}

/// How many steps a tile may be behind the sky before it is marched again.
fn behind_max(is_calm: bool, want: &Want) -> f64 {
    let steps = if is_calm { BEHIND_CALM } else { BEHIND_MOVING };
    if want.viewers == 0 {
        UNSEEN_BEHIND * steps
    } else {
        steps
    }
}
