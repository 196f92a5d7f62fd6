//! The tokens that a server knows: from a file, one a line, and from the configuration.

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use thiserror::Error;
use tokio::sync::watch;

use super::role::Role;
use super::secret_file::{SecretFileError, read_secret_file};
use super::token::TokenDigest;

/// How many tokens there may be. Each login compares with all of them.
const TOKENS_MAX: usize = 4096;

/// How long a token's name may be; at least one character.
const NAME_MAX_CHARS: usize = 64;

/// How long a file of tokens may be: all that there may be, with comments.
const FILE_MAX_BYTES: u64 = 1 << 20;

/// What a line of a file of tokens looks like.
pub const LINE_FORM: &str = "ROLE NAME sha256:64-HEX-DIGITS, as `skycell-server token new` prints it; \
     ROLE is view, steer or admin, NAME has 1 to 64 letters, digits, - . or _";

/// A token that the server knows.
#[derive(Clone, Debug)]
pub struct TokenEntry {
    /// What its holder may do.
    pub role: Role,
    /// Who holds it, for the log.
    pub name: String,
    /// What is kept of it.
    pub digest: TokenDigest,
}

impl fmt::Display for TokenEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} {} sha256:{}",
            self.role,
            self.name,
            self.digest.to_hex()
        )
    }
}

impl TokenEntry {
    /// Reads `ROLE NAME sha256:HEX`. None if it is none.
    pub fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace();
        let role = Role::of_name(words.next()?)?;
        let name = words.next().filter(|name| is_name(name))?.to_owned();
        let digest = TokenDigest::from_hex(words.next()?.strip_prefix("sha256:")?)?;
        words
            .next()
            .is_none()
            .then_some(Self { role, name, digest })
    }
}

/// Whether tokens may be called so.
pub fn is_name(name: &str) -> bool {
    (1..=NAME_MAX_CHARS).contains(&name.len())
        && name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || b"-._".contains(&byte))
}

/// Why there is no list of tokens. Never shows what a line holds: somebody may have written a token there.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TokenListError {
    /// The file cannot be read, or others than its owner can.
    #[error("tokens_file: {0}")]
    File(#[from] SecretFileError),
    /// A line is no token.
    #[error("{place} is no token; write {LINE_FORM}")]
    Line {
        /// Which line of which file, or which element of the configuration.
        place: String,
    },
    /// Two tokens have one name, or two lines one token.
    #[error("{place} names a token that was named before, or has another's name")]
    Twice {
        /// Which line of which file, or which element of the configuration.
        place: String,
    },
    /// The last one was taken away while the server runs.
    #[error(
        "no token is left, which would open the server to whoever reaches it; keep one, or stop the server"
    )]
    NoneLeft,
    /// Too many.
    #[error("there are more than {TOKENS_MAX} tokens")]
    TooMany,
}

/// The tokens that the server knows now. The file may be read again while the server runs.
pub struct Tokens {
    file: Option<PathBuf>,
    configured: Vec<TokenEntry>,
    known: watch::Sender<Arc<[TokenEntry]>>,
}

impl Tokens {
    /// The tokens of the configuration and of a file.
    ///
    /// # Errors
    /// Says which line is no token.
    pub fn open(
        file: Option<PathBuf>,
        configured: Vec<TokenEntry>,
    ) -> Result<Self, TokenListError> {
        let known = read(file.as_deref(), &configured)?;
        Ok(Self {
            file,
            configured,
            known: watch::Sender::new(known),
        })
    }

    /// Reads the file again. On an error the tokens of before stay.
    ///
    /// # Errors
    /// Says which line is no token, or that none is left.
    pub fn read_again(&self) -> Result<usize, TokenListError> {
        let known = read(self.file.as_deref(), &self.configured)?;
        let count = known.len();
        if count == 0 && !self.is_empty() {
            // Without any token everything is open.
            return Err(TokenListError::NoneLeft);
        }
        self.known.send_replace(known);
        Ok(count)
    }

    /// Whether none is known.
    pub fn is_empty(&self) -> bool {
        self.known().is_empty()
    }

    /// What is known of a token. Looks through all of them, so that the time tells nothing about which it was.
    pub fn holder(&self, token: &str) -> Option<TokenEntry> {
        let digest = TokenDigest::of(token);
        let mut holder = None;
        for entry in self.known().iter() {
            if entry.digest.is(&digest) {
                holder = Some(entry.clone());
            }
        }
        holder
    }

    /// What is known now, and word of every change of that.
    pub(super) fn watch(&self) -> watch::Receiver<Arc<[TokenEntry]>> {
        self.known.subscribe()
    }

