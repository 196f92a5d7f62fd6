//! What a tile is expected to be wrong by, and what audits make of that.

use super::{
    AGE_DRIFTING, AGE_MOVED, AGE_REST, AGE_STEP_RAD, CARRIED_BEHIND, LEAD_MAX_M, MOVED_TEXELS,
    REFRESH_WEIGHT, RESAMPLED_SAMPLES, SphereCache, Tile, Want, behind_max, steps_of_age,
};
use crate::cache::address::{TileKey, texel_solid_angle_sr};
use glam::DVec3;
use serde::Serialize;

/// Deviation of a texel, as audits measure it, for an angle by which the reference has moved, seen from what the tile shows,
/// percent/rad. Tuned, as those below: `measure ageing`.
const PERCENT_PER_RAD_MOVED: f64 = 90.0;
/// The same for an angle by which noise has risen through the clouds.
const PERCENT_PER_RAD_RISEN: f64 = 250.0;
/// For a step of the sky that is just not seen, percent, where it is the sun's, ...
const PERCENT_PER_STEP_OF_SUN: f64 = 0.1;
/// ... one of coverage, ...
const PERCENT_PER_STEP_OF_COVERAGE: f64 = 2.0;
/// ... of a type, ...
const PERCENT_PER_STEP_OF_TYPE: f64 = 0.3;
/// ... or of any other number: the geometric mean of those.
const PERCENT_PER_STEP: f64 = 0.4;
/// Of a texel with a single sample, percent; it falls with the root of their number. Measured with 1, 2, 4, 8: 2.7, 1.6, 1.2, 0.7.
const PERCENT_OF_A_SAMPLE: f64 = 2.5;
/// No deviation is expected to be larger: both show clouds of one sky.
const PERCENT_MAX: f64 = 50.0;

/// Under wind what a tile shows is seen from elsewhere than the reference by this angle at most, rad.
pub const LAG_RAD: f64 = 0.5 * AGE_MOVED * AGE_STEP_RAD;

/// The rates that expected errors follow from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AgeingRates {
    /// For an angle by which the reference has moved, seen from what a tile shows, percent/rad.
    pub percent_per_rad_moved: f64,
    /// For an angle by which noise has risen, percent/rad.
    pub percent_per_rad_risen: f64,
    /// For a step of the sky that is just not seen, percent, where it is the sun's.
    pub percent_per_step_of_sun: f64,
    /// The same of coverage.
    pub percent_per_step_of_coverage: f64,
    /// The same of a type.
    pub percent_per_step_of_type: f64,
    /// The same of any other number.
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
        percent_per_rad_moved: PERCENT_PER_RAD_MOVED,
        percent_per_rad_risen: PERCENT_PER_RAD_RISEN,
        percent_per_step_of_sun: PERCENT_PER_STEP_OF_SUN,
        percent_per_step_of_coverage: PERCENT_PER_STEP_OF_COVERAGE,
        percent_per_step_of_type: PERCENT_PER_STEP_OF_TYPE,
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
/// No audit counts for more than this times what was expected, or less than its inverse.
const TIMES_MAX: f64 = 8.0;
/// How far an audit moves what audits find of all tiles, in its logarithm.
const ALL_GAIN: f64 = 0.02;
/// How far an audit of eight texels moves a rate towards what it has found, as a power of the ratio.
const AUDIT_GAIN: f64 = 0.35;

/// How audits compare with what was expected, over all tiles: a scene may be harder than the one that rates were measured with,
/// and tiles are to be told from each other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::cache) struct AuditScale {
    /// Natural logarithm of found over expected, the mean of the latest.
    mean: f64,
}

