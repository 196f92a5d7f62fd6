//! What is shown on a way through layers.

use super::*;
use crate::frame_loop::driven::{Driven, FPS, steps, view};
use image::RgbImage;
use serde_json::{Value, json};
use skycell_protocol::{Camera, InputSequence, ViewerId};
use std::time::{Duration, Instant};

const CLIMBER: ViewerId = ViewerId(1);
/// Tiles that are marched between two frames: as many as a second of this way needs.
const TILES: usize = 40;

fn two_layers() -> Value {
    json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
        {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 2100,
         "density": {"model": "weather", "coverage": 0.5, "type": 0.5}},
        {"name": "high", "base_altitude_m": 4000, "top_altitude_m": 4600,
         "density": {"model": "weather", "coverage": 0.4, "type": 0.2, "seed": 3}}]})
}

fn camera(altitude_m: f64) -> Camera {
    Camera::new([200.0, altitude_m, -300.0], 40.0, -4.0, 60.0).expect("a camera")
}

fn joined(renderer: RendererKind, altitude_m: f64) -> Driven {
    let mut driven = Driven::new(32, &two_layers(), &[]);
    let mut asked = view([96, 54], camera(altitude_m));
    asked.renderer = renderer;
    driven.renderer.join(CLIMBER, asked);
    if renderer == RendererKind::Cached {
        driven.settle();
    }
    driven
}

impl Driven {
    /// One frame of the climber at an altitude, by whichever renderer makes it.
    fn climb(&mut self, altitude_m: f64) -> RgbImage {
        let renderer = &mut self.renderer;
        renderer.set_camera(CLIMBER, InputSequence(1), camera(altitude_m));
        renderer.take_views();
        renderer.regroup(1.0 / FPS);
        renderer.pass_transitions(1.0 / FPS);
        renderer.pass_renderer_fades(1.0 / FPS);
        renderer.refresh_cells();
        renderer.finish_approaches(Instant::now());
        renderer.march(TILES);
        renderer.refresh_cells();
        self.march_own(CLIMBER);
        self.show(CLIMBER)
    }

    /// Marches a frame of a viewer's own rays, where it has such.
    fn march_own(&mut self, id: ViewerId) {
        let renderer = &mut self.renderer;
        if renderer.marches_pixels(&renderer.viewers[&id]) {
            renderer.restart_screen_space(id);
            while !renderer.march_screen_space(id, u64::MAX >> 20) {
                renderer.gpu.wait().expect("a device");
            }
        }
    }

    fn is_inside(&self) -> bool {
        self.renderer.marches_near(&self.renderer.viewers[&CLIMBER])
    }

    fn kind(&self) -> RendererKind {
        self.renderer.viewers[&CLIMBER].kind
    }

