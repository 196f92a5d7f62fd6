//! What is given up where memory or time do not suffice, and when it comes back. Pure decisions over plain numbers: the same
//! numbers at the same times always give the same losses.
//!
//! A cell gives up *levels*: it wants the ancestors of what its viewers ask for, a quarter of the tiles with each level.
//! Memory takes levels from the cells that hold most, time takes samples and turns from all, and levels when that is not
//! enough. Losses come at once, or as soon as it is clear that they must, and go one by one after a calm time.

use super::address::{LEVELS, TileKey};
use super::requests::TileRequest;
use skycell_protocol::CellId;
use std::collections::{BTreeMap, HashMap, HashSet};

/// Most levels that a cell may lose: of the finest only the coarse one is left.
pub const LEVELS_LOST_MAX: u8 = LEVELS - 1;
/// Share of a memory budget into which tiles must fit before a level comes back.
const ROOMY: f64 = 0.85;
/// How long they must have fitted, s.
const CALM_S: f64 = 5.0;
/// What was given back and is lost again within this time, s, is waited for twice as long the next time, ...
const HOLD_S: f64 = 60.0;
/// ... up to this, s.
const CALM_MAX_S: f64 = 80.0;

/// Marching may be behind by so much work, s at its share of the time, whatever comes.
const BACKLOG_MAX_S: f64 = 1.5;
/// Being behind by no more is keeping up.
const BACKLOG_LOW_S: f64 = 0.3;
/// Work that becomes less is looked at for so long, s, ...
const BACKLOG_WINDOW_S: f64 = 4.0;
/// ... in which it must shrink by this share of what could be marched meanwhile: else as much comes as goes.
const BACKLOG_SHRINKS: f64 = 0.25;
/// When all has rested for so long, s, everything is marched: nobody waits for frames then.
const REST_S: f64 = 2.0;

/// The requests of one viewer with levels lost: what covers them, none twice.
#[must_use]
pub fn coarsened(requests: &[TileRequest], lost: u8) -> Vec<TileRequest> {
    if lost == 0 {
        return requests.to_vec();
    }
    let mut covering: HashMap<TileKey, TileRequest> = HashMap::new();
    for request in requests {
        let key = request.key.coarser(lost);
        let seen = covering.entry(key).or_insert(TileRequest {
            key,
            screen_share: 0.0,
            texel_pixels: 0.0,
            ..*request
        });
        seen.eccentricity_rad = seen.eccentricity_rad.min(request.eccentricity_rad);
        seen.distance_m = seen.distance_m.min(request.distance_m);
        seen.screen_share += request.screen_share;
        // Texels of a level have the area of four of the next.
        let texel_pixels =
            request.texel_pixels * 4f64.powi(i32::from(request.key.level - key.level));
        seen.texel_pixels = seen.texel_pixels.max(texel_pixels);
    }
    let mut covering: Vec<TileRequest> = covering.into_values().collect();
    covering.sort_unstable_by_key(|request| request.key);
    covering
}

/// How many tiles a cell wants, by the number of levels that it has lost: never more with more of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wish([u64; LEVELS as usize]);

impl Wish {
    /// Of the same number of tiles whatever is lost: where that is known to fit there is no need to know better.
    #[must_use]
    pub fn even(tiles: u64) -> Self {
        Self([tiles; LEVELS as usize])
    }

    /// Adds one sphere's: what its viewers ask for, and its coarse level.
    pub fn add<'a>(
        &mut self,
        coarse: &[TileRequest],
        requests: impl IntoIterator<Item = &'a TileRequest>,
    ) {
        let coarse: HashSet<TileKey> = coarse.iter().map(|request| request.key).collect();
        let mut keys: HashSet<TileKey> = requests.into_iter().map(|request| request.key).collect();
        for tiles in &mut self.0 {
            let beside = coarse.iter().filter(|key| !keys.contains(key)).count();
            *tiles += (keys.len() + beside) as u64;
            keys = keys.into_iter().map(|key| key.coarser(1)).collect();
        }
    }

    /// Tiles with levels lost.
    #[must_use]
    pub fn tiles(&self, lost: u8) -> u64 {
        self.0[usize::from(lost.min(LEVELS_LOST_MAX))]
    }

    /// What is wanted by a cell that has lost some levels for another reason.
    #[must_use]
    pub fn after(&self, lost: u8) -> Self {
        let mut levels = 0..LEVELS;
        Self([(); LEVELS as usize].map(|()| self.tiles(lost + levels.next().unwrap_or(0))))
    }
}

