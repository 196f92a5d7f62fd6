//! Random numbers that depend on what they are for alone.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};

/// Random numbers of one sample of one ray.
#[derive(Clone, Debug)]
pub struct Random(Xoshiro256PlusPlus);

/// SplitMix64's finaliser (G. Steele, D. Lea & C. Flood 2014): a bijection whose outputs look unrelated.
fn mixed(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Random {
    /// The numbers of a sample: the same for the same three numbers, whoever asks and when.
    #[must_use]
    pub fn new(seed: u64, ray_index: u64, sample_index: u64) -> Self {
        // Two hashes of all three numbers, so that every word of the state differs from sample to sample and no two
        // samples share a state.
        let one = mixed(sample_index ^ mixed(ray_index ^ mixed(seed)));
        let other = mixed(ray_index ^ mixed(sample_index ^ mixed(!seed)));
        let words = [one, other, mixed(one), mixed(other)];
        let mut bytes = [0; 32];
        for (place, word) in bytes.chunks_exact_mut(8).zip(words) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        Self(Xoshiro256PlusPlus::from_seed(bytes))
    }

    /// Even in [0, 1), 53 bits.
    pub fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Exponential with mean 1.
    pub fn exponential(&mut self) -> f64 {
        // 1 − u is in (0, 1].
        -(1.0 - self.unit()).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of the k-th number of each of many streams, the share below a tenth: its deviations over groups of streams, in
    /// standard errors, must themselves scatter by 1.
    #[test]
    fn numbers_of_different_samples_are_independent() {
        const GROUPS: u64 = 400;
        const SAMPLES: u64 = 4_000;
        for which in 0..3 {
            let mut squares = 0.0;
            for group in 0..GROUPS {
                let below = (0..SAMPLES)
                    .filter(|sample| {
                        let mut random = Random::new(group / 20, group % 20, *sample);
                        for _ in 0..which {
                            random.unit();
                        }
                        random.unit() < 0.1
                    })
                    .count();
                let (n, p) = (SAMPLES as f64, 0.1);
                squares += (below as f64 - n * p).powi(2) / (n * p * (1.0 - p));
            }
            let scatter = squares / GROUPS as f64;
            // The mean of 400 squared normal deviates is 1 ± 0.07.
            assert!((scatter - 1.0).abs() < 0.25, "number {which}: {scatter}");
        }
    }
}
