//! Where the frames of a temporal window have their samples.

/// Most frames of a temporal window.
pub const WINDOW_FRAMES_MAX: u32 = 16;

/// Where the rays of one frame stand in their marched pixels, and their samples in the steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FramePlace {
    /// Which picture pixel of a marched one.
    pub pixel: [u32; 2],
    /// Where in the picture pixel, 0…1.
    pub within: [f64; 2],
    /// By what share of a step samples are moved, 0…1: the depth segment.
    pub segment: f64,
}

/// The first 16 points of the (0, 2)-sequence of I. Sobol (1967), in sixteenths: any first 2^k of them have one in each of
/// 2^k columns, in each of as many rows, and in each box of a grid between.
const SOBOL: [[u32; 2]; 16] = {
    let mut points = [[0; 2]; 16];
    let mut index = 0;
    while index < 16u32 {
        // Direction numbers of the second dimension: each is the one before it, xored with its half.
        let directions = [8u32, 12, 10, 15];
        let mut y = 0;
        let mut bit = 0;
        while bit < 4 {
            if index >> bit & 1 == 1 {
                y ^= directions[bit as usize];
            }
            bit += 1;
        }
        points[index as usize] = [index.reverse_bits() >> 28, y];
        index += 1;
    }
    points
};

/// Place of frame `index` of `frames` in the unit square: n rooks, one in each of n columns and rows. Powers of two come
/// from Sobol's sequence, so that the places so far are spread evenly at any time; other numbers from a lattice whose second
/// coordinate grows by about the golden ratio.
fn rook(index: u32, frames: u32) -> [f64; 2] {
    let n = f64::from(frames);
    let [column, row] = if frames.is_power_of_two() {
        SOBOL[(index % 16) as usize].map(|place| place * frames / 16)
    } else {
        let grows = (1..frames)
            .filter(|step| gcd(*step, frames) == 1)
            .min_by(|a, b| {
                let off = |step: u32| (f64::from(step) / n - 0.618_033_988_749_894_9).abs();
                off(*a).total_cmp(&off(*b))
            })
            .unwrap_or(1);
        let column = index * grows % frames;
        [column, column * grows % frames]
    };
    [column, row].map(|place| (f64::from(place) + 0.5) / n)
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// The places of a window's frames, where each marched pixel stands for `divisor` × `divisor` picture pixels.
///
/// Frames that look through one and the same picture pixel share its march: each takes another segment of the steps, and
/// their samples interleave to all of it (P. Ford, "Real-Time Rendering of Atmospheric Clouds", 2024, 4.5).
#[must_use]
pub fn window_places(frames: u32, divisor: u32) -> Vec<FramePlace> {
    let frames = frames.clamp(1, WINDOW_FRAMES_MAX);
    let divisor = divisor.max(1);
    let mut places: Vec<FramePlace> = (0..frames)
        .map(|index| {
            let scaled = rook(index, frames).map(|place| place * f64::from(divisor));
            FramePlace {
                pixel: scaled.map(|place| (place as u32).min(divisor - 1)),
                within: scaled.map(f64::fract),
                segment: 0.0,
            }
        })
        .collect();
    let pixels = divisor * divisor;
    for index in 0..places.len() {
        // A pixel's only sample stands in its middle: beside it, it would shift the picture.
        if frames <= pixels {
            places[index].within = [0.5; 2];
        }
        let shares = |place: &&FramePlace| place.pixel == places[index].pixel;
        let before = places[..index].iter().filter(shares).count() as u32;
        let all = places.iter().filter(shares).count() as u32;
        places[index].segment = rook(before, all)[0];
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn no_two_frames_share_a_column_or_a_row() {
        for frames in 1..=WINDOW_FRAMES_MAX {
            for axis in 0..2 {
                let taken: BTreeSet<u32> = window_places(frames, 1)
                    .iter()
                    .map(|place| (place.within[axis] * f64::from(frames)) as u32)
                    .collect();
                assert_eq!(taken.len(), frames as usize, "{frames} frames, axis {axis}");
            }
        }
    }

    #[test]
    fn places_have_the_pixel_s_middle_as_their_mean() {
        for frames in 1..=WINDOW_FRAMES_MAX {
            for axis in 0..2 {
                let sum: f64 = window_places(frames, 1)
                    .iter()
                    .map(|place| place.within[axis])
                    .sum();
                assert!((sum / f64::from(frames) - 0.5).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn sixteen_frames_look_through_every_pixel_of_a_quarter_s() {
        let pixels = |frames, divisor| -> BTreeSet<[u32; 2]> {
            let places = window_places(frames, divisor);
            places.iter().map(|place| place.pixel).collect()
        };
        assert_eq!(pixels(16, 4).len(), 16);
        assert_eq!(pixels(4, 2).len(), 4);
        assert_eq!(pixels(16, 2).len(), 4);
        // The first four are in four quarters.
        let first: BTreeSet<[u32; 2]> = window_places(16, 4)[..4]
            .iter()
            .map(|place| place.pixel.map(|p| p / 2))
            .collect();
        assert_eq!(first.len(), 4);
    }

    #[test]
    fn frames_of_one_pixel_share_its_steps_evenly() {
        for divisor in [1, 2, 4] {
            for frames in 1..=WINDOW_FRAMES_MAX {
                let places = window_places(frames, divisor);
                for place in &places {
                    let mut segments: Vec<f64> = places
                        .iter()
                        .filter(|other| other.pixel == place.pixel)
                        .map(|other| other.segment)
                        .collect();
                    segments.sort_by(f64::total_cmp);
                    let n = segments.len() as f64;
                    for (index, segment) in segments.iter().enumerate() {
                        assert!((segment - (index as f64 + 0.5) / n).abs() < 1e-12);
                    }
                }
            }
        }
    }
}
