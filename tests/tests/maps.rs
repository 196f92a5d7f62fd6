//! Maps replaced while people watch: a sky gathers and clears, bad files change nothing, a restart keeps all.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, ensure};
use image::RgbImage;
use serde_json::json;
use skycell_client::{HttpApiError, MapChoice};
use skycell_protocol::scene::MapKind;
use skycell_protocol::{Camera, FrameSize, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::field::{GreyMap, MapFileFormat};
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use skycell_server::march::MarchSettings;
use skycell_tests::picture::{decoded, mean_difference};
use skycell_tests::server::{binary, target_dir, total_of};
use skycell_tests::{Server, ServerOptions, Viewer};

type Outcome = anyhow::Result<()>;

/// As in `end_to_end.rs`: pictures of other clouds differ by more, 8-bit steps in the mean.
const OTHER_PICTURE: f64 = 1.0;
/// And of the same ones by less.
const SAME_PICTURE: f64 = 0.1;

fn choice(kind: MapKind) -> MapChoice {
    MapChoice { kind, layer: None }
}

/// A map of one texel.
fn constant(value: f32) -> anyhow::Result<Vec<u8>> {
    let map = GreyMap {
        width: 1,
        height: 1,
        values: vec![value],
    };
    Ok(map.encode(MapFileFormat::Png)?)
}

/// How far what a viewer is shown is from a picture in the end: on a busy machine the last frame of a sky that rests may come
/// seconds after the one before.
async fn comes_to(viewer: &Viewer, picture: &RgbImage) -> anyhow::Result<f64> {
    let mut difference = f64::INFINITY;
    for _ in 0..40 {
        difference = mean_difference(&decoded(viewer.seen().frame()?)?, picture);
        if difference < SAME_PICTURE {
            break;
        }
        tokio::time::sleep(Duration::from_millis(250)).await;
    }
    Ok(difference)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sky_clears_at_once_gathers_over_time_comes_to_rest_and_survives_a_power_cut() -> Outcome
{
    let state = tempfile::tempdir()?;
    let options = ServerOptions {
        state_dir: Some(state.path().join("state")),
        ..ServerOptions::default()
    };
    let server = Server::start_with(options.clone()).await?;
    server.calm().await?;
    let viewer = Viewer::join(&server, 0.0).await?;
    server.at_rest(1).await?;
    let cloudy = decoded(viewer.seen().frame()?)?;
    let api = server.api();
    let coverage = choice(MapKind::Coverage);

    // At once, because the scene says nothing else.
    let scene = api
        .set_map(&coverage, Some(constant(0.0)?), None, "*")
        .await?;
    let revision = scene.revision().context("a revision")?;
    viewer
        .wait_for("a frame of the new scene", |seen| {
            seen.frame
                .as_ref()
                .is_some_and(|frame| frame.header.scene_revision >= revision)
        })
        .await?;
    server.at_rest(1).await?;
    let clear = decoded(viewer.seen().frame()?)?;
    let difference = mean_difference(&clear, &cloudy);
    ensure!(
        difference > OTHER_PICTURE,
        "the cleared sky differs by {difference}"
    );

    // A file that is no map: refused with the reason, and nothing has happened.
    let refused = api
        .set_map(&coverage, Some(b"no picture".to_vec()), None, "*")
        .await;
    match refused {
        Err(HttpApiError::Refused {
            status, problem, ..
        }) => {
            ensure!(status == 415, "{status}");
            ensure!(problem.detail.contains("PNG or EXR"), "{}", problem.detail);
        }
        other => anyhow::bail!("not refused: {other:?}"),
    }
    ensure!(api.scene().await?.revision() == Some(revision));

    // Overcast in six seconds: step by step.
    let started = tokio::time::Instant::now();
    let before = server.total("texels_updated").await?;
    api.set_map(&coverage, Some(constant(1.0)?), Some(6.0), "*")
        .await?;
    let mut on_the_way = Vec::new();
    // Steps wait for what they make to be marched, so that a busy machine takes longer.
    while started.elapsed() < Duration::from_secs(15) {
        tokio::time::sleep(Duration::from_millis(150)).await;
        on_the_way.push(mean_difference(&decoded(viewer.seen().frame()?)?, &clear));
    }
    let stats = server.at_rest(1).await?;
    let overcast = decoded(viewer.seen().frame()?)?;
    let whole = mean_difference(&overcast, &clear);
    println!("of {whole:.2} steps on the way: {on_the_way:.2?}");
    ensure!(
        whole > 4.0 * OTHER_PICTURE,
        "the gathered sky differs by {whole}"
    );
    // Nothing at first, and pictures between clear and overcast.
    ensure!(on_the_way[0] < 0.25 * whole, "{on_the_way:?} of {whole}");
    let between = on_the_way
        .iter()
        .filter(|d| (0.1 * whole..0.9 * whole).contains(*d))
        .count();
    ensure!(between >= 3, "{on_the_way:?} of {whole}");
    // In steps: not every texel in every frame.
    let marched = total_of(&stats, "texels_updated")? - before;
    println!("{marched} texels marched on the way");

    // At rest it costs nothing.
    let rested = server.total("texels_updated").await?;
    tokio::time::sleep(Duration::from_secs(1)).await;
    ensure!(server.total("texels_updated").await? == rested);

    // What was put is what is fetched; a killed server knows it again.
    let file = api.map(&coverage, "png").await?;
    ensure!(GreyMap::decode(&file)?.values == [1.0]);
    drop(viewer);
    server.kill()?;
    let server = Server::start_with(options).await?;
    let viewer = Viewer::join(&server, 0.0).await?;
    server.at_rest(1).await?;
    let difference = comes_to(&viewer, &overcast).await?;
    ensure!(
        difference < SAME_PICTURE,
        "the restarted sky differs by {difference}"
    );

    // And the generated map again.
    server
        .api()
        .set_map(&coverage, None, Some(0.0), "*")
        .await?;
    server.at_rest(1).await?;
    let difference = comes_to(&viewer, &cloudy).await?;
    ensure!(
        difference < SAME_PICTURE,
        "the reset sky differs by {difference}"
    );
    viewer.close().await;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn noise_that_rises_ages_texels_for_as_long_as_it_rises() -> Outcome {
    let server = Server::start_calm().await?;
    let viewer = Viewer::join(&server, 0.0).await?;
    server.at_rest(1).await?;
    let mut layers = server.api().scene().await?.document["layers"].clone();
    layers[0]["density"]["evolution_m_per_s"] = json!(20.0);
    server.patch(&json!({"layers": layers.clone()})).await?;
    tokio::time::sleep(Duration::from_secs(4)).await;
    let before = server.total("texels_updated").await?;
    let shown = decoded(viewer.seen().frame()?)?;
    // At 20 m/s clouds 3 km away age in about two seconds.
    tokio::time::sleep(Duration::from_secs(5)).await;
    let marched = server.total("texels_updated").await? - before;
    ensure!(marched > 0, "nothing was marched");
    let later = decoded(viewer.seen().frame()?)?;
    let difference = mean_difference(&shown, &later);
    ensure!(difference > 0.1, "the picture differs by {difference}");
    layers[0]["density"]["evolution_m_per_s"] = json!(0.0);
    server.patch(&json!({"layers": layers})).await?;
    server.at_rest(1).await?;
    viewer.close().await;
    Ok(())
}

/// What the client says, and whether it was content.
async fn skycell(server: &Server, arguments: &[&str]) -> anyhow::Result<(bool, String)> {
    let url = format!("ws://{}/ws", server.address());
    let mut command = std::process::Command::new(binary("skycell")?);
    command
        .args(["scene", "map"])
        .args(arguments)
        .args(["--url", &url]);
    let output = tokio::task::spawn_blocking(move || command.output()).await??;
    let said = [output.stdout, output.stderr].concat();
    Ok((output.status.success(), String::from_utf8(said)?))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_client_fetches_replaces_and_resets_maps() -> Outcome {
    let server = Server::start_calm().await?;
    let folder = tempfile::tempdir()?;
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (png, exr) = (path("made.png"), path("made.exr"));
    for file in [&png, &exr] {
        let (good, said) = skycell(&server, &["get", "coverage", file]).await?;
        ensure!(good, "{said}");
    }
    let made = GreyMap::decode(&std::fs::read(&exr)?)?;
    ensure!((made.width, made.height) == (1024, 1024));
    // What was made in bytes is the same in 16 bits.
    let read = GreyMap::decode(&std::fs::read(&png)?)?;
    let worst = made
        .values
        .iter()
        .zip(&read.values)
        .map(|(a, b)| (a - b).abs());
    ensure!(worst.fold(0.0, f32::max) < 1e-6);

    let put = [
        "put",
        "type",
        &png,
        "--layer",
        "low",
        "--transition-s",
        "2",
        "--json",
    ];
    let (good, said) = skycell(&server, &put).await?;
    ensure!(good, "{said}");
    let told: serde_json::Value = serde_json::from_str(said.trim())?;
    let maps = &told["scene"]["layers"][0]["density"]["maps"];
    ensure!(
        maps["type"].is_string() && maps["transition_s"] == 2.0,
        "{told}"
    );
    let stale = ["reset", "type", "--if-match", "1"];
    let (good, said) = skycell(&server, &stale).await?;
    ensure!(!good && said.contains("412"), "{said}");
    let (good, said) = skycell(&server, &["reset", "type"]).await?;
    ensure!(good && said.starts_with("revision"), "{said}");

    std::fs::write(path("notes.png"), "no picture")?;
    let (good, said) = skycell(&server, &["put", "type", &path("notes.png")]).await?;
    ensure!(
        !good && said.contains("6e 6f 20 70") && said.contains("PNG or EXR"),
        "{said}"
    );
    let (good, said) = skycell(&server, &["put", "height", &png]).await?;
    ensure!(!good && said.contains("coverage, type, profile"), "{said}");
    let (good, said) = skycell(&server, &["get", "type", &path("type.tiff")]).await?;
    ensure!(!good && said.contains(".png or .exr"), "{said}");
    Ok(())
}

#[test]
fn maps_have_a_blend_for_as_long_as_they_are_on_their_way() {
    let scene = |seed: u32| {
        let document = json!({"version": 1, "layers": [{"density": {"model": "weather", "seed": seed,
            "maps": {"transition_s": if seed == 1 { 0 } else { 10 }}}}]});
        Arc::new(Scene::from_json(&document).expect("a valid document"))
    };
    let noise = target_dir().expect("a folder").join("noise-of-tests");
    let mut still = StillRenderer::new(RenderConfig::new(noise), scene(1), &[]).expect("a device");
    let look = |still: &mut StillRenderer| {
        let settings = StillSettings {
            samples: 1,
            march: MarchSettings {
                steps: 16,
                ..MarchSettings::default()
            },
            ..StillSettings::default()
        };
        let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 30.0, 60.0).expect("a camera");
        let size = FrameSize::new(32, 16).expect("a size");
        still
            .render_with(camera, size, &settings, |_| {})
            .expect("a picture");
        still.inventory()
    };
    let at_rest = look(&mut still);
    assert!(!at_rest.pipelines.contains_key("blend_maps"), "{at_rest:?}");
    still.set_scene(scene(2)).expect("pipelines");
    still.advance_time(5.0);
    let on_the_way = look(&mut still);
    assert_eq!(on_the_way.pipelines.get("blend_maps"), Some(&1));
    still.advance_time(6.0);
    let arrived = look(&mut still);
    for label in ["old maps", "new maps", "mixed maps"] {
        assert!(!at_rest.has(label), "{at_rest:?}");
        assert!(on_the_way.has(label), "{on_the_way:?}");
        assert!(!arrived.has(label), "{arrived:?}");
    }
}
