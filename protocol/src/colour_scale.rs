//! How the colours of a video are spread over its eight bits.
//!
//! A video holds brightness and two colour differences, eight bits each, and its codec loses most in the last bits. The colours of a
//! sky need an eighth of the range of a difference, so they are moved to its middle and spread before they are compressed, and
//! put back once they are decoded: `gain` times finer. Who decodes is told of both numbers by the frame's header. It smooths steps
//! of brightness of one, where there are no others, and dithers pixels as a PNG's are, which no codec would have carried.
//!
//! Differences are those of BT.709 in full range: (blue − Y) / 1.8556 and (red − Y) / 1.5748, in steps of 8 bits, around 128.
//! One is held for 2 × 2 pixels, in their middle.

use crate::FrameSize;

/// The largest gain: from here on what is spared of colour is lost in brightness, at the same rate (measured: 5 and 6 are
/// alike).
pub const GAIN_MAX: u8 = 6;
/// The middle of eight bits: no colour.
const NEUTRAL: f32 = 128.0;
/// (blue − Y) and (red − Y) of a step of a difference, BT.709 (Kr = 0.2126, Kb = 0.0722).
pub const FULL_RANGE: [f32; 2] = [1.8556, 1.5748];
/// What of a step of blue and red differences is missing in green: 2 Kb (1 − Kb) / Kg and 2 Kr (1 − Kr) / Kg.
const GREEN: [f32; 2] = [0.187_324, 0.468_124];

/// How colour differences were spread: `128 + gain · (difference − centre)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ColourScale {
    centre: [u8; 2],
    gain: u8,
}

impl ColourScale {
    /// Differences as they are.
    pub const PLAIN: Self = Self {
        centre: [128; 2],
        gain: 1,
    };

    /// A scale about a centre (of blue and red differences).
    pub fn new(centre: [u8; 2], gain: u8) -> Option<Self> {
        (1..=GAIN_MAX)
            .contains(&gain)
            .then_some(Self { centre, gain })
    }

    /// The finest scale that holds differences between `least` and `most` with room for a sixth more.
    pub fn for_range(least: [f32; 2], most: [f32; 2]) -> Self {
        let halves = [0, 1].map(|i| 0.5 * (most[i] - least[i]));
        let half = 7.0 / 6.0 * halves[0].max(halves[1]) + 1.0;
        // At most 127 / 1, so it fits.
        let gain = ((127.0 / half) as u8).clamp(1, GAIN_MAX);
        if gain == 1 {
            return Self::PLAIN;
        }
        let centre = [0, 1].map(|i| (0.5 * (most[i] + least[i])).round() as u8);
        Self { centre, gain }
    }

    /// Whether differences between `least` and `most` are held.
    pub fn holds(&self, least: [f32; 2], most: [f32; 2]) -> bool {
        // Without a gain there is room for all that 8-bit colours have, but for half a step at their end.
        self.gain == 1
            || [0, 1]
                .into_iter()
                .all(|i| self.spread(least[i], i) >= -0.5 && self.spread(most[i], i) < 255.5)
    }

    /// The blue (0) or red (1) difference as it is compressed, before it is rounded.
    #[inline]
    pub fn spread(&self, difference: f32, index: usize) -> f32 {
        NEUTRAL + f32::from(self.gain) * (difference - f32::from(self.centre[index]))
    }

    /// How much finer the differences are.
    pub fn gain(&self) -> u8 {
        self.gain
    }

    /// Its bytes in a frame's header; all 0 where the colours are as the stream itself says.
    pub(crate) fn to_wire(scale: Option<Self>) -> [u8; 4] {
        scale.map_or([0; 4], |s| [s.centre[0], s.centre[1], s.gain, 0])
    }

    /// Of a header's bytes. A gain that this crate does not know is taken as it is said.
    pub(crate) fn of_wire(bytes: [u8; 4]) -> Option<Self> {
        let [blue, red, gain, _] = bytes;
        (gain > 0).then_some(Self {
            centre: [blue, red],
            gain,
        })
    }
}

