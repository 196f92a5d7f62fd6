//! A token, and what is kept of it.

use std::fmt;

use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

/// What tokens of `skycell-server token new` begin with, so that one that has leaked is recognised.
pub const TOKEN_PREFIX: &str = "sky_";

/// 256 bits: nobody guesses them, so a plain hash keeps them and a slow one would only slow down logins.
const RANDOM_BYTES: usize = 32;

/// A token as its holder knows it. Never printed by `Debug`.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

impl Token {
    /// A new random token. None if the system gives no random numbers.
    pub fn new_random() -> Option<Self> {
        let mut bytes = [0; RANDOM_BYTES];
        rustls::crypto::ring::default_provider()
            .secure_random
            .fill(&mut bytes)
            .ok()?;
        use base64::Engine;
        let text = base64::engine::general_purpose::URL_SAFE_NO_PAD.encode(bytes);
        Some(Self(format!("{TOKEN_PREFIX}{text}")))
    }

    /// The text, for its holder.
    pub fn text(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

/// The SHA-256 of a token: all that the server keeps. Compared in constant time.
#[derive(Clone, Copy)]
pub struct TokenDigest([u8; 32]);

impl TokenDigest {
    /// The digest of a token.
    pub fn of(token: &str) -> Self {
        Self(Sha256::digest(token.as_bytes()).into())
    }

    /// Reads 64 hexadecimal digits.
    pub fn from_hex(text: &str) -> Option<Self> {
        let digits = text.as_bytes();
        if digits.len() != 64 {
            return None;
        }
        let mut bytes = [0; 32];
        for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
            let digit = |digit: u8| char::from(digit).to_digit(16);
            *byte = u8::try_from(digit(pair[0])? << 4 | digit(pair[1])?).ok()?;
        }
        Some(Self(bytes))
    }

    /// 64 hexadecimal digits.
    pub fn to_hex(self) -> String {
        self.0.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Whether both are the same; takes the same time wherever they differ.
    pub fn is(&self, other: &Self) -> bool {
        self.0.ct_eq(&other.0).into()
    }
}

impl fmt::Debug for TokenDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("TokenDigest(…)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn new_tokens_are_long_differ_and_fit_a_header() {
        let (a, b) = (
            Token::new_random().expect("random"),
            Token::new_random().expect("random"),
        );
        assert!(a != b);
        assert_eq!(a.text().len(), TOKEN_PREFIX.len() + 43);
        assert!(
            a.text()
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || b"-_".contains(&byte))
        );
        assert!(!format!("{a:?}").contains(a.text()));
    }

    #[test]
    fn a_digest_is_sha_256_in_hex_and_back() {
        // FIPS 180-2, appendix B.1.
        let hex = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        let digest = TokenDigest::of("abc");
        assert_eq!(digest.to_hex(), hex);
        let read = TokenDigest::from_hex(&hex.to_uppercase()).expect("hex");
        assert!(read.is(&digest) && !read.is(&TokenDigest::of("abd")));
        assert!(TokenDigest::from_hex(&hex[1..]).is_none());
        assert!(TokenDigest::from_hex(&format!("+{}", &hex[1..])).is_none());
    }
}
