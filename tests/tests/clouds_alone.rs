//! Clouds alone, for renderers with a background of their own: over the sky's own background they are the picture, and
//! viewers who ask for them share the caches of those who do not.

use anyhow::{Context, ensure};
use half::f16;
use serde_json::{Value, json};
use skycell_protocol::clouds::{Clouds, WHITE, append};
use skycell_protocol::message::{Hello, ViewChange};
use skycell_protocol::{Camera, Codec, FrameCodec, FrameSize, RendererKind, Scene, Show, Stereo};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{StillPicture, StillRenderer, StillSettings};
use skycell_server::march::MarchSettings;
use skycell_tests::picture::decoded;
use skycell_tests::server::{target_dir, total_of};
use skycell_tests::{Seen, Server, Viewer};
use std::sync::Arc;

fn scene(document: &Value) -> Arc<Scene> {
    Arc::new(Scene::from_json(document).expect("a valid document"))
}

fn still(document: &Value) -> StillRenderer {
    let noise = target_dir().expect("a folder").join("noise-of-tests");
    StillRenderer::new(RenderConfig::new(noise), scene(document), &[]).expect("a device")
}

fn settings(renderer: RendererKind) -> StillSettings {
    StillSettings {
        renderer,
        samples: 2,
        march: MarchSettings {
            steps: 32,
            ..MarchSettings::default()
        },
        ..StillSettings::default()
    }
}

fn size() -> FrameSize {
    FrameSize::new(64, 36).expect("a size")
}

fn pixels() -> usize {
    size().pixels() as usize
}

/// Looks up into clouds, with some ground below.
fn outlook(altitude_m: f64, yaw_deg: f64, pitch_deg: f64) -> Camera {
    Camera::new([0.0, altitude_m, 0.0], yaw_deg, pitch_deg, 60.0).expect("a camera")
}

/// The picture, and the clouds alone of it.
fn both(
    still: &mut StillRenderer,
    camera: Camera,
    settings: &StillSettings,
    haze: bool,
) -> (StillPicture, Clouds) {
    let picture = still
        .render_with(camera, size(), settings, |_| {})
        .expect("a picture");
    (picture, alone(still, settings, haze))
}

fn alone(still: &mut StillRenderer, settings: &StillSettings, haze: bool) -> Clouds {
    let clouds = still
        .clouds_of_last(size(), settings, haze)
        .expect("clouds");
    let mut payload = Vec::new();
    append(&mut payload, &clouds.header, &clouds.pixels).expect("clouds");
    // Reading refuses what is negative, infinite, no number or more than all light.
    Clouds::parse(&payload).expect("clouds")
}

fn with_layers(mut document: Value, layers: Value) -> Value {
    document["layers"] = layers;
    document
}

/// How far a background behind clouds may be from the picture in a channel: half a step of the half floats that hold colour and
/// transmittance, and f32's rounding of the sums.
fn budget(clouds: &Clouds, pixel: usize, channel: usize, behind: f64) -> f64 {
    let colour = f64::from(clouds.radiance(pixel)[channel] * WHITE[channel]);
    let through = f64::from(clouds.transmittance(pixel)) * behind;
    let smallest =
        0.5f64.powi(25) / f64::from(clouds.header().pre_exposure) * f64::from(WHITE[channel]);
    0.5f64.powi(11) * (colour + through)
        + smallest
        + 0.5f64.powi(25) * behind
        + 2e-6 * (colour + through)
}

/// How far clouds over a background are from the picture, in budgets, in the worst pixel and channel.
fn worst_share(
    clouds: &Clouds,
    bare: &StillPicture,
    picture: &StillPicture,
) -> (f64, (usize, usize)) {
    let mut worst = (0.0, (0, 0));
    for pixel in 0..pixels() {
        for (channel, white) in WHITE.into_iter().enumerate() {
            let behind = f64::from(bare.linear[4 * pixel + channel]);
            let colour = f64::from(clouds.radiance(pixel)[channel] * white);
            let over = f64::from(clouds.transmittance(pixel)) * behind + colour;
            let off = (over - f64::from(picture.linear[4 * pixel + channel])).abs();
            let share = off / budget(clouds, pixel, channel, behind);
            if share > worst.0 {
                worst = (share, (pixel, channel));
            }
        }
    }
    worst
}

