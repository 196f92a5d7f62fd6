//! Noise and maps kept on disk: made once, found by their parameters.

use super::layer_maps::LayerMaps;
use super::map_file::{GreyMap, MapFileError, read_map_file};
use super::maps::{MAP_SIZE, WeatherMaps};
use super::profile::{PROFILE_SIZE, profile_texels};
use super::resample::device_texels;
use super::sheet::SheetMaps;
use super::volumes::{NoiseVolume, VolumeKind};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use skycell_protocol::scene::{MapKind, WeatherDensity, WeatherPattern};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

/// Changes with the formulas of this module's noise: old files are then no longer found.
const GENERATOR_VERSION: u32 = 5;

/// Changes with how maps from files are brought to the device's size.
const RESAMPLER_VERSION: u32 = 1;

/// Maps from files that are kept as the device reads them, the last used: those of four layers four times over.
const DRAWN_MAPS_MAX: usize = 48;
const DRAWN_PREFIX: &str = "drawn-";

/// Where noise and maps are kept. Without a folder they are made anew each time.
#[derive(Clone, Debug)]
pub struct FieldStore {
    folder: Option<PathBuf>,
}

impl FieldStore {
    /// A store in a folder, which is created when needed.
    #[must_use]
    pub fn new(folder: Option<PathBuf>) -> Self {
        Self { folder }
    }

    /// A noise volume.
    #[must_use]
    pub fn volume(&self, kind: VolumeKind, seed: u32) -> NoiseVolume {
        let size = kind.size();
        let bytes = 2 * (size as usize).pow(3);
        let key = format!("{}-{size}-seed{seed}-v{GENERATOR_VERSION}", kind.name());
        let texels = self.load_or_make(&key, bytes, u64::from(size), |bar| {
            NoiseVolume::generate(kind, seed, || bar.inc(1)).texels
        });
        NoiseVolume { size, texels }
    }

    /// Coverage and type maps.
    #[must_use]
    pub fn weather_maps(&self, pattern: WeatherPattern, seed: u32) -> WeatherMaps {
        let texels = (MAP_SIZE as usize).pow(2);
        let key = format!(
            "maps-{}-{MAP_SIZE}-seed{seed}-v{GENERATOR_VERSION}",
            pattern.name()
        );
        let both = self.load_or_make(&key, 2 * texels, u64::from(MAP_SIZE), |bar| {
            let maps = WeatherMaps::generate(pattern, seed, || bar.inc(1));
            [maps.coverage, maps.cloud_type].concat()
        });
        let (coverage, cloud_type) = both.split_at(texels);
        WeatherMaps {
            coverage: coverage.to_vec(),
            cloud_type: cloud_type.to_vec(),
        }
    }

    /// A map from a file of a folder as the device reads it, in 65 535ths. What was read once is found by its content.
    ///
    /// # Errors
    /// When the file is no map.
    pub fn map_file(
        &self,
        folder: &Path,
        file: &str,
        kind: MapKind,
    ) -> Result<Vec<u16>, MapFileError> {
        self.map_of_bytes(&read_map_file(folder, file)?, kind)
    }

    /// As [`Self::map_file`], of a file's content.
    ///
    /// # Errors
    /// When it is no map.
    pub fn map_of_bytes(&self, bytes: &[u8], kind: MapKind) -> Result<Vec<u16>, MapFileError> {
        let texels = match kind {
            MapKind::Coverage | MapKind::Type => (MAP_SIZE as usize).pow(2),
            MapKind::Profile => PROFILE_SIZE.map(|n| n as usize).iter().product(),
        };
        // Coverage and type are resampled alike.
        let shape = if kind == MapKind::Profile {
            "profile"
        } else {
            "map"
        };
        let content = xxh3_128(bytes);
        let key = format!("{DRAWN_PREFIX}{shape}-{content:032x}-v{RESAMPLER_VERSION}.bin");
        let path = self.folder.as_ref().map(|folder| folder.join(key));
        if let Some(found) = path.as_deref().and_then(|path| read(path, 2 * texels)) {
            return Ok(found
                .chunks_exact(2)
                .map(|two| u16::from_le_bytes([two[0], two[1]]))
                .collect());
        }
        let made = device_texels(&GreyMap::decode(bytes)?, kind);
        if let Some(path) = path {
            let raw: Vec<u8> = made.iter().flat_map(|texel| texel.to_le_bytes()).collect();
            if let Err(error) = write(&path, &raw) {
                tracing::warn!(path = %path.display(), %error, "a map is not kept on disk");
            }
            forget_old_maps(path.parent().unwrap_or_else(|| Path::new(".")));
        }
        Ok(made)
    }

    /// The maps that a layer has without files.
    #[must_use]
    pub fn generated_maps(&self, weather: &WeatherDensity) -> LayerMaps {
        let wide = |bytes: &[u8]| bytes.iter().map(|byte| u16::from(*byte) * 257).collect();
        let made = self.weather_maps(weather.pattern(), weather.seed());
        LayerMaps {
            coverage: wide(&made.coverage),
            cloud_type: wide(&made.cloud_type),
            profile: wide(&profile_texels(weather.profile())),
        }
    }

