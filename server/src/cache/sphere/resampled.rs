//! Tiles of a sphere with another anchor, filled from those of the one before.

use super::{SphereCache, Tile};
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
            refreshes: self.refreshes,
            reference: self.reference,
            moved: self.moved,
            samples: self.samples,
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
                evolved_m: self.evolved_m,
                refreshes: self
                    .refreshes
                    .wrapping_sub(behind_by(all(&|tile| tile.refreshes == old.refreshes))),
                last_seen_frame: frame,
                moved: self.moved,
                left: most(&|tile| tile.behind(old.moved)),
                left_m: most(&|tile| old.age_m(tile, reference)),
                resampled: true,
            },
        );
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
