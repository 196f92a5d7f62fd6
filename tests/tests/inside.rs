//! Viewers in a layer: its near part by rays of their own and its far part from the cache, against rays alone.

use anyhow::ensure;
use image::RgbImage;
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
/// What the cache may differ by at its reference from below, between and above layers (`above.rs`): the far part is read as that
/// is, and the near part is the same rays.
const AT_REFERENCE: f64 = 0.03;
/// By how much that grows from below when the reference is so far aside (`measure distance`).
const ASIDE_100_M: f64 = 0.007;
const ASIDE_300_M: f64 = 0.016;

fn scene() -> anyhow::Result<Arc<Scene>> {
    // The default's low layer, without wind.
    let scene = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
        {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 4000,
         "density": {"model": "weather", "coverage": 0.5, "type": 0.6}},
        {"name": "high", "base_altitude_m": 6000, "top_altitude_m": 6600,
         "density": {"model": "weather", "coverage": 0.4, "type": 0.2, "seed": 3}}]});
    Ok(Arc::new(Scene::from_json(&scene)?))
}

fn renderer() -> anyhow::Result<StillRenderer> {
    let config = RenderConfig::new(target_dir()?.join("noise-of-tests"));
    Ok(StillRenderer::new(config, scene()?, &[])?)
}

struct Shown {
    picture: RgbImage,
    linear: Vec<f32>,
    texels: u64,
    pixels: u64,
    evaluations: u64,
}

fn shown(
    still: &mut StillRenderer,
    camera: Camera,
    settings: &StillSettings,
) -> anyhow::Result<Shown> {
    let size = FrameSize::new(SIZE[0], SIZE[1])?;
    let before = still.totals();
    let made = still.render_with(camera, size, settings, |_| {})?;
    let picture = without_alpha(&made.display, size)?;
    let after = still.totals();
    Ok(Shown {
        picture,
        linear: made.linear,
        texels: after.texels_updated - before.texels_updated,
        pixels: after.screen_space_marches - before.screen_space_marches,
        evaluations: made.figures.density_evaluations.unwrap_or(0),
    })
}

fn settings(renderer: RendererKind, offset_m: [f64; 3]) -> StillSettings {
    StillSettings {
        renderer,
        samples: SAMPLES,
        march: MarchSettings {
            count_reads: true,
            ..MarchSettings::default()
        },
        reference_offset_m: offset_m,
        ..StillSettings::default()
    }
}

/// FLIP of near and far against rays alone.
fn apart(
    still: &mut StillRenderer,
    name: &str,
    camera: Camera,
    settings_of_cache: &StillSettings,
) -> anyhow::Result<(f64, [Shown; 2])> {
    let inside = shown(still, camera, settings_of_cache)?;
    ensure!(
        inside.texels > 0 && inside.pixels > 0,
        "{name}: {} texels, {} pixels",
        inside.texels,
        inside.pixels
    );
    ensure!(
        inside.linear.iter().all(|v| v.is_finite() && *v >= 0.0),
        "{name}: not a number"
    );
    let alone = settings(RendererKind::ScreenSpace, [0.0; 3]);
    let rays = shown(still, camera, &alone)?;
    ensure!(rays.texels == 0, "rays march no texels");
    let found = distance(&rays.picture, &inside.picture)?;
    println!(
        "{name}: FLIP {:.4}, SSIM {:.4}; {} texels, {} rays of near parts with {} evaluations; rays alone {} with {}",
        found.flip,
        found.ssim,
        inside.texels,
        inside.pixels,
        inside.evaluations,
        rays.pixels,
        rays.evaluations
    );
    let pictures = target_dir()?.join("pictures-of-tests/inside");
    std::fs::create_dir_all(&pictures)?;
    inside
        .picture
        .save(pictures.join(format!("{name}-near-and-far.png")))?;
    rays.picture
        .save(pictures.join(format!("{name}-rays.png")))?;
    Ok((found.flip, [inside, rays]))
}

fn camera(altitude_m: f64, yaw_deg: f64, pitch_deg: f64) -> anyhow::Result<Camera> {
    Ok(Camera::new(
        [200.0, altitude_m, -300.0],
        yaw_deg,
        pitch_deg,
        60.0,
    )?)
}

#[test]
fn in_a_layer_near_and_far_together_show_what_rays_alone_show() -> Outcome {
    let mut still = renderer()?;
    for (name, altitude_m, yaw_deg, pitch_deg) in [
        ("along", 2_500.0, 40.0, 0.0),
        ("up", 2_500.0, 40.0, 35.0),
        ("down", 2_500.0, 40.0, -35.0),
        ("below-the-top", 3_600.0, 130.0, -8.0),
        ("above-the-base", 1_600.0, 220.0, 5.0),
    ] {
        let camera = camera(altitude_m, yaw_deg, pitch_deg)?;
        let cached = settings(RendererKind::Cached, [0.0; 3]);
        let (flip, [inside, rays]) = apart(&mut still, name, camera, &cached)?;
        ensure!(flip <= AT_REFERENCE, "{name}: {flip}");
        // Of two layers one is marched for each pixel, and of that what is near.
        ensure!(2 * inside.pixels == rays.pixels, "{name}");
    }
    Ok(())
}

