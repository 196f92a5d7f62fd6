//! A picture's colours spread over the eight bits of a video, as finely as they fit ([`skycell_protocol::colour_scale`]).

use skycell_protocol::ColourScale;
use skycell_protocol::colour_scale::{FULL_RANGE, dither};

use super::EncodeError;
use super::i420::I420;

/// BT.709's shares of red and blue in brightness.
const KR: f32 = 0.2126;
const KB: f32 = 0.0722;
/// After so many pictures in a row that a much finer scale would hold, it is taken, which costs a key: 5 s of 30 a second.
const FINER_AFTER: u32 = 150;
/// How much finer, at least, as a ratio of gains: 3/2.
const FINER: (u8, u8) = (3, 2);

/// The scale of a stream. It holds from key to key, since pictures build on one another; a picture that it does not hold
/// begins another.
#[derive(Debug, Default)]
pub struct Spread {
    scale: Option<ColourScale>,
    /// Pictures since one that needed this scale.
    spacious: u32,
    /// Blue and red differences, not yet rounded, around 128.
    differences: [Vec<f32>; 2],
    /// The dither of a frame, and how wide it is and one eye's part of it.
    pattern: Vec<u8>,
    pattern_widths: [usize; 2],
}

impl Spread {
    /// Fills planes with a frame's pixels, whose dither is taken out of the brightness: who decodes puts it in again, and it would
    /// only cost bits. Returns the scale, and whether it is another one than that of the picture before, which then must be a key, as
    /// it is where `begins`.
    ///
    /// # Errors
    /// If the pixels are not as many as the planes' size tells.
    pub fn fill(
        &mut self,
        planes: &mut I420,
        rgba: &[u8],
        begins: bool,
        is_pair: bool,
    ) -> Result<(ColourScale, bool), EncodeError> {
        let width = planes.coded_width();
        let columns = planes.size().width() as usize;
        let eye_width = if is_pair { columns / 2 } else { columns };
        let (rgba, [luma, blue, red]) = planes.pixels_and_planes(rgba)?;
        if self.pattern_widths != [width, eye_width] || self.pattern.len() != luma.len() {
            self.pattern.clear();
            self.pattern.extend((0..luma.len()).map(|at| {
                let noise = dither((at % width) % eye_width.max(1), at / width);
                ((noise + 0.5) * 256.0) as u8
            }));
            self.pattern_widths = [width, eye_width];
        }
        for ((byte, pixel), noise) in luma.iter_mut().zip(rgba.chunks_exact(4)).zip(&self.pattern) {
            let [r, g, b] = [pixel[0], pixel[1], pixel[2]].map(f32::from);
            let shown = KR * r + (1.0 - KR - KB) * g + KB * b;
            // Half a step of the noise's own rounding, half a step of this one, and the noise's middle.
            *byte = (shown - f32::from(*noise) * (1.0 / 256.0) + (1.0 - 0.5 / 256.0)) as u8;
        }
        let [blue_differences, red_differences] = &mut self.differences;
        let (least, most) = differences_of(rgba, width, blue_differences, red_differences);
        let (scale, is_other) = self.scale_for(least, most, begins);
        for (i, (plane, differences)) in [blue, red].into_iter().zip(&self.differences).enumerate()
        {
            for (byte, difference) in plane.iter_mut().zip(differences) {
                // A cast to u8 ends at 0 and 255.
                *byte = (scale.spread(*difference, i) + 0.5) as u8;
            }
        }
        Ok((scale, is_other))
    }

    fn scale_for(&mut self, least: [f32; 2], most: [f32; 2], begins: bool) -> (ColourScale, bool) {
        let finest = ColourScale::for_range(least, most);
        let kept = self
            .scale
            .filter(|scale| !begins && scale.holds(least, most));
        if let Some(scale) = kept {
            let is_much_finer = u32::from(finest.gain()) * u32::from(FINER.1)
                >= u32::from(scale.gain()) * u32::from(FINER.0);
            self.spacious = if is_much_finer { self.spacious + 1 } else { 0 };
            if self.spacious < FINER_AFTER {
                return (scale, false);
            }
        }
        self.spacious = 0;
        let is_other = self.scale != Some(finest);
        self.scale = Some(finest);
        (finest, is_other)
    }
}

/// The differences of 2 × 2 pixels each, and the least and the most of them.
fn differences_of(
    rgba: &[u8],
    width: usize,
    blue: &mut Vec<f32>,
    red: &mut Vec<f32>,
) -> ([f32; 2], [f32; 2]) {
    let count = rgba.len() / 16;
    blue.resize(count, 0.0);
    red.resize(count, 0.0);
    // A quarter for the mean of four.
    let scales = FULL_RANGE.map(|range| 0.25 / range);
    let rows = rgba.chunks_exact(8 * width);
    let halves = blue
        .chunks_exact_mut(width / 2)
        .zip(red.chunks_exact_mut(width / 2));
    let (mut least, mut most) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for (pair, (blue, red)) in rows.zip(halves) {
        let (upper, lower) = pair.split_at(4 * width);
        let quads = upper.chunks_exact(8).zip(lower.chunks_exact(8));
        for ((upper, lower), (blue, red)) in quads.zip(blue.iter_mut().zip(red.iter_mut())) {
            let sum = |c: usize| {
                f32::from(
                    u16::from(upper[c])
                        + u16::from(upper[c + 4])
                        + u16::from(lower[c])
                        + u16::from(lower[c + 4]),
                )
            };
            let (r, g, b) = (sum(0), sum(1), sum(2));
            let luma = KR * r + (1.0 - KR - KB) * g + KB * b;
            *blue = 128.0 + scales[0] * (b - luma);
            *red = 128.0 + scales[1] * (r - luma);
        }
        for (i, row) in [&*blue, &*red].into_iter().enumerate() {
            for difference in row {
                least[i] = least[i].min(*difference);
                most[i] = most[i].max(*difference);
            }
        }
    }
    (least, most)
}
