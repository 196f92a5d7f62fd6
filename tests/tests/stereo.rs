//! Viewers with two eyes: each half of a picture is what one eye sees from its place, and both come from one cache.

use anyhow::{Context, ensure};
use serde_json::json;
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene, Show, Stereo};
use skycell_server::config::{FrameFilter, PlacedCell, RenderConfig};
use skycell_server::frame_loop::{StillPicture, StillRenderer, StillSettings};
use skycell_server::march::{MarchSettings, WindowPlan};
use skycell_shaders::SourceEdit;
use skycell_tests::server::target_dir;
use std::sync::Arc;

/// Of an eye's picture; no multiple of anything that pixels are grouped by.
const SIZE: [u32; 2] = [61, 35];

/// A renderer with one cell, so that whoever looks does so from one and the same frame and reference.
fn renderer(scene: Scene) -> anyhow::Result<StillRenderer> {
    let config = RenderConfig::new(target_dir()?.join("noise-of-tests"));
    let cell = PlacedCell {
        name: "here".into(),
        center_m: [0.0, 2.0, 0.0],
        radius_m: 1e4,
    };
    Ok(StillRenderer::new(config, Arc::new(scene), &[cell])?)
}

fn settings(renderer: RendererKind) -> StillSettings {
    StillSettings {
        renderer,
        samples: 2,
        march: MarchSettings {
            steps: 24,
            ..MarchSettings::default()
        },
        ..StillSettings::default()
    }
}

/// What an eye's part of a picture holds: the bytes that are shown, and linear radiance.
type Half = (Vec<u8>, Vec<f32>);

fn halves(picture: &StillPicture) -> [Half; 2] {
    let width = picture.size.width() as usize / 2;
    [0, 1].map(|eye| {
        let display = picture.display.chunks_exact(4 * width).skip(eye);
        let linear = picture.linear.chunks_exact(4 * width).skip(eye);
        (
            display.step_by(2).flatten().copied().collect(),
            linear.step_by(2).flatten().copied().collect(),
        )
    })
}

/// A pair's picture and those of one eye at each of both places.
fn seen(
    still: &mut StillRenderer,
    settings: &StillSettings,
    pair: Stereo,
    camera: Camera,
    size: FrameSize,
) -> anyhow::Result<([Half; 2], [Half; 2])> {
    let of_pair = StillSettings {
        stereo: Some(pair),
        ..*settings
    };
    let picture = still.render_with(camera, size, &of_pair, |_| {})?;
    ensure!(picture.size == size.pair(), "{:?}", picture.size);
    let mut alone = Vec::new();
    for eye in pair.eyes(&camera) {
        let picture = still.render_with(eye, size, settings, |_| {})?;
        alone.push((picture.display, picture.linear));
    }
    let alone = alone.try_into().ok().context("two eyes")?;
    Ok((halves(&picture), alone))
}

/// Writes each eye's part to the left.
fn both_on_the_left(path: &str, source: &str) -> String {
    match path {
        "composite/composite.wgsl" => source.replace("+ eye.first_column", ""),
        _ => source.to_owned(),
    }
}

#[test]
fn each_half_is_what_one_eye_sees_from_its_place() -> anyhow::Result<()> {
    let (cached, own) = (RendererKind::Cached, RendererKind::ScreenSpace);
    let window = WindowPlan {
        frames: 4,
        divisor: 2,
        depth_segments: 2,
        refinement: 2,
    };
    let as_frames = StillSettings {
        shared_background: true,
        filter: FrameFilter::Bilinear,
        ..settings(cached)
    };
    let not_full = StillSettings {
        window: Some(window),
        frames: 3,
        ..settings(own)
    };
    let in_motion = StillSettings {
        frames: 6,
        turn_deg_per_frame: 1.5,
        ..not_full
    };
    let showing = |show| StillSettings {
        show,
        ..settings(cached)
    };
    let scene = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [{"family": "cumulus"}, {"family": "cirrus"}]});
    let mut still = renderer(Scene::from_json(&scene)?)?;
    let camera = Camera::new([0.0, 2.0, 0.0], 30.0, 20.0, 60.0)?;
    let size = FrameSize::new(SIZE[0], SIZE[1])?;
    // At 64 mm no eye searches for what texels show, at 100 m both do.
    for (what, settings, eye_distance_m) in [
        ("from the cache, people's eyes", settings(cached), 0.064),
        ("from the cache", settings(cached), 100.0),
        ("from the cache as on a software driver", as_frames, 100.0),
        ("by rays of its own", settings(own), 100.0),
        ("by a window that is not full", not_full, 100.0),
        // A pair turns about its middle: apart, its eyes come from other places than one that turns about itself.
        ("by a window that turns", in_motion, 0.0),
        ("level of the cache", showing(Show::CacheMip), 100.0),
        ("transmittance", showing(Show::Transmittance), 100.0),
        ("density along rays", showing(Show::Density), 100.0),
        ("section", showing(Show::ProfileSection), 100.0),
    ] {
        let pair = Stereo::new(eye_distance_m)?;
        let (halves, alone) = seen(&mut still, &settings, pair, camera, size)?;
        for (side, (half, alone)) in ["left", "right"].iter().zip(halves.iter().zip(&alone)) {
            // A pair's tiles may lie in other slots than those of one eye. A texel's place on a page of 8192 rows has 2⁻¹² of a
            // texel of rounding, twice, and between neighbours radiance differs by what there is at most.
            let is_read = settings.renderer == cached;
            let most = alone.1.iter().fold(0.0f32, |most, value| most.max(*value));
            let (may_differ, bytes) = if is_read {
                (most / 2048.0, 1)
            } else {
                (0.0, 0)
            };
            let is_shown = half
                .0
                .iter()
                .zip(&alone.0)
                .all(|(a, b)| a.abs_diff(*b) <= bytes);
            let is_linear = half
                .1
                .iter()
                .zip(&alone.1)
                .all(|(a, b)| (a - b).abs() <= may_differ);
            assert!(is_shown, "{what}: {side}, as shown");
            assert!(is_linear, "{what}: {side}, linear");
        }
        assert!(
            eye_distance_m < 1.0 || halves[0] != halves[1] || settings.show == Show::CacheMip,
            "{what}: both eyes see the same"
        );
    }
    // Planted: both eyes' parts at one place.
    let edit: SourceEdit = both_on_the_left;
    still.plant(Some(edit))?;
    let pair = Stereo::new(100.0)?;
    let (halves, alone) = seen(&mut still, &settings(cached), pair, camera, size)?;
    assert!(halves[0] != alone[0] && halves[1] != alone[1]);
    Ok(())
}

