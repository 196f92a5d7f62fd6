//! Views of one quantity instead of the picture: against closed forms, against the picture that they are parts of, and that
//! one that says nothing is refused in words.

use serde_json::{Value, json};
use skycell_protocol::message::Hello;
use skycell_protocol::show::{DISTANCE_HIGH_M, DISTANCE_LOW_M};
use skycell_protocol::{Camera, Codec, FrameSize, RendererKind, Scene, Show};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{StillPicture, StillRenderer, StillSettings};
use skycell_server::march::MarchSettings;
use skycell_tests::picture::decoded;
use skycell_tests::server::target_dir;
use skycell_tests::{Server, Viewer};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Matplotlib's viridis at eight places of its table, sRGB.
const VIRIDIS: [(f64, [u8; 3]); 5] = [
    (0.0, [68, 1, 84]),
    (0.25, [59, 82, 139]),
    (0.5, [33, 145, 140]),
    (0.75, [94, 201, 98]),
    (1.0, [253, 231, 37]),
];
const NOTHING: [u8; 3] = [33, 33, 36];

fn still(document: &Value) -> StillRenderer {
    let scene = Scene::from_json(document).expect("a valid document");
    let noise = target_dir().expect("a folder").join("noise-of-tests");
    StillRenderer::new(RenderConfig::new(noise), Arc::new(scene), &[]).expect("a device")
}

fn settings(show: Show, renderer: RendererKind) -> StillSettings {
    StillSettings {
        show,
        renderer,
        samples: 2,
        march: MarchSettings {
            steps: 32,
            ..MarchSettings::default()
        },
        ..StillSettings::default()
    }
}

fn looking_up(still: &mut StillRenderer, show: Show, renderer: RendererKind) -> StillPicture {
    let camera = Camera::new([0.0, 0.0, 0.0], 0.0, 90.0, 20.0).expect("a camera");
    let size = FrameSize::new(32, 32).expect("a size");
    still
        .render_with(camera, size, &settings(show, renderer), |_| {})
        .expect("a picture")
}

/// The pixel in the middle.
fn middle(picture: &StillPicture) -> [u8; 3] {
    let (width, height) = (
        picture.size.width() as usize,
        picture.size.height() as usize,
    );
    let at = 4 * (height / 2 * width + width / 2);
    [0, 1, 2].map(|c| picture.display[at + c])
}

/// A share of the scale whose colour is nearest, by the table's places mixed linearly.
fn share_of(colour: [u8; 3]) -> f64 {
    let mut best = (f64::INFINITY, 0.0);
    for index in 0..=400 {
        let share = f64::from(index) / 400.0;
        let place = (share * 4.0).min(3.999) as usize;
        let (from, low) = VIRIDIS[place];
        let (_, high) = VIRIDIS[place + 1];
        let part = (share - from) * 4.0;
        let difference: f64 = (0..3)
            .map(|c| {
                let mixed = f64::from(low[c]) * (1.0 - part) + f64::from(high[c]) * part;
                (mixed - f64::from(colour[c])).powi(2)
            })
            .sum();
        if difference < best.0 {
            best = (difference, share);
        }
    }
    best.1
}

/// A flat slab of optical depth 1 between 2000 and 2200 m, without air.
fn slab() -> Value {
    json!({
        "version": 1, "planet": "flat",
        "atmosphere": {"model": "uniform"},
        "sun": {"elevation_deg": 10},
        "layers": [{"base_altitude_m": 2000, "top_altitude_m": 2200, "extinction_per_m": 0.005,
            "density": {"model": "homogeneous"}}],
        "wind": {"speed_m_per_s": 0}
    })
}

