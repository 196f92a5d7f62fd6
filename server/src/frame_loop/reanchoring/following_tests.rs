//! Domes that go along with their cell's reference, and one that stays.

use crate::frame_loop::driven::{Driven, FPS, mean_and_most, middle, steps, view};
use crate::march::{ProxySettings, ProxySetup};
use image::RgbImage;
use serde_json::json;
use skycell_protocol::{Camera, InputSequence, ViewerId};

const VIEWER: ViewerId = ViewerId(1);

/// Looks the same way from everywhere.
fn camera(east_m: f64) -> Camera {
    Camera::new([east_m, 2.0, 0.0], 40.0, 25.0, 60.0).expect("a camera")
}

/// A viewer of a dome on a still day, with all that it sees marched.
fn under(setup: ProxySetup, follow_m: f64) -> Driven {
    let document = json!({"version": 1, "wind": {"speed_m_per_s": 0}});
    let proxies = ProxySettings {
        setup,
        follow_m,
        ..ProxySettings::default()
    };
    let mut driven = Driven::on(proxies, 48, &document, &[]);
    let viewer = view([160, 90], camera(0.0));
    driven.renderer.join(VIEWER, viewer);
    driven.settle();
    driven
}

/// Moves the viewer and with it the reference; marches nothing.
fn go(driven: &mut Driven, east_m: f64) {
    let renderer = &mut driven.renderer;
    renderer.set_camera(VIEWER, InputSequence(1), camera(east_m));
    renderer.regroup(1.0 / FPS);
    renderer.refresh_cells();
}

fn flip(a: &RgbImage, b: &RgbImage) -> f64 {
    steps(&[a.clone(), b.clone()])[0]
}

fn origin_m(driven: &Driven) -> f64 {
    let id = driven.cell_of(VIEWER);
    driven.renderer.active_cells[&id].anchors[0].at_start_m.x
}

#[test]
fn a_dome_follows_by_resampling_without_a_march_and_without_a_step() {
    for setup in [ProxySetup::FollowingDome, ProxySetup::NestedDomes] {
        let mut driven = under(setup, 100.0);
        let marched = driven.renderer.counters.tiles_updated;
        // Small steps, of which every tenth takes the dome along.
        let mut frames = vec![driven.show(VIEWER)];
        let mut followed = Vec::new();
        let mut before_m = origin_m(&driven);
        for step in 1..=32 {
            go(&mut driven, f64::from(step) * 10.5);
            frames.push(driven.show(VIEWER));
            followed.push(origin_m(&driven) != before_m);
            before_m = origin_m(&driven);
        }
        let apart = steps(&frames);
        let of = |follows: bool| -> Vec<f64> {
            let chosen = apart.iter().zip(&followed);
            chosen
                .filter(|(_, f)| **f == follows)
                .map(|(flip, _)| *flip)
                .collect()
        };
        let [walk, follow] = [of(false), of(true)];
        let filled = driven.renderer.counters.tiles_resampled;
        println!(
            "{setup:?}: FLIP of a step {:.4} in the middle, {:.4} at most; of one that the dome follows {follow:.4?}; {filled} tiles",
            middle(&walk),
            mean_and_most(&walk)[1]
        );
        assert_eq!(follow.len(), 3, "{setup:?}");
        assert!(filled >= 3 * 20 && driven.renderer.counters.tiles_updated == marched);
        for flip in &follow {
            assert!(*flip < 1.5 * mean_and_most(&walk)[1], "{setup:?}: {flip}");
        }
        // One cell's tiles, not those of every anchor that there has been.
        assert_eq!(driven.renderer.active_cells.len(), 1);
    }
}

#[test]
fn a_dome_that_follows_shows_what_is_seen_from_where_it_is_now() {
    let at_start = under(ProxySetup::FollowingDome, 100.0).show(VIEWER);
    let mut driven = under(ProxySetup::FollowingDome, 100.0);
    for step in 1..=10 {
        go(&mut driven, f64::from(step) * 105.0);
    }
    assert!((origin_m(&driven) - 1_050.0).abs() < 1.0);
    let followed = driven.show(VIEWER);
    driven.settle();
    let marched = driven.show(VIEWER);
    let [off, way] = [&followed, &at_start].map(|picture| flip(picture, &marched));
    println!(
        "1 km on, FLIP to what is marched there: {off:.4}; of what was seen from the start {way:.4}"
    );
    assert!(off < 0.5 * way, "{off} of {way}");
}

#[test]
fn a_dome_that_stays_is_marched_from_where_it_began() {
    let mut driven = under(ProxySetup::StaticDome, 100.0);
    go(&mut driven, 1_000.0);
    driven.settle();
    let id = driven.cell_of(VIEWER);
    assert_eq!(driven.renderer.active_cells[&id].reference_m.x, 0.0);
    assert_eq!(origin_m(&driven), 0.0);
    assert_eq!(driven.renderer.counters.tiles_resampled, 0);
}

#[test]
fn a_static_dome_is_made_anew_where_all_have_left_it() {
    let mut driven = under(ProxySetup::StaticDome, 100.0);
    // Half its radius is the height of the layer's clouds.
    let height_m = driven.renderer.active[0].proxy_altitude_m;
    go(&mut driven, 0.95 * (height_m - 2.0));
    assert_eq!(origin_m(&driven), 0.0);
    go(&mut driven, 1.05 * (height_m - 2.0));
    assert!(origin_m(&driven) > height_m);
}
