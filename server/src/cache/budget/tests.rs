use super::*;
use proptest::prelude::*;

fn square(level: u8, corner: u16, side: u16) -> Vec<TileRequest> {
    let tile = |x, y| TileRequest {
        key: TileKey { level, x, y },
        eccentricity_rad: 0.1,
        distance_m: 2_000.0,
        screen_share: 0.01,
        texel_pixels: 1.0,
    };
    (0..side)
        .flat_map(|y| (0..side).map(move |x| tile(corner + x, corner + y)))
        .collect()
}

/// A cell that asks for a square of `side` tiles along an edge at level 5, without a coarse level.
fn wish(side: u16) -> Wish {
    let mut wish = Wish::default();
    wish.add(&[], &square(5, 0, side));
    wish
}

fn wishes(sides: &[u16]) -> BTreeMap<CellId, Wish> {
    let sides = sides.iter().map(|side| wish(*side));
    (1..).map(CellId).zip(sides).collect()
}

fn limits(server: u64, cell: u64) -> TileLimits {
    TileLimits { server, cell }
}

#[test]
fn each_level_that_is_lost_leaves_a_quarter_of_the_tiles() {
    let wish = wish(32);
    let tiles: Vec<u64> = (0..6).map(|lost| wish.tiles(lost)).collect();
    assert_eq!(tiles, [1024, 256, 64, 16, 4, 1]);
    assert_eq!(wish.after(2).tiles(1), wish.tiles(3));
    // What is granted is what was counted, each tile once.
    let asked = square(5, 3, 9);
    let mut counted = Wish::default();
    counted.add(&[], &asked);
    for lost in 0..LEVELS {
        assert_eq!(coarsened(&asked, lost).len() as u64, counted.tiles(lost));
    }
    let share = |tiles: &[TileRequest]| tiles.iter().map(|t| t.screen_share).sum::<f64>();
    assert!((share(&coarsened(&asked, 2)) - share(&asked)).abs() < 1e-12);
    // And a texel of what is granted covers four, twice over.
    let covers = |tiles: &[TileRequest]| tiles.iter().map(|t| t.texel_pixels).fold(0.0, f64::max);
    assert_eq!(covers(&coarsened(&asked, 2)), 16.0 * covers(&asked));
}

#[test]
fn whatever_is_asked_for_is_covered_by_what_is_granted() {
    for lost in 0..LEVELS {
        let asked = square(3, 5, 7);
        let granted: HashSet<TileKey> = coarsened(&asked, lost).iter().map(|t| t.key).collect();
        for tile in &asked {
            let above = std::iter::successors(Some(tile.key), |key| key.parent());
            assert!(above.into_iter().any(|key| granted.contains(&key)));
        }
    }
}

#[test]
fn who_holds_little_pays_for_nobody() {
    // One cell asks for far more than all, three for a little.
    let wishes = wishes(&[60, 10, 8, 6]);
    let lost = least_losses(&wishes, limits(1_200, u64::MAX));
    assert_eq!(Vec::from_iter(lost.values()), [&1, &0, &0, &0]);
    // Equals get equal shares, as near as levels allow.
    let alike = super::tests::wishes(&[32; 4]);
    let lost = least_losses(&alike, limits(1_024, u64::MAX));
    assert_eq!(Vec::from_iter(lost.values()), [&1; 4]);
    // The limit of a cell holds for each, however much room there is.
    let lost = least_losses(&wishes, limits(u64::MAX, 64));
    assert_eq!(Vec::from_iter(lost.values()), [&3, &1, &0, &0]);
}

proptest! {
    #[test]
    fn all_fit_and_no_loss_is_for_nothing(sides in proptest::collection::vec(1u16..60, 1..8), server in 32u64..4_000, cell in 4u64..4_000) {
        let wishes = wishes(&sides);
        let limits = limits(server, cell);
        let lost = least_losses(&wishes, limits);
        let held = |id: &CellId| wishes[id].tiles(lost[id]);
        let sum: u64 = wishes.keys().map(held).sum();
        prop_assert!(sum <= server);
        for id in wishes.keys() {
            prop_assert!(held(id) <= cell);
            if lost[id] > 0 {
                // With a level more it would be too large itself, or the largest of all while all together are too many.
                let more = wishes[id].tiles(lost[id] - 1);
                let is_largest = wishes.keys().all(|other| held(other) <= more);
                prop_assert!(more > cell || is_largest, "{lost:?}");
            }
        }
    }
}

