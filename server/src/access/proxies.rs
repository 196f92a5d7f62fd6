//! Reverse proxies: whose word about the client's address is believed.
//!
//! Every client may send the headers that proxies write, so they count only where the connection comes from a proxy that is
//! trusted, and only as far as trusted proxies wrote them. Each proxy adds the address that it was called from at the end, so
//! they are read from the right: the first address that is no trusted proxy's is the client's. What stands further left, the
//! client may have written itself.
//!
//! Which of the two headers the proxies write is configured: one that writes `X-Forwarded-For` passes a client's own
//! `Forwarded` on as it is, so a server that believed whichever is there would believe the client.

use std::net::{IpAddr, SocketAddr};

use axum::http::{HeaderMap, HeaderName, HeaderValue};
use ipnet::IpNet;
use serde::{Serialize, Serializer};
use serde_json::Value;
use skycell_protocol::read_json::{ReadJson, read_name};
use skycell_protocol::value_error::ValueError;

/// How many networks of proxies may be listed.
pub const PROXIES_MAX: usize = 64;

/// What a network of proxies looks like.
const NET_FORM: &str =
    "an address or a network, such as 10.0.0.2, 10.0.0.0/8 or fd00::/8, but not all addresses";

/// The header in which proxies tell where a request comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProxyHeader {
    /// `X-Forwarded-For`.
    #[default]
    XForwardedFor,
    /// `Forwarded` (RFC 7239), its parameter `for`.
    Forwarded,
}

impl ProxyHeader {
    const NAMES: [(&'static str, Self); 2] = [
        ("x-forwarded-for", Self::XForwardedFor),
        ("forwarded", Self::Forwarded),
    ];

    fn name(self) -> HeaderName {
        match self {
            Self::XForwardedFor => HeaderName::from_static("x-forwarded-for"),
            Self::Forwarded => axum::http::header::FORWARDED,
        }
    }
}

impl ReadJson for ProxyHeader {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &Self::NAMES)
    }
}

/// Addresses of proxies. Written and read as `10.0.0.0/8`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProxyNet(IpNet);

impl ProxyNet {
    /// Reads an address or a network. None if it is neither, or holds every address.
    pub fn parse(text: &str) -> Option<Self> {
        let net = match text.parse::<IpAddr>() {
            Ok(address) => IpNet::from(address.to_canonical()),
            Err(_) => text.parse::<IpNet>().ok()?,
        };
        (net.prefix_len() > 0).then(|| Self(net.trunc()))
    }
}

impl Serialize for ProxyNet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.0)
    }
}

impl ReadJson for ProxyNet {
    fn read_json(value: &Value, pointer: &str) -> Result<Self, ValueError> {
        value
            .as_str()
            .and_then(Self::parse)
            .ok_or_else(|| ValueError::new(pointer, value, NET_FORM))
    }
}

/// The proxies that are believed.
#[derive(Clone, Debug, Default)]
pub struct TrustedProxies {
    nets: Vec<ProxyNet>,
    header: ProxyHeader,
}

impl TrustedProxies {
    /// Proxies of these networks, and what they write.
    pub fn new(nets: Vec<ProxyNet>, header: ProxyHeader) -> Self {
        Self { nets, header }
    }

    /// Whether an address is that of a trusted proxy.
    pub fn trusts(&self, address: IpAddr) -> bool {
        let address = address.to_canonical();
        self.nets.iter().any(|net| net.0.contains(&address))
    }

    /// Where a request comes from that came on a connection from `peer`.
    pub fn client_of(&self, peer: IpAddr, headers: &HeaderMap) -> IpAddr {
        let mut nearest = peer;
        if !self.trusts(peer) {
            return peer;
        }
        // Later headers continue earlier ones.
        for line in headers.get_all(self.header.name()).iter().rev() {
            for hop in self.hops(line).into_iter().rev() {
                // A proxy that hides where a request comes from, or a header that nobody can read.
                let Some(address) = hop else { return nearest };
                nearest = address;
                if !self.trusts(address) {
                    return address;
                }
            }
        }
        nearest
    }

    /// The addresses of a header, from left to right.
    fn hops(&self, line: &HeaderValue) -> Vec<Option<IpAddr>> {
        let Ok(line) = line.to_str() else {
            return vec![None];
        };
        match self.header {
            ProxyHeader::XForwardedFor => line.split(',').map(address_of).collect(),
            ProxyHeader::Forwarded => unquoted_parts(line, ',').map(forwarded_for).collect(),
        }
    }
}

/// The address of an element of `Forwarded`.
fn forwarded_for(element: &str) -> Option<IpAddr> {
    let node = unquoted_parts(element, ';').find_map(|pair| {
        let (name, value) = pair.split_once('=')?;
        name.trim().eq_ignore_ascii_case("for").then_some(value)
    })?;
    let node = node.trim();
    let plain = node
        .strip_prefix('"')
        .and_then(|rest| rest.strip_suffix('"'))
        .unwrap_or(node);
    address_of(plain)
}

/// Parts of a text between separators that stand in no quotes. An escaped quote does not end them; no address has one.
fn unquoted_parts(text: &str, separator: char) -> impl Iterator<Item = &str> {
    let (mut is_quoted, mut is_escaped) = (false, false);
    text.split(move |c| {
        if is_escaped {
            is_escaped = false;
            return false;
        }
        match c {
            '\\' => is_escaped = is_quoted,
            '"' => is_quoted = !is_quoted,
            _ => {}
        }
        c == separator && !is_quoted
    })
}

