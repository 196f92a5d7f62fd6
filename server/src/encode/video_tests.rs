//! Streams decoded again.

use openh264::decoder::Decoder;
use skycell_protocol::colour_scale::{GAIN_MAX, dither};
use skycell_protocol::{Codec, ColourScale, FrameSize};
use std::time::{Duration, Instant};

use super::colours::Spread;
use super::i420::{I420, rgb_of, rgb_of_spread};
use super::stream::{StreamPicture, ViewerStream};

/// Clouds of a kind: waves of several lengths, moved by `shift` pixels, under a grain that is another in each picture.
fn waves(size: FrameSize, shift: f64) -> Vec<u8> {
    let mut rgba = Vec::with_capacity(size.pixels() as usize * 4);
    let mut grain = fastrand::Rng::with_seed(shift.to_bits());
    for row in 0..size.height() {
        for column in 0..size.width() {
            let (x, y) = (f64::from(column) + shift, f64::from(row));
            let wave = |length: f64, slope: f64| ((x + slope * y) / length).sin();
            let value = 0.5 + 0.2 * wave(40.0, 0.3) + 0.1 * wave(11.0, -0.7) + 0.05 * grain.f64();
            let colour = |scale: f64| (255.0 * scale * value).clamp(0.0, 255.0) as u8;
            rgba.extend([colour(0.8), colour(0.9), colour(1.1), 255]);
        }
    }
    rgba
}

fn mean_difference(rgb: &[u8], rgba: &[u8]) -> f64 {
    let sum: u64 = rgb
        .chunks_exact(3)
        .zip(rgba.chunks_exact(4))
        .flat_map(|(a, b)| (0..3).map(|channel| u64::from(a[channel].abs_diff(b[channel]))))
        .sum();
    sum as f64 / rgb.len() as f64
}

/// A viewer's stream and who watches it, by a clock of the test's.
struct Session {
    stream: ViewerStream,
    decoder: Decoder,
    now: Instant,
    target_kbit_per_s: u32,
    scales_colours: bool,
    /// What was seen last.
    last: Vec<u8>,
}

struct Seen {
    is_key: bool,
    bytes: usize,
    difference: f64,
    colours: Option<ColourScale>,
}

impl Session {
    fn new(target_kbit_per_s: u32) -> Self {
        Self {
            stream: ViewerStream::default(),
            decoder: Decoder::new().expect("a decoder"),
            now: Instant::now(),
            target_kbit_per_s,
            scales_colours: false,
            last: Vec::new(),
        }
    }

    fn show(&mut self, rgba: &[u8], size: FrameSize, wants_key: bool) -> Seen {
        self.now += Duration::from_secs_f64(1.0 / 30.0);
        let picture = StreamPicture {
            rgba,
            size,
            codec: Codec::H264,
            target_kbit_per_s: self.target_kbit_per_s,
            fps_max: 30.0,
            scales_colours: self.scales_colours,
            is_pair: false,
        };
        let mut bytes = vec![7; 3];
        let unit = self
            .stream
            .encode(&picture, &mut { wants_key }, self.now, &mut bytes)
            .expect("encoded");
        assert_eq!(bytes[..3], [7; 3], "what was there stays");
        let decoded = self.decoder.decode(&bytes[3..]).expect("a whole stream");
        let decoded = decoded.expect("a picture");
        let rgb = match unit.colours {
            Some(scale) => rgb_of_spread(&decoded, scale, size),
            None => rgb_of(&decoded, size),
        }
        .expect("as large");
        let difference = mean_difference(&rgb, rgba);
        self.last = rgb;
        Seen {
            is_key: unit.is_key,
            bytes: bytes.len() - 3,
            difference,
            colours: unit.colours,
        }
    }
}

#[test]
fn colours_survive_the_way_to_planes_and_back_at_every_size() {
    for (width, height) in [(1, 1), (2, 1), (17, 9), (16, 16), (33, 50), (64, 36)] {
        let size = FrameSize::new(width, height).expect("in range");
        let flat = [
            [250, 120, 10, 255],
            [0, 0, 0, 255],
            [255, 255, 255, 255],
            [20, 90, 200, 255],
        ];
        for colour in flat {
            let rgba = colour.repeat(size.pixels() as usize);
            let mut planes = I420::new(size);
            planes.fill(&rgba).expect("as many");
            let rgb = rgb_of(&planes, size).expect("as large");
            for pixel in rgb.chunks_exact(3) {
                let off = pixel.iter().zip(colour).map(|(a, b)| a.abs_diff(b)).max();
                assert!(
                    off <= Some(2),
                    "{pixel:?} for {colour:?} at {width}x{height}"
                );
            }
        }
        let mut planes = I420::new(size);
        assert!(planes.fill(&[0; 7]).is_err());
    }
}