/// Layers that share altitudes and scatter each in its own way: their order is decided in each pixel.
fn crossing() -> Value {
    json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [
        {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 4000},
        {"name": "veil", "base_altitude_m": 2000, "top_altitude_m": 2200, "extinction_per_m": 0.002,
         "phase": {"model": "hg", "g": 0.3}, "density": {"model": "homogeneous"}},
        {"name": "high", "base_altitude_m": 6000, "top_altitude_m": 6400, "extinction_per_m": 0.001,
         "density": {"model": "homogeneous"}}]})
}

#[test]
fn clouds_over_the_skys_own_background_are_the_picture_in_both_renderers() {
    let still_air = json!({"speed_m_per_s": 0});
    let plain = json!({"version": 1, "wind": still_air});
    let physical = json!({"version": 1, "wind": still_air, "atmosphere": {"model": "physical"},
        "sun": {"elevation_deg": 4}});
    let crossing = crossing();
    let mut worst = 0.0f64;
    for (name, document, camera, renderers) in [
        (
            "plain",
            &plain,
            outlook(2.0, 0.0, 12.0),
            &[RendererKind::Cached, RendererKind::ScreenSpace][..],
        ),
        (
            "towards a low sun",
            &physical,
            outlook(2.0, 135.0, 12.0),
            &[RendererKind::Cached, RendererKind::ScreenSpace],
        ),
        (
            "from above",
            &plain,
            outlook(9_000.0, 0.0, -10.0),
            &[RendererKind::Cached],
        ),
        (
            "crossing layers",
            &crossing,
            outlook(2.0, 40.0, 30.0),
            &[RendererKind::Cached],
        ),
    ] {
        let mut still = still(document);
        for renderer in renderers {
            let settings = settings(*renderer);
            still.set_scene(scene(document)).expect("a scene");
            let (picture, clouds) = both(&mut still, camera, &settings, true);
            still
                .set_scene(scene(&with_layers(document.clone(), json!([]))))
                .expect("a scene");
            let (bare, nothing) = both(&mut still, camera, &settings, true);
            assert_eq!(nothing.planes()[..3], vec![vec![f16::ZERO; pixels()]; 3]);
            let covered = (0..pixels())
                .filter(|pixel| clouds.transmittance(*pixel) < 0.9)
                .count();
            let (share, place) = worst_share(&clouds, &bare, &picture);
            worst = worst.max(share);
            assert!(
                share <= 1.0,
                "{name}, {renderer:?}: {share} of the budget at {place:?}"
            );
            // Of those pixels that show sky, a good part shows cloud; else nothing was compared.
            println!(
                "{name}, {renderer:?}: {covered} of {} pixels hide a tenth or more",
                size().pixels()
            );
            assert!(covered * 10 > pixels(), "{name}, {renderer:?}: {covered}");
        }
    }
    println!("worst share of the rounding budget: {worst:.2}");
}

