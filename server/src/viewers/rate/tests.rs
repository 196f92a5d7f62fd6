use std::collections::VecDeque;

use super::*;

const WISHED: u8 = 85;

/// A link with a queue that no frame leaves before it has been carried, and a viewer behind it.
#[derive(Clone, Copy)]
struct Link {
    kbit_per_s: f64,
    round_trip_us: u64,
    held_us: u64,
    /// How many frames may be under way, if the control does not say less.
    window: u32,
    fps: f64,
}

/// What a viewer saw.
#[derive(Default)]
struct Seen {
    ages_us: Vec<u64>,
    qualities: Vec<u8>,
}

impl Seen {
    fn p95_age_ms(&self) -> u64 {
        let mut ages_us = self.ages_us.clone();
        ages_us.sort_unstable();
        ages_us[(ages_us.len() * 95).div_ceil(100) - 1] / 1000
    }

    /// How often the quality changed in the second half.
    fn changes(&self) -> usize {
        let late = &self.qualities[self.qualities.len() / 2..];
        late.windows(2).filter(|pair| pair[0] != pair[1]).count()
    }
}

/// A JPEG of the sky, as long as one of 320x180 pixels; every frame a little other.
fn jpeg_bytes(quality: u8, frame: u64) -> usize {
    let content = 1.0 + 0.1 * ((frame as f64) * 0.7).sin();
    (700.0 + 11_000.0 * (f64::from(quality) / 85.0).powf(1.1) * content) as usize
}

/// What full quality needs.
fn source_kbit_per_s(fps: f64) -> f64 {
    jpeg_bytes(WISHED, 0) as f64 * 8.0e-3 * fps
}

struct World {
    rate: RateControl,
    now_us: u64,
    link_free_us: u64,
    frame: u64,
    under_way: VecDeque<(u64, Delivery)>,
}

impl World {
    fn new(link: &Link) -> Self {
        let mut rate = RateControl::default();
        rate.round_trip(link.round_trip_us);
        Self {
            rate,
            now_us: 1_000_000,
            link_free_us: 0,
            frame: 0,
            under_way: VecDeque::new(),
        }
    }

    /// Watches for some seconds, in steps of a millisecond.
    fn watch(&mut self, link: &Link, seconds: u64) -> Seen {
        let mut seen = Seen::default();
        let end_us = self.now_us + seconds * 1_000_000;
        let turn_us = (1.0e6 / link.fps) as u64;
        let mut due_us = self.now_us;
        while self.now_us < end_us {
            self.now_us += 1_000;
            let now_us = self.now_us;
            while let Some((rendered_us, delivery)) = self.under_way.front().copied()
                && delivery.acknowledged_us <= now_us
            {
                self.under_way.pop_front();
                seen.ages_us.push(delivery.acknowledged_us - rendered_us);
                self.rate.delivered(delivery, link.fps);
            }
            let window = self.rate.frames_in_flight_max(link.window);
            if now_us < due_us || self.under_way.len() >= window as usize {
                continue;
            }
            due_us = (due_us + turn_us).max(now_us);
            let quality = self.rate.jpeg_quality(WISHED);
            let bytes = jpeg_bytes(quality, self.frame);
            self.frame += 1;
            self.rate.jpeg_encoded(bytes, link.fps, now_us);
            // Composite, readback and encoding.
            let sent_us = now_us + 12_000;
            let carried_us = (bytes as f64 * 8.0e3 / link.kbit_per_s) as u64;
            self.link_free_us = self.link_free_us.max(sent_us) + carried_us;
            let delivery = Delivery {
                bytes: bytes as u64,
                sent_us,
                acknowledged_us: self.link_free_us + link.round_trip_us + link.held_us,
                held_us: link.held_us,
            };
            self.under_way.push_back((now_us, delivery));
            seen.qualities.push(quality);
        }
        seen
    }
}

fn link(fps: f64, share_of_source: f64) -> Link {
    Link {
        kbit_per_s: source_kbit_per_s(fps) * share_of_source,
        round_trip_us: 20_000,
        held_us: 8_000,
        window: 2,
        fps,
    }
}

#[test]
fn a_link_that_carries_all_is_left_alone_however_long_it_is() {
    for fps in [5.0, 15.0, 30.0, 60.0] {
        for round_trip_us in [0, 40_000, 300_000] {
            for held_us in [0, 16_000, 120_000] {
                let link = Link {
                    round_trip_us,
                    held_us,
                    ..link(fps, 4.0)
                };
                let mut world = World::new(&link);
                let seen = world.watch(&link, 20);
                assert_eq!(
                    world.rate.target_kbit_per_s(),
                    None,
                    "{fps} {round_trip_us}"
                );
                assert!(seen.qualities.iter().all(|quality| *quality == WISHED));
                assert_eq!(world.rate.frames_in_flight_max(2), 2);
            }
        }
    }
}

