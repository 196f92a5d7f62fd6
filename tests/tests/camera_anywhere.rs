//! A camera that climbs from the ground through a cloud layer and between layers to orbit, on a real server: which renderer
//! shows it, that no frame is black or broken, that its frames are those of rays through every pixel, and that the change
//! between renderers is none of the picture.

use anyhow::ensure;
use image::RgbImage;
use serde_json::{Value, json};
use skycell_protocol::message::Hello;
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use skycell_server::march::MarchSettings;
use skycell_tests::accuracy::distance;
use skycell_tests::picture::{decoded, without_alpha};
use skycell_tests::server::target_dir;
use skycell_tests::{Server, ServerOptions, Viewer};
use std::sync::Arc;

type Outcome = anyhow::Result<()>;

const STEPS: u32 = 48;
const SAMPLES: u32 = 4;

/// Two layers with a gap between them, no wind.
fn scene() -> Value {
    json!({
        "layers": [
            {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 2500,
             "density": {"model": "weather", "coverage": 0.6, "type": 0.5}},
            {"name": "high", "base_altitude_m": 4000, "top_altitude_m": 4600,
             "density": {"model": "weather", "coverage": 0.4, "type": 0.2, "seed": 3}}
        ],
        "wind": {"speed_m_per_s": 0}
    })
}

fn size() -> FrameSize {
    FrameSize::new(96, 56).expect("a size")
}

async fn server() -> anyhow::Result<Server> {
    let server = Server::start_with(ServerOptions {
        render_toml: format!(
            "march_steps = {STEPS}\nsamples = {SAMPLES}\nmip_bias = 0.0\nframe_filter = \"catmull-rom\""
        ),
        ..ServerOptions::default()
    })
    .await?;
    server.patch(&scene()).await?;
    Ok(server)
}

/// The picture by rays of its own, without a server.
fn by_rays(still: &mut StillRenderer, camera: Camera, quality: &Value) -> RgbImage {
    let of_quality = |key: &str| quality[key].as_u64().map(|value| value as u32);
    let settings = StillSettings {
        renderer: RendererKind::ScreenSpace,
        samples: SAMPLES,
        march: MarchSettings {
            steps: STEPS,
            sun_steps: of_quality("sun_steps"),
            octaves: of_quality("octaves"),
            ..MarchSettings::default()
        },
        ..StillSettings::default()
    };
    let picture = still
        .render_with(camera, size(), &settings, |_| {})
        .expect("a picture");
    without_alpha(&picture.display, size()).expect("as many pixels")
}

/// Share of pixels that are wholly black.
fn black(picture: &RgbImage) -> f64 {
    let black = picture.pixels().filter(|pixel| pixel.0 == [0; 3]).count();
    black as f64 / f64::from(picture.width() * picture.height())
}

