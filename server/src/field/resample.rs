//! Maps of any size brought to the size that the device reads.

use super::map_file::GreyMap;
use super::maps::MAP_SIZE;
use super::profile::PROFILE_SIZE;
use rayon::prelude::*;
use skycell_protocol::scene::MapKind;

/// What lies beyond the last texel of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Edge {
    /// The first one: the map tiles.
    Wrap,
    /// The last one goes on.
    Clamp,
}

/// For every texel of a line of `to`, which of `from` make it and by which share. More texels are averaged over the area
/// of the new one; fewer are interpolated between their middles, as a sampler would.
fn shares(from: u32, to: u32, edge: Edge) -> Vec<Vec<(usize, f64)>> {
    let per_texel = f64::from(from) / f64::from(to);
    (0..to)
        .map(|index| {
            if from >= to {
                let (low, high) = (
                    f64::from(index) * per_texel,
                    f64::from(index + 1) * per_texel,
                );
                (low.floor() as u32..(high.ceil() as u32).min(from))
                    .map(|i| {
                        let overlap = high.min(f64::from(i + 1)) - low.max(f64::from(i));
                        (i as usize, overlap.max(0.0) / per_texel)
                    })
                    .collect()
            } else {
                let at = (f64::from(index) + 0.5) * per_texel - 0.5;
                let below = at.floor();
                let neighbour = |i: f64| match edge {
                    Edge::Wrap => i.rem_euclid(f64::from(from)) as usize,
                    Edge::Clamp => i.clamp(0.0, f64::from(from - 1)) as usize,
                };
                let share = at - below;
                vec![
                    (neighbour(below), 1.0 - share),
                    (neighbour(below + 1.0), share),
                ]
            }
        })
        .collect()
}

fn resampled(map: &GreyMap, width: u32, height: u32, edge: Edge) -> Vec<f32> {
    let along = shares(map.width, width, edge);
    let down = shares(map.height, height, edge);
    let sum = |value: &dyn Fn(usize) -> f32, parts: &[(usize, f64)]| {
        parts
            .iter()
            .map(|(index, share)| f64::from(value(*index)) * share)
            .sum::<f64>() as f32
    };
    let narrow: Vec<f32> = map
        .values
        .par_chunks(map.width as usize)
        .flat_map_iter(|row| along.iter().map(move |parts| sum(&|i| row[i], parts)))
        .collect();
    let width = width as usize;
    down.par_iter()
        .flat_map_iter(|parts| {
            let narrow = &narrow;
            (0..width).map(move |x| sum(&|i| narrow[i * width + x], parts))
        })
        .collect()
}

fn unit_u16(value: f32) -> u16 {
    (value.clamp(0.0, 1.0) * 65_535.0).round() as u16
}

/// A map as the device reads it, in 65 535ths: coverage and type of [`MAP_SIZE`] along both sides, the profile's heights
/// along a row and its types down the rows, [`PROFILE_SIZE`].
#[must_use]
pub(super) fn device_texels(map: &GreyMap, kind: MapKind) -> Vec<u16> {
    if kind != MapKind::Profile {
        let values = resampled(map, MAP_SIZE, MAP_SIZE, Edge::Wrap);
        return values.into_par_iter().map(unit_u16).collect();
    }
    let [heights, types] = PROFILE_SIZE;
    let upright = resampled(map, types, heights, Edge::Clamp);
    (0..types as usize)
        .flat_map(|t| {
            let upright = &upright;
            (0..heights as usize)
                .map(move |h| unit_u16(upright[(heights as usize - 1 - h) * types as usize + t]))
        })
        .collect()
}

/// The picture of what the device reads: the inverse of [`device_texels`] for a map of the device's size.
#[must_use]
pub(super) fn picture_of(texels: &[u16], kind: MapKind) -> GreyMap {
    let value = |texel: u16| f32::from(texel) / 65_535.0;
    if kind != MapKind::Profile {
        return GreyMap {
            width: MAP_SIZE,
            height: MAP_SIZE,
            values: texels.iter().map(|texel| value(*texel)).collect(),
        };
    }
    let [heights, types] = PROFILE_SIZE.map(|n| n as usize);
    GreyMap {
        width: types as u32,
        height: heights as u32,
        values: (0..heights)
            .flat_map(|row| (0..types).map(move |t| value(texels[t * heights + heights - 1 - row])))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(width: u32, height: u32, value: impl Fn(u32, u32) -> f32) -> GreyMap {
        GreyMap {
            width,
            height,
            values: (0..height)
                .flat_map(|y| (0..width).map(move |x| (x, y)))
                .map(|(x, y)| value(x, y))
                .collect(),
        }
    }

    #[test]
    fn maps_of_the_devices_size_are_taken_as_they_are() {
        let value = |x: u32, y: u32| f32::from(((x * 31 + y * 977) % 65_536) as u16) / 65_535.0;
        let exact = map(MAP_SIZE, MAP_SIZE, value);
        let texels = device_texels(&exact, MapKind::Coverage);
        assert_eq!(picture_of(&texels, MapKind::Coverage), exact);
        let [heights, types] = PROFILE_SIZE;
        let exact = map(types, heights, value);
        let texels = device_texels(&exact, MapKind::Profile);
        assert_eq!(picture_of(&texels, MapKind::Profile), exact);
        // The first row of texels is type 0 from the base up: the picture's left column from the bottom up.
        assert_eq!(
            f32::from(texels[1]) / 65_535.0,
            exact.values[((heights - 2) * types) as usize]
        );
    }

    #[test]
    fn any_size_keeps_its_mean_its_bounds_and_its_constants() {
        let value = |x: u32, y: u32| ((x * 7 + y * 13) % 11) as f32 / 10.0;
        for (width, height) in [(1, 1), (1, 8192), (2048, 1024), (1500, 3), (8192, 1)] {
            let drawn = map(width, height, value);
            let texels = device_texels(&drawn, MapKind::Coverage);
            let mean = texels.iter().map(|t| f64::from(*t)).sum::<f64>()
                / (texels.len() as f64 * 65_535.0);
            let truth =
                drawn.values.iter().map(|v| f64::from(*v)).sum::<f64>() / drawn.values.len() as f64;
            // Linear interpolation of a wrapped line keeps its mean where the new size is a multiple of the old one, and
            // nearly so elsewhere.
            assert!(
                (mean - truth).abs() < 2e-3,
                "{width} x {height}: {mean} {truth}"
            );
            for constant in [0.0, 0.5, 1.0] {
                let texels = device_texels(&map(width, height, |_, _| constant), MapKind::Coverage);
                let expected = unit_u16(constant);
                assert!(texels.iter().all(|t| *t == expected), "{width} x {height}");
            }
        }
    }

    #[test]
    fn a_small_map_is_interpolated_across_its_edges() {
        // Two texels, 0 and 1: the wrapped line is a triangle with its ends at the middles of both.
        let texels = device_texels(&map(2, 1, |x, _| x as f32), MapKind::Coverage);
        for (x, texel) in texels.iter().take(MAP_SIZE as usize).enumerate() {
            let u = (x as f64 + 0.5) / f64::from(MAP_SIZE);
            let from_middle = (u - 0.75).rem_euclid(1.0);
            let truth = 1.0 - 2.0 * from_middle.min(1.0 - from_middle);
            assert!(
                (f64::from(*texel) / 65_535.0 - truth).abs() < 1e-5,
                "{x}: {texel} {truth}"
            );
        }
    }
}
