//! The blue noise that moves the samples of a temporal window: neighbours differ as much as they can, so that what a frame
//! lacks is seen as fine grain and goes away in the mean over a few pixels.

/// Columns and rows.
pub const BLUE_NOISE_SIZE: u32 = 64;

/// Three masks, for x, y and depth, made by void and cluster (R. Ulichney, 1993) with σ = 1.5 pixels on a torus:
/// `cargo run --release --example blue_noise -- server/data/blue_noise_64.png`.
const BLUE_NOISE_PNG: &[u8] = include_bytes!("../../data/blue_noise_64.png");

/// The masks as the shaders read them: 8 bits of x, y and depth in one word per pixel, row by row. Empty only when the file
/// that is compiled in is no picture, which a test shows that it is not.
#[must_use]
pub fn blue_noise_words() -> Vec<u32> {
    let Ok(picture) = image::load_from_memory(BLUE_NOISE_PNG) else {
        return Vec::new();
    };
    let pixels = picture.to_rgb8();
    pixels
        .pixels()
        .map(|pixel| {
            let [x, y, depth] = pixel.0.map(u32::from);
            x | y << 8 | depth << 16
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(channel: u32) -> Vec<f64> {
        blue_noise_words()
            .iter()
            .map(|word| f64::from(word >> (8 * channel) & 255))
            .collect()
    }

    #[test]
    fn every_value_is_as_frequent_as_every_other() {
        for channel in 0..3 {
            let mut counts = [0u32; 256];
            for value in mask(channel) {
                counts[value as usize] += 1;
            }
            assert!(counts.iter().all(|count| *count == 16));
        }
    }

    /// Mean power of the mask's spectrum at wave numbers up to `radius` round the torus.
    fn power_below(mask: &[f64], radius: i32) -> f64 {
        let size = BLUE_NOISE_SIZE as i32;
        let mean = mask.iter().sum::<f64>() / mask.len() as f64;
        let mut powers = Vec::new();
        for v in 0..=radius {
            for u in -radius..=radius {
                if u * u + v * v > radius * radius || (u, v) == (0, 0) {
                    continue;
                }
                let (mut re, mut im) = (0.0, 0.0);
                for (at, value) in (0..).zip(mask) {
                    let turns = f64::from(u * (at % size) + v * (at / size)) / f64::from(size);
                    let angle = std::f64::consts::TAU * turns;
                    re += (value - mean) * angle.cos();
                    im += (value - mean) * angle.sin();
                }
                powers.push(re * re + im * im);
            }
        }
        powers.iter().sum::<f64>() / powers.len() as f64
    }

    #[test]
    fn the_noise_is_blue() {
        // White noise of 256 even values: each wave has the variance times the number of pixels.
        let white = 4096.0 * (256.0f64.powi(2) - 1.0) / 12.0;
        for channel in 0..3 {
            let share = power_below(&mask(channel), 8) / white;
            assert!(
                share < 0.02,
                "channel {channel} has {share} of white noise's power"
            );
        }
    }

    #[test]
    fn the_masks_have_nothing_to_do_with_each_other() {
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            let products = mask(a).into_iter().zip(mask(b));
            let sum: f64 = products.map(|(a, b)| (a - 127.5) * (b - 127.5)).sum();
            let correlation = sum / 4096.0 / ((256.0f64.powi(2) - 1.0) / 12.0);
            // Three standard errors of 4096 pairs.
            assert!(correlation.abs() < 3.0 / 64.0, "{a} and {b}: {correlation}");
        }
    }
}
