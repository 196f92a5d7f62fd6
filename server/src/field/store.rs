//! Noise and maps kept on disk: made once, found by their parameters.

use super::layer_maps::LayerMaps;
use super::map_file::{GreyMap, MapFileError, read_map_file};
use super::maps::{MAP_SIZE, WeatherMaps};
use super::profile::{PROFILE_SIZE, profile_texels};
use super::resample::device_texels;
use super::sheet::SheetMaps;
use super::volumes::{NoiseVolume, VOLUME_SEED, VolumeKind};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use skycell_protocol::Scene;
use skycell_protocol::scene::{DensityModel, MapKind, WeatherDensity, WeatherPattern};
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

/// Generated maps that are kept of weather and of sheets each, the last used: 2 and 3 MiB a piece.
const GENERATED_MAX: usize = 48;
const GENERATED_PREFIX: &str = "maps-";
const SHEET_PREFIX: &str = "sheet-";

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
        let key = volume_key(kind, seed);
        let texels = self.load_or_make(&key, bytes, u64::from(size), |bar| {
            NoiseVolume::generate(kind, seed, || bar.inc(1)).texels
        });
        NoiseVolume { size, texels }
    }

    /// Coverage and type maps.
    #[must_use]
    pub fn weather_maps(&self, pattern: WeatherPattern, seed: u32) -> WeatherMaps {
        let texels = (MAP_SIZE as usize).pow(2);
        let key = maps_key(pattern, seed);
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
            forget_oldest(folder_of(&path), DRAWN_PREFIX, DRAWN_MAPS_MAX);
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

    /// Makes the noise and the generated maps that one scene needs, another does not, and that are not kept yet, so that
    /// whoever reads them later finds them. Takes seconds where something has to be made, else next to nothing. Without
    /// a folder it does nothing.
    pub fn prepare(&self, wanted: &Scene, known: &Scene) {
        let Some(folder) = &self.folder else {
            return;
        };
        let known = generated_parts(known);
        for part in generated_parts(wanted) {
            if !known.contains(&part) && !folder.join(format!("{}.bin", part.key())).exists() {
                self.make(part);
            }
        }
    }

    fn make(&self, part: GeneratedPart) {
        match part {
            GeneratedPart::Volume(kind) => drop(self.volume(kind, VOLUME_SEED)),
            GeneratedPart::Weather(pattern, seed) => drop(self.weather_maps(pattern, seed)),
            GeneratedPart::Sheet(seed) => drop(self.sheet_maps(seed)),
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
        let key = sheet_key(seed);
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
        if let Some(path) = path {
            if let Err(error) = write(&path, &made) {
                tracing::warn!(path = %path.display(), %error, "noise is not kept on disk");
            }
            // Scenes may name any seed.
            for prefix in [GENERATED_PREFIX, SHEET_PREFIX] {
                forget_oldest(folder_of(&path), prefix, GENERATED_MAX);
            }
        }
        made
    }
}

/// What is made for a layer.
#[derive(Clone, Copy, PartialEq, Eq)]
enum GeneratedPart {
    Volume(VolumeKind),
    Weather(WeatherPattern, u32),
    Sheet(u32),
}

impl GeneratedPart {
    fn key(self) -> String {
        match self {
            Self::Volume(kind) => volume_key(kind, VOLUME_SEED),
            Self::Weather(pattern, seed) => maps_key(pattern, seed),
            Self::Sheet(seed) => sheet_key(seed),
        }
    }
}

fn generated_parts(scene: &Scene) -> Vec<GeneratedPart> {
    let of_layer = |density: &DensityModel| match density {
        DensityModel::Weather(weather) => vec![
            GeneratedPart::Volume(VolumeKind::Shape),
            GeneratedPart::Volume(VolumeKind::Detail),
            GeneratedPart::Weather(weather.pattern(), weather.seed()),
        ],
        DensityModel::Cirrus(cirrus) => vec![GeneratedPart::Sheet(cirrus.seed())],
        _ => Vec::new(),
    };
    let densities = scene.layers().iter().map(|layer| layer.density());
    densities.flat_map(of_layer).collect()
}

fn volume_key(kind: VolumeKind, seed: u32) -> String {
    let size = kind.size();
    format!("{}-{size}-seed{seed}-v{GENERATOR_VERSION}", kind.name())
}

fn maps_key(pattern: WeatherPattern, seed: u32) -> String {
    let pattern = pattern.name();
    format!("{GENERATED_PREFIX}{pattern}-{MAP_SIZE}-seed{seed}-v{GENERATOR_VERSION}")
}

fn sheet_key(seed: u32) -> String {
    format!("{SHEET_PREFIX}{MAP_SIZE}-seed{seed}-v{GENERATOR_VERSION}")
}

/// Removes all but the last used files of a kind.
fn forget_oldest(folder: &Path, prefix: &str, kept_max: usize) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    let mut maps: Vec<(std::time::SystemTime, PathBuf)> = entries
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(prefix))
        .filter_map(|entry| Some((entry.metadata().ok()?.modified().ok()?, entry.path())))
        .collect();
    maps.sort();
    let many = maps.len().saturating_sub(kept_max);
    for (_, path) in maps.into_iter().take(many) {
        // Another process may have been faster; what is left is removed next time.
        let _ = std::fs::remove_file(path);
    }
}

fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or_else(|| Path::new("."))
}

/// The texels of a file whose length and checksum are right; a damaged file counts as none.
fn read(path: &Path, bytes: usize) -> Option<Vec<u8>> {
    let mut file = std::fs::read(path).ok()?;
    // What is used is not the first to be forgotten. A folder that cannot be written still serves.
    let used = std::fs::File::options().append(true).open(path);
    let _ = used.and_then(|file| file.set_modified(std::time::SystemTime::now()));
    if file.len() != bytes + 8 {
        return None;
    }
    let checksum = file.split_off(bytes);
    (checksum == xxh3_64(&file).to_le_bytes()).then_some(file)
}

/// Writes beside the file and renames, so that another process never reads half of it.
fn write(path: &Path, texels: &[u8]) -> std::io::Result<()> {
    std::fs::create_dir_all(folder_of(path))?;
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
    fn what_a_scene_needs_is_there_once_it_is_prepared_unless_another_scene_has_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = FieldStore::new(Some(folder.path().to_owned()));
        let sheet = serde_json::json!({
            "version": 1, "layers": [{"name": "high", "family": "cirrus"}]});
        let scene = Scene::from_json(&sheet).expect("a scene");
        let none =
            Scene::from_json(&serde_json::json!({"version": 1, "layers": []})).expect("a scene");
        store.prepare(&scene, &scene);
        assert_eq!(
            std::fs::read_dir(folder.path()).expect("readable").count(),
            0
        );
        store.prepare(&scene, &none);
        let names = || {
            let mut names: Vec<_> = std::fs::read_dir(folder.path())
                .expect("readable")
                .map(|entry| entry.expect("an entry").file_name())
                .collect();
            names.sort();
            names
        };
        assert_eq!(names(), [format!("{}.bin", sheet_key(1)).as_str()]);
        let made = std::fs::metadata(folder.path().join(&names()[0])).expect("there");
        store.prepare(&scene, &none);
        let after = std::fs::metadata(folder.path().join(&names()[0])).expect("there");
        assert_eq!(
            made.modified().expect("a time"),
            after.modified().expect("a time")
        );
    }

    #[test]
    fn the_last_used_files_are_kept() {
        let folder = tempfile::tempdir().expect("a folder");
        for age_s in 0..6u64 {
            let path = folder.path().join(format!("maps-{age_s}.bin"));
            write(&path, &[age_s as u8]).expect("writable");
            let time = std::time::SystemTime::now() - Duration::from_secs(1000 - age_s);
            let file = std::fs::File::options()
                .append(true)
                .open(&path)
                .expect("there");
            file.set_modified(time).expect("a time");
        }
        // The oldest is used.
        let oldest = folder.path().join("maps-0.bin");
        assert_eq!(read(&oldest, 1), Some(vec![0]));
        forget_oldest(folder.path(), "maps-", 2);
        let left: Vec<bool> = (0..6)
            .map(|i| folder.path().join(format!("maps-{i}.bin")).exists())
            .collect();
        assert_eq!(left, [true, false, false, false, false, true]);
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
