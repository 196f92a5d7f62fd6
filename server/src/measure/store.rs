//! Measured points on disk: one line of JSON each, so that a run that was stopped goes on where it was.

use super::metrics::{LinearErrors, ShownErrors};
use super::settings::PointSettings;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why results cannot be kept.
#[derive(Debug, Error)]
#[error("cannot {action} {path}: {error}; --out names the folder")]
pub struct StoreError {
    /// What was tried.
    pub action: &'static str,
    /// With what.
    pub path: PathBuf,
    /// What the system says.
    pub error: io::Error,
}

impl StoreError {
    pub(super) fn of(action: &'static str, path: &Path, error: impl Into<io::Error>) -> Self {
        Self {
            action,
            path: path.to_owned(),
            error: error.into(),
        }
    }
}

/// What a picture cost, all of its samples together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    /// Rays.
    pub marches: u64,
    /// Texture reads, counted by the shader.
    pub texture_reads: Option<u64>,
    /// Evaluations of a density, counted by the shader.
    pub density_evaluations: Option<u64>,
    /// Look-ups of density for columns of the sun volume; they are among the texture reads.
    #[serde(default)]
    pub sun_volume_evaluations: u64,
    /// Time by the device's timestamps.
    pub gpu_ns: Option<u64>,
    /// Time by the clock, compositing and reading back included.
    pub wall_s: f64,
    /// Length of the compressed picture.
    pub encoded_bytes: Option<u64>,
    /// Time to compress it, by the clock.
    pub encode_s: Option<f64>,
}

/// What was measured at a point.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// The shown picture against the reference.
    pub shown: ShownErrors,
    /// Linear radiance against the reference; none for compressed pictures, which have none.
    pub linear: Option<LinearErrors>,
    /// [`LinearErrors::relative_mse`] against the path tracer, where it was run.
    pub path_traced_relative_mse: Option<f64>,
    /// What it cost.
    pub cost: Cost,
}

/// A measured point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Hash of all that the result depends on.
    pub key: String,
    /// The point.
    pub settings: PointSettings,
    /// The result.
    pub measurement: Measurement,
}

/// The measured points of a folder.
pub struct Store {
    path: PathBuf,
    file: File,
    records: HashMap<String, Record>,
    warnings: Vec<String>,
}

impl Store {
    /// Opens `results.jsonl` of a folder, which is made where there is none. Lines that are no records are left out with
    /// a warning: the last one of a run that was killed may be torn.
    ///
    /// # Errors
    /// When the folder cannot be made or the file not be read and written.
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        std::fs::create_dir_all(folder).map_err(|e| StoreError::of("make", folder, e))?;
        let path = folder.join("results.jsonl");
        let text = match std::fs::read(&path) {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(StoreError::of("read", &path, error)),
        };
        let mut warnings = Vec::new();
        let mut records = HashMap::new();
        for (number, line) in (1..).zip(text.lines()) {
            match serde_json::from_str::<Record>(line) {
                Ok(record) => {
                    records.insert(record.key.clone(), record);
                }
                Err(_) if line.trim().is_empty() => {}
                Err(error) => warnings.push(format!(
                    "line {number} of {} is damaged and left out: {error}",
                    path.display()
                )),
            }
        }
        let mut file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&path)
            .map_err(|e| StoreError::of("write", &path, e))?;
        if !text.is_empty() && !text.ends_with('\n') {
            // What comes next must not stick to the torn line.
            file.write_all(b"\n")
                .map_err(|e| StoreError::of("write", &path, e))?;
        }
        Ok(Self {
            path,
            file,
            records,
            warnings,
        })
    }

    /// What was wrong with the file.
    #[must_use]
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Points that were read or measured.
    #[must_use]
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether there is no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// A point's result.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&Record> {
        self.records.get(key)
    }

    /// Keeps a point: one write, then on disk.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn put(&mut self, record: Record) -> Result<(), StoreError> {
        let failed = |error: io::Error| StoreError::of("write", &self.path, error);
        let mut line = serde_json::to_string(&record).map_err(|e| failed(e.into()))?;
        line.push('\n');
        self.file.write_all(line.as_bytes()).map_err(failed)?;
        self.file.sync_data().map_err(failed)?;
        self.records.insert(record.key.clone(), record);
        Ok(())
    }

    /// The point's result if it is there, else what `measure` gives, kept.
    ///
    /// # Errors
    /// Those of `measure`, and when the file cannot be written.
    pub fn get_or_measure<E: From<StoreError>>(
        &mut self,
        key: &str,
        settings: PointSettings,
        measure: impl FnOnce() -> Result<Measurement, E>,
    ) -> Result<Record, E> {
        if let Some(record) = self.records.get(key) {
            return Ok(record.clone());
        }
        let record = Record {
            key: key.to_owned(),
            settings,
            measurement: measure()?,
        };
        self.put(record.clone())?;
        Ok(record)
    }
}

