//! Transitions through the renderer: what frames show on the way, and what is left behind.

use super::*;
use crate::cells::CellLimit;
use crate::config::PlacedCell;
use crate::frame_loop::driven::{
    Driven, FPS, apart, camera, mean_and_most, middle, scene_of, steps, view,
};
use image::RgbImage;
use serde_json::json;
use skycell_protocol::{Camera, InputSequence};

pub(super) const STANDING: ViewerId = ViewerId(1);
/// As long as a way takes: tiles that wind has aged are marched meanwhile.
pub(super) const WIND_FRAMES: usize = 400;
/// A viewer who stands at the edge of the cell of a crowd whose limit is about to be less, so that it gets one of its own. The
/// smaller the crowd, the farther the old cell's reference goes then: with one, as far as the new one's.
fn left_behind(crowd: u32) -> Driven {
    let driven = Driven::new(48, &json!({"version": 1}), &[]);
    left_behind_in(driven, crowd, 2_400.0)
}

/// The same with a configuration, and so far from the crowd.
pub(super) fn left_behind_in(mut driven: Driven, crowd: u32, away_m: f64) -> Driven {
    for id in 2..2 + crowd {
        let there = view([16, 12], camera(away_m, 40.0));
        driven.renderer.join(ViewerId(id), there);
    }
    let here = view([160, 90], camera(0.0, 40.0));
    driven.renderer.join(STANDING, here);
    for _ in 0..600 {
        driven.renderer.regroup(0.1);
    }
    assert_eq!(driven.cell_of(STANDING), driven.cell_of(ViewerId(2)));
    driven.settle();
    driven
}

/// FLIP between successive frames before and during a transition of one who stands, and from its first to its last one.
pub(super) struct Measured {
    pub(super) wind: Vec<f64>,
    pub(super) waits: Vec<f64>,
    pub(super) fades: Vec<f64>,
    pub(super) whole: f64,
    texels: u64,
    /// As many as wind alone takes of one cell in its frames.
    texels_wind: u64,
    /// Own rays of the one who stands.
    pub(super) rays: u64,
}

/// With a limit of cells that tells it from the crowd.
pub(super) fn measured(mut driven: Driven, limit_m: f64) -> Measured {
    let first = driven.renderer.counters.tiles_updated;
    let wind: Vec<RgbImage> = (0..WIND_FRAMES)
        .map(|_| driven.frame(STANDING, 1.0 / FPS))
        .collect();
    let marched = driven.renderer.counters.tiles_updated;
    let texels_wind = (marched - first) * crate::cache::TEXELS_PER_TILE;
    driven
        .renderer
        .cells
        .set_limit(CellLimit::new(limit_m, limit_m));
    let rays = driven.renderer.counters.screen_space_marches;
    let (mut waits, mut fades) = (vec![wind[WIND_FRAMES - 1].clone()], Vec::new());
    loop {
        let frame = driven.frame(STANDING, 1.0 / FPS);
        match driven.stage(STANDING) {
            Some(Stage::Waits) => waits.push(frame),
            Some(_) => fades.push(frame),
            None => {
                fades.push(frame);
                let viewer = &driven.renderer.viewers[&STANDING];
                if viewer.renderer_fade.is_none() {
                    break;
                }
            }
        }
    }
    let rays = driven.renderer.counters.screen_space_marches - rays;
    assert_ne!(driven.cell_of(STANDING), driven.cell_of(ViewerId(2)));
    let marched = driven.renderer.counters.tiles_updated - marched;
    let ends = [fades[0].clone(), fades[fades.len() - 1].clone()];
    fades.insert(0, waits[waits.len() - 1].clone());
    Measured {
        wind: steps(&wind),
        waits: steps(&waits),
        whole: steps(&ends)[0],
        fades: steps(&fades),
        texels: marched * crate::cache::TEXELS_PER_TILE,
        texels_wind,
        rays,
    }
}

impl Measured {
    pub(super) fn print(&self, what: &str) {
        for (stage, steps) in [
            ("wind", &self.wind),
            ("waits", &self.waits),
            ("fades", &self.fades),
        ] {
            println!(
                "{what}, {stage}: FLIP {:.5} in the middle, {:.5} at most, {} frames",
                middle(steps),
                mean_and_most(steps)[1],
                steps.len()
            );
        }
        println!(
            "{what}: from the first to the last frame {:.4}; {} texels for both viewers, of which wind takes {} or so; {} rays of \
             its own, pixels {}",
            self.whole,
            self.texels,
            self.texels_wind * self.fades.len() as u64 / WIND_FRAMES as u64,
            self.rays,
            160 * 90 * self.fades.len(),
        );
    }
}