#[test]
fn every_size_has_a_stream_and_another_size_begins_another() {
    let mut session = Session::new(2_000);
    for (width, height) in [(1, 1), (17, 9), (160, 90), (161, 91)] {
        let size = FrameSize::new(width, height).expect("in range");
        for number in 0..3 {
            let seen = session.show(&waves(size, f64::from(number)), size, false);
            assert_eq!(seen.is_key, number == 0, "{width}x{height} {number}");
            assert!(
                seen.difference < 4.0,
                "{width}x{height}: {}",
                seen.difference
            );
        }
    }
    assert!(session.stream.is_open());
    session.stream.end();
    assert!(!session.stream.is_open());
}

#[test]
fn a_key_that_is_asked_for_comes_when_the_last_one_is_old_enough() {
    let size = FrameSize::new(160, 90).expect("in range");
    let mut session = Session::new(2_000);
    let keys: Vec<u32> = (0..60)
        .filter(|number| {
            session
                .show(&waves(size, f64::from(*number)), size, true)
                .is_key
        })
        .collect();
    assert_eq!(keys.first(), Some(&0));
    assert_eq!(keys.len(), 3, "of two seconds: {keys:?}");
    assert!(
        keys.windows(2).all(|pair| pair[1] - pair[0] >= 27),
        "{keys:?}"
    );
}

#[test]
fn the_rate_follows_its_target_up_and_down_without_a_key() {
    let size = FrameSize::new(320, 180).expect("in range");
    let mut session = Session::new(2_000);
    let mut number = 0;
    for target_kbit_per_s in [2_000, 700, 3_000] {
        session.target_kbit_per_s = target_kbit_per_s;
        let mut bytes = 0;
        for late in [false, true] {
            for _ in 0..45 {
                number += 1;
                let seen = session.show(&waves(size, 7.3 * f64::from(number)), size, false);
                assert_eq!(seen.is_key, number == 1);
                bytes += if late { seen.bytes } else { 0 };
            }
        }
        let kbit_per_s = bytes as f64 * 8e-3 / 1.5;
        let share = kbit_per_s / f64::from(target_kbit_per_s);
        println!("{kbit_per_s:.0} kbit/s for {target_kbit_per_s}");
        assert!(
            (0.6..1.3).contains(&share),
            "{kbit_per_s:.0} for {target_kbit_per_s}"
        );
    }
}

#[test]
fn a_picture_that_rests_gets_finer() {
    let size = FrameSize::new(320, 180).expect("in range");
    let mut session = Session::new(600);
    for number in 0..30 {
        session.show(&waves(size, 5.0 * f64::from(number)), size, false);
    }
    let still = waves(size, 150.0);
    let seen: Vec<Seen> = (0..10).map(|_| session.show(&still, size, false)).collect();
    for (number, seen) in seen.iter().enumerate() {
        println!(
            "{number}: {} bytes, off by {:.3}",
            seen.bytes, seen.difference
        );
    }
    assert!(seen[9].difference < 0.8 * seen[0].difference);
}

/// Colours of a clear sky, a slow slope in both directions, not rounded.
fn slope(size: FrameSize, x: u32, y: u32) -> [f64; 3] {
    let (x, y) = (
        f64::from(x) / f64::from(size.width()),
        f64::from(y) / f64::from(size.height()),
    );
    [
        60.0 + 6.0 * x + 9.0 * y,
        95.0 + 5.0 * x + 8.0 * y,
        150.0 + 3.0 * x + 5.0 * y,
    ]
}

/// As a composite rounds it.
fn dithered(size: FrameSize, colour: impl Fn(u32, u32) -> [f64; 3]) -> Vec<u8> {
    let mut rgba = Vec::with_capacity(size.pixels() as usize * 4);
    for y in 0..size.height() {
        for x in 0..size.width() {
            let noise = f64::from(dither(x as usize, y as usize));
            rgba.extend(colour(x, y).map(|value| (value + noise).round() as u8));
            rgba.push(255);
        }
    }
    rgba
}

/// Root of the mean square by which means over 16 x 16 pixels differ from what was meant, the worst of the three channels.
fn mean_error(rgb: &[u8], size: FrameSize, colour: impl Fn(u32, u32) -> [f64; 3]) -> f64 {
    let (columns, rows) = (size.width() / 16, size.height() / 16);
    let mut sums = [0.0; 3];
    for block in 0..columns * rows {
        let (left, top) = (block % columns * 16, block / columns * 16);
        let mut off = [0.0; 3];
        for at in 0..256 {
            let (x, y) = (left + at % 16, top + at / 16);
            let pixel = &rgb[(y * size.width() + x) as usize * 3..];
            for (i, meant) in colour(x, y).into_iter().enumerate() {
                off[i] += (f64::from(pixel[i]) - meant) / 256.0;
            }
        }
        for i in 0..3 {
            sums[i] += off[i] * off[i] / f64::from(columns * rows);
        }
    }
    sums.into_iter().fold(0.0, f64::max).sqrt()
}

