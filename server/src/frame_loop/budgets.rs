//! What cells lose where memory or the time for marching do not suffice: decided in `cache/budget`, told to the caches here and
//! said to people.

#[cfg(test)]
mod tests;

use super::cells_on_device::ActiveCell;
use super::interface::LossStats;
use super::renderer::SkyRenderer;
use crate::cache::{LEVELS_LOST_MAX, MemoryGovernor, Rate, RateGovernor, TileRequest, Wish};
use crate::quality::Pace;
use skycell_protocol::CellId;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// How often the work that waits is looked at.
const RATE_INTERVAL: Duration = Duration::from_millis(500);
/// A tile that nobody wants and that was not seen for so long, or up to twice that, gives its slot back: where people travel
/// memory holds what they look at, and not where they were.
const UNSEEN_KEPT: Duration = Duration::from_secs(60);
/// Tiles that move at a time: recording a copy takes the thread some microseconds.
const MOVED_MAX: usize = 1024;
/// From this share of a budget on, wishes are counted tile by tile; below it, it is enough that they fit.
const COUNTED_FROM: f64 = 0.5;

/// Losses of all cells.
#[derive(Debug)]
pub(super) struct Losses {
    memory: MemoryGovernor,
    rate: RateGovernor,
    /// Clocks of both begin here.
    pub(super) begun: Instant,
    rate_due: Instant,
    backlog_s: f64,
    /// The frame that was shown at a time: tiles that were not seen since go when it is long ago.
    unseen_since: (Instant, u64),
    /// Wishes may not fit, so they are counted.
    are_counted: bool,
}

impl Default for Losses {
    fn default() -> Self {
        let now = Instant::now();
        Self {
            memory: MemoryGovernor::default(),
            rate: RateGovernor::default(),
            begun: now,
            rate_due: now,
            backlog_s: 0.0,
            unseen_since: (now, 0),
            are_counted: false,
        }
    }
}

impl Losses {
    pub(super) fn rate(&self) -> Rate {
        self.rate.rate()
    }

    /// Whether marching keeps up, by what is given up for it.
    pub(super) fn pace(&self) -> Pace {
        match self.rate.rate() {
            rate if rate.coarsens() => Pace::Behind,
            rate if rate == RateGovernor::default().rate() => Pace::KeepsUp,
            _ => Pace::Just,
        }
    }

    /// What a cell would hold of what viewers ask for; an upper bound where that is known to fit.
    pub(super) fn wish_of(
        &self,
        coarse: &[Vec<TileRequest>],
        read: &[&[Vec<TileRequest>]],
    ) -> Wish {
        if read.is_empty() {
            return Wish::default();
        }
        if !self.are_counted {
            let asked = read.iter().flat_map(|layers| layers.iter());
            let tiles = coarse.iter().chain(asked).map(Vec::len).sum::<usize>();
            return Wish::even(tiles as u64);
        }
        let mut wish = Wish::default();
        for (layer, coarse) in coarse.iter().enumerate() {
            wish.add(coarse, read.iter().filter_map(|r| r.get(layer)).flatten());
        }
        wish
    }
}

impl SkyRenderer {
    /// Lets cells lose levels until what is wanted fits, and gives levels back when there has been room for a while. Returns the
    /// cells whose wishes have to be told anew.
    pub(super) fn fit_memory(&mut self) -> Vec<CellId> {
        let limits = self.caches.limits();
        let for_time = self.losses.rate().lost;
        let wished = |cell: &ActiveCell| cell.wish.tiles(0);
        let sum: u64 = self.active_cells.values().map(wished).sum();
        let most = self.active_cells.values().map(wished).max().unwrap_or(0);
        let is_near = sum as f64 > COUNTED_FROM * limits.server as f64
            || most as f64 > COUNTED_FROM * limits.cell as f64;
        if is_near && !self.losses.are_counted {
            self.losses.are_counted = true;
            return self.recount();
        }
        if !is_near && !self.losses.memory.is_short() {
            self.losses.are_counted = false;
        }
        let wishes: BTreeMap<CellId, Wish> = self
            .active_cells
            .iter()
            .map(|(id, cell)| (*id, cell.wish.after(for_time)))
            .collect();
        let now_s = self.losses.begun.elapsed().as_secs_f64();
        self.losses.memory.consider(&wishes, limits, now_s);
        let mut changed = Vec::new();
        for (id, cell) in &mut self.active_cells {
            let lost = (self.losses.memory.lost(*id) + for_time).min(LEVELS_LOST_MAX);
            if cell.lost != lost {
                cell.lost = lost;
                changed.push(*id);
            }
        }
        self.tell_anew(&changed);
        changed
    }