#[test]
fn no_frame_of_a_standing_viewer_between_two_cells_differs_from_the_last_by_twice_what_wind_does() {
    let found = measured(left_behind(1), 500.0);
    found.print("two part");
    let way = [found.waits.as_slice(), &found.fades].concat();
    let [(wind, wind_most), (half, most)] =
        [&found.wind, &way].map(|steps| (middle(steps), mean_and_most(steps)[1]));
    // Planted: the new cell at once, as soon as it is there.
    let mut driven = left_behind(1);
    let before = driven.frame(STANDING, 1.0 / FPS);
    driven
        .renderer
        .cells
        .set_limit(CellLimit::new(500.0, 500.0));
    driven.renderer.regroup(1.0 / FPS);
    driven.renderer.end_transitions();
    driven.settle();
    let pop = steps(&[before, driven.show(STANDING)])[0];
    println!("at once: {pop:.4}");
    assert!(pop > 2.0 * wind_most, "{pop}");
    assert!(half < 2.0 * wind, "{half} of {wind}");
    assert!(most < 2.0 * wind_most, "{most} of {wind_most}");
}

/// FLIP between successive frames of one who stays in a cell that falls apart: while wind alone changes them, and from then on until its
/// reference is where it should be. So many stand at either end.
fn staying(each: u32, wind_frames: usize) -> [Vec<f64>; 2] {
    let mut driven = Driven::new(48, &json!({"version": 1}), &[]);
    let seen = ViewerId(1);
    driven
        .renderer
        .join(seen, view([160, 90], camera(0.0, 40.0)));
    for id in 2..=each {
        let here = view([16, 12], camera(0.0, 40.0));
        driven.renderer.join(ViewerId(id), here);
    }
    for id in each + 1..=2 * each {
        let there = view([16, 12], camera(2_400.0, 40.0));
        driven.renderer.join(ViewerId(id), there);
    }
    for _ in 0..600 {
        driven.renderer.regroup(0.1);
    }
    let cell = driven.cell_of(seen);
    assert_eq!(driven.cell_of(ViewerId(2 * each)), cell);
    driven.settle();
    let reference_m = |driven: &Driven| driven.renderer.active_cells[&cell].reference_m;
    let stood_m = reference_m(&driven);
    let wind: Vec<RgbImage> = (0..wind_frames)
        .map(|_| driven.frame(seen, 1.0 / FPS))
        .collect();
    driven
        .renderer
        .cells
        .set_limit(CellLimit::new(500.0, 500.0));
    let mut frames = vec![wind[wind_frames - 1].clone()];
    let is_there = |driven: &Driven| {
        let goal_m = driven.renderer.cells.get(cell).expect("there").reference_m;
        let viewers = driven.renderer.viewers.values();
        reference_m(driven).distance(goal_m) < 1.0
            && viewers
                .into_iter()
                .all(|viewer| viewer.transition.is_none())
    };
    while frames.len() < 20 || !is_there(&driven) {
        frames.push(driven.frame(seen, 1.0 / FPS));
        assert!(frames.len() < 2_000, "never there");
    }
    assert_eq!(driven.cell_of(seen), cell);
    let moved_m = reference_m(&driven).distance(stood_m);
    println!("{each} at either end: the reference goes {moved_m:.0} m");
    assert!(moved_m > 1_000.0);
    [steps(&wind), steps(&frames)]
}

#[test]
fn no_frame_of_one_who_stays_in_a_cell_that_falls_apart_differs_from_the_last_by_twice_what_wind_does()
 {
    let crowds = [(1, WIND_FRAMES), (VIEWERS_MAX as u32 + 1, 20)];
    let found = crowds.map(|(each, wind_frames)| {
        let [wind, way] = staying(each, wind_frames);
        let [calm, all] = [&wind, &way].map(|steps| (middle(steps), mean_and_most(steps)[1]));
        println!(
            "{each}: wind {calm:.5?}, way {all:.5?}, {} frames",
            way.len()
        );
        (calm, all)
    });
    let ((wind, wind_most), (half, most)) = found[0];
    assert!(half < 2.0 * wind, "{half} of {wind}");
    assert!(most < 2.0 * wind_most, "{most} of {wind_most}");
    // More than there is room for are dragged along, which is seen.
    assert!(found[1].1.1 > most, "{found:?}");
}

