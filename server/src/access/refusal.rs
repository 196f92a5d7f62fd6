//! Why somebody is refused, by name: for the metrics.

/// Why a request, a viewer or a connection was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Refusal {
    /// No token, where one is needed.
    NoToken,
    /// A token that is not known.
    WrongToken,
    /// A token that was taken away while it was used.
    TokenTaken,
    /// A token whose role may not.
    Role,
    /// Too many wrong tokens.
    FailedTokens,
    /// A token in an address.
    TokenInUrl,
    /// Too many requests.
    Requests,
    /// Too many WebSockets opened.
    Upgrades,
    /// Too many connections of one peer.
    Connections,
    /// As many viewers as may be.
    Viewers,
    /// As many viewers of one peer as may be.
    ViewersOfPeer,
    /// As many pixels as may be.
    Pixels,
    /// A name that is not this server's.
    Host,
    /// A page of another site.
    Origin,
    /// A head with too many or too long headers.
    Head,
    /// No TLS where it is spoken.
    Tls,
}

impl Refusal {
    /// Every reason.
    pub const ALL: [Self; 16] = [
        Self::NoToken,
        Self::WrongToken,
        Self::TokenTaken,
        Self::Role,
        Self::FailedTokens,
        Self::TokenInUrl,
        Self::Requests,
        Self::Upgrades,
        Self::Connections,
        Self::Viewers,
        Self::ViewersOfPeer,
        Self::Pixels,
        Self::Host,
        Self::Origin,
        Self::Head,
        Self::Tls,
    ];

    /// Its name in the metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::NoToken => "no-token",
            Self::WrongToken => "wrong-token",
            Self::TokenTaken => "token-taken",
            Self::Role => "role",
            Self::FailedTokens => "failed-tokens",
            Self::TokenInUrl => "token-in-url",
            Self::Requests => "requests",
            Self::Upgrades => "upgrades",
            Self::Connections => "connections-of-peer",
            Self::Viewers => "viewers",
            Self::ViewersOfPeer => "viewers-of-peer",
            Self::Pixels => "pixels",
            Self::Host => "host",
            Self::Origin => "origin",
            Self::Head => "head-too-large",
            Self::Tls => "tls",
        }
    }
}
