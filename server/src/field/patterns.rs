//! What coverage and type maps look like before they are equalised. All of them repeat after the map's span.

use super::noise::{billow, octaves, perlin};
use skycell_protocol::scene::WeatherPattern;

/// Gradient noise of a few octaves.
fn smooth(at: [f32; 3], frequency: u32, count: u32, gain: f32, seed: u32) -> f32 {
    octaves(perlin, at, frequency, count, gain, seed)
}

/// A place moved by gradient noise, in periods: what wind does to rows.
pub(super) fn warped(at: [f32; 3], frequency: u32, strength: f32, seed: u32) -> [f32; 3] {
    let by = |seed: u32| strength * smooth(at, frequency, 2, 0.5, seed);
    [at[0] + by(seed ^ 0x5a5a), at[1] + by(seed ^ 0xa5a5), at[2]]
}

/// Coverage before it is equalised; `at` is in periods.
pub(super) fn coverage(pattern: WeatherPattern, at: [f32; 3], seed: u32) -> f32 {
    match pattern {
        // Cells of clouds in several sizes, gathered by broad gradient noise.
        WeatherPattern::Puffs => {
            let cells = octaves(billow, at, 12, 3, 0.5, seed);
            cells + 0.55 * smooth(at, 3, 4, 0.55, seed ^ 0x77)
        }
        // Cells that are longer than wide and lie across the map's y, bent.
        WeatherPattern::Rolls => {
            let bent = warped(at, 4, 0.035, seed);
            let cells = |along: u32, across: u32, seed: u32| {
                let place = [bent[0] * along as f32, bent[1] * across as f32, 0.25];
                billow(place, [along, across, 1], seed)
            };
            let rolls = 0.7 * cells(18, 30, seed) + 0.3 * cells(40, 66, seed ^ 0x31);
            rolls + 0.3 * smooth(at, 4, 3, 0.5, seed ^ 0x77)
        }
        // Rows of small cells, in fields with gaps between.
        WeatherPattern::Ripples => {
            let bent = warped(at, 5, 0.03, seed);
            let cells = |along: u32, across: u32, seed: u32| {
                let place = [bent[0] * along as f32, bent[1] * across as f32, 0.25];
                billow(place, [along, across, 1], seed)
            };
            let row = (bent[1] * 52.0 * std::f32::consts::TAU).cos();
            let ripples = cells(44, 52, seed) + 0.3 * cells(75, 97, seed ^ 0x31) + 0.25 * row;
            ripples + 0.9 * smooth(at, 3, 4, 0.5, seed ^ 0x77)
        }
        WeatherPattern::Veils => smooth(at, 3, 5, 0.45, seed),
    }
}

/// Type before it is equalised: the product of two cell sizes, so few places are tall.
pub(super) fn cloud_type(at: [f32; 3], seed: u32) -> f32 {
    billow(at.map(|v| v * 7.0), 7, seed ^ 0x3131) * billow(at.map(|v| v * 16.0), 16, seed ^ 0x1313)
}
