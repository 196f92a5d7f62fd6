use super::*;
use std::collections::BTreeMap;

/// A tick of the render thread, s.
const TICK_S: f64 = 0.1;

fn plaza() -> Cells {
    let plaza = PlacedCell {
        name: "plaza".into(),
        center_m: [10_000.0, 2.0, 0.0],
        radius_m: 500.0,
    };
    Cells::new(&[plaza], CellLimit::default())
}

fn empty() -> Cells {
    Cells::new(&[], CellLimit::default())
}

fn at(x: f64) -> DVec3 {
    DVec3::new(x, 2.0, 0.0)
}

fn ids(positions: usize) -> impl Iterator<Item = ViewerId> {
    (1..=positions as u32).map(ViewerId)
}

/// Places all and lets them settle.
fn settle(cells: &mut Cells, positions: &[f64]) {
    for (id, x) in ids(positions.len()).zip(positions) {
        cells.place(id, at(*x));
    }
    for _ in 0..300 {
        cells.regroup(TICK_S);
    }
}

/// Every viewer in exactly one cell, which holds it; no formed cell without members.
fn check(cells: &Cells, who: &str) {
    let mut homes: BTreeMap<ViewerId, u32> = BTreeMap::new();
    for (id, cell) in cells.iter() {
        assert!(cell.placed || !cell.members.is_empty(), "{who}");
        for viewer in &cell.members {
            *homes.entry(*viewer).or_default() += 1;
            assert_eq!(cells.cell_of(*viewer), Some(id), "{who}");
            let position_m = cells.places[viewer].position_m;
            if !cell.placed {
                let place = &cells.places[viewer];
                for limit in [cell.limit, cells.limit_of(place)] {
                    let away_m = limit.distance_m(position_m, cell.reference_m);
                    assert!(away_m <= limit.radius_m(), "{who}: {away_m} m");
                }
            }
        }
    }
    assert_eq!(homes.len(), cells.places.len(), "{who}");
    assert!(homes.values().all(|count| *count == 1), "{who}");
}

#[test]
fn a_placed_cell_takes_those_who_stand_in_it_and_keeps_its_reference() {
    let mut cells = plaza();
    settle(&mut cells, &[10_300.0, 9_800.0, 9_400.0]);
    let [first, second, outside] = [1, 2, 3].map(|id| cells.cell_of(ViewerId(id)));
    assert_eq!(first, second);
    assert_ne!(first, outside);
    let cell = cells.get(first.expect("placed")).expect("there");
    assert_eq!(
        (cell.name.as_str(), cell.reference_m),
        ("plaza", at(10_000.0))
    );
}

#[test]
fn nobody_flips_back_and_forth_at_the_edge_of_a_placed_cell() {
    let mut cells = plaza();
    settle(&mut cells, &[9_600.0]);
    let mut changes = 0;
    for step in 0..100 {
        let x = if step % 2 == 0 { 9_495.0 } else { 9_505.0 };
        cells.place(ViewerId(1), at(x));
        changes += cells.regroup(TICK_S).len();
    }
    assert_eq!(changes, 0);
}

#[test]
fn viewers_near_each_other_share_a_cell_whose_reference_goes_to_their_mean() {
    let mut cells = empty();
    settle(&mut cells, &[0.0, 1_000.0, 2_000.0, 1.0e7]);
    let [a, b, c, far] = [1, 2, 3, 4].map(|id| cells.cell_of(ViewerId(id)).expect("there"));
    assert_eq!((a, b), (b, c));
    assert_ne!(a, far);
    let reference_m = cells.get(a).expect("there").reference_m;
    assert!(reference_m.distance(at(1_000.0)) <= 5.0, "{reference_m}");
}

#[test]
fn a_reference_does_not_jump_and_does_not_follow_those_who_mill_about() {
    let mut cells = empty();
    settle(&mut cells, &[0.0, 100.0]);
    let id = cells.cell_of(ViewerId(1)).expect("there");
    let reference = |cells: &Cells| cells.get(id).expect("there").reference_m;
    let rest_m = reference(&cells);
    for step in 0..100 {
        cells.place(ViewerId(1), at(f64::from(step % 7) * 10.0 - 40.0));
        cells.regroup(TICK_S);
    }
    assert_eq!(reference(&cells), rest_m);
    // Half the crowd takes a car.
    cells.place(ViewerId(2), at(1_500.0));
    let mut before_m = rest_m;
    for _ in 0..100 {
        cells.regroup(TICK_S);
        let step_m = reference(&cells).distance(before_m);
        before_m = reference(&cells);
        assert!(step_m < 450.0, "{step_m}");
    }
    assert!(before_m.distance(at(750.0)) < 35.0, "{before_m}");
}