    /// Lets all wishes be counted tile by tile.
    fn recount(&mut self) -> Vec<CellId> {
        let all: Vec<CellId> = self.active_cells.keys().copied().collect();
        self.tell_anew(&all);
        all
    }

    fn tell_anew(&mut self, cells: &[CellId]) {
        for id in cells {
            self.change_requests(*id);
        }
    }

    /// Looks at the work that waits, which takes so long at marching's share of the time, and lowers or raises the rate. True
    /// when pictures may be as fine as they get again.
    pub(super) fn consider_rate(
        &mut self,
        now: Instant,
        s_per_tile: f64,
        is_hurried: bool,
    ) -> bool {
        if now < self.losses.rate_due {
            return false;
        }
        self.losses.rate_due = now + RATE_INTERVAL;
        let has_viewers = !self.viewers.is_empty();
        let tiles = if has_viewers {
            self.caches.backlog()
        } else {
            0
        };
        let share = f64::from(self.config.march_share);
        self.losses.backlog_s = tiles as f64 * s_per_tile / share;
        let now_s = now.duration_since(self.losses.begun).as_secs_f64();
        let backlog_s = self.losses.backlog_s;
        let was_coarse = self.losses.rate().coarsens();
        if self.losses.rate.consider(backlog_s, is_hurried, now_s) {
            self.touch_all_requests();
        }
        was_coarse && !self.losses.rate().coarsens()
    }

    /// Lets tiles go that nobody has looked at for long, and pages of the atlas that are empty without them.
    pub(super) fn forget_unseen(&mut self, now: Instant) {
        let (marked, frame) = self.losses.unseen_since;
        if now.duration_since(marked) >= UNSEEN_KEPT {
            self.caches.release_unseen(frame);
            self.losses.unseen_since = (now, self.caches.mark_seen());
            self.give_pages_back();
        }
    }

    /// Where half of the pages would do, tiles move together and the pages at the end go. Tables are to be told before the
    /// next frame.
    fn give_pages_back(&mut self) {
        if !self.atlas.is_half_empty(self.caches.resident()) {
            return;
        }
        let moved = self.caches.gather(MOVED_MAX);
        self.atlas
            .shrink(&self.gpu, self.caches.slots_needed(), &moved);
    }

    /// Levels that a cell has lost for want of memory and of time.
    pub(super) fn levels_lost(&self, cell: CellId) -> u8 {
        self.active_cells.get(&cell).map_or(0, |cell| cell.lost)
    }

    /// What a cell has lost, for people; none where it has lost nothing.
    pub(super) fn loss_note(&self, id: CellId) -> Option<String> {
        let cell = self.active_cells.get(&id)?;
        let rate = self.losses.rate();
        let mut notes = Vec::new();
        if self.losses.memory.lost(id) > 0 {
            let limits = self.caches.limits();
            notes.push(format!(
                "the memory for tiles does not suffice ({} wished, {} in all, {} a cell)",
                cell.wish.tiles(0),
                limits.server,
                limits.cell
            ));
        }
        if rate != RateGovernor::default().rate() {
            let fewer = match rate.samples_divisor {
                1 => String::new(),
                divisor => format!(", samples are divided by {divisor}"),
            };
            notes.push(format!(
                "the time for marching does not suffice (texels wait {} times as long{fewer})",
                rate.age_factor
            ));
        }
        if cell.lost > 0 {
            notes.push(format!("the mip bias is {} higher", cell.lost));
        }
        notes.extend(self.error_note(id));
        (!notes.is_empty()).then(|| notes.join("; "))
    }

    /// What is given up now, in figures.
    pub(super) fn loss_stats(&self) -> LossStats {
        let limits = self.caches.limits();
        let cells = || self.active_cells.values();
        let rate = self.losses.rate();
        LossStats {
            tiles_max: limits.server,
            cell_tiles_max: limits.cell,
            tiles_wished: cells().map(|cell| cell.wish.tiles(0)).sum(),
            tiles_granted: cells().map(|cell| cell.wish.tiles(cell.lost)).sum(),
            tiles_refused: self.caches.refused(),
            levels_lost_most: cells().map(|cell| cell.lost).max().unwrap_or(0),
            memory_changes: self.losses.memory.changes(),
            rate_step: self.losses.rate.step(),
            age_factor: rate.age_factor,
            samples_divisor: rate.samples_divisor,
            levels_lost_to_time: rate.lost,
            rate_changes: self.losses.rate.changes(),
            backlog_s: self.losses.backlog_s,
        }
    }
}