/// How many tiles there may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileLimits {
    /// In all cells together.
    pub server: u64,
    /// In each.
    pub cell: u64,
}

impl TileLimits {
    fn scaled(self, share: f64) -> Self {
        let scaled = |tiles: u64| (tiles as f64 * share) as u64;
        Self {
            server: scaled(self.server),
            cell: scaled(self.cell),
        }
    }
}

/// The least levels that each cell must lose so that all fit: whoever holds most gives first, so nobody who holds little pays
/// for somebody who asks for much. Where even the coarse levels do not fit, all else is lost.
#[must_use]
pub fn least_losses(wishes: &BTreeMap<CellId, Wish>, limits: TileLimits) -> BTreeMap<CellId, u8> {
    let fits_alone = |wish: &Wish| {
        (0..LEVELS)
            .find(|lost| wish.tiles(*lost) <= limits.cell)
            .unwrap_or(LEVELS_LOST_MAX)
    };
    let mut lost: BTreeMap<CellId, u8> = wishes
        .iter()
        .map(|(id, wish)| (*id, fits_alone(wish)))
        .collect();
    let mut sum: u64 = lost.iter().map(|(id, lost)| wishes[id].tiles(*lost)).sum();
    while sum > limits.server {
        // Of equals the one that came last.
        let most = lost
            .iter()
            .map(|(id, lost)| (wishes[id].tiles(*lost), *id, *lost))
            .filter(|(tiles, id, _)| *tiles > wishes[id].tiles(LEVELS_LOST_MAX))
            .max();
        let Some((tiles, id, before)) = most else {
            break;
        };
        lost.insert(id, before + 1);
        sum = sum - tiles + wishes[&id].tiles(before + 1);
    }
    lost
}

/// How long to wait before something comes back: longer each time that it did not hold.
#[derive(Clone, Copy, Debug)]
struct Calm {
    calm_s: f64,
    since_s: Option<f64>,
    regained_s: Option<f64>,
}

impl Calm {
    const fn new() -> Self {
        Self {
            calm_s: CALM_S,
            since_s: None,
            regained_s: None,
        }
    }

    /// Something was lost.
    fn lost(&mut self, now_s: f64) {
        if self
            .regained_s
            .take()
            .is_some_and(|at_s| now_s - at_s < HOLD_S)
        {
            self.calm_s = (2.0 * self.calm_s).min(CALM_MAX_S);
        }
        self.since_s = None;
    }

    /// Something may come back if there is still room; true when it does.
    fn regains(&mut self, has_room: bool, now_s: f64) -> bool {
        if !has_room {
            self.since_s = None;
            return false;
        }
        if self.regained_s.is_some_and(|at_s| now_s - at_s >= HOLD_S) {
            self.calm_s = CALM_S;
        }
        if now_s - *self.since_s.get_or_insert(now_s) < self.calm_s {
            return false;
        }
        self.since_s = None;
        self.regained_s = Some(now_s);
        true
    }
}

#[derive(Clone, Copy, Debug)]
struct CellLoss {
    lost: u8,
    calm: Calm,
}

/// Levels that cells have lost for want of memory.
#[derive(Clone, Debug, Default)]
pub struct MemoryGovernor {
    cells: BTreeMap<CellId, CellLoss>,
    changes: u64,
}

impl MemoryGovernor {
    /// Takes what cells want by now; true when losses have changed. What they then want fits, unless even the coarse levels do
    /// not.
    pub fn consider(
        &mut self,
        wishes: &BTreeMap<CellId, Wish>,
        limits: TileLimits,
        now_s: f64,
    ) -> bool {
        self.cells.retain(|id, _| wishes.contains_key(id));
        let needed = least_losses(wishes, limits);
        let mut roomy = None;
        let mut changed = false;
        for (id, needed) in needed {
            if needed == 0 && !self.cells.contains_key(&id) {
                continue;
            }
            let cell = self.cells.entry(id).or_insert(CellLoss {
                lost: 0,
                calm: Calm::new(),
            });
            if needed > cell.lost {
                cell.lost = needed;
                cell.calm.lost(now_s);
                changed = true;
            } else if cell.lost > 0 {
                let roomy = roomy.get_or_insert_with(|| least_losses(wishes, limits.scaled(ROOMY)));
                let has_room = roomy.get(&id).is_some_and(|least| *least < cell.lost);
                if cell.calm.regains(has_room, now_s) {
                    cell.lost -= 1;
                    changed = true;
                }
            }
        }
        self.changes += u64::from(changed);
        changed
    }

