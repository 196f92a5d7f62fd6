//! At which heights of a layer its cloud is, and how to cut it into slabs.

use super::maps::COVERAGE_SOFTNESS;
use super::profile::vertical_profile;
use skycell_protocol::scene::WeatherDensity;

/// Slices of a layer's height.
const SLICES: usize = 64;
/// Places of the coverage map, of the type map and of the shape noise over which density is averaged.
const COVERAGES: u32 = 16;
const TYPES: u32 = 4;
const NOISES: u32 = 8;
/// Of all cloud, what may lie outside of the heights in which it is looked for.
const OUTSIDE: f64 = 1e-3;
/// Rounds after which cuts have settled.
const ROUNDS: u32 = 64;

/// How much cloud there is at each height of a layer, as shares of all.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudHeights([f64; SLICES]);

/// A slab in height fractions of its layer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slab {
    /// From where to where.
    pub between: [f64; 2],
    /// Mean height of its cloud.
    pub mean: f64,
}

impl CloudHeights {
    /// The same at all heights.
    #[must_use]
    pub fn even() -> Self {
        Self([1.0 / SLICES as f64; SLICES])
    }

    /// Of a weather layer: the mean of what noise leaves of the dimensional profile (`cloud/density.wgsl`) over maps whose
    /// values are evenly distributed, as generated ones are, and over noise that is. Profiles from files count as the
    /// group's own.
    #[must_use]
    pub fn of(weather: &WeatherDensity) -> Self {
        let form = weather.form();
        let threshold = 1.0 - (1.0 + COVERAGE_SOFTNESS) * weather.coverage();
        let middle = |i: u32, count: u32| (f64::from(i) + 0.5) / f64::from(count);
        let mut cloud = [0.0; SLICES];
        for u in (0..COVERAGES).map(|i| middle(i, COVERAGES)) {
            let coverage = ((u - threshold) / COVERAGE_SOFTNESS).clamp(0.0, 1.0);
            if coverage == 0.0 {
                continue;
            }
            for w in (0..TYPES).map(|i| middle(i, TYPES)) {
                let of_map = 1.0 - form.type_spread + form.type_spread * w;
                let of_dome = 1.0 - form.dome + form.dome * coverage;
                let cloud_type = (weather.cloud_type() * of_map).min(1.0) * of_dome;
                for (slice, sum) in cloud.iter_mut().enumerate() {
                    let height = (slice as f64 + 0.5) / SLICES as f64;
                    let profile = coverage
                        * vertical_profile(weather.profile(), cloud_type.clamp(0.0, 1.0), height);
                    for noise in (0..NOISES).map(|i| middle(i, NOISES)) {
                        let surface = form.shape_floor + form.shape_range * noise - (1.0 - profile);
                        *sum += (surface * form.steepness).clamp(0.0, 1.0);
                    }
                }
            }
        }
        let all: f64 = cloud.iter().sum();
        if all > 0.0 {
            Self(cloud.map(|sum| sum / all))
        } else {
            Self::even()
        }
    }

    /// Heights between which all cloud is but for a thousandth, and a slice more on either side.
    #[must_use]
    pub fn seen_between(&self) -> [f64; 2] {
        let outside_from = |slices: &mut dyn Iterator<Item = &f64>| {
            let mut sum = 0.0;
            let outside = slices.take_while(|share| {
                sum += **share;
                sum < 0.5 * OUTSIDE
            });
            outside.count().saturating_sub(1) as f64 / SLICES as f64
        };
        let low = outside_from(&mut self.0.iter());
        let high = 1.0 - outside_from(&mut self.0.iter().rev());
        [low, high]
    }

    /// So many slabs that meet and fill the layer, from the lowest on: each around the mean height of its cloud, cut half
    /// the way between two means. So the mean square of how far cloud is from the mean of its slab is least (S. Lloyd, "Least
    /// Squares Quantization in PCM", 1982): seen beside a reference from a sphere there, it is off by that.
    #[must_use]
    pub fn slabs(&self, count: u32) -> Vec<Slab> {
        let count = count.max(1);
        let [low, high] = self.seen_between();
        let mut cuts: Vec<f64> = (1..count)
            .map(|i| low + (high - low) * f64::from(i) / f64::from(count))
            .collect();
        let mut slabs = self.between(&cuts);
        for _ in 0..ROUNDS {
            cuts = slabs
                .windows(2)
                .map(|pair| 0.5 * (pair[0].mean + pair[1].mean))
                .collect();
            slabs = self.between(&cuts);
        }
        slabs
    }

