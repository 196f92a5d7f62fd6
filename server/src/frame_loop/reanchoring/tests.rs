//! What is shown when a cell gets new anchors.

use super::*;
use crate::frame_loop::driven::{Driven, FPS, apart, camera, mean_and_most, middle, steps, view};
use crate::march::{CellFrame, drift_m_per_s};
use image::RgbImage;
use serde_json::{Value, json};
use skycell_protocol::ViewerId;
use skycell_shaders::SourceEdit;

const VIEWER: ViewerId = ViewerId(1);

/// A viewer whose cell's anchors stand aside of its reference, and its frame's origin, with all that it sees marched.
fn aside(document: &Value, anchors_m: DVec3, origin_m: DVec3) -> Driven {
    let mut driven = Driven::new(48, document, &[]);
    driven
        .renderer
        .join(VIEWER, view([160, 90], camera(0.0, 40.0)));
    let id = driven.cell_of(VIEWER);
    let radius_m = driven.renderer.scene.planet().radius_m();
    let cell = driven.renderer.active_cells.get_mut(&id).expect("a cell");
    for anchor in &mut cell.anchors {
        anchor.at_start_m += anchors_m;
    }
    cell.frame = CellFrame::at(cell.reference_m + origin_m, radius_m);
    driven.settle();
    driven
}

fn still_sky() -> Value {
    json!({"version": 1, "wind": {"speed_m_per_s": 0}})
}

/// Pictures before new anchors, right after them, and when all is marched again.
struct Shown {
    before: RgbImage,
    after: RgbImage,
    marched: RgbImage,
    /// Tiles that were filled and those that were marched for the picture after.
    tiles: [u64; 2],
}

fn reanchored(driven: &mut Driven) -> Shown {
    let before = driven.show(VIEWER);
    let id = driven.cell_of(VIEWER);
    let counters = &driven.renderer.counters;
    let (filled, marched) = (counters.tiles_resampled, counters.tiles_updated);
    driven.renderer.reanchor_cell(id);
    assert_eq!(driven.renderer.transition_stats().cells_kept, 1);
    driven.renderer.end_transitions();
    driven.renderer.refresh_cells();
    let viewer = &driven.renderer.viewers[&VIEWER];
    assert!(
        !driven.renderer.is_coarse(id, &viewer.requests),
        "a tile is missing"
    );
    let after = driven.show(VIEWER);
    let counters = &driven.renderer.counters;
    let tiles = [
        counters.tiles_resampled - filled,
        counters.tiles_updated - marched,
    ];
    driven.settle();
    Shown {
        before,
        after,
        marched: driven.show(VIEWER),
        tiles,
    }
}

fn flip(a: &RgbImage, b: &RgbImage) -> f64 {
    steps(&[a.clone(), b.clone()])[0]
}

#[test]
fn a_cell_with_new_anchors_shows_what_it_showed_and_marches_nothing_for_that() {
    let far_m = DVec3::new(3_900.0, 0.0, 500.0);
    for (what, anchors_m, origin_m, flip_max, apart_max) in [
        (
            "anchors where they were",
            DVec3::ZERO,
            DVec3::ZERO,
            0.01,
            0.2,
        ),
        ("anchors 3.9 km aside", far_m, DVec3::ZERO, 0.05, 3.0),
        (
            "anchors 2 km aside and lower",
            DVec3::new(2_000.0, -1.0, 0.0),
            DVec3::ZERO,
            0.05,
            3.0,
        ),
        (
            "a frame 3 km aside",
            far_m,
            DVec3::new(-3_000.0, 0.0, 1_000.0),
            0.05,
            3.0,
        ),
    ] {
        let mut driven = aside(&still_sky(), anchors_m, origin_m);
        let shown = reanchored(&mut driven);
        let [first, last] = [&shown.after, &shown.marched].map(|p| flip(&shown.before, p));
        let [mean, end] = [&shown.after, &shown.marched].map(|p| apart(&shown.before, p));
        println!(
            "{what}: FLIP {first:.4} right after, {last:.4} when marched; {mean:.3} and {end:.3} steps of 8 bits; {:?} tiles",
            shown.tiles
        );
        assert!(
            shown.tiles[0] >= 20 && shown.tiles[1] == 0,
            "{:?}",
            shown.tiles
        );
        assert!(first < flip_max && mean < apart_max, "{what}");
    }
    // As it was: the caches start anew, and a batch of tiles later.
    let mut driven = aside(&still_sky(), far_m, DVec3::ZERO);
    let before = driven.show(VIEWER);
    let id = driven.cell_of(VIEWER);
    let tiles = driven.renderer.counters.tiles_updated;
    driven.renderer.restart_cell(id);
    driven.turn(1.0 / FPS);
    let flip_first = flip(&before, &driven.show(VIEWER));
    driven.settle();
    let marched = driven.renderer.counters.tiles_updated - tiles;
    println!(
        "started anew: FLIP {flip_first:.4} a frame later, {marched} tile updates until it is whole"
    );
    // Half again as much as any of the others may be off.
    assert!(flip_first > 1.5 * 0.05);
}

