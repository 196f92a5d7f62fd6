use super::super::driven::{Driven, TILES, apart, camera, view};
use super::super::stats::render_stats;
use super::*;
use crate::config::RenderConfig;
use image::RgbImage;
use serde_json::{Value, json};
use skycell_protocol::{Camera, InputSequence, ViewerId};

const ONE: ViewerId = ViewerId(1);
const OTHER: ViewerId = ViewerId(2);
const SMALL: [u32; 2] = [96, 54];

/// The default clouds, without wind.
fn calm() -> Value {
    json!({"version": 1, "wind": {"speed_m_per_s": 0}})
}

fn one_sample(config: &mut RenderConfig) {
    config.samples = Some(1);
    config.mip_bias = Some(0.0);
}

/// Leaves a picture in the folder that `SKYCELL_PICTURES` names.
fn save(name: &str, picture: &RgbImage) {
    if let Some(folder) = std::env::var_os("SKYCELL_PICTURES") {
        let path = std::path::Path::new(&folder).join(format!("{name}.png"));
        picture.save(path).expect("written");
    }
}

impl Driven {
    fn move_to(&mut self, viewer: ViewerId, camera: Camera) {
        self.renderer.set_camera(viewer, InputSequence(1), camera);
        self.pass_time(0.0);
    }

    fn is_shown_coarse(&self, viewer: ViewerId) -> bool {
        self.renderer.shows_coarse(&self.renderer.viewers[&viewer])
    }

    fn lost(&self, viewer: ViewerId) -> u8 {
        self.renderer.levels_lost(self.cell_of(viewer))
    }

    fn tiles_asked(&self, viewer: ViewerId) -> usize {
        let requests = &self.renderer.viewers[&viewer].requests;
        requests.iter().map(Vec::len).sum()
    }

    /// Lets losses be looked at after a while, for as long as it takes.
    fn let_calm_times_pass(&mut self) {
        for _ in 0..40 {
            self.renderer.losses.begun -= Duration::from_secs(30);
            self.renderer.refresh_cells();
        }
        self.settle();
    }
}

/// Turns of the loop until a viewer who has jumped is shown a coarse sky of where it is, and a fine one. Each has a frame.
fn turns_after_jump(driven: &mut Driven, name: &str) -> (usize, usize) {
    let (mut coarse, mut fine) = (None, None);
    for turn in 1..200 {
        let picture = driven.frame(ONE, 0.1);
        let viewer = &driven.renderer.viewers[&ONE];
        if driven.renderer.coarse_is_ready(viewer.cell) && coarse.is_none() {
            coarse = Some(turn);
            save(&format!("{name}-coarse"), &picture);
        }
        if !driven.is_shown_coarse(ONE) && driven.stage(ONE).is_none() {
            fine = Some(turn);
            save(&format!("{name}-fine"), &picture);
            break;
        }
    }
    (coarse.expect("a coarse sky"), fine.expect("a fine sky"))
}

#[test]
fn who_turns_round_or_jumps_gets_the_next_frame_at_once_and_a_fine_one_soon() {
    for (name, goal) in [
        ("turn", camera(0.0, 220.0)),
        ("jump", camera(50_000.0, 40.0)),
        ("jump-and-turn", camera(50_000.0, 220.0)),
    ] {
        let mut driven = Driven::configured(24, &calm(), &[], one_sample);
        driven
            .renderer
            .join(ONE, view([160, 90], camera(0.0, 40.0)));
        driven.settle();
        let before = driven.frame(ONE, 0.1);
        save(&format!("{name}-before"), &before);
        driven.move_to(ONE, goal);
        let viewer = &driven.renderer.viewers[&ONE];
        assert!(!driven.renderer.waits_for_tiles(viewer), "{name}");
        assert!(driven.is_shown_coarse(ONE), "{name}");
        let first = driven.show(ONE);
        save(&format!("{name}-first"), &first);
        if name == "jump" {
            // Nothing is there of the new place: what was seen before, to the last bit.
            assert_eq!(apart(&first, &before), 0.0);
        }
        // Clouds, not a clear sky.
        let mut clear = Driven::new(24, &json!({"version": 1, "layers": []}), &[]);
        clear.renderer.join(ONE, view([160, 90], goal));
        clear.pass_time(0.0);
        let clear = clear.show(ONE);
        assert!(
            apart(&first, &clear) > 5.0,
            "{name}: {}",
            apart(&first, &clear)
        );
        let jumps = name != "turn";
        let (coarse, fine) = turns_after_jump(&mut driven, name);
        let asked = driven.tiles_asked(ONE) + 25;
        println!("{name}: coarse after {coarse} turns, fine after {fine}, {asked} tiles at most");
        assert!(coarse <= 1 + 25usize.div_ceil(TILES), "{name}: {coarse}");
        // Marching and, after a jump, a way of 0.2 s.
        let bound = 2 + asked.div_ceil(TILES) + if jumps { 4 } else { 0 };
        assert!(fine <= bound, "{name}: {fine} of {bound}");
        // What is shown in the end is what one sees who was always there.
        let last = driven.frame(ONE, 0.1);
        let mut there = Driven::configured(24, &calm(), &[], one_sample);
        there.renderer.join(ONE, view([160, 90], goal));
        there.settle();
        let there = there.frame(ONE, 0.1);
        assert!(
            apart(&last, &there) < 0.5,
            "{name}: {}",
            apart(&last, &there)
        );
        assert!(apart(&first, &there) < 40.0, "{name}");
        let counters = &driven.renderer.counters;
        assert_eq!(counters.frames_held, 0, "{name}");
    }
}

