//! Means and standard errors that can be merged.

use crate::{RayResult, StandardErrors};
use glam::DVec3;
use serde::Serialize;

/// Mean and sum of squared deviations of a count of samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Mean {
    /// How many samples.
    pub count: u64,
    /// Their mean.
    pub mean: f64,
    /// Σ (x − mean)².
    pub squared_deviations: f64,
}

impl Mean {
    /// Takes in one sample (B. Welford 1962).
    pub fn add(&mut self, value: f64) {
        self.count += 1;
        let off = value - self.mean;
        self.mean += off / self.count as f64;
        self.squared_deviations += off * (value - self.mean);
    }

    /// Takes in the samples of another (T. Chan, G. Golub & R. LeVeque 1979). The order of merging changes the last bits:
    /// merge in a fixed one.
    pub fn merge(&mut self, other: &Self) {
        if other.count == 0 {
            return;
        }
        if self.count == 0 {
            *self = *other;
            return;
        }
        let (a, b) = (self.count as f64, other.count as f64);
        let off = other.mean - self.mean;
        self.count += other.count;
        let all = self.count as f64;
        self.mean += off * b / all;
        self.squared_deviations += other.squared_deviations + off * off * a * b / all;
    }

    /// Standard error of the mean; infinite below two samples.
    #[must_use]
    pub fn standard_error(&self) -> f64 {
        if self.count < 2 {
            return f64::INFINITY;
        }
        let count = self.count as f64;
        (self.squared_deviations.max(0.0) / (count * (count - 1.0))).sqrt()
    }
}

/// What the samples of a ray have shown so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Moments {
    /// Radiance per channel.
    pub radiance: [Mean; 3],
    /// Its part that was scattered exactly once, from the sun.
    pub single_scattered: [Mean; 3],
    /// Transmittance.
    pub transmittance: Mean,
    /// Optical depth; from some of the samples only.
    pub optical_depth: Mean,
    /// Evaluations of density.
    pub evaluations: u64,
    /// Scatterings.
    pub scatterings: u64,
    /// Paths that the safety limit has cut: if not 0, the result is too dark.
    pub cut_paths: u64,
    /// Places where density was above its upper bound: if not 0, the result is wrong.
    pub above_majorant: u64,
}

impl Moments {
    /// Takes in other samples of the same ray. Merge in a fixed order, for the same bits whoever traced what.
    pub fn merge(&mut self, other: &Self) {
        for channel in 0..3 {
            self.radiance[channel].merge(&other.radiance[channel]);
            self.single_scattered[channel].merge(&other.single_scattered[channel]);
        }
        self.transmittance.merge(&other.transmittance);
        self.optical_depth.merge(&other.optical_depth);
        self.evaluations += other.evaluations;
        self.scatterings += other.scatterings;
        self.cut_paths += other.cut_paths;
        self.above_majorant += other.above_majorant;
    }

    /// How many samples.
    #[must_use]
    pub fn samples(&self) -> u64 {
        self.transmittance.count
    }

    /// Means and standard errors.
    #[must_use]
    pub fn result(&self) -> RayResult {
        let mean = |m: &[Mean; 3]| DVec3::from_array(m.map(|m| m.mean));
        let error = |m: &[Mean; 3]| DVec3::from_array(m.map(|m| m.standard_error()));
        RayResult {
            radiance: mean(&self.radiance),
            single_scattered: mean(&self.single_scattered),
            transmittance: self.transmittance.mean,
            optical_depth: self.optical_depth.mean,
            steps: self.evaluations,
            standard_error: StandardErrors {
                radiance: error(&self.radiance),
                single_scattered: error(&self.single_scattered),
                transmittance: self.transmittance.standard_error(),
                optical_depth: self.optical_depth.standard_error(),
            },
            layers: Vec::new(),
        }
    }

    pub(super) fn add(&mut self, radiance: DVec3, single_scattered: DVec3, transmittance: f64) {
        for channel in 0..3 {
            self.radiance[channel].add(radiance[channel]);
            self.single_scattered[channel].add(single_scattered[channel]);
        }
        self.transmittance.add(transmittance);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn merged_means_are_those_of_all_samples() {
        let values: Vec<f64> = (0..100).map(|i| f64::from(i).sin() + 5.0).collect();
        let (mut all, mut front, mut back) = (Mean::default(), Mean::default(), Mean::default());
        for (i, value) in values.iter().enumerate() {
            all.add(*value);
            if i < 37 { &mut front } else { &mut back }.add(*value);
        }
        front.merge(&back);
        assert!((front.mean - all.mean).abs() < 1e-13);
        assert!((front.standard_error() - all.standard_error()).abs() < 1e-14);
        let mean = values.iter().sum::<f64>() / 100.0;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 99.0;
        assert!((all.standard_error() - (variance / 100.0).sqrt()).abs() < 1e-14);
    }
}
