//! Ways by rays of a viewer's own: that they begin and end with what caches show, that nothing pops, and what they show and cost.

use super::super::tests::{
    EARLY_ENDS, EarlyEnd, STANDING, left_behind_in, measured, placed, sheet, target,
};
use super::*;
use crate::config::{PlacedCell, RenderConfig};
use crate::frame_loop::driven::{
    Driven, FPS, apart, camera, mean_and_most, middle, scene_of, steps, view,
};
use crate::frame_loop::screen_space::WindowChoice;
use crate::frame_loop::{StillRenderer, StillSettings};
use crate::march::{CellFrame, MarchSettings};
use image::RgbImage;
use serde_json::{Value, json};
use skycell_protocol::{FrameSize, InputSequence};

/// Caches as in 2023: one sphere a layer, looked up where the eye's ray meets it.
fn plain(steps: u32, document: &Value, placed: &[PlacedCell]) -> Driven {
    plain_at(None, steps, document, placed)
}

/// The same at a mip bias.
fn plain_at(mip_bias: Option<f32>, steps: u32, document: &Value, placed: &[PlacedCell]) -> Driven {
    let mut driven = Driven::configured(steps, document, placed, |config| {
        config.mip_bias = mip_bias;
        config.parallax_steps = Some(0);
        config.transitions = Transitions::OwnRays;
    });
    let renderer = &mut driven.renderer;
    renderer.window_choice = WindowChoice::ByQuality;
    let scene = renderer.scene.clone();
    renderer.prepare_pipelines(&scene).expect("pipelines");
    driven
}

fn calm() -> Value {
    json!({"version": 1, "wind": {"speed_m_per_s": 0}})
}

/// Places that cells are about, beside one another.
const EAST_M: [f64; 3] = [0.0, 1_200.0, 2_400.0];

fn cells() -> [PlacedCell; 3] {
    [("a", 0), ("b", 1), ("c", 2)].map(|(name, place)| placed(name, EAST_M[place]))
}

/// A viewer in the first cell, whose picture is whole.
fn standing(mut driven: Driven) -> Driven {
    let here = view([160, 90], camera(EAST_M[0], 40.0));
    driven.renderer.join(STANDING, here);
    driven.settle();
    driven
}

impl Driven {
    /// Lets the standing viewer belong to another cell, as if it stood there.
    fn belong(&mut self, place: usize) {
        let there = DVec3::new(EAST_M[place], 2.0, 0.0);
        self.renderer.cells.place(STANDING, there);
        self.renderer.regroup(0.0);
        self.renderer.refresh_cells();
    }

    fn hold_at(&mut self, gone: f64) {
        let viewer = self.renderer.viewers.get_mut(&STANDING).expect("a viewer");
        let transition = viewer.transition.as_mut().expect("a way");
        transition.way.hold_at(gone);
    }

    /// The picture of a place of the way, when all frames of a window have been marched there.
    fn at(&mut self, gone: f64) -> RgbImage {
        for _ in 0..20 {
            self.hold_at(gone);
            // A renderer's last picture is mixed into those that are shown after it.
            self.frame(STANDING, 1.0 / FPS);
        }
        self.hold_at(gone);
        self.settle();
        self.turn(0.0);
        self.show(STANDING)
    }

    fn starts_m(&self) -> Option<DVec3> {
        self.renderer
            .rays_start_m(&self.renderer.viewers[&STANDING])
    }
}

#[test]
fn a_way_of_rays_begins_with_what_the_old_cache_shows_and_ends_with_what_the_new_one_does() {
    let mut driven = standing(plain_at(Some(0.0), 96, &calm(), &cells()));
    let old = driven.show(STANDING);
    driven.belong(1);
    driven.until(STANDING, Some(Stage::Fades));
    assert!(
        driven.renderer.active_cells.len() == 1,
        "the old cell is kept"
    );
    assert_eq!(driven.starts_m(), Some(DVec3::new(EAST_M[0], 2.0, 0.0)));
    let [first, half, last] = [0.0, 0.5, 0.99].map(|gone| driven.at(gone));
    driven.until(STANDING, None);
    let viewer = &driven.renderer.viewers[&STANDING];
    assert_eq!(viewer.kind, RendererKind::Cached);
    for _ in 0..12 {
        driven.frame(STANDING, 1.0 / FPS);
    }
    driven.settle();
    driven.renderer.refresh_cells();
    let new = driven.show(STANDING);
    let flip = |a: &RgbImage, b: &RgbImage| steps(&[a.clone(), b.clone()])[0];
    let whole = flip(&old, &new);
    let ends = [flip(&old, &first), flip(&last, &new)];
    let halves = [flip(&old, &half), flip(&half, &new)];
    println!("old to new {whole:.4}, at the ends {ends:.4?}, from the middle {halves:.4?}");
    sheet(&[vec![old, first, half, last, new]])
        .save(target("rays.png"))
        .expect("written");
    assert!(
        ends.iter().all(|end| *end < 0.25 * whole),
        "{ends:?} of {whole}"
    );
    assert!(
        halves
            .iter()
            .all(|half| (0.5..1.0).contains(&(half / whole))),
        "{halves:?} of {whole}"
    );
}