#[test]
fn somebody_elses_jump_changes_no_bit_of_a_frame() {
    let mut driven = Driven::configured(16, &calm(), &[], one_sample);
    driven.renderer.join(ONE, view(SMALL, camera(0.0, 40.0)));
    driven.renderer.join(OTHER, view(SMALL, camera(0.0, 40.0)));
    driven.settle();
    let before = driven.frame(OTHER, 0.1);
    driven.move_to(ONE, camera(50_000.0, 200.0));
    for _ in 0..30 {
        assert_eq!(apart(&driven.frame(OTHER, 0.1), &before), 0.0);
        driven.show(ONE);
    }
    assert_ne!(driven.cell_of(ONE), driven.cell_of(OTHER));
}

#[test]
fn a_cell_that_asks_for_too_much_loses_levels_and_nobody_else_does() {
    let mut driven = Driven::configured(16, &calm(), &[], |config| {
        one_sample(config);
        config.cache_memory_mib = 8;
    });
    let limit = driven.renderer.caches.limits().server;
    driven
        .renderer
        .join(ONE, view([640, 360], camera(0.0, 40.0)));
    driven
        .renderer
        .join(OTHER, view(SMALL, camera(50_000.0, 40.0)));
    driven.settle();
    println!("{} of {limit} tiles", driven.tiles_asked(ONE));
    assert!(driven.tiles_asked(ONE) as u64 > limit);
    assert_eq!([driven.lost(ONE), driven.lost(OTHER)], [1, 0]);
    let caches = &driven.renderer.caches;
    assert_eq!(caches.refused(), 0);
    assert!(u64::from(caches.resident()) <= limit);
    // All of what is granted is there, and it is told.
    assert!(!driven.is_shown_coarse(ONE) && !driven.is_shown_coarse(OTHER));
    let stats = render_stats(&driven.renderer, 0.0);
    let cell = |viewer| stats.cells.iter().find(|c| c.id == driven.cell_of(viewer));
    let [one, other] = [ONE, OTHER].map(|viewer| cell(viewer).expect("a cell"));
    println!("{:?}\n{:?}", one.loss_note, stats.losses);
    assert!(
        one.loss_note
            .as_ref()
            .is_some_and(|note| note.contains("memory"))
    );
    assert_eq!((one.levels_lost, &other.loss_note), (1, &None));
    assert!(stats.losses.tiles_granted <= limit && stats.losses.tiles_wished > limit);
    assert!(one.converged);
    // It is the picture of a mip bias that is one higher, everywhere.
    let lossy = driven.frame(ONE, 0.1);
    save("lossy", &lossy);
    let mut biased = Driven::configured(16, &calm(), &[], |config| {
        one_sample(config);
        config.mip_bias = Some(1.0);
    });
    biased
        .renderer
        .join(ONE, view([640, 360], camera(0.0, 40.0)));
    biased.settle();
    let biased = biased.frame(ONE, 0.1);
    assert!(apart(&lossy, &biased) < 0.25, "{}", apart(&lossy, &biased));
    // There is room when the picture is small again: after a calm time, not before.
    driven
        .renderer
        .set_view(ONE, view(SMALL, camera(0.0, 40.0)));
    driven.renderer.refresh_cells();
    assert_eq!(driven.lost(ONE), 1);
    driven.let_calm_times_pass();
    assert_eq!(driven.lost(ONE), 0);
    assert_eq!(
        render_stats(&driven.renderer, 0.0).losses.levels_lost_most,
        0
    );
}

#[test]
fn each_cell_keeps_to_its_own_memory_while_somebody_looks_around() {
    let mut driven = Driven::configured(8, &calm(), &[], |config| {
        one_sample(config);
        config.cell_memory_mib = Some(2);
    });
    let limit = driven.renderer.caches.limits().cell;
    driven
        .renderer
        .join(ONE, view([320, 180], camera(0.0, 0.0)));
    for turn in 0..24 {
        driven.move_to(ONE, camera(0.0, f64::from(turn) * 30.0));
        driven.turn(0.1);
        driven.show(ONE);
        let caches = &driven.renderer.caches;
        assert!(caches.resident_in(driven.cell_of(ONE)) <= limit);
        assert_eq!(caches.refused(), 0);
    }
    assert!(driven.lost(ONE) > 0 && driven.renderer.caches.evicted() > 0);
}

