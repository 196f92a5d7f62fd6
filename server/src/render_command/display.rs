//! Linear radiance as it is shown, in f64: what the composite does in `composite/tone.wgsl`.

use skycell_protocol::scene::ToneCurve;

/// What looks white: the reference solar spectrum (ASTM G173) at the three channels, relative to its mean.
const WHITE: [f64; 3] = [0.8444, 1.0602, 1.0954];

/// How radiance becomes bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Display {
    pub(crate) exposure: f64,
    pub(crate) curve: ToneCurve,
    pub(crate) tone_map: bool,
    pub(crate) dither: bool,
}

impl Display {
    /// The bytes of a pixel.
    pub(crate) fn bytes(&self, radiance: [f64; 3], column: u32, row: u32) -> [u8; 3] {
        let noise = if self.dither {
            // J. Jimenez, "Next Generation Post Processing in Call of Duty", 2014.
            let inner = f64::from(column) * 0.067_110_56 + f64::from(row) * 0.005_837_15;
            (52.982_918_9 * inner.fract()).fract() - 0.5
        } else {
            0.0
        };
        let linear = [0, 1, 2].map(|c| radiance[c] / WHITE[c] * self.exposure);
        let encoded = if self.tone_map {
            encoded(self.curve, linear)
        } else {
            linear.map(|value| srgb(value.clamp(0.0, 1.0)))
        };
        encoded.map(|value| (255.0 * (value + noise / 255.0).clamp(0.0, 1.0)).round() as u8)
    }
}

/// A curve's sRGB-encoded values of balanced and exposed radiance.
fn encoded(curve: ToneCurve, linear: [f64; 3]) -> [f64; 3] {
    match curve {
        ToneCurve::Aces => linear.map(|value| srgb(filmic(value))),
        ToneCurve::Agx => agx(linear),
        ToneCurve::Neutral => neutral(linear).map(srgb),
    }
}

/// A vector times a matrix that is given by rows.
fn product(rows: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    rows.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// T. Sobotka's AgX, 2022, by B. Wrensch's fit, 2023, with its Punchy look; twice the radiance, as the composite has it.
fn agx(linear: [f64; 3]) -> [f64; 3] {
    const INSET: [[f64; 3]; 3] = [
        [0.842_479_062_253_094, 0.078_433_6, 0.079_223_745_147_764_3],
        [
            0.042_328_242_261_012_3,
            0.878_468_636_469_772,
            0.079_166_127_460_543_4,
        ],
        [0.042_375_654_905_705_1, 0.078_433_6, 0.879_142_973_793_104],
    ];
    const OUTSET: [[f64; 3]; 3] = [
        [
            1.196_879_005_120_17,
            -0.098_020_881_140_136_8,
            -0.099_029_744_079_720_5,
        ],
        [
            -0.052_896_851_757_456_2,
            1.151_903_129_904_17,
            -0.098_961_176_844_843_3,
        ],
        [
            -0.052_971_635_514_443_8,
            -0.098_043_450_117_124_1,
            1.151_073_672_641_16,
        ],
    ];
    let (low, high) = (-12.473_93, 4.026_069);
    let mixed = product(INSET, linear.map(|value| (2.0 * value).clamp(1e-10, 1e30)));
    let looked = mixed.map(|value| {
        let x = ((value.log2() - low) / (high - low)).clamp(0.0, 1.0);
        let terms = [-0.002_32, 0.119_1, 0.429_8, -6.868, 31.96, -40.14, 15.5];
        let curve = terms.iter().rev().fold(0.0, |sum, term| sum * x + term);
        curve.max(0.0).powf(1.35)
    });
    let luma = 0.212_6 * looked[0] + 0.715_2 * looked[1] + 0.072_2 * looked[2];
    product(OUTSET, looked.map(|value| luma + 1.4 * (value - luma)))
        .map(|value| value.clamp(0.0, 1.0))
}

/// Khronos PBR Neutral, 2024; 1.7 times the radiance, as the composite has it.
fn neutral(linear: [f64; 3]) -> [f64; 3] {
    let colour = linear.map(|value| 1.7 * value.min(1e30));
    let least = colour.into_iter().fold(f64::INFINITY, f64::min);
    let offset = if least < 0.08 {
        least - 6.25 * least * least
    } else {
        0.04
    };
    let shifted = colour.map(|value| value - offset);
    let peak = shifted.into_iter().fold(0.0, f64::max);
    let (start, room) = (0.76, 0.24);
    if peak < start {
        return shifted.map(|value| value.clamp(0.0, 1.0));
    }
    let compressed = 1.0 - room * room / (peak + room - start);
    let white = 1.0 - 1.0 / (0.15 * (peak - compressed) + 1.0);
    shifted.map(|value| {
        (value * compressed / peak * (1.0 - white) + compressed * white).clamp(0.0, 1.0)
    })
}

/// K. Narkowicz's fit of the ACES reference transform, 2015.
fn filmic(x: f64) -> f64 {
    (x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)).clamp(0.0, 1.0)
}

/// IEC 61966-2-1.
fn srgb(linear: f64) -> f64 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn black_stays_black_and_what_is_bright_ends_at_white() {
        let display = Display {
            exposure: 3.6,
            curve: ToneCurve::Aces,
            tone_map: true,
            dither: false,
        };
        assert_eq!(display.bytes([0.0; 3], 5, 7), [0; 3]);
        assert_eq!(display.bytes([1e9; 3], 5, 7), [255; 3]);
    }
}