/// Replaces a file as a whole: whoever reads it, now or after a stop, sees the old or the new one.
///
/// # Errors
/// When it cannot be written.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
    let mut new_path = path.as_os_str().to_owned();
    new_path.push(".new");
    let new_path = PathBuf::from(new_path);
    let write = || -> io::Result<()> {
        let mut file = File::create(&new_path)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&new_path, path)
    };
    write().map_err(|error| StoreError::of("write", path, error))
}

/// Writes a report as JSON that people can read, too, its keys in the order of the alphabet.
///
/// # Errors
/// When it is no JSON or cannot be written.
pub fn write_json(path: &Path, report: &impl Serialize) -> anyhow::Result<()> {
    let text = format!("{:#}\n", serde_json::to_value(report)?);
    Ok(write_whole(path, text.as_bytes())?)
}

/// Hash of parts that a result depends on.
#[must_use]
pub fn key_of(parts: &[&str]) -> String {
    let mut hasher = xxhash_rust::xxh3::Xxh3::new();
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    format!("{:032x}", hasher.digest128())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measurement(flip: f64) -> Measurement {
        Measurement {
            shown: ShownErrors { flip, ssim: 1.0 },
            linear: None,
            path_traced_relative_mse: None,
            cost: Cost {
                wall_s: 0.1 + flip,
                ..Cost::default()
            },
        }
    }

    /// Measures points 0 to `count`; returns which were measured and not read.
    fn run(folder: &Path, count: u32) -> Vec<u32> {
        let mut store = Store::open(folder).expect("a folder");
        let mut measured = Vec::new();
        for n in 0..count {
            let settings = PointSettings::screen_space(n, 8);
            let record = store
                .get_or_measure::<StoreError>(&key_of(&[&n.to_string()]), settings, || {
                    measured.push(n);
                    Ok(measurement(f64::from(n) / 3.0))
                })
                .expect("kept");
            assert_eq!(record.measurement, measurement(f64::from(n) / 3.0));
        }
        measured
    }

    #[test]
    fn a_second_run_measures_only_what_the_first_did_not() {
        let folder = tempfile::tempdir().expect("a folder");
        assert_eq!(run(folder.path(), 3), [0, 1, 2]);
        assert_eq!(run(folder.path(), 5), [3, 4]);
        assert_eq!(run(folder.path(), 5), [0u32; 0]);
    }

    #[test]
    fn a_torn_last_line_is_measured_again_and_spoils_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        run(folder.path(), 3);
        let path = folder.path().join("results.jsonl");
        let text = std::fs::read_to_string(&path).expect("a file");
        std::fs::write(&path, &text[..text.len() - 20]).expect("torn");
        assert_eq!(
            Store::open(folder.path())
                .expect("a store")
                .warnings()
                .len(),
            1
        );
        assert_eq!(run(folder.path(), 3), [2]);
        let store = Store::open(folder.path()).expect("a store");
        assert_eq!(store.len(), 3);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("file");
        std::fs::write(&file, b"").expect("written");
        let refused = Store::open(&file.join("out"))
            .err()
            .expect("no folder in a file");
        assert!(refused.to_string().contains("--out"), "{refused}");
    }

    #[test]
    fn keys_tell_where_a_part_ends() {
        assert_ne!(key_of(&["ab", "c"]), key_of(&["a", "bc"]));
        assert_eq!(key_of(&["ab", "c"]), key_of(&["ab", "c"]));
    }
}
