//! How a client is let in, and whom it trusts.

use std::path::Path;
use std::sync::Arc;

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use rustls::{ClientConfig, RootCertStore};
use skycell_protocol::ValueError;
use skycell_protocol::message::AccessToken;
use thiserror::Error;

/// How long a file with a token may be.
const TOKEN_FILE_MAX_BYTES: u64 = 64 * 1024;

/// Why a client has no token or trusts nobody.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum AccessError {
    /// A file cannot be read.
    #[error("cannot read {path}: {reason}")]
    File {
        /// The file.
        path: String,
        /// Why not.
        reason: String,
    },
    /// What is there is no token.
    #[error("{place} holds no token: {error}")]
    Token {
        /// The file or the variable.
        place: String,
        /// What a token is.
        error: ValueError,
    },
}

/// Token and trusted authorities. The token is never printed by `Debug`.
#[derive(Clone, Debug, Default)]
pub struct Access {
    token: Option<AccessToken>,
    authorities: Option<Arc<RootCertStore>>,
}

impl PartialEq for Access {
    fn eq(&self, other: &Self) -> bool {
        let same_authorities = match (&self.authorities, &other.authorities) {
            (None, None) => true,
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            _ => false,
        };
        self.token == other.token && same_authorities
    }
}

impl Eq for Access {}

impl Access {
    /// With this token.
    #[must_use]
    pub fn with_token(mut self, token: AccessToken) -> Self {
        self.token = Some(token);
        self
    }

    /// With the token in the first line of a file.
    ///
    /// # Errors
    /// If there is none.
    pub fn with_token_file(self, path: &Path) -> Result<Self, AccessError> {
        let text = read_bounded(path).map_err(|error| AccessError::File {
            path: path.display().to_string(),
            reason: error.to_string(),
        })?;
        let line = text.lines().next().unwrap_or_default().trim();
        self.with_token_text(line, &path.display().to_string())
    }

    /// With a token that stands somewhere else, such as in a variable.
    ///
    /// # Errors
    /// If it is none; `place` is told.
    pub fn with_token_text(self, text: &str, place: &str) -> Result<Self, AccessError> {
        match AccessToken::new(text) {
            Ok(token) => Ok(self.with_token(token)),
            Err(error) => Err(AccessError::Token {
                place: place.to_owned(),
                error,
            }),
        }
    }

    /// Trusts the authorities of a PEM file, and no others.
    ///
    /// # Errors
    /// If it holds none.
    pub fn with_ca_file(mut self, path: &Path) -> Result<Self, AccessError> {
        let failed = |reason: String| AccessError::File {
            path: path.display().to_string(),
            reason,
        };
        let mut authorities = RootCertStore::empty();
        let certificates = CertificateDer::pem_file_iter(path)
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|error| failed(error.to_string()))?;
        let (added, _) = authorities.add_parsable_certificates(certificates);
        if added == 0 {
            return Err(failed("there is no certificate in it".to_owned()));
        }
        self.authorities = Some(Arc::new(authorities));
        Ok(self)
    }

    /// The token.
    pub fn token(&self) -> Option<&AccessToken> {
        self.token.as_ref()
    }

    /// How TLS is spoken. The system's authorities are only read where they are needed.
    pub fn tls_config(&self, is_tls: bool) -> Arc<ClientConfig> {
        let authorities = match &self.authorities {
            Some(authorities) => Arc::clone(authorities),
            None => {
                let mut authorities = RootCertStore::empty();
                if is_tls {
                    // What cannot be read is not trusted; then the server's certificate is refused.
                    let system = rustls_native_certs::load_native_certs();
                    authorities.add_parsable_certificates(system.certs);
                }
                Arc::new(authorities)
            }
        };
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let versions = ClientConfig::builder_with_provider(provider)
            .with_protocol_versions(rustls::DEFAULT_VERSIONS)
            // Only a provider without any cipher for a version fails here.
            .unwrap_or_else(|_| ClientConfig::builder());
        let mut config = versions
            .with_root_certificates(authorities)
            .with_no_client_auth();
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Arc::new(config)
    }
}

fn read_bounded(path: &Path) -> std::io::Result<String> {
    use std::io::Read;
    let mut text = String::new();
    std::fs::File::open(path)?
        .take(TOKEN_FILE_MAX_BYTES)
        .read_to_string(&mut text)?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_the_first_line_of_its_file_and_never_shown() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("token");
        std::fs::write(&path, "  sky_secret \nmore\n").expect("written");
        let access = Access::default().with_token_file(&path).expect("a token");
        assert_eq!(access.token().map(AccessToken::text), Some("sky_secret"));
        assert!(!format!("{access:?}").contains("sky_secret"));
        std::fs::write(&path, "no token\n").expect("written");
        let error = Access::default().with_token_file(&path).expect_err("none");
        assert!(!error.to_string().contains("no token\n"), "{error}");
        let error = Access::default().with_ca_file(&path).expect_err("none");
        assert!(error.to_string().contains("certificate"), "{error}");
    }
}