async fn renderer_of(server: &Server) -> anyhow::Result<(String, bool)> {
    let stats = server.get("api/v1/stats").await?;
    let viewer = &stats["viewers"][0];
    let renderer = viewer["renderer"].as_str().unwrap_or_default().to_owned();
    Ok((renderer, viewer["renderer_note"].is_string()))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_from_the_ground_through_a_cloud_to_orbit_is_never_shown_a_broken_frame() -> Outcome
{
    let server = server().await?;
    let camera = |altitude_m: f64, pitch_deg: f64| {
        Camera::new([200.0, altitude_m, -300.0], 40.0, pitch_deg, 60.0)
    };
    let start = camera(2.0, 20.0)?;
    let hello = Hello {
        codec: skycell_protocol::Codec::Png,
        ..Hello::new(size(), 30.0, start)
    };
    let viewer = Viewer::join_as(&server, hello).await?;
    server.at_rest(1).await?;
    let mut document = scene();
    document["version"] = json!(1);
    let reference_scene = Arc::new(Scene::from_json(&document)?);
    let config = RenderConfig::new(target_dir()?.join("noise-of-tests"));
    let mut still = StillRenderer::new(config, reference_scene, &[])?;

    // What was seen and what rays see, side by side for whoever wants to look.
    let pictures = target_dir()?.join("pictures-of-tests/camera-anywhere");
    std::fs::create_dir_all(&pictures)?;
    // Wherever it comes to rest the cache is read, in a layer for all but what is near. Down again at the end.
    for (place, (altitude_m, pitch_deg)) in [
        (2.0, 20.0),
        (1495.0, 20.0),
        (1505.0, 20.0),
        (2100.0, 0.0),
        (3200.0, -10.0),
        (4300.0, 5.0),
        (12_000.0, -15.0),
        (400_000.0, -20.0),
        (1400.0, 20.0),
    ]
    .into_iter()
    .enumerate()
    {
        let camera = camera(altitude_m, pitch_deg)?;
        let input = viewer.look(camera).await?;
        let shown = |seen: &skycell_tests::Seen| {
            seen.frame
                .as_ref()
                .is_some_and(|frame| frame.header.input >= input)
        };
        viewer.wait_for("the new view", shown).await?;
        // A viewer that comes to where a cache holds goes on with rays until that is there.
        server.at_rest(1).await?;
        let begun = std::time::Instant::now();
        while renderer_of(&server).await?.0 != "cached" && begun.elapsed().as_secs() < 30 {
            tokio::time::sleep(std::time::Duration::from_millis(100)).await;
        }
        let stats = server.at_rest(1).await?;
        let quality = &stats["viewers"][0]["quality"]["settings"];
        let (is, has_note) = renderer_of(&server).await?;
        ensure!(is == "cached", "{altitude_m} m is shown by {is}");
        ensure!(!has_note, "nothing is to be explained");
        let picture = decoded(viewer.seen().frame()?)?;
        // In orbit most of the picture is space.
        let most_black = if altitude_m > 1e5 { 0.9 } else { 0.02 };
        ensure!(
            black(&picture) <= most_black,
            "{altitude_m} m: {} black",
            black(&picture)
        );
        let reference = by_rays(&mut still, camera, quality);
        let flip = distance(&picture, &reference)?.flip;
        picture.save(pictures.join(format!("{place}-shown.png")))?;
        reference.save(pictures.join(format!("{place}-by-rays.png")))?;
        println!(
            "{altitude_m:>8} m  {is:<12} FLIP {flip:.4}, black {:.3}",
            black(&picture)
        );
        // What filter, texels and a sky that four pixels share cost at this size; rays of the viewer's own are a temporal window,
        // of which this reference has none. Measured: 0.036 or less in the cache, 0.034 in the window, by 0.006 more or less from
        // run to run. A guard of what was measured, no target.
        let bound = 0.045;
        ensure!(flip <= bound, "{altitude_m} m: FLIP {flip}");
    }
    viewer.close().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_on_the_boundary_does_not_change_renderers_all_the_time() -> Outcome {
    let server = server().await?;
    let camera = |altitude_m: f64| Camera::new([0.0, altitude_m, 0.0], 0.0, 20.0, 60.0);
    let hello = Hello {
        codec: skycell_protocol::Codec::Png,
        ..Hello::new(FrameSize::new(32, 16)?, 30.0, camera(1498.0)?)
    };
    let viewer = Viewer::join_as(&server, hello).await?;
    server.at_rest(1).await?;
    let mut changes = Vec::new();
    let mut last = renderer_of(&server).await?.0;
    ensure!(last == "cached", "{last}");
    for round in 0..8 {
        let input = viewer
            .look(camera(if round % 2 == 0 { 1502.0 } else { 1498.0 })?)
            .await?;
        viewer
            .wait_for("the new view", |seen| {
                seen.frame
                    .as_ref()
                    .is_some_and(|frame| frame.header.input >= input)
            })
            .await?;
        tokio::time::sleep(std::time::Duration::from_millis(300)).await;
        let now = renderer_of(&server).await?.0;
        if now != last {
            changes.push((round, now.clone()));
            last = now;
        }
    }
    ensure!(changes.len() == 1 && last == "screen-space", "{changes:?}");
    viewer.close().await;
    Ok(())
}