#[test]
fn a_pair_without_a_distance_has_equal_halves() -> anyhow::Result<()> {
    let mut still = renderer(Scene::default())?;
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0)?;
    let size = FrameSize::new(SIZE[0], SIZE[1])?;
    for kind in [RendererKind::Cached, RendererKind::ScreenSpace] {
        let settings = StillSettings {
            stereo: Some(Stereo::new(0.0)?),
            ..settings(kind)
        };
        let picture = still.render_with(camera, size, &settings, |_| {})?;
        let [left, right] = halves(&picture);
        assert!(left == right, "{kind:?}");
    }
    Ok(())
}

/// Columns of the middle of what is not clear in each half.
fn middles(picture: &StillPicture) -> [f64; 2] {
    let width = picture.size.width() as usize / 2;
    halves(picture).map(|(shown, _)| {
        // The upper left corner is clear.
        let clear = &shown[..4];
        let cloudy = shown.chunks_exact(4).enumerate();
        let columns: Vec<f64> = cloudy
            .filter(|(_, pixel)| pixel != &clear)
            .map(|(at, _)| (at % width) as f64)
            .collect();
        columns.iter().sum::<f64>() / columns.len() as f64
    })
}

#[test]
fn a_ball_stands_as_far_apart_in_both_halves_as_the_distance_of_the_eyes_says() -> anyhow::Result<()>
{
    // 2 km up and 3 km north of the eyes.
    let scene = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [{"base_altitude_m": 1_500,
        "top_altitude_m": 2_500, "extinction_per_m": 0.1, "density": {"model": "homogeneous", "shape":
        {"form": "sphere", "center_m": [0, 2_002, -3_000], "radius_m": 300}}}]});
    let mut still = renderer(Scene::from_json(&scene)?)?;
    let pitch_deg = 2_000_f64.atan2(3_000.0).to_degrees();
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, pitch_deg, 20.0)?;
    let size = FrameSize::new(160, 90)?;
    let pair = Stereo::new(100.0)?;
    let pixels_per_tangent = 45.0 / 10_f64.to_radians().tan();
    let expected = pixels_per_tangent * pair.eye_distance_m() / 2_000_f64.hypot(3_000.0);
    for kind in [RendererKind::ScreenSpace, RendererKind::Cached] {
        let settings = StillSettings {
            show: Show::Transmittance,
            stereo: Some(pair),
            ..settings(kind)
        };
        let [left, right] = middles(&still.render_with(camera, size, &settings, |_| {})?);
        println!("{kind:?}: {left:.2} and {right:.2}, {expected:.2} apart");
        // What the left eye sees nearer than infinity stands farther right.
        assert!(
            (left - right - expected).abs() < 0.3,
            "{kind:?}: {left} {right}, not {expected} apart"
        );
    }
    Ok(())
}

#[test]
fn a_pair_of_peoples_eyes_marches_the_texels_of_one() -> anyhow::Result<()> {
    let mut still = renderer(Scene::default())?;
    let size = FrameSize::new(320, 180)?;
    let mut marches = |kind, camera, eye_distance_m: Option<f64>| {
        let settings = StillSettings {
            samples: 1,
            march: MarchSettings {
                steps: 4,
                ..MarchSettings::default()
            },
            stereo: eye_distance_m.map(Stereo::new).transpose()?,
            ..settings(kind)
        };
        let figures = still.render_with(camera, size, &settings, |_| {})?.figures;
        anyhow::Ok(figures.marches)
    };
    let (mut alone, mut people, mut far) = (0, 0, 0);
    for yaw_deg in [0.0, 77.0, 140.0, 260.0] {
        let camera = Camera::new([0.0, 2.0, 0.0], yaw_deg, 25.0, 60.0)?;
        let kind = RendererKind::Cached;
        alone += marches(kind, camera, None)?;
        people += marches(kind, camera, Some(0.064))?;
        far += marches(kind, camera, Some(100.0))?;
    }
    let ratio = |other: u64| other as f64 / alone as f64;
    println!(
        "{alone} texels for one eye; {:.4} times as many for two 64 mm apart, {:.4} for 100 m",
        ratio(people),
        ratio(far)
    );
    assert!(ratio(people) <= 1.02, "{alone} and {people}");
    assert!(ratio(far) <= 1.5, "{alone} and {far}");
    // Rays of its own are as many as pixels.
    let camera = Camera::default();
    let kind = RendererKind::ScreenSpace;
    assert_eq!(
        marches(kind, camera, Some(0.064))?,
        2 * marches(kind, camera, None)?
    );
    Ok(())
}
