//! Noise and maps kept on disk: made once, found by their parameters.

use super::maps::{MAP_SIZE, WeatherMaps};
use super::volumes::{NoiseVolume, VolumeKind};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use xxhash_rust::xxh3::xxh3_64;

/// Changes with the formulas of this module's noise: old files are then no longer found.
const GENERATOR_VERSION: u32 = 4;

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
    pub fn weather_maps(&self, seed: u32) -> WeatherMaps {
        let texels = (MAP_SIZE as usize).pow(2);
        let key = format!("maps-{MAP_SIZE}-seed{seed}-v{GENERATOR_VERSION}");
        let both = self.load_or_make(&key, 2 * texels, u64::from(MAP_SIZE), |bar| {
            let maps = WeatherMaps::generate(seed, || bar.inc(1));
            [maps.coverage, maps.cloud_type].concat()
        });
        let (coverage, cloud_type) = both.split_at(texels);
        WeatherMaps {
            coverage: coverage.to_vec(),
            cloud_type: cloud_type.to_vec(),
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