    fn known(&self) -> Arc<[TokenEntry]> {
        Arc::clone(&self.known.borrow())
    }
}

fn read(
    file: Option<&Path>,
    configured: &[TokenEntry],
) -> Result<Arc<[TokenEntry]>, TokenListError> {
    let mut entries: Vec<TokenEntry> = Vec::new();
    let mut add = |entry: TokenEntry, place: &dyn Fn() -> String| {
        if entries
            .iter()
            .any(|other| other.name == entry.name || other.digest.is(&entry.digest))
        {
            return Err(TokenListError::Twice { place: place() });
        }
        entries.push(entry);
        if entries.len() > TOKENS_MAX {
            return Err(TokenListError::TooMany);
        }
        Ok(())
    };
    for (index, entry) in configured.iter().enumerate() {
        add(entry.clone(), &|| format!("/tokens/{index}"))?;
    }
    if let Some(path) = file {
        let text = read_secret_file(path, FILE_MAX_BYTES)?;
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let place = || format!("line {} of {}", index + 1, path.display());
            let entry =
                TokenEntry::parse(line).ok_or_else(|| TokenListError::Line { place: place() })?;
            add(entry, &place)?;
        }
    }
    Ok(entries.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(role: &str, name: &str, token: &str) -> String {
        format!("{role} {name} sha256:{}", TokenDigest::of(token).to_hex())
    }

    fn file(text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("tokens");
        std::fs::write(&path, text).expect("written");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).expect("set");
        }
        (folder, path)
    }

    #[test]
    fn a_file_has_one_token_a_line_and_is_read_again() {
        let text = format!(
            "# who may watch\n\n{}\n  {}  \n",
            line("view", "guests", "aaa"),
            line("admin", "ops", "bbb")
        );
        let (_folder, path) = file(&text);
        let entry = TokenEntry::parse(&line("steer", "show", "ccc")).expect("a token");
        let tokens = Tokens::open(Some(path.clone()), vec![entry]).expect("tokens");
        let holds = |token: &str| tokens.holder(token).map(|entry| entry.role);
        assert_eq!(holds("aaa"), Some(Role::View));
        let ops = tokens.holder("bbb").expect("known");
        assert_eq!((ops.role, ops.name.as_str()), (Role::Admin, "ops"));
        assert_eq!(holds("ccc"), Some(Role::Steer));
        assert_eq!(holds("ddd"), None);
        assert_eq!(holds(""), None);
        std::fs::write(&path, line("view", "guests", "eee")).expect("written");
        assert_eq!(tokens.read_again().expect("tokens"), 2);
        assert_eq!((holds("aaa"), holds("eee")), (None, Some(Role::View)));
        std::fs::write(&path, "view guests").expect("written");
        assert!(tokens.read_again().is_err());
        assert_eq!(holds("eee"), Some(Role::View), "what was known stays");
    }

    #[test]
    fn the_last_token_is_not_taken_away_and_a_server_without_any_may_get_one() {
        let (_folder, path) = file(&line("view", "guests", "aaa"));
        let tokens = Tokens::open(Some(path.clone()), vec![]).expect("tokens");
        std::fs::write(&path, "# nobody\n").expect("written");
        assert!(matches!(tokens.read_again(), Err(TokenListError::NoneLeft)));
        assert!(tokens.holder("aaa").is_some());
        let tokens = Tokens::open(Some(path.clone()), vec![]).expect("tokens");
        let known = tokens.watch();
        assert_eq!(tokens.read_again().expect("none as before"), 0);
        std::fs::write(&path, line("view", "guests", "bbb")).expect("written");
        assert_eq!(tokens.read_again().expect("one"), 1);
        assert!(known.has_changed().expect("open") && !tokens.is_empty());
    }

    #[test]
    fn what_is_no_token_is_told_by_its_place_and_not_repeated() {
        for text in [
            "sky_secret",
            "guests view sha256:00",
            "owner a sha256:00",
            &format!("{} more", line("view", "a", "b")),
            &line("view", "a/b", "b"),
            &line("view", &"a".repeat(65), "b"),
        ] {
            let (_folder, path) = file(&format!("# comment\n{text}\n"));
            let error = Tokens::open(Some(path), vec![]).err().expect("no token");
            let told = error.to_string();
            assert!(told.contains("line 2 of") && !told.contains(text), "{told}");
        }
        for (a, b) in [
            (line("view", "a", "b"), line("view", "a", "c")),
            (line("view", "a", "b"), line("view", "c", "b")),
        ] {
            let (_folder, path) = file(&format!("{a}\n{b}\n"));
            assert!(matches!(
                Tokens::open(Some(path), vec![]).err(),
                Some(TokenListError::Twice { .. })
            ));
        }
    }
}