/// A defect: the shader whose text is changed, and how.
type Defect = (&'static str, skycell_shaders::SourceEdit);

/// An edit of one place of one file.
macro_rules! defect {
    ($file:literal, $from:literal => $to:literal) => {
        ($from, |path, source| {
            if path != $file {
                return source.to_owned();
            }
            assert!(source.contains($from), "{path} has no {}", $from);
            source.replace($from, $to)
        })
    };
}

#[test]
fn each_planted_defect_takes_the_clouds_out_of_the_budget() {
    let defects: [Defect; 6] = [
        // What is behind the nearest layer is forgotten.
        defect!("composite/clouds.wgsl", "        cloud.transmittance * behind.transmittance," => "        cloud.transmittance,"),
        // Cut off instead of rounded.
        defect!("composite/clouds.wgsl", "bits + 0xfffu + ((bits >> 13u) & 1u)" => "bits"),
        // Another pre-exposure than the header tells.
        defect!("composite/composite.wgsl", "power_of_two_below(world.exposure)" => "world.exposure"),
        // Spectral radiance, which is not white where sunlight is.
        defect!("composite/composite.wgsl", "clouds_pixel(balanced(radiance)," => "clouds_pixel(radiance,"),
        // Haze takes light and gives none.
        defect!("composite/shade.wgsl", "lit * kept + back.air * share * opacity" => "lit * kept"),
        // A background where there should be none.
        defect!("composite/show.wgsl", "    return vec3f(0.0);" => "    return back.air;"),
    ];
    let document = crossing();
    let settings = settings(RendererKind::Cached);
    let camera = outlook(2.0, 40.0, 30.0);
    let mut still = still(&with_layers(document.clone(), json!([])));
    let (bare, _) = both(&mut still, camera, &settings, true);
    still.set_scene(scene(&document)).expect("a scene");
    let (picture, clouds) = both(&mut still, camera, &settings, true);
    assert!(worst_share(&clouds, &bare, &picture).0 <= 1.0);
    for (what, edit) in defects {
        still.plant(Some(edit)).expect("shaders");
        let clouds = alone(&mut still, &settings, true);
        let (share, _) = worst_share(&clouds, &bare, &picture);
        println!("{share:.1} budgets without {what:?}");
        assert!(
            share > 1.5,
            "nobody would see the lack of {what:?}: {share}"
        );
    }
    still.plant(None).expect("shaders");
    let clouds = alone(&mut still, &settings, true);
    assert!(worst_share(&clouds, &bare, &picture).0 <= 1.0);
}

#[test]
fn a_scene_without_clouds_lets_everything_through_whatever_it_lacks() {
    for layers in [
        json!([]),
        json!([{"density": {"model": "weather", "coverage": 0}}]),
    ] {
        let mut still =
            still(&json!({"version": 1, "layers": layers, "wind": {"speed_m_per_s": 0}}));
        let (_, clouds) = both(
            &mut still,
            outlook(2.0, 0.0, 12.0),
            &settings(RendererKind::Cached),
            true,
        );
        for pixel in 0..pixels() {
            assert_eq!(clouds.radiance(pixel), [0.0; 3], "{layers}");
            assert_eq!(
                (clouds.transmittance(pixel), clouds.distance_m(pixel)),
                (1.0, 0.0),
                "{layers}"
            );
        }
    }
}

/// Flat slabs without air, of base, thickness and optical depth.
fn slabs(slabs: &[[f64; 3]]) -> Value {
    let layers = slabs.iter().enumerate().map(|(index, [base_m, thick_m, depth])| {
        json!({"name": format!("slab {index}"), "base_altitude_m": base_m, "top_altitude_m": base_m + thick_m, "extinction_per_m": depth / thick_m,
            "density": {"model": "homogeneous"}})
    });
    json!({"version": 1, "planet": "flat", "atmosphere": {"model": "uniform"}, "sun": {"elevation_deg": 10},
        "layers": layers.collect::<Vec<_>>(), "wind": {"speed_m_per_s": 0}})
}

#[test]
fn two_slabs_have_the_transmittance_and_mean_distance_of_their_closed_form_from_below_and_above() {
    let [low, high] = [[2_000.0, 1_000.0, 0.5], [5_000.0, 1_000.0, 1.0]];
    let mut still = still(&slabs(&[low, high]));
    // Depth of what is seen of a slab of an optical depth, in thicknesses: 1/τ - e^-τ / (1 - e^-τ).
    let seen = |depth: f64| 1.0 / depth - (-depth).exp() / (1.0 - (-depth).exp());
    for (altitude_m, pitch_deg) in [(0.0, 90.0), (8_000.0, -90.0)] {
        let from_below = pitch_deg > 0.0;
        let near_m = |[base_m, thick_m, depth]: [f64; 3]| {
            if from_below {
                base_m + thick_m * seen(depth)
            } else {
                altitude_m - base_m - thick_m + thick_m * seen(depth)
            }
        };
        let (first, second) = if from_below { (low, high) } else { (high, low) };
        let opacity = |[_, _, depth]: [f64; 3]| 1.0 - (-depth).exp();
        let hidden = [opacity(first), (1.0 - opacity(first)) * opacity(second)];
        let exact_m =
            (hidden[0] * near_m(first) + hidden[1] * near_m(second)) / (hidden[0] + hidden[1]);
        let camera = Camera::new([0.0, altitude_m, 0.0], 0.0, pitch_deg, 2.0).expect("a camera");
        for renderer in [RendererKind::Cached, RendererKind::ScreenSpace] {
            let mut settings = settings(renderer);
            settings.march.steps = 128;
            let (_, clouds) = both(&mut still, camera, &settings, true);
            let middle = (size().height() / 2 * size().width() + size().width() / 2) as usize;
            let (through, distance_m) = (
                f64::from(clouds.transmittance(middle)),
                f64::from(clouds.distance_m(middle)),
            );
            println!(
                "{renderer:?} at {altitude_m} m: T {through:.4}, {distance_m:.1} m, exactly {:.4}, {exact_m:.1} m",
                (-1.5f64).exp()
            );
            assert!(
                (through - (-1.5f64).exp()).abs() < 4e-3,
                "{renderer:?}: {through}"
            );
            assert!(
                (distance_m - exact_m).abs() < 4e-3 * exact_m,
                "{renderer:?}: {distance_m}, exactly {exact_m}"
            );
        }
    }
}

#[test]
fn distance_is_that_of_the_distance_view() {
    let mut still = still(&json!({"version": 1, "wind": {"speed_m_per_s": 0}}));
    let camera = outlook(2.0, 0.0, 20.0);
    let of_picture = settings(RendererKind::Cached);
    let of_view = StillSettings {
        show: Show::Distance,
        ..of_picture
    };
    let (_, clouds) = both(&mut still, camera, &of_picture, true);
    let view = still
        .render_with(camera, size(), &of_view, |_| {})
        .expect("a view");
    let mut compared = 0;
    for (pixel, values) in view.linear.chunks_exact(4).enumerate() {
        // Distance times opacity, and transmittance; the view tells nothing of thinner clouds.
        let opacity = 1.0 - f64::from(values[1]);
        if opacity < 0.01 {
            continue;
        }
        compared += 1;
        let (told_m, shown_m) = (
            f64::from(clouds.distance_m(pixel)),
            f64::from(values[0]) / opacity,
        );
        assert!(
            (told_m - shown_m).abs() < 1e-3 * shown_m,
            "pixel {pixel}: {told_m} m, the view has {shown_m} m"
        );
    }
    assert!(compared > 300, "{compared}");
}

#[test]
fn haze_is_in_front_of_clouds_or_left_out_as_asked() {
    let settings = settings(RendererKind::Cached);
    let mean = |clouds: &Clouds| {
        let pixels = pixels();
        let sum = |channel| {
            (0..pixels)
                .map(|pixel| f64::from(clouds.radiance(pixel)[channel]))
                .sum::<f64>()
        };
        [0, 1, 2].map(|channel| sum(channel) / pixels as f64)
    };
    for atmosphere in [json!({}), json!({"model": "physical"})] {
        let document =
            json!({"version": 1, "wind": {"speed_m_per_s": 0}, "atmosphere": atmosphere});
        let mut still = still(&document);
        let (_, hazy) = both(&mut still, outlook(2.0, 0.0, 12.0), &settings, true);
        let clear = alone(&mut still, &settings, false);
        assert!(hazy.header().haze && !clear.header().haze);
        // Haze hides nothing of what is behind clouds that the clouds do not, and moves none of them.
        assert_eq!(hazy.planes()[3..], clear.planes()[3..], "{atmosphere}");
        let [with, without] = [mean(&hazy), mean(&clear)];
        println!("{atmosphere}: mean colour with haze {with:?}, without {without:?}");
        assert!(
            (with[0] - without[0]).abs() > 0.01 * without[0],
            "{atmosphere}: {with:?} {without:?}"
        );
    }
    // Without air there is nothing to leave out.
    let mut still = still(&slabs(&[[2_000.0, 200.0, 1.0]]));
    let (_, hazy) = both(&mut still, outlook(2.0, 0.0, 30.0), &settings, true);
    let clear = alone(&mut still, &settings, false);
    assert_eq!(hazy.planes(), clear.planes());
}

#[test]
fn neither_a_cloud_before_the_sun_nor_the_darkest_exposure_leaves_the_half_floats() {
    // Droplets of 50 µm throw most light straight on; a thin veil of them stands before a sun ten times as bright.
    let veil = json!([{"base_altitude_m": 2000, "top_altitude_m": 2100, "extinction_per_m": 0.003,
        "phase": {"model": "hg-draine", "droplet_diameter_um": 50}, "density": {"model": "homogeneous"}}]);
    let mut at_zero = 0.0;
    for exposure_ev in [0.0, -10.0, 10.0, 30.0, -30.0] {
        let document = json!({"version": 1, "wind": {"speed_m_per_s": 0}, "exposure_ev": exposure_ev, "layers": veil,
            "sun": {"elevation_deg": 30, "azimuth_deg": 90, "irradiance_w_per_m2_nm": [10, 10, 10]}});
        let mut still = still(&document);
        let (_, clouds) = both(
            &mut still,
            outlook(2.0, 90.0, 30.0),
            &settings(RendererKind::Cached),
            true,
        );
        let told = (0..pixels())
            .map(|pixel| clouds.radiance(pixel)[1])
            .fold(0.0, f32::max);
        let pre_exposure = clouds.header().pre_exposure;
        println!("{exposure_ev} EV: pre-exposure {pre_exposure}, brightest {told}");
        if exposure_ev == 0.0 {
            at_zero = told;
        }
        // What a picture would show as white by far is cut at the largest half float, and what it would show as black by far
        // is 0; in between all is there.
        let expected = if exposure_ev == -30.0 {
            told.min(at_zero)
        } else {
            at_zero.min(65_504.0 / pre_exposure)
        };
        assert!(
            (told - expected).abs() <= 1e-3 * expected,
            "{told}, not {expected}"
        );
    }
}

#[test]
fn two_eyes_are_side_by_side_and_equal_where_nothing_is_between_them() {
    let mut still = still(&json!({"version": 1, "wind": {"speed_m_per_s": 0}}));
    let settings = StillSettings {
        stereo: Stereo::new(0.0).ok(),
        ..settings(RendererKind::Cached)
    };
    let (_, pair) = both(&mut still, outlook(2.0, 0.0, 20.0), &settings, true);
    assert_eq!((pair.width(), pair.height()), (128, 36));
    for plane in pair.planes() {
        for row in plane.chunks_exact(128) {
            assert_eq!(row[..64], row[64..]);
        }
    }
}

fn clouds_of(seen: &Seen) -> anyhow::Result<Clouds> {
    let frame = seen.frame()?;
    Ok(skycell_client::clouds_file::clouds_of(
        &frame.header,
        frame.payload(),
    )?)
}

fn is_clouds(seen: &Seen) -> bool {
    let frame = seen.frame.as_ref();
    frame.is_some_and(|frame| frame.header.codec == FrameCodec::Clouds)
}

fn is_fine(seen: &Seen) -> bool {
    is_clouds(seen) && seen.frame.as_ref().is_some_and(|frame| frame.header.exact)
}

fn hello(codec: Codec) -> anyhow::Result<Hello> {
    let camera = skycell_tests::viewer::camera([0.0, 2.0, 0.0], 0.0, 20.0)?;
    Ok(Hello {
        codec,
        ..Hello::new(FrameSize::new(160, 90)?, 30.0, camera)
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn who_asks_for_clouds_alone_shares_the_cell_and_gets_the_same_bits_as_the_next()
-> anyhow::Result<()> {
    let server = Server::start_calm().await?;
    let watcher = Viewer::join_as(&server, hello(Codec::Png)?).await?;
    let alone = total_of(&server.at_rest(1).await?, "texels_updated")?;
    let pipelines = |stats: &Value| {
        ["composite", "fade_pictures"].map(|kernel| stats["device"]["pipelines"][kernel].as_u64())
    };
    let before = pipelines(&server.get("api/v1/stats").await?);

    let first = Viewer::join_as(&server, hello(Codec::Clouds)?).await?;
    let second = Viewer::join_as(&server, hello(Codec::Clouds)?).await?;
    for viewer in [&first, &second] {
        viewer.wait_for("fine clouds", is_fine).await?;
    }
    let stats = server.at_rest(3).await?;
    // Nothing of it was there before somebody asked.
    let after = pipelines(&stats);
    ensure!(
        before[1] == Some(1) && after[1] == Some(2),
        "{before:?} {after:?}"
    );
    ensure!(after[0] > before[0], "{before:?} {after:?}");
    // What one marches all three see.
    let together = total_of(&stats, "texels_updated")?;
    ensure!(together == alone, "{alone} for one, {together} for three");
    let [one, other] = [clouds_of(&first.seen())?, clouds_of(&second.seen())?];
    ensure!(one == other, "two viewers at the same place differ");
    ensure!((one.width(), one.height()) == (160, 90) && one.header().haze);

    // Where clouds hide nothing and give no light, and where they hide all: as the picture has it.
    let picture = decoded(watcher.seen().frame()?)?;
    let pixels = (0..one.planes()[0].len()).map(|pixel| one.transmittance(pixel));
    let (clear, cloudy) = pixels.fold((0, 0), |(clear, cloudy), through| {
        (
            clear + u32::from(through == 1.0),
            cloudy + u32::from(through < 0.1),
        )
    });
    ensure!(
        clear > 1_000 && cloudy > 100,
        "{clear} clear pixels, {cloudy} opaque ones"
    );
    ensure!(picture.dimensions() == (160, 90));

    // A view of something else, which clouds alone are not, is refused in words; the session goes on.
    let odd = ViewChange {
        show: Some(Show::Density),
        ..ViewChange::default()
    };
    first.wish(odd).await?;
    let seen = first
        .wait_for("a complaint", |seen| seen.complaint.is_some())
        .await?;
    let complaint = seen.complaint.context("a complaint")?.message;
    ensure!(
        complaint == "/show is \"density\"; allowed: \"picture\" where codec is \"clouds\"",
        "{complaint}"
    );
    // Without haze there are other colours in the same places.
    let clear = ViewChange {
        haze: Some(false),
        ..ViewChange::default()
    };
    first.wish(clear).await?;
    let without =
        |seen: &Seen| is_fine(seen) && clouds_of(seen).is_ok_and(|clouds| !clouds.header().haze);
    let seen = first.wait_for("clouds without haze", without).await?;
    ensure!(clouds_of(&seen)?.planes()[3..] == one.planes()[3..]);
    // Pictures again.
    let back = ViewChange {
        codec: Some(Codec::Png),
        ..ViewChange::default()
    };
    first.wish(back).await?;
    let is_png = |seen: &Seen| {
        seen.frame
            .as_ref()
            .is_some_and(|f| f.header.codec == FrameCodec::Png && f.header.exact)
    };
    let seen = first.wait_for("a picture", is_png).await?;
    ensure!(
        decoded(seen.frame()?)? == picture,
        "the picture is another one than before"
    );
    ensure!(total_of(&server.at_rest(3).await?, "texels_updated")? == alone);
    for viewer in [watcher, first, second] {
        viewer.close().await;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn rays_of_their_own_make_clouds_alone_too() -> anyhow::Result<()> {
    let server = Server::start_calm().await?;
    let hello = Hello {
        renderer: RendererKind::ScreenSpace,
        ..hello(Codec::Clouds)?
    };
    let viewer = Viewer::join_as(&server, hello).await?;
    viewer.wait_for("clouds", is_clouds).await?;
    let seen = viewer.wait_for("fine clouds", is_fine).await?;
    let clouds = clouds_of(&seen)?;
    let cloudy = (0..clouds.planes()[0].len()).filter(|pixel| clouds.transmittance(*pixel) < 0.5);
    ensure!(cloudy.count() > 100);
    viewer.close().await;
    Ok(())
}
