//! TLS: certificate and key from PEM files, which may be read again while the server runs.

use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock};

use rustls::ServerConfig;
use rustls::pki_types::pem::{Error as PemError, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use thiserror::Error;
use tokio_rustls::TlsAcceptor;

use crate::access::{SecretFileError, check_secret_file};
use crate::config::TlsConfig;

/// Why there is no TLS.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TlsError {
    /// The certificate cannot be read.
    #[error("tls.certificate: {path} holds no certificates in PEM: {error}")]
    Certificate {
        /// The file.
        path: PathBuf,
        /// Why not.
        error: PemError,
    },
    /// Others than the owner can read the key.
    #[error("tls.key: {0}")]
    KeyFile(#[from] SecretFileError),
    /// The key cannot be read.
    #[error("tls.key: {path} holds no private key in PEM: {error}")]
    Key {
        /// The file.
        path: PathBuf,
        /// Why not.
        error: PemError,
    },
    /// They do not belong together, or are of a kind that is not known.
    #[error("tls.certificate and tls.key cannot be used: {0}")]
    Pair(#[from] rustls::Error),
}

/// What the server shows and speaks.
pub struct Tls {
    files: TlsConfig,
    acceptor: RwLock<TlsAcceptor>,
}

impl Tls {
    /// Reads certificate and key.
    ///
    /// # Errors
    /// Says which file is wrong.
    pub fn open(files: &TlsConfig) -> Result<Self, TlsError> {
        Ok(Self {
            files: files.clone(),
            acceptor: RwLock::new(acceptor_of(files)?),
        })
    }

    /// Reads both again, for connections from now on. On an error those of before stay.
    ///
    /// # Errors
    /// Says which file is wrong.
    pub fn read_again(&self) -> Result<(), TlsError> {
        let acceptor = acceptor_of(&self.files)?;
        *self
            .acceptor
            .write()
            .unwrap_or_else(PoisonError::into_inner) = acceptor;
        Ok(())
    }

    /// What begins a connection.
    pub(super) fn acceptor(&self) -> TlsAcceptor {
        self.acceptor
            .read()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

fn acceptor_of(files: &TlsConfig) -> Result<TlsAcceptor, TlsError> {
    let bad_certificate = |error| TlsError::Certificate {
        path: files.certificate.clone(),
        error,
    };
    let chain = CertificateDer::pem_file_iter(&files.certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(bad_certificate)?;
    if chain.is_empty() {
        return Err(bad_certificate(PemError::NoItemsFound));
    }
    check_secret_file(&files.key)?;
    let key = PrivateKeyDer::from_pem_file(&files.key).map_err(|error| TlsError::Key {
        path: files.key.clone(),
        error,
    })?;
    let mut config =
        ServerConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
            .with_protocol_versions(&[&rustls::version::TLS13, &rustls::version::TLS12])?
            .with_no_client_auth()
            .with_single_cert(chain, key)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}
