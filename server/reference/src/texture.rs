//! Textures as a sampler is specified to read them, in f64: texel centres at (i + ½)/n, linear between them, bytes as
//! fractions of 255 (WebGPU, "texel sampling"; unorm8).

use crate::ReferenceError;
use crate::error::checked;

/// Most texels along an edge.
const EDGE_MAX: u32 = 65_536;

/// The greatest whole number not above a value. Machines without an instruction for it call a function that is slower than
/// the whole read; values beyond 2^63 do not occur.
fn floor(value: f64) -> f64 {
    let cut = value as i64 as f64;
    if cut > value { cut - 1.0 } else { cut }
}

/// Both texels that a linear read along one axis takes, and the share of the upper one.
type Tap = (usize, usize, f64);

/// Both texels of a repeating edge at a coordinate in periods. Whole periods go first, which is exact and needs no
/// division of integers.
fn wrapped(periods: f64, size: u32) -> Tap {
    let texels = (periods - floor(periods)) * f64::from(size) - 0.5;
    let last = size as usize - 1;
    if texels < 0.0 {
        return (last, 0, texels + 1.0);
    }
    let low = (texels as usize).min(last);
    let high = if low == last { 0 } else { low + 1 };
    (low, high, texels - low as f64)
}

/// Both texels of a clamped edge at a coordinate in texels.
pub(crate) fn clamped(texels: f64, size: u32) -> Tap {
    let shifted = texels - 0.5;
    let low = floor(shifted);
    let last = i64::from(size) - 1;
    (
        (low as i64).clamp(0, last) as usize,
        (low as i64).saturating_add(1).clamp(0, last) as usize,
        shifted - low,
    )
}

fn mix(a: f64, b: f64, share: f64) -> f64 {
    a + (b - a) * share
}

fn check(what: &str, sizes: &[u32], channels: usize, given: usize) -> Result<(), ReferenceError> {
    if sizes.iter().any(|n| *n == 0 || *n > EDGE_MAX) {
        return Err(ReferenceError::WrongSize {
            what: what.to_owned(),
        });
    }
    // At most 2^48 · 2, which a usize of 64 bits holds; on smaller machines the product saturates.
    let expected = sizes
        .iter()
        .fold(channels, |n, size| n.saturating_mul(*size as usize));
    if given == expected {
        Ok(())
    } else {
        Err(ReferenceError::WrongLength {
            what: what.to_owned(),
            given,
            expected,
        })
    }
}

/// Values of a map.
#[derive(Clone, Debug, PartialEq)]
enum Texels {
    /// 255ths.
    Bytes(Vec<u8>),
    /// Any, such as half floats.
    Values(Vec<f32>),
}

/// A map of values in 0…1, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct TexelMap {
    width: u32,
    height: u32,
    texels: Texels,
}

impl TexelMap {
    /// A map of 255ths; `what` names it in errors.
    ///
    /// # Errors
    /// If there are not width × height texels.
    pub fn new(
        what: &str,
        width: u32,
        height: u32,
        texels: Vec<u8>,
    ) -> Result<Self, ReferenceError> {
        check(what, &[width, height], 1, texels.len())?;
        Ok(Self {
            width,
            height,
            texels: Texels::Bytes(texels),
        })
    }

    /// A map of values as they are; `what` names it in errors.
    ///
    /// # Errors
    /// If there are not width × height values, or one is not in 0…1.
    pub fn of_values(
        what: &str,
        width: u32,
        height: u32,
        values: Vec<f32>,
    ) -> Result<Self, ReferenceError> {
        check(what, &[width, height], 1, values.len())?;
        for value in &values {
            checked("a value of a map", f64::from(*value), 0.0..=1.0, "0 to 1")?;
        }
        Ok(Self {
            width,
            height,
            texels: Texels::Values(values),
        })
    }

    /// Texels along a row.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Whether both maps have as many texels along both edges.
    pub(crate) fn is_sized_as(&self, other: &Self) -> bool {
        (self.width, self.height) == (other.width, other.height)
    }

    /// The value of the texel of a column and a row that repeat.
    #[must_use]
    pub fn texel_repeated(&self, x: i64, y: i64) -> f64 {
        let x = x.rem_euclid(i64::from(self.width)) as usize;
        let y = y.rem_euclid(i64::from(self.height)) as usize;
        let index = y * self.width as usize + x;
        match &self.texels {
            Texels::Bytes(bytes) => f64::from(bytes[index]) / 255.0,
            Texels::Values(values) => f64::from(values[index]),
        }
    }

    /// A map of what a function makes of the values of two maps; of the first one's size.
    pub(crate) fn zipped(&self, other: &Self, function: impl Fn(f64, f64) -> f64) -> Self {
        let values = (0..i64::from(self.height))
            .flat_map(|y| (0..i64::from(self.width)).map(move |x| (x, y)))
            .map(|(x, y)| {
                let value = function(self.texel_repeated(x, y), other.texel_repeated(x, y));
                value.clamp(0.0, 1.0) as f32
            })
            .collect();
        Self {
            width: self.width,
            height: self.height,
            texels: Texels::Values(values),
        }
    }