/// Rows of pictures, as one.
pub(super) fn sheet(rows: &[Vec<RgbImage>]) -> RgbImage {
    let mut sheet = RgbImage::new(160 * rows[0].len() as u32, 90 * rows.len() as u32);
    for (y, row) in (0..).zip(rows) {
        for (x, picture) in (0..).zip(row) {
            image::imageops::replace(&mut sheet, picture, x * 160, y * 90);
        }
    }
    sheet
}

/// A file to be looked at.
pub(super) fn target(name: &str) -> std::path::PathBuf {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/transitions");
    std::fs::create_dir_all(&folder).expect("a folder");
    folder.join(name)
}

pub(super) fn placed(name: &str, east_m: f64) -> PlacedCell {
    PlacedCell {
        name: name.into(),
        center_m: [east_m, 2.0, 0.0],
        radius_m: 60.0,
    }
}

/// Three cells beside each other under a cheap sky, and a viewer in the first whose picture is whole.
fn in_a_row() -> Driven {
    let document = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
        {"name": "low", "density": {"model": "homogeneous", "shape":
         {"form": "sphere", "center_m": [0, 2000, -3000], "radius_m": 900}}}]});
    let cells = [placed("a", 0.0), placed("b", 110.0), placed("c", 220.0)];
    let mut driven = Driven::new(16, &document, &cells);
    driven
        .renderer
        .join(STANDING, view([64, 36], camera(0.0, 0.0)));
    driven.settle();
    driven
}

#[test]
fn a_mix_begins_with_the_old_picture_ends_with_the_new_one_and_lies_between_them() {
    let mut driven = in_a_row();
    driven.go(STANDING, 110.0);
    driven.until(STANDING, Some(Stage::Waits));
    driven.settle();
    let old = driven.show(STANDING);
    driven.until(STANDING, Some(Stage::Fades));
    assert!(driven.share(STANDING) == 0.0 && apart(&driven.show(STANDING), &old) == 0.0);
    let mut between = Vec::new();
    while driven.stage(STANDING) == Some(Stage::Fades) {
        between.push((driven.share(STANDING), driven.show(STANDING)));
        driven.turn(1.0 / FPS);
    }
    let new = driven.show(STANDING);
    let whole = apart(&old, &new);
    assert!(whole > 0.1, "nothing to be seen: {whole}");
    for (share, picture) in &between {
        let [from_old, from_new] = [&old, &new].map(|end| apart(end, picture));
        // Thresholds spread the rounding, so that it vanishes in the mean: to a thirtieth of a step over 64 x 36 pixels.
        assert!(
            (from_old - share * whole).abs() < 0.04,
            "{share}: {from_old} of {whole}"
        );
        assert!(
            (from_new - (1.0 - share) * whole).abs() < 0.04,
            "{share}: {from_new}"
        );
    }
}

#[test]
fn a_change_in_the_middle_of_a_way_goes_back_or_on_and_never_jumps() {
    let mut driven = in_a_row();
    let a = driven.cell_of(STANDING);
    driven.go(STANDING, 110.0);
    driven.until(STANDING, Some(Stage::Fades));
    let b = driven.cell_of(STANDING);
    while driven.share(STANDING) < 0.3 {
        driven.turn(1.0 / FPS);
    }
    // Back: the same picture, with both cells exchanged.
    let (before, share) = (driven.show(STANDING), driven.share(STANDING));
    let viewer = STANDING;
    let input = InputSequence(2);
    let back = camera(110.0, 40.0);
    driven
        .renderer
        .cells
        .place(viewer, DVec3::new(0.0, 2.0, 0.0));
    driven.renderer.regroup(0.0);
    driven.renderer.refresh_cells();
    assert_eq!(driven.cell_of(viewer), a);
    assert!((driven.share(viewer) - (1.0 - share)).abs() < 1e-12);
    assert!(apart(&driven.show(viewer), &before) == 0.0);
    // To a third cell: after these two.
    driven
        .renderer
        .cells
        .place(viewer, DVec3::new(220.0, 2.0, 0.0));
    driven.renderer.regroup(0.0);
    driven.renderer.refresh_cells();
    assert_eq!(driven.cell_of(viewer), a);
    assert!(apart(&driven.show(viewer), &before) == 0.0);
    assert_eq!(
        driven.renderer.active_cells.len(),
        3,
        "both that are shown and the next"
    );
    while driven.cell_of(viewer) == a {
        driven.turn(1.0 / FPS);
    }
    let c = driven.cell_of(viewer);
    assert!(c != a && c != b && driven.stage(viewer) == Some(Stage::Waits));
    driven.until(viewer, None);
    driven.renderer.set_camera(viewer, input, back);
    assert_eq!(
        driven.renderer.active_cells.len(),
        1,
        "nothing is left behind"
    );
}