#[test]
fn no_frame_of_a_standing_viewer_whose_rays_go_between_two_cells_differs_from_the_last_by_twice_what_wind_does()
 {
    let away_m = 600.0;
    let driven = plain(48, &json!({"version": 1}), &[]);
    let found = measured(left_behind_in(driven, 1, away_m), away_m / 5.0);
    found.print("own rays");
    let way = [found.waits.as_slice(), &found.fades].concat();
    let [(wind, wind_most), (half, most)] =
        [&found.wind, &way].map(|steps| (middle(steps), mean_and_most(steps)[1]));
    assert!(found.rays > 0 && half < 2.0 * wind, "{half} of {wind}");
    assert!(most < 2.0 * wind_most, "{most} of {wind_most}");
}

/// How far pictures of the way are from what the eye sees: those of the mix of caches that are searched, those of the mix of
/// plain ones, and those of rays, which are what plain caches of a reference in between would show.
#[test]
fn on_the_way_a_mix_of_searched_caches_is_nearer_to_what_the_eye_sees_than_own_rays() {
    let places = [0.01, 0.3, 0.5, 0.7, 0.99];
    let faded = |parallax_steps: Option<u32>| {
        Driven::configured(48, &calm(), &cells(), |config: &mut RenderConfig| {
            config.parallax_steps = parallax_steps;
        })
    };
    let variants = [
        ("a mix of searched caches", faded(None)),
        ("a mix of plain caches", faded(Some(0))),
        ("own rays", plain(48, &calm(), &cells())),
    ];
    let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
    let config = RenderConfig::new(noise.into());
    let mut still = StillRenderer::new(config, scene_of(&calm()), &[]).expect("a device");
    let settings = StillSettings {
        renderer: RendererKind::ScreenSpace,
        samples: 8,
        march: MarchSettings {
            steps: 48,
            ..MarchSettings::default()
        },
        ..StillSettings::default()
    };
    let size = FrameSize::new(160, 90).expect("a size");
    let seen = still.render_with(camera(EAST_M[0], 40.0), size, &settings, |_| {});
    let rgb = crate::measure::reference::without_alpha(&seen.expect("rays").display);
    let seen = RgbImage::from_raw(160, 90, rgb).expect("all rows");
    let mut rows = vec![vec![seen.clone(); places.len()]];
    let means = variants.map(|(what, driven)| {
        let mut driven = standing(driven);
        driven.belong(1);
        driven.until(STANDING, Some(Stage::Fades));
        let row = places.map(|gone| driven.at(gone));
        let flips = row
            .each_ref()
            .map(|picture| steps(&[seen.clone(), picture.clone()])[0]);
        println!("{what}: {flips:.4?}");
        rows.push(row.to_vec());
        flips.iter().sum::<f64>() / flips.len() as f64
    });
    sheet(&rows)
        .save(target("transition.png"))
        .expect("written");
    let [searched, mixed, rays] = means;
    assert!(searched < mixed.min(rays), "{means:?}");
}

#[test]
fn rays_go_on_from_where_they_are_when_the_way_leads_elsewhere() {
    let mut driven = standing(plain(16, &calm(), &cells()));
    driven.belong(1);
    driven.until(STANDING, Some(Stage::Fades));
    driven.at(0.5);
    driven.hold_at(0.5);
    let (before_m, shown) = (driven.starts_m().expect("rays"), driven.show(STANDING));
    assert!((before_m.x - 600.0).abs() < 1.0, "{before_m}");
    driven.belong(2);
    assert_eq!(driven.stage(STANDING), Some(Stage::Fades));
    assert!(driven.starts_m().expect("rays").distance(before_m) < 1e-6);
    assert_eq!(
        driven.renderer.active_cells.len(),
        1,
        "neither of the others is kept"
    );
    driven.turn(1.0 / FPS);
    let next = driven.show(STANDING);
    println!("from one to the other {:.3}", apart(&shown, &next));
    driven.hold_at(0.999);
    driven.until(STANDING, None);
    let [reference_m] =
        [driven.cell_of(STANDING)].map(|cell| driven.renderer.active_cells[&cell].reference_m);
    assert!((reference_m.x - EAST_M[2]).abs() < 1.0);
}

