//! Viewers at one place by bookkeeping alone: the texels that they ask for, beside the rays of screen-space pictures, and the
//! memory that they take. No device.

use super::views::RingSetup;
use crate::cache::{
    BYTES_PER_TEXEL, ProxySphere, SphereCache, TEXELS_PER_TILE, TexelSamples, TileKey, Wish,
    coarse_tiles, requested_tiles, seen_blocks,
};
use crate::composite::view_frustum;
use crate::march::{CellFrame, Surface, active_layers};
use glam::DVec3;
use serde::Serialize;
use skycell_protocol::{FrameSize, Scene};
use std::collections::BTreeMap;

/// Texels of a block that may be marched or not.
const TEXELS_PER_BLOCK: u64 = 64;
/// Bytes of a tile.
const TILE_BYTES: u64 = TEXELS_PER_TILE * BYTES_PER_TEXEL;
/// Rows and columns of a picture that are looked at for how much of it is sky.
const LOOKS: u32 = 64;

/// What a ring asks for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RingCount {
    /// At one place.
    pub viewers: u32,
    /// Width of each picture, degrees.
    pub across_deg: f64,
    /// Share of the field of view that neighbours have in common, 0 to 1.
    pub overlap: f64,
    /// Halvings of the cache's resolution below the screen's.
    pub mip_bias: f32,
    /// Of each picture.
    pub size: FrameSize,
    /// Tiles that somebody asks for, each once.
    pub tiles: u64,
    /// Tiles of the coarse level that nobody asks for.
    pub tiles_coarse: u64,
    /// Texels of these tiles for each pixel of all pictures.
    pub texels_per_pixel: f64,
    /// Their samples for each sample of a pixel, where texels that make a pixel together have them by area.
    pub samples_per_pixel: f64,
    /// Those of them in blocks of 8 × 8 that somebody sees or reads beside that.
    pub seen_per_pixel: f64,
    /// Share of the pictures above the horizon: a ray below it finds nothing and costs nothing.
    pub sky_share: f64,
    /// Memory of all tiles, with the coarse level, bytes.
    pub bytes: u64,
    /// The same where a budget takes a level away.
    pub bytes_with_a_level_lost: u64,
}

/// Counts what a ring of pictures `across_deg` wide asks for under a scene, each layer whole.
///
/// # Errors
/// When there are no such cameras.
pub fn count(setup: &RingSetup, across_deg: f64, scene: &Scene) -> anyhow::Result<RingCount> {
    let cameras = setup.cameras_across(across_deg)?;
    let active = active_layers(scene);
    let eye_m = cameras
        .first()
        .map_or(DVec3::ZERO, |camera| DVec3::from_array(camera.position_m()));
    let frame = CellFrame::at(eye_m, scene.planet().radius_m());
    let at = frame.from_world(eye_m);
    let spheres: Vec<ProxySphere> = active
        .iter()
        .map(|layer| ProxySphere {
            frame,
            anchor: at,
            surface: Surface::Shell {
                altitude_m: layer.proxy_altitude_m,
            },
            reference: at,
            seen_between_m: None,
            top_m: None,
            band: None,
        })
        .collect();
    let by_area = TexelSamples::new(setup.samples, true);
    let pixels = u64::from(setup.size.pixels());
    let (mut tiles, mut tiles_coarse, mut blocks, mut samples) = (0, 0, 0, 0);
    let mut wish = Wish::default();
    for sphere in &spheres {
        let mut seen: BTreeMap<TileKey, u64> = BTreeMap::new();
        let mut requests = Vec::new();
        for camera in &cameras {
            let view = view_frustum(camera, setup.size, &frame);
            let asked = requested_tiles(&view, sphere, f64::from(setup.mip_bias));
            for request in &asked {
                *seen.entry(request.key).or_default() |= seen_blocks(&view, sphere, request.key);
            }
            requests.push(asked);
        }
        let coarse = coarse_tiles(sphere, at);
        wish.add(&coarse, &requests.concat());
        let mut cache = SphereCache::default();
        cache.set_wanted(&coarse, requests.iter().flatten());
        let viewers = (requests.iter()).map(|asked| (asked.iter().map(|r| r.texel_pixels), pixels));
        let fitting = by_area.fitting(viewers);
        samples += cache.wanted_samples(fitting) - cache.coarse_only();
        let beside = coarse.iter().filter(|tile| !seen.contains_key(&tile.key));
        tiles += seen.len() as u64;
        tiles_coarse += beside.count() as u64;
        blocks += seen
            .values()
            .map(|mask| u64::from(mask.count_ones()))
            .sum::<u64>();
    }
    let pixels = f64::from(setup.viewers) * pixels as f64;
    let mut sky = 0;
    let views = cameras.iter().map(|c| view_frustum(c, setup.size, &frame));
    for view in views {
        for place in 0..LOOKS * LOOKS {
            let share = |index: u32| (f64::from(index) + 0.5) / f64::from(LOOKS) * 2.0 - 1.0;
            let (x, y) = (share(place % LOOKS), share(place / LOOKS));
            let ray = (view.forward + x * view.right + y * view.up).normalize_or_zero();
            let sees = |sphere: &ProxySphere| sphere.may_show(view.position, ray);
            sky += u64::from(spheres.iter().any(sees));
        }
    }
    Ok(RingCount {
        viewers: setup.viewers,
        across_deg,
        overlap: setup.overlap,
        mip_bias: setup.mip_bias,
        size: setup.size,
        tiles,
        tiles_coarse,
        texels_per_pixel: (tiles * TEXELS_PER_TILE) as f64 / pixels,
        samples_per_pixel: (samples * TEXELS_PER_TILE) as f64 / (pixels * f64::from(setup.samples)),
        seen_per_pixel: (blocks * TEXELS_PER_BLOCK) as f64 / pixels,
        sky_share: sky as f64 / f64::from(LOOKS * LOOKS) / f64::from(setup.viewers),
        bytes: wish.tiles(0) * TILE_BYTES,
        bytes_with_a_level_lost: wish.tiles(1) * TILE_BYTES,
    })
}

