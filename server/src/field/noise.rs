//! Tiling gradient and cellular noise (K. Perlin 2002; S. Worley 1996), evaluated on the CPU once and kept.
//!
//! Coordinates are in units of the noise's own lattice; `period` is the number of lattice cells after which it repeats.

/// Hash of a lattice point (M. Jarzynski & M. Olano 2020, pcg3d), already wrapped to the period by the caller.
fn hash(x: u32, y: u32, z: u32) -> [u32; 3] {
    let lcg = |v: u32| v.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    let (mut x, mut y, mut z) = (lcg(x), lcg(y), lcg(z));
    for round in 0..2 {
        x = x.wrapping_add(y.wrapping_mul(z));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        if round == 0 {
            x ^= x >> 16;
            y ^= y >> 16;
            z ^= z >> 16;
        }
    }
    [x, y, z]
}

fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 / (1u32 << 24) as f32
}

/// Lattice cell and the place in it, 0…1.
fn split(value: f32) -> (i32, f32) {
    let floor = value.floor();
    (floor as i32, value - floor)
}

/// Lattice cells after which noise repeats, along each axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Period([i32; 3]);

impl From<u32> for Period {
    fn from(cells: u32) -> Self {
        Self([cells as i32; 3])
    }
}

impl From<[u32; 3]> for Period {
    fn from(cells: [u32; 3]) -> Self {
        Self(cells.map(|n| n as i32))
    }
}

fn wrapped_hash(cell: [i32; 3], Period(period): Period, seed: u32) -> [u32; 3] {
    let wrap = |axis: usize| cell[axis].rem_euclid(period[axis]) as u32;
    hash(
        wrap(0).wrapping_add(seed.wrapping_mul(0x9e37_79b9)),
        wrap(1),
        wrap(2),
    )
}

/// Gradient noise, about −1…1, mean 0.
pub(super) fn perlin(position: [f32; 3], period: impl Into<Period>, seed: u32) -> f32 {
    let period = period.into();
    let ([x0, y0, z0], [fx, fy, fz]) = {
        let (x, fx) = split(position[0]);
        let (y, fy) = split(position[1]);
        let (z, fz) = split(position[2]);
        ([x, y, z], [fx, fy, fz])
    };
    let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let corner = |dx: i32, dy: i32, dz: i32| {
        let [h, _, _] = wrapped_hash([x0 + dx, y0 + dy, z0 + dz], period, seed);
        let (x, y, z) = (fx - dx as f32, fy - dy as f32, fz - dz as f32);
        // Perlin's twelve edge directions.
        match (h >> 16) % 12 {
            0 => x + y,
            1 => y - x,
            2 => x - y,
            3 => -x - y,
            4 => x + z,
            5 => z - x,
            6 => x - z,
            7 => -x - z,
            8 => y + z,
            9 => z - y,
            10 => y - z,
            _ => -y - z,
        }
    };
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let (u, v, w) = (fade(fx), fade(fy), fade(fz));
    let plane = |dz: i32| {
        mix(
            mix(corner(0, 0, dz), corner(1, 0, dz), u),
            mix(corner(0, 1, dz), corner(1, 1, dz), u),
            v,
        )
    };
    mix(plane(0), plane(1), w)
}

/// Distance to the nearest feature point, in cells; at most about 1.3.
pub(super) fn worley(position: [f32; 3], period: impl Into<Period>, seed: u32) -> f32 {
    let period = period.into();
    let (x0, fx) = split(position[0]);
    let (y0, fy) = split(position[1]);
    let (z0, fz) = split(position[2]);
    let mut nearest = f32::INFINITY;
    for dz in -1..=1 {
        for dy in -1..=1 {
            for dx in -1..=1 {
                let [a, b, c] = wrapped_hash([x0 + dx, y0 + dy, z0 + dz], period, seed);
                let x = dx as f32 + unit(a) - fx;
                let y = dy as f32 + unit(b) - fy;
                let z = dz as f32 + unit(c) - fz;
                nearest = nearest.min(x * x + y * y + z * z);
            }
        }
    }
    nearest.sqrt()
}

/// Cellular noise that bulges: 1 at feature points, towards 0 between them.
pub(super) fn billow(position: [f32; 3], period: impl Into<Period>, seed: u32) -> f32 {
    1.0 - worley(position, period, seed).min(1.0)
}

/// Sum of octaves of `noise`, each with doubled frequency and `gain` of the strength before, divided by their weights.
/// `unit_position` is in periods, 0…1.
pub(super) fn octaves(
    noise: impl Fn([f32; 3], u32, u32) -> f32,
    unit_position: [f32; 3],
    frequency: u32,
    count: u32,
    gain: f32,
    seed: u32,
) -> f32 {
    let (mut sum, mut weights, mut weight) = (0.0, 0.0, 1.0);
    for octave in 0..count {
        let cells = frequency << octave;
        let scaled = unit_position.map(|v| v * cells as f32);
        sum += weight * noise(scaled, cells, seed.wrapping_add(octave));
        weights += weight;
        weight *= gain;
    }
    sum / weights
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_tiles_after_its_period() {
        for i in 0..200 {
            let t = i as f32 * 0.0371;
            let here = [t * 4.0, 1.3 + t, 2.7 - t];
            let there = [here[0] + 4.0, here[1] - 4.0, here[2] + 8.0];
            assert!((perlin(here, 4, 7) - perlin(there, 4, 7)).abs() < 1e-4);
            assert!((worley(here, 4, 7) - worley(there, 4, 7)).abs() < 1e-4);
            let (uneven, there) = ([3, 5, 2], [here[0] + 3.0, here[1] - 5.0, here[2] + 2.0]);
            assert!((perlin(here, uneven, 7) - perlin(there, uneven, 7)).abs() < 1e-4);
            assert!((worley(here, uneven, 7) - worley(there, uneven, 7)).abs() < 1e-4);
        }
    }

    #[test]
    fn noise_depends_on_its_seed() {
        let here = [0.3, 0.4, 0.5];
        assert_ne!(worley(here, 4, 1), worley(here, 4, 2));
    }
}