#[test]
fn who_turns_sees_the_new_cell_soon_and_who_jumps_at_once() {
    let mut driven = standing(plain(16, &calm(), &cells()));
    driven.belong(1);
    driven.until(STANDING, Some(Stage::Fades));
    let mut frames = 0;
    while driven.stage(STANDING) == Some(Stage::Fades) {
        frames += 1;
        // 90 degrees a second.
        let turned = camera(EAST_M[0], 40.0 + 9.0 * frames as f64);
        driven
            .renderer
            .set_camera(STANDING, InputSequence(frames), turned);
        driven
            .renderer
            .cells
            .place(STANDING, DVec3::new(EAST_M[1], 2.0, 0.0));
        driven.turn(1.0 / FPS);
    }
    assert!((2..=10).contains(&frames), "{frames}");

    let mut driven = standing(plain(16, &calm(), &cells()));
    driven.go(STANDING, EAST_M[2]);
    driven.turn(1.0 / FPS);
    let viewer = &driven.renderer.viewers[&STANDING];
    assert!(
        viewer.shows_rays_on_its_way(),
        "{:?}",
        driven.stage(STANDING)
    );
    assert_eq!(driven.starts_m().map(|start| start.x), Some(EAST_M[2]));
    driven.until(STANDING, None);
}

#[test]
fn nothing_of_rays_outlives_a_way_that_ends_early() {
    let by_rays: EarlyEnd = (
        "another renderer",
        |driven| {
            let mut asked = view([160, 90], camera(EAST_M[0], 40.0));
            asked.renderer = RendererKind::ScreenSpace;
            driven.renderer.set_view(STANDING, asked);
            driven.turn(1.0 / FPS);
        },
        1,
    );
    for (what, end, cells_left) in EARLY_ENDS.into_iter().chain([by_rays]) {
        let mut driven = standing(plain(16, &calm(), &cells()));
        driven.show(STANDING);
        driven.belong(1);
        driven.until(STANDING, Some(Stage::Fades));
        let stats = driven.renderer.transition_stats();
        assert_eq!(
            [
                stats.viewers,
                stats.own_rays,
                stats.fading,
                stats.cells_kept
            ],
            [1, 1, 1, 0],
            "{what}"
        );
        end(&mut driven);
        let stats = driven.renderer.transition_stats();
        assert_eq!([stats.viewers, stats.own_rays], [0; 2], "{what}");
        assert_eq!(driven.renderer.active_cells.len(), cells_left, "{what}");
    }
}

#[test]
fn viewers_whose_windows_find_no_room_fade() {
    let mut driven = plain_at(Some(0.0), 1, &calm(), &cells());
    let ids = || (1..=6).map(ViewerId);
    for id in ids() {
        let here = view([1920, 1080], camera(EAST_M[0], 40.0));
        driven.renderer.join(id, here);
    }
    driven.settle();
    for id in ids() {
        let there = DVec3::new(EAST_M[1], 2.0, 0.0);
        driven.renderer.cells.place(id, there);
    }
    driven.renderer.regroup(0.0);
    let stats = driven.renderer.transition_stats();
    assert_eq!([stats.begun, stats.swapped], [6, 0]);
    assert!(stats.ring_bytes <= RING_BYTES_MAX && stats.ring_bytes > RING_BYTES_MAX / 2);
    let viewers = driven.renderer.viewers.values();
    let by_rays = viewers.filter(|viewer| viewer.marches_on_its_way()).count();
    println!("{by_rays} by rays, {} bytes", stats.ring_bytes);
    assert!((1..6).contains(&by_rays), "{by_rays}");
}

#[test]
fn a_window_whose_cell_has_another_frame_begins_anew() {
    let mut driven = standing(plain(16, &calm(), &cells()));
    driven.belong(1);
    driven.until(STANDING, Some(Stage::Fades));
    let is_full = |driven: &Driven| {
        let viewer = &driven.renderer.viewers[&STANDING];
        viewer
            .screen_space
            .as_ref()
            .is_some_and(ScreenSpaceJob::is_full)
    };
    assert!(is_full(&driven));
    let cell = driven.cell_of(STANDING);
    driven.renderer.restart_cell(cell);
    let moved = driven.renderer.active_cells.get_mut(&cell).expect("a cell");
    let far = DVec3::new(5_000.0, 0.0, 0.0);
    moved.frame = CellFrame::at(far, moved.frame.planet_radius_m());
    driven.turn(0.0);
    assert!(!is_full(&driven), "what was marched elsewhere is shown");
}

#[test]
fn who_is_shown_something_else_than_the_picture_has_no_rays_on_its_way() {
    let mut driven = standing(plain(16, &calm(), &cells()));
    let viewer = driven
        .renderer
        .viewers
        .get_mut(&STANDING)
        .expect("a viewer");
    viewer.view.show = Show::CacheAge;
    driven.belong(1);
    let stats = driven.renderer.transition_stats();
    assert_eq!([stats.viewers, stats.own_rays], [1, 0]);
    assert!(!driven.renderer.viewers[&STANDING].marches_on_its_way());
}