/// For people.
#[must_use]
pub fn table(counts: &[RingCount]) -> String {
    let mut text = String::from(
        "                                                 texels           samples  seen blocks alone  memory, MB\n\
         picture    bias  viewers  across  overlap  tiles  a pixel  of sky  by area  a pixel  of sky    all  a level lost\n",
    );
    for count in counts {
        text.push_str(&format!(
            "{:<9}  {:>4}  {:>7}  {:>5.1}°  {:>5.0} %  {:>5}  {:>7.2}  {:>6.2}  {:>7.2}  {:>7.2}  {:>6.2}  {:>5.1}  {:>12.1}\n",
            format!("{}x{}", count.size.width(), count.size.height()),
            count.mip_bias,
            count.viewers,
            count.across_deg,
            count.overlap * 100.0,
            count.tiles,
            count.texels_per_pixel,
            count.texels_per_pixel / count.sky_share,
            count.samples_per_pixel,
            count.seen_per_pixel,
            count.seen_per_pixel / count.sky_share,
            count.bytes as f64 / 1e6,
            count.bytes_with_a_level_lost as f64 / 1e6,
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(ring: (u32, f64, f64), mip_bias: f32, size: [u32; 2]) -> RingCount {
        let scene = Scene::from_json(&serde_json::json!({"version": 1})).expect("a scene");
        let (viewers, across_deg, overlap) = ring;
        let setup = RingSetup {
            viewers,
            overlap,
            mip_bias,
            size: FrameSize::new(size[0], size[1]).expect("a size"),
            steps: 64,
            samples: 8,
            samples_by_area: false,
        };
        let count = count(&setup, across_deg, &scene).expect("cameras");
        println!("{}", table(&[count]));
        count
    }

    #[test]
    fn sixteen_viewers_at_1080p_fit_into_160_mb_by_long_lenses_with_a_level_lost() {
        let usual = counted((16, 90.0, 0.4), 1.0, [1920, 1080]);
        assert!(usual.bytes < 160_000_000, "{usual:?}");
        let long = counted((16, 22.5, 0.4), 1.0, [1920, 1080]);
        assert!(long.bytes_with_a_level_lost < 160_000_000, "{long:?}");
    }

    #[test]
    fn at_a_mip_bias_of_1_large_pictures_that_share_nothing_take_less_than_a_texel_a_pixel() {
        for size in [[1280, 720], [1920, 1080]] {
            let count = counted((1, 90.0, 0.0), 1.0, size);
            assert!(count.texels_per_pixel <= 1.05, "{count:?}");
        }
    }

    #[test]
    fn what_is_seen_is_less_than_whole_tiles_and_no_less_than_the_picture() {
        for size in [[320, 180], [1280, 720]] {
            let count = counted((1, 90.0, 0.0), 0.0, size);
            assert!(count.seen_per_pixel < count.texels_per_pixel);
            // Texels are at most 0.8 pixels wide.
            let least = count.sky_share / (0.8 * 0.8);
            assert!(count.seen_per_pixel > least, "{count:?}");
        }
    }

    #[test]
    fn by_area_pictures_that_share_nothing_take_no_more_samples_than_screen_space_by_any_lens() {
        for size in [[320, 180], [640, 360], [1280, 720], [1920, 1080]] {
            for mip_bias in [0.0, 0.5, 1.0, 2.0] {
                for across_deg in [22.5, 27.0, 45.0, 60.0, 90.0, 110.0] {
                    let count = counted((1, across_deg, 0.0), mip_bias, size);
                    // 30 whole tiles for the pixels of 14: half of the samples are kept, and are a little more.
                    let is_small = size == [320, 180] && mip_bias == 1.0 && across_deg <= 45.0;
                    let most = if is_small { 1.07 } else { 1.05 };
                    assert!(count.samples_per_pixel <= most, "{count:?}");
                }
            }
        }
    }
}
