//! Viewers above and between layers: what they see in a cache whose rays go down against rays of their own.

use anyhow::ensure;
use image::RgbImage;
use image::imageops::thumbnail;
use serde_json::json;
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use skycell_server::march::MarchSettings;
use skycell_tests::accuracy::distance;
use skycell_tests::picture::without_alpha;
use skycell_tests::server::target_dir;
use std::sync::Arc;

type Outcome = anyhow::Result<()>;

const SIZE: [u32; 2] = [192, 108];
const SAMPLES: u32 = 4;

fn renderer() -> anyhow::Result<StillRenderer> {
    let scene = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
        {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 2500,
         "density": {"model": "weather", "coverage": 0.6, "type": 0.5}},
        {"name": "high", "base_altitude_m": 4000, "top_altitude_m": 4600,
         "density": {"model": "weather", "coverage": 0.4, "type": 0.2, "seed": 3}}]});
    let config = RenderConfig::new(target_dir()?.join("noise-of-tests"));
    Ok(StillRenderer::new(
        config,
        Arc::new(Scene::from_json(&scene)?),
        &[],
    )?)
}

struct Shown {
    picture: RgbImage,
    linear: Vec<f32>,
    marched: u64,
}

fn shown(
    still: &mut StillRenderer,
    camera: Camera,
    renderer: RendererKind,
    offset_m: [f64; 3],
) -> anyhow::Result<Shown> {
    let settings = StillSettings {
        renderer,
        samples: SAMPLES,
        march: MarchSettings {
            // From orbit the plain air hides all clouds.
            aerial_perspective: camera.position_m()[1] < 50_000.0,
            ..MarchSettings::default()
        },
        reference_offset_m: offset_m,
        ..StillSettings::default()
    };
    let size = FrameSize::new(SIZE[0], SIZE[1])?;
    let before = still.totals();
    let made = still.render_with(camera, size, &settings, |_| {})?;
    let picture = without_alpha(&made.display, size)?;
    let after = still.totals();
    Ok(Shown {
        picture,
        linear: made.linear,
        marched: after.texels_updated - before.texels_updated,
    })
}

/// FLIP of the cache against rays of the viewer's own.
fn apart(
    still: &mut StillRenderer,
    name: &str,
    camera: Camera,
    offset_m: [f64; 3],
) -> anyhow::Result<f64> {
    let cached = shown(still, camera, RendererKind::Cached, offset_m)?;
    ensure!(cached.marched > 0, "{name} is read from no cache");
    ensure!(
        cached.linear.iter().all(|v| v.is_finite()),
        "{name}: not a number"
    );
    let rays = shown(still, camera, RendererKind::ScreenSpace, [0.0; 3])?;
    ensure!(rays.marched == 0, "rays march no texels");
    // From far up clouds are smaller than a pixel, and samples of them are noise: what is compared are means.
    let is_far = camera.position_m()[1] >= 50_000.0;
    let compared = |picture: &RgbImage| {
        let [width, height] = SIZE.map(|pixels| if is_far { pixels / 4 } else { pixels });
        thumbnail(picture, width, height)
    };
    let found = distance(&compared(&rays.picture), &compared(&cached.picture))?;
    println!(
        "{name}: FLIP {:.4}, SSIM {:.4}, {} texels",
        found.flip, found.ssim, cached.marched
    );
    let pictures = target_dir()?.join("pictures-of-tests/above");
    std::fs::create_dir_all(&pictures)?;
    cached
        .picture
        .save(pictures.join(format!("{name}-cached.png")))?;
    rays.picture
        .save(pictures.join(format!("{name}-rays.png")))?;
    Ok(found.flip)
}

#[test]
fn from_above_and_between_layers_the_cache_shows_what_rays_show() -> Outcome {
    let mut still = renderer()?;
    for (name, altitude_m, pitch_deg) in [
        ("below", 2.0, 20.0),
        ("between", 3_200.0, -5.0),
        ("just-above", 4_605.0, -8.0),
        ("5km", 5_000.0, -15.0),
        ("12km", 12_000.0, -15.0),
        ("12km-down", 12_000.0, -80.0),
        ("100km", 100_000.0, -20.0),
        ("400km", 400_000.0, -25.0),
    ] {
        let camera = Camera::new([200.0, altitude_m, -300.0], 40.0, pitch_deg, 60.0)?;
        let flip = apart(&mut still, name, camera, [0.0; 3])?;
        ensure!(flip < 0.03, "{name}: {flip}");
    }
    Ok(())
}

#[test]
fn beside_the_reference_a_viewer_above_sees_clouds_where_they_are() -> Outcome {
    let mut still = renderer()?;
    let camera = Camera::new([0.0, 8_000.0, 0.0], 0.0, -25.0, 60.0)?;
    for offset_m in [[300.0, 0.0, 0.0], [1_000.0, 0.0, 0.0], [0.0, 500.0, 0.0]] {
        let flip = apart(
            &mut still,
            &format!("beside-{}-{}", offset_m[0], offset_m[1]),
            camera,
            offset_m,
        )?;
        ensure!(flip < 0.1, "{offset_m:?}: {flip}");
    }
    Ok(())
}

#[test]
fn rays_that_are_held_above_the_horizon_are_found() -> Outcome {
    let mut still = renderer()?;
    let camera = Camera::new([0.0, 8_000.0, 0.0], 0.0, -25.0, 60.0)?;
    still.plant(Some(|path, source| match path {
        "march/texel_ray.wgsl" => {
            let lowered = "let goes_down = proxy.from_above > 0u;";
            assert!(source.contains(lowered), "{path} has no {lowered}");
            source.replace(lowered, "let goes_down = false;")
        }
        _ => source.to_owned(),
    }))?;
    let flip = apart(&mut still, "planted", camera, [0.0; 3])?;
    ensure!(flip > 0.1, "{flip}");
    Ok(())
}

#[test]
fn at_the_extremes_no_picture_is_broken() -> Outcome {
    let mut still = renderer()?;
    for (altitude_m, pitch_deg) in [
        (4_600.001, -0.5),
        (4_600.001, -90.0),
        (2_500.001, -2.0),
        (3_999.999, 0.0),
        (400_000.0, -90.0),
        (4_700.0, 0.0),
    ] {
        let camera = Camera::new([0.0, altitude_m, 0.0], 10.0, pitch_deg, 50.0)?;
        let seen = shown(&mut still, camera, RendererKind::Cached, [0.0; 3])?;
        ensure!(
            seen.linear.iter().all(|v| v.is_finite() && *v >= 0.0),
            "{altitude_m} m"
        );
    }
    Ok(())
}
