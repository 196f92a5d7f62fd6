//! Files of maps that came through the API: named by their content, kept beside the scene, bounded.
//!
//! A file is complete on disk before a scene names it. One that no scene names any more stays for a while, so that a
//! change can be taken back by its old document, and goes when the folder is full.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use xxhash_rust::xxh3::xxh3_128;

use super::file::{SceneFileError, io_error, sync_folder, write_and_sync};
use crate::field::MapFileFormat;

/// Bytes of all files together that the folder holds at most: four layers' maps of the longest kind fit.
pub(super) const MAPS_TOTAL_MAX_BYTES: u64 = 512 << 20;
/// Bytes of all files together beyond which those that no scene names go, the oldest first.
const UNNAMED_FROM_BYTES: u64 = 128 << 20;
/// How many files that no scene names stay at most.
const UNNAMED_MAX: usize = 32;
/// Hexadecimal digits of a name.
const NAME_DIGITS: usize = 32;

/// A file of the folder.
struct Kept {
    used: SystemTime,
    name: String,
    bytes: u64,
}

/// The folder `maps` of the state.
pub(super) struct MapFolder {
    path: PathBuf,
}

/// Why a map is not kept.
#[derive(Debug, thiserror::Error)]
pub(super) enum KeepError {
    #[error(transparent)]
    Io(#[from] SceneFileError),
    #[error("{needed} bytes of maps, those that the scene names among them")]
    Full { needed: u64 },
}

/// Whether a name is one that this folder gives: others belong to whoever put them there.
fn is_content_name(name: &str) -> bool {
    name.split_once('.').is_some_and(|(stem, extension)| {
        stem.len() == NAME_DIGITS
            && stem
                .chars()
                .all(|c| c.is_ascii_digit() || ('a'..='f').contains(&c))
            && [MapFileFormat::Png, MapFileFormat::Exr]
                .iter()
                .any(|format| format.extension() == extension)
    })
}

impl MapFolder {
    pub(super) fn new(path: PathBuf) -> Self {
        Self { path }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Keeps a file and returns its name. `named` are the files that the scene names.
    pub(super) fn keep(
        &self,
        bytes: &[u8],
        format: MapFileFormat,
        named: &BTreeSet<String>,
    ) -> Result<String, KeepError> {
        let name = format!("{:032x}.{}", xxh3_128(bytes), format.extension());
        let path = self.path.join(&name);
        fs::create_dir_all(&self.path).map_err(|error| io_error("make", &self.path, error))?;
        // The content is compared, too: a file that was damaged, or another of the same hash, is replaced.
        if fs::read(&path).is_ok_and(|kept| kept == bytes) {
            // It counts as used now; where times cannot be set it may go sooner.
            let _ = fs::File::options()
                .append(true)
                .open(&path)
                .and_then(|file| file.set_modified(SystemTime::now()));
            return Ok(name);
        }
        let needed = self.named_bytes(named) + bytes.len() as u64;
        if needed > MAPS_TOTAL_MAX_BYTES {
            return Err(KeepError::Full { needed });
        }
        let new_path = self.path.join("map.new");
        write_and_sync(&new_path, bytes).map_err(|error| io_error("write", &new_path, error))?;
        fs::rename(&new_path, &path).map_err(|error| io_error("replace", &path, error))?;
        sync_folder(&self.path).map_err(|error| io_error("sync", &self.path, error))?;
        Ok(name)
    }

    fn named_bytes(&self, named: &BTreeSet<String>) -> u64 {
        let lengths = named
            .iter()
            .filter_map(|name| fs::metadata(self.path.join(name)).ok());
        lengths.map(|metadata| metadata.len()).sum()
    }

    /// Removes what no scene names and there is no room for. What cannot be removed stays for the next time.
    pub(super) fn collect(&self, named: &BTreeSet<String>) {
        let Ok(entries) = fs::read_dir(&self.path) else {
            return;
        };
        let mut kept: Vec<Kept> = entries
            .flatten()
            .filter_map(|entry| {
                let name = entry.file_name().into_string().ok()?;
                let metadata = entry.metadata().ok()?;
                is_content_name(&name).then_some(Kept {
                    used: metadata.modified().ok()?,
                    name,
                    bytes: metadata.len(),
                })
            })
            .collect();
        let mut total: u64 = kept.iter().map(|file| file.bytes).sum();
        kept.retain(|file| !named.contains(&file.name));
        kept.sort_by(|a, b| (a.used, &a.name).cmp(&(b.used, &b.name)));
        let many = kept.len().saturating_sub(UNNAMED_MAX);
        for (index, file) in kept.iter().enumerate() {
            if index >= many && total <= UNNAMED_FROM_BYTES {
                break;
            }
            if fs::remove_file(self.path.join(&file.name)).is_ok() {
                total -= file.bytes;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> (tempfile::TempDir, MapFolder) {
        let folder = tempfile::tempdir().expect("a folder");
        let maps = MapFolder::new(folder.path().join("maps"));
        (folder, maps)
    }

    #[test]
    fn a_file_is_known_by_its_content_and_a_damaged_one_is_replaced() {
        let (_folder, maps) = folder();
        let none = BTreeSet::new();
        let keep = |bytes: &[u8]| maps.keep(bytes, MapFileFormat::Png, &none).expect("kept");
        let name = keep(b"one");
        assert!(is_content_name(&name), "{name}");
        assert_eq!(keep(b"one"), name);
        assert_ne!(keep(b"two"), name);
        fs::write(maps.path().join(&name), b"damaged").expect("written");
        assert_eq!(keep(b"one"), name);
        assert_eq!(fs::read(maps.path().join(&name)).expect("read"), b"one");
    }

    #[test]
    fn what_no_scene_names_goes_oldest_first_and_strangers_files_stay() {
        let (_folder, maps) = folder();
        let none = BTreeSet::new();
        let first = maps
            .keep(b"first", MapFileFormat::Png, &none)
            .expect("kept");
        let named = BTreeSet::from([first.clone()]);
        fs::write(maps.path().join("by-hand.png"), b"mine").expect("written");
        for number in 0..UNNAMED_MAX + 8 {
            let bytes = number.to_le_bytes();
            maps.keep(&bytes, MapFileFormat::Exr, &named).expect("kept");
            maps.collect(&named);
        }
        let left = fs::read_dir(maps.path()).expect("read").count();
        assert_eq!(left, UNNAMED_MAX + 2);
        assert!(maps.path().join(first).exists());
        assert!(maps.path().join("by-hand.png").exists());
    }
}
