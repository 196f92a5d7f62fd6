//! How many samples a texel averages.

use super::TEXELS_PER_TILE;
use super::sphere::Want;

/// Where tiles that nobody shares would take more rays for each of a screen-space renderer than this, texels get fewer samples.
const RAYS_MAX: f64 = 1.05;
/// Shares of the pixels' samples that are tried then, until they fit; the last one counts if none does.
const PIXEL_SHARES: [f64; 6] = [1.0, 0.9, 0.8, 0.7, 0.6, 0.5];

/// Samples that texels average.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexelSamples {
    /// So many at most, 1 or more.
    pub most: u32,
    /// Where several texels make a pixel, it is their samples together that are so many, or fewer: what is finer than pixels costs no
    /// more rays than these, and is a little noisier.
    pub by_area: bool,
    /// By area, texels have so much of the pixels' samples together; 1 at most.
    pixel_share: f64,
}

impl TexelSamples {
    /// So many at most, or one.
    #[must_use]
    pub fn new(most: u32, by_area: bool) -> Self {
        Self {
            most: most.max(1),
            by_area,
            pixel_share: 1.0,
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
        Self {
            most: most.max(1),
            ..self
        }
    }

    /// By area, the most with which what each viewer asks for alone, areas of texels in its pixels beside the number of these, costs
    /// hardly more rays than its picture with as many samples. Gutters, and what edges of pictures cut off, are marched on top: where
    /// texels are just as wide as pixels all over a picture, by a long lens, they are a quarter. Who sees the same as another changes
    /// nothing. The coarse level, which is there for whoever turns, is not reckoned.
    #[must_use]
    pub fn fitting<Texels>(self, viewers: impl IntoIterator<Item = (Texels, u64)>) -> Self
    where
        Texels: Iterator<Item = f64> + Clone,
    {
        if !self.by_area {
            return self;
        }
        let mut largest: Option<f64> = None;
        for (texels, pixels) in viewers {
            let share = self.fitting_share(&texels, pixels);
            if share > largest {
                largest = share;
            }
            // There is no larger one, and others have many tiles, too.
            if largest == Some(PIXEL_SHARES[0]) {
                break;
            }
        }
        Self {
            pixel_share: largest.unwrap_or(1.0),
            ..self
        }
    }

    /// None for a viewer who asks for nothing.
    fn fitting_share(
        self,
        texels: &(impl Iterator<Item = f64> + Clone),
        pixels: u64,
    ) -> Option<f64> {
        texels.clone().next()?;
        let rays_max = RAYS_MAX * pixels as f64 * f64::from(self.most);
        let fits = |pixel_share: f64| {
            let samples = Self {
                pixel_share,
                ..self
            };
            let of_tiles: u64 = (texels.clone())
                .map(|texel_pixels| u64::from(samples.of_texel(texel_pixels)))
                .sum();
            (of_tiles * TEXELS_PER_TILE) as f64 <= rays_max
        };
        let least = PIXEL_SHARES[PIXEL_SHARES.len() - 1];
        let fitting = PIXEL_SHARES.into_iter().find(|share| fits(*share));
        Some(fitting.unwrap_or(least))
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
        let share = self.pixel_share * texel_pixels.clamp(0.0, 1.0);
        let pairs = (0.5 * share * f64::from(self.most)).floor();
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

    #[test]
    fn tiles_that_nobody_shares_cost_no_more_rays_than_the_pixels_of_their_viewers() {
        // Texels as wide as pixels by some lens, all over the picture, and a quarter marched on top of them.
        for texel_pixels in [0.3, 0.5, 0.75, 0.8, 1.0, 1.1, 1.25, 2.0, 4.0] {
            let tiles = std::iter::repeat_n(texel_pixels, 400);
            let texels = 400.0 * TEXELS_PER_TILE as f64;
            let pixels = (texels * texel_pixels / 1.25) as u64;
            let all = TexelSamples::new(8, true);
            let fitting = all.fitting([(tiles.clone(), pixels)]);
            let each = fitting.of_texel(texel_pixels);
            let rays = texels * f64::from(each) / (8.0 * pixels as f64);
            assert!(rays <= 1.05, "{texel_pixels}: {rays}");
            // And not much fewer: with two more it would be too many, or all are there.
            let with_more = rays * f64::from(each + 2) / f64::from(each);
            assert!(each == 8 || with_more > 1.0, "{texel_pixels}: {rays}");
            // A second one who sees the same changes nothing, nor does who asks for nothing.
            let none = std::iter::repeat_n(1.0, 0);
            let twice = [(tiles.clone(), pixels), (tiles.clone(), pixels), (none, 1)];
            assert_eq!(all.fitting(twice), fitting);
            // One with a larger picture of the same gets all.
            let larger = [(tiles.clone(), pixels), (tiles, 2 * pixels)];
            assert_eq!(all.fitting(larger), all);
        }
        let wide = |pixels| [(std::iter::once(1.0), pixels)];
        assert_eq!(
            TexelSamples::each(8).fitting(wide(1)),
            TexelSamples::each(8)
        );
        // Where nothing fits, there are still samples.
        assert_eq!(TexelSamples::new(8, true).fitting(wide(1)).of_texel(1.0), 4);
    }
}
