//! Viewers with two eyes through the renderer, on their way between view cells.

use crate::config::PlacedCell;
use crate::frame_loop::driven::{Driven, FPS, apart, camera, view};
use crate::frame_loop::transitions::Stage;
use image::RgbImage;
use serde_json::json;
use skycell_protocol::{Camera, InputSequence, Stereo, ViewerId};

const PAIR: ViewerId = ViewerId(1);
/// With one eye each, where those of the pair are.
const LEFT: ViewerId = ViewerId(2);
const RIGHT: ViewerId = ViewerId(3);
/// Of a part of the picture; no multiple of anything that pixels are grouped by.
const SIZE: [u32; 2] = [61, 35];

fn placed(name: &str, east_m: f64) -> PlacedCell {
    PlacedCell {
        name: name.into(),
        center_m: [east_m, 2.0, 0.0],
        radius_m: 60.0,
    }
}

fn halves(pair: &RgbImage) -> [RgbImage; 2] {
    let [width, height] = SIZE;
    [0, width].map(|x| image::imageops::crop_imm(pair, x, 0, width, height).to_image())
}

/// Where all three look from, around a place.
fn cameras(pair: Stereo, east_m: f64) -> [(ViewerId, Camera); 3] {
    let middle = camera(east_m, 0.0);
    let [left, right] = pair.eyes(&middle);
    [(PAIR, middle), (LEFT, left), (RIGHT, right)]
}

#[test]
fn on_the_way_between_two_cells_both_halves_are_what_one_eye_is_shown() {
    let document = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
        {"name": "low", "density": {"model": "homogeneous", "shape":
         {"form": "sphere", "center_m": [0, 2000, -3000], "radius_m": 900}}}]});
    let pair = Stereo::new(60.0).expect("a distance");
    let mut driven = Driven::new(16, &document, &[placed("a", 0.0), placed("b", 110.0)]);
    for (id, camera) in cameras(pair, 0.0) {
        let mut view = view(SIZE, camera);
        view.stereo = (id == PAIR).then_some(pair);
        driven.renderer.join(id, view);
    }
    driven.settle();
    let mut compared = [0; 3];
    let mut compare = |driven: &mut Driven, stage: usize| {
        let [left, right] = halves(&driven.show(PAIR));
        assert_eq!(apart(&left, &driven.show(LEFT)), 0.0, "left, stage {stage}");
        assert_eq!(
            apart(&right, &driven.show(RIGHT)),
            0.0,
            "right, stage {stage}"
        );
        assert!(apart(&left, &right) > 0.1, "nothing of 60 m to be seen");
        compared[stage] += 1;
    };
    compare(&mut driven, 0);
    let from = driven.cell_of(PAIR);
    for (id, camera) in cameras(pair, 110.0) {
        driven.renderer.set_camera(id, InputSequence(1), camera);
    }
    driven.until(PAIR, Some(Stage::Waits));
    driven.settle();
    compare(&mut driven, 1);
    driven.until(PAIR, Some(Stage::Fades));
    while driven.stage(PAIR) == Some(Stage::Fades) {
        assert_eq!(driven.share(PAIR), driven.share(LEFT));
        compare(&mut driven, 2);
        driven.turn(1.0 / FPS);
    }
    compare(&mut driven, 0);
    assert_ne!(driven.cell_of(PAIR), from);
    assert!(compared[2] > 10, "{compared:?}");
}

#[test]
fn a_viewer_who_opens_the_second_eye_on_the_way_goes_on_and_closes_it_again() {
    let document = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
        {"name": "low", "density": {"model": "homogeneous", "shape":
         {"form": "sphere", "center_m": [0, 2000, -3000], "radius_m": 900}}}]});
    let mut driven = Driven::new(16, &document, &[placed("a", 0.0), placed("b", 110.0)]);
    driven.renderer.join(PAIR, view(SIZE, camera(0.0, 0.0)));
    driven.settle();
    driven
        .renderer
        .set_camera(PAIR, InputSequence(1), camera(110.0, 0.0));
    driven.until(PAIR, Some(Stage::Waits));
    driven.settle();
    driven.until(PAIR, Some(Stage::Fades));
    while driven.share(PAIR) < 0.3 {
        driven.turn(1.0 / FPS);
    }
    let (share, before) = (driven.share(PAIR), driven.show(PAIR));
    let with = |stereo| {
        let mut view = view(SIZE, camera(110.0, 0.0));
        view.stereo = stereo;
        view
    };
    let texels = driven.renderer.counters.tiles_updated;
    driven.renderer.set_view(PAIR, with(Stereo::new(0.0).ok()));
    driven.settle();
    assert_eq!(driven.share(PAIR), share);
    for half in halves(&driven.show(PAIR)) {
        assert_eq!(apart(&half, &before), 0.0);
    }
    driven.renderer.set_view(PAIR, with(None));
    driven.settle();
    assert_eq!(apart(&driven.show(PAIR), &before), 0.0);
    assert_eq!(driven.renderer.counters.tiles_updated, texels);
}