#[test]
fn sixteen_viewers_leave_nothing_behind() {
    let mut driven = Driven::configured(4, &calm(), &[], one_sample);
    let mut rounds = Vec::new();
    for _ in 0..2 {
        let ids = (1..=16).map(ViewerId);
        for id in ids.clone() {
            let yaw_deg = f64::from(id.0) * 13.5;
            driven
                .renderer
                .join(id, view([160, 90], camera(0.0, yaw_deg)));
        }
        driven.settle();
        let held = driven.renderer.cache_bytes();
        assert!(held > 0);
        for id in ids {
            driven.renderer.leave(id);
        }
        driven.renderer.gpu.wait().expect("a device");
        assert_eq!(driven.renderer.cache_bytes(), 0);
        assert_eq!(driven.renderer.caches.resident(), 0);
        let resources = driven.renderer.inventory().resources;
        let bytes: u64 = resources.values().map(|of_label| of_label.bytes).sum();
        let counts: Vec<(String, u64)> = resources
            .into_iter()
            .map(|(label, of_label)| (label, of_label.count))
            .collect();
        rounds.push((held, counts, bytes));
    }
    println!("{rounds:?}");
    assert_eq!(rounds[0].0, rounds[1].0);
    assert_eq!(rounds[0].1, rounds[1].1, "no buffer or texture more");
    // The allocator may align the same ones otherwise.
    let aligned = 64 * rounds[0].1.iter().map(|(_, count)| count).sum::<u64>();
    assert!(rounds[1].2 <= rounds[0].2 + aligned);
}

/// Pages of the atlas are given back though somebody stays whose tiles are in the last ones, and its picture is that of one who
/// was always alone. (Before, it may show finer tiles of others.)
#[test]
fn who_stays_when_fifteen_leave_holds_and_sees_no_more_than_one_who_is_alone() {
    let mut driven = Driven::configured(4, &calm(), &[], one_sample);
    let ids = || (1..=16).map(ViewerId);
    for id in ids() {
        let yaw_deg = f64::from(id.0) * 22.5;
        let view = view([320, 180], camera(0.0, yaw_deg));
        driven.renderer.join(id, view);
        driven.settle();
    }
    let stays = ViewerId(16);
    let held = driven.renderer.cache_bytes();
    for id in ids().filter(|id| *id != stays) {
        driven.renderer.leave(id);
    }
    // Nobody moves: no frame is shown.
    let now = Instant::now();
    for minute in 1..=3 {
        let now = now + Duration::from_secs(61 * minute);
        driven.renderer.forget_unseen(now);
        driven.renderer.refresh_cells();
    }
    assert_eq!(driven.renderer.march(1), [], "nothing is lost");
    let left = driven.renderer.cache_bytes();
    let mut alone = Driven::configured(4, &calm(), &[], one_sample);
    alone
        .renderer
        .join(stays, view([320, 180], camera(0.0, 360.0)));
    alone.settle();
    println!("{held} bytes of sixteen, {left} when fifteen have left");
    assert_eq!(left, alone.renderer.cache_bytes());
    let off = apart(&driven.show(stays), &alone.show(stays));
    println!("{off} steps of 8 bits from one who is alone");
    // Filters round otherwise in another slot.
    assert!(off < 0.002, "{off}");
    assert!(2 * left < held, "{left} {held}");
}

#[test]
fn marching_that_does_not_keep_up_takes_fewer_samples_and_says_so() {
    let mut driven = Driven::configured(4, &calm(), &[], |config| {
        config.samples = Some(8);
        config.samples_by_area = Some(false);
    });
    driven.renderer.join(ONE, view(SMALL, camera(0.0, 0.0)));
    let mut now = Instant::now();
    // A driver so slow that a tile takes a second, and a viewer who turns.
    let mut steps = Vec::new();
    for turn in 0..60 {
        driven.move_to(ONE, camera(0.0, f64::from(turn) * 10.0));
        driven.renderer.march(1);
        now += Duration::from_millis(500);
        driven.renderer.consider_rate(now, 1.0, true);
        steps.push(driven.renderer.losses.rate.step());
    }
    println!("{steps:?}");
    assert!(steps.is_sorted() && steps.last() >= Some(&3));
    assert!(driven.lost(ONE) == driven.renderer.losses.rate().lost);
    let cell = driven.cell_of(ONE);
    let stats = render_stats(&driven.renderer, 0.0);
    let cell = stats.cells.iter().find(|c| c.id == cell).expect("a cell");
    assert_eq!(cell.samples, 2);
    assert!(
        cell.loss_note
            .as_ref()
            .is_some_and(|note| note.contains("time"))
    );
    // At rest all comes back, and is marched.
    for _ in 0..8 {
        now += Duration::from_millis(500);
        driven.renderer.consider_rate(now, 1.0, false);
    }
    driven.settle();
    let stats = render_stats(&driven.renderer, 0.0);
    let cell = &stats.cells[0];
    assert_eq!((stats.losses.rate_step, cell.samples), (0, 8));
    assert!(cell.converged && cell.loss_note.is_none() && cell.levels_lost == 0);
}
