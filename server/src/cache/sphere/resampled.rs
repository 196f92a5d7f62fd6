//! Tiles of a sphere with another anchor, filled from those of the one before.

use super::{SphereCache, Tile};
use crate::cache::SkyWay;
use crate::cache::address::TileKey;
use crate::cache::pool::Slot;
use glam::{DVec2, DVec3};

impl SphereCache {
    /// An empty sphere that knows of the sky's way and of time what this one knows.
    pub(in crate::cache) fn like(&self) -> Self {
        Self {
            generation: self.generation,
            evolved_m: self.evolved_m,
            drifts: self.drifts,
            course: self.course,
            refreshes: self.refreshes,
            reference: self.reference,
            moved: self.moved,
            samples: self.samples,
            age_factor: self.age_factor,
            tables_changed: true,
            ..Self::default()
        }
    }

    /// What is wanted: the coarse level, then what viewers ask for, nearest to the middles of their pictures first.
    pub(in crate::cache) fn wanted_keys(&self) -> Vec<TileKey> {
        let mut keys: Vec<(bool, f64, TileKey)> = self
            .wanted
            .iter()
            .map(|(key, want)| (key.level > 0, want.eccentricity_rad, *key))
            .collect();
        keys.sort_unstable_by(|a, b| {
            (a.0.cmp(&b.0))
                .then(a.1.total_cmp(&b.1))
                .then(a.2.cmp(&b.2))
        });
        keys.into_iter().map(|(_, _, key)| key).collect()
    }

    /// The level of the old tiles that a new one is read from: the next finer one, since texels about another anchor are of
    /// other sizes. The coarsest is always whole.
    #[must_use]
    pub fn source_level(key: TileKey) -> u8 {
        if key.level == 0 { 0 } else { key.level + 1 }
    }

    /// The tiles that page tables name at some places of the octahedral square for a tile that is read from them.
    pub(in crate::cache) fn sources(&self, key: TileKey, places: &[DVec2]) -> Vec<Tile> {
        let mut keys: Vec<TileKey> = places
            .iter()
            .filter_map(|place| self.shown_at(*place, Self::source_level(key)))
            .collect();
        keys.sort_unstable();
        keys.dedup();
        keys.iter()
            .filter_map(|key| self.tiles.get(key).copied())
            .collect()
    }

    /// The finest tile up to a level that shows a place of the octahedral square.
    fn shown_at(&self, place: DVec2, level: u8) -> Option<TileKey> {
        let tile_at = |level: u8| {
            let side = TileKey::tiles_per_side(level);
            let index = |share: f64| ((share * f64::from(side)) as u32).min(side - 1) as u16;
            TileKey {
                level,
                x: index(place.x),
                y: index(place.y),
            }
        };
        (0..=level)
            .rev()
            .map(tile_at)
            .find(|key| self.tiles.get(key).is_some_and(|tile| tile.visits > 0))
    }

    /// Gives a tile a slot that is filled from others, of the sphere `old`: it is as good as the worst of them, and is to be
    /// marched when there is time.
    pub(in crate::cache) fn insert_resampled(
        &mut self,
        key: TileKey,
        slot: Slot,
        old: &Self,
        sources: &[Tile],
        reference: DVec3,
        frame: u64,
    ) {
        let all = |holds: &dyn Fn(&Tile) -> bool| sources.iter().all(holds);
        let most = |value: &dyn Fn(&Tile) -> f64| sources.iter().map(value).fold(0.0, f64::max);
        // Of another generation counts as one before, whichever.
        let behind_by = |is_present: bool| u32::from(!is_present);
        self.tables_changed = true;
        self.tiles.insert(
            key,
            Tile {
                slot,
                samples: sources.iter().map(|tile| tile.samples).min().unwrap_or(0),
                old_samples: 0.0,
                visits: 1,
                generation: self
                    .generation
                    .wrapping_sub(behind_by(all(&|tile| tile.generation == old.generation))),
                sampled: sources.iter().filter_map(|tile| tile.sampled).min(),
                marched_from: reference,
                shown_from: sources.iter().map(|tile| tile.shown_from).sum::<DVec3>()
                    / sources.len().max(1) as f64,
                evolved_m: self.evolved_m,
                refreshes: self
                    .refreshes
                    .wrapping_sub(behind_by(all(&|tile| tile.refreshes == old.refreshes))),
                last_seen_frame: frame,
                moved: self.moved,
                left: SkyWay {
                    steps: most(&|tile| tile.behind(old.moved).steps),
                    percent: most(&|tile| tile.behind(old.moved).percent),
                },
                left_m: most(&|tile| old.age_m(tile, reference)),
                resampled: true,
                rate: most(&|tile| tile.rate),
            },
        );
    }

    /// What a tile shows is what is seen from a place.
    pub(in crate::cache) fn shows_from(&mut self, key: &TileKey, from: DVec3) {
        if let Some(tile) = self.tiles.get_mut(key) {
            tile.shown_from = from;
        }
    }

    /// Where the rays of a tile's texels started on the mean, in the frame that drifts with the layer.
    #[must_use]
    pub fn shown_from(&self, key: &TileKey) -> Option<DVec3> {
        self.tiles.get(key).map(|tile| tile.shown_from)
    }

    /// Whether the coarse level is wanted and shows something everywhere.
    #[must_use]
    pub fn coarse_is_shown(&self) -> bool {
        let mut coarse = self.wanted.keys().filter(|key| key.level == 0).peekable();
        let is_wanted = coarse.peek().is_some();
        is_wanted && coarse.all(|key| self.tiles.get(key).is_some_and(|tile| tile.visits > 0))
    }

