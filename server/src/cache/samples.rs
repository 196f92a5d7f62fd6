//! How many samples a texel averages.

use super::sphere::Want;

/// Samples that texels average.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TexelSamples {
    /// So many at most, 1 or more.
    pub most: u32,
    /// Where several texels make a pixel, it is their samples together that are so many, or fewer: what is finer than pixels costs no
    /// more rays than these, and is a little noisier.
    pub by_area: bool,
}

impl TexelSamples {
    /// So many at most, or one.
    #[must_use]
    pub fn new(most: u32, by_area: bool) -> Self {
        Self {
            most: most.max(1),
            by_area,
        }
    }

    /// So many in each texel.
    #[must_use]
    pub fn each(most: u32) -> Self {
        Self::new(most, false)
    }

    /// The same for another number.
    #[must_use]
    pub fn with_most(self, most: u32) -> Self {
        Self::new(most, self.by_area)
    }

    /// Samples that the texels of a tile should average: one where it only fills in for tiles that are not there yet.
    pub(super) fn of(self, want: &Want) -> u32 {
        if want.viewers == 0 {
            return 1;
        }
        self.of_texel(want.texel_pixels)
    }

    /// Samples of a texel that somebody asks for, which covers so many pixels.
    #[must_use]
    pub fn of_texel(self, texel_pixels: f64) -> u32 {
        if !self.by_area {
            return self.most;
        }
        // The two of a pair are on opposite sides of the middle of their texel, so there are whole pairs. They are rounded down:
        // gutters and what edges of pictures cut off are marched on top. One sample alone stands on either side, from texel to texel.
        let pairs = (0.5 * texel_pixels * f64::from(self.most)).floor();
        // No more than there are, so it is no larger than that number. What is no number is one.
        (2.0 * pairs).max(1.0).min(f64::from(self.most)) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn want(viewers: u32, texel_pixels: f64) -> Want {
        Want {
            viewers,
            eccentricity_rad: 0.0,
            distance_m: 1e3,
            attention: 0.1,
            texel_pixels,
        }
    }

    #[test]
    fn a_pixel_has_its_samples_or_fewer_whether_one_texel_makes_it_or_several() {
        let shared = TexelSamples::new(8, true);
        for width in [0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0] {
            let area: f64 = width * width;
            let of_texel = shared.of(&want(1, area));
            let of_pixel = f64::from(of_texel) / area;
            assert!(of_pixel <= 8.0 || of_texel == 1, "{width}: {of_pixel}");
            // Short of them by less than a pair.
            assert!(of_pixel > 8.0 - 2.0 / area, "{width}: {of_pixel}");
        }
        let counts = [
            0.0,
            0.1225,
            0.25,
            0.5,
            0.74,
            0.75,
            1.0,
            4.0,
            f64::INFINITY,
            f64::NAN,
        ];
        let of = counts.map(|area| shared.of(&want(2, area)));
        assert_eq!(of, [1, 1, 2, 4, 4, 6, 8, 8, 8, 1]);
        // A sample is a sample, and where nobody asks for a tile one is enough.
        assert_eq!(shared.with_most(1).of(&want(1, 1.0)), 1);
        assert_eq!(shared.of(&want(0, 1.0)), 1);
        assert_eq!(TexelSamples::each(8).of(&want(1, 0.1)), 8);
    }
}
