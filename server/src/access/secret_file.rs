//! Files that hold secrets: read only if nobody else may.

use std::io::Read;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a file of secrets is not read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SecretFileError {
    /// It cannot be read.
    #[error("cannot read {path}: {error}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why not.
        error: std::io::Error,
    },
    /// It is longer than it may be.
    #[error("{path} is longer than {max_bytes} bytes")]
    TooLong {
        /// The file.
        path: PathBuf,
        /// What is allowed.
        max_bytes: u64,
    },
    /// Others may read or change it.
    #[error(
        "{path} has mode {mode:03o}: others may read it, or a group may change it. \
         Write: chmod 600 {path}"
    )]
    Mode {
        /// The file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
}

/// What others may not: read, change or run it; and the group may not change it. A group may read it, because
/// orchestrators hand secrets over that way.
#[cfg(unix)]
const FORBIDDEN_MODE: u32 = 0o027;

/// Checks who may read or change a file with secrets.
///
/// # Errors
/// If others may.
pub(crate) fn check_secret_file(path: &Path) -> Result<(), SecretFileError> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = std::fs::metadata(path)
            .map_err(|error| SecretFileError::Read {
                path: path.to_owned(),
                error,
            })?
            .permissions()
            .mode()
            & 0o777;
        if mode & FORBIDDEN_MODE != 0 {
            return Err(SecretFileError::Mode {
                path: path.to_owned(),
                mode,
            });
        }
    }
    Ok(())
}

/// The text of a file of at most `max_bytes`.
pub(super) fn read_secret_file(path: &Path, max_bytes: u64) -> Result<String, SecretFileError> {
    check_secret_file(path)?;
    let failed = |error| SecretFileError::Read {
        path: path.to_owned(),
        error,
    };
    let mut text = String::new();
    let file = std::fs::File::open(path).map_err(failed)?;
    file.take(max_bytes + 1)
        .read_to_string(&mut text)
        .map_err(failed)?;
    if text.len() as u64 > max_bytes {
        return Err(SecretFileError::TooLong {
            path: path.to_owned(),
            max_bytes,
        });
    }
    Ok(text)
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_file_that_others_may_read_is_refused_with_what_to_write() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let path = file.path();
        for (mode, may) in [
            (0o600, true),
            (0o400, true),
            (0o440, true),
            (0o644, false),
            (0o660, false),
            (0o604, false),
            (0o601, false),
        ] {
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).expect("set");
            let result = check_secret_file(path);
            assert_eq!(result.is_ok(), may, "{mode:o}");
            if let Err(error) = result {
                assert!(error.to_string().contains("chmod 600"), "{error}");
            }
        }
    }
}