impl AuditScale {
    /// Takes what was found where something was expected, percent both; returns how many times more that is than of others. None
    /// for what is no number.
    pub(in crate::cache) fn times(&mut self, expected: f64, found: f64) -> Option<f64> {
        let most = TIMES_MAX.ln();
        let found = ((found + NOTHING_PERCENT) / (expected + NOTHING_PERCENT)).ln();
        if !found.is_finite() {
            return None;
        }
        let found = found.clamp(-most, most);
        self.mean += ALL_GAIN * (found - self.mean);
        Some((found - self.mean).exp())
    }
}

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

    /// The angle by which the reference may move from one sample of a tile to the next, rad, seen from what it shows.
    fn moved_max_rad(key: TileKey, tile: &Tile) -> f64 {
        let texel_rad = texel_solid_angle_sr(key.level).sqrt();
        (AGE_MOVED * AGE_STEP_RAD).min(MOVED_TEXELS * texel_rad) / tile.rate
    }

    /// How many times as old as otherwise tiles become before they are marched again.
    fn lasts(&self) -> f64 {
        self.age_factor.unwrap_or(1.0)
    }

    /// How far ahead of the reference the rays of a sample start, m: half of the way that it goes until the tile's next one, so
    /// that what is shown until then is seen from too far ahead as long as from too far behind.
    pub(super) fn lead_m(&self, key: TileKey, tile: &Tile, distance_m: f64) -> f64 {
        let lasts = self.lasts().min(1.0);
        (0.5 * lasts * Self::moved_max_rad(key, tile) * distance_m).min(LEAD_MAX_M)
    }

    /// Whether a tile with all its samples is to take another.
    pub(super) fn is_aged(
        &self,
        key: TileKey,
        tile: &Tile,
        want: &Want,
        reference: DVec3,
        is_calm: bool,
    ) -> bool {
        // Where time does not suffice, what moves may get older before its turn comes; less old where audits say so.
        let lasts = self.lasts();
        let seen_elsewhere = if self.drifts {
            let moved_rad = Self::moved_m(tile, reference) / want.distance_m.max(1.0);
            let behind = steps_of_age(self.behind_m(tile, reference), want.distance_m);
            moved_rad > Self::moved_max_rad(key, tile) * lasts
                || tile.rate * behind > AGE_DRIFTING * lasts
        } else {
            self.age_steps(tile, reference, want.distance_m) > AGE_REST
        };
        // A sky at rest is brought to the present wherever it is.
        let (rate, lasts) = if is_calm {
            (1.0, 1.0)
        } else {
            (tile.rate, lasts)
        };
        seen_elsewhere || rate * tile.behind(self.moved).steps > behind_max(is_calm, want) * lasts
    }

    /// By how much one more sample is expected to make a tile with `samples` at most less wrong, percent. Of what is wrong with a
    /// tile most may be there afterwards, too: noise of seven samples is hardly less with an eighth, that of one is with a second.
    pub(super) fn gained_percent(
        &self,
        tile: &Tile,
        reference: DVec3,
        distance_m: f64,
        samples: u32,
    ) -> f64 {
        let taken = f64::from(Self::samples_in(tile));
        let is_whole = tile.samples >= samples;
        let noise = if is_whole {
            0.0
        } else {
            taken.sqrt().recip() - (taken + 1.0).sqrt().recip()
        };
        let weight = if is_whole {
            f64::from(REFRESH_WEIGHT)
        } else {
            (taken + 1.0).recip()
        };
        let moved_m = (1.0 - CARRIED_BEHIND) * Self::moved_m(tile, reference);
        let risen_m = weight * self.risen_m(tile);
        let percent = PERCENT_OF_A_SAMPLE * noise
            + (PERCENT_PER_RAD_MOVED * moved_m + PERCENT_PER_RAD_RISEN * risen_m)
                / distance_m.max(1.0)
            + weight * tile.behind(self.moved).percent;
        (tile.rate * percent).min(PERCENT_MAX)
    }

    /// Samples that what a tile holds counts as.
    fn samples_in(tile: &Tile) -> f32 {
        if tile.resampled {
            RESAMPLED_SAMPLES
        } else {
            tile.samples.max(1) as f32 + tile.old_samples
        }
    }

    /// How far the noise has risen through the clouds since what a tile shows, m.
    fn risen_m(&self, tile: &Tile) -> f64 {
        tile.left_m + (tile.evolved_m - self.evolved_m).abs()
    }

    /// What a tile is expected to be wrong by when it is seen from so far away from where it was marched for, percent.
    fn expected_of(&self, tile: &Tile, moved_m: f64, distance_m: f64) -> f64 {
        let risen_m = self.risen_m(tile);
        let percent = PERCENT_OF_A_SAMPLE / f64::from(Self::samples_in(tile)).sqrt()
            + (PERCENT_PER_RAD_MOVED * moved_m + PERCENT_PER_RAD_RISEN * risen_m)
                / distance_m.max(1.0)
            + tile.behind(self.moved).percent;
        (tile.rate * percent).min(PERCENT_MAX)
    }

    /// What an audit is expected to find, percent, and the angle by which what the tile shows is seen from elsewhere, rad.
    #[must_use]
    pub fn expected(&self, key: &TileKey, reference: DVec3) -> Option<(f64, f64)> {
        let tile = self.tiles.get(key)?;
        let distance_m = self.wanted.get(key)?.distance_m.max(1.0);
        let moved_m = tile.shown_from.distance(reference);
        let risen_m = self.risen_m(tile);
        let expected = self.expected_of(tile, moved_m, distance_m);
        Some((expected, (moved_m + risen_m) / distance_m))
    }

    /// An audit has found so many times the deviation that was expected of a tile, beside what it finds of all.
    pub(in crate::cache) fn note_audit(&mut self, key: &TileKey, times: f64) {
        if let Some(tile) = self.tiles.get_mut(key) {
            tile.rate = (tile.rate * times.powf(AUDIT_GAIN)).clamp(RATES[0], RATES[1]);
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
