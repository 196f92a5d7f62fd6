//! Crowds of cameras over minutes: cells, changes between them, distances, texels, time to decide.

use super::tiles::{CrowdTiles, TileSetup, TileSums};
use crate::cells::{CellChange, CellLimit, Cells, Crowd, CrowdMotion, ErrorCurve, Storeys};
use crate::march::{active_layers, layer_bounds_m};
use cpu_time::ThreadTime;
use glam::DVec3;
use serde::Serialize;
use skycell_protocol::{Camera, CellId, Scene, ViewerId};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Whoever is back in a cell within this time has flipped, s.
pub const FLIP_S: f64 = 15.0;
/// Decisions are to take no more, µs.
pub const DECISION_MAX_US: f64 = 1_000.0;
/// How far up everybody looks, degrees.
const PITCH_DEG: f64 = 15.0;
/// Vertical field of view, degrees.
const FOV_DEG: f64 = 60.0;
/// Everybody looks around by so much to each side of where they go, degrees, …
const LOOK_DEG: f64 = 40.0;
/// … once to and fro in this time, s.
const LOOK_S: f64 = 20.0;

/// A crowd and how it is watched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CrowdSetup {
    /// What it does.
    pub motion: CrowdMotion,
    /// How many.
    pub viewers: usize,
    /// For how long, s.
    pub duration_s: f64,
    /// How often cells are decided on, 1/s.
    pub ticks_per_s: u32,
    /// Ticks from one look at the caches to the next.
    pub ticks_per_look: u32,
    /// Of the crowd.
    pub seed: u64,
    /// How wide cells may be.
    pub limit: CellLimit,
    /// What viewers see.
    pub tiles: TileSetup,
}

/// Where values lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// The least.
    pub min: f64,
    /// Half are not above it.
    pub median: f64,
    /// 95 of 100 are not above it.
    pub p95: f64,
    /// The most.
    pub max: f64,
}

impl Spread {
    /// Of values in any order; zeros of none.
    #[must_use]
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let at = |share: f64| {
            // The smallest value that at least such a share is not above.
            let rank = (share * values.len() as f64).ceil() as usize;
            values.get(rank.max(1) - 1).copied().unwrap_or(0.0)
        };
        Self {
            min: at(0.0),
            median: at(0.5),
            p95: at(0.95),
            max: at(1.0),
        }
    }
}

/// A second of a crowd.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CrowdSecond {
    /// Since the start, s.
    pub time_s: f64,
    /// Cells with members.
    pub cells: usize,
    /// Changes of cells in it.
    pub changes: u64,
    /// Texels marched in it.
    pub texels: u64,
    /// Median over the viewers of the error that the distance from the reference brings, FLIP.
    pub error_median: f64,
    /// 95th percentile over the viewers.
    pub error_p95: f64,
}

/// What the caches of a crowd would have marched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CrowdTexels {
    /// Texels marched.
    pub marched: u64,
    /// The same for each second of a viewer who reads a cache.
    pub per_viewer_second: f64,
    /// Rays of a screen-space renderer for each viewer, once per pixel and frame at as many frames as there are ticks, for
    /// each texel that was marched.
    pub screen_space_rays_per_texel: f64,
    /// Share of viewers' time in which they read a cache.
    pub readers_share: f64,
    /// Share of viewers' time in a layer, the near part of which rays of their own go through besides.
    pub within_share: f64,
    /// Share of requested texels that another viewer of the cell requests too.
    pub shared: f64,
    /// Share of looks at which the budget was spent with work left.
    pub short_share: f64,
    /// Caches that began anew because their anchor was too far from the reference.
    pub new_anchors: u64,
    /// The most memory that was held, bytes.
    pub bytes_most: u64,
}

/// What came of a crowd.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CrowdOutcome {
    /// What it did.
    pub motion: &'static str,
    /// How many.
    pub viewers: usize,
    /// For how long, s.
    pub duration_s: f64,
    /// Cells with members, over ticks.
    pub cells: Spread,
    /// Changes from one cell to another.
    pub changes: u64,
    /// The same for each minute of a viewer.
    pub changes_per_viewer_minute: f64,
    /// Viewers back in a cell that they left within [`FLIP_S`].
    pub flips: u64,
    /// The farthest of any viewer from its reference, as a share of what the limit allows.
    pub widest_share: f64,
    /// Distances from the reference as a share of what the limit allows, over viewers and seconds.
    pub distance_share: Spread,
    /// Error that the distance brings, FLIP, over viewers and seconds.
    pub error: Spread,
    /// Time of the processor to take in the whole crowd at once, before the first tick, µs.
    pub joined_us: f64,
    /// Time of the processor to decide on cells, µs a tick: what else runs does not count, but it differs from run to run.
    pub decision_us: Spread,
    /// Changes of cells in the decision that took most.
    pub slowest_changes: usize,
    /// Share of the decisions that took more than [`DECISION_MAX_US`].
    pub slow_decisions_share: f64,
    /// What would be marched.
    pub texels: CrowdTexels,
    /// How it went.
    pub seconds: Vec<CrowdSecond>,
}

