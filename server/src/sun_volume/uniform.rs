//! What shaders read of a volume.

use super::generation::{Generation, Strip};
use glam::DVec2;
use skycell_shaders::layout;

/// The work of a strip, in the frame in which its layer's columns are made.
#[must_use]
pub fn strip_work(volume: &Generation, strip: &Strip) -> layout::SunColumns {
    let size = volume.size();
    let spacing_m = size.spacing_of_level_m(strip.level);
    let [x, z] = strip.columns.min;
    let foot_m = DVec2::new(x as f64 + 0.5, z as f64 + 0.5) * spacing_m;
    let texel = |index: i64| index.rem_euclid(i64::from(size.columns)) as u32;
    let edge = |axis: usize| (strip.columns.max[axis] - strip.columns.min[axis]).max(0) as u32;
    layout::SunColumns {
        direction: volume.direction().as_vec3().to_array(),
        spacing_m: spacing_m as f32,
        first_foot_m: (foot_m - volume.origin_m(strip.layer)).as_vec2().to_array(),
        first_texel: [texel(x), texel(z)],
        columns: [edge(0), edge(1)],
        columns_per_side: size.columns,
        first_slice: first_slice(volume, strip.layer, strip.level),
        slices: size.slices,
        substeps: volume.substeps(strip.layer),
        layer: strip.layer as u32,
        pad_layer: 0,
    }
}

fn first_slice(volume: &Generation, layer: usize, level: u32) -> u32 {
    let size = volume.size();
    (layer as u32 * size.levels + level) * size.slices
}

/// The volume as a cell sees it. `origin_m` is world x and z of the cell's frame; `layers` has each shown layer's drift and
/// extinction;
/// a cone would take `sun_steps`.
#[must_use]
pub fn sun_volume_uniform(
    volume: &Generation,
    origin_m: DVec2,
    layers: &[(DVec2, f64)],
    sun_steps: u32,
) -> layout::SunVolume {
    let size = volume.size();
    let depth = f64::from(size.depth(volume.layers()));
    let near_steps = size.near_steps_for(sun_steps);
    let near_columns = f64::from(near_steps) * size.near_columns;
    let mut uniform = layout::SunVolume::default();
    for (layer, (drift_m, extinction_per_m)) in layers.iter().enumerate().take(4) {
        if layer >= volume.layers() {
            break;
        }
        let shell = volume.shell(layer);
        let seen = &mut uniform.layers[layer];
        *seen = layout::SunLayer {
            direction: volume.direction().as_vec3().to_array(),
            base_altitude_m: shell.base_altitude_m as f32,
            top_altitude_m: shell.top_altitude_m as f32,
            extinction_per_m: *extinction_per_m as f32,
            near_periods: (near_columns / f64::from(size.columns)) as f32,
            slice_w: (1.0 / depth) as f32,
            slices: (size.slices - 1) as f32,
            near_steps,
            ..Default::default()
        };
        // What leads from the frame to the field.
        let offset_m = origin_m - *drift_m;
        for (level, value) in (0..).zip(&mut seen.levels) {
            *value = if level < size.levels {
                level_uniform(volume, layer, level, offset_m, depth)
            } else {
                // Knows no foot.
                layout::SunLevel {
                    feet_min_m: [1.0; 2],
                    feet_max_m: [-1.0; 2],
                    per_m: 1.0,
                    ..Default::default()
                }
            };
        }
    }
    uniform
}

fn level_uniform(
    volume: &Generation,
    layer: usize,
    level: u32,
    offset_m: DVec2,
    depth: f64,
) -> layout::SunLevel {
    let size = volume.size();
    let spacing_m = size.spacing_of_level_m(level);
    let period_m = spacing_m * f64::from(size.columns);
    let known = volume.known(layer, level);
    // Between the middles of the outermost columns, so that a read never reaches beyond them.
    let edge = |index: [i64; 2], inwards: f64| {
        let at = DVec2::new(index[0] as f64 + inwards, index[1] as f64 + inwards) * spacing_m;
        (at - offset_m).as_vec2().to_array()
    };
    let (feet_min_m, feet_max_m) = if known.is_empty() {
        ([1.0; 2], [-1.0; 2])
    } else {
        (edge(known.min, 0.5), edge(known.max, -0.5))
    };
    layout::SunLevel {
        // Reduced in f64: neither place nor time costs precision.
        offset: (offset_m / period_m)
            .to_array()
            .map(|periods| periods.rem_euclid(1.0) as f32),
        feet_min_m,
        feet_max_m,
        per_m: (1.0 / period_m) as f32,
        first_w: (f64::from(first_slice(volume, layer, level)) / depth) as f32,
    }
}