#[test]
fn what_does_not_fit_is_lost_at_once_and_comes_back_level_by_level_after_a_calm_time() {
    let mut governor = MemoryGovernor::default();
    let limits = limits(300, u64::MAX);
    let (small, large) = (wishes(&[16]), wishes(&[40]));
    assert!(!governor.consider(&small, limits, 0.0));
    assert!(governor.consider(&large, limits, 0.1));
    assert_eq!(governor.lost(CellId(1)), 2);
    let mut came_back = Vec::new();
    for tick in 1..400 {
        let now_s = f64::from(tick) * 0.1;
        // 256 of 300 tiles are more than 85 %.
        if governor.consider(&small, limits, now_s) {
            came_back.push(now_s);
        }
    }
    assert_eq!(came_back.len(), 1, "{came_back:?}");
    assert_eq!(governor.lost(CellId(1)), 1, "no room for all of it");
    for tick in 400..800 {
        governor.consider(&wishes(&[15]), limits, f64::from(tick) * 0.1);
    }
    assert!(!governor.is_short());
}

#[test]
fn a_wish_that_comes_and_goes_changes_ever_less() {
    let mut governor = MemoryGovernor::default();
    let limits = limits(300, u64::MAX);
    let (small, large) = (wishes(&[12]), wishes(&[20]));
    let mut changes = [0; 2];
    for tick in 0..24_000 {
        let now_s = f64::from(tick) * 0.1;
        let wishes = if tick % 200 < 100 { &large } else { &small };
        let changed = governor.consider(wishes, limits, now_s);
        changes[usize::from(now_s > 600.0)] += u32::from(changed);
    }
    // 60 spells in the first ten minutes, 60 in each further ten.
    assert!(changes[0] <= 8, "{changes:?}");
    assert!(changes[1] <= 2, "{changes:?}");
}

/// Work that comes, s of marching a second without any loss, against what can be done of it; returns steps by time.
fn work(seconds: u32, comes: impl Fn(f64) -> f64) -> (RateGovernor, Vec<u32>) {
    let mut governor = RateGovernor::default();
    let mut backlog_s: f64 = 0.0;
    let mut steps = Vec::new();
    for tick in 0..2 * seconds {
        let now_s = f64::from(tick) * 0.5;
        let rate = governor.rate();
        let less = f64::from(rate.samples_divisor) * rate.age_factor * 4f64.powi(rate.lost.into());
        backlog_s = (backlog_s + 0.5 * comes(now_s) / less - 0.5).max(0.0);
        governor.consider(backlog_s, true, now_s);
        steps.push(governor.step());
    }
    (governor, steps)
}

#[test]
fn much_work_that_is_worked_off_costs_nothing() {
    // Half a minute of work at once, as after a jump, and then none.
    let (governor, steps) = work(60, |now_s| if now_s < 0.5 { 60.0 } else { 0.0 });
    assert!(steps.iter().all(|step| *step == 0), "{steps:?}");
    assert_eq!(governor.changes(), 0);
    // As much as can be done is no reason either.
    let (_, steps) = work(600, |_| 0.95);
    assert!(steps.iter().all(|step| *step == 0));
}

#[test]
fn more_work_than_time_lowers_the_rate_until_it_can_be_done_and_stays_there() {
    for (comes, expected) in [(1.3, 1), (2.6, 2), (10.0, 3), (40.0, 4)] {
        let (_, steps) = work(600, |_| comes);
        let most = steps.iter().max().copied().unwrap_or(0);
        assert_eq!(most, expected, "{comes}");
        let last = &steps[steps.len() / 2..];
        let flips = last.windows(2).filter(|two| two[0] != two[1]).count();
        assert!(flips <= 12, "{comes}: {flips} changes in five minutes");
    }
}

#[test]
fn what_was_given_up_comes_back_when_there_is_time_and_at_once_at_rest() {
    let (mut governor, steps) = work(300, |now_s| if now_s < 60.0 { 10.0 } else { 0.1 });
    assert!(steps[119] == 3 && steps.last() == Some(&0), "{steps:?}");
    let (busy, _) = work(60, |_| 50.0);
    governor.clone_from(&busy);
    assert!(governor.step() > 2);
    assert!(!governor.consider(20.0, false, 60.0));
    assert!(governor.consider(15.0, false, 62.5));
    assert_eq!(governor.step(), 0);
}