    /// All maps of a layer: from files in a folder where it names some, else from its seed.
    ///
    /// # Errors
    /// When a file is no map.
    pub fn layer_maps(
        &self,
        weather: &WeatherDensity,
        folder: &Path,
    ) -> Result<LayerMaps, MapFileError> {
        let drawn = |kind: MapKind| {
            weather
                .maps()
                .file(kind)
                .map(|file| self.map_file(folder, file, kind))
                .transpose()
        };
        let drawn = [
            drawn(MapKind::Coverage)?,
            drawn(MapKind::Type)?,
            drawn(MapKind::Profile)?,
        ];
        let mut maps = self.generated_maps(weather);
        for (map, drawn) in [&mut maps.coverage, &mut maps.cloud_type, &mut maps.profile]
            .into_iter()
            .zip(drawn)
        {
            if let Some(drawn) = drawn {
                *map = drawn;
            }
        }
        Ok(maps)
    }

    /// Maps of a thin sheet.
    #[must_use]
    pub fn sheet_maps(&self, seed: u32) -> SheetMaps {
        let texels = (MAP_SIZE as usize).pow(2);
        let key = format!("sheet-{MAP_SIZE}-seed{seed}-v{GENERATOR_VERSION}");
        let all = self.load_or_make(&key, 3 * texels, 5 * u64::from(MAP_SIZE), |bar| {
            let maps = SheetMaps::generate(seed, || bar.inc(1));
            [maps.patches, maps.fibres, maps.veil].concat()
        });
        SheetMaps {
            patches: all[..texels].to_vec(),
            fibres: all[texels..2 * texels].to_vec(),
            veil: all[2 * texels..].to_vec(),
        }
    }

    fn load_or_make(
        &self,
        key: &str,
        bytes: usize,
        steps: u64,
        make: impl FnOnce(&ProgressBar) -> Vec<u8>,
    ) -> Vec<u8> {
        let path = self.folder.as_ref().map(|f| f.join(format!("{key}.bin")));
        if let Some(found) = path.as_deref().and_then(|p| read(p, bytes)) {
            return found;
        }
        tracing::info!(key, "making noise");
        // Drawn only once a second has passed: short work needs no bar.
        let bar = ProgressBar::with_draw_target(Some(steps), ProgressDrawTarget::hidden());
        if let Ok(style) = ProgressStyle::with_template("making {msg} [{bar:30}] {percent} %") {
            bar.set_style(style);
        }
        bar.set_message(key.to_owned());
        let made = std::thread::scope(|scope| {
            let (done, finished) = std::sync::mpsc::channel::<()>();
            let watched = bar.clone();
            scope.spawn(move || {
                if finished.recv_timeout(Duration::from_secs(1))
                    == Err(std::sync::mpsc::RecvTimeoutError::Timeout)
                {
                    watched.set_draw_target(ProgressDrawTarget::stderr());
                }
            });
            let made = make(&bar);
            drop(done);
            made
        });
        bar.finish_and_clear();
        if let Some(path) = path
            && let Err(error) = write(&path, &made)
        {
            tracing::warn!(path = %path.display(), %error, "noise is not kept on disk");
        }
        made
    }
}

/// Removes all but the youngest maps that were made from files.
fn forget_old_maps(folder: &Path) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    let mut maps: Vec<(std::time::SystemTime, PathBuf)> = entries
        .flatten()
        .filter(|entry| {
            entry
                .file_name()
                .to_string_lossy()
                .starts_with(DRAWN_PREFIX)
        })
        .filter_map(|entry| Some((entry.metadata().ok()?.modified().ok()?, entry.path())))
        .collect();
    maps.sort();
    let many = maps.len().saturating_sub(DRAWN_MAPS_MAX);
    for (_, path) in maps.into_iter().take(many) {
        // Another process may have been faster; what is left is removed next time.
        let _ = std::fs::remove_file(path);
    }
}

/// The texels of a file whose length and checksum are right; a damaged file counts as none.
fn read(path: &Path, bytes: usize) -> Option<Vec<u8>> {
    let mut file = std::fs::read(path).ok()?;
    if file.len() != bytes + 8 {
        return None;
    }
    let checksum = file.split_off(bytes);
    (checksum == xxh3_64(&file).to_le_bytes()).then_some(file)
}

/// Writes beside the file and renames, so that another process never reads half of it.
fn write(path: &Path, texels: &[u8]) -> std::io::Result<()> {
    let folder = path.parent().unwrap_or_else(|| Path::new("."));
    std::fs::create_dir_all(folder)?;
    let temporary = path.with_extension(format!("tmp{}", std::process::id()));
    let mut file = std::fs::File::create(&temporary)?;
    file.write_all(texels)?;
    file.write_all(&xxh3_64(texels).to_le_bytes())?;
    file.sync_all()?;
    std::fs::rename(&temporary, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_noise_is_the_noise_that_was_made() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = FieldStore::new(Some(folder.path().to_owned()));
        let made = store.volume(VolumeKind::Detail, 5);
        let kept = store.volume(VolumeKind::Detail, 5);
        assert_eq!(made, kept);
        assert_eq!(made, FieldStore::new(None).volume(VolumeKind::Detail, 5));
    }

    #[test]
    fn a_damaged_file_is_made_anew() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = FieldStore::new(Some(folder.path().to_owned()));
        let made = store.volume(VolumeKind::Detail, 6);
        let path = std::fs::read_dir(folder.path())
            .expect("readable")
            .next()
            .expect("one file")
            .expect("entry")
            .path();
        let mut bytes = std::fs::read(&path).expect("readable");
        bytes[100] ^= 0xff;
        std::fs::write(&path, bytes).expect("writable");
        assert_eq!(store.volume(VolumeKind::Detail, 6), made);
    }
}