impl CrowdOutcome {
    /// Without what the clock told, which differs from run to run.
    #[must_use]
    pub fn without_clock(mut self) -> Self {
        self.joined_us = 0.0;
        self.decision_us = Spread::default();
        self.slowest_changes = 0;
        self.slow_decisions_share = 0.0;
        self
    }
}

/// Where somebody looks: ahead, and around.
struct Gaze {
    before_m: DVec3,
    ahead_deg: f64,
}

impl Gaze {
    fn camera(&mut self, place: usize, position_m: DVec3, time_s: f64) -> Option<Camera> {
        let way_m = (position_m - self.before_m).with_y(0.0);
        if way_m.length() > 0.01 {
            self.ahead_deg = way_m.x.atan2(-way_m.z).to_degrees();
        }
        self.before_m = position_m;
        // Nobody turns their head when their neighbour does: places differ by the golden angle.
        let phase = place as f64 * 2.4;
        let aside_deg = LOOK_DEG * (time_s / LOOK_S * TAU + phase).sin();
        let yaw_deg = (self.ahead_deg + aside_deg).rem_euclid(360.0);
        Camera::new(position_m.to_array(), yaw_deg, PITCH_DEG, FOV_DEG).ok()
    }
}

/// What is known of a crowd while it moves.
struct Watch<'a> {
    setup: &'a CrowdSetup,
    curve: &'a ErrorCurve,
    cells: Cells,
    flips: FlipCount,
    cell_counts: Vec<f64>,
    joined_us: f64,
    decisions_us: Vec<f64>,
    /// What the slowest took, µs, and changes of cells in it.
    slowest: (f64, usize),
    shares: Vec<f64>,
    errors: Vec<f64>,
    seconds: Vec<CrowdSecond>,
    changes: u64,
    widest_share: f64,
}

/// Counts who goes back to where they have just left.
#[derive(Default)]
struct FlipCount {
    /// When who left which cell, s.
    left_s: BTreeMap<(ViewerId, CellId), f64>,
    flips: u64,
}

impl FlipCount {
    fn note(&mut self, change: &CellChange, time_s: f64) {
        let left_s = self.left_s.get(&(change.viewer, change.to));
        self.flips += u64::from(left_s.is_some_and(|left_s| time_s - left_s < FLIP_S));
        self.left_s.insert((change.viewer, change.from), time_s);
    }
}

/// Lets a crowd move and watches it; `progress` gets the share that is done.
#[must_use]
pub fn watch(
    setup: &CrowdSetup,
    scene: &Scene,
    curve: &ErrorCurve,
    mut progress: impl FnMut(f64),
) -> CrowdOutcome {
    let mut crowd = Crowd::new(setup.viewers, setup.motion, setup.seed);
    let mut watch = Watch::new(setup, scene, curve);
    let mut tiles = CrowdTiles::new(scene, setup.tiles);
    let mut gazes: Vec<Gaze> = crowd
        .positions_m()
        .map(|before_m| Gaze {
            before_m,
            ahead_deg: 0.0,
        })
        .collect();
    watch.join(crowd.positions_m());
    let tick_s = 1.0 / f64::from(setup.ticks_per_s);
    let ticks = (setup.duration_s * f64::from(setup.ticks_per_s)).round() as u32;
    for tick in 0..ticks {
        let time_s = f64::from(tick) * tick_s;
        let positions_m: Vec<DVec3> = crowd.positions_m().collect();
        watch.decide(&positions_m, tick_s, time_s);
        if tick % setup.ticks_per_s == 0 {
            watch.begin_second(&positions_m, time_s);
        }
        if tick % setup.ticks_per_look == 0 {
            let cameras: Vec<(ViewerId, Camera)> = positions_m
                .iter()
                .zip(&mut gazes)
                .enumerate()
                .filter_map(|(place, (position_m, gaze))| {
                    let camera = gaze.camera(place, *position_m, time_s)?;
                    Some((viewer(place), camera))
                })
                .collect();
            let passed_s = tick_s * f64::from(setup.ticks_per_look);
            let marched = tiles.look(&watch.cells, &cameras, passed_s, time_s);
            if let Some(second) = watch.seconds.last_mut() {
                second.texels += TileSums::texels(marched);
            }
            progress(f64::from(tick) / f64::from(ticks));
        }
        crowd.advance(tick_s);
    }
    watch.outcome(tiles.sums())
}

