//! What a tile is expected to be wrong by, and what audits make of that.

use super::{
    AGE_DRIFTING, AGE_MOVED, AGE_REST, AGE_STEP_RAD, CARRIED_BEHIND, LEAD_MAX_M, RESAMPLED_SAMPLES,
    SphereCache, Tile, Want, behind_max, steps_of_age,
};
use crate::cache::address::TileKey;
use glam::DVec3;
use serde::Serialize;

/// Deviation of a texel, as audits measure it, for an angle by which the reference has moved or the noise has risen, seen from
/// what the tile shows, percent/rad.
const PERCENT_PER_RAD: f64 = 300.0;
/// For a step of the sky that is just not seen, percent.
const PERCENT_PER_STEP: f64 = 0.5;
/// Of a texel with a single sample, percent; it falls with the root of their number.
const PERCENT_OF_A_SAMPLE: f64 = 4.0;
/// No deviation is expected to be larger: both show clouds of one sky.
const PERCENT_MAX: f64 = 50.0;
/// The rates that expected errors follow from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AgeingRates {
    /// For an angle by which the reference has moved or noise has risen, seen from what a tile shows, percent/rad.
    pub percent_per_rad: f64,
    /// For a step of the sky that is just not seen, percent.
    pub percent_per_step: f64,
    /// Of a texel with a single sample, percent.
    pub percent_of_a_sample: f64,
    /// Share of the way of the reference that stays in what is carried over.
    pub carried_behind: f64,
    /// The angle of a step of age, rad.
    pub age_step_rad: f64,
    /// Steps of age from one sample to the next under wind.
    pub age_moved: f64,
}

impl AgeingRates {
    /// What caches reckon with.
    pub const RECKONED: Self = Self {
        percent_per_rad: PERCENT_PER_RAD,
        percent_per_step: PERCENT_PER_STEP,
        percent_of_a_sample: PERCENT_OF_A_SAMPLE,
        carried_behind: CARRIED_BEHIND,
        age_step_rad: AGE_STEP_RAD,
        age_moved: AGE_MOVED,
    };
}

/// How much slower or faster than that a tile may be taken to age: what an audit has seen of it are some texels.
const RATES: [f64; 2] = [0.25, 2.0];
/// Less than this is nothing, percent.
const NOTHING_PERCENT: f64 = 0.2;
/// How far an audit of eight texels moves a rate towards what it has found, as a power of the ratio.
const AUDIT_GAIN: f64 = 0.35;

impl SphereCache {
    /// How far the reference has moved since a tile's last sample, m.
    fn moved_m(tile: &Tile, reference: DVec3) -> f64 {
        tile.marched_from.distance(reference)
    }

    /// How far a mixture is behind when it is carried over to where a reference is now, m.
    pub(super) fn behind_m(&self, tile: &Tile, reference: DVec3) -> f64 {
        let evolved_m = (tile.evolved_m - self.evolved_m).abs();
        tile.left_m + evolved_m + CARRIED_BEHIND * Self::moved_m(tile, reference)
    }

    /// How far ahead of the reference the rays of a sample start, m: half of the way that it goes until the tile's next one, so
    /// that what is shown until then is seen from too far ahead as long as from too far behind.
    pub(super) fn lead_m(&self, tile: &Tile, distance_m: f64) -> f64 {
        (super::knob("LEAD", 0.5) * AGE_MOVED * AGE_STEP_RAD * distance_m / tile.rate).min(LEAD_MAX_M)
    }

    /// Whether a tile with all its samples is to take another.
    pub(super) fn is_aged(&self, tile: &Tile, want: &Want, reference: DVec3, is_calm: bool) -> bool {
        let steps = |way_m: f64| steps_of_age(way_m, want.distance_m);
        let seen_elsewhere = if self.drifts {
            tile.rate * steps(Self::moved_m(tile, reference)) > AGE_MOVED
                || tile.rate * steps(self.behind_m(tile, reference)) > AGE_DRIFTING
        } else {
            self.age_steps(tile, reference, want.distance_m) > AGE_REST
        };
        // A sky at rest is brought to the present wherever it is.
        let rate = if is_calm { 1.0 } else { tile.rate };
        seen_elsewhere || rate * tile.behind(self.moved) > behind_max(is_calm, want)
    }

    /// What a tile is expected to be wrong by, percent, as an audit measures it.
    pub(super) fn expected_percent(&self, tile: &Tile, reference: DVec3, distance_m: f64) -> f64 {
        self.expected_of(tile, self.age_m(tile, reference), distance_m)
    }

    fn expected_of(&self, tile: &Tile, way_m: f64, distance_m: f64) -> f64 {
        let samples = if tile.resampled {
            RESAMPLED_SAMPLES
        } else {
            tile.samples.max(1) as f32 + tile.old_samples
        };
        let percent = PERCENT_OF_A_SAMPLE / f64::from(samples).sqrt()
            + PERCENT_PER_RAD * way_m / distance_m.max(1.0)
            + PERCENT_PER_STEP * tile.behind(self.moved);
        (tile.rate * percent).min(PERCENT_MAX)
    }

    /// What an audit is expected to find, percent, and the angle by which what the tile shows is seen from elsewhere, rad.
    #[must_use]
    pub fn expected(&self, key: &TileKey, reference: DVec3) -> Option<(f64, f64)> {
        let tile = self.tiles.get(key)?;
        let distance_m = self.wanted.get(key)?.distance_m.max(1.0);
        let evolved_m = (tile.evolved_m - self.evolved_m).abs();
        let way_m = tile.left_m + evolved_m + tile.shown_from.distance(reference);
        Some((self.expected_of(tile, way_m, distance_m), way_m / distance_m))
    }

    /// An audit has found another deviation than was expected, both percent, the mean of some texels.
    pub(in crate::cache) fn note_audit(&mut self, key: &TileKey, expected: f64, found: f64) {
        if let Some(tile) = self.tiles.get_mut(key) {
            let ratio = (found + NOTHING_PERCENT) / (expected + NOTHING_PERCENT);
            // What is no number fails no comparison of clamp's, and would stay.
            if ratio.is_finite() {
                tile.rate = (tile.rate * ratio.powf(AUDIT_GAIN)).clamp(RATES[0], RATES[1]);
            }
        }
    }

    /// How fast a tile that comes ages: as the one that shows the same more coarsely.
    pub(super) fn rate_of_parent(&self, key: TileKey) -> f64 {
        let parent = key.level.checked_sub(1).map(|level| TileKey {
            level,
            x: key.x / 2,
            y: key.y / 2,
        });
        let parent = parent.and_then(|key| self.tiles.get(&key));
        parent.map_or(1.0, |tile| tile.rate)
    }

    /// How fast a tile is taken to age beside others.
    #[must_use]
    pub fn rate(&self, key: &TileKey) -> Option<f64> {
        self.tiles.get(key).map(|tile| tile.rate)
    }
}
