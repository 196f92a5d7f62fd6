//! Which names this server answers to, and pages of which sites may talk to it.
//!
//! A page of any site may send a visitor's browser to 127.0.0.1, and a name of that site may be made to lead there
//! (DNS rebinding): then the page's own origin is this server's. What gives it away is the `Host` header, which holds
//! the name that the browser was told.

use std::net::IpAddr;

use axum::http::header::{HOST, ORIGIN};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, StatusCode, Version};

use super::refusal::Refusal;
use crate::api::Problem;

/// Names and origins that are allowed.
#[derive(Clone, Debug)]
pub(super) struct Hosts {
    /// Only this machine reaches the server, so only its own names are right.
    pub(super) is_loopback: bool,
    /// Further names.
    pub(super) allowed_hosts: Vec<String>,
    /// Origins of other sites whose pages may talk to this server.
    pub(super) allowed_origins: Vec<String>,
}

impl Hosts {
    /// Refuses requests to a name that is not this server's.
    pub(super) fn check_host(
        &self,
        version: Version,
        headers: &HeaderMap,
    ) -> Result<(), (Refusal, Problem)> {
        let Some(host) = headers.get(HOST) else {
            // Health checks of some proxies. Browsers always name a host.
            if version == Version::HTTP_10 {
                return Ok(());
            }
            return Err((
                Refusal::Host,
                Problem::new(StatusCode::BAD_REQUEST, "the request has no header Host"),
            ));
        };
        let text = host.to_str().unwrap_or_default();
        if self.is_own_host(text) {
            return Ok(());
        }
        Err((
            Refusal::Host,
            Problem::new(
                StatusCode::MISDIRECTED_REQUEST,
                format!(
                    "{} is no name of this server; allowed_hosts in the configuration lists its names",
                    shown(text)
                ),
            ),
        ))
    }

    fn is_own_host(&self, host: &str) -> bool {
        let Ok(authority) = host.parse::<Authority>() else {
            return false;
        };
        let name = authority.host();
        let is_listed = |allowed: &String| {
            allowed.eq_ignore_ascii_case(host) || allowed.eq_ignore_ascii_case(name)
        };
        if self.allowed_hosts.iter().any(is_listed) || name.eq_ignore_ascii_case("localhost") {
            return true;
        }
        let address = name.trim_start_matches('[').trim_end_matches(']');
        match address.parse::<IpAddr>() {
            // No name leads to an address, so nobody can have made it lead here.
            Ok(address) => !self.is_loopback || address.to_canonical().is_loopback(),
            Err(_) => false,
        }
    }

    /// Refuses pages of other sites. What is no browser sends no origin.
    pub(super) fn check_origin(&self, headers: &HeaderMap) -> Result<(), (Refusal, Problem)> {
        let Some(origin) = headers.get(ORIGIN) else {
            return Ok(());
        };
        let origin = origin.to_str().unwrap_or_default();
        let host = headers
            .get(HOST)
            .and_then(|host| host.to_str().ok())
            .unwrap_or_default();
        let is_own = origin
            .split_once("://")
            .is_some_and(|(_, authority)| !host.is_empty() && authority.eq_ignore_ascii_case(host));
        if is_own || self.allowed_origins.iter().any(|other| other == origin) {
            return Ok(());
        }
        Err((
            Refusal::Origin,
            Problem::new(
                StatusCode::FORBIDDEN,
                format!(
                    "pages of {} may not connect; allowed_origins in the configuration lists those that may",
                    shown(origin)
                ),
            ),
        ))
    }
}

/// What somebody else wrote, as far as it is repeated.
fn shown(text: &str) -> String {
    const MAX_CHARS: usize = 80;
    if text.chars().count() > MAX_CHARS {
        let cut: String = text.chars().take(MAX_CHARS).collect();
        format!("{cut}…")
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hosts(is_loopback: bool) -> Hosts {
        Hosts {
            is_loopback,
            allowed_hosts: vec!["sky.example".to_owned(), "one.example:99".to_owned()],
            allowed_origins: vec!["https://world.example".to_owned()],
        }
    }

    fn headers(host: &str, origin: Option<&str>) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(HOST, host.parse().expect("a header"));
        if let Some(origin) = origin {
            headers.insert(ORIGIN, origin.parse().expect("a header"));
        }
        headers
    }

    #[test]
    fn a_server_answers_to_its_own_names_only() {
        for (host, on_loopback, beyond) in [
            ("localhost", true, true),
            ("LocalHost:8080", true, true),
            ("127.0.0.1:8080", true, true),
            ("127.8.9.1", true, true),
            ("[::1]:8080", true, true),
            ("[::ffff:127.0.0.1]:8080", true, true),
            ("sky.example", true, true),
            ("SKY.example:8443", true, true),
            ("one.example:99", true, true),
            ("one.example:98", false, false),
            ("192.0.2.7:8080", false, true),
            ("[2001:db8::1]", false, true),
            ("evil.example", false, false),
            ("evil.example:8080", false, false),
            ("localhost.evil.example", false, false),
            ("127.0.0.1.evil.example", false, false),
            ("sky.example.evil.example", false, false),
            ("127.0.0.1@evil.example", false, false),
            ("", false, false),
            ("a b", false, false),
        ] {
            for (is_loopback, may) in [(true, on_loopback), (false, beyond)] {
                let result = hosts(is_loopback).check_host(Version::HTTP_11, &headers(host, None));
                assert_eq!(result.is_ok(), may, "{host:?}, loopback: {is_loopback}");
            }
        }
        for (version, may) in [(Version::HTTP_10, true), (Version::HTTP_11, false)] {
            let result = hosts(true).check_host(version, &HeaderMap::new());
            assert_eq!(result.is_ok(), may, "{version:?}");
        }
    }

    #[test]
    fn pages_of_this_server_and_of_listed_origins_may_connect_and_others_may_not() {
        for (origin, may) in [
            (None, true),
            (Some("http://sky.example:8080"), true),
            (Some("http://SKY.example:8080"), true),
            (Some("https://world.example"), true),
            (Some("http://world.example"), false),
            (Some("http://sky.example"), false),
            (Some("http://evil.example"), false),
            (Some("null"), false),
        ] {
            let result = hosts(true).check_origin(&headers("sky.example:8080", origin));
            assert_eq!(result.is_ok(), may, "{origin:?}");
        }
    }
}
