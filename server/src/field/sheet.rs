//! The map of a thin sheet of ice: patches, and inside them fibres and a veil.
//!
//! Fibres are falling ice that wind shear draws out: tufts of noise, smeared along bent stream lines (line integral
//! convolution, B. Cabral & L. Leedom 1993), to one side, so that each has a head and a tail.

use super::maps::{MAP_SIZE, equalise};
use super::noise::{octaves, perlin};
use super::patterns::warped;
use rayon::prelude::*;

/// Patches, fibres and veil of a sheet, 0…255, row by row. All repeat.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SheetMaps {
    /// Evenly distributed: a share c of the texels is below 255 c. Read over the map's span.
    pub patches: Vec<u8>,
    /// Read over the fibres' period, drawn out along x.
    pub fibres: Vec<u8>,
    /// Nearly even; read as the fibres are.
    pub veil: Vec<u8>,
}

const SIZE: usize = MAP_SIZE as usize;
/// Texels that a tuft is drawn out over; weights fall to 1/e over a third of it.
const TAIL_TEXELS: usize = 350;

fn smooth(at: [f32; 3], frequency: u32, count: u32, gain: f32, seed: u32) -> f32 {
    octaves(perlin, at, frequency, count, gain, seed)
}

/// A value for every texel, from its place in periods.
fn each(value: impl Fn([f32; 3]) -> f32 + Sync, done: &(impl Fn() + Sync)) -> Vec<f32> {
    (0..SIZE)
        .into_par_iter()
        .flat_map_iter(|row| {
            done();
            let value = &value;
            (0..SIZE).map(move |column| {
                value([
                    (column as f32 + 0.5) / SIZE as f32,
                    (row as f32 + 0.5) / SIZE as f32,
                    0.25,
                ])
            })
        })
        .collect()
}

/// A map's value at a place in texels, repeating, between its texels.
fn read(map: &[f32], x: f32, y: f32) -> f32 {
    let (x0, y0) = (x.floor(), y.floor());
    let (fx, fy) = (x - x0, y - y0);
    let wrap = |v: f32| (v as i64).rem_euclid(SIZE as i64) as usize;
    let (x0, y0) = (wrap(x0), wrap(y0));
    let (x1, y1) = ((x0 + 1) % SIZE, (y0 + 1) % SIZE);
    let row = |y: usize| map[y * SIZE + x0] * (1.0 - fx) + map[y * SIZE + x1] * fx;
    row(y0) * (1.0 - fy) + row(y1) * fy
}

/// A map drawn out along stream lines whose slopes are given, with weights that fall behind each place.
fn drawn_out(map: &[f32], slopes: &[f32], done: &(impl Fn() + Sync)) -> Vec<f32> {
    (0..SIZE)
        .into_par_iter()
        .flat_map_iter(|row| {
            done();
            (0..SIZE).map(move |column| {
                let (mut x, mut y) = (column as f32, row as f32);
                let (mut sum, mut weights) = (0.0, 0.0);
                for step in 0..TAIL_TEXELS {
                    let weight = (-3.0 * step as f32 / TAIL_TEXELS as f32).exp();
                    sum += weight * read(map, x, y);
                    weights += weight;
                    let slope = read(slopes, x, y);
                    let length = (1.0 + slope * slope).sqrt();
                    x -= 1.0 / length;
                    y -= slope / length;
                }
                sum / weights
            })
        })
        .collect()
}

/// Values stretched so that the given shares of them lie at 0 and 255, raised to a power between.
fn stretched(values: &[f32], shares: [f64; 2], power: f32) -> Vec<u8> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let [low, high] = shares.map(|share| sorted[((sorted.len() - 1) as f64 * share) as usize]);
    let width = (high - low).max(1e-6);
    values
        .iter()
        .map(|v| (((v - low) / width).clamp(0.0, 1.0).powf(power) * 255.0).round() as u8)
        .collect()
}

impl SheetMaps {
    /// Makes the maps; `progress` is called five times per row, from any thread.
    #[must_use]
    pub fn generate(seed: u32, progress: impl Fn() + Sync) -> Self {
        let done = &progress;
        let patches = each(
            |at| smooth(warped(at, 3, 0.06, seed), 3, 5, 0.5, seed ^ 0x77),
            done,
        );
        let slopes = each(|at| 1.8 * smooth(at, 3, 2, 0.45, seed ^ 0x99), done);
        // Tufts stand in clusters and are of several sizes.
        let tufts = each(
            |at| {
                let clusters = 0.3 + 1.5 * smooth(at, 5, 3, 0.6, seed ^ 0x21);
                let grain = smooth(at, 48, 4, 0.8, seed ^ 0x42);
                (clusters.max(0.0) * (grain + 0.25)).max(0.0)
            },
            done,
        );
        let fibres = drawn_out(&tufts, &slopes, done);
        let veil = each(
            |at| {
                let bent = warped(at, 4, 0.04, seed);
                smooth(bent, 4, 5, 0.55, seed ^ 0x63)
            },
            done,
        );
        let mixed: Vec<f32> = veil
            .iter()
            .zip(&fibres)
            .map(|(veil, fibre)| 2.0 + veil + 0.5 * fibre)
            .collect();
        Self {
            patches: equalise(&patches),
            fibres: stretched(&fibres, [0.3, 0.995], 1.6),
            veil: veil_texels(&mixed),
        }
    }
}

/// A veil never tears: its thinnest places have half the density of its thickest.
fn veil_texels(values: &[f32]) -> Vec<u8> {
    stretched(values, [0.01, 0.99], 1.0)
        .into_iter()
        .map(|v| 127 + v / 2)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fibres_are_longer_than_wide() {
        let maps = SheetMaps::generate(1, || {});
        let at = |x: usize, y: usize| f64::from(maps.fibres[(y % SIZE) * SIZE + x % SIZE]);
        let change = |dx: usize, dy: usize| -> f64 {
            (0..SIZE * SIZE)
                .step_by(37)
                .map(|i| (at(i % SIZE + dx, i / SIZE + dy) - at(i % SIZE, i / SIZE)).abs())
                .sum()
        };
        assert!(change(0, 6) > 1.5 * change(6, 0));
    }
}