/// What ends a way of the standing viewer before it has arrived, and the cells that are left.
pub(super) type EarlyEnd = (&'static str, fn(&mut Driven), usize);

pub(super) const EARLY_ENDS: [EarlyEnd; 3] = [
    (
        "the viewer leaves",
        |driven| driven.renderer.leave(STANDING),
        0,
    ),
    (
        "layers move",
        |driven| {
            let document = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
                {"base_altitude_m": 3000, "top_altitude_m": 4000,
                 "density": {"model": "homogeneous"}}]});
            let scene = scene_of(&document);
            driven.renderer.set_scene(scene, 2).expect("a scene");
        },
        1,
    ),
    (
        "rays of its own, above the layer",
        |driven| {
            let high = Camera::new([110.0, 9_000.0, 0.0], 0.0, 0.0, 60.0).expect("a camera");
            driven.renderer.set_camera(STANDING, InputSequence(3), high);
            driven.turn(1.0 / FPS);
        },
        1,
    ),
];

#[test]
fn nothing_outlives_a_way_that_ends_early() {
    let resized: EarlyEnd = (
        "another size, and the end",
        |driven| {
            let larger = view([80, 48], camera(110.0, 40.0));
            driven.renderer.set_view(STANDING, larger);
            driven.turn(1.0 / FPS);
            assert_eq!(driven.stage(STANDING), Some(Stage::Fades));
            assert_eq!(driven.show(STANDING).dimensions(), (80, 48));
            driven.until(STANDING, None);
        },
        1,
    );
    for (what, end, cells) in EARLY_ENDS.into_iter().chain([resized]) {
        let mut driven = in_a_row();
        driven.go(STANDING, 110.0);
        driven.until(STANDING, Some(Stage::Fades));
        driven.turn(0.01);
        let stats = driven.renderer.transition_stats();
        assert_eq!(
            [stats.viewers, stats.fading, stats.cells_kept, stats.begun],
            [1; 4],
            "{what}"
        );
        assert_eq!(stats.picture_bytes, 64 * 36 * 4);
        end(&mut driven);
        let stats = driven.renderer.transition_stats();
        let left = [
            stats.viewers,
            stats.fading,
            stats.cells_kept,
            stats.picture_bytes,
        ];
        assert_eq!(left, [0; 4], "{what}");
        assert_eq!(driven.renderer.active_cells.len(), cells, "{what}");
    }
}

#[test]
fn who_jumps_far_is_shown_the_coarse_sky_of_there_soon_and_marches_nothing_for_the_old_cell() {
    let mut driven = in_a_row();
    driven.show(STANDING);
    let left = driven.cell_of(STANDING);
    driven.go(STANDING, 80_000.0);
    driven.turn(0.01);
    assert_eq!(driven.stage(STANDING), Some(Stage::Waits));
    let wanted = |driven: &Driven| -> u64 {
        let spheres = driven.renderer.caches.spheres_of(left);
        spheres
            .map(|(_, sphere)| sphere.requested_and_unique().0)
            .sum()
    };
    assert_eq!(wanted(&driven), 0);
    driven.until(STANDING, Some(Stage::Fades));
    let mut frames = 0;
    while driven.stage(STANDING).is_some() {
        driven.turn(1.0 / FPS);
        frames += 1;
    }
    assert!(frames <= 5, "{frames}");
}

#[test]
fn more_viewers_than_there_is_room_for_change_cells_at_once_and_are_counted() {
    let mut driven = in_a_row();
    let crowd = VIEWERS_MAX as u32 + 3;
    for id in 2..=crowd {
        driven
            .renderer
            .join(ViewerId(id), view([16, 12], camera(0.0, 0.0)));
    }
    driven.settle();
    for id in 1..=crowd {
        driven.go(ViewerId(id), 110.0);
    }
    driven.turn(1.0 / FPS);
    let stats = driven.renderer.transition_stats();
    assert_eq!(
        [stats.viewers, stats.begun, stats.swapped],
        [VIEWERS_MAX as u64, VIEWERS_MAX as u64, 3]
    );
    assert_eq!(stats.cells_kept, 1);
    driven.until(STANDING, None);
    driven.turn(1.0);
    assert_eq!(driven.renderer.active_cells.len(), 1);
}