fn viewer(place: usize) -> ViewerId {
    ViewerId(place as u32 + 1)
}

impl<'a> Watch<'a> {
    fn new(setup: &'a CrowdSetup, scene: &Scene, curve: &'a ErrorCurve) -> Self {
        let bounds_m = layer_bounds_m(scene, &active_layers(scene));
        let mut cells = Cells::new(&[], setup.limit);
        cells.set_storeys(Storeys::of(&bounds_m));
        Self {
            setup,
            curve,
            cells,
            flips: FlipCount::default(),
            cell_counts: Vec::new(),
            joined_us: 0.0,
            decisions_us: Vec::new(),
            slowest: (0.0, 0),
            shares: Vec::new(),
            errors: Vec::new(),
            seconds: Vec::new(),
            changes: 0,
            widest_share: 0.0,
        }
    }

    /// Everybody comes.
    fn join(&mut self, positions_m: impl Iterator<Item = DVec3>) {
        let positions_m: Vec<DVec3> = positions_m.collect();
        let begun = ThreadTime::now();
        for (place, position_m) in positions_m.iter().enumerate() {
            self.cells.place(viewer(place), *position_m);
        }
        self.joined_us = begun.elapsed().as_secs_f64() * 1e6;
    }

    fn decide(&mut self, positions_m: &[DVec3], tick_s: f64, time_s: f64) {
        let begun = ThreadTime::now();
        for (place, position_m) in positions_m.iter().enumerate() {
            self.cells.place(viewer(place), *position_m);
        }
        let changes = self.cells.regroup(tick_s);
        let took_us = begun.elapsed().as_secs_f64() * 1e6;
        if took_us > self.slowest.0 {
            self.slowest = (took_us, changes.len());
        }
        self.decisions_us.push(took_us);
        for change in &changes {
            self.flips.note(change, time_s);
        }
        self.changes += changes.len() as u64;
        if let Some(second) = self.seconds.last_mut() {
            second.changes += changes.len() as u64;
        }
        self.cell_counts.push(self.cells.iter().count() as f64);
        let shares = self.offsets(positions_m).map(|offset| offset.share);
        self.widest_share = shares.fold(self.widest_share, f64::max);
    }

    /// How far everybody is from their reference.
    fn offsets(&self, positions_m: &[DVec3]) -> impl Iterator<Item = Offset> {
        let limit = self.cells.limit();
        positions_m
            .iter()
            .enumerate()
            .filter_map(move |(place, position_m)| {
                let cell = self.cells.get(self.cells.cell_of(viewer(place))?)?;
                let away_m = *position_m - cell.reference_m;
                Some(Offset {
                    share: limit.distance_m(*position_m, cell.reference_m) / limit.radius_m(),
                    sideways_m: away_m.with_y(0.0).length(),
                    up_m: away_m.y,
                })
            })
    }

    fn begin_second(&mut self, positions_m: &[DVec3], time_s: f64) {
        let offsets: Vec<Offset> = self.offsets(positions_m).collect();
        let errors: Vec<f64> = offsets
            .iter()
            .map(|offset| self.curve.flip(offset.sideways_m, offset.up_m))
            .collect();
        self.shares
            .extend(offsets.iter().map(|offset| offset.share));
        self.errors.extend(&errors);
        let error = Spread::of(errors);
        self.seconds.push(CrowdSecond {
            time_s,
            cells: self.cells.iter().count(),
            error_median: error.median,
            error_p95: error.p95,
            ..CrowdSecond::default()
        });
    }

    fn outcome(self, sums: TileSums) -> CrowdOutcome {
        let setup = self.setup;
        let viewer_s = setup.viewers as f64 * setup.duration_s;
        let slow = self
            .decisions_us
            .iter()
            .filter(|us| **us > DECISION_MAX_US)
            .count();
        CrowdOutcome {
            motion: setup.motion.name(),
            viewers: setup.viewers,
            duration_s: setup.duration_s,
            cells: Spread::of(self.cell_counts),
            changes: self.changes,
            changes_per_viewer_minute: self.changes as f64 / viewer_s * 60.0,
            flips: self.flips.flips,
            widest_share: self.widest_share,
            distance_share: Spread::of(self.shares),
            error: Spread::of(self.errors),
            joined_us: self.joined_us,
            slowest_changes: self.slowest.1,
            slow_decisions_share: slow as f64 / self.decisions_us.len().max(1) as f64,
            decision_us: Spread::of(self.decisions_us),
            texels: texels(setup, &sums),
            seconds: self.seconds,
        }
    }
}

struct Offset {
    /// Of what the limit allows.
    share: f64,
    sideways_m: f64,
    up_m: f64,
}

