//! Whether the clear sky at dusk has bands, once it is eight bits and once it is a JPEG as well.

use image::RgbImage;
use serde_json::json;
use skycell_protocol::{Camera, Codec, FrameSize, Scene};
use skycell_server::config::RenderConfig;
use skycell_server::encode::encode_after;
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use skycell_tests::picture::without_alpha;
use std::sync::Arc;

const SIZE: [u32; 2] = [512, 288];
/// How closely a picture is looked at.
#[derive(Clone, Copy)]
struct Look {
    /// Vertical field of view.
    fov_deg: f64,
    /// Columns whose rows are averaged: wide enough to average the dither away, narrow enough that bands do not lean.
    columns: u32,
    /// Rows to either side of those through which a parabola is laid: a band is an edge that it cannot follow.
    reach: i32,
}

/// At pixels.
const NEAR: Look = Look {
    fov_deg: 30.0,
    columns: 32,
    reach: 10,
};
/// At squares of 8 × 8 pixels, of which it takes as many to average the dither away: through a longer lens, where bands are
/// broad and lean little.
const FAR: Look = Look {
    fov_deg: 7.0,
    columns: SIZE[0],
    reach: 32,
};
/// What of an 8-bit step the mean of a row may leave the curve around it by, root of the mean square. A staircase of whole
/// steps leaves it by 1/√12 = 0.29. A step is 1 % of the luminance of a mid grey, and eyes tell 0.4 % apart at best.
const BAND_STEPS: f64 = 0.12;

/// Least-squares parabola through values at -reach…reach without the middle's own, at the middle.
fn around(values: &[f64], at: usize, reach: i32) -> f64 {
    // Of the symmetric window: a + c x², odd powers drop out in the middle.
    let (mut n, mut x2, mut x4, mut y, mut yx2) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for offset in -reach..=reach {
        if offset == 0 {
            continue;
        }
        let square = f64::from(offset * offset);
        let value = values[(at as i32 + offset) as usize];
        n += 1.0;
        x2 += square;
        x4 += square * square;
        y += value;
        yx2 += value * square;
    }
    (y * x4 - yx2 * x2) / (n * x4 - x2 * x2)
}

/// Qualities of a JPEG.
const QUALITIES: [u8; 2] = [90, 80];

/// Weights of red, green and blue in what is compared.
type Weights = [f64; 3];
const COLOURS: [Weights; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// JPEG's luma (JFIF, after ITU-R BT.601), which eyes see the finest steps of.
const LUMA: [Weights; 1] = [[0.299, 0.587, 0.114]];

/// Root of the mean square by which row means of blocks of columns leave the curve around them, in 8-bit steps; the worst of
/// the mixes of colours.
fn bands_of(picture: &RgbImage, look: Look, mixes: &[Weights]) -> f64 {
    let Look { columns, reach, .. } = look;
    let (width, height) = picture.dimensions();
    let mut worst: f64 = 0.0;
    for mix in mixes {
        let (mut sum, mut count) = (0.0, 0.0);
        for block in 0..width / columns {
            let rows: Vec<f64> = (0..height)
                .map(|y| {
                    let row = (block * columns..(block + 1) * columns).map(|x| {
                        let pixel = picture.get_pixel(x, y).0;
                        (0..3).map(|i| mix[i] * f64::from(pixel[i])).sum::<f64>()
                    });
                    row.sum::<f64>() / f64::from(columns)
                })
                .collect();
            for at in reach as usize..rows.len() - reach as usize {
                sum += (rows[at] - around(&rows, at, reach)).powi(2);
                count += 1.0;
            }
        }
        worst = worst.max(f64::sqrt(sum / count));
    }
    worst
}

/// As a viewer gets it.
fn as_jpeg(picture: &RgbImage, quality: u8) -> RgbImage {
    let rgba: Vec<u8> = picture
        .pixels()
        .flat_map(|p| [p.0[0], p.0[1], p.0[2], 255])
        .collect();
    let size = FrameSize::new(SIZE[0], SIZE[1]).expect("a size");
    let mut bytes = Vec::new();
    encode_after(&mut bytes, &rgba, size, Codec::Jpeg, quality).expect("a picture");
    image::load_from_memory(&bytes)
        .expect("a picture")
        .to_rgb8()
}

/// No dither before the value is rounded.
fn undithered(path: &str, source: &str) -> String {
    if path == "composite/tone.wgsl" {
        source.replace("noise / 255.0", "0.0 * noise")
    } else {
        source.to_owned()
    }
}

fn scene(elevation_deg: f64, exposure_ev: f64) -> Arc<Scene> {
    let document = json!({"version": 1, "layers": [], "atmosphere": {"model": "physical"},
        "exposure_ev": exposure_ev, "sun": {"elevation_deg": elevation_deg, "azimuth_deg": 90}});
    Arc::new(Scene::from_json(&document).expect("a scene"))
}

#[test]
fn the_clear_sky_at_dusk_has_no_bands_in_eight_bits() {
    let config = RenderConfig::new(std::env::temp_dir().join("skycell-noise"));
    let mut still = StillRenderer::new(config, scene(40.0, 0.0), &[]).expect("a device");
    let size = FrameSize::new(SIZE[0], SIZE[1]).expect("a size");
    for (elevation_deg, exposure_ev) in [(2.0, 2.0), (-3.0, 6.0)] {
        still
            .set_scene(scene(elevation_deg, exposure_ev))
            .expect("a scene");
        let mut look = |edit: Option<skycell_shaders::SourceEdit>, codec: Codec, look: Look| {
            // Away from the sun, where the sky changes least over a pixel.
            let camera = Camera::new([0.0, 2.0, 0.0], 270.0, 24.0, look.fov_deg).expect("a camera");
            still.plant(edit).expect("a shader");
            let settings = StillSettings {
                codec,
                ..StillSettings::default()
            };
            let picture = still
                .render_with(camera, size, &settings, |_| {})
                .expect("a picture");
            without_alpha(&picture.display, size).expect("as many pixels")
        };
        let plain = look(Some(undithered), Codec::Png, NEAR);
        let dithered = look(None, Codec::Png, NEAR);
        let of = |picture| bands_of(picture, NEAR, &COLOURS);
        let (without, with) = (of(&plain), of(&dithered));
        println!("sun {elevation_deg}°: {without:.3} of a step without dither, {with:.3} with it");
        // The measure tells bands from none.
        assert!(without > 2.0 * BAND_STEPS, "{without}");
        assert!(with < BAND_STEPS, "{with}");

        let plain = look(Some(undithered), Codec::Jpeg, FAR);
        let in_pixels = look(None, Codec::Png, FAR);
        let in_squares = look(None, Codec::Jpeg, FAR);
        for quality in QUALITIES {
            let of = |picture| bands_of(&as_jpeg(picture, quality), FAR, &LUMA);
            let (without, pixels, squares) = (of(&plain), of(&in_pixels), of(&in_squares));
            println!(
                "sun {elevation_deg}°, JPEG of quality {quality}: {without:.3} without dither, {pixels:.3} with that of \
                 pixels, {squares:.3} with that of squares"
            );
            assert!(without > BAND_STEPS, "{without}");
            assert!(
                squares < BAND_STEPS && squares < 0.75 * without,
                "{squares}"
            );
        }
    }
}