/// A plane of eight bits.
#[derive(Clone, Copy, Debug)]
pub struct Plane<'a> {
    /// Rows from top to bottom.
    pub bytes: &'a [u8],
    /// From the beginning of one row to that of the next.
    pub stride: usize,
}

impl Plane<'_> {
    /// A row, or the last one that there is; `width` values of it.
    fn row(&self, y: usize, width: usize) -> &[u8] {
        let rows = self.bytes.len().saturating_sub(width) / self.stride + 1;
        let begin = y.min(rows - 1) * self.stride;
        &self.bytes[begin..begin + width]
    }

    fn holds(&self, width: usize, height: usize) -> bool {
        self.stride >= width && self.bytes.len() >= self.stride * (height - 1) + width
    }
}

/// What moves a pixel by up to half a step before it is rounded: the composite's own pattern (`composite/tone.wgsl`; J. Jimenez, "Next
/// Generation Post Processing in Call of Duty", 2014).
pub fn dither(x: usize, y: usize) -> f32 {
    // Of what is not negative, and quicker than `fract`.
    let fraction = |value: f32| value - (value as u32) as f32;
    fraction(52.982_918 * fraction(x as f32 * 0.067_110_56 + y as f32 * 0.005_837_15)) - 0.5
}

/// How far a pixel's brightness is compared with that around, in columns and rows.
const REACH: usize = 8;
/// Which of the rows below, and which column of a row that begins `REACH` before the pixel.
const AROUND: [(usize, usize); 12] = [
    (0, 8),
    (1, 4),
    (1, 8),
    (1, 12),
    (2, 0),
    (2, 4),
    (2, 12),
    (2, 16),
    (3, 4),
    (3, 8),
    (3, 12),
    (4, 8),
];
/// Those rows, from the pixel's own.
const ROWS: [isize; 5] = [-8, -4, 0, 4, 8];

/// Brightness of a pixel of the middle one of five rows, each of which begins `REACH` values before the picture: the mean of what is
/// around and differs by a step at most. A slope too slow for eight bits is a slope again; all else differs by more, or is grain
/// that a mean does no harm.
fn smoothed(rows: &[Vec<u8>; 5], x: usize) -> f32 {
    let around = rows.each_ref().map(|row| &row[x..=x + 2 * REACH]);
    let own = around[2][REACH];
    let (mut sum, mut count) = (u32::from(own), 1_u32);
    for (row, column) in AROUND {
        let value = around[row][column];
        let is_near = u32::from(value.abs_diff(own) <= 1);
        sum += is_near * u32::from(value);
        count += is_near;
    }
    sum as f32 / count as f32
}