    /// How far the nearest tile of the coarse level is behind a reference, steps: more than a few when that has jumped.
    #[must_use]
    pub fn nearest_age_steps(&self, reference: DVec3) -> Option<f64> {
        self.wanted
            .iter()
            .filter(|(key, _)| key.level == 0)
            .filter_map(|(key, want)| Some((self.tiles.get(key)?, want.distance_m)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(tile, distance_m)| self.age_steps(tile, reference, distance_m))
    }

    /// Whether a tile of such an age shows nothing of what is seen from where the reference is now.
    #[must_use]
    pub fn is_of_elsewhere(&self, reference: DVec3) -> bool {
        self.nearest_age_steps(reference)
            .is_none_or(|age| age > super::AGE_RESTART)
    }
}

#[cfg(test)]
mod tests {
    use crate::cache::TexelSamples;
    use crate::cache::{Caches, SphereId, TileKey, TileRequest};
    use glam::{DVec2, DVec3};
    use skycell_protocol::CellId;

    const SPHERE: SphereId = SphereId {
        cell: CellId(1),
        proxy: 0,
    };
    const SAMPLES: u32 = 4;

    fn request(key: TileKey) -> TileRequest {
        TileRequest {
            key,
            eccentricity_rad: 0.1,
            distance_m: 2_000.0,
            screen_share: 0.1,
            texel_pixels: 1.0,
        }
    }

    /// Updates until nothing is left to do.
    fn converge(caches: &mut Caches, at: DVec3) -> usize {
        let mut updates = 0;
        loop {
            let planned = caches.plan(7, |_| Some(at)).len();
            if planned == 0 {
                return updates;
            }
            updates += planned;
        }
    }

    /// The middle of a tile in a square that is turned by half against the new one.
    fn turned(key: TileKey) -> Vec<DVec2> {
        let side = f64::from(TileKey::tiles_per_side(key.level));
        let middle = DVec2::new(f64::from(key.x), f64::from(key.y)) + 0.5;
        vec![DVec2::ONE - middle / side]
    }

    /// A whole coarse level and some finer tiles, which are then wanted about another anchor.
    fn moved(tiles_max: u32, age: impl FnOnce(&mut Caches)) -> (Caches, usize) {
        let mut caches = Caches::new(tiles_max, SAMPLES);
        let coarse: Vec<TileRequest> = TileKey::all_of(0).map(request).collect();
        let fine = |x: u16, y: u16| TileKey { level: 1, x, y };
        let before: Vec<TileRequest> = (1..5).map(|x| request(fine(x, 5))).collect();
        let after: Vec<TileRequest> = (5..9).map(|x| request(fine(x, 4))).collect();
        caches.sphere_mut(SPHERE).set_wanted(&coarse, &before);
        converge(&mut caches, DVec3::ZERO);
        assert!(caches.sphere_mut(SPHERE).coarse_is_shown());
        age(&mut caches);
        let old = caches
            .take_spheres(SPHERE.cell)
            .remove(&0)
            .expect("a sphere");
        caches.sphere_mut(SPHERE).set_wanted(&coarse, &after);
        let filled = caches.resample(SPHERE, &old, DVec3::ZERO, false, turned);
        let slots: std::collections::HashSet<_> = filled.iter().map(|(_, slot)| *slot).collect();
        assert_eq!(slots.len(), filled.len(), "a slot has one owner");
        caches.release(old);
        assert_eq!(
            caches.resident() as usize,
            filled.len(),
            "old slots are given back"
        );
        (caches, filled.len())
    }

    #[test]
    fn what_was_filled_is_shown_at_once_and_marched_when_there_is_time() {
        let (mut caches, filled) = moved(100, |_| {});
        assert_eq!(filled, 29);
        let sphere = caches.sphere_mut(SPHERE);
        assert!((5..9).all(|x| sphere.shows_present(&TileKey { level: 1, x, y: 4 })));
        assert_eq!(
            sphere.settled(TexelSamples::each(SAMPLES)).len(),
            4,
            "with all samples"
        );
        assert!(sphere.take_tables_changed());
        // One for the coarse level, all for what viewers see; the first weighs a third.
        let first = caches.plan(1, |_| Some(DVec3::ZERO));
        assert!((first[0].weight - 1.0 / 3.0).abs() < 1e-6, "{first:?}");
        let updates = 1 + converge(&mut caches, DVec3::ZERO);
        assert_eq!(updates, 25 + 4 * SAMPLES as usize);
    }

    #[test]
    fn what_was_filled_is_as_old_as_the_worst_that_it_was_filled_from() {
        // Of a sky before: shown, and marched before what is only blurred.
        let (mut caches, _) = moved(100, Caches::age_all);
        let sphere = caches.sphere_mut(SPHERE);
        assert!(!sphere.shows_present(&TileKey {
            level: 1,
            x: 5,
            y: 4
        }));
        assert!(sphere.coarse_is_shown());
        let all = 25 + 4 * SAMPLES as usize;
        assert_eq!(converge(&mut caches, DVec3::ZERO), all);
        // Seen from elsewhere: nothing of the old view is left, as without new anchors.
        let (mut caches, _) = moved(100, |_| {});
        let far = DVec3::X * 2_000.0;
        assert!(caches.sphere_mut(SPHERE).is_of_elsewhere(far));
        assert!(
            caches
                .plan(40, |_| Some(far))
                .iter()
                .all(|update| update.weight == 1.0)
        );
    }

    #[test]
    fn with_too_few_slots_the_coarse_level_comes_first() {
        // 29 are in use, 27 are left.
        let (mut caches, filled) = moved(56, |_| {});
        assert_eq!(filled, 27);
        assert!(caches.sphere_mut(SPHERE).coarse_is_shown());
    }
}