    /// Waits for what is made on another thread for the place where the climber is.
    fn wait_for_pipelines(&mut self) {
        let begun = Instant::now();
        let altitude_m = self.renderer.viewers[&CLIMBER].view.camera.position_m()[1];
        let sides = self.renderer.sides_about(altitude_m);
        while !(self
            .renderer
            .side_keys(&self.renderer.scene.clone(), &sides))
        .into_iter()
        .all(|key| self.renderer.pipelines.get(key).is_some())
        {
            assert!(begun.elapsed() < Duration::from_secs(60), "never made");
            self.renderer.take_views();
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// How a frame was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Made {
    FromCache,
    NearAndFar,
    ByRays,
}

impl Driven {
    fn made(&self) -> Made {
        match self.kind() {
            RendererKind::ScreenSpace => Made::ByRays,
            RendererKind::Cached if self.is_inside() => Made::NearAndFar,
            RendererKind::Cached => Made::FromCache,
        }
    }
}

/// Every third frame of both, one row above the other, to be looked at.
fn strip(frames: &[Vec<RgbImage>; 2]) -> image::ImageResult<()> {
    let columns = frames[0].len().div_ceil(3) as u32;
    let (width, height) = frames[0][0].dimensions();
    let mut strip = RgbImage::new(columns * width, 2 * height);
    for (row, frames) in (0..).zip(frames) {
        for (column, frame) in (0..).zip(frames.iter().step_by(3)) {
            image::imageops::replace(
                &mut strip,
                frame,
                column * i64::from(width),
                row * i64::from(height),
            );
        }
    }
    let folder = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../target/pictures-of-tests/inside"
    );
    std::fs::create_dir_all(folder)?;
    strip.save(format!("{folder}/climb.png"))
}

#[test]
fn a_climb_through_a_layer_and_back_shows_no_step_that_rays_do_not_show() {
    // Up through the lower layer into the gap, and down again, each with a rest in the layer and at the end.
    let climb = (0..22).map(|i| 1_360.0 + 50.0 * f64::from(i));
    let mut up: Vec<f64> = climb.collect();
    up.splice(9..9, [up[9]; 10]);
    let rests = [up[0]; 12];
    let way: Vec<f64> = up
        .iter()
        .chain(up.iter().rev())
        .chain(&rests)
        .copied()
        .collect();
    let mut cached = joined(RendererKind::Cached, way[0]);
    let mut rays = joined(RendererKind::ScreenSpace, way[0]);
    let mut made = Vec::new();
    let mut frames = [Vec::new(), Vec::new()];
    for altitude_m in &way {
        frames[0].push(cached.climb(*altitude_m));
        frames[1].push(rays.climb(*altitude_m));
        if made.last().is_none_or(|(_, last)| *last != cached.made()) {
            made.push((*altitude_m, cached.made()));
        }
        if made.len() == 2 {
            cached.wait_for_pipelines();
        }
    }
    let [shown, by_rays] = frames.each_ref().map(|frames| steps(frames));
    for (index, (a, b)) in shown.iter().zip(&by_rays).enumerate() {
        println!(
            "{:>6} m: {a:.4} from one frame to the next, rays {b:.4}",
            way[index + 1]
        );
    }
    println!("{made:?}");
    strip(&frames).expect("a picture");
    let order: Vec<Made> = made.iter().map(|(_, made)| *made).collect();
    let into_and_out = [
        Made::FromCache,
        Made::ByRays,
        Made::NearAndFar,
        Made::ByRays,
    ];
    assert_eq!(order[..4], into_and_out, "{made:?}");
    assert_eq!(order.last(), Some(&Made::FromCache), "{made:?}");
    // On the way down it is in the layer again.
    let inside = order.iter().filter(|made| **made == Made::NearAndFar);
    assert!(inside.count() >= 2, "{made:?}");
    // What a change of renderers shows beside the motion: filter and texels against the window's samples.
    for (index, (a, b)) in shown.iter().zip(&by_rays).enumerate() {
        assert!(*a <= 1.5 * b + 0.03, "{} m: {a} {b}", way[index + 1]);
    }
}

#[test]
fn two_in_a_layer_share_its_far_part_and_each_has_a_near_part_of_its_own() {
    let in_layer = |east_m: f64, altitude_m: f64| {
        Camera::new([east_m, altitude_m, -300.0], 40.0, -4.0, 60.0).expect("a camera")
    };
    let mut driven = joined(RendererKind::Cached, 1_800.0);
    driven.wait_for_pipelines();
    let settled = |driven: &mut Driven, ids: &[ViewerId]| {
        driven.renderer.regroup(1.0 / FPS);
        driven.settle();
        let later = Instant::now() + Duration::from_secs(2);
        driven.renderer.finish_approaches(later);
        driven.settle();
        for id in ids {
            driven.march_own(*id);
        }
    };
    settled(&mut driven, &[CLIMBER]);
    assert_eq!(driven.made(), Made::NearAndFar);
    let alone = driven.renderer.counters.tiles_updated;
    let rays_of_one = driven.renderer.counters.screen_space_marches;
    assert!(alone > 0);
    let other = ViewerId(2);
    let beside = view([96, 54], in_layer(230.0, 1_802.0));
    driven.renderer.join(other, beside);
    settled(&mut driven, &[CLIMBER, other]);
    let both = driven.renderer.counters.tiles_updated;
    println!(
        "{alone} tile updates for one in a layer, {} more for two; {rays_of_one} rays of its own",
        both - alone
    );
    assert_eq!(driven.cell_of(CLIMBER), driven.cell_of(other));
    assert!(
        driven
            .renderer
            .marches_near(&driven.renderer.viewers[&other])
    );
    assert!(4 * (both - alone) < alone, "{alone} {both}");
    // One layer of two, a frame of a window.
    let window = driven.renderer.viewers[&CLIMBER].screen_space.as_ref();
    assert_eq!(window.expect("a near part").marched_layers(), [0]);
}

#[test]
fn who_goes_to_and_fro_at_a_layers_base_keeps_rays() {
    let mut driven = joined(RendererKind::Cached, 1_495.0);
    for _ in 0..4 {
        driven.climb(1_505.0);
        assert_eq!(driven.made(), Made::ByRays);
        driven.climb(1_495.0);
        assert_eq!(driven.made(), Made::ByRays);
    }
}

#[test]
fn who_is_carried_through_a_layer_at_once_gets_rays_until_the_cache_is_there() {
    let mut driven = joined(RendererKind::Cached, 1_000.0);
    assert_eq!(driven.kind(), RendererKind::Cached);
    driven.climb(3_000.0);
    assert_eq!(driven.kind(), RendererKind::ScreenSpace);
    assert!(driven.renderer.viewers[&CLIMBER].reads_cache());
    driven.wait_for_pipelines();
    let mut by_rays = driven.climb(3_000.0);
    let mut frames = Vec::new();
    for _ in 0..60 {
        let frame = driven.climb(3_000.0);
        match driven.kind() {
            RendererKind::ScreenSpace => by_rays = frame,
            RendererKind::Cached => frames.push(frame),
        }
    }
    assert_eq!(driven.kind(), RendererKind::Cached);
    // It goes over to the cache by and by.
    let last = frames.last().expect("frames of the cache").clone();
    let whole = steps(&[by_rays.clone(), last])[0];
    frames.insert(0, by_rays);
    let most = steps(&frames).into_iter().fold(0.0, f64::max);
    println!("from rays to the cache {whole:.4}, in one frame {most:.4} at most");
    assert!(most < 0.5 * whole, "{most} {whole}");
    // All that is read was marched from where it is now.
    let id = driven.cell_of(CLIMBER);
    assert!(driven.renderer.is_reached(id, [200.0, 3_000.0, -300.0]));
    let viewer = &driven.renderer.viewers[&CLIMBER];
    assert!(!driven.renderer.is_coarse(id, &viewer.requests));
    assert!(viewer.requests.iter().all(|tiles| !tiles.is_empty()));
}

#[test]
fn two_who_look_down_side_by_side_share_texels() {
    let mut driven = joined(RendererKind::Cached, 3_000.0);
    driven.wait_for_pipelines();
    driven.climb(3_000.0);
    driven.settle();
    let marched = |driven: &Driven| driven.renderer.counters.tiles_updated;
    let alone = marched(&driven);
    assert!(alone > 0);
    let mut beside = view([96, 54], camera(3_000.0));
    beside.camera = Camera::new([210.0, 3_001.0, -300.0], 42.0, -4.0, 60.0).expect("a camera");
    driven.renderer.join(ViewerId(2), beside);
    driven.renderer.regroup(1.0 / FPS);
    driven.settle();
    let both = marched(&driven);
    println!(
        "{alone} tile updates for one, {} more for two",
        both - alone
    );
    assert_eq!(driven.cell_of(CLIMBER), driven.cell_of(ViewerId(2)));
    assert!(4 * (both - alone) < alone, "{alone} {both}");
}
