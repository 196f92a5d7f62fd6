//! The cached renderer against the screen-space renderer: same scene, same place, same samples.

use image::RgbImage;
use image::imageops::{FilterType, resize};
use skycell_protocol::{FrameSize, RendererKind};
use skycell_tests::accuracy::{Distance, Recipe, distance, picture};

/// The first column of table 1 in Weinrauch et al., "Clouds in the Cloud", 2023.
const FLIP_MAX: f64 = 0.0059;
/// The same column.
const SSIM_MIN: f64 = 0.998;

/// A cache against the screen-space renderer.
struct Compared {
    bias: f32,
    /// Texel updates for each of its rays.
    updates_per_ray: f64,
    apart: Distance,
    /// The screen-space picture itself through an ideal filter at the cache's resolution.
    filtered: Distance,
}

/// A picture that has been made smaller by a power of two and larger again, both by a filter close to the ideal one.
fn through_fewer_pixels(picture: &RgbImage, mip_bias: f32) -> RgbImage {
    let (width, height) = picture.dimensions();
    let fewer = |pixels: u32| ((pixels as f32 / mip_bias.exp2()).round() as u32).max(1);
    let small = resize(picture, fewer(width), fewer(height), FilterType::Lanczos3);
    resize(&small, width, height, FilterType::Lanczos3)
}

/// Caches of mip biases, with 8 samples of a texel or by area, against the screen-space renderer with 8 of a pixel.
fn compare(size: [u32; 2], caches: &[(f32, bool)]) -> anyhow::Result<Vec<Compared>> {
    let size = FrameSize::new(size[0], size[1])?;
    let screen = Recipe::screen_space();
    let (reference, _) = picture(screen, size)?;
    caches
        .iter()
        .map(|&(bias, samples_by_area)| {
            let cached = Recipe {
                renderer: RendererKind::Cached,
                mip_bias: bias,
                samples_by_area,
                ..screen
            };
            let (test, texels) = picture(cached, size)?;
            let apart = distance(&reference, &test)?;
            let filtered = distance(&reference, &through_fewer_pixels(&reference, bias))?;
            let rays = u64::from(size.pixels()) * u64::from(screen.samples);
            let updates_per_ray = texels as f64 / rays as f64;
            println!(
                "mip bias {bias}{}: {apart:?}, {texels} texel updates, {updates_per_ray:.3} of the screen-space renderer's rays; \
                 an ideal filter at that resolution: {filtered:?}",
                if samples_by_area { ", samples by area" } else { "" },
            );
            Ok(Compared {
                bias,
                updates_per_ray,
                apart,
                filtered,
            })
        })
        .collect()
}

#[test]
fn the_cached_sky_is_as_close_to_the_screen_space_sky_as_published() -> anyhow::Result<()> {
    let [each, by_area] = &compare([1280, 720], &[(0.0, false), (0.0, true)])?[..] else {
        anyhow::bail!("two caches were asked for");
    };
    for Compared { apart, .. } in [each, by_area] {
        assert!(apart.flip <= FLIP_MAX, "{apart:?}");
        assert!(apart.ssim >= SSIM_MIN, "{apart:?}");
    }
    // Texels are half a pixel wide; the coarse level comes on top.
    assert!(
        by_area.updates_per_ray < 0.4 * each.updates_per_ray,
        "{} {}",
        by_area.updates_per_ray,
        each.updates_per_ray
    );
    Ok(())
}

/// At 1920×1080. Each coarser cache must be worse, else the bias does nothing; none may be far behind what its number of texels
/// can show at all. With samples by area one viewer alone, looking at nearly nothing but sky, costs no more than its own rays would.
#[test]
#[ignore = "slower suite: deploy/test --full"]
fn each_step_of_mip_bias_costs_accuracy() -> anyhow::Result<()> {
    let caches = [0.0, 1.0, 2.0, 3.0].map(|bias| (bias, false));
    let by_area = [0.0, 1.0].map(|bias| (bias, true));
    for (found, flip_max) in compare([1920, 1080], &by_area)?
        .iter()
        .zip([FLIP_MAX, 0.0088])
    {
        assert!(found.updates_per_ray <= 1.05, "{}", found.updates_per_ray);
        assert!(found.apart.flip <= flip_max, "{:?}", found.apart);
    }
    let measured = compare([1920, 1080], &caches)?;
    for pair in measured.windows(2) {
        let [finer, coarser] = [pair[0].apart, pair[1].apart];
        assert!(
            coarser.flip > finer.flip && coarser.ssim < finer.ssim,
            "{finer:?} {coarser:?}"
        );
    }
    for (found, most) in measured.iter().zip([0.0040, 0.0088, 0.0138]) {
        assert!(found.apart.flip <= most, "{:?}", found.apart);
    }
    for found in measured.iter().filter(|found| found.bias >= 1.0) {
        assert!(
            found.apart.flip <= 1.5 * found.filtered.flip,
            "{:?} {:?}",
            found.apart,
            found.filtered
        );
    }
    Ok(())
}
