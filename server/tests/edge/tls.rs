//! HTTPS and wss with certificates made for the test.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use reqwest::StatusCode;
use rustls::pki_types::CertificateDer;
use rustls::{ClientConfig, RootCertStore};
use skycell_server::config::TlsConfig;
use skycell_server::service::{Tls, TlsError};
use tokio_tungstenite::{Connector, connect_async_tls_with_config};

use crate::client::{Client, handshake, hello_json};
use crate::stand_in::Behaviour;
use crate::tokens::by_hand;
use crate::world::{World, start_with};

/// A certificate for localhost and its key, in files.
pub(crate) struct Certificate {
    pub(crate) files: TlsConfig,
    pub(crate) der: CertificateDer<'static>,
}

pub(crate) fn certificate(folder: &Path) -> Certificate {
    let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
    let made = rcgen::generate_simple_self_signed(names).expect("a certificate");
    let files = TlsConfig {
        certificate: folder.join("cert.pem"),
        key: folder.join("key.pem"),
    };
    std::fs::write(&files.certificate, made.cert.pem()).expect("written");
    write_secret(&files.key, &made.signing_key.serialize_pem());
    Certificate {
        files,
        der: made.cert.der().clone(),
    }
}

fn write_secret(path: &PathBuf, text: &str) {
    std::fs::write(path, text).expect("written");
    set_mode(path, 0o600);
}

fn set_mode(path: &Path, mode: u32) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).expect("set");
    }
}

fn client_config(
    der: &CertificateDer<'static>,
    versions: &[&'static rustls::SupportedProtocolVersion],
) -> ClientConfig {
    let mut roots = RootCertStore::empty();
    roots.add(der.clone()).expect("a certificate");
    ClientConfig::builder_with_provider(Arc::new(rustls::crypto::ring::default_provider()))
        .with_protocol_versions(versions)
        .expect("versions")
        .with_root_certificates(roots)
        .with_no_client_auth()
}

async fn world_with_tls() -> (World, Certificate) {
    let folder = tempfile::tempdir().expect("a folder");
    let made = certificate(folder.path());
    let files = made.files.clone();
    let world = start_with(Behaviour::default(), |config| config.tls = Some(files)).await;
    (world, made)
}

#[tokio::test(flavor = "multi_thread")]
async fn https_and_wss_are_spoken_and_plain_http_is_not() {
    let (world, made) = world_with_tls().await;
    let port = world.address().port();
    assert_eq!(world.service.url(), format!("https://{}", world.address()));
    for versions in [
        &[&rustls::version::TLS13][..],
        &[&rustls::version::TLS12][..],
    ] {
        let https = reqwest::Client::builder()
            .tls_backend_preconfigured(client_config(&made.der, versions))
            .no_proxy()
            .build()
            .expect("a client");
        let url = format!("https://localhost:{port}/api/v1/scene");
        let response = https.get(url).send().await.expect("an answer");
        assert_eq!(response.status(), StatusCode::OK);
        assert_eq!(response.version(), reqwest::Version::HTTP_11);

        let mut request = handshake(world.address(), Some("skycell.v1"));
        *request.uri_mut() = format!("wss://localhost:{port}/ws").parse().expect("a URI");
        let connector = Connector::Rustls(Arc::new(client_config(&made.der, versions)));
        let (socket, _) = connect_async_tls_with_config(request, None, true, Some(connector))
            .await
            .expect("connects");
        let mut client = Client { socket };
        client.say(&hello_json()).await;
        let (header, _) = client.frame().await;
        assert_eq!((header.width, header.height), (64, 32));
    }
    // A client that knows other authorities does not trust this server.
    let other = certificate(tempfile::tempdir().expect("a folder").path());
    let stranger = reqwest::Client::builder()
        .tls_backend_preconfigured(client_config(&other.der, rustls::ALL_VERSIONS))
        .build()
        .expect("a client");
    let url = format!("https://localhost:{port}/livez");
    assert!(stranger.get(url).send().await.is_err());
    // Plain HTTP gets nothing.
    let request = format!("GET /livez HTTP/1.1\r\nHost: {}\r\n\r\n", world.address());
    assert!(!by_hand(&world, &request).await.contains("200 OK"));
}

#[test]
fn a_certificate_and_a_key_that_cannot_be_used_are_told_apart() {
    let (a, b) = (
        tempfile::tempdir().expect("a folder"),
        tempfile::tempdir().expect("a folder"),
    );
    let (made, other) = (certificate(a.path()), certificate(b.path()));
    assert!(Tls::open(&made.files).is_ok());
    let with = |certificate: &PathBuf, key: &PathBuf| {
        Tls::open(&TlsConfig {
            certificate: certificate.clone(),
            key: key.clone(),
        })
        .err()
    };
    let (certificate, key) = (&made.files.certificate, &made.files.key);
    assert!(matches!(
        with(&a.path().join("none"), key),
        Some(TlsError::Certificate { .. })
    ));
    assert!(matches!(with(key, key), Some(TlsError::Certificate { .. })));
    assert!(matches!(
        with(certificate, certificate),
        Some(TlsError::Key { .. } | TlsError::KeyFile(_))
    ));
    assert!(matches!(
        with(certificate, &other.files.key),
        Some(TlsError::Pair(_))
    ));
    #[cfg(unix)]
    {
        set_mode(key, 0o644);
        let error = with(certificate, key).expect("others may read it");
        assert!(error.to_string().contains("chmod 600"), "{error}");
    }
}