/// Pixels of a decoded picture (brightness, blue and red differences), dithered: red, green, blue; the top left `size` of what the
/// planes hold. `eye_width` is how many columns one eye's part has: the pattern begins anew there. None where they hold less.
pub fn rgb_of_planes(
    [luma, blue, red]: [Plane<'_>; 3],
    scale: ColourScale,
    size: FrameSize,
    eye_width: usize,
) -> Option<Vec<u8>> {
    let (width, height) = (size.width() as usize, size.height() as usize);
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let whole = luma.holds(width, height)
        && [blue, red]
            .iter()
            .all(|plane| plane.holds(half_width, half_height));
    if !whole || eye_width == 0 {
        return None;
    }
    let gain = f32::from(scale.gain.max(1));
    let centre = scale.centre.map(|centre| f32::from(centre) - NEUTRAL);
    let mut rgb = Vec::with_capacity(3 * width * height);
    // Differences of a row of pixels at half its width.
    let mut halves = [vec![0.0_f32; half_width], vec![0.0_f32; half_width]];
    let mut rows = [(); 5].map(|()| vec![0; width + 2 * REACH]);
    for y in 0..height {
        // Three quarters of the nearer row, a quarter of the next one: differences stand in the middle of 2 × 2 pixels.
        let near = y / 2;
        let far = if y % 2 == 0 {
            near.saturating_sub(1)
        } else {
            (near + 1).min(half_height - 1)
        };
        for (i, (plane, half)) in [blue, red].iter().zip(&mut halves).enumerate() {
            let rows = plane
                .row(near, half_width)
                .iter()
                .zip(plane.row(far, half_width));
            for (value, (near, far)) in half.iter_mut().zip(rows) {
                let mixed = 0.75 * f32::from(*near) + 0.25 * f32::from(*far);
                *value = (mixed - NEUTRAL) / gain + centre[i];
            }
        }
        for (row, offset) in rows.iter_mut().zip(ROWS) {
            let y = (y as isize + offset).clamp(0, height as isize - 1);
            let values = luma.row(y as usize, width);
            row[REACH..REACH + width].copy_from_slice(values);
            // Beyond its sides the picture goes on as it ends.
            row[..REACH].fill(values[0]);
            row[REACH + width..].fill(values[width - 1]);
        }
        for x in 0..width {
            let near = x / 2;
            let far = if x % 2 == 0 {
                near.saturating_sub(1)
            } else {
                (near + 1).min(half_width - 1)
            };
            let [blue, red] = [0, 1].map(|i| 0.75 * halves[i][near] + 0.25 * halves[i][far]);
            let luma = smoothed(&rows, x) + dither(x % eye_width, y);
            let colour = [
                luma + FULL_RANGE[1] * red,
                luma - GREEN[0] * blue - GREEN[1] * red,
                luma + FULL_RANGE[0] * blue,
            ];
            // A cast to u8 ends at 0 and 255.
            rgb.extend(colour.map(|value| (value + 0.5) as u8));
        }
    }
    Some(rgb)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_sky_is_spread_and_a_sunset_is_not() {
        assert_eq!(
            ColourScale::for_range([124.0, 105.0], [157.0, 130.0]).gain(),
            6
        );
        assert_eq!(
            ColourScale::for_range([20.0, 100.0], [180.0, 240.0]),
            ColourScale::PLAIN
        );
        assert!(
            ColourScale::new([128; 2], 0).is_none()
                && ColourScale::new([128; 2], GAIN_MAX + 1).is_none()
        );
    }

    #[test]
    fn planes_that_are_too_small_are_no_picture() {
        let size = FrameSize::new(5, 3).expect("in range");
        let bytes = [128; 64];
        let plane = |length, stride| Plane {
            bytes: &bytes[..length],
            stride,
        };
        let read =
            |luma, colour| rgb_of_planes([luma, colour, colour], ColourScale::PLAIN, size, 5);
        assert_eq!(
            read(plane(21, 8), plane(7, 4)).map(|rgb| rgb.len()),
            Some(45)
        );
        assert_eq!(read(plane(20, 8), plane(7, 4)), None);
        assert_eq!(read(plane(21, 8), plane(6, 4)), None);
        assert_eq!(read(plane(64, 4), plane(7, 4)), None);
    }

    #[test]
    fn each_eye_has_the_same_picture() {
        let size = FrameSize::new(64, 8).expect("in range");
        let (luma, blue, red) = ([100; 512], [150; 128], [131; 128]);
        let planes = [(&luma[..], 64), (&blue[..], 32), (&red[..], 32)]
            .map(|(bytes, stride)| Plane { bytes, stride });
        let scale = ColourScale::new([140, 120], 5).expect("a gain");
        let rgb = rgb_of_planes(planes, scale, size, 32).expect("as large");
        for row in rgb.chunks_exact(3 * 64) {
            assert_eq!(row[..96], row[96..]);
        }
    }

    proptest! {
        #[test]
        fn a_scale_holds_the_range_that_it_is_made_for_and_no_value_is_cut(
            ends in proptest::array::uniform4(0.0..255.0f32),
        ) {
            let [a, b, c, d] = ends;
            let (least, most) = ([a.min(b), c.min(d)], [a.max(b), c.max(d)]);
            let scale = ColourScale::for_range(least, most);
            prop_assert!(scale.holds(least, most));
            for i in 0..2 {
                for difference in [least[i], most[i]] {
                    let coded = (scale.spread(difference, i) + 0.5) as u8;
                    let back = (f32::from(coded) - NEUTRAL) / f32::from(scale.gain) + f32::from(scale.centre[i]);
                    prop_assert!((back - difference).abs() <= 0.51 / f32::from(scale.gain));
                }
            }
        }
    }
}
