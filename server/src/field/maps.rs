//! Coverage and type maps of a weather layer, made from noise in the manner of P. Ford 2024, 4.2.1, and the distance to
//! the nearest possible cloud, which lets a ray cross clear sky in one step.

use super::layer_maps::MapFormat;
use super::patterns::{cloud_type, coverage};
use rayon::prelude::*;
use skycell_protocol::scene::WeatherPattern;

/// Texels along a map.
pub const MAP_SIZE: u32 = 1024;

/// Share of the layer's map that the skip channel reaches at 1: a quarter of the span.
pub const SKIP_RANGE_SHARE: f64 = 0.25;

/// As in `cloud/density.wgsl`.
pub(super) const COVERAGE_SOFTNESS: f64 = 0.55;

/// Coverage and type of a layer before the layer's own settings, 0…255, row by row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WeatherMaps {
    /// Evenly distributed: a share c of the texels is below 255 c.
    pub coverage: Vec<u8>,
    /// 0 flat … 255 tall.
    pub cloud_type: Vec<u8>,
}

impl WeatherMaps {
    /// Makes both maps; `progress` is called per finished row, from any thread.
    #[must_use]
    pub fn generate(pattern: WeatherPattern, seed: u32, progress: impl Fn() + Sync) -> Self {
        let rows: Vec<Vec<[f32; 2]>> = (0..MAP_SIZE)
            .into_par_iter()
            .map(|row| {
                let line = (0..MAP_SIZE)
                    .map(|column| {
                        let at = [
                            (column as f32 + 0.5) / MAP_SIZE as f32,
                            (row as f32 + 0.5) / MAP_SIZE as f32,
                            0.25,
                        ];
                        [coverage(pattern, at, seed), cloud_type(at, seed)]
                    })
                    .collect();
                progress();
                line
            })
            .collect();
        let values: Vec<[f32; 2]> = rows.into_iter().flatten().collect();
        Self {
            coverage: equalise(&values.iter().map(|v| v[0]).collect::<Vec<_>>()),
            cloud_type: equalise(&values.iter().map(|v| v[1]).collect::<Vec<_>>()),
        }
    }
}

/// Replaces each value by its rank, so that a threshold is a share of the area.
pub(super) fn equalise(values: &[f32]) -> Vec<u8> {
    let mut order: Vec<u32> = (0..values.len() as u32).collect();
    order.sort_unstable_by(|a, b| values[*a as usize].total_cmp(&values[*b as usize]));
    let mut ranks = vec![0u8; values.len()];
    for (rank, index) in order.into_iter().enumerate() {
        ranks[index as usize] = (rank * 256 / values.len()) as u8;
    }
    ranks
}

/// Smallest map value at which a layer of this coverage can hold cloud.
fn threshold(layer_coverage: f64) -> f64 {
    1.0 + (-COVERAGE_SOFTNESS - 1.0) * layer_coverage
}

/// What the skip channel counts to.
pub(super) const SKIP_LEVELS: u8 = 255;

/// Layer coverages are taken up to the next of so many steps before skips are made, so that a coverage that grows slowly
/// asks for new ones seldom. Less is skipped then, never too much.
const SKIP_COVERAGE_STEPS: f64 = 64.0;

/// The coverage that skips are made for: not below the layer's own.
#[must_use]
pub fn skip_coverage(layer_coverage: f64) -> f64 {
    (layer_coverage * SKIP_COVERAGE_STEPS).ceil() / SKIP_COVERAGE_STEPS
}

