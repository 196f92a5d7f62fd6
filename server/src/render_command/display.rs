//! Linear radiance as it is shown, in f64: what the composite does in `composite/tone.wgsl`.

/// What looks white: the reference solar spectrum (ASTM G173) at the three channels, relative to its mean.
const WHITE: [f64; 3] = [0.8444, 1.0602, 1.0954];

/// How radiance becomes bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Display {
    pub(crate) exposure: f64,
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
        [0, 1, 2].map(|channel| {
            let linear = radiance[channel] / WHITE[channel] * self.exposure;
            let shown = if self.tone_map {
                filmic(linear)
            } else {
                linear.clamp(0.0, 1.0)
            };
            (255.0 * (srgb(shown) + noise / 255.0).clamp(0.0, 1.0)).round() as u8
        })
    }
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
            tone_map: true,
            dither: false,
        };
        assert_eq!(display.bytes([0.0; 3], 5, 7), [0; 3]);
        assert_eq!(display.bytes([1e9; 3], 5, 7), [255; 3]);
    }
}
