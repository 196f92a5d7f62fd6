//! Whether a server may listen where it is told to.

use std::net::SocketAddr;

use thiserror::Error;

use super::token_list::Tokens;

/// The server would be open to whoever reaches it.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "listen = \"{listen}\" is reachable from other machines, and no token is configured, so whoever reaches it could \
     watch and change the sky. Make a token with
  skycell-server token new --role view --name guests
write the line that it prints into a file that only its owner can read (chmod 600), and name that file in the \
     configuration:
  tokens_file = \"/etc/skycell/tokens\"
or listen on this machine alone: listen = \"127.0.0.1:{port}\"", port = listen.port()
)]
pub struct ExposureError {
    /// Where it would listen.
    pub listen: SocketAddr,
}

/// Refuses an address beyond the loopback interface where no token is known.
///
/// # Errors
/// Says what to write.
pub fn check_exposure(listen: SocketAddr, tokens: &Tokens) -> Result<(), ExposureError> {
    if is_loopback(listen) || !tokens.is_empty() {
        Ok(())
    } else {
        Err(ExposureError { listen })
    }
}

/// Only this machine reaches it.
pub(super) fn is_loopback(listen: SocketAddr) -> bool {
    listen.ip().to_canonical().is_loopback()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::TokenEntry;

    #[test]
    fn beyond_the_loopback_interface_a_token_is_demanded() {
        let none = Tokens::open(None, vec![]).expect("no tokens");
        let line = format!("view guests sha256:{}", "0".repeat(64));
        let entry = TokenEntry::parse(&line).expect("a token");
        let one = Tokens::open(None, vec![entry]).expect("a token");
        for (listen, is_open) in [
            ("127.0.0.1:8080", false),
            ("127.9.9.9:8080", false),
            ("[::1]:8080", false),
            ("0.0.0.0:8080", true),
            ("[::]:8080", true),
            ("192.0.2.1:8080", true),
            ("[::ffff:192.0.2.1]:8080", true),
        ] {
            let listen: SocketAddr = listen.parse().expect("an address");
            assert_eq!(check_exposure(listen, &none).is_err(), is_open, "{listen}");
            assert!(check_exposure(listen, &one).is_ok(), "{listen}");
        }
        let error = check_exposure("0.0.0.0:8443".parse().expect("an address"), &none)
            .expect_err("open")
            .to_string();
        for part in ["token new", "tokens_file", "127.0.0.1:8443"] {
            assert!(error.contains(part), "{error}");
        }
    }
}
