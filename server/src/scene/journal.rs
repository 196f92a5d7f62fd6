//! The revisions on disk: `revisions.log`, one line each, written ahead of `scene.json`.
//!
//! A line is the hash of a record, a space, and the record as JSON. Lines are appended and synced; when many are of
//! revisions that are not kept any more, the file is written anew under another name, synced, and takes the old one's
//! place. A group of changes has a line for each of them, too: the later one says which ones before it stands for.
//!
//! What a stop at any instant can leave, and what is made of it:
//!
//! - a last line that is cut short, or (after a power cut, where the file's length may reach the disk before its content)
//!   garbage at the end: not acknowledged, so it is cut off;
//! - a whole line, and a `scene.json` of the revision before: it goes on as if it had been acknowledged;
//! - of a group of changes, lines of some and not of the last: those that were acknowledged are there, and the last of them
//!   stands for them;
//! - a new file under its other name: unfinished or not, the old one holds all that was acknowledged.
//!
//! The order is what makes this so. Content is synced before a name is given to it (a rename that reaches the disk before
//! the content leaves an empty file), and the folder is synced after the name was given (else the old name may come back).

use std::collections::VecDeque;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::PathBuf;
use std::sync::Arc;

use xxhash_rust::xxh3::xxh3_64;

use super::REVISIONS_MAX;
use super::file::{SceneFileError, io_error, sync_folder, write_and_sync};
use super::revision::Revision;

/// Lines beyond which the file is written anew with those that are kept.
const LINES_MAX: usize = 2 * REVISIONS_MAX;
/// No record is a tenth as long.
const LINE_MAX_BYTES: usize = 1 << 20;
/// Hexadecimal digits of a hash.
const HASH_DIGITS: usize = 16;

/// The file of revisions.
pub(super) struct Journal {
    folder: PathBuf,
    path: PathBuf,
    lines: usize,
    bytes: u64,
    /// What stands at its end is not known: it is written anew before anything is added.
    is_suspect: bool,
}

/// What stands in a journal.
#[derive(Default)]
pub(super) struct Found {
    pub(super) revisions: VecDeque<Arc<Revision>>,
    /// Lines that hold nothing that can be used.
    pub(super) damaged: usize,
    /// Whether the end was cut short.
    pub(super) is_torn: bool,
    lines: usize,
    bytes: u64,
}

impl Journal {
    /// The journal of a folder and the revisions in it, oldest first; none if there is no file.
    pub(super) fn open(folder: PathBuf) -> Result<(Self, Found), SceneFileError> {
        let path = folder.join("revisions.log");
        let found = match File::open(&path) {
            Ok(file) => {
                let mut bytes = Vec::new();
                let most = (LINES_MAX + 1) as u64 * LINE_MAX_BYTES as u64;
                file.take(most)
                    .read_to_end(&mut bytes)
                    .map_err(|error| io_error("read", &path, error))?;
                read_lines(&bytes)
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => Found::default(),
            Err(error) => return Err(io_error("read", &path, error)),
        };
        let journal = Self {
            folder,
            path,
            lines: found.lines,
            bytes: found.bytes,
            // A file that is not there is made as a whole, so that its name is synced, too.
            is_suspect: found.is_torn || found.damaged > 0 || found.lines == 0,
        };
        Ok((journal, found))
    }

    /// Keeps the newest of `revisions`, which are all that are kept. Synced when it returns.
    pub(super) fn keep(
        &mut self,
        revisions: &VecDeque<Arc<Revision>>,
    ) -> Result<(), SceneFileError> {
        let Some(newest) = revisions.back() else {
            return Ok(());
        };
        if self.is_suspect || self.lines >= LINES_MAX {
            return self.rewrite(revisions);
        }
        let line = line_of(newest)?;
        self.is_suspect = true;
        self.append(&line)
            .map_err(|error| io_error("write", &self.path, error))?;
        self.is_suspect = false;
        self.lines += 1;
        self.bytes += line.len() as u64;
        Ok(())
    }

    /// Takes back what [`Self::keep`] has added: the revision was not made after all.
    pub(super) fn take_back(&mut self, revisions: &VecDeque<Arc<Revision>>) {
        if let Err(error) = self.rewrite(revisions) {
            // The next one is kept by writing all anew.
            self.is_suspect = true;
            tracing::error!(%error, "a revision that was not made stays in the journal");
        }
    }

    fn append(&self, line: &[u8]) -> io::Result<()> {
        let mut file = OpenOptions::new().append(true).open(&self.path)?;
        if file.metadata()?.len() != self.bytes {
            return Err(io::Error::other(
                "somebody else has changed it; is another server running in this folder?",
            ));
        }
        file.write_all(line)?;
        file.sync_all()
    }

    /// Writes all that is kept, and nothing else.
    pub(super) fn rewrite(
        &mut self,
        revisions: &VecDeque<Arc<Revision>>,
    ) -> Result<(), SceneFileError> {
        let mut text = Vec::new();
        for revision in revisions {
            text.extend(line_of(revision)?);
        }
        let new_path = self.folder.join("revisions.log.new");
        write_and_sync(&new_path, &text).map_err(|error| io_error("write", &new_path, error))?;
        fs::rename(&new_path, &self.path)
            .map_err(|error| io_error("replace", &self.path, error))?;
        (self.lines, self.bytes) = (revisions.len(), text.len() as u64);
        self.is_suspect = true;
        sync_folder(&self.folder).map_err(|error| io_error("sync", &self.folder, error))?;
        self.is_suspect = false;
        Ok(())
    }

    /// Whether all that it holds is known and whole.
    pub(super) fn is_whole(&self) -> bool {
        !self.is_suspect
    }
}

fn line_of(revision: &Revision) -> Result<Vec<u8>, SceneFileError> {
    let record = serde_json::to_vec(&revision.to_record()?)?;
    let mut line = format!("{:016x} ", xxh3_64(&record)).into_bytes();
    line.extend(record);
    line.push(b'\n');
    Ok(line)
}

fn read_lines(bytes: &[u8]) -> Found {
    let mut found = Found {
        bytes: bytes.len() as u64,
        ..Found::default()
    };
    let mut bad_at_end = 0;
    for line in bytes.split_inclusive(|byte| *byte == b'\n') {
        found.lines += 1;
        match read_line(line) {
            Some(revision) => {
                found.damaged += std::mem::take(&mut bad_at_end);
                // A number that comes again stands for a revision that was taken back; of a group the last one stands for all.
                while found
                    .revisions
                    .back()
                    .is_some_and(|last| last.revision >= revision.first)
                {
                    found.revisions.pop_back();
                }
                found.revisions.push_back(Arc::new(revision));
                if found.revisions.len() > REVISIONS_MAX {
                    found.revisions.pop_front();
                }
            }
            None => bad_at_end += 1,
        }
    }
    found.is_torn = bad_at_end > 0;
    found
}

/// The revision of a whole line.
fn read_line(line: &[u8]) -> Option<Revision> {
    let line = line.strip_suffix(b"\n")?;
    let (hash, record) = line.split_at_checked(HASH_DIGITS)?;
    let record = record.strip_prefix(b" ")?;
    let hash = u64::from_str_radix(std::str::from_utf8(hash).ok()?, 16).ok()?;
    if record.len() > LINE_MAX_BYTES || xxh3_64(record) != hash {
        return None;
    }
    // A record of a later version that this one cannot read counts as damaged: the scene itself stands in `scene.json`.
    let value = serde_json::from_slice(record).ok()?;
    Revision::from_record(&value).ok()
}