#[test]
fn a_slab_has_the_transmittance_and_distance_of_its_closed_form_in_both_renderers() {
    let mut still = still(&slab());
    for renderer in [RendererKind::Cached, RendererKind::ScreenSpace] {
        let shown = share_of(middle(&looking_up(
            &mut still,
            Show::Transmittance,
            renderer,
        )));
        let exact = (-1.0f64).exp();
        assert!(
            (shown - exact).abs() < 0.03,
            "{renderer:?}: {shown}, exactly {exact}"
        );

        // The mean of the depth in a slab of optical depth 1: (1 - 2/e) / (1 - 1/e) of its thickness.
        let depth = (1.0 - 2.0 * exact) / (1.0 - exact);
        let distance_m: f64 = 2000.0 + 200.0 * depth;
        let exact = (distance_m / DISTANCE_LOW_M).ln() / (DISTANCE_HIGH_M / DISTANCE_LOW_M).ln();
        let shown = share_of(middle(&looking_up(&mut still, Show::Distance, renderer)));
        assert!(
            (shown - exact).abs() < 0.03,
            "{renderer:?}: {shown}, exactly {exact}"
        );
    }
}

#[test]
fn the_parts_of_the_light_add_up_to_the_picture() {
    let mut document = slab();
    // Light of the sky, too, so that the ambient part is something; its own background is taken away again.
    document["atmosphere"]["radiance_w_per_m2_nm_sr"] = json!([0.02, 0.03, 0.05]);
    let mut still = still(&document);
    for renderer in [RendererKind::Cached, RendererKind::ScreenSpace] {
        let mut mean = |show| -> [f64; 3] {
            let picture = looking_up(&mut still, show, renderer);
            let pixels = picture.linear.len() as f64 / 4.0;
            [0, 1, 2].map(|c| {
                let channel = picture.linear.iter().skip(c).step_by(4);
                channel.map(|value| f64::from(*value)).sum::<f64>() / pixels
            })
        };
        let whole = mean(Show::Picture);
        let parts = [Show::Single, Show::Multiple, Show::Ambient].map(&mut mean);
        // x: distance, y: transmittance.
        let transmittance = mean(Show::Transmittance)[1];
        for (c, background) in [0.02, 0.03, 0.05].into_iter().enumerate() {
            let sum: f64 = parts.iter().map(|part| part[c]).sum();
            let exact = whole[c] - background * transmittance;
            assert!(
                (sum - exact).abs() < 2e-3 * whole[c] && parts.iter().all(|part| part[c] > 0.0),
                "{renderer:?}: {parts:?} are {sum} together, not {exact}"
            );
        }
        // The phase of droplets looks away from the sun here; an even one gives more.
        assert!(mean(Show::PhaseOff)[0] > whole[0], "{renderer:?}");
    }
}

#[test]
fn the_field_of_a_filled_slab_is_one_where_it_is_and_nothing_beside_it() {
    let mut still = still(&slab());
    for show in [Show::Density, Show::Profile, Show::DensityAbove] {
        let picture = looking_up(&mut still, show, RendererKind::Cached);
        assert!(
            share_of(middle(&picture)) > 0.97,
            "{show:?}: {:?}",
            middle(&picture)
        );
    }
    // The section's upper rows are in the slab, which is the highest, its lower ones below it.
    let section = looking_up(&mut still, Show::DensitySection, RendererKind::Cached);
    let rgb = |row: usize| [0, 1, 2].map(|c| section.display[4 * (row * 32 + 5) + c]);
    assert!(
        share_of(rgb(0)) > 0.97 && rgb(20) == NOTHING,
        "{:?} {:?}",
        rgb(0),
        rgb(20)
    );
    // A layer without maps has no type.
    let picture = looking_up(&mut still, Show::Type, RendererKind::Cached);
    assert_eq!(middle(&picture), NOTHING);
    let steps = looking_up(&mut still, Show::Steps, RendererKind::ScreenSpace);
    let shown = share_of(middle(&steps)) * 256.0;
    // Steps are a 64th of the distance here: ln(2200 / 2000) · 64 = 6.1 of them.
    assert!((2.0..14.0).contains(&shown), "{shown} steps");
}