#[test]
fn a_cell_that_falls_apart_becomes_two_and_two_that_meet_become_one() {
    let mut cells = empty();
    let standing = [0.0, 100.0, 200.0, 300.0, 400.0];
    settle(&mut cells, &standing);
    assert_eq!(cells.iter().count(), 1);
    let home = cells.cell_of(ViewerId(1));
    let mut changes = Vec::new();
    for step in 0..1_000 {
        for (id, x) in ids(5).zip(standing) {
            let away_m = f64::from(step) * 10.0;
            let x = if id.0 > 3 { x + away_m } else { x - away_m };
            cells.place(id, at(x));
        }
        changes.extend(cells.regroup(TICK_S));
        check(&cells, "apart");
    }
    let mut moved: Vec<u32> = changes.iter().map(|change| change.viewer.0).collect();
    moved.sort_unstable();
    assert_eq!(moved, [4, 5], "the smaller part leaves, once");
    assert_eq!(cells.cell_of(ViewerId(1)), home);
    settle(&mut cells, &standing);
    assert_eq!(cells.iter().count(), 1);
    assert_eq!(cells.cell_of(ViewerId(5)), home);
}

#[test]
fn a_group_that_moves_together_keeps_one_cell_which_moves_with_it() {
    let mut cells = empty();
    settle(&mut cells, &[0.0, 300.0, 600.0]);
    let home = cells.cell_of(ViewerId(1));
    for step in 0..600 {
        for (id, x) in ids(3).zip([0.0, 300.0, 600.0]) {
            cells.place(id, at(x + f64::from(step) * 25.0));
        }
        assert_eq!(cells.regroup(TICK_S), []);
    }
    check(&cells, "a convoy");
    assert_eq!(cells.cell_of(ViewerId(3)), home);
}

#[test]
fn a_viewer_alone_who_jumps_takes_its_cell_along() {
    let mut cells = empty();
    settle(&mut cells, &[0.0]);
    let home = cells.cell_of(ViewerId(1));
    cells.place(ViewerId(1), at(5.0e6));
    assert_eq!(cells.regroup(TICK_S), []);
    assert_eq!(cells.cell_of(ViewerId(1)), home);
    check(&cells, "a jump");
}

#[test]
fn the_last_one_to_leave_takes_a_formed_cell_away_and_leaves_a_placed_one() {
    let mut cells = plaza();
    settle(&mut cells, &[0.0, 10_000.0]);
    cells.remove(ViewerId(1));
    cells.remove(ViewerId(2));
    assert_eq!(cells.iter().count(), 1);
}

#[test]
fn up_and_down_counts_for_more_than_sideways() {
    let limit = CellLimit::new(3_000.0, 1_000.0);
    let away = |x, y| limit.distance_m(DVec3::ZERO, DVec3::new(x, y, 0.0));
    assert!((away(3_000.0, 0.0) - 3_000.0).abs() < 1e-9);
    assert!((away(0.0, 1_000.0) - 3_000.0).abs() < 1e-9);
    let mut cells = Cells::new(&[], limit);
    cells.place(ViewerId(1), at(0.0));
    cells.place(ViewerId(2), at(0.0) + DVec3::Y * 900.0);
    assert_eq!(cells.iter().count(), 2, "too high up to enter");
}

#[test]
fn a_narrower_limit_is_kept_at_the_next_grouping() {
    let mut cells = empty();
    settle(&mut cells, &[0.0, 1_000.0, 2_000.0]);
    assert_eq!(cells.iter().count(), 1);
    cells.set_limit(CellLimit::new(300.0, 100.0));
    cells.regroup(TICK_S);
    check(&cells, "narrower");
    assert_eq!(cells.iter().count(), 3);
}

#[test]
fn cells_that_a_narrow_limit_has_split_merge_again_though_nobody_moves() {
    let mut cells = empty();
    settle(&mut cells, &[0.0, 1_500.0]);
    cells.set_limit(CellLimit::new(300.0, 100.0));
    cells.regroup(TICK_S);
    assert_eq!(cells.iter().count(), 2);
    // The wish is gone before anybody may go back.
    cells.set_limit(CellLimit::default());
    for _ in 0..20 {
        cells.regroup(TICK_S);
    }
    assert_eq!(cells.iter().count(), 2);
    for _ in 0..200 {
        cells.regroup(TICK_S);
    }
    assert_eq!(cells.iter().count(), 1);
    for _ in 0..200 {
        cells.regroup(TICK_S);
    }
    assert!(!cells.restless, "a crowd at rest costs nothing");
}