/// Distance from every texel to the nearest place that can hold cloud, in 255ths of a quarter of the map's span,
/// rounded down and shortened by what bilinear reads of both maps may add, so that a ray never steps into a cloud.
/// `coverage` is in 65 535ths, read in `format`; the layer's own is taken up to [`skip_coverage`].
#[must_use]
pub fn skip_distances(coverage: &[u16], format: MapFormat, layer_coverage: f64) -> Vec<u8> {
    let limit = threshold(skip_coverage(layer_coverage));
    let size = MAP_SIZE as usize;
    let range = (SKIP_RANGE_SHARE * f64::from(MAP_SIZE)) as usize;
    let far = (range * range) as f32;
    let seeds: Vec<f32> = coverage
        .iter()
        .map(|c| {
            if f64::from(format.value(*c)) > limit {
                0.0
            } else {
                far
            }
        })
        .collect();
    // Squared distances, first along rows, then along columns (P. Felzenszwalb & D. Huttenlocher 2012).
    let rows: Vec<f32> = seeds
        .par_chunks(size)
        .flat_map_iter(|row| squared_distances(row, range))
        .collect();
    let columns: Vec<Vec<f32>> = (0..size)
        .into_par_iter()
        .map(|x| {
            let column: Vec<f32> = (0..size).map(|y| rows[y * size + x]).collect();
            squared_distances(&column, range).collect()
        })
        .collect();
    // A bilinear read of distances is at most √½ texels too far, a bilinear read of coverage reaches √2 texels out.
    let margin = std::f32::consts::FRAC_1_SQRT_2 + std::f32::consts::SQRT_2;
    (0..size * size)
        .map(|i| {
            let texels = (columns[i % size][i / size].min(far).sqrt() - margin).max(0.0);
            (texels / range as f32 * f32::from(SKIP_LEVELS)).floor() as u8
        })
        .collect()
}

/// Lower envelope of parabolas along one wrapped line.
fn squared_distances(line: &[f32], range: usize) -> impl Iterator<Item = f32> + use<> {
    let size = line.len();
    let padded: Vec<f32> = (0..size + 2 * range)
        .map(|i| line[(i + size - range % size) % size])
        .collect();
    let mut vertices = vec![0usize; padded.len()];
    let mut bounds = vec![f32::NEG_INFINITY; padded.len() + 1];
    let mut top = 0;
    for q in 1..padded.len() {
        let crossing = |v: usize| {
            let (qf, vf) = (q as f32, v as f32);
            ((padded[q] + qf * qf) - (padded[v] + vf * vf)) / (2.0 * (qf - vf))
        };
        let mut s = crossing(vertices[top]);
        while top > 0 && s <= bounds[top] {
            top -= 1;
            s = crossing(vertices[top]);
        }
        top += 1;
        vertices[top] = q;
        bounds[top] = s;
    }
    bounds[top + 1] = f32::INFINITY;
    let mut at = 0;
    (range..range + size)
        .map(|q| {
            while bounds[at + 1] < q as f32 {
                at += 1;
            }
            let v = vertices[at];
            let d = q as f32 - v as f32;
            d * d + padded[v]
        })
        .collect::<Vec<_>>()
        .into_iter()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_cloud(at: (usize, usize)) -> Vec<u16> {
        let size = MAP_SIZE as usize;
        let mut coverage = vec![0u16; size * size];
        coverage[at.1 * size + at.0] = u16::MAX;
        coverage
    }

    #[test]
    fn skips_never_reach_a_cloud() {
        let size = MAP_SIZE as usize;
        let (cx, cy) = (10usize, 1000usize);
        let skips = skip_distances(&one_cloud((cx, cy)), MapFormat::Bytes, 0.5);
        for y in (0..size).step_by(7) {
            for x in (0..size).step_by(5) {
                let wrap = |a: usize, b: usize| {
                    let d = a.abs_diff(b);
                    d.min(size - d) as f64
                };
                let truth = wrap(x, cx).hypot(wrap(y, cy));
                let skip = f64::from(skips[y * size + x]) / 255.0 * 256.0;
                assert!(
                    skip <= (truth - 2.1).max(0.0),
                    "({x}, {y}): {skip} of {truth}"
                );
                if truth < 250.0 {
                    assert!(skip >= truth - 4.0, "({x}, {y}): {skip} of {truth}");
                }
            }
        }
    }

    #[test]
    fn full_coverage_leaves_nothing_to_skip_and_none_leaves_everything() {
        let coverage = vec![10 * 257u16; (MAP_SIZE * MAP_SIZE) as usize];
        for format in [MapFormat::Bytes, MapFormat::Halves] {
            let skips = |layer_coverage| skip_distances(&coverage, format, layer_coverage);
            assert!(skips(1.0).iter().all(|s| *s == 0));
            assert!(skips(0.0).iter().all(|s| *s > 250));
        }
    }

    #[test]
    fn a_threshold_on_coverage_is_a_share_of_the_area() {
        let maps = WeatherMaps::generate(WeatherPattern::Puffs, 3, || {});
        let below = maps.coverage.iter().filter(|c| **c < 64).count();
        let share = below as f64 / maps.coverage.len() as f64;
        assert!((share - 0.25).abs() < 0.005, "{share}");
    }
}