    fn mixed(&self, (x0, x1, fx): Tap, (y0, y1, fy): Tap) -> f64 {
        let width = self.width as usize;
        let mixed = |at: &dyn Fn(usize) -> f64| {
            let upper = mix(at(y0 * width + x0), at(y0 * width + x1), fx);
            let lower = mix(at(y1 * width + x0), at(y1 * width + x1), fx);
            mix(upper, lower, fy)
        };
        match &self.texels {
            Texels::Bytes(bytes) => mixed(&|index| f64::from(bytes[index])) / 255.0,
            Texels::Values(values) => mixed(&|index| f64::from(values[index])),
        }
    }

    /// Where texture coordinates that repeat after 1 are read.
    pub(crate) fn taps(&self, u: f64, v: f64) -> [Tap; 2] {
        [wrapped(u, self.width), wrapped(v, self.height)]
    }

    /// The value at taps of a map of the same size.
    pub(crate) fn at(&self, taps: [Tap; 2]) -> f64 {
        self.mixed(taps[0], taps[1])
    }

    /// The value at texture coordinates that repeat after 1.
    #[must_use]
    pub fn repeated(&self, u: f64, v: f64) -> f64 {
        self.at(self.taps(u, v))
    }

    /// The value at texture coordinates in 0…1, beyond which the edge's goes on.
    #[must_use]
    pub fn clamped(&self, u: f64, v: f64) -> f64 {
        self.mixed(
            clamped(u * f64::from(self.width), self.width),
            clamped(v * f64::from(self.height), self.height),
        )
    }
}

/// A cube of texels with two bytes each, x fastest, then y, then z; it repeats.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ByteVolume {
    size: u32,
    texels: Vec<u8>,
}

impl ByteVolume {
    /// A volume with `size` texels along each edge; `what` names it in errors.
    ///
    /// # Errors
    /// If there are not 2 size³ bytes.
    pub fn new(what: &str, size: u32, texels: Vec<u8>) -> Result<Self, ReferenceError> {
        check(what, &[size, size, size], 2, texels.len())?;
        Ok(Self { size, texels })
    }

    /// Texels along an edge.
    #[must_use]
    pub fn size(&self) -> u32 {
        self.size
    }

    /// Both channels of the texel at indices that repeat.
    #[must_use]
    pub fn texel(&self, index: [i64; 3]) -> [u8; 2] {
        let n = i64::from(self.size);
        let [x, y, z] = index.map(|i| i.rem_euclid(n) as usize);
        let at = 2 * ((z * n as usize + y) * n as usize + x);
        [self.texels[at], self.texels[at + 1]]
    }

    /// Both channels at coordinates that repeat after 1.
    #[must_use]
    pub fn repeated(&self, at: [f64; 3]) -> [f64; 2] {
        let n = self.size as usize;
        let [x, y, z] = at.map(|u| wrapped(u, self.size));
        let line = |y: usize, z: usize| {
            let row = 2 * (z * n + y) * n;
            let (a, b) = (row + 2 * x.0, row + 2 * x.1);
            let value = |i: usize| f64::from(self.texels[i]);
            [
                mix(value(a), value(b), x.2),
                mix(value(a + 1), value(b + 1), x.2),
            ]
        };
        let plane = |z: usize| {
            let (low, high) = (line(y.0, z), line(y.1, z));
            [mix(low[0], high[0], y.2), mix(low[1], high[1], y.2)]
        };
        let (low, high) = (plane(z.0), plane(z.1));
        [
            mix(low[0], high[0], z.2) / 255.0,
            mix(low[1], high[1], z.2) / 255.0,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texel_centres_hold_their_bytes_and_edges_wrap_or_clamp() {
        let map = TexelMap::new("map", 4, 2, vec![0, 51, 102, 255, 255, 0, 0, 0]).expect("a map");
        let close = |a: f64, b: f64| (a - b).abs() < 1e-12;
        assert!(close(map.repeated(0.375, 0.25), 0.2));
        assert!(close(map.repeated(1.375, -0.75), 0.2));
        // Between the last and the first texel of a row.
        assert!(close(map.repeated(0.0, 0.25), 0.5));
        assert!(close(map.clamped(0.0, 0.25), 0.0));
        assert!(close(map.clamped(2.0, 0.25), 1.0));
        // In the middle of four texels.
        assert!(close(map.repeated(0.25, 0.5), (0.0 + 0.2 + 1.0) / 4.0));
    }

    #[test]
    fn a_volume_is_linear_between_its_texels() {
        let mut texels = vec![0u8; 2 * 27];
        // Texel (1, 2, 0).
        texels[2 * 7] = 255;
        texels[2 * 7 + 1] = 51;
        let volume = ByteVolume::new("volume", 3, texels).expect("a volume");
        let [a, b] = volume.repeated([0.5, 2.5 / 3.0, 0.5 / 3.0]);
        assert!((a - 1.0).abs() < 1e-12 && (b - 0.2).abs() < 1e-12);
        // Half way to each neighbour, across the wrapped edge of y and z.
        let [a, _] = volume.repeated([2.0 / 3.0, 0.0, 0.0]);
        assert!((a - 0.125).abs() < 1e-12);
        assert_eq!(volume.texel([-2, 5, 3]), [255, 51]);
    }

    #[test]
    fn data_that_does_not_fill_its_size_is_refused() {
        assert!(TexelMap::new("map", 2, 2, vec![0; 5]).is_err());
        assert!(ByteVolume::new("volume", 0, Vec::new()).is_err());
    }
}