#[test]
fn frames_on_a_link_of_a_third_stay_young_at_the_wished_rate() {
    for fps in [8.0, 15.0, 30.0] {
        let link = link(fps, 1.0 / 3.0);
        let mut world = World::new(&link);
        let seen = world.watch(&link, 20);
        let target = f64::from(world.rate.target_kbit_per_s().expect("a slow link"));
        println!(
            "{fps} fps, {:.0} kbit/s: aims at {target:.0}, {:.1} fps, p95 {} ms, {} changes of quality",
            link.kbit_per_s,
            seen.ages_us.len() as f64 / 20.0,
            seen.p95_age_ms(),
            seen.changes()
        );
        assert!(
            (0.55..0.95).contains(&(target / link.kbit_per_s)),
            "{target}"
        );
        // With the first second, in which the link is found out.
        assert!(seen.ages_us.len() as f64 > 0.85 * 20.0 * fps);
        assert!(seen.p95_age_ms() <= 250, "{}", seen.p95_age_ms());
        // It does not hop: a try each ten seconds at most, up and down again.
        assert!(seen.changes() <= 4, "{}", seen.changes());
    }
}

#[test]
fn on_a_link_that_even_the_least_quality_does_not_fit_frames_go_one_at_a_time() {
    let link = link(15.0, 0.05);
    let mut world = World::new(&link);
    world.watch(&link, 10);
    let seen = world.watch(&link, 20);
    assert_eq!(world.rate.frames_in_flight_max(2), 1);
    let least = *seen.qualities.last().expect("a frame");
    assert!(least < 20, "{least}");
    // One frame's time on the link and the way, instead of two.
    let alone_ms = jpeg_bytes(least, 0) as f64 * 8.0 / link.kbit_per_s;
    println!("{alone_ms:.0} ms a frame, p95 {} ms", seen.p95_age_ms());
    assert!((seen.p95_age_ms() as f64) < 1.3 * alone_ms + 50.0);
}

#[test]
fn a_link_that_recovers_gets_its_quality_back_and_one_that_fails_loses_it_at_once() {
    let (slow, fast) = (link(15.0, 1.0 / 3.0), link(15.0, 5.0));
    let mut world = World::new(&slow);
    let before = world.watch(&fast, 10);
    assert!(before.qualities.iter().all(|quality| *quality == WISHED));
    let fell = world.watch(&slow, 10);
    assert!(fell.qualities[15] < WISHED, "within a second");
    assert!(fell.p95_age_ms() <= 400, "{}", fell.p95_age_ms());
    let recovered = world.watch(&fast, 40);
    assert_eq!(recovered.qualities.last(), Some(&WISHED));
    let steps = recovered.changes();
    assert!(steps <= 10, "{steps} changes on the way up");
}

#[test]
fn a_ladder_never_leaves_the_wished_quality_upwards_and_ends() {
    let mut ladder = JpegLadder::default();
    for wished in [1, 5, 12, 60, 100] {
        assert_eq!(ladder.quality(wished), wished);
    }
    for now_us in 0..100 {
        ladder.encoded(1_000_000, Some(10.0), now_us);
    }
    for wished in [1, 5, 12, 60, 100] {
        let least = ladder.quality(wished);
        assert!((1..=wished).contains(&least), "{wished}: {least}");
    }
    // Without a rate to keep to, all is allowed.
    ladder.encoded(1_000_000, None, 100);
    assert_eq!(ladder.quality(85), 85);
}

#[test]
fn an_attempt_that_fails_makes_the_next_one_wait_longer() {
    let mut ladder = JpegLadder::default();
    // Lengths that just fit below and not above: every step up is taken back.
    let mut tries = 0;
    let mut quality = ladder.quality(WISHED);
    for frame in 0..15 * 120 {
        let now_us = frame * 66_667;
        let bytes = if ladder.quality(WISHED) > 40 {
            3_000
        } else {
            600
        };
        ladder.encoded(bytes, Some(1_000.0), now_us);
        let next = ladder.quality(WISHED);
        tries += usize::from(next > quality);
        quality = next;
    }
    assert!((5..=16).contains(&tries), "{tries} attempts in two minutes");
}
