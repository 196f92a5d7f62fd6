//! All maps of one weather layer, wherever they come from, as the device reads them.

use super::map_file::{GreyMap, MapFileError, map_pointer, read_map_file};
use super::maps::{MAP_SIZE, SKIP_LEVELS, skip_distances};
use super::resample::picture_of;
use super::store::FieldStore;
use skycell_protocol::scene::{DensityModel, MapKind};
use skycell_protocol::{Scene, SceneError};
use std::path::Path;

/// Coverage, type and profile of a layer before the layer's own settings, in 65 535ths; see [`super::MAP_SIZE`] and
/// [`super::PROFILE_SIZE`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LayerMaps {
    /// Row by row from the north.
    pub coverage: Vec<u16>,
    /// Row by row from the north; 0 flat … 65 535 tall.
    pub cloud_type: Vec<u16>,
    /// Heights along a row, types down the rows.
    pub profile: Vec<u16>,
}

/// How the device stores maps: in bytes while that loses nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MapFormat {
    /// 8 bits.
    #[default]
    Bytes,
    /// Half floats: eleven digits or more.
    Halves,
}

impl MapFormat {
    /// What the device reads for a value in 65 535ths.
    #[must_use]
    pub fn value(self, texel: u16) -> f32 {
        match self {
            Self::Bytes => f32::from(byte_of(texel)) / 255.0,
            Self::Halves => half::f16::from_f32(f32::from(texel) / 65_535.0).to_f32(),
        }
    }

    /// What keeps all digits of all these maps: they share textures.
    #[must_use]
    pub fn of<'a>(maps: impl IntoIterator<Item = &'a LayerMaps>) -> Self {
        if maps.into_iter().all(LayerMaps::are_bytes) {
            Self::Bytes
        } else {
            Self::Halves
        }
    }

    /// What keeps the digits of both.
    #[must_use]
    pub fn with_digits_of(self, other: Self) -> Self {
        if self == Self::Bytes { other } else { self }
    }

    /// What the device reads for a skip distance in `SKIP_LEVELS`: not rounded up.
    #[must_use]
    pub fn skip(self, level: u8) -> f32 {
        match self {
            Self::Bytes => f32::from(level) / 255.0,
            // 256ths are exact in a half float.
            Self::Halves => f32::from(level) / (f32::from(SKIP_LEVELS) + 1.0),
        }
    }
}

/// The nearest byte.
fn byte_of(texel: u16) -> u8 {
    ((u32::from(texel) + 128) / 257) as u8
}

impl LayerMaps {
    /// Whether bytes keep all their digits.
    fn are_bytes(&self) -> bool {
        let is_byte = |texel: &u16| texel.is_multiple_of(257);
        [&self.coverage, &self.cloud_type, &self.profile]
            .into_iter()
            .all(|map| map.iter().all(is_byte))
    }

    /// These maps on their way to others: (1 − share) of these and `share` of those.
    #[must_use]
    pub fn blended(&self, to: &Self, share: f64) -> Self {
        let share = share.clamp(0.0, 1.0);
        let mix = |from: &[u16], to: &[u16]| {
            from.iter()
                .zip(to)
                .map(|(a, b)| {
                    let value = f64::from(*a) + (f64::from(*b) - f64::from(*a)) * share;
                    value.round() as u16
                })
                .collect()
        };
        Self {
            coverage: mix(&self.coverage, &to.coverage),
            cloud_type: mix(&self.cloud_type, &to.cloud_type),
            profile: mix(&self.profile, &to.profile),
        }
    }

    /// Skip distances for a layer's coverage; see [`skip_distances`].
    #[must_use]
    pub fn skips(&self, format: MapFormat, layer_coverage: f64) -> Vec<u8> {
        skip_distances(&self.coverage, format, layer_coverage)
    }

    /// One of the maps as a picture.
    #[must_use]
    pub fn picture(&self, kind: MapKind) -> GreyMap {
        let texels = match kind {
            MapKind::Coverage => &self.coverage,
            MapKind::Type => &self.cloud_type,
            MapKind::Profile => &self.profile,
        };
        picture_of(texels, kind)
    }

    /// Texels along a side of coverage and type.
    pub const SIDE: u32 = MAP_SIZE;
}

/// Whether all maps that a scene names can be read from a folder. What is read is kept, so that the device's side finds it
/// ready.
///
/// # Errors
/// Names the layer's map and what is wrong with its file.
pub fn check_maps(scene: &Scene, store: &FieldStore, folder: &Path) -> Result<(), SceneError> {
    for (index, layer) in scene.layers().iter().enumerate() {
        if let DensityModel::Weather(weather) = layer.density() {
            for kind in MapKind::ALL {
                if let Some(file) = weather.maps().file(kind) {
                    store
                        .map_file(folder, file, kind)
                        .map_err(|error: MapFileError| error.at(map_pointer(index, kind)))?;
                }
            }
        }
    }
    Ok(())
}

/// The content of all files of maps that a scene names, as hashes: their names do not tell.
#[must_use]
pub fn content_of_maps(scene: &Scene, folder: &Path) -> String {
    let mut content = String::new();
    for layer in scene.layers() {
        if let DensityModel::Weather(weather) = layer.density() {
            for file in MapKind::ALL.iter().filter_map(|k| weather.maps().file(*k)) {
                let bytes = read_map_file(folder, file).unwrap_or_default();
                content.push_str(&format!("{:032x} ", xxhash_rust::xxh3::xxh3_128(&bytes)));
            }
        }
    }
    content
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_keep_bytes_and_halves_keep_eleven_digits() {
        for byte in 0..=255u8 {
            let texel = u16::from(byte) * 257;
            assert_eq!(byte_of(texel), byte);
            assert_eq!(MapFormat::Bytes.value(texel), f32::from(byte) / 255.0);
            assert!(MapFormat::Bytes.skip(byte) <= f32::from(byte) / 255.0);
            assert!(MapFormat::Halves.skip(byte) <= f32::from(byte) / 255.0);
        }
        for texel in 0..=u16::MAX {
            let exact = f64::from(texel) / 65_535.0;
            let stored = f64::from(MapFormat::Halves.value(texel));
            // Half an ulp of eleven digits; subnormals below 2^-14 round by 2^-25.
            assert!((stored - exact).abs() <= exact * 2f64.powi(-11) + 2f64.powi(-25));
        }
    }
}
