//! The cached renderer against the screen-space renderer: same scene, same place, same samples. The measures are someone
//! else's tools: NVIDIA's FLIP and an SSIM crate.

use image::{GrayImage, RgbImage};
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{StillPixels, StillRenderer};
use std::path::PathBuf;
use std::sync::Arc;

const FLIP_GUARD: f32 = 0.0105;
const SSIM_GUARD: f64 = 0.963;

fn renderer(samples: u32, mip_bias: f32) -> StillRenderer {
    let mut config = RenderConfig::new(PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("noise"));
    config.samples = samples;
    config.mip_bias = mip_bias;
    config.cache_memory_mib = 1024;
    StillRenderer::new(config, Arc::new(Scene::default()), &[]).expect("a device that renders")
}

fn picture(still: &mut StillRenderer, size: FrameSize, kind: RendererKind) -> RgbImage {
    let camera = Camera::new([0.0, 2.0, 0.0], 0.0, 25.0, 60.0).expect("a camera");
    let pixels = still
        .render(camera, size, kind, false, |_| {})
        .expect("a picture");
    let StillPixels::Display(bytes) = pixels else {
        panic!("asked for a picture of bytes");
    };
    let rgb = bytes.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]);
    RgbImage::from_raw(size.width(), size.height(), rgb.collect()).expect("whole rows")
}

/// Mean FLIP at its default viewing distance (67 pixels a degree) and SSIM of luma.
fn flip_and_ssim(reference: &RgbImage, test: &RgbImage) -> (f32, f64) {
    let flip_image = |image: &RgbImage| {
        nv_flip::FlipImageRgb8::with_data(image.width(), image.height(), image.as_raw())
    };
    let error = nv_flip::flip(
        flip_image(reference),
        flip_image(test),
        nv_flip::DEFAULT_PIXELS_PER_DEGREE,
    );
    let flip = nv_flip::FlipPool::from_image(&error).mean();
    let luma = |image: &RgbImage| -> GrayImage {
        image::DynamicImage::ImageRgb8(image.clone()).to_luma8()
    };
    let ssim = image_compare::gray_similarity_structure(
        &image_compare::Algorithm::MSSIMSimple,
        &luma(reference),
        &luma(test),
    )
    .expect("images of one size");
    (flip, ssim.score)
}

fn compare(samples: u32, mip_biases: &[f32]) -> Vec<(f32, f64)> {
    let size = FrameSize::new(1280, 720).expect("a size");
    let mut screen = renderer(samples, 0.0);
    let reference = picture(&mut screen, size, RendererKind::ScreenSpace);
    drop(screen);
    mip_biases
        .iter()
        .map(|bias| {
            let mut cached = renderer(samples, *bias);
            let test = picture(&mut cached, size, RendererKind::Cached);
            let (flip, ssim) = flip_and_ssim(&reference, &test);
            let texels = cached.totals().texels_updated;
            println!(
                "1280x720, {samples} samples, mip bias {bias}: FLIP {flip:.4}, SSIM {ssim:.4}, {texels} texel updates"
            );
            (flip, ssim)
        })
        .collect()
}

/// The bound is a guard against getting worse, a tenth above what is measured (README, "Figures"). It is not the goal:
/// Weinrauch et al. 2023 publish FLIP .0059 and SSIM .9980 in the first column of their table 1.
#[test]
fn the_cached_sky_is_no_farther_from_the_screen_space_sky_than_measured() {
    let (flip, ssim) = compare(8, &[0.0])[0];
    assert!(flip <= FLIP_GUARD, "FLIP {flip}");
    assert!(ssim >= SSIM_GUARD, "SSIM {ssim}");
}

/// Mip biases 1 to 3 for the report; each coarser cache must be worse, else the bias does nothing.
#[test]
#[ignore = "slower suite: deploy/test --full"]
fn each_step_of_mip_bias_costs_accuracy() {
    let measured = compare(8, &[0.0, 1.0, 2.0, 3.0]);
    for pair in measured.windows(2) {
        assert!(
            pair[1].0 > pair[0].0 && pair[1].1 < pair[0].1,
            "{measured:?}"
        );
    }
}