#[test]
fn who_asks_for_less_error_leaves_a_wide_crowd_and_does_not_take_it_apart() {
    let mut cells = empty();
    let places = [0.0, 500.0, 1_000.0, 1_500.0, 2_000.0];
    settle(&mut cells, &places);
    assert_eq!(cells.iter().count(), 1);
    let strict = ViewerId(1);
    cells.set_limit_of(strict, Some(CellLimit::new(300.0, 100.0)));
    let mut changes = Vec::new();
    for _ in 0..600 {
        changes.extend(cells.regroup(TICK_S));
        check(&cells, "strict");
    }
    assert_eq!(cells.iter().count(), 2);
    assert!(changes.iter().all(|change| change.viewer == strict));
    assert_eq!(changes.len(), 1, "{changes:?}");
    let own = cells.cell_of(strict).expect("a cell");
    assert_eq!(cells.get(own).expect("it is there").radius_m, 300.0);
    // Without the wish all are together again.
    cells.set_limit_of(strict, None);
    for _ in 0..300 {
        cells.regroup(TICK_S);
    }
    assert_eq!(cells.iter().count(), 1);
}

#[test]
fn a_narrow_crowd_shares_a_cell_with_whoever_asks_for_less_error() {
    let mut cells = empty();
    settle(&mut cells, &[0.0, 20.0, 40.0, 60.0]);
    cells.set_limit_of(ViewerId(2), Some(CellLimit::new(300.0, 100.0)));
    for _ in 0..100 {
        cells.regroup(TICK_S);
    }
    assert_eq!(cells.iter().count(), 1);
    // The one who would make it too wide does not come in.
    cells.place(ViewerId(9), at(1_000.0));
    cells.regroup(TICK_S);
    check(&cells, "narrow");
    assert_eq!(cells.iter().count(), 2);
}

/// What happened to a crowd.
struct Told {
    changes: Vec<(u32, CellChange)>,
    cells_most: usize,
    ticks: u32,
}

/// Every seventh asks for less error.
fn told(motion: CrowdMotion, count: usize, minutes: u32) -> Told {
    let mut crowd = Crowd::new(count, motion, 7);
    let mut cells = plaza();
    let mut told = Told {
        changes: Vec::new(),
        cells_most: 0,
        ticks: minutes * 600,
    };
    for tick in 0..told.ticks {
        for (id, position_m) in ids(count).zip(crowd.positions_m()) {
            cells.place(id, position_m);
            if id.0 % 7 == 0 {
                cells.set_limit_of(id, Some(CellLimit::new(800.0, 250.0)));
            }
        }
        let changes = cells.regroup(TICK_S);
        told.changes
            .extend(changes.into_iter().map(|change| (tick, change)));
        told.cells_most = told.cells_most.max(cells.iter().count());
        if tick % 10 == 0 {
            check(&cells, motion.name());
        }
        crowd.advance(TICK_S);
    }
    told
}

#[test]
fn no_cell_of_a_crowd_is_wider_than_its_limit_and_nobody_flips() {
    for motion in CrowdMotion::ALL {
        let told = told(motion, 400, 10);
        // A flip: back in the cell that somebody left less than ten seconds ago.
        let mut left: BTreeMap<(ViewerId, CellId), u32> = BTreeMap::new();
        let mut flips = 0;
        for (tick, change) in &told.changes {
            let since = left.get(&(change.viewer, change.to));
            if since.is_some_and(|left| tick - left < 100) {
                flips += 1;
                println!("{} at {tick}: {change:?}, left at {since:?}", motion.name());
            }
            left.insert((change.viewer, change.from), *tick);
        }
        println!(
            "{}: {} cells at most, {} changes, {flips} flips",
            motion.name(),
            told.cells_most,
            told.changes.len()
        );
        assert_eq!(flips, 0, "{}", motion.name());
    }
}

#[test]
fn the_same_crowd_has_the_same_cells() {
    for motion in CrowdMotion::ALL {
        let [one, other] = [0; 2].map(|_| told(motion, 100, 2));
        assert_eq!(one.changes, other.changes);
    }
}

