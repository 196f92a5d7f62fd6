//! What setups of proxies show.

use super::*;
use crate::config::RenderConfig;
use crate::march::{BandEnds, MarchSettings, ProxySetup};
use crate::measure::metrics::shown_errors;
use crate::measure::reference::without_alpha;
use image::RgbImage;
use serde_json::{Value, json};
use skycell_protocol::Scene;
use skycell_shaders::SourceEdit;
use std::path::PathBuf;
use std::sync::Arc;

const SIZE: [u32; 2] = [160, 90];

fn still_of(document: &Value) -> StillRenderer {
    let noise = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/noise-of-tests");
    let config = RenderConfig::new(PathBuf::from(noise));
    let scene = Scene::from_json(document).expect("a scene");
    StillRenderer::new(config, Arc::new(scene), &[]).expect("a device")
}

fn picture(still: &mut StillRenderer, pitch_deg: f64, settings: &StillSettings) -> RgbImage {
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, pitch_deg, 60.0).expect("a camera");
    let size = FrameSize::new(SIZE[0], SIZE[1]).expect("a size");
    let made = still.render_with(camera, size, settings, |_| {});
    let pixels = without_alpha(&made.expect("a picture").display);
    RgbImage::from_raw(SIZE[0], SIZE[1], pixels).expect("a whole picture")
}

fn flip(a: &RgbImage, b: &RgbImage) -> f64 {
    shown_errors(a, b).expect("comparable").flip
}

fn settings(proxies: ProxySetup) -> StillSettings {
    StillSettings {
        proxies,
        march: MarchSettings {
            steps: 32,
            ..MarchSettings::default()
        },
        samples: 4,
        parallax_steps: 0,
        ..StillSettings::default()
    }
}

/// Bands of one layer, from 2 on.
fn nested(bands: u32, band_ends: BandEnds) -> StillSettings {
    StillSettings {
        bands,
        band_ends,
        ..settings(ProxySetup::NestedDomes)
    }
}

#[test]
fn at_the_reference_every_setup_shows_what_spheres_in_the_layers_show() {
    let mut still = still_of(&json!({"version": 1, "wind": {"speed_m_per_s": 0}}));
    let spheres = picture(&mut still, 20.0, &settings(ProxySetup::InLayer));
    for setup in [ProxySetup::StaticDome, ProxySetup::FollowingDome] {
        let apart = flip(&spheres, &picture(&mut still, 20.0, &settings(setup)));
        println!("{setup:?}: {apart:.4}");
        // The same directions.
        assert!(apart < 0.001, "{setup:?}: {apart}");
    }
    for bands in 2..=4 {
        for ends in [BandEnds::Gaps, BandEnds::Cut] {
            let apart = flip(&spheres, &picture(&mut still, 20.0, &nested(bands, ends)));
            println!("{bands} bands, {ends:?}: {apart:.4}");
            // Opacities of bands are interpolated apart.
            assert!(apart < 0.012, "{bands} bands, {ends:?}: {apart}");
        }
    }
}

/// A box of thin cloud 4 km away, where two bands of its layer meet.
fn box_between_bands() -> Value {
    json!({"version": 1, "wind": {"speed_m_per_s": 0}, "layers": [{"name": "box",
        "base_altitude_m": 1_500, "top_altitude_m": 2_504, "extinction_per_m": 0.0012,
        "density": {"model": "homogeneous", "shape": {"form": "box",
            "center_m": [0, 2_000, -3_464], "size_m": [2_400, 700, 2_400]}}}]})
}

const NEAR_ALONE: SourceEdit = |path, source| match path {
    "composite/cached.wgsl" => source.replace(
        "    let kept = front.transmittance;",
        "    if true { return front; }\n    let kept = front.transmittance;",
    ),
    _ => source.to_owned(),
};
const FAR_ALONE: SourceEdit = |path, source| match path {
    "composite/cached.wgsl" => source.replace(
        "    let kept = front.transmittance;",
        "    if true { return back; }\n    let kept = front.transmittance;",
    ),
    _ => source.to_owned(),
};

/// Of the pixels of the box, the share of those whose cloud is not in one of the bands as a whole.
fn sliced(still: &mut StillRenderer, whole: &RgbImage, ends: BandEnds) -> f64 {
    let [near, far] = [NEAR_ALONE, FAR_ALONE].map(|edit| {
        still.plant(Some(edit)).expect("shaders");
        picture(still, 30.0, &nested(2, ends))
    });
    still.plant(None).expect("shaders");
    let (mut of_box, mut in_both) = (0u32, 0u32);
    for (x, y, pixel) in whole.enumerate_pixels() {
        let off = |other: &RgbImage| {
            let pairs = pixel.0.iter().zip(other.get_pixel(x, y).0);
            pairs.map(|(a, b)| a.abs_diff(b)).max().unwrap_or(0)
        };
        let (near, far) = (off(&near), off(&far));
        of_box += u32::from(near.max(far) > 6);
        in_both += u32::from(near.min(far) > 6);
    }
    assert!(of_box > 500, "{of_box} pixels");
    f64::from(in_both) / f64::from(of_box)
}

#[test]
fn bands_that_end_in_gaps_slice_no_cloud() {
    let mut still = still_of(&box_between_bands());
    let whole = picture(&mut still, 30.0, &settings(ProxySetup::StaticDome));
    for ends in [BandEnds::Gaps, BandEnds::Cut] {
        let apart = flip(&whole, &picture(&mut still, 30.0, &nested(2, ends)));
        let share = sliced(&mut still, &whole, ends);
        println!("{ends:?}: FLIP {apart:.4} from the whole, {share:.3} of the box sliced");
        assert!(apart < 0.006, "{ends:?}: {apart}");
        match ends {
            // Where one band takes over from the other, texels of both are between pixels. Measured: .010 and .174.
            BandEnds::Gaps => assert!(share < 0.03, "{share}"),
            BandEnds::Cut => assert!(share > 0.1, "{share}"),
        }
    }
    // A far band that begins in the cloud which the near one goes on with shows a part of it twice, and a near one that does
    // not go on leaves it out.
    let twice: SourceEdit = |path, source| match path {
        "march/march.wgsl" => source.replace(
            "density = select(density, 0.0, distance_m < unlit_to_m);",
            "",
        ),
        _ => source.to_owned(),
    };
    let never: SourceEdit = |path, source| match path {
        "march/march.wgsl" => source.replace(
            "is_clear && distance_m >= part.far_m);",
            "distance_m >= part.far_m);",
        ),
        _ => source.to_owned(),
    };
    for (what, edit) in [("twice", twice), ("never", never)] {
        still.plant(Some(edit)).expect("shaders");
        let apart = flip(
            &whole,
            &picture(&mut still, 30.0, &nested(2, BandEnds::Gaps)),
        );
        println!("{what}: FLIP {apart:.4}");
        assert!(apart > 0.02, "{what}: {apart}");
    }
}

#[test]
fn domes_that_are_cut_into_slabs_are_refused() {
    let mut still = still_of(&json!({"version": 1, "layers": []}));
    let camera = Camera::default();
    let size = FrameSize::new(16, 16).expect("a size");
    let settings = StillSettings {
        slabs: 2,
        ..settings(ProxySetup::StaticDome)
    };
    let refused = still.render_with(camera, size, &settings, |_| {});
    let message = refused.expect_err("refused").to_string();
    assert!(message.contains("2 slabs with static-dome"), "{message}");
}