    fn between(&self, cuts: &[f64]) -> Vec<Slab> {
        let ends = std::iter::once(0.0)
            .chain(cuts.iter().copied())
            .chain([1.0])
            .collect::<Vec<f64>>();
        ends.windows(2)
            .map(|ends| Slab {
                between: [ends[0], ends[1]],
                mean: self.mean_between(ends[0], ends[1]),
            })
            .collect()
    }

    /// Mean height of the cloud between two heights; the middle where there is none.
    fn mean_between(&self, low: f64, high: f64) -> f64 {
        let (mut weighted, mut sum) = (0.0, 0.0);
        for (slice, share) in self.0.iter().enumerate() {
            let [from, to] =
                [slice, slice + 1].map(|end| (end as f64 / SLICES as f64).clamp(low, high));
            let part = share * (to - from);
            weighted += part * 0.5 * (from + to);
            sum += part;
        }
        if sum > 0.0 {
            weighted / sum
        } else {
            0.5 * (low + high)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use skycell_protocol::Scene;
    use skycell_protocol::scene::DensityModel;

    fn heights(cloud_type: f64, coverage: f64) -> CloudHeights {
        let document = json!({"version": 1, "layers": [{"name": "a",
            "density": {"model": "weather", "type": cloud_type, "coverage": coverage}}]});
        let scene = Scene::from_json(&document).expect("valid");
        match scene.layers()[0].density() {
            DensityModel::Weather(weather) => CloudHeights::of(weather),
            _ => unreachable!("weather was asked for"),
        }
    }

    /// Mean square of how far cloud is from its slab's mean.
    fn spread(heights: &CloudHeights, slabs: &[Slab]) -> f64 {
        let off = |height: f64| {
            let slab = slabs.iter().find(|s| height < s.between[1]);
            slab.map_or(1.0, |s| (height - s.mean).powi(2))
        };
        let shares = heights.0.iter().enumerate();
        shares
            .map(|(i, share)| share * off((i as f64 + 0.5) / SLICES as f64))
            .sum()
    }

    #[test]
    fn slabs_fill_the_layer_and_are_cut_where_the_clouds_are() {
        for (cloud_type, coverage) in [(0.0, 1.0), (0.3, 0.5), (0.7, 0.45), (1.0, 0.2)] {
            let heights = heights(cloud_type, coverage);
            for count in 1..=4u32 {
                let slabs = heights.slabs(count);
                assert_eq!(slabs.len(), count as usize);
                assert_eq!(slabs[0].between[0], 0.0);
                assert_eq!(slabs[count as usize - 1].between[1], 1.0);
                for slab in &slabs {
                    let [low, high] = slab.between;
                    assert!(low < slab.mean && slab.mean < high, "{slabs:?}");
                }
                for pair in slabs.windows(2) {
                    assert_eq!(pair[0].between[1], pair[1].between[0]);
                }
                // Better than slabs of even thickness.
                let even: Vec<f64> = (1..count)
                    .map(|i| f64::from(i) / f64::from(count))
                    .collect();
                let even = heights.between(&even);
                assert!(
                    spread(&heights, &slabs) <= spread(&heights, &even) + 1e-4,
                    "{slabs:?}"
                );
            }
        }
    }

    #[test]
    fn even_cloud_is_cut_evenly() {
        for (slab, expected) in CloudHeights::even()
            .slabs(4)
            .iter()
            .zip([0.125, 0.375, 0.625, 0.875])
        {
            assert!((slab.mean - expected).abs() < 1e-6, "{slab:?}");
        }
    }

    #[test]
    fn cloud_is_looked_for_where_it_is() {
        assert_eq!(CloudHeights::even().seen_between(), [0.0, 1.0]);
        // Small heaps end below the top of their layer, storms reach it.
        let [low, high] = heights(0.5, 0.45).seen_between();
        assert!(low < 0.05 && (0.6..0.85).contains(&high), "{low} {high}");
        let [_, high] = heights(1.0, 0.5).seen_between();
        assert!(high > 0.95, "{high}");
    }
}
