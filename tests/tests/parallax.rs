//! Viewers beside the reference of their cell: what they see in its cache against rays of their own.

use image::RgbImage;
use serde_json::json;
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use skycell_shaders::SourceEdit;
use skycell_tests::accuracy::{Distance, distance};
use skycell_tests::picture::without_alpha;
use skycell_tests::server::target_dir;
use std::sync::Arc;

/// Size of the pictures.
const SIZE: [u32; 2] = [192, 108];
/// Samples of texels and pixels.
const SAMPLES: u32 = 4;

fn renderer(scene: Arc<Scene>) -> anyhow::Result<StillRenderer> {
    let config = RenderConfig::new(target_dir()?.join("noise-of-tests"));
    Ok(StillRenderer::new(config, scene, &[])?)
}

fn picture(still: &mut StillRenderer, settings: &StillSettings) -> anyhow::Result<RgbImage> {
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0)?;
    let size = FrameSize::new(SIZE[0], SIZE[1])?;
    let made = still.render_with(camera, size, settings, |_| {})?;
    without_alpha(&made.display, size)
}

fn cached(offset_m: [f64; 3], parallax_steps: u32) -> StillSettings {
    StillSettings {
        samples: SAMPLES,
        reference_offset_m: offset_m,
        parallax_steps,
        ..StillSettings::default()
    }
}

/// How far the cache of a reference is from rays of the viewer's own, without a search and with one.
fn apart(still: &mut StillRenderer, offset_m: [f64; 3]) -> anyhow::Result<[Distance; 2]> {
    let own = StillSettings {
        renderer: RendererKind::ScreenSpace,
        samples: SAMPLES,
        ..StillSettings::default()
    };
    let own = picture(still, &own)?;
    let mut found = Vec::new();
    for steps in [0, StillSettings::default().parallax_steps] {
        let seen = picture(still, &cached(offset_m, steps))?;
        found.push(distance(&own, &seen)?);
    }
    println!(
        "{offset_m:?} m: on the sphere {:?}, searched {:?}",
        found[0], found[1]
    );
    Ok([found[0], found[1]])
}

#[test]
fn beside_the_reference_a_viewer_sees_clouds_where_they_are() -> anyhow::Result<()> {
    let mut still = renderer(Arc::default())?;
    for offset_m in [[300.0, 0.0, 0.0], [1_000.0, 0.0, 0.0], [0.0, 0.0, 1_000.0]] {
        let [sphere, searched] = apart(&mut still, offset_m)?;
        // Measured: .47, .47 and .43 of the proxy sphere's.
        assert!(
            searched.flip <= 0.6 * sphere.flip && searched.ssim > sphere.ssim,
            "{offset_m:?}: {sphere:?} {searched:?}"
        );
    }
    Ok(())
}

/// A search that takes what texels show to be half as far.
fn half_as_far(path: &str, source: &str) -> String {
    if path == "composite/cached.wgsl" {
        source.replace("- shown.distance_m;", "- 0.5 * shown.distance_m;")
    } else {
        source.to_owned()
    }
}

#[test]
fn a_box_high_above_its_proxy_sphere_stands_where_it_is_seen_from_aside() -> anyhow::Result<()> {
    // The layer's sphere is at 3 km, the box from 4.6 to 5 km.
    let scene = json!({"version": 1, "wind": {"speed_m_per_s": 0.0}, "layers": [{"name": "box",
        "base_altitude_m": 1_000, "top_altitude_m": 5_000, "extinction_per_m": 0.02,
        "density": {"model": "homogeneous", "shape": {"form": "box",
            "center_m": [0, 4_800, -8_000], "size_m": [3_000, 400, 3_000]}}}]});
    let mut still = renderer(Arc::new(Scene::from_json(&scene)?))?;
    let offset_m = [1_500.0, 0.0, 0.0];
    let [sphere, searched] = apart(&mut still, offset_m)?;
    assert!(
        searched.flip <= 0.25 * sphere.flip,
        "{sphere:?} {searched:?}"
    );
    // A defect must show.
    let edit: SourceEdit = half_as_far;
    still.plant(Some(edit))?;
    let [_, wrong] = apart(&mut still, offset_m)?;
    assert!(wrong.flip > 3.0 * searched.flip, "{wrong:?}");
    Ok(())
}

#[test]
fn a_layer_in_slabs_looks_whole_from_the_reference_and_stands_better_beside_it()
-> anyhow::Result<()> {
    let mut still = renderer(Arc::default())?;
    let of = |offset_m, slabs| StillSettings {
        slabs,
        ..cached(offset_m, StillSettings::default().parallax_steps)
    };
    let whole = picture(&mut still, &of([0.0; 3], 1))?;
    for slabs in 2..=4 {
        let cut = picture(&mut still, &of([0.0; 3], slabs))?;
        let apart = distance(&whole, &cut)?;
        println!("{slabs} slabs: {apart:?}");
        assert!(apart.flip < 0.01, "{slabs} slabs: {apart:?}");
    }
    let own = StillSettings {
        renderer: RendererKind::ScreenSpace,
        samples: SAMPLES,
        ..StillSettings::default()
    };
    let own = picture(&mut still, &own)?;
    let mut beside = Vec::new();
    for slabs in [1, 4] {
        let seen = picture(&mut still, &of([3_000.0, 0.0, 0.0], slabs))?;
        beside.push(distance(&own, &seen)?);
        println!("{slabs} slabs, 3 km aside: {:?}", beside.last());
    }
    assert!(beside[1].flip < beside[0].flip, "{beside:?}");
    Ok(())
}