#[test]
fn nobody_shares_what_is_seen_from_the_other_side_of_a_layer() {
    let mut cells = plaza();
    cells.set_storeys(Storeys::of(&[[1_500.0, 2_000.0]]));
    let places = [10_000.0, 10_010.0, 10_020.0, 10_030.0];
    let altitudes_m = [2.0, 1_400.0, 1_700.0, 2_100.0];
    for (id, (x, y)) in ids(4).zip(places.into_iter().zip(altitudes_m)) {
        cells.place(id, DVec3::new(x, y, 0.0));
    }
    for _ in 0..300 {
        cells.regroup(TICK_S);
    }
    check(&cells, "a layer between them");
    let cell = |id: u32| cells.cell_of(ViewerId(id)).expect("a cell");
    assert!(cells.get(cell(1)).expect("there").placed);
    assert_ne!(cell(3), cell(4));
    assert_ne!(cell(2), cell(3));
    // Whoever climbs through the layer alone takes the reference along at once.
    let alone = cell(3);
    cells.place(ViewerId(3), DVec3::new(10_020.0, 2_050.0, 0.0));
    cells.regroup(TICK_S);
    let now = cells.cell_of(ViewerId(3)).expect("a cell");
    let reference_m = cells.get(now).expect("there").reference_m;
    assert!(reference_m.y > 2_000.0, "{now:?} {alone:?} {reference_m}");
    // A layer that comes between them parts them.
    cells.set_storeys(Storeys::of(&[[700.0, 900.0]]));
    cells.place(ViewerId(2), DVec3::new(10_010.0, 500.0, 0.0));
    for _ in 0..300 {
        cells.regroup(TICK_S);
    }
    check(&cells, "another layer");
}

#[test]
fn in_a_layer_cells_are_narrower() {
    let storeys = Storeys::of(&[[1_500.0, 4_000.0]]);
    for (altitude_m, apart_m, shares) in [
        (2.0, 2_000.0, true),
        (2_500.0, 2_000.0, false),
        (2_500.0, 350.0, true),
        (4_500.0, 2_000.0, true),
    ] {
        let mut cells = empty();
        cells.set_storeys(storeys);
        for (id, east_m) in ids(2).zip([0.0, apart_m]) {
            cells.place(id, DVec3::new(east_m, altitude_m, 0.0));
        }
        for _ in 0..300 {
            cells.regroup(TICK_S);
        }
        check(&cells, "in a layer");
        let [a, b] = [1, 2].map(|id| cells.cell_of(ViewerId(id)));
        assert_eq!(a == b, shares, "{apart_m} m at {altitude_m} m");
    }
    // Who asks for less than that anyway is not asked for less.
    let narrow = CellLimit::new(300.0, 110.0).with_storeys(storeys);
    let [a, b] = [0.0, 200.0].map(|east_m| DVec3::new(east_m, 2_000.0, 0.0));
    assert!((narrow.distance_m(a, b) - 200.0).abs() < 1e-9);
}

#[test]
fn who_jumps_away_leaves_the_others_where_they_are() {
    let mut cells = Cells::new(&[], CellLimit::default());
    for viewer in 1..=3 {
        cells.place(ViewerId(viewer), DVec3::new(0.0, 2.0, 0.0));
    }
    let [first, last] = [1, 3].map(ViewerId);
    let home = cells.cell_of(last).expect("a cell");
    cells.regroup(0.02);
    // The first member, and then one of two.
    for jumper in [first, ViewerId(2)] {
        cells.place(jumper, DVec3::new(50_000.0, 2.0, 0.0));
        cells.regroup(0.02);
        assert_eq!(cells.cell_of(last), Some(home));
        let reference_m = cells.get(home).expect("there").reference_m;
        assert_eq!(reference_m, DVec3::new(0.0, 2.0, 0.0));
    }
    assert_eq!(cells.cell_of(first), cells.cell_of(ViewerId(2)));
    // Who jumps alone, or all together, take their cell along.
    cells.place(last, DVec3::new(-90_000.0, 2.0, 0.0));
    cells.regroup(0.02);
    assert_eq!(cells.cell_of(last), Some(home));
}

#[test]
fn who_climbs_through_a_layer_leaves_the_others_where_they_are() {
    let mut cells = empty();
    cells.set_storeys(Storeys::of(&[[1_500.0, 2_000.0]]));
    let place = |cells: &mut Cells, id: u32, altitude_m: f64| {
        cells.place(ViewerId(id), DVec3::new(f64::from(id), altitude_m, 0.0));
    };
    for id in 1..=4 {
        place(&mut cells, id, 1_490.0);
    }
    for _ in 0..100 {
        cells.regroup(TICK_S);
    }
    let home = cells.cell_of(ViewerId(1)).expect("a cell");
    for altitude_m in [1_501.0, 1_700.0, 2_400.0] {
        place(&mut cells, 4, altitude_m);
        for _ in 0..20 {
            cells.regroup(TICK_S);
            check(&cells, "a climb");
            assert!((1..=3).all(|id| cells.cell_of(ViewerId(id)) == Some(home)));
            assert_ne!(cells.cell_of(ViewerId(4)), Some(home));
        }
    }
}