fn texels(setup: &CrowdSetup, sums: &TileSums) -> CrowdTexels {
    let marched = TileSums::texels(sums.marched);
    let look_s = f64::from(setup.ticks_per_look) / f64::from(setup.ticks_per_s);
    let reader_s = sums.readers as f64 * look_s;
    let rays = reader_s * f64::from(setup.ticks_per_s) * f64::from(setup.tiles.size.pixels());
    let share = |part: u64, of: u64| part as f64 / of.max(1) as f64;
    CrowdTexels {
        marched,
        per_viewer_second: marched as f64 / reader_s.max(f64::MIN_POSITIVE),
        screen_space_rays_per_texel: rays / marched.max(1) as f64,
        readers_share: share(sums.readers, sums.readers + sums.others),
        within_share: share(sums.within, sums.readers + sums.others),
        shared: 1.0 - share(sums.unique, sums.requested),
        short_share: share(sums.short_looks, sums.looks),
        new_anchors: sums.new_anchors,
        bytes_most: sums.bytes_most(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use skycell_protocol::FrameSize;

    fn setup(motion: CrowdMotion) -> CrowdSetup {
        CrowdSetup {
            motion,
            viewers: 60,
            duration_s: 60.0,
            ticks_per_s: 10,
            ticks_per_look: 20,
            seed: 3,
            limit: CellLimit::default(),
            tiles: TileSetup {
                size: FrameSize::new(160, 90).expect("a size"),
                mip_bias: 1.0,
                samples: 4,
                tiles_per_s: 1e6,
            },
        }
    }

    fn outcome(setup: &CrowdSetup) -> CrowdOutcome {
        watch(
            setup,
            &Scene::default(),
            crate::cells::ErrorCurves::embedded().of(1, 16),
            |_| {},
        )
        .without_clock()
    }

    #[test]
    fn no_cell_of_a_crowd_is_wider_than_its_limit_and_nobody_flips() {
        for motion in CrowdMotion::ALL {
            let found = outcome(&setup(motion));
            assert!(found.widest_share <= 1.0, "{found:?}");
            assert!(
                found.widest_share > 0.03,
                "somebody is away from a reference"
            );
            assert_eq!(found.flips, 0, "{}", found.motion);
            assert!(found.cells.min >= 1.0 && found.cells.max <= 60.0);
            assert_eq!(found.seconds.len(), 60);
            let counted: u64 = found.seconds.iter().map(|second| second.texels).sum();
            assert_eq!(counted, found.texels.marched, "{}", found.motion);
            assert!(found.texels.readers_share > 0.9 && found.texels.marched > 0);
        }
    }

    #[test]
    fn the_same_seed_has_the_same_outcome_and_another_one_has_another() {
        let setup = setup(CrowdMotion::Wander);
        let other = CrowdSetup { seed: 4, ..setup };
        let first = outcome(&setup);
        assert_eq!(first, outcome(&setup));
        assert_ne!(first.seconds, outcome(&other).seconds);
    }

    #[test]
    fn a_narrower_limit_has_more_cells_a_smaller_error_and_more_texels() {
        let wide = setup(CrowdMotion::Wander);
        let narrow = CrowdSetup {
            limit: CellLimit::new(500.0, 200.0),
            ..wide
        };
        let [wide, narrow] = [wide, narrow].map(|setup| outcome(&setup));
        assert!(narrow.cells.median > wide.cells.median);
        assert!(narrow.error.p95 < wide.error.p95);
        assert!(narrow.texels.marched > wide.texels.marched);
    }

    #[test]
    fn who_is_back_within_the_time_is_counted_and_nobody_else() {
        let mut count = FlipCount::default();
        let mut go = |who: u32, from: u32, to: u32, time_s: f64| {
            let change = CellChange {
                viewer: ViewerId(who),
                from: CellId(from),
                to: CellId(to),
            };
            count.note(&change, time_s);
            count.flips
        };
        assert_eq!(go(1, 1, 2, 0.0), 0);
        assert_eq!(go(2, 2, 1, 5.0), 0, "somebody else");
        assert_eq!(go(1, 2, 1, 10.0), 1, "back after ten seconds");
        assert_eq!(go(1, 1, 2, 30.0), 1, "and away again after twenty");
        assert_eq!(go(1, 2, 3, 31.0), 1, "to where they never were");
    }

    #[test]
    fn a_spread_has_the_values_at_its_ranks() {
        let spread = Spread::of((1..=100).rev().map(f64::from).collect());
        assert_eq!(
            (spread.min, spread.median, spread.p95, spread.max),
            (1.0, 50.0, 95.0, 100.0)
        );
        assert_eq!(Spread::of(Vec::new()), Spread::default());
    }
}