#[test]
fn colours_that_are_spread_keep_slopes_too_slow_for_eight_bits() {
    let size = FrameSize::new(320, 180).expect("in range");
    let rgba = dithered(size, |x, y| slope(size, x, y));
    let mut planes = I420::new(size);
    let (scale, _) = Spread::default()
        .fill(&mut planes, &rgba, true, false)
        .expect("as many");
    assert_eq!(scale.gain(), GAIN_MAX);
    let spread = rgb_of_spread(&planes, scale, size).expect("as large");
    planes.fill(&rgba).expect("as many");
    let plain = rgb_of(&planes, size).expect("as large");
    let [spread, plain] =
        [spread, plain].map(|rgb| mean_error(&rgb, size, |x, y| slope(size, x, y)));
    println!("{spread:.3} of a step spread, {plain:.3} plain");
    assert!(spread < 0.12, "{spread}");
    assert!(plain > 0.25, "the measure tells bands: {plain}");
    // And through the codec, which quantises noise away.
    let mut errors = [0.0; 2];
    for (error, scales_colours) in errors.iter_mut().zip([true, false]) {
        let mut session = Session::new(2_000);
        session.scales_colours = scales_colours;
        for _ in 0..5 {
            session.show(&rgba, size, false);
        }
        *error = mean_error(&session.last, size, |x, y| slope(size, x, y));
    }
    println!(
        "{:.3} of a step spread, {:.3} plain, compressed",
        errors[0], errors[1]
    );
    // Not smoothed it would be .17.
    assert!(errors[0] < 0.15 && errors[1] > 0.5, "{errors:?}");
}

#[test]
fn every_size_has_spread_colours_that_are_right() {
    for (width, height) in [(1, 1), (2, 1), (17, 9), (16, 16), (33, 50), (64, 36)] {
        let size = FrameSize::new(width, height).expect("in range");
        for colour in [
            [250, 120, 10, 255],
            [0, 0, 0, 255],
            [255, 255, 255, 255],
            [20, 90, 200, 255],
        ] {
            let rgba = colour.repeat(size.pixels() as usize);
            let mut planes = I420::new(size);
            let (scale, _) = Spread::default()
                .fill(&mut planes, &rgba, true, false)
                .expect("as many");
            let rgb = rgb_of_spread(&planes, scale, size).expect("as large");
            for pixel in rgb.chunks_exact(3) {
                let off = pixel.iter().zip(colour).map(|(a, b)| a.abs_diff(b)).max();
                assert!(
                    off <= Some(1),
                    "{pixel:?} for {colour:?} at {width}x{height}"
                );
            }
        }
        let mut planes = I420::new(size);
        assert!(
            Spread::default()
                .fill(&mut planes, &[0; 7], true, false)
                .is_err()
        );
    }
}

#[test]
fn a_picture_that_the_scale_does_not_hold_begins_another_one_which_gets_finer_again() {
    let size = FrameSize::new(64, 48).expect("in range");
    let calm = dithered(size, |x, y| slope(size, x, y));
    // A sun at the edge of the same sky.
    let sun = dithered(size, |x, y| {
        if x > 40 {
            [255.0, 150.0, 20.0]
        } else {
            slope(size, x, y)
        }
    });
    let mut session = Session::new(2_000);
    session.scales_colours = true;
    let gain = |seen: &Seen| seen.colours.expect("spread").gain();
    let first = session.show(&calm, size, false);
    assert!(first.is_key && gain(&first) == GAIN_MAX);
    assert!(!session.show(&calm, size, false).is_key);
    let with_sun = session.show(&sun, size, false);
    assert!(
        with_sun.is_key && gain(&with_sun) < GAIN_MAX,
        "{:?}",
        with_sun.colours
    );
    assert!(with_sun.difference < 4.0, "{}", with_sun.difference);
    assert!(!session.show(&sun, size, false).is_key);
    let seen: Vec<Seen> = (0..160).map(|_| session.show(&calm, size, false)).collect();
    assert_eq!(
        seen.iter().filter(|seen| seen.is_key).count(),
        1,
        "no key each time"
    );
    assert!(!seen[100].is_key && gain(&seen[100]) == gain(&with_sun));
    assert_eq!(gain(&seen[159]), GAIN_MAX);
}