#[test]
fn beside_the_reference_of_a_layer_nothing_is_torn() -> Outcome {
    let mut still = renderer()?;
    for (name, offset_m, more) in [
        ("100m-aside", [100.0, 0.0, 0.0], ASIDE_100_M),
        ("300m-aside", [300.0, 0.0, 0.0], ASIDE_300_M),
        ("100m-up", [0.0, 100.0, 0.0], ASIDE_100_M),
    ] {
        let camera = camera(2_500.0, 40.0, 0.0)?;
        let cached = settings(RendererKind::Cached, offset_m);
        let (flip, _) = apart(&mut still, name, camera, &cached)?;
        ensure!(flip <= AT_REFERENCE + more, "{name}: {flip}");
    }
    Ok(())
}

#[test]
fn in_slabs_the_far_part_is_kept_in_bands() -> Outcome {
    let mut still = renderer()?;
    let cached = StillSettings {
        slabs: 2,
        ..settings(RendererKind::Cached, [0.0; 3])
    };
    let (flip, _) = apart(&mut still, "slabs", camera(2_500.0, 40.0, 0.0)?, &cached)?;
    ensure!(flip <= AT_REFERENCE, "{flip}");
    Ok(())
}

/// A layer of smoke that is filled evenly: what is seen through it is what is behind it times its transmittance, so that each
/// metre of it that is there twice or not at all shows.
fn smoke() -> anyhow::Result<StillRenderer> {
    let scene = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
        {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 4000, "extinction_per_m": 0.0002,
         "single_scattering_albedo": 0, "density": {"model": "homogeneous"}}]});
    let config = RenderConfig::new(target_dir()?.join("noise-of-tests"));
    let scene = Arc::new(Scene::from_json(&scene)?);
    Ok(StillRenderer::new(config, scene, &[])?)
}

/// Mean relative difference of radiance between near and far in smoke and rays alone, where rays show something.
fn apart_in_smoke(
    still: &mut StillRenderer,
    name: &str,
    offset_m: [f64; 3],
) -> anyhow::Result<f64> {
    let clear = |settings: StillSettings| StillSettings {
        march: MarchSettings {
            aerial_perspective: false,
            ..settings.march
        },
        ..settings
    };
    let along = camera(2_500.0, 40.0, 0.0)?;
    let cached = clear(settings(RendererKind::Cached, offset_m));
    let alone = clear(settings(RendererKind::ScreenSpace, [0.0; 3]));
    let inside = shown(still, along, &cached)?;
    ensure!(inside.texels > 0 && inside.pixels > 0, "{name}");
    let rays = shown(still, along, &alone)?;
    let most = rays.linear.iter().copied().fold(0.0, f32::max);
    let pairs = inside.linear.iter().zip(&rays.linear).enumerate();
    let off: Vec<f64> = pairs
        .filter(|(index, (_, by_rays))| index % 4 < 3 && **by_rays > 0.01 * most)
        .map(|(_, (seen, by_rays))| f64::from((seen - by_rays).abs() / by_rays))
        .collect();
    ensure!(off.len() > 1_000, "{name}: {} values", off.len());
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    println!(
        "{name}: {:.2} % off in the mean of {} values",
        100.0 * mean,
        off.len()
    );
    Ok(mean)
}

/// What 100 m of the smoke take.
const IN_SMOKE: f64 = 0.02;

#[test]
fn in_smoke_each_metre_is_in_one_part() -> Outcome {
    let mut still = smoke()?;
    let right = apart_in_smoke(&mut still, "smoke", [0.0; 3])?;
    ensure!(right < IN_SMOKE, "{right}");
    // From beside the reference what is far is seen at other angles, but no part of it twice.
    let aside = apart_in_smoke(&mut still, "smoke-300m-aside", [300.0, 0.0, 0.0])?;
    ensure!(aside < 5.0 * IN_SMOKE, "{aside}");
    Ok(())
}

#[test]
fn near_parts_that_end_where_far_ones_do_not_begin_are_found() -> Outcome {
    let mut still = smoke()?;
    // Of what is between 1.6 and 2 km the near part has all, the far part some: 200 m too much.
    still.plant(Some(|path, source| match path {
        "march/pixels.wgsl" => source.replace("end_m - eye.reach_fade_m", "end_m"),
        _ => source.to_owned(),
    }))?;
    let twice = apart_in_smoke(&mut still, "planted-twice", [0.0; 3])?;
    // Of what is between 1.2 and 2 km nobody has all: 400 m too little.
    still.plant(Some(|path, source| match path {
        "march/pixels.wgsl" => source.replace(
            "let end_m = dome_distance_m(eye.reach_m,",
            "let end_m = dome_distance_m(eye.reach_m - 400.0,",
        ),
        _ => source.to_owned(),
    }))?;
    let never = apart_in_smoke(&mut still, "planted-never", [0.0; 3])?;
    ensure!(
        twice > IN_SMOKE && never > 2.0 * IN_SMOKE,
        "{twice} {never}"
    );
    Ok(())
}

#[test]
fn at_the_edges_of_layers_no_picture_is_broken() -> Outcome {
    let mut still = renderer()?;
    for (altitude_m, pitch_deg) in [
        (1_500.0, 0.0),
        (1_500.0, -90.0),
        (4_000.0, 90.0),
        (4_000.0, -0.5),
        (6_300.0, 0.0),
    ] {
        let cached = settings(RendererKind::Cached, [0.0; 3]);
        let seen = shown(&mut still, camera(altitude_m, 10.0, pitch_deg)?, &cached)?;
        ensure!(
            seen.linear.iter().all(|v| v.is_finite() && *v >= 0.0),
            "{altitude_m} m"
        );
    }
    Ok(())
}