/// An address with a port or without; one of IPv6 in brackets or without.
fn address_of(text: &str) -> Option<IpAddr> {
    let text = text.trim();
    let with_port = || Some(text.parse::<SocketAddr>().ok()?.ip());
    let bracketed = || text.strip_prefix('[')?.strip_suffix(']')?.parse().ok();
    let address = text.parse().ok().or_else(with_port).or_else(bracketed)?;
    Some(address.to_canonical())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn proxies(nets: &[&str], header: ProxyHeader) -> TrustedProxies {
        let nets = nets.iter().map(|net| ProxyNet::parse(net).expect("a net"));
        TrustedProxies::new(nets.collect(), header)
    }

    fn client(proxies: &TrustedProxies, peer: &str, lines: &[(&'static str, &str)]) -> String {
        let mut headers = HeaderMap::new();
        for (name, line) in lines {
            headers.append(*name, line.parse().expect("a header"));
        }
        let peer = peer.parse().expect("an address");
        proxies.client_of(peer, &headers).to_string()
    }

    #[test]
    fn a_network_is_an_address_or_cidr_and_never_everything() {
        for (text, written) in [
            ("10.0.0.2", Some("10.0.0.2/32")),
            ("10.1.2.3/8", Some("10.0.0.0/8")),
            ("::ffff:10.0.0.2", Some("10.0.0.2/32")),
            ("fd00::1", Some("fd00::1/128")),
            ("fd00::/8", Some("fd00::/8")),
            ("0.0.0.0/0", None),
            ("::/0", None),
            ("10.0.0.0/33", None),
            ("proxy.example", None),
            ("", None),
        ] {
            let net = ProxyNet::parse(text).map(|net| net.0.to_string());
            assert_eq!(net.as_deref(), written, "{text}");
        }
    }

    #[test]
    fn whoever_is_no_trusted_proxy_is_who_it_is_whatever_it_says() {
        let spoofed = [
            ("x-forwarded-for", "192.0.2.7"),
            ("forwarded", "for=192.0.2.7"),
        ];
        for header in [ProxyHeader::XForwardedFor, ProxyHeader::Forwarded] {
            let none = proxies(&[], header);
            assert_eq!(client(&none, "198.51.100.1", &spoofed), "198.51.100.1");
            let other = proxies(&["10.0.0.0/8"], header);
            assert_eq!(client(&other, "198.51.100.1", &spoofed), "198.51.100.1");
        }
    }

    #[test]
    fn the_right_most_address_that_is_no_trusted_proxy_counts() {
        let trusted = proxies(&["10.0.0.0/8", "fd00::/8"], ProxyHeader::XForwardedFor);
        for (lines, expected) in [
            (&["192.0.2.7"][..], "192.0.2.7"),
            // What the client wrote stands on the left.
            (&["203.0.113.9, 192.0.2.7"], "192.0.2.7"),
            (&["203.0.113.9, 192.0.2.7, 10.0.0.3"], "192.0.2.7"),
            (&["203.0.113.9", "192.0.2.7", "10.0.0.3"], "192.0.2.7"),
            (&["192.0.2.7:4711"], "192.0.2.7"),
            (&["2001:db8::7"], "2001:db8::7"),
            (&["[2001:db8::7]:4711, fd00::2"], "2001:db8::7"),
            (&["::ffff:192.0.2.7"], "192.0.2.7"),
            // A trusted proxy that calls by itself.
            (&["10.0.0.9"], "10.0.0.9"),
            (&[], "10.0.0.2"),
            // What nobody can read ends what is believed.
            (&["192.0.2.7, unknown"], "10.0.0.2"),
            (&["192.0.2.7, unknown, 10.0.0.3"], "10.0.0.3"),
            (&["192.0.2.7,"], "10.0.0.2"),
        ] {
            let lines: Vec<_> = lines.iter().map(|l| ("x-forwarded-for", *l)).collect();
            assert_eq!(client(&trusted, "10.0.0.2", &lines), expected, "{lines:?}");
        }
        let other_header = [
            ("forwarded", "for=203.0.113.9"),
            ("x-forwarded-for", "192.0.2.7"),
        ];
        assert_eq!(client(&trusted, "10.0.0.2", &other_header), "192.0.2.7");
    }

    #[test]
    fn forwarded_is_read_with_its_quotes_and_parameters() {
        let trusted = proxies(&["10.0.0.0/8"], ProxyHeader::Forwarded);
        for (line, expected) in [
            ("for=192.0.2.7", "192.0.2.7"),
            (
                "For=\"[2001:db8::7]:4711\"; proto=https;by=10.0.0.2",
                "2001:db8::7",
            ),
            (
                "for=203.0.113.9, for=192.0.2.7;host=\"a,b;for=1.1.1.1\"",
                "192.0.2.7",
            ),
            (
                "for=192.0.2.7, proto=https;for=\"10.0.0.3:80\"",
                "192.0.2.7",
            ),
            ("for=192.0.2.7, for=_hidden", "10.0.0.2"),
            ("for=192.0.2.7, proto=https", "10.0.0.2"),
            ("for=\"192.0.2.7", "10.0.0.2"),
            ("", "10.0.0.2"),
        ] {
            let found = client(&trusted, "10.0.0.2", &[("forwarded", line)]);
            assert_eq!(found, expected, "{line}");
        }
        let other_header = [("x-forwarded-for", "203.0.113.9")];
        assert_eq!(client(&trusted, "10.0.0.2", &other_header), "10.0.0.2");
    }
}