#[test]
fn a_sky_of_maps_has_a_picture_of_every_quantity() {
    let mut still = still(&json!({"version": 1, "wind": {"speed_m_per_s": 0}}));
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0).expect("a camera");
    let size = FrameSize::new(64, 36).expect("a size");
    for (name, show) in Show::ALL {
        if show == Show::CacheAge {
            // A single picture's texels are all of the same age.
            continue;
        }
        let picture = still
            .render_with(camera, size, &settings(show, RendererKind::Cached), |_| {})
            .expect("a picture");
        let colours: BTreeSet<[u8; 3]> = picture
            .display
            .chunks_exact(4)
            .map(|p| [p[0], p[1], p[2]])
            .collect();
        let least = if show == Show::CacheMip { 1 } else { 8 };
        assert!(colours.len() >= least, "{name}: {} colours", colours.len());
    }
}

#[test]
fn a_view_of_the_cache_without_a_cache_is_refused_in_words() {
    let mut still = still(&slab());
    let camera = Camera::new([0.0, 0.0, 0.0], 0.0, 90.0, 20.0).expect("a camera");
    let size = FrameSize::new(8, 8).expect("a size");
    for show in [Show::CacheMip, Show::CacheAge] {
        let refused = still
            .render_with(
                camera,
                size,
                &settings(show, RendererKind::ScreenSpace),
                |_| {},
            )
            .expect_err("there is no cache")
            .to_string();
        assert!(
            refused.contains(show.name()) && refused.contains("screen-space"),
            "{refused}"
        );
    }
}

#[test]
fn exposure_that_follows_the_sky_shows_a_dim_sun_and_a_bright_one_alike_within_its_bounds() {
    let brightness = |share: f64, auto: Value| {
        let irradiance = [1.474, 1.8504, 1.91198].map(|value| value * share);
        let mut still = still(&json!({
            "version": 1, "sun": {"irradiance_w_per_m2_nm": irradiance}, "wind": {"speed_m_per_s": 0},
            "tone": {"auto_exposure": auto}
        }));
        let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0).expect("a camera");
        let size = FrameSize::new(64, 36).expect("a size");
        let picture = still
            .render_with(
                camera,
                size,
                &settings(Show::Picture, RendererKind::Cached),
                |_| {},
            )
            .expect("a picture");
        picture
            .display
            .iter()
            .map(|byte| f64::from(*byte))
            .sum::<f64>()
            / picture.display.len() as f64
    };
    let by_hand = brightness(1.0, Value::Null);
    let auto = brightness(1.0, json!({}));
    println!("by hand {by_hand:.1}, automatic {auto:.1}");
    assert!(
        (by_hand - auto).abs() < 12.0,
        "the default is its own middle: {by_hand} {auto}"
    );
    let dim = brightness(1.0 / 16.0, json!({}));
    assert!((dim - auto).abs() < 2.0, "{dim} instead of {auto}");
    let bounded = brightness(1.0 / 16.0, json!({"max_ev": 1}));
    assert!(
        bounded < dim - 20.0,
        "{bounded} although only one stop is allowed"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_is_shown_what_it_asks_for_and_told_where_that_says_nothing() -> anyhow::Result<()>
{
    let server = Server::start_calm().await?;
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0)?;
    let size = FrameSize::new(64, 36)?;
    let asks = |show, renderer| Hello {
        show,
        renderer,
        codec: Codec::Png,
        ..Hello::new(size, 30.0, camera)
    };
    // The light end of the scale, which no sky has: clear sky lets everything through.
    let is_shown = |seen: &skycell_tests::Seen| {
        let picture = seen.frame.as_ref().and_then(|frame| decoded(frame).ok());
        picture.is_some_and(|picture| {
            let mut pixels = picture.pixels();
            pixels.any(|pixel| pixel.0[0] > 220 && pixel.0[1] > 200 && pixel.0[2] < 90)
        })
    };
    let viewer = Viewer::join_as(&server, asks(Show::Transmittance, RendererKind::Cached)).await?;
    viewer.wait_for("its view", is_shown).await?;
    viewer.close().await;

    let viewer = Viewer::join_as(&server, asks(Show::CacheMip, RendererKind::ScreenSpace)).await?;
    let told = |seen: &skycell_tests::Seen| {
        let note = seen
            .status
            .as_ref()
            .and_then(|status| status.show_note.as_ref());
        note.is_some_and(|note| note.contains("rays of its own"))
    };
    viewer.wait_for("a note", told).await?;
    viewer.close().await;
    Ok(())
}