    /// Levels that a cell has lost.
    #[must_use]
    pub fn lost(&self, cell: CellId) -> u8 {
        self.cells.get(&cell).map_or(0, |cell| cell.lost)
    }

    /// Whether some cell has lost anything.
    #[must_use]
    pub fn is_short(&self) -> bool {
        self.cells.values().any(|cell| cell.lost > 0)
    }

    /// How often losses have changed.
    #[must_use]
    pub fn changes(&self) -> u64 {
        self.changes
    }
}

/// What is given up for want of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Texels that age are marched again when they are so many times as far behind.
    pub age_factor: f64,
    /// Samples of a texel are divided by it.
    pub samples_divisor: u32,
    /// Levels that every cell has lost.
    pub lost: u8,
}

/// From nothing given up to the least that can be done: first what only shows in motion, then noise, then resolution.
const RATES: [Rate; 6] = {
    const fn rate(age_factor: f64, samples_divisor: u32, lost: u8) -> Rate {
        Rate {
            age_factor,
            samples_divisor,
            lost,
        }
    }
    [
        rate(1.0, 1, 0),
        rate(2.0, 1, 0),
        rate(2.0, 2, 0),
        rate(4.0, 4, 0),
        rate(4.0, 4, 1),
        rate(4.0, 4, 2),
    ]
};

impl Rate {
    /// Samples of a texel that should average so many.
    #[must_use]
    pub fn samples(&self, samples: u32) -> u32 {
        (samples / self.samples_divisor).max(1)
    }

    /// Whether a picture at rest would be finer with nothing given up.
    #[must_use]
    pub fn coarsens(&self) -> bool {
        self.samples_divisor > 1 || self.lost > 0
    }
}

/// What all cells have lost for want of time.
#[derive(Clone, Debug)]
pub struct RateGovernor {
    step: usize,
    /// When work that is behind was last looked at, s, and how much it was.
    looked: Option<(f64, f64)>,
    rested_since_s: Option<f64>,
    calm: Calm,
    changes: u64,
}

impl Default for RateGovernor {
    fn default() -> Self {
        Self {
            step: 0,
            looked: None,
            rested_since_s: None,
            calm: Calm::new(),
            changes: 0,
        }
    }
}

impl RateGovernor {
    /// Takes how long the work that waits takes, s of wall time at the share that marching has while somebody moves or the sky
    /// does; true when something was given up or came back.
    pub fn consider(&mut self, backlog_s: f64, is_hurried: bool, now_s: f64) -> bool {
        let before = self.step;
        if is_hurried {
            self.rested_since_s = None;
            self.hurry(backlog_s, now_s);
        } else {
            self.looked = None;
            let since_s = *self.rested_since_s.get_or_insert(now_s);
            if self.step > 0 && now_s - since_s >= REST_S {
                self.step = 0;
                self.calm.regained_s = Some(now_s);
            }
        }
        self.changes += u64::from(self.step != before);
        self.step != before
    }

    fn hurry(&mut self, backlog_s: f64, now_s: f64) {
        if backlog_s <= BACKLOG_MAX_S {
            self.looked = None;
            let has_room = self.step > 0 && backlog_s <= BACKLOG_LOW_S;
            if self.calm.regains(has_room, now_s) {
                self.step -= 1;
            }
            return;
        }
        self.calm.since_s = None;
        let (looked_s, was_s) = *self.looked.get_or_insert((now_s, backlog_s));
        let passed_s = now_s - looked_s;
        if passed_s < BACKLOG_WINDOW_S {
            return;
        }
        self.looked = Some((now_s, backlog_s));
        if was_s - backlog_s < BACKLOG_SHRINKS * passed_s && self.step + 1 < RATES.len() {
            self.step += 1;
            self.looked = None;
            self.calm.lost(now_s);
        }
    }

    /// What is given up now.
    #[must_use]
    pub fn rate(&self) -> Rate {
        RATES[self.step]
    }

    /// How far down, 0 for nothing given up.
    #[must_use]
    pub fn step(&self) -> u32 {
        self.step as u32
    }

    /// How often it has changed.
    #[must_use]
    pub fn changes(&self) -> u64 {
        self.changes
    }
}

#[cfg(test)]
mod tests;