#[test]
fn a_pass_that_looks_at_the_wrong_place_is_found() {
    let defects: [(&str, SourceEdit); 3] = [
        (
            "the new anchor for the old one",
            |path, source| match path {
                "march/resample.wgsl" => source.replace(
                    "before - way.old_proxy.anchor",
                    "before - way.new_proxy.anchor",
                ),
                _ => source.to_owned(),
            },
        ),
        ("gutters left out", |path, source| match path {
            "march/resample.wgsl" => source.replace(
                "(texel_in_level(item.tile, stored) + 0.5)",
                "(texel_in_level(item.tile, stored) + 2.5)",
            ),
            _ => source.to_owned(),
        }),
        ("the frame's way forgotten", |path, source| match path {
            "march/resample.wgsl" => source.replace("position.xz + moved", "position.xz"),
            _ => source.to_owned(),
        }),
    ];
    for (what, edit) in defects {
        let far_m = DVec3::new(3_900.0, 0.0, 500.0);
        let mut driven = aside(&still_sky(), far_m, DVec3::new(-3_000.0, 0.0, 1_000.0));
        driven.renderer.pipelines.plant(Some(edit));
        let scene = driven.renderer.scene.clone();
        driven
            .renderer
            .prepare_pipelines(&scene)
            .expect("pipelines");
        let shown = reanchored(&mut driven);
        let first = flip(&shown.before, &shown.after);
        println!("{what}: {first:.4}");
        assert!(first > 0.1, "{what}: {first}");
    }
}

#[test]
fn wind_that_carries_anchors_far_leaves_no_step() {
    let windy = json!({"version": 1, "wind": {"speed_m_per_s": 10}});
    let scene = crate::frame_loop::driven::scene_of(&windy);
    let along = drift_m_per_s(&scene, 0).with_y(0.0).normalize();
    // Two seconds of wind away from the limit.
    let mut driven = aside(&windy, along * 3_980.0, DVec3::ZERO);
    let (mut wind, mut way) = (Vec::new(), Vec::new());
    let mut last = driven.frame(VIEWER, 1.0 / FPS);
    for _ in 0..250 {
        let next = driven.frame(VIEWER, 1.0 / FPS);
        let step = flip(&last, &next);
        last = next;
        if driven.stage(VIEWER).is_some() {
            way.push(step);
        } else {
            wind.push(step);
        }
    }
    let [(alone, alone_most), (half, most)] =
        [&wind, &way].map(|steps| (middle(steps), mean_and_most(steps)[1]));
    println!(
        "wind alone: FLIP {alone:.4} in the middle, {alone_most:.4} at most, {} frames",
        wind.len()
    );
    println!("new anchors: {half:.4} and {most:.4}, {} frames", way.len());
    let filled = driven.renderer.counters.tiles_resampled;
    let (drift_m, _) = driven
        .renderer
        .cell_drift(driven.cell_of(VIEWER))
        .expect("a cell");
    assert!(
        filled > 0 && drift_m.length() < 300.0,
        "{filled} tiles, {drift_m}"
    );
    assert!(way.len() > 50 && half < 2.0 * alone && most < 2.0 * alone_most);
    assert_eq!(
        driven.renderer.active_cells.len(),
        1,
        "what was before is kept"
    );
}
