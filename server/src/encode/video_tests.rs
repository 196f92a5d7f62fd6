//! Streams decoded again.

use openh264::decoder::Decoder;
use skycell_protocol::{Codec, FrameSize};
use std::time::{Duration, Instant};

use super::i420::{I420, rgb_of};
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
}

struct Seen {
    is_key: bool,
    bytes: usize,
    difference: f64,
}

impl Session {
    fn new(target_kbit_per_s: u32) -> Self {
        Self {
            stream: ViewerStream::default(),
            decoder: Decoder::new().expect("a decoder"),
            now: Instant::now(),
            target_kbit_per_s,
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
        };
        let mut bytes = vec![7; 3];
        let unit = self
            .stream
            .encode(&picture, &mut { wants_key }, self.now, &mut bytes)
            .expect("encoded");
        assert_eq!(bytes[..3], [7; 3], "what was there stays");
        let decoded = self.decoder.decode(&bytes[3..]).expect("a whole stream");
        let rgb = rgb_of(&decoded.expect("a picture"), size).expect("as large");
        Seen {
            is_key: unit.is_key,
            bytes: bytes.len() - 3,
            difference: mean_difference(&rgb, rgba),
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
